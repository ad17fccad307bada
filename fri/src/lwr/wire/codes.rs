//! The coded fields of a measurement. Unknown codes are kept.

use crate::codes::codes;

codes! {
    /// State of the interface, as KRL `$FRISTATE`.
    #[doc(alias = "FRI_STATE")]
    State: u16 {
        /// Closed; the controller sends nothing in this state.
        Off = 0 "OFF",
        /// Monitor mode: measurements flow, commands are ignored but expected.
        Mon = 1 "MON",
        /// Command mode: the robot follows the commands, if its drives have power.
        Cmd = 2 "CMD",
    }
}

codes! {
    /// The controller's rating of our timing, as KRL `$FRIQUALITY`.
    #[doc(alias = "FRI_QUALITY")]
    Quality: u16 {
        /// Command mode is not allowed.
        Unacceptable = 0 "UNACCEPTABLE",
        /// Command mode is allowed; many answers are missing.
        Bad = 1 "BAD",
        /// Command mode is allowed; some answers are missing.
        Ok = 2 "OK",
        /// Command mode is allowed; most KRL programs wait for this.
        Perfect = 3 "PERFECT",
    }
}

codes! {
    /// Control strategy in force, as KRL `$STIFFNESS.STRATEGY` / 10.
    #[doc(alias = "FRI_CTRL")]
    Control: u16 {
        /// Another strategy.
        Unspecified = 0 "other",
        /// Joint position control.
        Position = 1 "position",
        /// Cartesian impedance control.
        CartesianImpedance = 2 "cartesian-impedance",
        /// Joint impedance control.
        JointImpedance = 3 "joint-impedance",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_roundtrip() {
        for code in 0..=u16::MAX {
            assert_eq!(State::from(code).code(), code);
            assert_eq!(Quality::from(code).code(), code);
            assert_eq!(Control::from(code).code(), code);
        }
    }

    #[test]
    fn codes_unknown_display() {
        assert_eq!(State::from(0xffff).to_string(), "?65535");
        assert_eq!(Quality::Perfect.to_string(), "PERFECT");
    }
}

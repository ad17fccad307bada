//! The coded fields of a measurement. Codes we do not know are kept, not judged.

use std::fmt;

/// Declares an enum over a `u16` code that loses no value.
macro_rules! codes {
    ($(#[$doc:meta])* $name:ident { $($(#[$vdoc:meta])* $variant:ident = $code:literal $text:literal,)+ }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum $name {
            $($(#[$vdoc])* $variant,)+
            /// A code this crate does not know.
            Other(u16),
        }

        impl $name {
            /// The number on the wire.
            #[must_use]
            pub fn code(self) -> u16 {
                match self {
                    $(Self::$variant => $code,)+
                    Self::Other(code) => code,
                }
            }
        }

        impl From<u16> for $name {
            fn from(code: u16) -> Self {
                match code {
                    $($code => Self::$variant,)+
                    code => Self::Other(code),
                }
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self {
                    $(Self::$variant => f.pad($text),)+
                    Self::Other(code) => write!(f, "?{code}"),
                }
            }
        }
    };
}

codes! {
    /// State of the interface, as KRL `$FRISTATE`.
    #[doc(alias = "FRI_STATE")]
    State {
        /// Closed; the controller sends nothing in this state.
        Off = 0 "OFF",
        /// Monitor mode: measurements flow, commands are ignored but expected.
        Mon = 1 "MON",
        /// Command mode: the robot follows the commands, if its drives have power.
        Cmd = 2 "CMD",
    }
}

codes! {
    /// The controller's judgement of our timing, as KRL `$FRIQUALITY`.
    #[doc(alias = "FRI_QUALITY")]
    Quality {
        /// Command mode is not allowed.
        Unacceptable = 0 "UNACCEPTABLE",
        /// Command mode is allowed; many answers are missing.
        Bad = 1 "BAD",
        /// Command mode is allowed; some answers are missing.
        Ok = 2 "OK",
        /// Command mode is allowed; what most KRL programs wait for.
        Perfect = 3 "PERFECT",
    }
}

codes! {
    /// Control strategy in force, as KRL `$STIFFNESS.STRATEGY` / 10.
    #[doc(alias = "FRI_CTRL")]
    Control {
        /// None of those below.
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
    fn every_code_survives() {
        for code in 0..=u16::MAX {
            assert_eq!(State::from(code).code(), code);
            assert_eq!(Quality::from(code).code(), code);
            assert_eq!(Control::from(code).code(), code);
        }
    }

    #[test]
    fn unknown_codes_are_shown_as_such() {
        assert_eq!(State::from(0xffff).to_string(), "?65535");
        assert_eq!(Quality::Perfect.to_string(), "PERFECT");
    }
}

//! The enumerations of the FRI schema. Unknown codes are kept.

use crate::codes::codes;

codes! {
    /// State of a session, `FRISessionState`.
    #[doc(alias = "ESessionState")]
    SessionState: i32 {
        /// No session; the controller sends at most one datagram in this state.
        Idle = 0 "IDLE",
        /// Measurements flow, quality does not suffice for commands yet.
        MonitoringWait = 1 "MONITORING_WAIT",
        /// Measurements flow, quality suffices for commands.
        MonitoringReady = 2 "MONITORING_READY",
        /// A motion with FRI overlay is about to begin; commands must agree with the interpolator.
        CommandingWait = 3 "COMMANDING_WAIT",
        /// The robot follows the commands.
        CommandingActive = 4 "COMMANDING_ACTIVE",
    }
}

codes! {
    /// The controller's rating of our timing, `FRIConnectionQuality`.
    Quality: i32 {
        /// Commands are not allowed.
        Poor = 0 "POOR",
        /// Commands are not allowed.
        Fair = 1 "FAIR",
        /// Commands are allowed.
        Good = 2 "GOOD",
        /// Commands are allowed.
        Excellent = 3 "EXCELLENT",
    }
}

codes! {
    /// Request of the safety controller, `SafetyState`.
    Safety: i32 {
        /// Nothing.
        Normal = 0 "normal",
        /// Stop 0: drives off at once, brakes close.
        Stop0 = 1 "stop-0",
        /// Stop 1: braking, then drives off.
        Stop1 = 2 "stop-1",
        /// Stop 2: braking, drives stay on.
        Stop2 = 3 "stop-2",
    }
}

codes! {
    /// Operation mode at the smartPAD, `OperationMode`.
    OperationMode: i32 {
        /// Manual, reduced speed.
        T1 = 0 "T1",
        /// Manual, high speed.
        T2 = 1 "T2",
        /// Automatic.
        Aut = 2 "AUT",
    }
}

codes! {
    /// State of one drive, `DriveState`.
    Drive: i32 {
        /// No power, brake closed.
        Off = 0 "off",
        /// Between off and active.
        Transitioning = 1 "transitioning",
        /// Power on, brake open.
        Active = 2 "active",
    }
}

codes! {
    /// Control mode of the motion under way, `ControlMode`.
    ControlMode: i32 {
        /// Joint position control.
        Position = 0 "position",
        /// Cartesian impedance control.
        CartesianImpedance = 1 "cartesian-impedance",
        /// Joint impedance control.
        JointImpedance = 2 "joint-impedance",
        /// No motion under way.
        None = 3 "none",
    }
}

codes! {
    /// Values that the overlay expects in every command, `ClientCommandMode`.
    CommandMode: i32 {
        /// No overlay active.
        None = 0 "none",
        /// Joint positions.
        Position = 1 "position",
        /// A wrench, and joint positions.
        Wrench = 2 "wrench",
        /// Joint torques, and joint positions.
        Torque = 3 "torque",
        /// A Cartesian pose (2.x).
        CartesianPose = 4 "cartesian-pose",
    }
}

codes! {
    /// Kind of overlay, `OverlayType`.
    Overlay: i32 {
        /// No overlay active.
        None = 0 "none",
        /// Joint overlay.
        Joint = 1 "joint",
        /// Cartesian overlay.
        Cartesian = 2 "cartesian",
    }
}

codes! {
    /// Type of an input or output, `FriIOType`.
    IoType: i32 {
        /// Boolean.
        Boolean = 0 "bool",
        /// Unsigned integer.
        Digital = 1 "digital",
        /// Real number.
        Analog = 2 "analog",
    }
}

codes! {
    /// Whether the client reads or writes, `FriIODirection`.
    IoDirection: i32 {
        /// The client reads.
        Input = 0 "in",
        /// The client writes.
        Output = 1 "out",
    }
}

codes! {
    /// How the redundant axis is determined, `RedundancyStrategy`.
    RedundancyStrategy: i32 {
        /// By the elbow angle E1, rad.
        E1 = 0 "E1",
        /// Not at all.
        None = 4 "none",
    }
}

/// Implements `Default` as the code 0, for fields missing on the wire.
macro_rules! zero_by_default {
    ($($name:ident),+) => { $(impl Default for $name {
        fn default() -> Self {
            0.into()
        }
    })+ };
}
zero_by_default!(IoType, IoDirection);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_roundtrip() {
        for code in (-3..300).chain([i32::MIN, i32::MAX]) {
            assert_eq!(SessionState::from(code).code(), code);
            assert_eq!(Quality::from(code).code(), code);
            assert_eq!(Safety::from(code).code(), code);
            assert_eq!(OperationMode::from(code).code(), code);
            assert_eq!(Drive::from(code).code(), code);
            assert_eq!(ControlMode::from(code).code(), code);
            assert_eq!(CommandMode::from(code).code(), code);
            assert_eq!(Overlay::from(code).code(), code);
            assert_eq!(IoType::from(code).code(), code);
            assert_eq!(IoDirection::from(code).code(), code);
            assert_eq!(RedundancyStrategy::from(code).code(), code);
        }
    }
}

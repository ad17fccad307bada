//! Settings and fault knobs of the emulated cabinet, with the defaults and where they come from. No behaviour.

use crate::emulator::{Chain, Contact, LineFaults, PowerOff, Sensing, Timing};
use crate::sunrise::AXES;
use crate::sunrise::IoLevel;
use crate::sunrise::wire::{
    CommandMode, ControlMode, Dialect, IoDirection, OperationMode, Quality,
};
use std::time::Duration;

/// Robot arm of the cabinet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Robot {
    /// LBR iiwa 7 R800.
    Iiwa7,
    /// LBR iiwa 14 R820.
    Iiwa14,
}

impl Robot {
    pub(super) fn chain(self) -> Chain {
        match self {
            Self::Iiwa7 => Chain::IIWA7,
            Self::Iiwa14 => Chain::IIWA14,
        }
    }
}

/// Settings of an emulated cabinet.
#[derive(Debug, Clone, PartialEq)]
pub struct CabinetConfig {
    /// Robot arm.
    pub robot: Robot,
    /// Dialect of its FRI option.
    pub dialect: Dialect,
    /// Period of monitoring messages, 1 ms to 100 ms, whole milliseconds; values beyond are clamped.
    pub send_period: Duration,
    /// An answer is due to every n-th message, from 1.
    pub receive_multiplier: u32,
    /// Joint positions at the start, rad.
    pub joints: [f64; AXES],
    /// Axis limits.
    pub limits: Limits,
    /// Time constant with which measured positions follow the set-point in position control.
    pub lag: Duration,
    /// How answers are rated.
    pub timing: Timing,
    /// How long quality must be GOOD before MONITORING_READY; zero, the default, as soon as it is. No length is published;
    /// clients see seconds.
    pub monitoring_wait: Duration,
    /// How long COMMANDING_WAIT lasts at least, with answers that agree all the time; zero, the default, one answer. No
    /// length is published.
    pub commanding_wait: Duration,
    /// Largest deviation of the first commands of an overlay from the interpolator, rad; *assumption*: 0.01.
    pub synchronisation_tolerance_rad: f64,
    /// Largest deviation of positions commanded with torques from the measured ones, rad; *assumption*: 0.2.
    pub axis_delta_max_rad: f64,
    /// Timeout for commands that agree with the interpolator; *assumption*: 10 s.
    pub synchronisation_timeout: Duration,
    /// Operation mode at the smartPAD; in T1 the flange is limited to 250 mm/s.
    pub operation_mode: OperationMode,
    /// Inputs and outputs that the robot program shares, at most 10, with their values at the start.
    pub ios: Vec<Io>,
    /// Names of frames that the robot program requests, at most 5.
    pub requested_frames: Vec<String>,
    /// What the tip of the tool touches.
    pub contact: Option<Contact>,
    /// Tip of the tool in the frame of the flange, m.
    pub tool_m: [f64; 3],
    /// How it estimates external forces.
    pub sensing: Sensing,
    /// Load that the robot program states, kg, and its centre in the frame of the flange, m. Only an arm with surroundings
    /// weighs: there the drives carry this load, and the estimated forces are those beyond it.
    pub load: (f64, [f64; 3]),
    /// The robot program.
    pub program: Program,
    /// Faults.
    pub faults: Faults,
    /// Random seed.
    pub seed: u64,
}

impl Default for CabinetConfig {
    fn default() -> Self {
        Self {
            robot: Robot::Iiwa14,
            dialect: Dialect::V1,
            send_period: Duration::from_millis(2),
            receive_multiplier: 1,
            joints: [0.0, 0.5, 0.0, -1.2, 0.0, 1.0, 0.0],
            limits: Limits::of(Robot::Iiwa14),
            lag: Duration::from_millis(10),
            timing: Timing::default(),
            monitoring_wait: Duration::ZERO,
            commanding_wait: Duration::ZERO,
            synchronisation_tolerance_rad: 0.01,
            axis_delta_max_rad: 0.2,
            synchronisation_timeout: Duration::from_secs(10),
            operation_mode: OperationMode::Aut,
            ios: Vec::new(),
            requested_frames: Vec::new(),
            contact: None,
            tool_m: [0.0; 3],
            sensing: Sensing::default(),
            load: (0.0, [0.0; 3]),
            program: Program::default(),
            faults: Faults::default(),
            seed: 1,
        }
    }
}

/// An input or output that the robot program shares.
#[derive(Debug, Clone, PartialEq)]
pub struct Io {
    /// `Group.Name`, at most 63 bytes.
    pub name: String,
    /// Whether the client may write it.
    pub direction: IoDirection,
    /// Its value.
    pub level: IoLevel,
}

/// Axis limits, symmetric about zero; from data sheets except the acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Largest absolute position, rad.
    pub position_rad: [f64; AXES],
    /// Largest absolute speed, rad/s.
    pub speed_rad_per_s: [f64; AXES],
    /// Braking deceleration, rad/s2; *assumption*: 10. Commanded accelerations are not checked: no such check is known.
    pub acceleration_rad_per_s2: [f64; AXES],
}

impl Limits {
    /// Limits of an arm.
    pub fn of(robot: Robot) -> Self {
        let degrees = [170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0_f64];
        let speeds = match robot {
            Robot::Iiwa7 => [98.0, 98.0, 100.0, 130.0, 140.0, 180.0, 180.0_f64],
            Robot::Iiwa14 => [85.0, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0],
        };
        Self {
            position_rad: degrees.map(f64::to_radians),
            speed_rad_per_s: speeds.map(f64::to_radians),
            acceleration_rad_per_s2: [10.0; AXES],
        }
    }
}

/// The control mode of a motion, with its parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Control {
    /// Joint position control.
    Position,
    /// Joint impedance control.
    JointImpedance {
        /// Nm/rad, from 0.
        stiffness: [f64; AXES],
        /// Lehr's damping, 0..=1.
        damping: [f64; AXES],
    },
    /// Cartesian impedance control.
    CartesianImpedance {
        /// N/m along x, y, z, then Nm/rad about A, B, C (z, y, x), from 0.
        stiffness: [f64; 6],
        /// Lehr's damping, in the same order, 0..=1.
        damping: [f64; 6],
    },
}

impl Control {
    /// Its code in messages.
    pub fn mode(&self) -> ControlMode {
        match self {
            Self::Position => ControlMode::Position,
            Self::JointImpedance { .. } => ControlMode::JointImpedance,
            Self::CartesianImpedance { .. } => ControlMode::CartesianImpedance,
        }
    }
}

/// A motion that holds its position, with a client overlay: `positionHold(control)` with an `FRIJointOverlay`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overlay {
    /// Control mode of the motion.
    pub control: Control,
    /// Values that the client has to command. WRENCH requires Cartesian impedance, TORQUE joint impedance,
    /// CARTESIAN_POSE FRI 2.
    pub command: CommandMode,
}

impl Default for Overlay {
    fn default() -> Self {
        Self {
            control: Control::Position,
            command: CommandMode::Position,
        }
    }
}

/// The robot program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Program {
    /// Nothing: the owner calls [`super::Cabinet::start_overlay`] and [`super::Cabinet::cancel`].
    Manual,
    /// Awaits quality and moves with an overlay, repeatedly.
    Auto {
        /// The motion.
        overlay: Overlay,
        /// Pause before the next motion after one ended; `None` ends the program.
        restart: Option<Duration>,
    },
}

impl Default for Program {
    fn default() -> Self {
        Self::Auto {
            overlay: Overlay::default(),
            restart: Some(Duration::from_secs(1)),
        }
    }
}

/// Fault settings.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Faults {
    /// Messages on the way to the client.
    pub to_client: LineFaults,
    /// Commands on the way to the cabinet.
    pub to_cabinet: LineFaults,
    /// A loss of drive power.
    pub power_off: Option<PowerOff>,
    /// Replaces the computed quality.
    pub quality: Option<Quality>,
    /// How slow the controller's clock runs, parts per million; at most 100,000 either way. Read at the start only.
    pub drift_ppm: f64,
}

//! Cell file configuration of a KUKA youBot on an EtherCAT segment. The driver is in `segment`.

use serde::Deserialize;
use takt_ethercat::youbot::{CURRENT_MAX_MA, HOMING};

use takt_device_drives::Recovery;

/// The arm of a youBot: a power board and the drives of five joints, one behind the other.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct YouBotArm {
    /// Name by which nets find it.
    pub name: String,
    /// Ring position of its power board, from 0; the drives follow.
    pub position: u16,
    /// Name of the gripper behind its last joint; `None` for no gripper.
    #[serde(default)]
    pub gripper: Option<String>,
    /// Whether arm and gripper may move by themselves, while no net commands them, to find their commutation and
    /// their stops. Otherwise they are operational only if their drives have known both since power-on.
    #[serde(default)]
    pub homing: bool,
    /// Recovery of arm and gripper after a fault.
    #[serde(default)]
    pub recovery: Recovery,
    /// Control loop of the drives.
    #[serde(default)]
    pub control: YouBotControl,
    /// Largest current of each motor, A.
    #[serde(default = "YouBotArm::default_current")]
    pub current_max: [f64; 5],
    /// Motor currents for homing against the stops, A.
    #[serde(default = "YouBotArm::default_homing_current")]
    pub homing_current: [f64; 5],
    /// From where nets count the joints, and the frames of the arm's kinematics.
    #[serde(default)]
    pub zero: YouBotZero,
    /// Range of each joint, degrees from its stop.
    #[serde(default = "YouBotArm::default_range")]
    pub range: [[f64; 2]; 5],
    /// Largest speed of each joint, degrees per second.
    #[serde(default = "YouBotArm::default_velocity")]
    pub velocity_max: [f64; 5],
    /// Largest acceleration of each joint, degrees per second squared.
    #[serde(default = "YouBotArm::default_acceleration")]
    pub acceleration_max: [f64; 5],
}

impl YouBotArm {
    /// An arm with its power board at that position, which does not move by itself.
    #[must_use]
    pub fn new(name: impl Into<String>, position: u16) -> Self {
        Self {
            name: name.into(),
            position,
            gripper: None,
            homing: false,
            recovery: Recovery::default(),
            control: YouBotControl::default(),
            current_max: Self::default_current(),
            homing_current: Self::default_homing_current(),
            zero: YouBotZero::default(),
            range: Self::default_range(),
            velocity_max: Self::default_velocity(),
            acceleration_max: Self::default_acceleration(),
        }
    }

    fn default_current() -> [f64; 5] {
        CURRENT_MAX_MA.map(amperes)
    }

    fn default_homing_current() -> [f64; 5] {
        HOMING.map(|homing| amperes(homing.current_ma))
    }

    /// Mechanical range from stop to stop; the third joint counts downwards.
    const fn default_range() -> [[f64; 2]; 5] {
        [
            [0.0, 338.0],
            [0.0, 155.0],
            [-297.0, 0.0],
            [0.0, 205.0],
            [0.0, 335.0],
        ]
    }

    const fn default_velocity() -> [f64; 5] {
        [90.0; 5]
    }

    const fn default_acceleration() -> [f64; 5] {
        [180.0; 5]
    }
}

fn amperes(milliamperes: i32) -> f64 {
    f64::from(milliamperes) / 1000.0
}

/// From where nets count the joints of an arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum YouBotZero {
    /// From the upright arm, as the Robotics API does; its base is below axis 1, its flange in the palm of the gripper.
    #[default]
    Upright,
    /// From the stops, where the arm is folded, as the vendor does; its frames are `arm_link_0` and `arm_link_5`.
    Folded,
}

impl YouBotZero {
    /// Joint positions of the upright arm, degrees from the stops.
    const UPRIGHT: [f64; 5] = [169.0, 65.0, -146.0, 102.5, 167.5];

    /// Positions at which nets see zero, rad from the stops.
    #[must_use]
    pub fn offsets(self) -> [f64; 5] {
        match self {
            Self::Upright => Self::UPRIGHT.map(f64::to_radians),
            Self::Folded => [0.0; 5],
        }
    }

    /// The model of the arm's kinematics.
    #[must_use]
    pub const fn model(self) -> &'static str {
        match self {
            Self::Upright => "kuka_youbot_upright",
            Self::Folded => "kuka_youbot",
        }
    }
}

/// Control loop of an arm's drives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum YouBotControl {
    /// Position loop: the drives apply their own ramp.
    #[default]
    Position,
    /// Velocity loop, with position correction in each cycle: smaller following error in fast motions.
    Velocity,
}

/// The base of a youBot: a power board and the drives of four mecanum wheels, one behind the other.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct YouBotBase {
    /// Name by which nets find it.
    pub name: String,
    /// Ring position of its power board, from 0; the drives follow.
    #[serde(default)]
    pub position: u16,
    /// Whether wheels may turn by themselves, while no net commands the base, to find their commutation after
    /// power-on: up to a fifth of a turn. Otherwise the base is operational only if its drives know it.
    #[serde(default = "YouBotBase::default_commutation")]
    pub commutation: bool,
    /// Recovery after a fault.
    #[serde(default)]
    pub recovery: Recovery,
    /// Largest current of each motor, A.
    #[serde(default = "YouBotBase::default_current")]
    pub current_max: f64,
    /// Largest speed, m/s.
    #[serde(default = "YouBotBase::default_limit")]
    pub velocity_max: f64,
    /// Largest rotational speed, rad/s.
    #[serde(default = "YouBotBase::default_limit")]
    pub rotation_max: f64,
    /// Largest acceleration, m/s².
    #[serde(default = "YouBotBase::default_acceleration")]
    pub acceleration_max: f64,
    /// Largest rotational acceleration, rad/s².
    #[serde(default = "YouBotBase::default_acceleration")]
    pub rotation_acceleration_max: f64,
}

impl YouBotBase {
    /// A base with its power board at that position.
    #[must_use]
    pub fn new(name: impl Into<String>, position: u16) -> Self {
        Self {
            name: name.into(),
            position,
            commutation: Self::default_commutation(),
            recovery: Recovery::default(),
            current_max: Self::default_current(),
            velocity_max: Self::default_limit(),
            rotation_max: Self::default_limit(),
            acceleration_max: Self::default_acceleration(),
            rotation_acceleration_max: Self::default_acceleration(),
        }
    }

    const fn default_commutation() -> bool {
        true
    }

    const fn default_current() -> f64 {
        5.0
    }

    const fn default_limit() -> f64 {
        0.8
    }

    const fn default_acceleration() -> f64 {
        1.6
    }
}

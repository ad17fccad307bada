//! A KUKA youBot on an EtherCAT segment, as the cell's file tells it. How it is led is in `device::ethercat`.

use serde::Deserialize;

use super::Recovery;

/// The arm of a youBot: a power board and the drives of five joints, one behind the other.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct YouBotArm {
    /// Name by which nets find it.
    pub name: String,
    /// Where its power board is in the ring, from 0; the drives follow.
    pub position: u16,
    /// Name by which nets find the gripper behind its last joint; `None` for no gripper.
    #[serde(default)]
    pub gripper: Option<String>,
    /// Whether arm and gripper may move by themselves, while nothing commands them, to find their commutation and
    /// their stops. Without, they are operational only if their drives know both since power came on.
    #[serde(default)]
    pub homing: bool,
    /// What becomes of arm and gripper after a fault.
    #[serde(default)]
    pub recovery: Recovery,
    /// By which loop of the drives joints are moved.
    #[serde(default)]
    pub control: YouBotControl,
    /// Largest current of each motor, A.
    #[serde(default = "YouBotArm::default_current")]
    pub current_max: [f64; 5],
    /// Current of each motor at which it presses against its stop, A.
    #[serde(default = "YouBotArm::default_homing_current")]
    pub homing_current: [f64; 5],
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
    /// One of that name with its power board there, which does not move by itself.
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
            range: Self::default_range(),
            velocity_max: Self::default_velocity(),
            acceleration_max: Self::default_acceleration(),
        }
    }

    const fn default_current() -> [f64; 5] {
        [4.0, 4.0, 3.0, 2.0, 1.5]
    }

    const fn default_homing_current() -> [f64; 5] {
        [2.0, 0.5, 1.0, 0.5, 0.5]
    }

    /// What the mechanics allow, from stop to stop; the third joint counts downwards.
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

/// By which loop of its drives an arm is moved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum YouBotControl {
    /// That of position: the drives keep to their own ramp on the way.
    #[default]
    Position,
    /// That of velocity, with positions corrected each cycle: less behind on fast motions.
    Velocity,
}

/// The base of a youBot: a power board and the drives of four mecanum wheels, one behind the other.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct YouBotBase {
    /// Name by which nets find it.
    pub name: String,
    /// Where its power board is in the ring, from 0; the drives follow.
    #[serde(default)]
    pub position: u16,
    /// Whether wheels may turn by themselves, while nothing commands the base, to find their commutation after power
    /// came on: up to a fifth of a turn. Without, it is operational only if its drives know it.
    #[serde(default = "YouBotBase::default_commutation")]
    pub commutation: bool,
    /// What becomes of it after a fault.
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
    /// One of that name with its power board there.
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

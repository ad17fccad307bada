//! Parts of a device, as data. They determine where the values of a device lie in the image, what programs see of it,
//! and what a recording contains. Behaviour is in the drivers.

use serde::{Deserialize, Serialize};
use takt_net::device::{
    Base, CartesianPosition, Gripper, Homing, Interfaces, Io, JointTorque, Layout, Order,
    ServoGripper, interface,
};

use crate::device::ARM_JOINTS_MAX;

/// A number that a driver reports about its drives or its wire, for people to look at: its name within the device, its unit, and
/// the names of the states that it numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Figure {
    /// Such as `joint.0.statusword`; unique in the device.
    pub name: String,
    /// SI unit; empty if it has none.
    pub unit: String,
    /// If it is the number of a state: the names of all, by number.
    pub states: Vec<String>,
}

impl Figure {
    /// A count, or another number without a unit.
    #[must_use]
    pub fn number(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            ..Self::default()
        }
    }

    /// The value of a counter.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "counters below 2^53 are exact")]
    pub const fn count(value: u64) -> f64 {
        value as f64
    }

    /// A number with that unit.
    #[must_use]
    pub fn with_unit(name: impl Into<String>, unit: &str) -> Self {
        Self {
            unit: unit.to_owned(),
            ..Self::number(name)
        }
    }

    /// A time, s.
    #[must_use]
    pub fn time(name: impl Into<String>) -> Self {
        Self::with_unit(name, "s")
    }

    /// The number of one of these states.
    #[must_use]
    pub fn state(name: impl Into<String>, states: impl IntoIterator<Item = impl ToString>) -> Self {
        let states = states.into_iter().map(|state| state.to_string());
        Self {
            states: states.collect(),
            ..Self::number(name)
        }
    }
}

/// These parts, and figures.
#[must_use]
pub fn with_figures(parts: &[Part], figures: impl IntoIterator<Item = Figure>) -> Vec<Part> {
    let figures = Part::Figures(figures.into_iter().collect());
    parts.iter().cloned().chain([figures]).collect()
}

/// A part of a device besides its joints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// It is a mobile base.
    Base {
        /// Number of wheels whose state it reports.
        wheels: usize,
        /// Largest speed, m/s.
        velocity_max: f64,
        /// Largest rotational speed, rad/s.
        rotation_max: f64,
        /// Largest acceleration, m/s².
        #[serde(default = "unknown")]
        acceleration_max: f64,
        /// Largest rotational acceleration, rad/s².
        #[serde(default = "unknown")]
        rotation_acceleration_max: f64,
    },
    /// It has inputs and outputs.
    Io {
        /// Digital inputs.
        bool_in: usize,
        /// Digital outputs.
        bool_out: usize,
        /// Analogue inputs.
        real_in: usize,
        /// Analogue outputs.
        real_out: usize,
    },
    /// It follows Cartesian positions.
    CartesianPosition,
    /// It grips.
    Gripper {
        /// Largest distance between its fingers, m.
        distance_max: f64,
    },
    /// Tool and load can be commanded.
    Tool,
    /// It has several control strategies.
    Strategy,
    /// Stiffness, damping and torque of its joints can be commanded.
    JointImpedance,
    /// Stiffness, damping and wrench of its tool can be commanded.
    CartesianImpedance,
    /// It reports joint torques.
    Torques,
    /// It reports force and torque at its tool.
    Wrench,
    /// Its drives report flags.
    Drives {
        /// Number of drives.
        count: usize,
    },
    /// It grips by itself, by commands of its own protocol.
    ServoGripper,
    /// Its driver homes it.
    Homing,
    /// An oscillation of its tool in Cartesian impedance can be commanded.
    CartesianSine,
    /// Its driver reports numbers about its drives and its wire.
    Figures(Vec<Figure>),
}

/// A limit that an older recording does not have.
const fn unknown() -> f64 {
    f64::INFINITY
}

/// Allocates the signal and command words of these parts of a device with `joints` joints. The same parts in the same
/// order give the same words.
#[must_use]
pub fn lay(parts: &[Part], joints: usize, layout: &mut Layout) -> Interfaces {
    let mut has = Interfaces::default();
    for part in parts {
        match *part {
            Part::Base {
                wheels,
                velocity_max,
                rotation_max,
                acceleration_max,
                rotation_acceleration_max,
            } => {
                let speeds = [velocity_max, rotation_max];
                let accelerations = [acceleration_max, rotation_acceleration_max];
                has.base = Some(Base::new(layout, wheels, speeds, accelerations));
            }
            Part::Io {
                bool_in,
                bool_out,
                real_in,
                real_out,
            } => has.io = Some(Io::new(layout, [bool_in, bool_out, real_in, real_out])),
            Part::CartesianPosition => has.cartesian = Some(CartesianPosition::new(layout)),
            Part::Gripper { distance_max } => {
                has.gripper = Some(Gripper::new(layout, distance_max));
            }
            Part::Tool => has.tool = Some(Order::new(layout)),
            Part::Strategy => has.strategy = Some(Order::new(layout)),
            Part::JointImpedance => {
                has.joint_impedance = Some((0..joints).map(|_| Order::new(layout)).collect());
            }
            Part::CartesianImpedance => has.cartesian_impedance = Some(Order::new(layout)),
            Part::Torques => {
                let torque = |layout: &mut Layout| JointTorque {
                    estimated: layout.signal(),
                    measured: layout.signal(),
                };
                has.torques = Some((0..joints).map(|_| torque(layout)).collect());
            }
            Part::Wrench => has.wrench = Some(layout.signal()),
            Part::Drives { count } => {
                has.drives = Some((0..count).map(|_| layout.signal()).collect());
            }
            Part::ServoGripper => has.servo_gripper = Some(ServoGripper::new(layout)),
            Part::Homing => has.homing = Some(Homing::new(layout)),
            Part::CartesianSine => has.cartesian_sine = Some(Order::new(layout)),
            Part::Figures(ref figures) => {
                let place = |figure: &Figure| interface::Figure {
                    name: figure.name.as_str().into(),
                    unit: figure.unit.as_str().into(),
                    states: figure.states.clone().into(),
                    place: layout.signal(),
                };
                has.figures = figures.iter().map(place).collect();
            }
        }
    }
    has
}

/// All interfaces that a device can have, to check a net without its cell.
#[must_use]
pub fn everything() -> Interfaces {
    const MANY: usize = 64;
    let parts = [
        Part::Base {
            wheels: MANY,
            velocity_max: f64::INFINITY,
            rotation_max: f64::INFINITY,
            acceleration_max: f64::INFINITY,
            rotation_acceleration_max: f64::INFINITY,
        },
        Part::Io {
            bool_in: MANY,
            bool_out: MANY,
            real_in: MANY,
            real_out: MANY,
        },
        Part::CartesianPosition,
        Part::Gripper {
            distance_max: f64::INFINITY,
        },
        Part::Tool,
        Part::Strategy,
        Part::JointImpedance,
        Part::CartesianImpedance,
        Part::Torques,
        Part::Wrench,
        Part::Drives { count: MANY },
        Part::ServoGripper,
        Part::Homing,
        Part::CartesianSine,
    ];
    lay(&parts, ARM_JOINTS_MAX, &mut Layout::default())
}

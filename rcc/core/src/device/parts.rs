//! What devices are made of, as data: from it follow where their values lie in the image, what is
//! told to programs, and what a recording notes. It does not say how a device does anything.

use serde::{Deserialize, Serialize};
use takt_net::device::{
    Base, CartesianPosition, Gripper, Interfaces, Io, JointTorque, Layout, Order,
};

use crate::device::ARM_JOINTS_MAX;

/// Something a device offers beside joints.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// It is a mobile base.
    Base {
        /// How many wheels it tells of.
        wheels: usize,
        /// Largest speed, m/s.
        velocity_max: f64,
        /// Largest rotational speed, rad/s.
        rotation_max: f64,
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
    /// It follows positions of its tool.
    CartesianPosition,
    /// It grips.
    Gripper {
        /// Largest distance between its fingers, m.
        distance_max: f64,
    },
    /// It can be told what it carries.
    Tool,
    /// It has more than one control strategy.
    Strategy,
    /// Its joints give way as told.
    JointImpedance,
    /// Its tool gives way as told.
    CartesianImpedance,
    /// It knows torques at its joints.
    Torques,
    /// It knows force and torque at its tool.
    Wrench,
    /// Its drives tell flags.
    Drives {
        /// How many drives.
        count: usize,
    },
}

/// The places of what these parts of a device with so many joints report and are told. The same
/// parts in the same order give the same places.
#[must_use]
pub fn lay(parts: &[Part], joints: usize, layout: &mut Layout) -> Interfaces {
    let mut has = Interfaces::default();
    for part in parts {
        match *part {
            Part::Base {
                wheels,
                velocity_max,
                rotation_max,
            } => has.base = Some(Base::new(layout, wheels, velocity_max, rotation_max)),
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
        }
    }
    has
}

/// Everything a device could offer, so that a net can be checked apart from its cell.
#[must_use]
pub fn everything() -> Interfaces {
    const MANY: usize = 64;
    let parts = [
        Part::Base {
            wheels: MANY,
            velocity_max: f64::INFINITY,
            rotation_max: f64::INFINITY,
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
    ];
    lay(&parts, ARM_JOINTS_MAX, &mut Layout::default())
}

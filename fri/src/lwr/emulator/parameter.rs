//! The fields of a command besides its position, as a controller checks them: the flag that declares each valid, and its
//! range. It applies none of them.

use crate::lwr::JOINT_NAMES;
use crate::lwr::wire::{Cmd, CmdFlags};
use std::fmt;

/// A field of a command besides its position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Parameter {
    /// Added torque of a joint, Nm.
    JointTorque,
    /// Stiffness of a joint, Nm/rad, from 0.
    JointStiffness,
    /// Normalised damping of a joint, 0..=1.
    JointDamping,
    /// Added force, N, or torque, Nm, at the tool.
    Wrench,
    /// Stiffness at the tool, N/m or Nm/rad, from 0.
    CartesianStiffness,
    /// Normalised damping at the tool, 0..=1.
    CartesianDamping,
}

/// Components at the tool in the order of the datagram.
const COMPONENTS: [&str; 6] = ["X", "Y", "Z", "about Z", "about Y", "about X"];

impl Parameter {
    /// All fields, in the order of their numbers.
    pub const ALL: [Self; 6] = [
        Self::JointTorque,
        Self::JointStiffness,
        Self::JointDamping,
        Self::Wrench,
        Self::CartesianStiffness,
        Self::CartesianDamping,
    ];

    /// The flag that declares the field valid.
    pub(super) const fn flag(self) -> CmdFlags {
        match self {
            Self::JointTorque => CmdFlags::JNTTRQ,
            Self::JointStiffness => CmdFlags::JNTSTIFF,
            Self::JointDamping => CmdFlags::JNTDAMP,
            Self::Wrench => CmdFlags::TCPFT,
            Self::CartesianStiffness => CmdFlags::CARTSTIFF,
            Self::CartesianDamping => CmdFlags::CARTDAMP,
        }
    }

    /// Values of the field in a command: 7 joints or 6 components.
    pub(super) const fn values(self, cmd: &Cmd) -> &[f32] {
        match self {
            Self::JointTorque => &cmd.joint_torque,
            Self::JointStiffness => &cmd.joint_stiffness,
            Self::JointDamping => &cmd.joint_damping,
            Self::Wrench => &cmd.wrench,
            Self::CartesianStiffness => &cmd.cartesian_stiffness,
            Self::CartesianDamping => &cmd.cartesian_damping,
        }
    }

    /// Lowest and highest value; infinite values are rejected in any case. `torque_max` is the joint's, Nm.
    pub(super) fn range(self, torque_max: Option<f64>) -> [f64; 2] {
        match self {
            Self::JointTorque => {
                let most = torque_max.unwrap_or(f64::INFINITY);
                [-most, most]
            }
            Self::JointStiffness | Self::CartesianStiffness => [0.0, f64::INFINITY],
            Self::JointDamping | Self::CartesianDamping => [0.0, 1.0],
            Self::Wrench => [f64::NEG_INFINITY, f64::INFINITY],
        }
    }

    /// Name of the joint or component at `index`.
    pub(super) fn component_name(self, index: usize) -> &'static str {
        let names: &[&str] = match self {
            Self::JointTorque | Self::JointStiffness | Self::JointDamping => &JOINT_NAMES,
            Self::Wrench | Self::CartesianStiffness | Self::CartesianDamping => &COMPONENTS,
        };
        names.get(index).copied().unwrap_or("?")
    }

    /// The range in words.
    pub(super) const fn bounds(self) -> &'static str {
        match self {
            Self::JointTorque => "(Nm, a number within the joint's torque)",
            Self::JointStiffness | Self::CartesianStiffness => "(a number from 0)",
            Self::JointDamping | Self::CartesianDamping => "(0 to 1)",
            Self::Wrench => "(a number)",
        }
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::JointTorque => "an added torque of",
            Self::JointStiffness | Self::CartesianStiffness => "stiffness",
            Self::JointDamping | Self::CartesianDamping => "damping",
            Self::Wrench => "an added force or torque of",
        })
    }
}

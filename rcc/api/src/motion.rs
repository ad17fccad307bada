//! Motions of an arm as nets. Every net begins in the state that was commanded in the cycle before, at rest or in motion:
//! one net serves as a fresh start, as successor of a motion that ended, and as successor of one that still moves.
//!
//! The speed of a motion scales its time: at 0.5 velocities are halved, accelerations quartered, jerks divided by eight.

mod path;

use std::time::Duration;

use crate::engine::Failure;
use crate::error::Error;
use crate::net::{Net, Port};
pub(crate) use path::{ArmMotion, Path};

/// Limits of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// Smallest position, rad.
    pub position_min: f64,
    /// Largest position, rad.
    pub position_max: f64,
    /// Largest speed, rad/s.
    pub velocity: f64,
    /// Largest acceleration, rad/s².
    pub acceleration: f64,
    /// Largest jerk of motions, rad/s³.
    pub jerk: f64,
}

/// Limits of motions of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CartesianLimits {
    /// Speed of the position, m/s.
    pub velocity: f64,
    /// Its acceleration, m/s².
    pub acceleration: f64,
    /// Its jerk, m/s³.
    pub jerk: f64,
    /// Speed of the orientation, rad/s.
    pub rot_velocity: f64,
    /// Its acceleration, rad/s².
    pub rot_acceleration: f64,
    /// Its jerk, rad/s³.
    pub rot_jerk: f64,
}

impl Default for CartesianLimits {
    /// The speed of manual operation (ISO 10218-1: at most 0.25 m/s), reached in a quarter of a second.
    fn default() -> Self {
        Self {
            velocity: 0.25,
            acceleration: 1.0,
            jerk: 10.0,
            rot_velocity: 0.5,
            rot_acceleration: 2.5,
            rot_jerk: 25.0,
        }
    }
}

/// An arm as its controller describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmDescription {
    /// Its name.
    pub name: String,
    /// Its type, such as `kuka_lwr_fri`.
    pub kind: String,
    /// Its joints, from the base.
    pub joints: Vec<JointLimits>,
    /// Period of the nets that command it.
    pub period: Duration,
}

impl ArmDescription {
    /// A net that reads a port of all joints, as `outq0` and so on.
    pub(crate) fn reader(&self, port: &str) -> String {
        let mut net = Net::default();
        for axis in 0..self.joints.len() {
            let monitor = [("Robot", self.name.as_str().into()), ("Axis", axis.into())];
            let value = net.add("RobotArm::JointMonitor", monitor).out(port);
            let key = format!("q{axis}");
            net.add(
                "Core::DoubleNetcommOut",
                [("inValue", (&value).into()), ("Key", key.into())],
            );
        }
        net.finish_once()
    }

    /// A net that reads the measured pose of the flange, as `outpose`.
    pub(crate) fn pose_reader(&self) -> String {
        let mut net = Net::default();
        let joints = self.joint_array(&mut net, "outMeasuredPosition");
        let kin = [
            ("inJoints", (&joints).into()),
            ("Robot", self.name.as_str().into()),
        ];
        let pose = net.add("ArmKinematics::Kin", kin).out("outFrame");
        net.add(
            "World::FrameNetcommOut",
            [("inValue", (&pose).into()), ("Key", "pose".into())],
        );
        net.finish_once()
    }

    /// A port of all joints, as an array.
    pub(crate) fn joint_array(&self, net: &mut Net, port: &str) -> Port {
        let size = self.joints.len();
        let empty = net
            .add("Core::DoubleArray", [("Size", size.into())])
            .out("outArray");
        (0..size).fold(empty, |array, axis| {
            let monitor = [("Robot", self.name.as_str().into()), ("Axis", axis.into())];
            let value = net.add("RobotArm::JointMonitor", monitor).out(port);
            let element = [
                ("inArray", (&array).into()),
                ("inValue", (&value).into()),
                ("Size", size.into()),
                ("Index", axis.into()),
            ];
            net.add("Core::DoubleArraySet", element).out("outArray")
        })
    }

    /// Checks joint positions, rad.
    pub(crate) fn check_joints(&self, to: &[f64]) -> Result<(), Error> {
        let (name, joints) = (&self.name, &self.joints);
        if to.len() != joints.len() {
            let text = format!("{name} has {} joints, not {}", joints.len(), to.len());
            return Err(Error::Invalid(text));
        }
        for (number, (to, limits)) in to.iter().zip(joints).enumerate() {
            let (min, max) = (limits.position_min, limits.position_max);
            if !(min..=max).contains(to) {
                return Err(Error::Limit {
                    joint: format!("{name} joint {number}"),
                    value: *to,
                    min,
                    max,
                });
            }
        }
        Ok(())
    }

    /// Commands the joints; returns what makes the motion fail.
    pub(crate) fn command(&self, net: &mut Net, joints: &Port) -> Vec<(Failure, Port)> {
        let size = self.joints.len();
        let kinds = [
            ("outErrorJointFailed", Failure::joints_failed(&self.name)),
            ("outErrorIllegalPosition", Failure::out_of_range(&self.name)),
            ("outErrorConcurrentAccess", Failure::conflict(&self.name)),
        ];
        let mut axes = Vec::new();
        for axis in 0..size {
            let element = [
                ("inArray", joints.into()),
                ("Size", size.into()),
                ("Index", axis.into()),
            ];
            let position = net.add("Core::DoubleArrayGet", element).out("outValue");
            let command = [
                ("inPosition", (&position).into()),
                ("Robot", self.name.as_str().into()),
                ("Axis", axis.into()),
            ];
            axes.push(net.add("RobotArm::JointPosition", command));
        }
        let any = |(port, failure): (&str, Failure)| {
            let ports: Vec<_> = axes.iter().map(|axis| axis.out(port)).collect();
            Some((failure, net.any(&ports)?))
        };
        kinds.into_iter().filter_map(any).collect()
    }
}

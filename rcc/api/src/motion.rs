//! Motions of an arm as nets. Every net begins in the state that was commanded in the cycle before, at rest or in motion:
//! one net serves as a fresh start, as successor of a motion that ended, and as successor of one that still moves.
//!
//! The speed of a motion scales its time: at 0.5 velocities are halved, accelerations quartered, jerks divided by eight.

mod centre;
mod coupled;
mod follow;
mod frame;
mod hold;
mod jog;
mod path;
mod press;
mod stream;
#[cfg(test)]
mod tests;
mod trajectory;

use std::sync::Arc;
use std::time::Duration;

use takt_motion::plan::{Bounds, FrameBounds};
use takt_motion::{Model, URDF};
use takt_net::device::Kinematics;

use crate::engine::Failure;
use crate::error::ErrorKind;
use crate::net::{Argument, Net, Port, Primitive, array};
use crate::plan::joint_bounds;
use crate::pose::Pose;
pub(crate) use centre::Centre;
pub(crate) use coupled::{CoupledMotion, Holder};
pub(crate) use follow::Follow;
pub(crate) use frame::{Route, centre_of};
pub(crate) use hold::Hold;
pub(crate) use jog::Jog;
pub(crate) use path::{ArmMotion, Path};
pub use press::ForceLimits;
pub(crate) use press::{Along, Press};
pub(crate) use stream::{Goals, Stream};
pub(crate) use trajectory::Along as AlongTrajectory;
pub use trajectory::JointTrajectory;

/// Joint positions that differ by more, rad, are different places.
pub(crate) const ELSEWHERE: f64 = 2e-3;

/// A joint that is slower, rad/s, is at rest.
const AT_REST: f64 = 1e-3;

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

impl JointLimits {
    /// Zero, or the middle of the range if that excludes zero, rad.
    pub(crate) fn rest(&self) -> f64 {
        let (min, max) = (self.position_min, self.position_max);
        if (min..=max).contains(&0.0) {
            0.0
        } else {
            f64::midpoint(min, max)
        }
    }
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

impl CartesianLimits {
    /// The longest time that braking from a part of the speed takes, s.
    pub(crate) fn braking_s(&self, speed: f64) -> f64 {
        let FrameBounds {
            translation,
            rotation,
        } = self.bounds();
        let time = |it: Bounds| {
            let velocity = it.velocity * speed;
            if velocity * it.jerk < it.acceleration * it.acceleration {
                // The acceleration is not reached.
                return 2.0 * (velocity / it.jerk).sqrt();
            }
            velocity / it.acceleration + it.acceleration / it.jerk
        };
        f64::max(time(translation), time(rotation))
    }

    /// The limits as those of plans.
    pub(crate) const fn bounds(&self) -> FrameBounds {
        FrameBounds {
            translation: Bounds {
                velocity: self.velocity,
                acceleration: self.acceleration,
                jerk: self.jerk,
            },
            rotation: Bounds {
                velocity: self.rot_velocity,
                acceleration: self.rot_acceleration,
                jerk: self.rot_jerk,
            },
        }
    }

    /// Parameters of the primitives that move frames.
    fn arguments(&self, speed: f64) -> [(&'static str, Argument); 7] {
        [
            ("Velocity", self.velocity.into()),
            ("Acceleration", self.acceleration.into()),
            ("Jerk", self.jerk.into()),
            ("RotVelocity", self.rot_velocity.into()),
            ("RotAcceleration", self.rot_acceleration.into()),
            ("RotJerk", self.rot_jerk.into()),
            ("Speed", speed.into()),
        ]
    }

    fn check(&self, name: &str) -> Result<(), ErrorKind> {
        let limits = [
            ("velocity", self.velocity),
            ("acceleration", self.acceleration),
            ("jerk", self.jerk),
            ("rot_velocity", self.rot_velocity),
            ("rot_acceleration", self.rot_acceleration),
            ("rot_jerk", self.rot_jerk),
        ];
        let wrong = limits
            .iter()
            .find(|(_, limit)| !(*limit > 0.0 && limit.is_finite()));
        wrong.map_or(Ok(()), |(limit, value)| {
            let text = format!(
                "{name}: the limit `{limit}` is {value}; it is above 0\nhint: limits are in m, rad and s"
            );
            Err(ErrorKind::Invalid(text))
        })
    }
}

/// An arm as its controller describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmDescription {
    /// Its name.
    pub name: String,
    /// Its type, such as `kuka_lwr_fri`.
    pub kind: String,
    /// Model of its kinematics, such as `kuka_lwr4` or the chain of a URDF; empty if it is not described.
    pub model: Model,
    /// Its joints, from the base.
    pub joints: Vec<JointLimits>,
    /// Its joint positions at home, rad: those of its cell file, else 0, and the middle of its range for a joint that cannot be
    /// at 0.
    pub home: Vec<f64>,
    /// Period of the nets that command it.
    pub period: Duration,
    /// Names of its interfaces, such as `wrench` and `cartesianimpedance`.
    pub interfaces: Vec<String>,
}

/// Whether two numbers differ by more than that.
fn is_further(net: &mut Net, [from, to]: &[Port; 2], most: f64) -> Port {
    let distance = net.of_two("Core::DoubleSubtract", to, from);
    let distance = net.of("Core::DoubleAbs", &distance);
    let greater = [("inFirst", (&distance).into()), ("Second", most.into())];
    net.add("Core::DoubleGreater", greater).out("outValue")
}

impl ArmDescription {
    /// Checks that it has an interface; `wanted` says in errors what that is.
    pub(crate) fn needs(&self, interface: &str, wanted: &'static str) -> Result<(), ErrorKind> {
        if self.interfaces.iter().any(|mine| mine == interface) {
            return Ok(());
        }
        Err(ErrorKind::Unsupported {
            device: self.name.clone(),
            wanted,
            cause: format!("arms of type `{}` do not have it", self.kind),
        })
    }

    /// A net that reads ports of all joints, of the first one as `outq0` and so on, of the second one as `outv0`.
    pub(crate) fn reader(&self, ports: &[&str]) -> String {
        let mut net = Net::default();
        for axis in 0..self.joints.len() {
            for (port, letter) in ports.iter().zip(["q", "v"]) {
                let monitor = [("Robot", self.name.as_str().into()), ("Axis", axis.into())];
                let value = net.add("RobotArm::JointMonitor", monitor).out(port);
                let key = format!("{letter}{axis}");
                net.add(
                    "Core::DoubleNetcommOut",
                    [("inValue", (&value).into()), ("Key", key.into())],
                );
            }
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
        let empty = net.doubles(size);
        (0..size).fold(empty, |array, axis| {
            let monitor = [("Robot", self.name.as_str().into()), ("Axis", axis.into())];
            let value = net.add("RobotArm::JointMonitor", monitor).out(port);
            net.with_element(&array, &value, size, axis)
        })
    }

    /// Its kinematics, if the program knows their model.
    pub(crate) fn kinematics(&self) -> Option<Arc<dyn Kinematics>> {
        self.model.limited(&self.limits())
    }

    /// The pose of its flange in its base at joint positions, rad.
    pub(crate) fn pose(&self, joints: &[f64]) -> Option<Pose> {
        Some(self.kinematics()?.forward(joints).into())
    }

    /// Limits of its joints for checks of plans.
    pub(crate) fn limits(&self) -> Vec<takt_net::JointLimits> {
        let limits = |joint: &JointLimits| takt_net::JointLimits {
            position_min: joint.position_min,
            position_max: joint.position_max,
            velocity_max: joint.velocity,
            acceleration_max: joint.acceleration,
        };
        self.joints.iter().map(limits).collect()
    }

    /// Velocity, acceleration and jerk of each joint, as arrays.
    pub(crate) fn limit_texts(&self) -> [String; 3] {
        let joints = self.joints.iter();
        let bounds: Vec<_> = joints.map(|joint| joint_bounds(joint, 1.0)).collect();
        let of = |limit: &dyn Fn(&Bounds) -> f64| {
            let limits: Vec<_> = bounds.iter().map(limit).collect();
            array(&limits)
        };
        [
            of(&|joint| joint.velocity),
            of(&|joint| joint.acceleration),
            of(&|joint| joint.jerk),
        ]
    }

    /// Nothing is known about where the arm begins.
    pub(crate) fn no_start(&self) -> ErrorKind {
        let cause = "it is not known where the arm begins: its positions are not known, or the activity before it ends \
                     anywhere\nhint: begin it when the arm is at rest";
        ErrorKind::Unplanned {
            device: self.name.clone(),
            cause: cause.to_owned(),
        }
    }

    /// The program does not know the kinematics of the arm.
    pub(crate) fn no_model(&self) -> ErrorKind {
        let cause = if self.model.is_empty() {
            "the controller describes no kinematics of this arm".to_owned()
        } else if self.model.name().starts_with(URDF) {
            format!(
                "this program cannot read the chain of joints that the controller describes as `{}`\nhint: use the version of \
                 Takt that the controller has",
                self.model
            )
        } else {
            format!(
                "the model `{}` of its kinematics is not known here",
                self.model
            )
        };
        ErrorKind::Unplanned {
            device: self.name.clone(),
            cause,
        }
    }

    /// Checks joint positions, rad.
    pub(crate) fn check_joints(&self, to: &[f64]) -> Result<(), ErrorKind> {
        let (name, joints) = (&self.name, &self.joints);
        if to.len() != joints.len() {
            let text = format!(
                "{name} has {} joints, not {}\nhint: one position for each joint, from the base",
                joints.len(),
                to.len()
            );
            return Err(ErrorKind::Invalid(text));
        }
        for (number, (to, limits)) in to.iter().zip(joints).enumerate() {
            let (min, max) = (limits.position_min, limits.position_max);
            if !(min..=max).contains(to) {
                return Err(ErrorKind::Limit {
                    joint: format!("{name} joint {number}"),
                    value: *to,
                    min,
                    max,
                });
            }
        }
        Ok(())
    }

    /// Whether a joint is further from another position than it moves in a time, s, at a part of its velocity limit;
    /// `None` without joints.
    pub(crate) fn any_further(
        &self,
        net: &mut Net,
        [from, to]: [&Port; 2],
        (time_s, part): (f64, f64),
    ) -> Option<Port> {
        let mut further = Vec::new();
        for (axis, limits) in self.joints.iter().enumerate() {
            let ends = [from, to].map(|joints| self.joint_of(net, joints, axis));
            further.push(is_further(net, &ends, limits.velocity * part * time_s));
        }
        net.any(&further)
    }

    /// Whether a joint moves further in a cycle than at a part of its largest speed. The cycle before is that of the net: where
    /// the thread skipped cycles, what the driver reports has gone on.
    pub(crate) fn any_faster(&self, net: &mut Net, joints: &Port, part: f64) -> Option<Port> {
        let period_s = self.period.as_secs_f64();
        let mut faster = Vec::new();
        for (axis, limits) in self.joints.iter().enumerate() {
            let monitor = [("Robot", self.name.as_str().into()), ("Axis", axis.into())];
            let monitor = net.add("RobotArm::JointMonitor", monitor);
            let begin = monitor.out("outCommandedPosition");
            let (later, before) = net.state("Core::Double", &begin);
            let now = self.joint_of(net, joints, axis);
            net.close(&later, &now);
            let limit = limits.velocity * part * period_s;
            faster.push(is_further(net, &[before, now], limit));
        }
        net.any(&faster)
    }

    /// Whether the arm is at rest in the first cycle, and elsewhere than at these joint positions, rad; `None` without
    /// joints.
    pub(crate) fn is_elsewhere(&self, net: &mut Net, expected: &[f64]) -> Option<Port> {
        let mut away = Vec::new();
        let mut moving = Vec::new();
        for (axis, expected) in expected.iter().enumerate() {
            let monitor = [("Robot", self.name.as_str().into()), ("Axis", axis.into())];
            let monitor = net.add("RobotArm::JointMonitor", monitor);
            let expected = [("Value", (*expected).into())];
            let expected = net.add("Core::DoubleValue", expected).out("outValue");
            let position = monitor.out("outCommandedPosition");
            let distance = net.of_two("Core::DoubleSubtract", &position, &expected);
            away.push(net.is_beyond(&distance, ELSEWHERE));
            moving.push(net.is_beyond(&monitor.out("outCommandedVelocity"), AT_REST));
        }
        let (away, moving) = (net.any(&away)?, net.any(&moving)?);
        let rests = net.of("Core::BooleanNot", &moving);
        let first = net.first_cycle();
        let rests = net.of_two("Core::BooleanAnd", &first, &rests);
        Some(net.of_two("Core::BooleanAnd", &rests, &away))
    }

    /// A joint of an array.
    pub(crate) fn joint_of(&self, net: &mut Net, joints: &Port, axis: usize) -> Port {
        let element = [
            ("inArray", joints.into()),
            ("Size", self.joints.len().into()),
            ("Index", axis.into()),
        ];
        net.add("Core::DoubleArrayGet", element).out("outValue")
    }

    /// A motion of each joint to its goal, from the state that is commanded, at rest or in motion.
    pub(crate) fn track(&self, net: &mut Net, goal: &Port, stop: &Port, speed: f64) -> Primitive {
        let positions = self.joint_array(net, "outCommandedPosition");
        let velocities = self.joint_array(net, "outCommandedVelocity");
        let accelerations = self.joint_array(net, "outCommandedAcceleration");
        let [velocity, acceleration, jerk] = self.limit_texts();
        let over = net.override_in();
        net.add(
            "Motion::Track",
            [
                ("inGoal", goal.into()),
                ("inStop", stop.into()),
                ("inOverride", (&over).into()),
                ("inFrom", (&positions).into()),
                ("inFromVelocity", (&velocities).into()),
                ("inFromAcceleration", (&accelerations).into()),
                ("Velocity", velocity.into()),
                ("Acceleration", acceleration.into()),
                ("Jerk", jerk.into()),
                ("Speed", speed.into()),
            ],
        )
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
            let position = self.joint_of(net, joints, axis);
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

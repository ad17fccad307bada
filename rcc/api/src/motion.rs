//! Motions of an arm as nets. Every net begins in the state that was commanded in the cycle before, at rest or in motion:
//! one net serves as a fresh start, as successor of a motion that ended, and as successor of one that still moves.
//!
//! The speed of a motion scales its time: at 0.5 velocities are halved, accelerations quartered, jerks divided by eight.

use std::time::Duration;

use crate::error::Error;
use crate::expression::Condition;
use crate::net::{Net, Port, array};
use crate::pose::Pose;

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

/// Where an arm is to move, and on which path.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// To joint positions (rad), all joints together; the path of the flange follows from that.
    Ptp(Vec<f64>),
    /// The flange along a straight line to a pose in the base of the arm.
    Lin(Pose),
    /// The flange along the arc through `via` to `to`.
    Circ {
        /// A point on the arc; its orientation is not used.
        via: Pose,
        /// The end.
        to: Pose,
    },
}

/// A motion with everything that is needed to write its net.
#[derive(Clone, Debug, PartialEq)]
pub struct Order {
    /// The arm.
    pub arm: ArmDescription,
    /// Where it is to move.
    pub motion: Motion,
    /// Limits of the frame on lines and arcs.
    pub limits: CartesianLimits,
    /// Speed as part of the limits, above 0 to 1.
    pub speed: f64,
    /// Progress (part of the path, 0 to 1) from which a successor may take over.
    pub blend: Option<f64>,
    /// Conditions that stop the motion on its path, by name; the first that holds decides.
    pub until: Vec<(String, Condition)>,
}

/// Most conditions that stop one motion.
const UNTIL_MAX: usize = 32;

impl Order {
    /// Checks all that can be checked without the controller.
    ///
    /// # Errors
    /// [`Error::Invalid`], which names the argument, its value and its bounds.
    pub fn check(&self) -> Result<(), Error> {
        let name = &self.arm.name;
        let invalid = |what: String| Err(Error::Invalid(format!("{name}: {what}")));
        match &self.motion {
            Motion::Ptp(to) => self.check_joints(to)?,
            Motion::Lin(to) if !to.is_finite() => return invalid("the pose is not finite".into()),
            Motion::Circ { via, to } if !(via.is_finite() && to.is_finite()) => {
                return invalid("a pose of the arc is not finite".into());
            }
            Motion::Lin(_) | Motion::Circ { .. } => {}
        }
        if !(self.speed > 0.0 && self.speed <= 1.0) {
            return invalid(format!(
                "the speed is {}; it is above 0, at most 1",
                self.speed
            ));
        }
        if let Some(blend) = self.blend.filter(|blend| !(0.0..1.0).contains(blend)) {
            return invalid(format!("blend is {blend}; it is from 0 to below 1"));
        }
        if self.until.len() > UNTIL_MAX {
            return invalid(format!(
                "{} conditions; at most {UNTIL_MAX}",
                self.until.len()
            ));
        }
        for (number, (until, _)) in self.until.iter().enumerate() {
            let is_name = !until.is_empty()
                && until
                    .bytes()
                    .all(|b| b.is_ascii_alphanumeric() || b == b'_');
            if !is_name {
                return invalid(format!(
                    "`{until}` is no name of a condition: letters, digits and `_`"
                ));
            }
            let before = self.until.get(..number).unwrap_or_default();
            if before.iter().any(|(other, _)| other == until) {
                return invalid(format!("two conditions are called `{until}`"));
            }
        }
        Ok(())
    }

    fn check_joints(&self, to: &[f64]) -> Result<(), Error> {
        let (name, joints) = (&self.arm.name, &self.arm.joints);
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

    /// The names of the results that a successor may follow.
    pub(crate) fn results(&self) -> Vec<String> {
        let until = self.until.iter().map(|(name, _)| until_key(name));
        let blend = self.blend.map(|_| "blend".to_owned());
        std::iter::once("completed".to_owned())
            .chain(blend)
            .chain(until)
            .collect()
    }

    /// The text of its net.
    pub(crate) fn net(&self) -> String {
        let mut net = Net::default();
        let cancel = net.add("Cancel", []).out("outCancel");
        let met: Vec<_> = self
            .until
            .iter()
            .map(|(_, condition)| latched(&mut net, condition))
            .collect();
        let stops: Vec<_> = std::iter::once(cancel.clone()).chain(met.clone()).collect();
        let stop = net.any(&stops).unwrap_or_else(|| cancel.clone());
        let path = self.path(&mut net, &stop);
        let failed = self.command(&mut net, &path.joints);
        let mut failures = failed;
        if let Some(unreachable) = &path.unreachable {
            net.result("unreachable", unreachable);
            failures.push(unreachable.clone());
        }
        let going = net.of("Core::BooleanNot", &stop);
        let ended = net.of_two("Core::BooleanAnd", &path.done, &going);
        net.result("completed", &ended);
        let cancelled = net.of_two("Core::BooleanAnd", &path.done, &cancel);
        net.result("cancelled", &cancelled);
        self.report_conditions(&mut net, &path.done, &cancel, &met);
        net.add(
            "Core::DoubleNetcommOut",
            [
                ("inValue", (&path.progress).into()),
                ("Key", "progress".into()),
            ],
        );
        if let Some(blend) = self.blend {
            let far = [
                ("inFirst", (&path.progress).into()),
                ("Second", blend.into()),
            ];
            let far = net.add("Core::DoubleGreater", far).out("outValue");
            let moving = net.of("Core::BooleanNot", &path.done);
            let open = net.of_two("Core::BooleanAnd", &moving, &going);
            let may = net.of_two("Core::BooleanAnd", &far, &open);
            net.result("blend", &may);
        }
        failures.push(path.done);
        let end = net.any(&failures).unwrap_or(cancel);
        net.finish(&end)
    }

    /// One result for each condition that stops the motion; the first in order wins, and a cancel before all.
    fn report_conditions(&self, net: &mut Net, done: &Port, cancel: &Port, met: &[Port]) {
        let mut before = cancel.clone();
        for ((name, _), met) in self.until.iter().zip(met) {
            let first = net.of("Core::BooleanNot", &before);
            let at_rest = net.of_two("Core::BooleanAnd", done, met);
            let decides = net.of_two("Core::BooleanAnd", &at_rest, &first);
            net.result(&until_key(name), &decides);
            before = net.of_two("Core::BooleanOr", &before, met);
        }
    }

    fn path(&self, net: &mut Net, stop: &Port) -> Path {
        let arm = &self.arm;
        let positions = arm.joint_array(net, "outCommandedPosition");
        let velocities = arm.joint_array(net, "outCommandedVelocity");
        let over = [("Key", "override".into()), ("Value", 1.0.into())];
        let over = net.add("Core::DoubleNetcommIn", over).out("outValue");
        if let Motion::Ptp(to) = &self.motion {
            let accelerations = arm.joint_array(net, "outCommandedAcceleration");
            let [velocity, acceleration, jerk] = self.joint_limits();
            let ptp = net.add(
                "Motion::Ptp",
                [
                    ("inStop", stop.into()),
                    ("inOverride", (&over).into()),
                    ("inFrom", (&positions).into()),
                    ("inFromVelocity", (&velocities).into()),
                    ("inFromAcceleration", (&accelerations).into()),
                    ("To", array(to).into()),
                    ("Velocity", velocity.into()),
                    ("Acceleration", acceleration.into()),
                    ("Jerk", jerk.into()),
                ],
            );
            return Path {
                joints: ptp.out("outPosition"),
                progress: ptp.out("outProgress"),
                done: ptp.out("outDone"),
                unreachable: None,
            };
        }
        let robot = || ("Robot", arm.name.as_str().into());
        let from = net.add(
            "ArmKinematics::Kin",
            [("inJoints", (&positions).into()), robot()],
        );
        let twist = [
            ("inJoints", (&positions).into()),
            ("inVelocities", (&velocities).into()),
            robot(),
        ];
        let twist = net.add("ArmKinematics::VelKin", twist).out("outTwist");
        let motion = self.frame_motion(net, [stop, &over], &from.out("outFrame"), &twist);
        let inverse = net.add(
            "ArmKinematics::InvKin",
            [
                ("inFrame", (&motion.out("outPosition")).into()),
                ("inHintJoints", (&positions).into()),
                robot(),
            ],
        );
        let joints = inverse.out("outJoints");
        let none = net.of("Core::DoubleArrayIsNull", &joints);
        let moves = net.of("World::FrameIsNull", &motion.out("outPosition"));
        let moves = net.of("Core::BooleanNot", &moves);
        Path {
            unreachable: Some(net.of_two("Core::BooleanAnd", &none, &moves)),
            joints,
            progress: motion.out("outProgress"),
            done: motion.out("outDone"),
        }
    }

    /// The primitive that moves the frame.
    fn frame_motion(
        &self,
        net: &mut Net,
        [stop, over]: [&Port; 2],
        from: &Port,
        twist: &Port,
    ) -> crate::net::Primitive {
        let f = self.speed;
        let limits = &self.limits;
        let (kind, via, to) = match &self.motion {
            Motion::Circ { via, to } => ("Motion::Circ", ("Via", via.text().into()), to),
            // Without its own start, a line begins where the frame is.
            Motion::Lin(to) => ("Motion::Lin", ("Join", "0".into()), to),
            Motion::Ptp(_) => (
                "Motion::Lin",
                ("Join", "0".into()),
                &Pose::xyz(0.0, 0.0, 0.0),
            ),
        };
        net.add(
            kind,
            [
                ("inStop", stop.into()),
                ("inOverride", over.into()),
                ("inFrom", from.into()),
                ("inFromVelocity", twist.into()),
                via,
                ("To", to.text().into()),
                ("Velocity", (limits.velocity * f).into()),
                ("Acceleration", (limits.acceleration * f * f).into()),
                ("Jerk", (limits.jerk * f * f * f).into()),
                ("RotVelocity", (limits.rot_velocity * f).into()),
                ("RotAcceleration", (limits.rot_acceleration * f * f).into()),
                ("RotJerk", (limits.rot_jerk * f * f * f).into()),
            ],
        )
    }

    /// Velocity, acceleration and jerk of each joint at the speed of this motion, as arrays.
    fn joint_limits(&self) -> [String; 3] {
        let f = self.speed;
        let of = |limit: &dyn Fn(&JointLimits) -> f64| {
            let limits: Vec<_> = self.arm.joints.iter().map(limit).collect();
            array(&limits)
        };
        [
            of(&|joint| joint.velocity * f),
            of(&|joint| joint.acceleration * f * f),
            of(&|joint| joint.jerk * f * f * f),
        ]
    }

    /// Commands the joints; returns what makes the motion fail.
    fn command(&self, net: &mut Net, joints: &Port) -> Vec<Port> {
        let size = self.arm.joints.len();
        let errors = [
            "outErrorJointFailed",
            "outErrorIllegalPosition",
            "outErrorConcurrentAccess",
        ];
        let mut ports = [Vec::new(), Vec::new(), Vec::new()];
        for axis in 0..size {
            let element = [
                ("inArray", joints.into()),
                ("Size", size.into()),
                ("Index", axis.into()),
            ];
            let position = net.add("Core::DoubleArrayGet", element).out("outValue");
            let command = [
                ("inPosition", (&position).into()),
                ("Robot", self.arm.name.as_str().into()),
                ("Axis", axis.into()),
            ];
            let joint = net.add("RobotArm::JointPosition", command);
            for (ports, error) in ports.iter_mut().zip(errors) {
                ports.push(joint.out(error));
            }
        }
        let keys = ["failed", "illegal", "concurrent"];
        let any = keys.iter().zip(&ports).filter_map(|(key, ports)| {
            let any = net.any(ports)?;
            net.result(key, &any);
            Some(any)
        });
        any.collect()
    }
}

/// Ports of a motion's path.
struct Path {
    joints: Port,
    progress: Port,
    done: Port,
    /// Whether the frame is out of reach; joint motions have none.
    unreachable: Option<Port>,
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
    fn joint_array(&self, net: &mut Net, port: &str) -> Port {
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
}

/// Whether a condition has held; null counts as false.
fn latched(net: &mut Net, condition: &Condition) -> Port {
    let value = condition.write(net);
    let unknown = net.of("Core::BooleanIsNull", &value);
    let known = [
        ("inCondition", (&unknown).into()),
        ("inFalse", (&value).into()),
    ];
    let known = net.add("Core::BooleanConditional", known).out("outValue");
    net.add("Core::Trigger", [("inOn", (&known).into())])
        .out("outActive")
}

/// The key of the result of a condition.
pub(crate) fn until_key(name: &str) -> String {
    format!("until_{name}")
}

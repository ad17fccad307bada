//! The motions of one arm as nets: joints together, or the flange along a path.

use super::{ArmDescription, CartesianLimits, JointLimits};
use crate::engine::Failure;
use crate::error::Error;
use crate::net::{Net, Port, Primitive, array};
use crate::order::{Operation, Ports, Requests};
use crate::pose::Pose;

/// Where an arm is to move, and on which path.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Path {
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

/// A motion of an arm with everything that is needed to write its net.
#[derive(Clone, Debug)]
pub(crate) struct ArmMotion {
    pub(crate) arm: ArmDescription,
    pub(crate) path: Path,
    /// Limits of the frame on lines and arcs.
    pub(crate) limits: CartesianLimits,
}

impl Operation for ArmMotion {
    fn devices(&self) -> Vec<String> {
        vec![self.arm.name.clone()]
    }

    fn check(&self) -> Result<(), Error> {
        let name = &self.arm.name;
        let invalid = |what: &str| Err(Error::Invalid(format!("{name}: {what}")));
        match &self.path {
            Path::Ptp(to) => self.arm.check_joints(to),
            Path::Lin(to) if !to.is_finite() => invalid("the pose is not finite"),
            Path::Circ { via, to } if !(via.is_finite() && to.is_finite()) => {
                invalid("a pose of the arc is not finite")
            }
            Path::Lin(_) | Path::Circ { .. } => Ok(()),
        }
    }

    fn write(&self, net: &mut Net, requests: &Requests) -> Ports {
        let course = self.course(net, requests);
        let mut failures = Vec::new();
        if let Some(unreachable) = course.unreachable {
            failures.push((Failure::unreachable(&self.arm.name), unreachable));
        }
        failures.extend(self.arm.command(net, &course.joints));
        Ports {
            done: course.done,
            progress: Some(course.progress),
            failures,
            results: Vec::new(),
        }
    }
}

/// Ports of a motion along its path.
struct Course {
    joints: Port,
    progress: Port,
    done: Port,
    /// Whether the frame is out of reach; joint motions have none.
    unreachable: Option<Port>,
}

impl ArmMotion {
    fn course(&self, net: &mut Net, requests: &Requests) -> Course {
        let stop = &requests.stop;
        let arm = &self.arm;
        let positions = arm.joint_array(net, "outCommandedPosition");
        let velocities = arm.joint_array(net, "outCommandedVelocity");
        let over = net.override_in();
        if let Path::Ptp(to) = &self.path {
            let accelerations = arm.joint_array(net, "outCommandedAcceleration");
            let [velocity, acceleration, jerk] = self.joint_limits(requests.speed);
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
            return Course {
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
        let motion = self.frame_motion(
            net,
            ([stop, &over], requests.speed),
            &from.out("outFrame"),
            &twist,
        );
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
        Course {
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
        ([stop, over], speed): ([&Port; 2], f64),
        from: &Port,
        twist: &Port,
    ) -> Primitive {
        let f = speed;
        let limits = &self.limits;
        let (kind, via, to) = match &self.path {
            Path::Circ { via, to } => ("Motion::Circ", ("Via", via.text().into()), to),
            // Without its own start, a line begins where the frame is.
            Path::Lin(to) => ("Motion::Lin", ("Join", "0".into()), to),
            Path::Ptp(_) => (
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
    fn joint_limits(&self, speed: f64) -> [String; 3] {
        let f = speed;
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
}

//! Jogging: the program writes the velocity of an arm while it moves, and the arm brakes when the program ceases to. Not
//! here: who holds a key or a switch.

use super::frame;
use super::{ArmDescription, CartesianLimits};
use crate::engine::Failure;
use crate::error::ErrorKind;
use crate::live::KEY;
use crate::net::{Net, Port, array};
use crate::order::{Operation, Ports, Requests};
use crate::pose::Pose;

/// How long a velocity is in effect after it arrived, s. An older one counts as zero.
const DEAD_MAN_S: f64 = 0.1;

/// Largest mean speed of a joint until the motion centre would be at rest, as part of its limit.
const SPEED_MAX: f64 = 0.8;

/// What of an arm moves at a velocity that a program writes.
#[derive(Clone, Debug)]
pub(crate) enum Jog {
    /// The motion centre, which is at `tool` in the flange, in the axes of the base.
    Centre {
        arm: ArmDescription,
        limits: CartesianLimits,
        tool: Pose,
    },
    /// Each joint.
    Joints { arm: ArmDescription },
}

/// What a jog writes of its motion.
struct Moved {
    joints: Port,
    is_at_rest: Port,
    failures: Vec<(Failure, Port)>,
}

impl Jog {
    const fn arm(&self) -> &ArmDescription {
        let (Self::Centre { arm, .. } | Self::Joints { arm }) = self;
        arm
    }

    /// Whether the velocity is to be zero: on request, or since the program has written none for a while.
    fn off(net: &mut Net, updated: &Port, stop: &Port) -> Port {
        let now = net.add("Core::TimeNet", []).out("outValue");
        let age = net.of_two("Core::TimeDiff", &now, updated);
        let old = [("inFirst", (&age).into()), ("Second", DEAD_MAN_S.into())];
        let old = net.add("Core::DoubleGreater", old).out("outValue");
        // The age is null until a program writes.
        let never = net.of("Core::BooleanIsNull", &old);
        let old = [
            ("inCondition", (&never).into()),
            ("True", "true".into()),
            ("inFalse", (&old).into()),
        ];
        let old = net.add("Core::BooleanConditional", old).out("outValue");
        net.of_two("Core::BooleanOr", stop, &old)
    }

    /// One joint: its position, and whether it rests.
    fn write_joint(
        net: &mut Net,
        arm: &ArmDescription,
        axis: usize,
        (wanted, off): (&Port, &Port),
    ) -> Option<[Port; 2]> {
        let limits = arm.joints.get(axis)?;
        let monitor = [("Robot", arm.name.as_str().into()), ("Axis", axis.into())];
        let monitor = net.add("RobotArm::JointMonitor", monitor);
        let (at_in, at) = net.state("Core::Double", &monitor.out("outCommandedPosition"));
        let (speed_in, speed) = net.state("Core::Double", &monitor.out("outCommandedVelocity"));
        let wanted = arm.joint_of(net, wanted, axis);
        let wanted = net.zero_if("Core::Double", off, &wanted);
        // At the velocity limit, a joint brakes in this way within its acceleration limit, and its range is not left.
        let rate = limits.acceleration / limits.velocity;
        let room = |net: &mut Net, end: f64| {
            let end = net.add("Core::DoubleValue", [("Value", end.into())]);
            let distance = net.of_two("Core::DoubleSubtract", &end.out("outValue"), &at);
            net.scaled(&distance, rate)
        };
        let (lowest, highest) = (
            room(net, limits.position_min),
            room(net, limits.position_max),
        );
        let wanted = net.clamped(&wanted, &lowest, &highest);
        let period = net.add("Core::CycleTime", []).out("outValue");
        let change = net.scaled(&period, limits.acceleration);
        let least = net.of_two("Core::DoubleSubtract", &speed, &change);
        let most = net.of_two("Core::DoubleAdd", &speed, &change);
        let next_speed = net.clamped(&wanted, &least, &most);
        let way = net.of_two("Core::DoubleMultiply", &next_speed, &period);
        let next = net.of_two("Core::DoubleAdd", &at, &way);
        net.close(&at_in, &next);
        net.close(&speed_in, &next_speed);
        let rests = net.of("Core::DoubleAbs", &next_speed);
        let rests = [("inFirst", (&rests).into()), ("Second", 0.0.into())];
        let moves = net.add("Core::DoubleGreater", rests).out("outValue");
        Some([next, moves])
    }

    fn write_joints(
        net: &mut Net,
        arm: &ArmDescription,
        requests: &Requests<'_>,
    ) -> Result<Moved, ErrorKind> {
        let zeros = array(&vec![0.0; arm.joints.len()]);
        let sent = [("Key", KEY.into()), ("Value", zeros.into())];
        let sent = net.add("Core::DoubleArrayNetcommIn", sent);
        let off = Self::off(net, &sent.out("outLastUpdated"), &requests.stop);
        let over = net.override_in();
        let size = arm.joints.len();
        let mut wanted = net.doubles(size);
        for (axis, limits) in arm.joints.iter().enumerate() {
            let value = arm.joint_of(net, &sent.out("outValue"), axis);
            let value = net.of_two("Core::DoubleMultiply", &value, &over);
            let most = limits.velocity * requests.speed;
            let bounds = [
                ("inValue", (&value).into()),
                ("Min", (-most).into()),
                ("Max", most.into()),
            ];
            let value = net.add("Core::DoubleClamp", bounds).out("outValue");
            wanted = net.with_element(&wanted, &value, size, axis);
        }
        let mut joints = net.doubles(size);
        let mut moving = Vec::new();
        for axis in 0..size {
            let Some([position, moves]) = Self::write_joint(net, arm, axis, (&wanted, &off)) else {
                continue;
            };
            joints = net.with_element(&joints, &position, size, axis);
            moving.push(moves);
        }
        let moves = net.any(&moving).ok_or_else(|| arm.no_start())?;
        Ok(Moved {
            joints,
            is_at_rest: net.of("Core::BooleanNot", &moves),
            failures: Vec::new(),
        })
    }

    /// The next velocity of a position or an orientation.
    fn approach(
        net: &mut Net,
        (now, wanted, off): (&Port, &Port, &Port),
        (over, [velocity, acceleration]): (&Port, [f64; 2]),
    ) -> Port {
        let wanted = [("inValue", wanted.into()), ("inFactor", over.into())];
        let wanted = net.add("World::VectorScale", wanted).out("outValue");
        let wanted = [("inValue", (&wanted).into()), ("Max", velocity.into())];
        let wanted = net.add("World::VectorClamp", wanted).out("outValue");
        let wanted = net.zero_if("World::Vector", off, &wanted);
        let change = net.of_two("World::VectorSubtract", &wanted, now);
        let period = net.add("Core::CycleTime", []).out("outValue");
        let most = net.scaled(&period, acceleration);
        let change = [("inValue", (&change).into()), ("inMax", (&most).into())];
        let change = net.add("World::VectorClamp", change).out("outValue");
        // The last change is the whole difference, so that zero is exact.
        net.of_two("World::VectorAdd", now, &change)
    }

    /// Whether one of several velocities is not zero.
    fn any_moves(net: &mut Net, speeds: &[Port]) -> Option<Port> {
        let moving = speeds.iter().map(|speed| {
            let length = [("inValue", speed.into())];
            let length = net.add("World::VectorLength", length).out("outValue");
            let greater = [("inFirst", (&length).into()), ("Second", 0.0.into())];
            net.add("Core::DoubleGreater", greater).out("outValue")
        });
        let moving: Vec<_> = moving.collect();
        net.any(&moving)
    }

    fn write_centre(
        net: &mut Net,
        (arm, limits, tool): (&ArmDescription, &CartesianLimits, &Pose),
        requests: &Requests<'_>,
    ) -> (Moved, Port) {
        let sent = net.add("World::TwistNetcommIn", [("Key", KEY.into())]);
        // A fault stops the motion from the next cycle on.
        let (fault_in, stop) = net.feedback(&requests.stop);
        let off = Self::off(net, &sent.out("outLastUpdated"), &stop);
        let over = net.override_in();
        let begin = frame::commanded(net, arm, tool);
        let parts = [("inValue", (&begin.velocity).into())];
        let parts = net.add("World::TwistToVelocities", parts);
        let wanted = [("inValue", (&sent.out("outValue")).into())];
        let wanted = net.add("World::TwistToVelocities", wanted);
        let (at_in, at) = net.state("World::Frame", &begin.frame);
        let bounds = limits.bounds(1.0);
        let mut next = Vec::new();
        let parts = ["outTransVel", "outRotVel"].map(|port| (wanted.out(port), parts.out(port)));
        for ((wanted, begin), bounds) in parts.iter().zip([bounds.translation, bounds.rotation]) {
            let (now_in, now) = net.state("World::Vector", begin);
            let velocity = bounds.velocity * requests.speed;
            let limits = (&over, [velocity, bounds.acceleration]);
            let speed = Self::approach(net, (&now, wanted, &off), limits);
            net.close(&now_in, &speed);
            next.push(speed);
        }
        let twist = |net: &mut Net, speeds: &[Port]| {
            let parts = ["inTransVel", "inRotVel"].into_iter().zip(speeds);
            let parts: Vec<_> = parts.map(|(name, port)| (name, port.into())).collect();
            net.add_with("World::TwistFromVelocities", &parts)
                .out("outValue")
        };
        let moved = |net: &mut Net, twist: &Port| {
            let step = [("inFrame", (&at).into()), ("inTwist", twist.into())];
            net.add("World::FrameAddTwist", step).out("outValue")
        };
        let step = twist(net, &next);
        let position = moved(net, &step);
        net.close(&at_in, &position);
        // Where it is at rest at the latest, if it brakes now: from the largest speed that takes this time twice.
        let time = |it: &takt_motion::plan::Bounds| it.velocity / (2.0 * it.acceleration);
        let time_s = time(&bounds.translation).max(time(&bounds.rotation));
        let period = net.add("Core::CycleTime", []).out("outValue");
        let seconds = net.add("Core::DoubleValue", [("Value", time_s.into())]);
        let cycles = net.of_two("Core::DoubleDivide", &seconds.out("outValue"), &period);
        let far = next.iter().map(|speed| {
            let far = [("inValue", speed.into()), ("inFactor", (&cycles).into())];
            net.add("World::VectorScale", far).out("outValue")
        });
        let far: Vec<_> = far.collect();
        let far = twist(net, &far);
        let rest = moved(net, &far);
        let grip = tool.inverse();
        let (flange, rest) = (net.transform(&position, &grip), net.transform(&rest, &grip));
        let (joints, beyond) = frame::inverse(net, arm, &flange);
        let (rest_joints, will_be_beyond) = frame::inverse(net, arm, &rest);
        let beyond = net.of_two("Core::BooleanOr", &beyond, &will_be_beyond);
        let fast = arm.any_further(net, [&joints, &rest_joints], (time_s, SPEED_MAX));
        let mut faults = vec![(Failure::unreachable(&arm.name), beyond)];
        faults.extend(fast.map(|fast| (Failure::too_fast(&arm.name), fast)));
        let moves = Self::any_moves(net, &next).unwrap_or_else(|| stop.clone());
        let is_at_rest = net.of("Core::BooleanNot", &moves);
        let latched = latched(net, faults);
        let ports: Vec<_> = latched.iter().map(|(_, port)| port.clone()).collect();
        let fault = net.any(&ports).unwrap_or_else(|| stop.clone());
        net.close(&fault_in, &fault);
        // The net ends when the arm is at rest.
        let ended = latched.into_iter();
        let ended = ended
            .map(|(failure, port)| (failure, net.of_two("Core::BooleanAnd", &is_at_rest, &port)));
        let failures = ended.collect();
        let moved = Moved {
            joints,
            is_at_rest,
            failures,
        };
        (moved, fault)
    }
}

/// The same faults, each kept from the cycle on in which it appears.
fn latched(net: &mut Net, faults: Vec<(Failure, Port)>) -> Vec<(Failure, Port)> {
    let latched = faults.into_iter().map(|(failure, port)| {
        let latched = [("inOn", (&port).into())];
        (failure, net.add("Core::Trigger", latched).out("outActive"))
    });
    latched.collect()
}

impl Operation for Jog {
    fn devices(&self) -> Vec<String> {
        vec![self.arm().name.clone()]
    }

    fn check(&self) -> Result<(), ErrorKind> {
        match self {
            Self::Centre { arm, limits, tool } => {
                if !tool.is_finite() {
                    return Err(ErrorKind::not_finite(&arm.name, "the motion centre"));
                }
                limits.check(&arm.name)
            }
            Self::Joints { .. } => Ok(()),
        }
    }

    fn needs_begins(&self) -> bool {
        false
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let (moved, fault) = match self {
            Self::Centre { arm, limits, tool } => {
                let (moved, fault) = Self::write_centre(net, (arm, limits, tool), requests);
                (moved, Some(fault))
            }
            Self::Joints { arm } => (Self::write_joints(net, arm, requests)?, None),
        };
        let mut failures = self.arm().command(net, &moved.joints);
        failures.extend(moved.failures);
        Ok(Ports {
            done: net.of_two("Core::BooleanAnd", &moved.is_at_rest, &requests.stop),
            progress: None,
            failures,
            results: Vec::new(),
            fault,
        })
    }
}

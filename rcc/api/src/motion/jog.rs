//! Jogging: the program writes the velocity of an arm while it moves, and the arm brakes when the program ceases to. Not
//! here: who holds a key or a switch.

use super::ArmDescription;
use super::centre::{Centre, Next};
use crate::error::ErrorKind;
use crate::live::KEY;
use crate::net::{Net, Port, array};
use crate::order::{Operation, Ports, Requests};

/// How long a velocity is in effect after it arrived, s. An older one counts as zero.
const DEAD_MAN_S: f64 = 0.1;

/// What of an arm moves at a velocity that a program writes.
#[derive(Clone, Debug)]
pub(crate) enum Jog {
    /// The motion centre, which is at `tool` in the flange, in the axes of the base.
    Centre(Centre),
    /// Each joint.
    Joints { arm: ArmDescription },
}

/// What a jog of joints writes of its motion.
struct Moved {
    joints: Port,
    is_at_rest: Port,
}

impl Jog {
    const fn arm(&self) -> &ArmDescription {
        let (Self::Centre(Centre { arm, .. }) | Self::Joints { arm }) = self;
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
        })
    }

    fn write_centre(net: &mut Net, centre: &Centre, requests: &Requests<'_>) -> Ports {
        let sent = net.add("World::TwistNetcommIn", [("Key", KEY.into())]);
        let mut moving = centre.begin(net, &requests.stop);
        moving.stop = Self::off(net, &sent.out("outLastUpdated"), &moving.stop);
        let over = net.override_in();
        let wanted = [("inValue", (&sent.out("outValue")).into())];
        let wanted = net.add("World::TwistToVelocities", wanted);
        let wanted = ["outTransVel", "outRotVel"].map(|port| wanted.out(port));
        let [velocity, rotation] = &wanted;
        let velocities = moving.approach_both(net, [velocity, rotation], (&over, requests.speed));
        let next = Next {
            velocities,
            at: None,
        };
        let moved = centre.end(net, moving, &next, Vec::new());
        moved.ports(net, &requests.stop, Vec::new())
    }
}

impl Operation for Jog {
    fn devices(&self) -> Vec<String> {
        vec![self.arm().name.clone()]
    }

    fn check(&self) -> Result<(), ErrorKind> {
        match self {
            Self::Centre(centre) => centre.check(),
            Self::Joints { .. } => Ok(()),
        }
    }

    fn needs_begins(&self) -> bool {
        false
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let arm = match self {
            Self::Centre(centre) => return Ok(Self::write_centre(net, centre, requests)),
            Self::Joints { arm } => arm,
        };
        let moved = Self::write_joints(net, arm, requests)?;
        Ok(Ports {
            done: net.of_two("Core::BooleanAnd", &moved.is_at_rest, &requests.stop),
            progress: None,
            failures: arm.command(net, &moved.joints),
            results: Vec::new(),
            fault: None,
        })
    }
}

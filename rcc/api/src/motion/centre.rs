//! A motion centre that moves at a velocity that its net computes in each cycle: jogging, moving under force, and following
//! a frame. It begins in the state that is commanded, at rest or in motion, and brakes where the arm cannot follow.

use takt_motion::plan::Bounds;

use super::frame;
use super::{ArmDescription, CartesianLimits};
use crate::engine::Failure;
use crate::error::ErrorKind;
use crate::net::{Later, Net, Port};
use crate::order::Ports;
use crate::pose::Pose;

/// Largest mean speed of a joint until the motion centre would be at rest, as part of its limit.
const SPEED_MAX: f64 = 0.8;

/// How long the set-points rest before a motion that fails ends, s.
const STEADY_S: f64 = 1.0;

/// A motion centre with its limits.
#[derive(Clone, Debug)]
pub(crate) struct Centre {
    pub(crate) arm: ArmDescription,
    pub(crate) limits: CartesianLimits,
    /// The motion centre in the flange.
    pub(crate) tool: Pose,
}

/// A motion centre in a cycle, before its motion.
pub(super) struct Moving {
    at_in: Later,
    velocity_in: Later,
    rotation_in: Later,
    stop_in: Later,
    /// Where it is in the base.
    pub(super) at: Port,
    /// Its velocity, m/s, and rotational velocity, rad/s, along the axes of the base.
    pub(super) velocity: Port,
    pub(super) rotation: Port,
    /// Whether it is to brake: on request, or after a fault.
    pub(super) stop: Port,
    /// The limits along the way and of rotation, at full speed.
    pub(super) bounds: [Bounds; 2],
}

/// What a motion centre does in a cycle.
pub(super) struct Next {
    /// Velocity and rotational velocity.
    pub(super) velocities: [Port; 2],
    /// Where it is then; else where these lead in one period.
    pub(super) at: Option<Port>,
}

impl Centre {
    pub(super) fn check(&self) -> Result<(), ErrorKind> {
        let name = &self.arm.name;
        if !self.tool.is_finite() {
            return Err(ErrorKind::not_finite(name, "the motion centre"));
        }
        self.limits.check(name)
    }

    /// The state in this cycle.
    pub(super) fn begin(&self, net: &mut Net, stop: &Port) -> Moving {
        // A fault stops the motion from the next cycle on.
        let (stop_in, stop) = net.feedback(stop);
        let begin = frame::commanded(net, &self.arm, &self.tool);
        let parts = [("inValue", (&begin.velocity).into())];
        let parts = net.add("World::TwistToVelocities", parts);
        let (at_in, at) = net.state("World::Frame", &begin.frame);
        let (velocity_in, velocity) = net.state("World::Vector", &parts.out("outTransVel"));
        let (rotation_in, rotation) = net.state("World::Vector", &parts.out("outRotVel"));
        let bounds = self.limits.bounds();
        Moving {
            at_in,
            velocity_in,
            rotation_in,
            stop_in,
            at,
            velocity,
            rotation,
            stop,
            bounds: [bounds.translation, bounds.rotation],
        }
    }

    /// Commands the next state. With the faults of the motion, in order, those of the arm.
    pub(super) fn end(
        &self,
        net: &mut Net,
        moving: Moving,
        next: &Next,
        mut faults: Vec<(Failure, Port)>,
    ) -> Moved {
        let [velocity, rotation] = &next.velocities;
        let position = next.at.clone().unwrap_or_else(|| {
            let step = twist(net, &next.velocities);
            moved(net, &moving.at, &step)
        });
        net.close(&moving.at_in, &position);
        net.close(&moving.velocity_in, velocity);
        net.close(&moving.rotation_in, rotation);
        // Where it is at rest at the latest, if it brakes now: from the largest speed that takes this time twice.
        let time = |it: &Bounds| it.velocity / (2.0 * it.acceleration);
        let time_s = moving.bounds.iter().map(time).fold(0.0, f64::max);
        let period = net.add("Core::CycleTime", []).out("outValue");
        let seconds = net.add("Core::DoubleValue", [("Value", time_s.into())]);
        let cycles = net.of_two("Core::DoubleDivide", &seconds.out("outValue"), &period);
        let far = [velocity, rotation].map(|speed| scaled(net, speed, &cycles));
        let far = twist(net, &far);
        let rest = moved(net, &moving.at, &far);
        let grip = self.tool.inverse();
        let (flange, rest) = (net.transform(&position, &grip), net.transform(&rest, &grip));
        let (arm, name) = (&self.arm, &self.arm.name);
        let (joints, beyond) = frame::inverse(net, arm, &flange);
        let (rest_joints, will_be_beyond) = frame::inverse(net, arm, &rest);
        let beyond = net.of_two("Core::BooleanOr", &beyond, &will_be_beyond);
        let fast = arm.any_further(net, [&joints, &rest_joints], (time_s, SPEED_MAX));
        faults.push((Failure::unreachable(name), beyond));
        faults.extend(fast.map(|fast| (Failure::too_fast(name), fast)));
        let moves = next.velocities.iter().map(|speed| {
            let length = net.of("World::VectorLength", speed);
            let greater = [("inFirst", (&length).into()), ("Second", 0.0.into())];
            net.add("Core::DoubleGreater", greater).out("outValue")
        });
        let moves: Vec<_> = moves.collect();
        let moves = net.any(&moves).unwrap_or_else(|| moving.stop.clone());
        let is_at_rest = net.of("Core::BooleanNot", &moves);
        let latched = latched(net, faults);
        let ports: Vec<_> = latched.iter().map(|(_, port)| port.clone()).collect();
        let fault = net.any(&ports).unwrap_or_else(|| moving.stop.clone());
        net.close(&moving.stop_in, &fault);
        // The net ends when the arm is at rest: near a singularity joints come to rest after their set-points.
        let is_steady = lasting(net, &is_at_rest, STEADY_S);
        let ended = latched.into_iter();
        let ended = ended
            .map(|(failure, port)| (failure, net.of_two("Core::BooleanAnd", &is_steady, &port)));
        let failures: Vec<_> = ended.collect();
        let mut commanded = arm.command(net, &joints);
        commanded.extend(failures);
        Moved {
            is_at_rest,
            failures: commanded,
            fault,
        }
    }
}

/// What a motion centre has done in a cycle.
pub(super) struct Moved {
    pub(super) is_at_rest: Port,
    failures: Vec<(Failure, Port)>,
    fault: Port,
}

impl Moved {
    /// The ports of an operation that goes on until a stop is requested.
    pub(super) fn ports(
        self,
        net: &mut Net,
        stop: &Port,
        results: Vec<(&'static str, Port)>,
    ) -> Ports {
        Ports {
            done: net.of_two("Core::BooleanAnd", &self.is_at_rest, stop),
            progress: None,
            failures: self.failures,
            results,
            fault: Some(self.fault),
        }
    }
}

impl Moving {
    /// The next velocity on the way to the wanted one, which changes by the acceleration limit at most; zero is wanted of a
    /// motion that is to stop.
    pub(super) fn approach(
        &self,
        net: &mut Net,
        (now, wanted): (&Port, &Port),
        acceleration: f64,
    ) -> Port {
        let wanted = net.zero_if("World::Vector", &self.stop, wanted);
        let change = net.of_two("World::VectorSubtract", &wanted, now);
        let period = net.add("Core::CycleTime", []).out("outValue");
        let most = net.scaled(&period, acceleration);
        let change = [("inValue", (&change).into()), ("inMax", (&most).into())];
        let change = net.add("World::VectorClamp", change).out("outValue");
        // The last change is the whole difference, so that zero is exact.
        net.of_two("World::VectorAdd", now, &change)
    }

    /// The next velocities on the way to these, at most as fast as the bounds at this override and speed permit.
    pub(super) fn approach_both(
        &self,
        net: &mut Net,
        wanted: [&Port; 2],
        (over, speed): (&Port, f64),
    ) -> [Port; 2] {
        let mut next = Vec::new();
        let now = [&self.velocity, &self.rotation];
        for ((wanted, now), bounds) in wanted.into_iter().zip(now).zip(self.bounds) {
            let wanted = scaled(net, wanted, over);
            let velocity = bounds.velocity * speed;
            let wanted = [("inValue", (&wanted).into()), ("Max", velocity.into())];
            let wanted = net.add("World::VectorClamp", wanted).out("outValue");
            next.push(self.approach(net, (now, &wanted), bounds.acceleration));
        }
        let rotation = next.pop();
        let velocity = next.pop();
        [
            velocity.unwrap_or_else(|| self.velocity.clone()),
            rotation.unwrap_or_else(|| self.rotation.clone()),
        ]
    }

    /// One step towards a frame that may move, within the bounds; a stop brakes.
    pub(super) fn towards(
        &self,
        net: &mut Net,
        (velocity, goal, goal_velocity): (&Port, &Port, Option<&Port>),
        (over, speed): (&Port, f64),
    ) -> Next {
        let twist = twist(net, &[velocity.clone(), self.rotation.clone()]);
        let [translation, rotation] = self.bounds;
        let velocity_max = net.scaled(over, translation.velocity * speed);
        let rotation_max = net.scaled(over, rotation.velocity * speed);
        let mut arguments = vec![
            ("inCurPos", (&self.at).into()),
            ("inCurVel", (&twist).into()),
            ("inDestPos", goal.into()),
            ("inMaxTransVel", (&velocity_max).into()),
            ("MaxTransAcc", translation.acceleration.into()),
            ("inMaxRotVel", (&rotation_max).into()),
            ("MaxRotAcc", rotation.acceleration.into()),
        ];
        arguments.extend(goal_velocity.map(|it| ("inDestVel", it.into())));
        let step = net.add_with("World::FrameOTG", &arguments);
        let parts = [("inValue", (&step.out("outVel")).into())];
        let parts = net.add("World::TwistToVelocities", parts);
        let brakes = [
            (velocity, parts.out("outTransVel"), translation),
            (&self.rotation, parts.out("outRotVel"), rotation),
        ];
        let braked = brakes.map(|(now, wanted, bounds)| {
            // A braking motion does not need the goal, which may be unknown.
            let zero = net.add("World::VectorValue", []).out("outValue");
            let brakes = self.approach(net, (now, &zero), bounds.acceleration);
            conditional(net, "World::Vector", (&self.stop, &brakes, &wanted))
        });
        let stopped = self::twist(net, &braked);
        let stopped = moved(net, &self.at, &stopped);
        let at = (&self.stop, &stopped, &step.out("outPos"));
        let at = conditional(net, "World::Frame", at);
        Next {
            velocities: braked,
            at: Some(at),
        }
    }
}

/// One of two values.
pub(super) fn conditional(
    net: &mut Net,
    kind: &str,
    (condition, yes, no): (&Port, &Port, &Port),
) -> Port {
    let arguments = [
        ("inCondition", condition.into()),
        ("inTrue", yes.into()),
        ("inFalse", no.into()),
    ];
    net.add(&format!("{kind}Conditional"), arguments)
        .out("outValue")
}

/// A vector times a number.
pub(super) fn scaled(net: &mut Net, vector: &Port, factor: &Port) -> Port {
    let arguments = [("inValue", vector.into()), ("inFactor", factor.into())];
    net.add("World::VectorScale", arguments).out("outValue")
}

/// Whether a number is greater than a constant.
pub(super) fn over(net: &mut Net, number: &Port, limit: f64) -> Port {
    let arguments = [("inFirst", number.into()), ("Second", limit.into())];
    net.add("Core::DoubleGreater", arguments).out("outValue")
}

/// Whether a number is less than a constant.
pub(super) fn under(net: &mut Net, number: &Port, limit: f64) -> Port {
    let arguments = [("First", limit.into()), ("inSecond", number.into())];
    net.add("Core::DoubleGreater", arguments).out("outValue")
}

/// Whether a state has lasted for a time, s.
pub(super) fn lasting(net: &mut Net, state: &Port, time_s: f64) -> Port {
    let arguments = [("inValue", state.into()), ("Duration", time_s.into())];
    net.add("Core::BooleanHistory", arguments).out("outAll")
}

/// Both velocities as one value.
fn twist(net: &mut Net, speeds: &[Port; 2]) -> Port {
    let parts = ["inTransVel", "inRotVel"].into_iter().zip(speeds);
    let parts: Vec<_> = parts.map(|(name, port)| (name, port.into())).collect();
    net.add_with("World::TwistFromVelocities", &parts)
        .out("outValue")
}

/// A frame after one period of a motion.
fn moved(net: &mut Net, at: &Port, twist: &Port) -> Port {
    let step = [("inFrame", at.into()), ("inTwist", twist.into())];
    net.add("World::FrameAddTwist", step).out("outValue")
}

/// The same faults, each kept from the cycle on in which it appears.
fn latched(net: &mut Net, faults: Vec<(Failure, Port)>) -> Vec<(Failure, Port)> {
    let latched = faults.into_iter().map(|(failure, port)| {
        let latched = [("inOn", (&port).into())];
        (failure, net.add("Core::Trigger", latched).out("outActive"))
    });
    latched.collect()
}

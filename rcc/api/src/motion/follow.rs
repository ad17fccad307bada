//! Following a frame that moves: that of another arm, of a mobile base, or of numbers over sensors. The motion centre is
//! brought to it as fast as the limits permit, and then has its velocity.

use super::centre::{Centre, under};
use crate::engine::Failure;
use crate::error::ErrorKind;
use crate::moving::MovingFrame;
use crate::net::{Net, Port};
use crate::order::{Operation, Ports, Requests};
use crate::pose::Pose;
use crate::world::Frame;

/// Distance within which the frame is reached, m and rad.
const REACHED: [f64; 2] = [1e-3, 1e-2];

/// A larger velocity from the base to a frame in one period is no number.
const FAR: f64 = 1e9;

/// An arm that follows a frame.
#[derive(Clone, Debug)]
pub(crate) struct Follow {
    pub(crate) centre: Centre,
    pub(crate) frame: MovingFrame,
    /// The base of the arm.
    pub(crate) base: Frame,
}

impl Follow {
    /// The frame in the base of the arm.
    fn goal(&self, net: &mut Net) -> Result<Port, ErrorKind> {
        let placed = self.frame.placed_in(&self.base)?;
        let goal = self.frame.write(net);
        let goal = if placed == Pose::IDENTITY {
            goal
        } else {
            let placed = net.frame(&placed);
            net.of_two("World::FrameTransform", &placed, &goal)
        };
        Ok(net.transform(&goal, &self.frame.offset()))
    }

    /// Whether a frame is null or not finite.
    fn is_unknown(net: &mut Net, frame: &Port) -> Port {
        let origin = net.frame(&Pose::IDENTITY);
        let away = between(net, frame, &origin);
        let away = net.add("World::TwistToVelocities", [("inValue", (&away).into())]);
        let parts = ["outTransVel", "outRotVel"].map(|part| {
            let length = net.of("World::VectorLength", &away.out(part));
            // Not true of null and of what is no number.
            let bounded = under(net, &length, FAR);
            let bounded = net.known(&bounded);
            net.of("Core::BooleanNot", &bounded)
        });
        let [position, rotation] = &parts;
        net.of_two("Core::BooleanOr", position, rotation)
    }
}

/// The velocity that leads from one frame to another in one period.
fn between(net: &mut Net, to: &Port, from: &Port) -> Port {
    let ends = [("inFrame", to.into()), ("inPrevFrame", from.into())];
    net.add("World::TwistFromFrames", ends).out("outValue")
}

impl Operation for Follow {
    fn devices(&self) -> Vec<String> {
        vec![self.centre.arm.name.clone()]
    }

    fn check(&self) -> Result<(), ErrorKind> {
        let name = &self.centre.arm.name;
        self.centre.check()?;
        if self.frame.arm() == Some(name) {
            let text = format!("{name}: an arm cannot follow itself");
            return Err(ErrorKind::Invalid(text));
        }
        if !self.frame.offset().is_finite() {
            return Err(ErrorKind::not_finite(name, "the pose in the frame"));
        }
        self.frame.placed_in(&self.base).map(drop)
    }

    fn needs_begins(&self) -> bool {
        false
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let name = &self.centre.arm.name;
        let mut moving = self.centre.begin(net, &requests.stop);
        let known = self.goal(net)?;
        let is_unknown = Self::is_unknown(net, &known);
        moving.stop = net.of_two("Core::BooleanOr", &moving.stop, &is_unknown);
        // Where it is unknown, the arm brakes where it is.
        let goal = [
            ("inCondition", (&is_unknown).into()),
            ("inTrue", (&moving.at).into()),
            ("inFalse", (&known).into()),
        ];
        let goal = net.add("World::FrameConditional", goal).out("outValue");
        let (before_in, before) = net.state("World::Frame", &goal);
        net.close(&before_in, &goal);
        let velocity = between(net, &goal, &before);
        let over = net.override_in();
        let way = (&moving.velocity, &goal, Some(&velocity));
        let next = moving.towards(net, way, (&over, requests.speed));
        let left = between(net, &goal, &moving.at);
        let left = [("inValue", (&left).into())];
        let left = net.add("World::TwistToVelocities", left);
        let period_s = self.centre.arm.period.as_secs_f64();
        let near = ["outTransVel", "outRotVel"]
            .into_iter()
            .zip(REACHED)
            .map(|(port, limit)| {
                let left = net.of("World::VectorLength", &left.out(port));
                under(net, &left, limit / period_s)
            });
        let near: Vec<_> = near.collect();
        let is_near = near
            .into_iter()
            .reduce(|all, port| net.of_two("Core::BooleanAnd", &all, &port));
        let is_near = is_near.unwrap_or_else(|| is_unknown.clone());
        let unknown = "the frame that it follows is not known\nhint: the device that moves the frame may be offline";
        let faults = vec![(Failure::of("frameless", name, unknown), is_unknown)];
        let moved = self.centre.end(net, moving, &next, faults);
        Ok(moved.ports(net, &requests.stop, vec![("maintaining", is_near)]))
    }
}

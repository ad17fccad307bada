//! Motion under force: the motion centre approaches along a direction until the arm touches something, and then moves
//! there at a velocity that is proportional to the missing force (admittance control), at rest or while it moves aside to
//! a pose. Not here: stiffness and damping of the arm itself, which its controller has.

use super::centre::{Centre, Moving, Next, conditional, lasting, over, scaled, under};
use crate::engine::Failure;
use crate::error::ErrorKind;
use crate::net::{Net, Port};
use crate::order::{Operation, Ports, Requests};
use crate::pose::Pose;

/// How long the force is near the wanted one before it counts as held, s.
const HELD_S: f64 = 0.2;
/// How long the force is less than half of a touch before the contact counts as lost, s.
const LOST_S: f64 = 0.1;
/// A pose aside is reached within this distance, m.
const REACHED: f64 = 2e-4;
/// And at most this speed, m/s and rad/s.
const REACHED_SPEED: f64 = 1e-4;

/// Limits of motions under force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForceLimits {
    /// Speed until contact, m/s.
    pub approach: f64,
    /// Largest speed in contact along the direction of the force, m/s.
    pub velocity: f64,
    /// Longest way along the direction of the force, either way, m.
    pub travel: f64,
    /// Force from which on there is contact, N; at most half of the wanted force counts.
    pub touch: f64,
    /// How far from the wanted force a held one may be, N.
    pub tolerance: f64,
    /// Largest magnitude of the force at the tool, N: beyond, the arm stops and the activity fails.
    pub force_max: f64,
    /// Missing force by velocity in contact, Ns/m: the lower, the faster the force is reached, and the more it overshoots on
    /// stiff objects.
    pub damping: f64,
}

impl Default for ForceLimits {
    /// For objects of up to 50,000 N/m.
    fn default() -> Self {
        Self {
            approach: 0.02,
            velocity: 0.01,
            travel: 0.1,
            touch: 5.0,
            tolerance: 2.0,
            force_max: 100.0,
            damping: 2000.0,
        }
    }
}

impl ForceLimits {
    fn check(&self, name: &str, force: f64) -> Result<(), ErrorKind> {
        let limits = [
            ("approach", self.approach),
            ("velocity", self.velocity),
            ("travel", self.travel),
            ("touch", self.touch),
            ("tolerance", self.tolerance),
            ("force_max", self.force_max),
            ("damping", self.damping),
        ];
        let wrong = limits
            .iter()
            .find(|(_, limit)| !(*limit > 0.0 && limit.is_finite()));
        if let Some((limit, value)) = wrong {
            let text = format!(
                "{name}: the limit `{limit}` is {value}; it is above 0\nhint: limits are in m, N and s"
            );
            return Err(ErrorKind::Invalid(text));
        }
        let most = self.force_max - self.tolerance;
        if !(force > 0.0 && force <= most) {
            let text = format!(
                "{name}: the force is {force} N; it is above 0 N, at most {most} N\nhint: `force_max` less `tolerance` bounds \
                 it; the direction has the sign"
            );
            return Err(ErrorKind::Invalid(text));
        }
        Ok(())
    }
}

/// The axes in which a direction is given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Along {
    /// Those of the base of the arm.
    Base([f64; 3]),
    /// Those of the motion centre.
    Centre([f64; 3]),
}

impl Along {
    /// The same direction, given in the axes of a frame at `frame`.
    pub(crate) fn turned(self, frame: &Pose) -> Self {
        match self {
            Self::Base(vector) => Self::Base(frame.turned(vector)),
            Self::Centre(vector) => Self::Centre(vector),
        }
    }

    const fn vector(self) -> [f64; 3] {
        let (Self::Base(vector) | Self::Centre(vector)) = self;
        vector
    }

    /// The unit vector, if there is one.
    fn unit(self) -> Option<[f64; 3]> {
        let vector = self.vector();
        let length = vector.iter().map(|x| x * x).sum::<f64>().sqrt();
        (length.is_finite() && length > 1e-9).then(|| vector.map(|x| x / length))
    }
}

/// A motion of an arm under force.
#[derive(Clone, Debug)]
pub(crate) struct Press {
    pub(crate) centre: Centre,
    /// Where to the arm presses, or why that is not known.
    pub(crate) along: Result<Along, ErrorKind>,
    /// What it presses with, N.
    pub(crate) force: f64,
    pub(crate) limits: ForceLimits,
    /// Where it moves aside meanwhile; its place along the direction of the force does not matter.
    pub(crate) to: Option<Result<Pose, ErrorKind>>,
}

/// The force in a cycle.
struct Pressing {
    /// Unit vector.
    direction: Port,
    /// The missing force, N.
    lacks: Port,
    is_unknown: Port,
    is_touched: Port,
    is_lost: Port,
    is_too_large: Port,
}

impl Press {
    fn along(&self) -> Result<Along, ErrorKind> {
        self.along.clone()
    }

    fn goal(&self) -> Result<Option<Pose>, ErrorKind> {
        self.to.clone().transpose()
    }

    /// The direction along the axes of the base.
    fn direction(&self, net: &mut Net, at: &Port) -> Result<Port, ErrorKind> {
        let along = self.along()?;
        let [x, y, z] = along.unit().unwrap_or_default();
        let vector = format!("{{x:{x},y:{y},z:{z}}}");
        let vector = net.add("World::VectorValue", [("Value", vector.into())]);
        let vector = vector.out("outValue");
        Ok(match along {
            Along::Base(_) => vector,
            Along::Centre(_) => {
                let parts = net.add("World::FrameToPosRot", [("inValue", at.into())]);
                let turned = [
                    ("inValue", (&vector).into()),
                    ("inRot", (&parts.out("outRotation")).into()),
                ];
                net.add("World::VectorRotate", turned).out("outValue")
            }
        })
    }

    fn sense(&self, net: &mut Net, direction: Port, stop: &Port) -> Pressing {
        let name = self.centre.arm.name.as_str();
        let sensor = net.add("KUKA::LWR::FMonitor", [("Robot", name.into())]);
        let vector = ["inX", "inY", "inZ"].into_iter().zip(["Fx", "Fy", "Fz"]);
        let ports: Vec<_> = vector
            .map(|(name, axis)| (name, (&sensor.out(&format!("outTcp{axis}"))).into()))
            .collect();
        let vector = net.add_with("World::VectorFromXYZ", &ports).out("outValue");
        let is_unknown = net.of("World::VectorIsNull", &vector);
        let vector = net.zero_if("World::Vector", &is_unknown, &vector);
        // The object pushes back.
        let back = net.of_two("World::VectorDot", &vector, &direction);
        let pressing = net.of("Core::DoubleNegate", &back);
        let lacks = [("inFirst", (&back).into()), ("Second", self.force.into())];
        let lacks = net.add("Core::DoubleAdd", lacks).out("outValue");
        let touch = self.limits.touch.min(self.force / 2.0);
        let touches = over(net, &pressing, touch);
        let is_touched = net.add("Core::Trigger", [("inOn", (&touches).into())]);
        let is_touched = is_touched.out("outActive");
        let is_free = under(net, &pressing, touch / 2.0);
        let is_gone = net.of_two("Core::BooleanAnd", &is_free, &is_touched);
        let is_gone = lasting(net, &is_gone, LOST_S);
        // An arm that is requested to stop may leave.
        let goes_on = net.of("Core::BooleanNot", stop);
        let is_lost = net.of_two("Core::BooleanAnd", &is_gone, &goes_on);
        let magnitude = net.of("World::VectorLength", &vector);
        Pressing {
            direction,
            lacks,
            is_unknown,
            is_touched,
            is_lost,
            is_too_large: over(net, &magnitude, self.limits.force_max),
        }
    }

    /// The velocity along the direction: towards contact, and there by the missing force.
    fn admit(
        &self,
        net: &mut Net,
        moving: &Moving,
        pressing: &Pressing,
        (over, speed): (&Port, f64),
    ) -> Port {
        let limits = &self.limits;
        let law = net.scaled(&pressing.lacks, limits.damping.recip());
        let bounds = [
            ("inValue", (&law).into()),
            ("Min", (-limits.velocity * speed).into()),
            ("Max", (limits.velocity * speed).into()),
        ];
        let law = net.add("Core::DoubleClamp", bounds).out("outValue");
        let approach = limits.approach * speed;
        let wanted = [
            ("inCondition", (&pressing.is_touched).into()),
            ("inTrue", (&law).into()),
            ("False", approach.into()),
        ];
        let wanted = net.add("Core::DoubleConditional", wanted).out("outValue");
        let wanted = net.of_two("Core::DoubleMultiply", &wanted, over);
        let wanted = scaled(net, &pressing.direction, &wanted);
        let [translation, _] = moving.bounds;
        let now = match &self.to {
            None => moving.velocity.clone(),
            Some(_) => part_along(net, &moving.velocity, &pressing.direction),
        };
        moving.approach(net, (&now, &wanted), translation.acceleration)
    }

    /// The velocities aside on the way to a pose, and whether it is reached.
    fn aside(
        net: &mut Net,
        moving: &Moving,
        (direction, to): (&Port, &Pose),
        requests: (&Port, f64),
    ) -> ([Port; 2], Port) {
        let along = part_along(net, &moving.velocity, direction);
        let velocity = net.of_two("World::VectorSubtract", &moving.velocity, &along);
        let goal = net.frame(to);
        let goal = net.add("World::FrameToPosRot", [("inValue", (&goal).into())]);
        let here = net.add("World::FrameToPosRot", [("inValue", (&moving.at).into())]);
        let here = here.out("outPosition");
        let left = net.of_two("World::VectorSubtract", &goal.out("outPosition"), &here);
        let above = part_along(net, &left, direction);
        let left = net.of_two("World::VectorSubtract", &left, &above);
        let beside = net.of_two("World::VectorAdd", &here, &left);
        let beside = [
            ("inPos", (&beside).into()),
            ("inRot", (&goal.out("outRotation")).into()),
        ];
        let beside = net.add("World::FrameFromPosRot", beside).out("outValue");
        let next = moving.towards(net, (&velocity, &beside, None), requests);
        let left = net.of("World::VectorLength", &left);
        let mut is_there = under(net, &left, REACHED);
        for speed in &next.velocities {
            let speed = net.of("World::VectorLength", speed);
            let rests = under(net, &speed, REACHED_SPEED);
            is_there = net.of_two("Core::BooleanAnd", &is_there, &rests);
        }
        (next.velocities, is_there)
    }

    /// Whether the arm has moved further along the direction than it may.
    fn is_far(&self, net: &mut Net, velocity: &Port, direction: &Port) -> Port {
        let zero = net.add("Core::DoubleValue", [("Value", 0.0.into())]);
        let (way_in, way) = net.state("Core::Double", &zero.out("outValue"));
        let speed = net.of_two("World::VectorDot", velocity, direction);
        let period = net.add("Core::CycleTime", []).out("outValue");
        let step = net.of_two("Core::DoubleMultiply", &speed, &period);
        let way = net.of_two("Core::DoubleAdd", &way, &step);
        net.close(&way_in, &way);
        let way = net.of("Core::DoubleAbs", &way);
        over(net, &way, self.limits.travel)
    }

    fn faults(&self, pressing: &Pressing, is_far: Port) -> Vec<(Failure, Port)> {
        let name = &self.centre.arm.name;
        let device = name.clone();
        let ForceLimits {
            travel, force_max, ..
        } = self.limits;
        let exceeded = ErrorKind::ForceExceeded {
            device: device.clone(),
            limit: force_max,
        };
        let not_reached = ErrorKind::ForceNotReached {
            device: device.clone(),
            force: self.force,
            travel,
        };
        let lost = ErrorKind::ContactLost { device };
        let unknown = "the force at its tool is not known\nhint: near a singularity or without contact to the robot there is none";
        let of = |key: &str, error: ErrorKind| Failure::with(key, name, error);
        vec![
            (
                Failure::of("forceless", name, unknown),
                pressing.is_unknown.clone(),
            ),
            (of("exceeded", exceeded), pressing.is_too_large.clone()),
            (of("contactless", lost), pressing.is_lost.clone()),
            (of("forceful", not_reached), is_far),
        ]
    }
}

/// The part of a vector along a direction.
fn part_along(net: &mut Net, vector: &Port, direction: &Port) -> Port {
    let length = net.of_two("World::VectorDot", vector, direction);
    scaled(net, direction, &length)
}

impl Operation for Press {
    fn devices(&self) -> Vec<String> {
        vec![self.centre.arm.name.clone()]
    }

    fn check(&self) -> Result<(), ErrorKind> {
        let arm = &self.centre.arm;
        let name = &arm.name;
        self.centre.check()?;
        self.limits.check(name, self.force)?;
        let along = self.along()?;
        if along.unit().is_none() {
            let [x, y, z] = along.vector();
            let text = format!("{name}: the direction is [{x}, {y}, {z}]; it is finite and not 0");
            return Err(ErrorKind::Invalid(text));
        }
        if let Some(to) = self.goal()?
            && !to.is_finite()
        {
            return Err(ErrorKind::not_finite(name, "the pose"));
        }
        arm.needs("wrench", "force at its tool")
    }

    fn needs_begins(&self) -> bool {
        false
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let mut moving = self.centre.begin(net, &requests.stop);
        let direction = self.direction(net, &moving.at)?;
        let pressing = self.sense(net, direction, &requests.stop);
        // Without a force it never goes on.
        moving.stop = net.of_two("Core::BooleanOr", &moving.stop, &pressing.is_unknown);
        let factors = (&net.override_in(), requests.speed);
        let normal = self.admit(net, &moving, &pressing, factors);
        let is_near = net.of("Core::DoubleAbs", &pressing.lacks);
        let is_near = under(net, &is_near, self.limits.tolerance);
        let is_near = net.of_two("Core::BooleanAnd", &is_near, &pressing.is_touched);
        let is_held = lasting(net, &is_near, HELD_S);
        let is_held = net.add("Core::Trigger", [("inOn", (&is_held).into())]);
        let is_held = is_held.out("outActive");
        let (velocities, maintains) = match self.goal()? {
            None => {
                let zero = net.add("World::VectorValue", []).out("outValue");
                let [_, bounds] = moving.bounds;
                let rotation = moving.approach(net, (&moving.rotation, &zero), bounds.acceleration);
                ([normal, rotation], is_held)
            }
            Some(to) => {
                let aside = (&pressing.direction, &to);
                let ([velocity, rotation], is_there) = Self::aside(net, &moving, aside, factors);
                // The way aside begins with the contact.
                let zero = net.add("World::VectorValue", []).out("outValue");
                let waiting = (&pressing.is_touched, &velocity, &zero);
                let velocity = conditional(net, "World::Vector", waiting);
                let velocity = net.of_two("World::VectorAdd", &velocity, &normal);
                let maintains = net.of_two("Core::BooleanAnd", &is_held, &is_there);
                ([velocity, rotation], maintains)
            }
        };
        let is_far = self.is_far(net, &velocities[0], &pressing.direction);
        let faults = self.faults(&pressing, is_far);
        let next = Next {
            velocities,
            at: None,
        };
        let moved = self.centre.end(net, moving, &next, faults);
        Ok(moved.ports(net, &requests.stop, vec![("maintaining", maintains)]))
    }
}

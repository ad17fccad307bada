//! Mobile bases: they move to a pose, or at a velocity for a time. Their poses are in the frame in which they started; a
//! velocity is in their own frame, and only x, y and the turn about z matter.

use std::sync::Arc;
use std::time::Duration;

use crate::activity::Activity;
use crate::description::{Descriptions, Interface};
use crate::engine::Failure;
use crate::error::{Error, ErrorKind};
use crate::expression::Number;
use crate::net::{Net, Port, Primitive};
use crate::order::{Operation, Ports, Requests, Speed};
use crate::pose::Pose;
use crate::session::Session;
use crate::world::{Frame, World};

/// Largest speed on the way to a pose in each direction, as part of the limit: of both directions together, in any
/// heading and while they change, the speed stays within it.
const PART: f64 = 0.5;

/// Largest acceleration, as part of the limit: the driver, whose cycles are longer, sees the changes of some more cycles.
const ACCELERATION_PART: f64 = 0.9;

/// Speed for each metre or radian that is left, 1/s, where the base can brake so hard.
const GAIN: f64 = 3.0;

/// A base at most as fast is at rest, m/s and rad/s.
const REST: f64 = 0.005;

/// Longest time of a velocity, s.
const DRIVE_MAX_S: f64 = 3600.0;

/// A mobile base of a cell. Clones are the same base with speeds of their own.
#[derive(Clone, Debug)]
pub struct Base {
    session: Arc<Session>,
    name: String,
    interface: Interface,
    speed: Speed,
}

impl Base {
    pub(crate) fn find(session: &Arc<Session>, name: &str) -> Result<Self, ErrorKind> {
        let devices = Descriptions::read(session)?;
        Ok(Self {
            session: Arc::clone(session),
            name: name.to_owned(),
            interface: devices.interface(name, "mobile base", &["robotbase"])?,
            speed: Speed::FULL,
        })
    }

    /// Its name in the cell.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The same base, slower: the speed of its motions is multiplied by `factor`, above 0 to 1.
    #[must_use]
    pub fn with_speed(mut self, factor: f64) -> Self {
        self.speed = self.speed.times(factor);
        self
    }

    /// Its largest speed, m/s, and rotational speed, rad/s.
    pub fn limits(&self) -> (f64, f64) {
        let [velocity, rotation] = limits(&self.interface);
        (velocity, rotation)
    }

    /// Moves straight to a pose in the frame in which the base started; its height and tilt do not matter. At the speed 1
    /// it moves with half of its largest speed in x and y, and it changes its speed within its largest acceleration.
    /// Completed when less than 0.01 m and 0.01 rad are left, and it is at rest: at most 0.005 m/s and 0.005 rad/s.
    pub fn go_to(&self, pose: impl Into<Pose>) -> Activity {
        self.activity(Task::To(pose.into()))
    }

    /// Moves at a velocity in its own frame, x and y in m/s and the turn about z in rad/s, times the speed and the override
    /// of the cell, for `duration`, at most an hour; then it brakes to rest. It changes its speed within its largest
    /// acceleration. A program that requests it again by [`Activity::now`] before the time is over keeps the base in motion;
    /// without the program it comes to rest.
    pub fn drive(&self, velocity: [f64; 3], duration: Duration) -> Activity {
        self.activity(Task::At(velocity, duration))
    }

    fn activity(&self, task: Task) -> Activity {
        let motion = BaseMotion {
            name: self.name.clone(),
            interface: self.interface.clone(),
            task,
        };
        Activity::new(&self.session, motion, self.speed)
    }

    /// The frame in which it started.
    pub(crate) fn odometry(&self) -> Result<Frame, ErrorKind> {
        let devices = Descriptions::read(&self.session)?;
        let world = World::read(&self.session, &devices)?;
        world.frame(&format!("{}.odometry", self.name))
    }

    /// The measured pose in the frame in which the base started.
    ///
    /// # Errors
    /// If the base is offline, or the connection is lost.
    #[track_caller]
    pub fn pose(&self) -> Result<Pose, Error> {
        let mut net = Net::default();
        let pose = monitor(&mut net, &self.name).out("outPos");
        let out = [("inValue", (&pose).into()), ("Key", "pose".into())];
        net.add("World::FrameNetcommOut", out);
        let values = self.session.evaluate(&net.finish_once())?;
        let pose = values.get("outpose").and_then(|text| Pose::read(text));
        let unknown = || ErrorKind::DeviceFailed {
            device: self.name.clone(),
            cause: "its pose is not known\nhint: `takt run` and the page say why it is offline"
                .to_owned(),
        };
        Ok(pose.ok_or_else(unknown)?)
    }

    /// The measured angle of a wheel since the start, rad, as an expression.
    pub fn wheel(&self, wheel: usize) -> Number {
        let parameters = vec![("Robot", self.name.clone()), ("Wheel", wheel.to_string())];
        Number::sensor("RobotBase::WheelMonitor", parameters, "outPos")
    }

    /// Requests that what the base does end, and everything that waits for it.
    pub fn cancel(&self) {
        self.session.cancel_device(&self.name);
    }
}

/// Largest speed, m/s, and rotational speed, rad/s.
fn limits(interface: &Interface) -> [f64; 2] {
    ["velocity_max", "rotation_max"].map(|limit| interface.number(limit))
}

/// Largest acceleration of motions, m/s², and rotational acceleration, rad/s².
fn accelerations(interface: &Interface) -> [f64; 2] {
    ["acceleration_max", "rotation_acceleration_max"]
        .map(|limit| interface.number(limit) * ACCELERATION_PART)
}

/// The measured pose of a base.
pub(crate) fn measured(net: &mut Net, name: &str) -> Port {
    monitor(net, name).out("outPos")
}

fn monitor(net: &mut Net, name: &str) -> Primitive {
    net.add("RobotBase::BaseMonitor", [("Robot", name.into())])
}

/// What a base is to do.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Task {
    To(Pose),
    /// At a velocity, m/s and rad/s, for a time.
    At([f64; 3], Duration),
}

/// A motion of a base.
#[derive(Clone, Debug)]
struct BaseMotion {
    name: String,
    interface: Interface,
    task: Task,
}

impl BaseMotion {
    /// The velocity, and whether it is to come to rest.
    fn lead(&self, net: &mut Net, requests: &Requests<'_>) -> (Port, Port) {
        match self.task {
            Task::To(pose) => {
                let [velocity, rotation] = limits(&self.interface).map(|it| it * requests.speed);
                let velocity = velocity * PART;
                // It brakes by gain times speed at most.
                let [acceleration, turning] = accelerations(&self.interface);
                let gain = GAIN.min(acceleration / velocity);
                let here = monitor(net, &self.name);
                let to = net.frame(&pose);
                let lead = [
                    ("inDest", (&to).into()),
                    ("inPos", (&here.out("outPos")).into()),
                    ("velX", velocity.into()),
                    ("velY", velocity.into()),
                    ("velYaw", rotation.into()),
                    ("pX", gain.into()),
                    ("pY", gain.into()),
                    ("pYaw", GAIN.min(turning / rotation).into()),
                ];
                let lead = net.add("RobotBase::OmnidirectionalBaseController", lead);
                let over = net.override_in();
                let slowed = [
                    ("inValue", (&lead.out("outVel")).into()),
                    ("inFactor", (&over).into()),
                ];
                let slowed = net.add("World::TwistScale", slowed).out("outValue");
                (slowed, lead.out("outCompleted"))
            }
            Task::At(velocity, duration) => {
                let over = net.override_in();
                let [x, y, turn] = velocity.map(|part| {
                    let scaled = part * requests.speed;
                    let scaled = [("inFirst", (&over).into()), ("Second", scaled.into())];
                    net.add("Core::DoubleMultiply", scaled).out("outValue")
                });
                let twist = [
                    ("inX", (&x).into()),
                    ("inY", (&y).into()),
                    ("inA", (&turn).into()),
                ];
                let twist = net.add("World::TwistFromXYZ", twist).out("outValue");
                let time = net.add("Core::Clock", []).out("outValue");
                let duration = duration.as_secs_f64();
                let late = [("inFirst", (&time).into()), ("Second", duration.into())];
                (twist, net.add("Core::DoubleGreater", late).out("outValue"))
            }
        }
    }

    /// The next velocity on the way to the wanted one, within the accelerations.
    fn approach(&self, net: &mut Net, wanted: &Port) -> Port {
        let now = monitor(net, &self.name).out("outCmdVel");
        // A base that reports none was commanded none.
        let unknown = net.of("World::TwistIsNull", &now);
        let now = net.zero_if("World::Twist", &unknown, &now);
        let [wanted, now] = [wanted, &now]
            .map(|twist| net.add("World::TwistToVelocities", [("inValue", twist.into())]));
        let period = net.add("Core::CycleTime", []).out("outValue");
        let ports = [("outTransVel", "inTransVel"), ("outRotVel", "inRotVel")];
        let mut next = Vec::new();
        for ((part, name), limit) in ports.into_iter().zip(accelerations(&self.interface)) {
            let (wanted, now) = (wanted.out(part), now.out(part));
            let change = net.of_two("World::VectorSubtract", &wanted, &now);
            let most = net.scaled(&period, limit);
            let change = [("inValue", (&change).into()), ("inMax", (&most).into())];
            let change = net.add("World::VectorClamp", change).out("outValue");
            let sum = net.of_two("World::VectorAdd", &now, &change);
            next.push((name, (&sum).into()));
        }
        net.add_with("World::TwistFromVelocities", &next)
            .out("outValue")
    }

    /// Whether the base is measured at rest.
    fn rests(&self, net: &mut Net) -> Port {
        let velocity = monitor(net, &self.name).out("outVel");
        let parts = net.add(
            "World::TwistToVelocities",
            [("inValue", (&velocity).into())],
        );
        let [slow, steady] = ["outTransVel", "outRotVel"].map(|part| {
            let speed = net.of("World::VectorLength", &parts.out(part));
            let under = [("First", REST.into()), ("inSecond", (&speed).into())];
            net.add("Core::DoubleGreater", under).out("outValue")
        });
        net.of_two("Core::BooleanAnd", &slow, &steady)
    }
}

impl Operation for BaseMotion {
    fn devices(&self) -> Vec<String> {
        vec![self.name.clone()]
    }

    fn check(&self) -> Result<(), ErrorKind> {
        let invalid = |what: String| Err(ErrorKind::Invalid(format!("{}: {what}", self.name)));
        let (velocity, duration) = match self.task {
            Task::To(pose) if !pose.is_finite() => {
                return invalid("the pose is not finite".to_owned());
            }
            Task::To(_) => return Ok(()),
            Task::At(velocity, duration) => (velocity, duration),
        };
        let [x, y, turn] = velocity;
        let [velocity_max, rotation_max] = limits(&self.interface);
        let speed = x.hypot(y);
        if !(0.0..=velocity_max).contains(&speed) {
            let text =
                format!("the speed is {speed} m/s; it is finite and at most {velocity_max} m/s");
            return invalid(text);
        }
        if !(0.0..=rotation_max).contains(&turn.abs()) {
            let text =
                format!("the turn is {turn} rad/s; it is finite and at most {rotation_max} rad/s");
            return invalid(text);
        }
        if duration.is_zero() || duration.as_secs_f64() > DRIVE_MAX_S {
            return invalid(format!(
                "it drives for {duration:?}; it is above 0 s, at most 3600 s"
            ));
        }
        Ok(())
    }

    fn needs_begins(&self) -> bool {
        false
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let name = &self.name;
        let (lead, arrived) = self.lead(net, requests);
        let arrived = net.known(&arrived);
        let halts = net.of_two("Core::BooleanOr", &arrived, &requests.stop);
        let rest = net.add("World::TwistValue", []).out("outValue");
        let velocity = [
            ("inCondition", (&halts).into()),
            ("inTrue", (&rest).into()),
            ("inFalse", (&lead).into()),
        ];
        let velocity = net.add("World::TwistConditional", velocity).out("outValue");
        let velocity = self.approach(net, &velocity);
        let command = [
            ("inVel", (&velocity).into()),
            ("Robot", name.as_str().into()),
        ];
        let command = net.add("RobotBase::BaseVelocity", command);
        let rests = self.rests(net);
        let rests = net.known(&rests);
        let failed = "the base does not follow its commands\nhint: `takt run` and the page say whether it is online";
        Ok(Ports {
            done: net.of_two("Core::BooleanAnd", &halts, &rests),
            progress: None,
            failures: vec![
                (
                    Failure::conflict(name),
                    command.out("outErrorConcurrentAccess"),
                ),
                (
                    Failure::of("failed", name, failed),
                    command.out("outErrorBaseFailed"),
                ),
                (
                    Failure::of(
                        "illegal",
                        name,
                        "the velocity is beyond the limits of the base",
                    ),
                    command.out("outErrorIllegalVelocity"),
                ),
            ],
            results: Vec::new(),
            fault: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::order::text_of;

    fn motion(task: Task) -> BaseMotion {
        let limits = [
            ("velocity_max", 0.8),
            ("rotation_max", 0.6),
            ("acceleration_max", 0.4),
            ("rotation_acceleration_max", 4.0),
        ];
        BaseMotion {
            name: "platform".to_owned(),
            interface: Interface::with("robotbase", limits),
            task,
        }
    }

    #[test]
    fn pose_is_approached_within_the_limits() {
        let text = text_of(motion(Task::To(Pose::xyz(1.0, 0.5, 0.0)))).unwrap();
        // Half of the limit at half of the speed.
        assert!(
            text.contains("velX='0.2', velY='0.2', velYaw='0.3'"),
            "{text}"
        );
        // By what it can brake, and at most 3/s.
        assert!(text.contains("pX='1.8', pY='1.8', pYaw='3'"), "{text}");
        assert!(
            text.contains("inTrue=") && text.contains("First='0.005'"),
            "{text}"
        );
        // The override changes the speed, within the acceleration.
        assert!(text.contains("Key='override'") && text.contains("World::TwistScale("));
    }

    #[test]
    fn velocity_ends_after_its_duration() {
        let text = text_of(motion(Task::At(
            [0.8, 0.0, 0.2],
            Duration::from_millis(300),
        )))
        .unwrap();
        assert!(text.contains("Second='0.4'"), "{text}");
        assert!(text.contains("Second='0.3'"), "{text}");
        assert!(text.contains("Key='override'"), "{text}");
    }

    #[test]
    fn velocity_beyond_the_limits_is_invalid() {
        let second = Duration::from_secs(1);
        let wrong = [
            Task::At([0.6, 0.6, 0.0], second),
            Task::At([0.0, 0.0, -0.61], second),
            Task::At([f64::NAN, 0.0, 0.0], second),
            Task::At([0.0, 0.0, f64::NAN], second),
            Task::At([0.1, 0.0, 0.0], Duration::ZERO),
            Task::At([0.1, 0.0, 0.0], Duration::from_secs(3601)),
            Task::To(Pose::xyz(f64::NAN, 0.0, 0.0)),
        ];
        for task in wrong {
            let error = text_of(motion(task)).unwrap_err();
            assert!(matches!(error, ErrorKind::Invalid(_)), "{error}");
        }
    }
}

//! Grippers: fingers that move to a distance (KUKA youBot), and grippers that execute commands of their own and measure
//! their force (Schunk WSG). A command has a time-out; a cancelled one stops the fingers where they are.

use std::sync::Arc;
use std::time::Duration;

use crate::activity::Activity;
use crate::description::{Descriptions, Interface};
use crate::engine::Failure;
use crate::error::{Error, ErrorKind};
use crate::expression::{Condition, Number};
use crate::net::{Net, Port, Primitive};
use crate::order::{Operation, Ports, Requests, Speed};
use crate::session::Session;

/// Interface of a gripper whose fingers move to a distance.
const FINGERS: &str = "gripper";

/// Interface of a gripper with commands of its own.
const SERVO: &str = "servogripper";

/// Relative speed of the fingers of a gripper with commands of its own, m/s, at the speed 1.
const SPEED: f64 = 0.2;

/// Time-out of a command at the speed 1.
const TIMEOUT: Duration = Duration::from_secs(5);

/// A gripper of a cell. Widths are distances between its fingers, m. Clones are the same gripper with speeds and time-outs
/// of their own.
#[derive(Clone, Debug)]
pub struct Gripper {
    session: Arc<Session>,
    name: String,
    interface: Interface,
    speed: Speed,
    timeout: Duration,
}

impl Gripper {
    pub(crate) fn find(session: &Arc<Session>, name: &str) -> Result<Self, ErrorKind> {
        let devices = Descriptions::read(session)?;
        let interface = devices.interface(name, "gripper", &[FINGERS, SERVO])?;
        Ok(Self::new(session, name.to_owned(), interface))
    }

    fn new(session: &Arc<Session>, name: String, interface: Interface) -> Self {
        Self {
            session: Arc::clone(session),
            name,
            interface,
            speed: Speed::FULL,
            timeout: TIMEOUT,
        }
    }

    /// All grippers of a cell.
    pub(crate) fn all(session: &Arc<Session>) -> Result<Vec<Self>, ErrorKind> {
        let devices = Descriptions::read(session)?.with_interface(&[FINGERS, SERVO]);
        let devices = devices.into_iter();
        let gripper = |(name, interface)| Self::new(session, name, interface);
        Ok(devices.map(gripper).collect())
    }

    /// Its device type, such as `schunk_wsg`.
    pub fn kind(&self) -> &str {
        &self.interface.kind
    }

    /// The largest width, m; `None` if only the gripper itself knows it.
    pub fn width_max(&self) -> Option<f64> {
        (self.interface.name == FINGERS).then(|| self.interface.number("width_max"))
    }

    /// Its name in the cell.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The same gripper, slower: the speed of its commands is multiplied by `factor`, above 0 to 1. At 1 the fingers of a
    /// gripper with commands of its own move at 0.2 m/s. Fingers that only move to a distance have one speed.
    #[must_use]
    pub fn with_speed(mut self, factor: f64) -> Self {
        self.speed = self.speed.times(factor);
        self
    }

    /// The same gripper with another time-out, at the speed 1; by default 5 s. At less speed it is as much longer.
    #[must_use]
    pub const fn with_timeout(mut self, timeout: Duration) -> Self {
        self.timeout = timeout;
        self
    }

    /// Opens it wide. A gripper with commands of its own moves to its outer end stop, from which it counts: it needs that
    /// once after it was switched on.
    pub fn open(&self) -> Activity {
        self.activity(Task::Open)
    }

    /// Closes it without a part. It fails if a gripper with commands of its own is blocked by one.
    pub fn close(&self) -> Activity {
        self.move_to(0.0)
    }

    /// Moves the fingers to a width, m.
    pub fn move_to(&self, width: f64) -> Activity {
        self.activity(Task::Move { width })
    }

    /// Grips a part of a width, m, with at most a force, N; fails if there is none. Only grippers with commands of their
    /// own can: they keep the force up when the activity has ended. Release the part by [`Self::move_to`] or
    /// [`Self::open`].
    pub fn grasp(&self, width: f64, force: f64) -> Activity {
        self.activity(Task::Grasp { width, force })
    }

    fn activity(&self, task: Task) -> Activity {
        let motion = Grip {
            name: self.name.clone(),
            interface: self.interface.clone(),
            task,
            timeout: self.timeout,
        };
        Activity::new(&self.session, motion, self.speed)
    }

    /// The measured width, m, as an expression.
    pub fn width(&self) -> Number {
        if self.interface.name == SERVO {
            return self.monitor("outOpeningWidth");
        }
        let parameters = vec![("Robot", self.name.clone())];
        Number::sensor("KUKA::youBot::GripperMonitor", parameters, "outDistance")
    }

    /// The measured gripping force, N, as an expression.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if the gripper does not measure it.
    #[track_caller]
    pub fn force(&self) -> Result<Number, Error> {
        self.needs_servo()?;
        Ok(self.monitor("outForce"))
    }

    /// Whether it holds a part.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if the gripper does not know it.
    #[track_caller]
    pub fn holds(&self) -> Result<Condition, Error> {
        self.needs_servo()?;
        // The state is a whole number; 4 is holding.
        let state = self.monitor("outGraspingState");
        Ok((state - 4.0).abs().under(0.5))
    }

    /// Requests that what the gripper does end, and everything that waits for it.
    pub fn cancel(&self) {
        self.session.cancel_device(&self.name);
    }

    fn monitor(&self, port: &'static str) -> Number {
        let parameters = vec![("Device", self.name.clone())];
        Number::sensor("schunkwsg::Monitor", parameters, port)
    }

    fn needs_servo(&self) -> Result<(), ErrorKind> {
        if self.interface.name == SERVO {
            return Ok(());
        }
        Err(no_force(&self.name))
    }
}

fn no_force(name: &str) -> ErrorKind {
    let text =
        "it neither measures nor limits its force\nhint: `move_to` moves its fingers to a width";
    ErrorKind::Invalid(format!("{name}: {text}"))
}

/// What a gripper is to do.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Task {
    Open,
    Move { width: f64 },
    Grasp { width: f64, force: f64 },
}

/// A command to a gripper.
#[derive(Clone, Debug)]
struct Grip {
    name: String,
    interface: Interface,
    task: Task,
    timeout: Duration,
}

/// Status codes of grippers with commands of their own, and what they mean; every other one is a refusal.
const STATUSES: [(i32, &str); 5] = [
    (18, "it found no part of this width"),
    (19, "another command took the place of this one"),
    (28, "the width or the speed is out of its range"),
    (29, "the fingers are blocked\nhint: `grasp` grips a part"),
    (
        31,
        "it does not execute commands\nhint: `takt run` and the page say why it is offline",
    ),
];

impl Grip {
    fn is_servo(&self) -> bool {
        self.interface.name == SERVO
    }

    /// A command of a gripper that executes its own.
    fn command(&self, net: &mut Net, requests: &Requests<'_>, after: Option<&Port>) -> Primitive {
        let speed = ("Speed", (SPEED * requests.speed).into());
        let (kind, mut arguments) = match self.task {
            Task::Open => ("schunkwsg::Homing", vec![("Direction", "true".into())]),
            Task::Move { width } => {
                let arguments = vec![
                    ("Width", width.into()),
                    speed,
                    ("RelativeMotion", "false".into()),
                    ("StopOnBlock", "true".into()),
                ];
                ("schunkwsg::Prepositioning", arguments)
            }
            Task::Grasp { width, .. } => {
                ("schunkwsg::Grasping", vec![("Width", width.into()), speed])
            }
        };
        arguments.push(("Device", self.name.as_str().into()));
        arguments.extend(after.map(|after| ("inActive", after.into())));
        net.add_with(kind, &arguments)
    }

    /// Whether a command has succeeded; adds why it can fail.
    fn judge(
        &self,
        net: &mut Net,
        command: &Primitive,
        failures: &mut Vec<(Failure, Port)>,
        key: &str,
    ) -> Port {
        let status = command.out("outStatusCode");
        let mut is = |code: i32| {
            let equals = [
                ("inFirst", (&status).into()),
                ("Second", code.to_string().into()),
            ];
            let equals = net.add("Core::IntEquals", equals).out("outValue");
            net.known(&equals)
        };
        let done = is(0);
        for (code, cause) in STATUSES {
            let failure = Failure::of(&format!("{key}_{code}"), &self.name, cause);
            failures.push((failure, is(code)));
        }
        let taken = Failure {
            key: format!("{key}_32"),
            ..Failure::conflict(&self.name)
        };
        failures.push((taken, is(32)));
        let finished = net.known(&command.out("outFinished"));
        let not_done = net.of("Core::BooleanNot", &done);
        let refused = net.of_two("Core::BooleanAnd", &finished, &not_done);
        let cause = "the gripper refused the command";
        let refusal = Failure::of(&format!("{key}_refused"), &self.name, cause);
        failures.push((refusal, refused));
        done
    }

    fn servo(&self, net: &mut Net, requests: &Requests<'_>) -> (Port, Vec<(Failure, Port)>) {
        let mut failures = Vec::new();
        let mut limited = None;
        if let Task::Grasp { force, .. } = self.task {
            let limit = [
                ("Force", force.into()),
                ("Device", self.name.as_str().into()),
            ];
            let limit = net.add("schunkwsg::SetForceLimit", limit);
            limited = Some(self.judge(net, &limit, &mut failures, "limit"));
        }
        let command = self.command(net, requests, limited.as_ref());
        let done = self.judge(net, &command, &mut failures, "grip");
        (done, failures)
    }

    fn fingers(&self, net: &mut Net) -> Port {
        let width = match self.task {
            Task::Open => self.interface.number("width_max"),
            Task::Move { width } | Task::Grasp { width, .. } => width,
        };
        let fingers = [
            ("Distance", width.into()),
            ("Robot", self.name.as_str().into()),
        ];
        let done = net.add("KUKA::youBot::Gripper", fingers);
        net.known(&done.out("outCompleted"))
    }
}

impl Operation for Grip {
    fn devices(&self) -> Vec<String> {
        vec![self.name.clone()]
    }

    fn check(&self) -> Result<(), ErrorKind> {
        let name = &self.name;
        let invalid = |what: String| Err(ErrorKind::Invalid(format!("{name}: {what}")));
        if self.timeout.is_zero() {
            return invalid("the time-out is 0 s; it is above 0".to_owned());
        }
        let width = match self.task {
            Task::Open => return Ok(()),
            Task::Grasp { .. } if !self.is_servo() => return Err(no_force(name)),
            Task::Grasp { force, .. } if !(force > 0.0 && force.is_finite()) => {
                return invalid(format!("the force is {force} N; it is above 0"));
            }
            Task::Move { width } | Task::Grasp { width, .. } => width,
        };
        let widest = if self.is_servo() {
            f64::MAX
        } else {
            self.interface.number("width_max")
        };
        if (0.0..=widest).contains(&width) {
            return Ok(());
        }
        let range = if self.is_servo() {
            "it is finite and from 0".to_owned()
        } else {
            format!("it is from 0 to {widest} m")
        };
        invalid(format!("the width is {width} m; {range}"))
    }

    fn needs_begins(&self) -> bool {
        false
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let (done, mut failures) = if self.is_servo() {
            self.servo(net, requests)
        } else {
            (self.fingers(net), Vec::new())
        };
        let limit = self.timeout.as_secs_f64() / requests.speed;
        let time = net.add("Core::Clock", []).out("outValue");
        let late = [("inFirst", (&time).into()), ("Second", limit.into())];
        let late = net.add("Core::DoubleGreater", late).out("outValue");
        let cause = format!(
            "the fingers are not where they should be after {limit} s\nhint: a part or an end stop is in the way, or the \
             gripper is offline"
        );
        failures.push((Failure::of("late", &self.name, &cause), late));
        Ok(Ports {
            // The fingers stop with the end of the net.
            done: net.of_two("Core::BooleanOr", &done, &requests.stop),
            progress: None,
            failures,
            results: Vec::new(),
            fault: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::order::text_of;

    fn grip(interface: &'static str, task: Task) -> Grip {
        Grip {
            name: "hand".to_owned(),
            interface: Interface::with(interface, [("width_max", 0.023)]),
            task,
            timeout: TIMEOUT,
        }
    }

    #[test]
    fn fingers_move_to_a_width_with_a_time_out() {
        let text = text_of(grip(FINGERS, Task::Open)).unwrap();
        assert!(
            text.contains("Gripper(Distance='0.023', Robot='hand')"),
            "{text}"
        );
        // At half of the speed.
        assert!(text.contains("Second='10'"), "{text}");
    }

    #[test]
    fn grasp_begins_when_its_force_is_limited() {
        let grasp = Task::Grasp {
            width: 0.05,
            force: 30.0,
        };
        let text = text_of(grip(SERVO, grasp)).unwrap();
        assert!(
            text.contains("SetForceLimit(Force='30', Device='hand')"),
            "{text}"
        );
        let grasping = "Grasping(Width='0.05', Speed='0.1', Device='hand', inActive=p";
        assert!(text.contains(grasping), "{text}");
    }

    #[test]
    fn width_or_force_out_of_range_is_invalid() {
        let grasp = |force| Task::Grasp { width: 0.02, force };
        let width = |width| Task::Move { width };
        let wrong = [
            (FINGERS, grasp(10.0)),
            (FINGERS, width(0.024)),
            (FINGERS, width(-0.001)),
            (SERVO, width(f64::NAN)),
            (SERVO, width(f64::INFINITY)),
            (SERVO, grasp(0.0)),
            (SERVO, grasp(f64::NAN)),
        ];
        for (interface, task) in wrong {
            let error = text_of(grip(interface, task)).unwrap_err();
            assert!(matches!(error, ErrorKind::Invalid(_)), "{error}");
        }
    }
}

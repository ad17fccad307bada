//! A connection to the controller of a cell, and the threads around the [engine](crate::engine): programs call from any
//! thread; one thread receives what the controller reports. No lock is held while a program or a call waits.

use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::task::Waker;
use std::time::{Duration, Instant};

use takt_client::{Client, Message, Token, Value};

use crate::arm::{Arm, REST_TIMEOUT};
use crate::engine::{Action, ActivityId, Engine, GroupId, Start, State, When};
use crate::error::Error;
use crate::motion::{ArmDescription, JointLimits, Order};

/// Least time between two reports of one value of a net. Results are reported with the end of the net in any case.
const REFRESH: f64 = 0.05;

/// How often the receiver checks whether the program still uses the connection.
const RECEIVE_SLICE: Duration = Duration::from_millis(200);

/// Ratio of jerk to acceleration where the controller knows no jerk limit, 1/s: full acceleration after 0.1 s.
const JERK_PER_ACCELERATION: f64 = 10.0;

/// The controller of a cell. Clones share the connection, and the activities belong to it: when the last clone, arm and
/// handle is gone, or the program dies, the controller cancels them, and aborts what does not end.
#[derive(Clone, Debug)]
pub struct Cell {
    session: Arc<Session>,
}

impl Cell {
    /// Connects to a controller: `host:port`, or the path of its Unix socket.
    ///
    /// # Errors
    /// If no controller listens there, or it requires a token.
    pub fn connect(address: &str) -> Result<Self, Error> {
        Self::connect_with(address, None)
    }

    /// The same with a token.
    ///
    /// # Errors
    /// As [`Self::connect`].
    pub fn connect_with(address: &str, token: Option<&Token>) -> Result<Self, Error> {
        Self::begin(Client::connect_with(address, token)?)
    }

    /// Connects to the controller of this host.
    ///
    /// # Errors
    /// As [`Self::connect`].
    pub fn connect_here(token: Option<&Token>) -> Result<Self, Error> {
        Self::begin(Client::connect_here(token)?)
    }

    fn begin(client: Client) -> Result<Self, Error> {
        let session = client.call("nse", ["takt-api", "end"])?;
        let session = Arc::new(Session {
            id: session.text().unwrap_or_default().to_owned(),
            client: client.clone(),
            engine: Mutex::default(),
            subjects: Mutex::default(),
            wakers: Mutex::default(),
            changed: Condvar::new(),
        });
        let receiver = Arc::downgrade(&session);
        // The receiver does not keep the session: the program's last reference ends it.
        let receive = move || loop {
            let next = client.next_push(RECEIVE_SLICE);
            let Some(session) = receiver.upgrade() else {
                return;
            };
            match next {
                Ok(Some(push)) => session.handle(push),
                Ok(None) => {}
                Err(error) => return session.lose(&error.into()),
            }
        };
        let thread = std::thread::Builder::new()
            .name("takt-api".to_owned())
            .spawn(receive);
        thread.map_err(|error| Error::Connection(format!("cannot start a thread: {error}")))?;
        Ok(Self { session })
    }

    /// An arm by its name.
    ///
    /// # Errors
    /// If the controller has no arm of that name; the error lists those that it has.
    pub fn arm(&self, name: &str) -> Result<Arm, Error> {
        let mut arms = self.arms()?;
        let at = arms.iter().position(|arm| arm.description().name == name);
        at.map(|at| arms.swap_remove(at)).ok_or_else(|| {
            let known: Vec<_> = arms
                .iter()
                .map(|arm| arm.description().name.clone())
                .collect();
            Error::NoDevice {
                wanted: "arm",
                name: name.to_owned(),
                known: if known.is_empty() {
                    "none".to_owned()
                } else {
                    known.join(", ")
                },
            }
        })
    }

    /// All arms.
    ///
    /// # Errors
    /// If the connection is lost.
    pub fn arms(&self) -> Result<Vec<Arm>, Error> {
        let reply = self.session.client.call("din", [] as [&str; 0])?;
        let Some(Value::Map(devices)) = reply.values.into_iter().next() else {
            return Ok(Vec::new());
        };
        let arms = devices
            .into_iter()
            .filter_map(|(name, device)| describe(name, &device));
        Ok(arms
            .map(|arm| Arm::new(Arc::clone(&self.session), arm))
            .collect())
    }

    /// Cancels everything that this program began, waits until it is at rest, and ends the session.
    ///
    /// # Errors
    /// If the connection is lost, or something still moves after ten seconds; the session is ended in any case.
    pub fn close(self) -> Result<(), Error> {
        let arms = self.arms()?;
        for arm in &arms {
            arm.cancel();
        }
        let until = Instant::now() + REST_TIMEOUT;
        let busy = |engine: &Engine| {
            let mut names = arms.iter().map(|arm| &arm.description().name);
            names.find(|name| engine.latest(name).is_some()).cloned()
        };
        let rested = self.session.wait_until(until, |session| {
            busy(&session.engine()).is_none().then_some(())
        });
        let moving = rested
            .is_none()
            .then(|| busy(&self.session.engine()))
            .flatten();
        self.session
            .client
            .call("ase", [self.session.id.as_str()])?;
        moving.map_or(Ok(()), |device| {
            let reason =
                "it did not come to rest after its cancellation and was aborted".to_owned();
            Err(Error::Ended { device, reason })
        })
    }
}

/// The arm of a device's description, if it is one.
fn describe(name: String, device: &Value) -> Option<ArmDescription> {
    let members = device.as_map()?;
    let text = |key: &str| members.get(key).and_then(Value::as_str);
    let joint = |joint: &Value| {
        let members = joint.as_map()?;
        let number = |key: &str| {
            members
                .get(key)
                .and_then(Value::as_str)?
                .parse::<f64>()
                .ok()
        };
        let acceleration = number("acceleration_max")?;
        Some(JointLimits {
            position_min: number("position_min")?,
            position_max: number("position_max")?,
            velocity: number("velocity_max")?,
            acceleration,
            jerk: acceleration * JERK_PER_ACCELERATION,
        })
    };
    let joints: Option<Vec<_>> = members
        .get("joints")?
        .as_list()?
        .iter()
        .map(joint)
        .collect();
    Some(ArmDescription {
        name,
        kind: text("type").unwrap_or_default().to_owned(),
        joints: joints.filter(|joints| !joints.is_empty())?,
        period: Duration::from_secs_f64(text("period")?.parse().ok()?),
    })
}

/// The connection with its activities.
#[derive(Debug)]
pub(crate) struct Session {
    id: String,
    client: Client,
    engine: Mutex<Engine>,
    subjects: Mutex<Subjects>,
    wakers: Mutex<Vec<Waker>>,
    /// Notified after each change of the engine.
    changed: Condvar,
}

/// What the tags of pushes stand for. The lock is held while a push is handled, so that pushes of one subject are handled
/// in their order.
#[derive(Debug, Default)]
struct Subjects {
    known: BTreeMap<String, Subject>,
    /// Pushes whose subscription was not yet confirmed.
    early: Vec<Message>,
}

#[derive(Clone, Debug)]
enum Subject {
    Net(String),
    Rule(String),
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Session {
    pub(crate) fn engine(&self) -> MutexGuard<'_, Engine> {
        lock(&self.engine)
    }

    /// Begins activities together.
    pub(crate) fn begin(&self, orders: &[Order], when: When) -> Result<Vec<ActivityId>, Error> {
        orders.iter().try_for_each(Order::check)?;
        let start = |order: &Order| Start {
            device: order.arm.name.clone(),
            net: order.net(),
            results: order.results(),
        };
        let starts = orders.iter().map(start).collect();
        let begun = self.engine().begin(starts, when);
        self.perform();
        begun
    }

    /// Waits until activities run, or ended.
    pub(crate) fn wait_for_begin(&self, ids: &[ActivityId]) -> Result<(), Error> {
        let until = Instant::now() + Duration::from_secs(u64::from(u32::MAX));
        let begun = self.wait_until(until, |session| {
            let engine = session.engine();
            let mut states = ids.iter().map(|id| engine.state(*id));
            if let Some(error) = states.clone().find_map(|state| match state {
                Some(State::Ended(Err(error))) => Some(error.clone()),
                _ => None,
            }) {
                return Some(Err(error));
            }
            let begun = |state: Option<&State>| {
                state.is_none_or(|state| matches!(state, State::Running | State::Ended(_)))
            };
            states.all(begun).then_some(Ok(()))
        });
        begun.unwrap_or(Ok(()))
    }

    /// Waits until a device has no activity.
    pub(crate) fn wait_for_rest(&self, device: &str) -> Result<(), Error> {
        let until = Instant::now() + Duration::from_secs(u64::from(u32::MAX));
        self.wait_until(until, |session| {
            session.engine().latest(device).is_none().then_some(())
        });
        self.engine().lost().map_or(Ok(()), Err)
    }

    /// Polls after each change until there is a result, or the deadline.
    pub(crate) fn wait_until<T>(
        &self,
        until: Instant,
        mut poll: impl FnMut(&Self) -> Option<T>,
    ) -> Option<T> {
        loop {
            let revision = self.engine().revision();
            if let Some(found) = poll(self) {
                return Some(found);
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            let engine = self.engine();
            if engine.revision() == revision {
                drop(
                    self.changed
                        .wait_timeout(engine, left.min(Duration::from_secs(1))),
                );
            }
        }
    }

    /// Wakes a task at the next change.
    pub(crate) fn wake_on_change(&self, waker: &Waker) {
        let mut wakers = lock(&self.wakers);
        if !wakers.iter().any(|known| known.will_wake(waker)) {
            wakers.push(waker.clone());
        }
    }

    pub(crate) fn cancel(&self, ids: &[ActivityId]) {
        let mut engine = self.engine();
        ids.iter().for_each(|id| engine.cancel(*id));
        drop(engine);
        self.perform();
    }

    /// Cancels what a device does and what waits for it.
    pub(crate) fn cancel_device(&self, device: &str) {
        self.engine().cancel_device(device);
        self.perform();
    }

    pub(crate) fn release(&self, ids: &[ActivityId]) {
        let mut engine = self.engine();
        ids.iter().for_each(|id| engine.release(*id));
        drop(engine);
        self.perform();
    }

    /// One cycle of a net with the present state of the devices: its out values by key.
    pub(crate) fn evaluate(&self, net: &str) -> Result<BTreeMap<String, String>, Error> {
        let reply = self.client.call("eva", [net])?;
        let Some(Value::Map(values)) = reply.values.into_iter().next() else {
            return Ok(BTreeMap::new());
        };
        let text = |(key, value): (String, Value)| Some((key, value.as_str()?.to_owned()));
        Ok(values.into_iter().filter_map(text).collect())
    }

    /// Requests what the engine wants, until it wants nothing more.
    fn perform(&self) {
        loop {
            let actions = self.engine().take_actions();
            if actions.is_empty() {
                break;
            }
            for action in actions {
                self.perform_one(action);
            }
        }
        self.notify();
    }

    fn notify(&self) {
        self.changed.notify_all();
        for waker in std::mem::take(&mut *lock(&self.wakers)) {
            waker.wake();
        }
    }

    fn perform_one(&self, action: Action) {
        match action {
            Action::Load { activity, net } => {
                let loaded = self.load(&net);
                self.engine().loaded(activity, loaded);
            }
            Action::Schedule {
                group,
                condition,
                stop,
                start,
            } => {
                self.schedule(group, &condition, &stop, &start);
            }
            // Both fail only for a net that is already gone, or with the connection, which the receiver reports.
            Action::Cancel(net) => drop(self.client.call("neca", [net])),
            Action::Unload(net) => drop(self.client.call("neun", [net])),
        }
    }

    /// Loads a net and subscribes to it.
    fn load(&self, text: &str) -> Result<String, Error> {
        let reply = self
            .client
            .call("nene", [text, self.id.as_str(), "takt-api"])?;
        let net = reply.text().unwrap_or_default().to_owned();
        let (state, faults) = self.inspect(&net)?;
        if state == "REJECTED" {
            self.client.call("neun", [net.as_str()])?;
            return Err(Error::Rejected(faults));
        }
        let arguments = [net.as_str().into(), REFRESH.into(), Value::from("every")];
        let tag = self.client.call("gne", arguments)?.tag;
        self.subscribe(tag, Subject::Net(net.clone()));
        Ok(net)
    }

    /// State of a net, and its faults or the reason of its end.
    fn inspect(&self, net: &str) -> Result<(String, Vec<String>), Error> {
        let reply = self.client.call("nin", [net])?;
        let info = reply
            .values
            .first()
            .and_then(Value::as_map)
            .and_then(|nets| nets.get(net));
        let Some(info) = info.and_then(Value::as_map) else {
            return Ok((String::new(), Vec::new()));
        };
        let text = |key: &str| {
            info.get(key)
                .and_then(Value::as_str)
                .unwrap_or_default()
                .to_owned()
        };
        let faults = info
            .get("rejection")
            .and_then(Value::as_list)
            .unwrap_or_default();
        let mut lines: Vec<_> = faults
            .iter()
            .filter_map(Value::as_str)
            .map(str::to_owned)
            .collect();
        lines.extend(Some(text("end")).filter(|end| !end.is_empty()));
        Ok((text("state"), lines))
    }

    fn schedule(&self, group: GroupId, condition: &str, stop: &[String], start: &[String]) {
        let nets = |nets: &[String]| Value::list_of(nets.iter().map(String::as_str));
        let arguments = [
            Value::from(condition),
            nets(stop),
            nets(&[]),
            nets(start),
            Value::from("takt-api"),
        ];
        let rule = self.client.call("nesc", arguments).map_err(Error::from);
        let rule = rule.map(|reply| reply.text().unwrap_or_default().to_owned());
        self.engine().scheduled(group, rule.clone());
        if let Ok(rule) = rule
            && let Ok(reply) = self.client.call("gsy", [rule.as_str()])
        {
            self.subscribe(reply.tag, Subject::Rule(rule));
        }
    }

    /// Handles the pushes of a subscription from now on, those first that came before its reply.
    fn subscribe(&self, tag: String, subject: Subject) {
        let mut subjects = lock(&self.subjects);
        let early = std::mem::take(&mut subjects.early);
        let (mine, others): (Vec<_>, Vec<_>) = early.into_iter().partition(|push| push.tag == tag);
        subjects.early = others;
        subjects.known.insert(tag, subject);
        for push in mine {
            self.handle_in(&mut subjects, push);
        }
    }

    /// Handles a push, and requests what follows from it.
    fn handle(&self, push: Message) {
        self.handle_in(&mut lock(&self.subjects), push);
        self.perform();
    }

    fn handle_in(&self, subjects: &mut Subjects, push: Message) {
        let Some(subject) = subjects.known.get(&push.tag).cloned() else {
            subjects.early.push(push);
            return;
        };
        match (subject, push.command.as_str(), push.args.first()) {
            (Subject::Net(net), "ns", Some(Value::String(state))) => {
                let ended = state == "TERMINATED";
                let reason = if ended {
                    self.inspect(&net).map(|(_, lines)| lines.join("; "))
                } else {
                    Ok(String::new())
                };
                self.engine()
                    .net_state(&net, state, &reason.unwrap_or_default());
                if state == "UNLOADED" {
                    subjects.known.remove(&push.tag);
                }
            }
            (Subject::Net(net), "nc", Some(Value::Map(values))) => {
                let mut engine = self.engine();
                for (key, text) in values {
                    let key = key.strip_prefix("out").unwrap_or(key);
                    engine.value(&net, key, text.as_str().unwrap_or_default());
                }
            }
            (Subject::Rule(rule), "rs", Some(Value::String(state))) => {
                self.engine().rule_state(&rule, state);
                if state != "ACTIVE" {
                    subjects.known.remove(&push.tag);
                }
            }
            _ => {}
        }
    }

    /// The connection ended.
    fn lose(&self, error: &Error) {
        self.engine().lose(error);
        self.notify();
    }
}

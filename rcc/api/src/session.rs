//! A connection to a controller, and the threads around the [engine](crate::engine): programs call from any thread; one
//! thread receives what the controller reports. No lock is held while a program or a call waits.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::task::Waker;
use std::time::{Duration, Instant};

use takt_client::{Client, Message, Reply, Value};

use crate::engine::{Action, ActivityId, Engine, GroupId, Part};
use crate::error::ErrorKind;
use crate::preparation::{Goals, KnownGoals};
use crate::program;

/// Least time between two reports of one value of a net. Results are reported with the end of the net in any case.
const REFRESH: f64 = 0.05;

/// Nets have the period of the controller's first net thread.
const CONTROLLER_PERIOD: f64 = 0.0;

/// Most pushes that wait for the reply to their subscription: a few of each one in progress.
const EARLY_MAX: usize = 4096;

/// How often the receiver checks whether the program still uses the connection.
const RECEIVE_SLICE: Duration = Duration::from_millis(200);

/// The connection with its activities.
#[derive(Debug)]
pub(crate) struct Session {
    id: String,
    /// What the controller knows the program by.
    program: String,
    client: Client,
    engine: Mutex<Engine>,
    subjects: Mutex<Subjects>,
    wakers: Mutex<Vec<Waker>>,
    /// Speed of all activities as part of their own, 0 to 1.
    speed: Mutex<f64>,
    goals: Mutex<KnownGoals>,
    /// Counts the stops: what was being prepared at one does not begin.
    stops: AtomicU64,
    /// Notified after each change of the engine.
    changed: Condvar,
    /// A controller in this program, which ends with the session.
    #[cfg(feature = "embedded")]
    embedded: Option<takt_embedded::Embedded>,
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
    /// A net that the controller rejected; it is unloaded at once.
    Rejected,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A deadline that no program reaches.
fn distant() -> Instant {
    Instant::now() + Duration::from_secs(u64::from(u32::MAX))
}

impl Session {
    /// Opens a session that ends with the connection, and starts the receiving thread.
    pub(crate) fn begin_with(client: Client) -> Result<Arc<Self>, ErrorKind> {
        Self::begin_at(
            client,
            #[cfg(feature = "embedded")]
            None,
        )
    }

    /// The same with a controller in this program, which ends with the session.
    #[cfg(feature = "embedded")]
    pub(crate) fn begin_embedded(
        client: Client,
        embedded: takt_embedded::Embedded,
    ) -> Result<Arc<Self>, ErrorKind> {
        Self::begin_at(client, Some(embedded))
    }

    fn begin_at(
        client: Client,
        #[cfg(feature = "embedded")] embedded: Option<takt_embedded::Embedded>,
    ) -> Result<Arc<Self>, ErrorKind> {
        let program = program::name();
        let session = client.call("nse", [program.as_str(), "end"])?;
        let session = Arc::new(Self {
            id: session.text().unwrap_or_default().to_owned(),
            program,
            client: client.clone(),
            engine: Mutex::default(),
            subjects: Mutex::default(),
            wakers: Mutex::default(),
            speed: Mutex::new(1.0),
            goals: Mutex::default(),
            stops: AtomicU64::new(0),
            changed: Condvar::new(),
            #[cfg(feature = "embedded")]
            embedded,
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
        thread.map_err(|error| ErrorKind::Connection(format!("cannot start a thread: {error}")))?;
        Ok(session)
    }

    /// The controller in this program.
    #[cfg(feature = "embedded")]
    pub(crate) const fn embedded(&self) -> Option<&takt_embedded::Embedded> {
        self.embedded.as_ref()
    }

    pub(crate) const fn client(&self) -> &Client {
        &self.client
    }

    /// Ends the session; the controller aborts what still runs.
    pub(crate) fn end(&self) -> Result<(), ErrorKind> {
        self.client.call("ase", [self.id.as_str()])?;
        Ok(())
    }

    pub(crate) fn engine(&self) -> MutexGuard<'_, Engine> {
        lock(&self.engine)
    }

    /// Counts the stops. What was described before a stop is not begun after it.
    pub(crate) fn stops(&self) -> u64 {
        self.stops.load(Ordering::SeqCst)
    }

    /// Begins parts in one call, cancelled if a stop came since `stops` were counted; `goals` are where each activity leaves
    /// its arms, as far as known.
    pub(crate) fn begin_all(
        &self,
        parts: Vec<Part>,
        goals: Vec<Vec<Goals>>,
        stops: u64,
    ) -> Result<Vec<Vec<ActivityId>>, ErrorKind> {
        let devices = |part: &Part| -> Vec<_> {
            let starts = part.starts.iter();
            starts.map(|start| start.devices.clone()).collect()
        };
        let devices: Vec<_> = parts.iter().map(devices).collect();
        let mut engine = self.engine();
        let begun = engine.begin_all(parts);
        if self.stops() != stops {
            let ids = begun.iter().flatten().flatten().copied();
            let ids: Vec<_> = ids.collect();
            ids.into_iter().rev().for_each(|id| engine.cancel(id));
        }
        drop(engine);
        let ids = begun.iter().flatten().flatten();
        let known = devices.iter().flatten().zip(goals.into_iter().flatten());
        for (id, (devices, goals)) in ids.zip(known) {
            self.goals().record(*id, devices, goals);
        }
        self.perform();
        begun
    }

    /// Where activities leave the arms.
    pub(crate) fn goals(&self) -> MutexGuard<'_, KnownGoals> {
        lock(&self.goals)
    }

    /// Waits until a device has no activity.
    pub(crate) fn wait_for_rest(&self, device: &str) -> Result<(), ErrorKind> {
        self.wait_for_rest_until(device, distant())
            .unwrap_or(Ok(()))
    }

    /// Waits until a device has no activity; `None` at the deadline.
    pub(crate) fn wait_for_rest_until(
        &self,
        device: &str,
        until: Instant,
    ) -> Option<Result<(), ErrorKind>> {
        self.wait_until(until, |session| {
            let Some(latest) = session.engine().latest(device) else {
                return Some(session.engine().lost().map_or(Ok(()), Err));
            };
            // What it keeps up has no end of its own.
            if session.engine().is_maintaining(latest) {
                session.cancel(&[latest]);
            }
            None
        })
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

    /// Cancels everything, also what other threads are preparing.
    ///
    /// Returns the devices that had something to do, and what they did.
    pub(crate) fn stop(&self) -> (BTreeSet<String>, Vec<ActivityId>) {
        let mut engine = self.engine();
        // Under the lock: what begins later sees the stop, and what began before is in the engine.
        self.stops.fetch_add(1, Ordering::SeqCst);
        let devices = engine.busy();
        let stopped = engine.cancel_all();
        drop(engine);
        self.perform();
        (devices, stopped)
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
    pub(crate) fn evaluate(&self, net: &str) -> Result<BTreeMap<String, String>, ErrorKind> {
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

    /// Sets the speed of all activities, those that run included.
    pub(crate) fn set_speed(&self, factor: f64) {
        let mut speed = lock(&self.speed);
        *speed = factor;
        let nets = self.engine().nets();
        nets.iter().for_each(|net| self.write_speed(net, factor));
    }

    pub(crate) fn speed(&self) -> f64 {
        *lock(&self.speed)
    }

    /// Fails only for a net that is already gone, or with the connection, which the receiver reports.
    fn write_speed(&self, net: &str, factor: f64) {
        drop(self.write_value(net, "override", &factor.to_string()));
    }

    fn write_value(&self, net: &str, key: &str, text: &str) -> Result<(), ErrorKind> {
        let value = Value::map_of([(format!("in{key}"), Value::from(text))]);
        let values = Value::map_of([(net.to_owned(), value)]);
        self.client.call("snc", [values])?;
        Ok(())
    }

    /// Writes a value into the nets of activities.
    pub(crate) fn write(&self, ids: &[ActivityId], key: &str, text: &str) -> Result<(), ErrorKind> {
        let nets = self.engine().loaded_nets(ids);
        if nets.is_empty() {
            let text =
                "nothing was sent: the activity does not run\nhint: send when `begin` has returned";
            return Err(ErrorKind::Invalid(text.to_owned()));
        }
        let mut nets = nets.iter();
        nets.try_for_each(|net| self.write_value(net, key, text))
    }

    fn notify(&self) {
        self.changed.notify_all();
        // A waker is program code: the lock is not held while it runs.
        let wakers = std::mem::take(&mut *lock(&self.wakers));
        wakers.into_iter().for_each(Waker::wake);
    }

    fn perform_one(&self, action: Action) {
        match action {
            Action::Load { activity, net } => {
                let loaded = self.load(&net);
                // A later change of the speed finds the net in the engine.
                let speed = lock(&self.speed);
                if let Ok(net) = &loaded
                    && *speed < 1.0
                {
                    self.write_speed(net, *speed);
                }
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
    fn load(&self, text: &str) -> Result<String, ErrorKind> {
        let arguments = [
            Value::from(text),
            self.id.as_str().into(),
            self.program.as_str().into(),
            CONTROLLER_PERIOD.into(),
            Value::Integer(1),
            REFRESH.into(),
            "every".into(),
        ];
        let reply = self.client.call("nene", arguments)?;
        let net = reply.text().unwrap_or_default().to_owned();
        if reply.values.get(1).and_then(Value::as_str) == Some("REJECTED") {
            let (_, faults) = self.inspect(&net)?;
            self.subscribe(reply.tag, Subject::Rejected);
            self.client.call("neun", [net.as_str()])?;
            return Err(ErrorKind::Rejected(faults));
        }
        self.subscribe(reply.tag, Subject::Net(net.clone()));
        Ok(net)
    }

    /// State of a net, and its faults or the reason of its end.
    fn inspect(&self, net: &str) -> Result<(String, Vec<String>), ErrorKind> {
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
            Value::from(self.program.as_str()),
            // Subscribes to the rule.
            Value::Integer(1),
        ];
        let reply = self.client.call("nesc", arguments).map_err(ErrorKind::from);
        let reply = reply.map_err(|error| self.obstacle(start).unwrap_or(error));
        let rule = |reply: &Reply| reply.text().unwrap_or_default().to_owned();
        let rules = reply.as_ref().map(rule).map_err(Clone::clone);
        self.engine().scheduled(group, rules);
        if let Ok(reply) = reply {
            let rule = Subject::Rule(rule(&reply));
            self.subscribe(reply.tag, rule);
        }
    }

    /// Why nets could not start, as far as the controller knows: another program holds what they need, or the cause.
    fn obstacle(&self, nets: &[String]) -> Option<ErrorKind> {
        nets.iter().find_map(|net| {
            let reply = self.client.call("nin", [net.as_str()]).ok()?;
            let info = reply.values.first()?.as_map()?.get(net)?.as_map()?;
            let holders = info.get("holders").and_then(Value::as_list);
            if let Some(holder) = holders.and_then(|holders| holders.first()?.as_map()) {
                let text = |key: &str| holder.get(key).and_then(Value::as_str).unwrap_or_default();
                let [net, session, program] = ["net", "session", "description"].map(text);
                let mut name = format!("net {net} of session {session}");
                if !program.is_empty() {
                    name.push_str(&format!(" ({program})"));
                }
                return Some(ErrorKind::conflict(text("resource"), Some(name)));
            }
            let cause = info.get("failure").and_then(Value::as_str)?;
            (!cause.is_empty()).then(|| ErrorKind::Refused(cause.to_owned()))
        })
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
            if subjects.early.len() == EARLY_MAX {
                let text = "notifications of no subscription".to_owned();
                return self.engine().lose(&ErrorKind::Lost(text));
            }
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
            (Subject::Rejected, "ns", Some(Value::String(state))) if state == "UNLOADED" => {
                subjects.known.remove(&push.tag);
            }
            (Subject::Net(net), "nc", Some(Value::Map(values))) => {
                let mut engine = self.engine();
                for (key, text) in values {
                    let key = key.strip_prefix("out").unwrap_or(key);
                    engine.value(&net, key, text.as_str().unwrap_or_default());
                }
            }
            (Subject::Rule(rule), "rs", Some(Value::String(state))) => {
                if state == "FIREFAILED" {
                    let nets = self.engine().nets_of_rule(&rule);
                    let cause = self.obstacle(&nets);
                    self.engine().rule_failed(&rule, cause);
                } else {
                    self.engine().rule_state(&rule, state);
                }
                if state != "ACTIVE" {
                    subjects.known.remove(&push.tag);
                }
            }
            _ => {}
        }
    }

    /// The connection ended.
    fn lose(&self, error: &ErrorKind) {
        self.engine().lose(error);
        self.notify();
    }
}

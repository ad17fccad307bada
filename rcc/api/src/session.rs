//! A connection to a controller, and the threads around the [engine](crate::engine): programs call from any thread; one
//! thread receives what the controller reports. No lock is held while a program or a call waits.

mod nets;
mod subjects;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::task::Waker;
use std::time::{Duration, Instant};

use takt_client::{Client, Value};

use crate::engine::{Action, ActivityId, Engine, Part};
use crate::error::ErrorKind;
use crate::preparation::{Goals, KnownGoals};
use crate::program;
use subjects::{Subject, Subjects};

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
    /// Nets that were loaded beforehand and not begun, with why they can no longer be, if so.
    ahead: Mutex<BTreeMap<String, Option<String>>>,
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
            ahead: Mutex::default(),
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
        // First those that are not begun: what begins meanwhile is in one of both.
        let mut nets: Vec<_> = lock(&self.ahead).keys().cloned().collect();
        nets.extend(self.engine().nets());
        nets.iter().for_each(|net| self.write_speed(net, factor));
    }

    pub(crate) fn speed(&self) -> f64 {
        *lock(&self.speed)
    }

    fn slow_down(&self, net: &str, speed: f64) {
        if speed < 1.0 {
            self.write_speed(net, speed);
        }
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
                if let Ok(net) = &loaded {
                    self.slow_down(net, *speed);
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

    /// The connection ended.
    fn lose(&self, error: &ErrorKind) {
        self.engine().lose(error);
        let subjects = std::mem::take(&mut lock(&self.subjects).known);
        for subject in subjects.into_values() {
            if let Subject::Listener(_, shared) = subject {
                shared.fail(error);
            }
        }
        self.notify();
    }
}

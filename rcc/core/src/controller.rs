//! The controller: its programming interface, and the registry between programs and the net threads. All
//! calls may block for one or two cycles; real-time threads make none of them.

mod admission;
mod clock;
mod condition;
mod devices;
mod driver_log;
mod eval;
mod events;
mod faults;
mod figures;
mod limited;
mod links;
mod load;
mod net;
mod quota;
mod registry;
mod reload;
mod retained;
mod rules;
mod shutdown;
mod threads;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use takt_net::{Limits, Rejection};

use crate::cell::{CellConfig, OnLoss};
use crate::device::DeviceStatus;
use crate::error::Error;
use crate::executor::stop::EmergencyStop;
use crate::executor::thread::Command;
use crate::record::{Recorder, RecordingEvent, Tap};
use crate::stop_channel::StopSwitch;
use clock::FollowedClock;
use net::Net;
use quota::{MemoryReturn, Quota};
use registry::{Registry, Session};

pub use crate::executor::{figures::NetCounts, rules::RuleState};
pub use crate::ids::{NetId, NetState, SessionId};
pub use clock::ClockInfo;
pub use eval::{EVAL_COST_MAX, EVAL_PRIMITIVES_MAX};
pub use faults::{DeviceFault, FaultCounts, StallCause, StallFigures};
pub use figures::{NetFigures, ThreadInfo};
pub use limited::LimitedInfo;
pub use links::{RECORDED_NETS_MAX, TAPS_RECORDED_FOR, TapRecord, Taps};
pub use load::LoadRequest;
pub use retained::RetainedNet;
pub use rules::{RuleId, RuleInfo, RuleRequest};

/// Maximum number of loaded nets.
pub const NETS_MAX: usize = 1024;
/// Maximum number of open sessions.
pub const SESSIONS_MAX: usize = 256;
/// Reason reported for a net that was aborted before it started.
const NEVER_RAN: &str = "aborted before it ran";
/// Time within which a net thread must answer.
const ANSWER_WITHIN: Duration = Duration::from_secs(2);

/// A net as programs see it.
#[derive(Clone, Debug)]
pub struct NetInfo {
    /// Its identifier.
    pub id: NetId,
    /// Description for users.
    pub description: String,
    /// Session that it belongs to.
    pub session: SessionId,
    /// Its text.
    pub text: Arc<str>,
    /// All its states in order; the last is the present one.
    pub states: Vec<NetState>,
    /// Faults for which it was rejected.
    pub rejection: Option<Arc<Rejection>>,
    /// Reason of its end, unless it terminated by itself.
    pub end: Option<String>,
}

impl NetInfo {
    /// Its present state.
    #[must_use]
    pub fn state(&self) -> NetState {
        self.states.last().copied().unwrap_or(NetState::Loading)
    }
}

/// A device as programs see it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceInfo {
    /// Its name.
    pub name: String,
    /// Its type.
    pub kind: String,
    /// Its interfaces with their parameters.
    pub interfaces: BTreeMap<String, BTreeMap<String, String>>,
    /// Whether it can be used.
    pub status: DeviceStatus,
}

/// Ends a watch when dropped.
#[derive(Debug)]
#[must_use = "the watch ends when this is dropped"]
pub struct Watch {
    inner: Arc<Inner>,
    number: u64,
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.inner.lock().watches.remove(&self.number);
    }
}

/// A running controller. Clones are handles of the same controller; dropping the last one stops it.
#[derive(Clone, Debug)]
pub struct Controller {
    inner: Arc<Inner>,
    _life: Arc<Life>,
}

/// Stops the threads when the last handle is dropped.
#[derive(Debug)]
struct Life {
    inner: Arc<Inner>,
    supervisor: Mutex<Option<std::thread::JoinHandle<()>>>,
}

impl Drop for Life {
    fn drop(&mut self) {
        self.inner.stop.store(true, Ordering::Relaxed);
        let supervisor = self
            .supervisor
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if supervisor.is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the supervisor panicked");
        }
        self.inner.lock().stop();
    }
}

#[derive(Debug)]
struct Inner {
    registry: Mutex<Registry>,
    /// Signalled after every change of the registry.
    changed: Condvar,
    stop: AtomicBool,
    primitives: takt_net::Registry,
    period: Duration,
}

impl Inner {
    /// Locks the registry after all events of the net threads were taken.
    fn lock(&self) -> MutexGuard<'_, Registry> {
        let mut registry = self.registry.lock().unwrap_or_else(PoisonError::into_inner);
        registry.unannounced |= registry.take_events();
        registry
    }

    /// Wakes waiting callers and watchers.
    fn announce(&self, registry: &Registry) {
        self.changed.notify_all();
        for watch in registry.watches.values() {
            watch();
        }
    }

    /// Waits for a thread's answer.
    fn wait_for<T>(
        &self,
        registry: MutexGuard<'_, Registry>,
        done: impl FnMut(&mut Registry) -> Option<T>,
    ) -> Result<T, Error> {
        self.wait_within(registry, ANSWER_WITHIN, done)
    }

    /// Waits until `done` returns a value or the timeout expires.
    fn wait_within<T>(
        &self,
        mut registry: MutexGuard<'_, Registry>,
        within: Duration,
        mut done: impl FnMut(&mut Registry) -> Option<T>,
    ) -> Result<T, Error> {
        let until = std::time::Instant::now() + within;
        loop {
            if let Some(result) = done(&mut registry) {
                return Ok(result);
            }
            let left = until.saturating_duration_since(std::time::Instant::now());
            if left.is_zero() {
                return Err(Error::NoAnswer(within));
            }
            let waited = self.changed.wait_timeout(registry, left);
            registry = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Controller {
    /// Starts the threads of a cell.
    ///
    /// # Errors
    /// If the cell is invalid, or a device or a thread cannot be started.
    pub fn start(cell: &CellConfig) -> Result<Self, Error> {
        Self::start_recording(cell, None)
    }

    /// Starts the threads of a cell and records the first net thread.
    ///
    /// # Errors
    /// If the cell is invalid, or a device or a thread cannot be started.
    pub fn start_recording(
        cell: &CellConfig,
        recording: Option<(Recorder, Tap)>,
    ) -> Result<Self, Error> {
        Self::start_under(cell, recording, StopSwitch::default())
    }

    /// As [`Self::start_recording`], under an existing switch, which a stop channel serves independently.
    ///
    /// # Errors
    /// If the cell is invalid, or a device or a thread cannot be started.
    pub fn start_under(
        cell: &CellConfig,
        recording: Option<(Recorder, Tap)>,
        switch: StopSwitch,
    ) -> Result<Self, Error> {
        cell.check().map_err(Error::Cell)?;
        let (recorder, tap) = recording.unzip();
        let clock = FollowedClock::of(cell);
        let stop = Arc::new(EmergencyStop::under(cell.controller.need_estop, switch));
        let threads = threads::start(cell, clock.as_ref(), &stop, tap)?;
        let room = Quota::of_mib(cell.controller.nets_memory_mib);
        let mut registry = Registry::new(threads, clock, stop, recorder, room);
        for device in &cell.devices {
            registry.add_of_cell(device)?;
        }
        for segment in &cell.ethercat {
            registry.add_segment(segment)?;
        }
        for network in &cell.canopen {
            registry.add_network(network)?;
        }
        let inner = Arc::new(Inner {
            registry: Mutex::new(registry),
            changed: Condvar::new(),
            stop: AtomicBool::new(false),
            primitives: crate::costs::registry(cell.controller.costs.as_deref())?,
            period: cell.controller.period,
        });
        let supervised = Arc::clone(&inner);
        let name = "takt-supervisor".to_owned();
        let supervisor = std::thread::Builder::new()
            .name(name.clone())
            .spawn(move || supervise(&supervised))
            .map_err(|source| Error::Thread { name, source })?;
        let life = Life {
            inner: Arc::clone(&inner),
            supervisor: Mutex::new(Some(supervisor)),
        };
        Ok(Self {
            inner,
            _life: Arc::new(life),
        })
    }

    /// Opens a session, to which nets can belong.
    ///
    /// # Errors
    /// If too many are open.
    pub fn open_session(&self, description: &str) -> Result<SessionId, Error> {
        self.open_session_with(description, OnLoss::Keep)
    }

    /// As [`Self::open_session`], with what happens to its nets when its connection is lost. The caller
    /// monitors the connection.
    ///
    /// # Errors
    /// If too many are open.
    pub fn open_session_with(
        &self,
        description: &str,
        on_loss: OnLoss,
    ) -> Result<SessionId, Error> {
        let mut registry = self.inner.lock();
        if registry.sessions.len() >= SESSIONS_MAX {
            return Err(Error::TooMany {
                what: "open sessions",
                bound: SESSIONS_MAX,
            });
        }
        registry.last_session += 1;
        let id = SessionId(registry.last_session);
        registry.sessions.insert(
            id,
            Session {
                description: description.to_owned(),
                on_loss,
            },
        );
        Ok(id)
    }

    /// What happens to the nets of a session whose connection is lost; `None` if there is no such session.
    #[must_use]
    pub fn session_on_loss(&self, id: SessionId) -> Option<OnLoss> {
        Some(self.inner.lock().sessions.get(&id)?.on_loss)
    }

    /// Replaces the description of a session.
    ///
    /// # Errors
    /// If there is no such session.
    pub fn describe_session(&self, id: SessionId, description: &str) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        let session = registry.sessions.get_mut(&id);
        let session = session.ok_or_else(|| Error::NoSuchSession(id.to_string()))?;
        description.clone_into(&mut session.description);
        Ok(())
    }

    /// The nets of a session; `None` if there is no such session.
    #[must_use]
    pub fn session_nets(&self, id: SessionId) -> Option<Vec<NetId>> {
        let registry = self.inner.lock();
        if id != SessionId::NONE && !registry.sessions.contains_key(&id) {
            return None;
        }
        let of_session = registry.nets.iter().filter(|(_, net)| net.session == id);
        Some(of_session.map(|(id, _)| *id).collect())
    }

    /// Starts a net and waits until it runs.
    ///
    /// # Errors
    /// If it is not ready, a resource is in use, or a device that it commands is not operational.
    pub fn start_net(&self, id: NetId) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        registry.begin(id)?;
        self.inner
            .wait_for(registry, |registry| registry.begun(id))?
    }

    /// Requests a running net to end by itself; other nets are not affected.
    ///
    /// # Errors
    /// If there is no such net.
    pub fn cancel(&self, id: NetId) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        if registry.net(id)?.state() == NetState::Running {
            registry.command(Command::Cancel(id.0))?;
        }
        Ok(())
    }

    /// Ends a net immediately and waits until it has ended.
    ///
    /// # Errors
    /// If there is no such net or the net thread does not answer.
    pub fn abort(&self, id: NetId) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        match registry.net(id)?.state() {
            NetState::Loading | NetState::Rejected | NetState::Terminated | NetState::Unloaded => {
                return Ok(());
            }
            NetState::Ready | NetState::Scheduled => {
                if registry.give_up(id)? {
                    self.inner.announce(&registry);
                    return Ok(());
                }
            }
            NetState::Running | NetState::Cancelling => {}
        }
        // A net held by its thread may have started meanwhile.
        registry.command(Command::Abort(id.0))?;
        let mut seen_running = false;
        self.inner.wait_for(registry, |registry| {
            let Some(net) = registry.nets.get_mut(&id) else {
                // Another client unloaded it meanwhile.
                return Some(());
            };
            match net.state() {
                NetState::Running | NetState::Cancelling => {
                    // It may have started only now: a start that raced with a rule is sent again.
                    if !std::mem::replace(&mut seen_running, true) {
                        registry.command(Command::Abort(id.0)).ok();
                    }
                    None
                }
                NetState::Ready | NetState::Scheduled if net.is_away() => None,
                NetState::Ready | NetState::Scheduled => {
                    net.end(NEVER_RAN.to_owned());
                    Some(())
                }
                NetState::Loading
                | NetState::Rejected
                | NetState::Terminated
                | NetState::Unloaded => Some(()),
            }
        })
    }

    /// Unloads a net that does not run; a running net is not affected.
    ///
    /// # Errors
    /// If there is no such net, or its cancel is still pending.
    pub fn unload(&self, id: NetId) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        match registry.net(id)?.state() {
            NetState::Running => return Ok(()),
            state @ (NetState::Cancelling | NetState::Loading) => {
                let what = "wait until it has ended, or abort it";
                return Err(Error::WrongState {
                    net: id,
                    state,
                    what,
                });
            }
            NetState::Rejected
            | NetState::Ready
            | NetState::Scheduled
            | NetState::Terminated
            | NetState::Unloaded => {}
        }
        if registry.net(id)?.is_away() {
            // Otherwise it would run unknown to all clients.
            drop(registry);
            self.abort(id)?;
            registry = self.inner.lock();
        }
        registry.withdraw(id)?;
        let mut net = registry.nets.remove(&id);
        if let Some(net) = &mut net {
            registry.remember(id, net);
        }
        self.inner.announce(&registry);
        drop(registry);
        // Freeing a large net takes long; do it without the lock.
        drop(net);
        Ok(())
    }

    /// A net; `None` once it is unloaded.
    #[must_use]
    pub fn net(&self, id: NetId) -> Option<NetInfo> {
        self.inner.lock().nets.get(&id).map(|net| net.info(id))
    }

    /// All nets.
    #[must_use]
    pub fn nets(&self) -> Vec<NetId> {
        self.inner.lock().nets.keys().copied().collect()
    }

    /// Sessions that are open, with their descriptions.
    #[must_use]
    pub fn sessions(&self) -> Vec<(SessionId, String)> {
        let registry = self.inner.lock();
        registry
            .sessions
            .iter()
            .map(|(id, s)| (*id, s.description.clone()))
            .collect()
    }

    /// Out values of a net that were reported and non-null at least once, as key and text.
    #[must_use]
    pub fn out_values(&self, id: NetId) -> Vec<(String, String)> {
        self.inner
            .lock()
            .nets
            .get_mut(&id)
            .map(Net::out_values)
            .unwrap_or_default()
    }

    /// In values of a net as last written, as key and text.
    #[must_use]
    pub fn in_values(&self, id: NetId) -> Vec<(String, String)> {
        let registry = self.inner.lock();
        registry
            .nets
            .get(&id)
            .map(Net::in_values)
            .unwrap_or_default()
    }

    /// Writes an in value of a net; returns whether the key exists.
    ///
    /// # Errors
    /// If there is no such net, or the text is not a value of that type.
    pub fn write_in(&self, id: NetId, key: &str, text: &str) -> Result<bool, Error> {
        self.inner.lock().net(id)?.write_in(id, key, text)
    }

    /// The devices.
    #[must_use]
    pub fn devices(&self) -> Vec<DeviceInfo> {
        self.inner.lock().device_infos()
    }

    /// Calls `wake` after each change of nets, sessions or devices, from a thread of the
    /// controller; `wake` must not call the controller. Changes of out values do not call it.
    pub fn on_change(&self, wake: impl Fn() + Send + Sync + 'static) -> Watch {
        let mut registry = self.inner.lock();
        registry.last_watch += 1;
        let number = registry.last_watch;
        registry.watches.insert(number, Box::new(wake));
        Watch {
            inner: Arc::clone(&self.inner),
            number,
        }
    }

    /// The switch that stops and releases the whole controller.
    #[must_use]
    pub fn stop_switch(&self) -> StopSwitch {
        self.inner.lock().stop.switch().clone()
    }

    /// Period of the first net thread.
    #[must_use]
    pub fn period(&self) -> Duration {
        self.inner.period
    }

    /// Ends the recording; returns how many cycles it holds, or `None` if there was none.
    ///
    /// # Errors
    /// If the file could not be written or cycles were lost.
    pub fn finish_recording(&self) -> Result<Option<u64>, Error> {
        let recorder = self.inner.lock().recorder.take();
        recorder.map(Recorder::finish).transpose()
    }
}

/// Limits for a net of that period: its cost bound is four fifths of the period.
#[must_use]
pub fn limits_for(period: Duration) -> Limits {
    Limits {
        cost: Some(crate::executor::figures::budget(period)),
        ..Limits::default()
    }
}

/// Interval at which the supervisor polls the net threads.
const SUPERVISION: Duration = Duration::from_millis(2);

/// Applies the events of the net threads to the registry, and detects changes of devices.
fn supervise(inner: &Inner) {
    let mut memory_return = MemoryReturn::default();
    while !inner.stop.load(Ordering::Relaxed) {
        let mut registry = inner.lock();
        registry.drop_expired();
        registry.drain_taps();
        let has_events = std::mem::take(&mut registry.unannounced);
        let moved = registry.poll_devices();
        if has_events || moved {
            inner.announce(&registry);
        }
        let now = std::time::Instant::now();
        let recording = registry.recorder.as_mut().and_then(|it| it.poll_event(now));
        let news = registry.take_notices(now);
        let returns = memory_return.is_due(now) && memory_return.check(registry.memory_taken());
        drop(registry);
        if returns && let Err(error) = takt_rt::host::return_memory() {
            tracing::warn!(
                "cannot lock the heap again, cycles may fault: {error}\nhint: LimitMEMLOCK=infinity"
            );
        }
        match recording {
            Some(RecordingEvent::Failed(what)) => {
                tracing::error!("{what}");
            }
            Some(RecordingEvent::CyclesLost(lost)) => tracing::warn!(
                lost,
                "cycles are missing in the recording: the disk is too slow or a cycle too large\nhint: record to a \
                 faster disk, or to memory (/dev/shm)"
            ),
            None => {}
        }
        for (driver, notice) in news {
            driver_log::report(&driver, &notice);
        }
        std::thread::sleep(SUPERVISION);
    }
}

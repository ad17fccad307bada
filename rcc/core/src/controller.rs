//! The controller: what programs can ask of it, and the desk between them and the net thread. All
//! calls may block for a cycle or two; none is made in a real-time thread.

mod clock;
mod closing;
mod condition;
mod departed;
mod desk;
mod devices;
mod eval;
mod events;
mod faults;
mod figures;
mod inter;
mod limited;
mod load;
mod net;
mod news;
mod outlook;
mod reload;
mod rules;
mod share;
mod threads;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use takt_net::{Limits, Registry, Rejection};

use crate::cell::{CellConfig, OnLoss};
use crate::device::DeviceStatus;
use crate::error::Error;
use crate::executor::stop::EmergencyStop;
use crate::executor::thread::Command;
use crate::record::{Recorder, RecordingEvent, Tap};
use crate::stop_channel::StopSwitch;
use clock::FollowedClock;
use desk::{Desk, Session};
use net::Net;
use share::{MemoryReturn, Room};

pub use crate::executor::{figures::NetCounts, rules::RuleState};
pub use crate::ids::{NetId, NetState, SessionId};
pub use clock::ClockInfo;
pub use departed::Departed;
pub use eval::{EVAL_COST_MAX, EVAL_PRIMITIVES_MAX};
pub use faults::{DeviceFault, FaultCounts, StallCause, StallFigures};
pub use figures::{NetFigures, ThreadInfo};
pub use inter::{LOOK_LASTS, LOOKS_MAX, TapRecord, Taps};
pub use limited::LimitedInfo;
pub use load::LoadRequest;
pub use rules::{RuleId, RuleInfo, RuleRequest};

/// Nets that may be loaded at once.
pub const NETS_MAX: usize = 1024;
/// Sessions that may be open at once.
pub const SESSIONS_MAX: usize = 256;
/// Why a net is over that was aborted too early.
const NEVER_RAN: &str = "aborted before it ran";
/// How long the net thread may take to answer.
const ANSWER_WITHIN: Duration = Duration::from_secs(2);

/// A net as programs see it.
#[derive(Clone, Debug)]
pub struct NetInfo {
    /// Its identifier.
    pub id: NetId,
    /// What it is, for people.
    pub description: String,
    /// Session it belongs to.
    pub session: SessionId,
    /// Its text.
    pub text: Arc<str>,
    /// All states it has been in, in order; the last is the present one.
    pub states: Vec<NetState>,
    /// What is wrong with it, if it was rejected.
    pub rejection: Option<Arc<Rejection>>,
    /// Why it ended, if not by itself.
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

/// A running controller. Clones are handles of the same one; the last one dropped ends it.
#[derive(Clone, Debug)]
pub struct Controller {
    inner: Arc<Inner>,
    _life: Arc<Life>,
}

/// Ends the threads when the last handle is dropped.
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
            tracing::error!("the supervisor had ended by a panic");
        }
        self.inner.lock().stop();
    }
}

#[derive(Debug)]
struct Inner {
    desk: Mutex<Desk>,
    /// Signalled after every change of the desk.
    changed: Condvar,
    stop: AtomicBool,
    registry: Registry,
    period: Duration,
}

impl Inner {
    /// The desk, up to date with what the net threads have told.
    fn lock(&self) -> MutexGuard<'_, Desk> {
        let mut desk = self.desk.lock().unwrap_or_else(PoisonError::into_inner);
        desk.unannounced |= desk.take_events();
        desk
    }

    /// Wakes those who wait for a change and those who watch.
    fn announce(&self, desk: &Desk) {
        self.changed.notify_all();
        for watch in desk.watches.values() {
            watch();
        }
    }

    /// Waits for a thread's answer.
    fn wait_for<T>(
        &self,
        desk: MutexGuard<'_, Desk>,
        done: impl FnMut(&mut Desk) -> Option<T>,
    ) -> Result<T, Error> {
        self.wait_within(desk, ANSWER_WITHIN, done)
    }

    /// Waits until `done` says so or the time is up.
    fn wait_within<T>(
        &self,
        mut desk: MutexGuard<'_, Desk>,
        within: Duration,
        mut done: impl FnMut(&mut Desk) -> Option<T>,
    ) -> Result<T, Error> {
        let until = std::time::Instant::now() + within;
        loop {
            if let Some(result) = done(&mut desk) {
                return Ok(result);
            }
            let left = until.saturating_duration_since(std::time::Instant::now());
            if left.is_zero() {
                return Err(Error::NoAnswer(within));
            }
            let waited = self.changed.wait_timeout(desk, left);
            desk = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Controller {
    /// Starts the threads of a cell.
    ///
    /// # Errors
    /// If the cell makes no sense, a device cannot be opened or a thread not be started.
    pub fn start(cell: &CellConfig) -> Result<Self, Error> {
        Self::start_recording(cell, None)
    }

    /// Starts the threads of a cell and records the first net thread.
    ///
    /// # Errors
    /// If the cell makes no sense, a device cannot be opened or a thread not be started.
    pub fn start_recording(
        cell: &CellConfig,
        recording: Option<(Recorder, Tap)>,
    ) -> Result<Self, Error> {
        Self::start_under(cell, recording, StopSwitch::default())
    }

    /// The same under a switch that is there before: a stop channel serves it whatever happens here.
    ///
    /// # Errors
    /// If the cell makes no sense, a device cannot be opened or a thread not be started.
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
        let room = Room::of_mib(cell.controller.nets_memory_mib);
        let mut desk = Desk::new(threads, clock, stop, recorder, room);
        for device in &cell.devices {
            desk.add_of_cell(device)?;
        }
        for segment in &cell.ethercat {
            desk.add_segment(segment)?;
        }
        for network in &cell.canopen {
            desk.add_network(network)?;
        }
        let inner = Arc::new(Inner {
            desk: Mutex::new(desk),
            changed: Condvar::new(),
            stop: AtomicBool::new(false),
            registry: crate::costs::registry(cell.controller.costs.as_deref())?,
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

    /// The same, saying what becomes of its nets when the connection that opens it is lost; to watch
    /// the connection is the caller's part.
    ///
    /// # Errors
    /// If too many are open.
    pub fn open_session_with(
        &self,
        description: &str,
        on_loss: OnLoss,
    ) -> Result<SessionId, Error> {
        let mut desk = self.inner.lock();
        if desk.sessions.len() >= SESSIONS_MAX {
            return Err(Error::TooMany {
                what: "open sessions",
                bound: SESSIONS_MAX,
            });
        }
        desk.last_session += 1;
        let id = SessionId(desk.last_session);
        desk.sessions.insert(
            id,
            Session {
                description: description.to_owned(),
                on_loss,
            },
        );
        Ok(id)
    }

    /// What becomes of the nets of a session whose connection is lost; `None` if there is none.
    #[must_use]
    pub fn session_on_loss(&self, id: SessionId) -> Option<OnLoss> {
        Some(self.inner.lock().sessions.get(&id)?.on_loss)
    }

    /// Describes a session anew.
    ///
    /// # Errors
    /// If there is no such session.
    pub fn describe_session(&self, id: SessionId, description: &str) -> Result<(), Error> {
        let mut desk = self.inner.lock();
        let session = desk.sessions.get_mut(&id);
        let session = session.ok_or_else(|| Error::NoSuchSession(id.to_string()))?;
        description.clone_into(&mut session.description);
        Ok(())
    }

    /// The nets of a session; `None` if there is no such session.
    #[must_use]
    pub fn session_nets(&self, id: SessionId) -> Option<Vec<NetId>> {
        let desk = self.inner.lock();
        if id != SessionId::NONE && !desk.sessions.contains_key(&id) {
            return None;
        }
        let of_session = desk.nets.iter().filter(|(_, net)| net.session == id);
        Some(of_session.map(|(id, _)| *id).collect())
    }

    /// Starts a net and waits until it runs.
    ///
    /// # Errors
    /// If it is not ready, what it needs is in use, or a device it commands does not follow.
    pub fn start_net(&self, id: NetId) -> Result<(), Error> {
        let mut desk = self.inner.lock();
        desk.begin(id)?;
        self.inner.wait_for(desk, |desk| desk.begun(id))?
    }

    /// Asks a running net to come to its end by itself; without effect on any other.
    ///
    /// # Errors
    /// If there is no such net.
    pub fn cancel(&self, id: NetId) -> Result<(), Error> {
        let mut desk = self.inner.lock();
        if desk.net(id)?.state() == NetState::Running {
            desk.command(Command::Cancel(id.0))?;
        }
        Ok(())
    }

    /// Ends a net at once, whatever it does, and waits for that.
    ///
    /// # Errors
    /// If there is no such net or the net thread does not answer.
    pub fn abort(&self, id: NetId) -> Result<(), Error> {
        let mut desk = self.inner.lock();
        match desk.net(id)?.state() {
            NetState::Loading | NetState::Rejected | NetState::Terminated | NetState::Unloaded => {
                return Ok(());
            }
            NetState::Ready | NetState::Scheduled => {
                if desk.give_up(id)? {
                    self.inner.announce(&desk);
                    return Ok(());
                }
            }
            NetState::Running | NetState::Cancelling => {}
        }
        // One that is away may have started meanwhile.
        desk.command(Command::Abort(id.0))?;
        let mut seen_running = false;
        self.inner.wait_for(desk, |desk| {
            let Some(net) = desk.nets.get_mut(&id) else {
                // Somebody unloaded it meanwhile.
                return Some(());
            };
            match net.state() {
                NetState::Running | NetState::Cancelling => {
                    // It may have started only now: a start that crossed the way of a rule is sent again.
                    if !std::mem::replace(&mut seen_running, true) {
                        desk.command(Command::Abort(id.0)).ok();
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

    /// Forgets a net that does not run; one that runs is left alone.
    ///
    /// # Errors
    /// If there is no such net, or it was asked to cancel and still runs.
    pub fn unload(&self, id: NetId) -> Result<(), Error> {
        let mut desk = self.inner.lock();
        match desk.net(id)?.state() {
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
        if desk.net(id)?.is_away() {
            // Or it would run without anybody who knows it.
            drop(desk);
            self.abort(id)?;
            desk = self.inner.lock();
        }
        desk.withdraw(id)?;
        let mut net = desk.nets.remove(&id);
        if let Some(net) = &mut net {
            desk.remember(id, net);
        }
        self.inner.announce(&desk);
        drop(desk);
        // A large net takes its time to be freed; nobody need wait for it.
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
        let desk = self.inner.lock();
        desk.sessions
            .iter()
            .map(|(id, s)| (*id, s.description.clone()))
            .collect()
    }

    /// Values that a net gives out: those reported and ever non-null, as key and text.
    #[must_use]
    pub fn out_values(&self, id: NetId) -> Vec<(String, String)> {
        self.inner
            .lock()
            .nets
            .get_mut(&id)
            .map(Net::out_values)
            .unwrap_or_default()
    }

    /// Values that a net takes in as they were last written, as key and text.
    #[must_use]
    pub fn in_values(&self, id: NetId) -> Vec<(String, String)> {
        let desk = self.inner.lock();
        desk.nets.get(&id).map(Net::in_values).unwrap_or_default()
    }

    /// Writes a value that a net takes in; returns whether it has one of that key.
    ///
    /// # Errors
    /// If there is no such net, or the text is no such value.
    pub fn write_in(&self, id: NetId, key: &str, text: &str) -> Result<bool, Error> {
        self.inner.lock().net(id)?.write_in(id, key, text)
    }

    /// The devices.
    #[must_use]
    pub fn devices(&self) -> Vec<DeviceInfo> {
        self.inner.lock().device_infos()
    }

    /// Calls `wake` after each change of nets, sessions or devices, from a thread of the
    /// controller; it must not call the controller. Not for values that nets give out.
    pub fn on_change(&self, wake: impl Fn() + Send + Sync + 'static) -> Watch {
        let mut desk = self.inner.lock();
        desk.last_watch += 1;
        let number = desk.last_watch;
        desk.watches.insert(number, Box::new(wake));
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

    /// Time from one cycle of the first net thread to the next.
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

/// Bounds on a net of that period: its cycles may cost four fifths of it.
#[must_use]
pub fn limits_for(period: Duration) -> Limits {
    Limits {
        cost: Some(crate::executor::figures::budget(period)),
        ..Limits::default()
    }
}

/// How often the supervisor looks at what the net thread tells.
const SUPERVISION: Duration = Duration::from_millis(2);

/// Carries what the net threads tell to the desk, and notes changes of devices.
fn supervise(inner: &Inner) {
    let mut memory_return = MemoryReturn::default();
    while !inner.stop.load(Ordering::Relaxed) {
        let mut desk = inner.lock();
        desk.forget_departed();
        desk.drain_taps();
        let told = std::mem::take(&mut desk.unannounced);
        let moved = desk.look_at_devices();
        if told || moved {
            inner.announce(&desk);
        }
        let now = std::time::Instant::now();
        let recording = desk.recorder.as_mut().and_then(|it| it.poll_event(now));
        let news = desk.take_news(now);
        let returns = memory_return.is_due(now) && memory_return.check(desk.memory_taken());
        drop(desk);
        if returns {
            takt_rt::host::return_memory();
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
            news::report(&driver, &notice);
        }
        std::thread::sleep(SUPERVISION);
    }
}

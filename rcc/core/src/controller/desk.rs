//! What the controller knows: nets, sessions, devices, and the way to the net threads. Guarded by
//! one lock that no real-time thread ever takes.

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use takt_net::Rejection;
use takt_net::fault::{Fault, FaultKind};
use takt_net::netcomm::{Directory, Entry, NetBoxes, OutStatus};
use takt_rt::latest::{LatestReader, LatestWriter};

use crate::cell::OnLoss;
use crate::controller::clock::FollowedClock;
use crate::controller::departed::Departed;
use crate::controller::inter::{Look, NetLinks};
use crate::controller::rules::{RuleEntry, RuleId};
use crate::controller::share::memory;
use crate::controller::threads::busy;
use crate::controller::{DeviceInfo, NetId, NetInfo, NetState, SessionId};
use crate::device::driver::DeviceDriver;
use crate::device::{DeviceStatus, DeviceTable};
use crate::error::Error;
use crate::executor::figures::NetCounters;
use crate::executor::stop::EmergencyStop;
use crate::executor::thread::{Command, NetThread};
use crate::executor::{ResourceSet, Running};
use crate::record::Recorder;

/// Things that a driver may tell before others are looked at.
const NEWS_AT_ONCE: usize = 32;

/// An open session.
#[derive(Debug)]
pub(super) struct Session {
    pub(super) description: String,
    pub(super) on_loss: OnLoss,
}

/// A net made ready, with the program's ends of its values.
#[derive(Debug)]
pub(super) struct Prepared {
    /// The number of its thread.
    pub(super) thread: usize,
    pub(super) running: Box<Running>,
    pub(super) links: NetLinks,
    pub(super) out_directory: Arc<Directory>,
    pub(super) out_reader: LatestReader<Box<[u64]>>,
    pub(super) in_directory: Arc<Directory>,
    pub(super) in_writer: LatestWriter<Box<[u64]>>,
    pub(super) in_words: Box<[u64]>,
}

#[derive(Debug)]
struct Values {
    links: NetLinks,
    out_directory: Arc<Directory>,
    out_reader: LatestReader<Box<[u64]>>,
    in_directory: Arc<Directory>,
    in_writer: LatestWriter<Box<[u64]>>,
    in_words: Box<[u64]>,
}

/// A net.
#[derive(Debug)]
pub(super) struct Net {
    pub(super) session: SessionId,
    description: String,
    text: Arc<str>,
    states: Vec<NetState>,
    rejection: Option<Arc<Rejection>>,
    end: Option<String>,
    /// The net while the net thread does not have it.
    running: Option<Box<Running>>,
    /// Set while a start is under way, and then to its outcome until somebody asks for it.
    starting: Option<Option<Result<(), Error>>>,
    /// Whether the net thread keeps it for rules to start.
    with_rules: bool,
    values: Option<Values>,
    /// Devices that the net reads or commands.
    devices: Vec<String>,
    /// The number of its thread, 0 until it is known.
    pub(super) thread: usize,
    counted: Option<Counted>,
}

/// What is known of a net's evaluation.
#[derive(Debug)]
pub(super) struct Counted {
    pub(super) counters: Arc<NetCounters>,
    pub(super) period: Duration,
    pub(super) primitives: usize,
    pub(super) cost: Duration,
    /// Bytes that it takes while it can run.
    pub(super) memory: usize,
}

impl Net {
    pub(super) fn new(session: SessionId, description: String, text: Arc<str>) -> Self {
        Self {
            session,
            description,
            text,
            states: vec![NetState::Loading],
            rejection: None,
            end: None,
            running: None,
            starting: None,
            with_rules: false,
            values: None,
            devices: Vec::new(),
            thread: 0,
            counted: None,
        }
    }

    pub(super) fn state(&self) -> NetState {
        self.states.last().copied().unwrap_or(NetState::Loading)
    }

    pub(super) fn enter(&mut self, state: NetState) {
        self.states.push(state);
    }

    pub(super) fn make_ready(&mut self, prepared: Prepared) {
        let Prepared {
            thread,
            running,
            links,
            out_directory,
            out_reader,
            in_directory,
            in_writer,
            in_words,
        } = prepared;
        self.thread = thread;
        self.devices = running.plan.uses().to_vec();
        self.counted = Some(Counted {
            counters: Arc::clone(running.counters()),
            period: running.plan.period(),
            primitives: running.plan.primitives(),
            cost: running.plan.cost().total,
            memory: memory(&running.plan),
        });
        self.running = Some(running);
        self.values = Some(Values {
            links,
            out_directory,
            out_reader,
            in_directory,
            in_writer,
            in_words,
        });
        self.enter(NetState::Ready);
    }

    pub(super) fn reject(&mut self, rejection: Rejection) {
        self.rejection = Some(Arc::new(rejection));
        self.enter(NetState::Rejected);
    }

    /// Gives the net away to be started.
    fn begin(&mut self, id: NetId) -> Result<Command, Error> {
        let state = self.state();
        let wrong = |what| Error::WrongState {
            net: id,
            state,
            what,
        };
        if !matches!(state, NetState::Ready | NetState::Scheduled) || self.is_to_start() {
            return Err(wrong(
                "only a net that is READY can be started; load it again",
            ));
        }
        // An outcome that nobody waited for any more is that of an earlier start.
        let command = match self.running.take() {
            Some(running) => Command::Start(running),
            None if self.with_rules => Command::StartScheduled(id.0),
            None => return Err(wrong("it is being started already")),
        };
        self.starting = Some(None);
        Ok(command)
    }

    /// It runs.
    pub(super) fn started(&mut self) {
        self.with_rules = false;
        self.starting = self.starting.take().map(|_| Some(Ok(())));
        self.enter(NetState::Running);
    }

    /// It ran and has ended.
    pub(super) fn ended(&mut self, why: Option<String>) {
        self.end = why;
        self.enter(NetState::Terminated);
    }

    /// It is back without having run; `why` if it could not be started.
    pub(super) fn take_back(&mut self, running: Box<Running>, why: Option<Error>) {
        self.with_rules = false;
        self.running = Some(running);
        self.starting = why.map(|error| Some(Err(error)));
    }

    /// Rules do not have it any more.
    pub(super) const fn leave_rules(&mut self) {
        self.with_rules = false;
    }

    /// Whether the net thread has it, or will, while it does not run yet.
    pub(super) const fn is_away(&self) -> bool {
        self.with_rules || self.is_to_start()
    }

    /// Whether a start is asked for and not answered.
    pub(super) const fn is_to_start(&self) -> bool {
        matches!(self.starting, Some(None))
    }

    /// What is known of its evaluation; `None` if it was never made ready.
    pub(super) const fn counted(&self) -> Option<&Counted> {
        self.counted.as_ref()
    }

    /// Ends a net that never ran.
    pub(super) fn end(&mut self, why: String) {
        self.end = Some(why);
        self.running = None;
        self.enter(NetState::Terminated);
    }

    /// Its text.
    pub(super) fn text(&self) -> &str {
        &self.text
    }

    /// Whether the net reads or commands the device of that name.
    pub(super) fn uses(&self, device: &str) -> bool {
        self.devices.iter().any(|name| name == device)
    }

    /// Gives the net away for rules to start, unless they have it already.
    pub(super) fn hand_to_rules(&mut self) -> Option<Box<Running>> {
        let running = self.running.take()?;
        self.with_rules = true;
        Some(running)
    }

    pub(super) fn become_scheduled(&mut self) {
        if self.state() == NetState::Ready {
            self.enter(NetState::Scheduled);
        }
    }

    /// Whether it ended as its own termination says.
    pub(super) fn ended_by_itself(&self) -> bool {
        self.state() == NetState::Terminated && self.end.is_none()
    }

    /// Where an out value lies.
    pub(super) fn out_entry(&self, key: &str) -> Option<Entry> {
        self.values.as_ref()?.out_directory.find(key).cloned()
    }

    /// What other nets may exchange with it.
    pub(super) fn boxes(&self) -> Option<NetBoxes> {
        let values = self.values.as_ref()?;
        Some(NetBoxes {
            inbox: Arc::clone(&values.in_directory),
            outbox: Arc::clone(&values.out_directory),
        })
    }

    /// Reads what it gave out last.
    pub(super) fn with_out_words<T>(&mut self, read: impl FnOnce(&[u64]) -> T) -> Option<T> {
        let values = self.values.as_mut()?;
        Some(values.out_reader.read_with(|words| read(words)))
    }

    pub(super) fn links_mut(&mut self) -> Option<&mut NetLinks> {
        Some(&mut self.values.as_mut()?.links)
    }

    pub(super) fn look_mut(&mut self) -> Option<&mut Look> {
        self.links_mut()?.look.as_mut()
    }

    /// One more reader of what it gives out; `None` if there are as many as there may be.
    pub(super) fn another_out_reader(&self) -> Option<LatestReader<Box<[u64]>>> {
        self.values.as_ref()?.out_reader.another()
    }

    /// A Boolean out value, if it is non-null.
    pub(super) fn out_bool(&mut self, entry: &Entry) -> Option<bool> {
        let reader = &mut self.values.as_mut()?.out_reader;
        reader.read_with(|words| {
            let current = entry.status(words) == OutStatus::Current;
            let value = entry.value(words).first().copied()?;
            current.then_some(value != 0)
        })
    }

    pub(super) fn info(&self, id: NetId) -> NetInfo {
        NetInfo {
            id,
            description: self.description.clone(),
            session: self.session,
            text: Arc::clone(&self.text),
            states: self.states.clone(),
            rejection: self.rejection.clone(),
            end: self.end.clone(),
        }
    }

    pub(super) fn out_values(&mut self) -> Vec<(String, String)> {
        let Some(values) = &mut self.values else {
            return Vec::new();
        };
        let directory = &values.out_directory;
        values.out_reader.read_with(|words| {
            let seen = directory
                .entries()
                .iter()
                .filter(|entry| entry.report && entry.status(words) != OutStatus::Never);
            seen.map(|entry| {
                let mut text = String::new();
                entry.format(words, &mut text);
                (entry.key.clone(), text)
            })
            .collect()
        })
    }

    pub(super) fn in_values(&self) -> Vec<(String, String)> {
        let Some(values) = &self.values else {
            return Vec::new();
        };
        let entries = values.in_directory.entries().iter();
        let entries = entries.filter(|entry| !entry.is_hidden());
        let text = |entry: &Entry| {
            let mut text = String::new();
            entry.format(&values.in_words, &mut text);
            (entry.key.clone(), text)
        };
        entries.map(text).collect()
    }

    pub(super) fn write_in(&mut self, id: NetId, key: &str, text: &str) -> Result<bool, Error> {
        let Some(values) = &mut self.values else {
            return Ok(false);
        };
        let entry = values.in_directory.find(key);
        let Some(entry) = entry.filter(|entry| !entry.is_hidden()) else {
            return Ok(false);
        };
        let written = entry.write(text, &mut values.in_words);
        written.map_err(|e| Error::Value {
            net: id,
            key: key.to_owned(),
            what: e.what,
        })?;
        let words = &values.in_words;
        values
            .in_writer
            .write_with(|slot| slot.copy_from_slice(words));
        Ok(true)
    }
}

type Wake = Box<dyn Fn() + Send + Sync>;

/// Everything behind the lock.
pub(super) struct Desk {
    /// The device's clock that net threads follow.
    pub(super) clock: Option<FollowedClock>,
    pub(super) stop: Arc<EmergencyStop>,
    /// Whether that was on when devices were last looked at.
    is_stopped: bool,
    pub(super) nets: BTreeMap<NetId, Net>,
    pub(super) departed: BTreeMap<NetId, Departed>,
    pub(super) sessions: BTreeMap<SessionId, Session>,
    pub(super) rules: BTreeMap<RuleId, RuleEntry>,
    last_rule: Option<u32>,
    pub(super) devices: DeviceTable,
    pub(super) drivers: Vec<Box<dyn DeviceDriver>>,
    pub(super) recorder: Option<Recorder>,
    pub(super) watches: BTreeMap<u64, Wake>,
    pub(super) last_watch: u64,
    /// How many nets were looked at when this was last counted.
    pub(super) looks: usize,
    pub(super) last_session: u32,
    last_net: Option<u32>,
    resources: HashMap<String, usize>,
    statuses: BTreeMap<String, DeviceStatus>,
    pub(super) threads: Vec<NetThread>,
    /// Threads of devices, by their name; the first for those that are not here.
    pub(super) serving: BTreeMap<String, usize>,
    /// Whether events were taken of which nobody was told yet.
    pub(super) unannounced: bool,
    /// Whether nothing is to begin any more.
    pub(super) closing: bool,
}

impl fmt::Debug for Desk {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Desk")
            .field("nets", &self.nets.len())
            .finish_non_exhaustive()
    }
}

impl Desk {
    pub(super) fn new(
        threads: Vec<NetThread>,
        clock: Option<FollowedClock>,
        stop: Arc<EmergencyStop>,
        recorder: Option<Recorder>,
    ) -> Self {
        Self {
            clock,
            stop,
            is_stopped: false,
            nets: BTreeMap::new(),
            departed: BTreeMap::new(),
            sessions: BTreeMap::new(),
            rules: BTreeMap::new(),
            last_rule: None,
            devices: DeviceTable::default(),
            drivers: Vec::new(),
            recorder,
            watches: BTreeMap::new(),
            last_watch: 0,
            looks: 0,
            last_session: 0,
            last_net: None,
            resources: HashMap::new(),
            statuses: BTreeMap::new(),
            threads,
            serving: BTreeMap::new(),
            unannounced: false,
            closing: false,
        }
    }

    pub(super) fn next_net(&mut self) -> NetId {
        let next = self.last_net.map_or(0, |last| last.wrapping_add(1));
        self.last_net = Some(next);
        NetId(next)
    }

    /// The next rule's number; an immediate start takes one too.
    pub(super) fn next_rule(&mut self) -> RuleId {
        let next = self.last_rule.map_or(0, |last| last.wrapping_add(1));
        self.last_rule = Some(next);
        RuleId(next)
    }

    pub(super) fn net(&mut self, id: NetId) -> Result<&mut Net, Error> {
        self.nets.get_mut(&id).ok_or(Error::NoSuchNet(id))
    }

    /// The number of a resource, a new one if it is seen for the first time.
    pub(super) fn resource(&mut self, name: &str) -> Result<usize, Rejection> {
        if let Some(number) = self.resources.get(name) {
            return Ok(*number);
        }
        let number = self.resources.len();
        if number >= ResourceSet::MAX {
            let (found, bound) = (number + 1, ResourceSet::MAX);
            let kind = FaultKind::Bound {
                what: "resources together with other nets",
                found,
                bound,
            };
            return Err(Rejection {
                faults: vec![Fault::new(kind, 0..0)],
            });
        }
        self.resources.insert(name.to_owned(), number);
        Ok(number)
    }

    pub(super) fn resource_name(&self, number: usize) -> String {
        let found = self.resources.iter().find(|(_, n)| **n == number);
        found.map_or_else(|| format!("resource {number}"), |(name, _)| name.clone())
    }

    /// Sends a net off to run.
    pub(super) fn begin(&mut self, id: NetId) -> Result<(), Error> {
        self.refuse_if_closing()?;
        let net = self.net(id)?;
        let (thread, command) = (net.thread, net.begin(id)?);
        self.next_rule();
        self.send(thread, command).map_err(|command| {
            if let (Command::Start(running), Ok(net)) = (command, self.net(id)) {
                net.take_back(running, None);
            } else if let Ok(net) = self.net(id) {
                net.starting = None;
            }
            busy()
        })
    }

    /// Takes a net that does not run away from rules that wait to start it or wait for it.
    pub(super) fn withdraw(&mut self, id: NetId) -> Result<(), Error> {
        if self.net(id)?.with_rules {
            self.command(Command::Unschedule {
                net: id.0,
                always: true,
            })?;
        }
        self.command(Command::Forget(id.0))
    }

    /// The outcome of a start, once it is known.
    pub(super) fn begun(&mut self, id: NetId) -> Option<Result<(), Error>> {
        match self.nets.get_mut(&id) {
            None => Some(Err(Error::NoSuchNet(id))),
            Some(net) => match net.starting.take() {
                Some(None) => {
                    net.starting = Some(None);
                    None
                }
                Some(Some(outcome)) => Some(outcome),
                None => Some(Ok(())),
            },
        }
    }

    /// Notes changes of devices; returns whether there were any.
    pub(super) fn look_at_devices(&mut self) -> bool {
        for driver in &self.drivers {
            let news = std::iter::from_fn(|| driver.news()).take(NEWS_AT_ONCE);
            news.for_each(|news| tracing::info!(driver = driver.name(), "{news}"));
        }
        let is_stopped = self.stop.is_on(takt_rt::monotonic());
        let statuses: BTreeMap<String, DeviceStatus> = self
            .devices
            .all()
            .map(|(_, device)| (device.name.clone(), device.status().under(is_stopped)))
            .collect();
        if is_stopped != self.is_stopped {
            self.is_stopped = is_stopped;
            if is_stopped {
                tracing::warn!(
                    "emergency stop: all devices stop, and the nets that command them end"
                );
            } else {
                tracing::info!("the emergency stop is over");
            }
        } else if statuses == self.statuses {
            return false;
        }
        for (name, status) in &statuses {
            let before = self.statuses.get(name).copied().unwrap_or_default();
            if before != *status {
                let driver = self.drivers.iter().find(|driver| driver.drives(name));
                let figures = driver.map(|driver| listed(&driver.figures()));
                tracing::info!(device = name, %before, now = %status, figures, "device");
            }
        }
        self.statuses = statuses;
        true
    }

    pub(super) fn device_infos(&self) -> Vec<DeviceInfo> {
        let is_stopped = self.stop.is_on(takt_rt::monotonic());
        let info = |device: &crate::device::Device| DeviceInfo {
            name: device.name.clone(),
            kind: device.kind.to_owned(),
            interfaces: device.told(),
            status: device.status().under(is_stopped),
        };
        self.devices.all().map(|(_, device)| info(device)).collect()
    }
}

/// Figures in one line.
fn listed(figures: &[(&'static str, String)]) -> String {
    let pairs = figures
        .iter()
        .map(|(name, value)| format!("{name} {value}"));
    pairs.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests;

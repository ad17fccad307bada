//! What the controller knows: nets, sessions, devices, and the way to the net thread. Guarded by
//! one lock that no real-time thread ever takes.

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use takt_net::Rejection;
use takt_net::fault::{Fault, FaultKind};
use takt_net::netcomm::{Directory, Entry, OutStatus};
use takt_rt::latest::{LatestReader, LatestWriter};

use crate::controller::departed::Departed;
use crate::controller::rules::{RuleEntry, RuleId};
use crate::controller::{DeviceInfo, NetId, NetInfo, NetState, SessionId};
use crate::device::lwr::Lwr;
use crate::device::{DeviceStatus, DeviceTable};
use crate::error::Error;
use crate::executor::thread::{Command, Event, NetThread};
use crate::executor::{End, Refusal, ResourceSet, Running};
use crate::record::Recorder;

/// An open session.
#[derive(Debug)]
pub(super) struct Session {
    pub(super) description: String,
}

/// A net made ready, with the program's ends of its values.
#[derive(Debug)]
pub(super) struct Prepared {
    pub(super) running: Box<Running>,
    pub(super) out_directory: Arc<Directory>,
    pub(super) out_reader: LatestReader<Box<[u64]>>,
    pub(super) in_directory: Arc<Directory>,
    pub(super) in_writer: LatestWriter<Box<[u64]>>,
    pub(super) in_words: Box<[u64]>,
}

#[derive(Debug)]
struct Values {
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
    /// Set while a start is under way, and then to its outcome.
    starting: Option<Option<Result<(), Error>>>,
    /// Whether the net thread keeps it for rules to start.
    with_rules: bool,
    values: Option<Values>,
    /// Devices that the net reads or commands.
    devices: Vec<String>,
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
        }
    }

    pub(super) fn state(&self) -> NetState {
        self.states.last().copied().unwrap_or(NetState::Loading)
    }

    fn enter(&mut self, state: NetState) {
        self.states.push(state);
    }

    pub(super) fn make_ready(&mut self, prepared: Prepared) {
        let Prepared {
            running,
            out_directory,
            out_reader,
            in_directory,
            in_writer,
            in_words,
        } = prepared;
        self.devices = running.plan.uses().to_vec();
        self.running = Some(running);
        self.values = Some(Values {
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

    /// Ends a net that never ran.
    pub(super) fn end(&mut self, why: String) {
        self.end = Some(why);
        self.running = None;
        self.enter(NetState::Terminated);
    }

    /// Whether the net reads or commands the device of that name.
    pub(super) fn uses(&self, device: &str) -> bool {
        self.devices.iter().any(|name| name == device)
    }

    /// Whether a start is under way.
    pub(super) const fn is_starting(&self) -> bool {
        self.starting.is_some()
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
        let Some(entry) = values.in_directory.find(key) else {
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
    pub(super) nets: BTreeMap<NetId, Net>,
    pub(super) departed: BTreeMap<NetId, Departed>,
    pub(super) sessions: BTreeMap<SessionId, Session>,
    pub(super) rules: BTreeMap<RuleId, RuleEntry>,
    last_rule: Option<u32>,
    pub(super) devices: DeviceTable,
    pub(super) arms: Vec<Lwr>,
    pub(super) recorder: Option<Recorder>,
    pub(super) watches: BTreeMap<u64, Wake>,
    pub(super) last_watch: u64,
    pub(super) last_session: u32,
    last_net: Option<u32>,
    resources: HashMap<String, usize>,
    statuses: BTreeMap<String, DeviceStatus>,
    thread: Option<NetThread>,
    /// Whether events were taken of which nobody was told yet.
    pub(super) unannounced: bool,
}

impl fmt::Debug for Desk {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Desk")
            .field("nets", &self.nets.len())
            .finish_non_exhaustive()
    }
}

impl Desk {
    pub(super) fn new(thread: NetThread, recorder: Option<Recorder>) -> Self {
        Self {
            nets: BTreeMap::new(),
            departed: BTreeMap::new(),
            sessions: BTreeMap::new(),
            rules: BTreeMap::new(),
            last_rule: None,
            devices: DeviceTable::default(),
            arms: Vec::new(),
            recorder,
            watches: BTreeMap::new(),
            last_watch: 0,
            last_session: 0,
            last_net: None,
            resources: HashMap::new(),
            statuses: BTreeMap::new(),
            thread: Some(thread),
            unannounced: false,
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

    /// Tells the net thread something.
    pub(super) fn command(&mut self, command: Command) -> Result<(), Error> {
        let bound = crate::executor::RUNNING_MAX;
        let busy = || Error::TooMany {
            what: "requests to the net thread",
            bound,
        };
        let thread = self.thread.as_mut().ok_or_else(busy)?;
        thread.commands.push(command).map_err(|_| busy())
    }

    /// Sends a net off to run.
    pub(super) fn begin(&mut self, id: NetId) -> Result<(), Error> {
        let net = self.net(id)?;
        let state = net.state();
        if !matches!(state, NetState::Ready | NetState::Scheduled) || net.starting.is_some() {
            let what = "only a net that is READY can be started; load it again";
            return Err(Error::WrongState {
                net: id,
                state,
                what,
            });
        }
        let command = match net.running.take() {
            Some(running) => Command::Start(running),
            None if net.with_rules => Command::StartScheduled(id.0),
            None => {
                let what = "it is being started already";
                return Err(Error::WrongState {
                    net: id,
                    state,
                    what,
                });
            }
        };
        net.starting = Some(None);
        self.next_rule();
        self.command(command)
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

    /// Takes what the net thread has to tell; returns whether it had anything.
    pub(super) fn take_events(&mut self) -> bool {
        let mut any = false;
        while let Some(event) = self.thread.as_mut().and_then(|t| t.events.pop()) {
            any = true;
            match event {
                Event::Started(id) => self.with(id, |net| {
                    net.with_rules = false;
                    net.starting = net.starting.take().map(|_| Some(Ok(())));
                    net.enter(NetState::Running);
                }),
                Event::Cancelling(id) => self.with(id, |net| {
                    if net.state() == NetState::Running {
                        net.enter(NetState::Cancelling);
                    }
                }),
                Event::Refused(running, refusal) => self.refused(running, refusal),
                Event::ArmRemoved(end) => drop(end),
                Event::RuleAdded(id) => self.rule_added(id),
                Event::RuleRefused(rule, why) => self.rule_refused(&rule, why),
                Event::RuleDone(rule) => self.rule_done(&rule),
                Event::Unscheduled(running) => self.unscheduled(running),
                Event::Ended(running, end) => {
                    let why = self.end_text(end);
                    if let (Some(why), End::DeviceFault(_)) = (&why, end) {
                        tracing::warn!(net = %NetId(running.id), why, "net ended");
                    }
                    self.with(running.id, |net| {
                        net.end = why;
                        net.enter(NetState::Terminated);
                    });
                }
            }
        }
        any
    }

    fn with(&mut self, id: u32, change: impl FnOnce(&mut Net)) {
        if let Some(net) = self.nets.get_mut(&NetId(id)) {
            change(net);
        }
    }

    /// A net is back from the rules. If a start by hand crossed its way, it is sent off again.
    fn unscheduled(&mut self, running: Box<Running>) {
        let Some(net) = self.nets.get_mut(&NetId(running.id)) else {
            return;
        };
        net.with_rules = false;
        if matches!(net.starting, Some(None)) {
            if self.command(Command::Start(running)).is_err() {
                tracing::error!("the net thread takes no more requests");
            }
        } else {
            net.running = Some(running);
        }
    }

    fn refused(&mut self, running: Box<Running>, refusal: Refusal) {
        let net = NetId(running.id);
        let error = match refusal {
            Refusal::TooMany => Error::TooMany {
                what: "running nets",
                bound: crate::executor::RUNNING_MAX,
            },
            Refusal::ResourceKept(number) => Error::ResourceKept {
                net,
                resource: self.resource_name(number),
            },
            Refusal::ResourceInUse(number) => Error::ResourceInUse {
                net,
                resource: self.resource_name(number),
            },
            Refusal::DeviceNotReady(number) => {
                let arm = self.devices.get(number);
                Error::DeviceNotReady {
                    net,
                    device: arm.map_or_else(|| format!("device {number}"), |a| a.name.clone()),
                    status: arm
                        .map_or(DeviceStatus::Offline, |a| a.status())
                        .to_string(),
                }
            }
        };
        self.with(running.id, |net| {
            net.with_rules = false;
            net.running = Some(running);
            net.starting = Some(Some(Err(error)));
        });
    }

    /// Why a net ended, unless it did so by itself.
    fn end_text(&self, end: End) -> Option<String> {
        match end {
            End::Terminated => None,
            End::Aborted => Some("aborted".to_owned()),
            End::Stopped => Some("stopped by a rule".to_owned()),
            End::DeviceFault(number) => {
                let arm = self.devices.get(number);
                let name = arm.map_or("?", |a| a.name.as_str());
                let status = arm.map_or(DeviceStatus::Offline, |a| a.status());
                Some(format!(
                    "device {name} ceased to follow commands and is {status}"
                ))
            }
        }
    }

    /// Notes changes of devices; returns whether there were any.
    pub(super) fn look_at_devices(&mut self) -> bool {
        let statuses: BTreeMap<String, DeviceStatus> = self
            .devices
            .arms()
            .map(|(_, arm)| (arm.name.clone(), arm.status()))
            .collect();
        if statuses == self.statuses {
            return false;
        }
        for (name, status) in &statuses {
            let before = self.statuses.get(name).copied().unwrap_or_default();
            if before != *status {
                let driver = self.arms.iter().find(|arm| arm.name() == name);
                let quality = driver.map(|arm| format!("{:?}", arm.figures().quality));
                tracing::info!(device = name, %before, now = %status, quality, "device");
            }
        }
        self.statuses = statuses;
        true
    }

    pub(super) fn device_infos(&self) -> Vec<DeviceInfo> {
        let info = |arm: &crate::device::Arm| {
            let joints = ("jointcount".to_owned(), arm.limits.len().to_string());
            let robot_arm = ("robotarm".to_owned(), BTreeMap::from([joints]));
            let kinematics = arm.kinematics.iter();
            let kinematics = kinematics.map(|_| ("armkinematics".to_owned(), BTreeMap::new()));
            DeviceInfo {
                name: arm.name.clone(),
                kind: arm.kind.to_owned(),
                interfaces: kinematics.chain([robot_arm]).collect(),
                status: arm.status(),
            }
        };
        self.devices.arms().map(|(_, arm)| info(arm)).collect()
    }

    pub(super) fn thread_stats(&self) -> takt_rt::stats::Snapshot {
        match &self.thread {
            Some(thread) => thread.stats.snapshot(),
            None => takt_rt::stats::pair().1.snapshot(),
        }
    }

    pub(super) fn hand_over(&self) -> takt_rt::stats::Summary {
        match &self.thread {
            Some(thread) => thread.hand_over.read().summary(),
            None => takt_rt::stats::Recorder::new().reader().read().summary(),
        }
    }

    pub(super) fn grants(&self) -> Vec<(String, takt_rt::Grant)> {
        let nets = self.thread.iter().flat_map(|t| t.grants().iter());
        let nets = nets.map(|grant| ("net thread".to_owned(), grant.clone()));
        let arms = self.arms.iter();
        let arms = arms.flat_map(|a| a.grants().iter().map(|g| (a.name().to_owned(), g.clone())));
        nets.chain(arms).collect()
    }

    /// Ends all threads. Drivers go last, so that they see their set-points end and brake.
    pub(super) fn stop(&mut self) {
        if let Some(thread) = self.thread.take() {
            thread.stop();
        }
        for arm in self.arms.drain(..) {
            arm.stop();
        }
    }
}

/// How many cycles of the thread one cycle of a net takes.
pub(super) fn multiple(period: Duration, thread_period: Duration) -> Result<u64, Rejection> {
    let (wanted, given) = (period.as_nanos(), thread_period.as_nanos().max(1));
    if wanted > 0 && wanted.is_multiple_of(given) {
        return Ok(u64::try_from(wanted / given).unwrap_or(u64::MAX));
    }
    let why = format!("{period:?} is no whole multiple of the controller's {thread_period:?}");
    let kind = FaultKind::Parameter {
        parameter: "cycle".to_owned(),
        why,
    };
    Err(Rejection {
        faults: vec![Fault::new(kind, 0..0)],
    })
}

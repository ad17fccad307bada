//! The controller's registry: nets, sessions, rules, devices, and the handles of net threads. Guarded by
//! one lock that real-time threads never take.

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

use takt_net::Rejection;
use takt_net::fault::{Fault, FaultKind};
use takt_rt::stats::StallReader;

use crate::cell::OnLoss;
use crate::controller::clock::FollowedClock;
use crate::controller::driver_log::DriverLog;
use crate::controller::faults::Faults;
use crate::controller::limited::Reported;
use crate::controller::net::Net;
use crate::controller::quota::Quota;
use crate::controller::retained::RetainedNet;
use crate::controller::rules::{RuleEntry, RuleId};
use crate::controller::threads::busy;
use crate::controller::{DeviceInfo, NetId, SessionId};
use crate::device::driver::DeviceDriver;
use crate::device::driver::Notice;
use crate::device::{DeviceStatus, DeviceTable};
use crate::error::Error;
use crate::executor::ResourceSet;
use crate::executor::stop::EmergencyStop;
use crate::executor::thread::{Command, NetThread};
use crate::record::Recorder;
use crate::stop_channel::Generation;

/// Notices of one driver that are taken before the next driver is polled.
const NEWS_AT_ONCE: usize = 32;
/// Minimum interval between reports of requests that the stop channel rejected.
const REFUSED_EVERY: Duration = Duration::from_secs(10);

/// An open session.
#[derive(Debug)]
pub(super) struct Session {
    pub(super) description: String,
    pub(super) on_loss: OnLoss,
}

type Wake = Box<dyn Fn() + Send + Sync>;

/// Everything behind the lock.
pub(super) struct Registry {
    /// The device clock that net threads follow.
    pub(super) clock: Option<FollowedClock>,
    pub(super) stop: Arc<EmergencyStop>,
    /// Memory limits of all nets together.
    pub(super) room: Quota,
    /// Whether it was active at the last poll of devices.
    is_stopped: bool,
    /// Last report on the stop channel: its generation, rejected requests, and when.
    stop_told: (Generation, u64, Option<Instant>),
    pub(super) nets: BTreeMap<NetId, Net>,
    pub(super) retained: BTreeMap<NetId, RetainedNet>,
    pub(super) sessions: BTreeMap<SessionId, Session>,
    pub(super) rules: BTreeMap<RuleId, RuleEntry>,
    last_rule: Option<u32>,
    pub(super) devices: DeviceTable,
    pub(super) drivers: Vec<Box<dyn DeviceDriver>>,
    news: DriverLog,
    pub(super) faults: Faults,
    /// Other threads of this process that measure their stalls, by name.
    pub(super) watched_stalls: Vec<(String, StallReader)>,
    pub(super) recorder: Option<Recorder>,
    pub(super) watches: BTreeMap<u64, Wake>,
    pub(super) last_watch: u64,
    /// Number of nets whose taps are recorded, as last counted.
    pub(super) recorded_nets: usize,
    pub(super) last_session: u32,
    last_net: Option<u32>,
    resources: HashMap<String, usize>,
    statuses: BTreeMap<String, DeviceStatus>,
    /// Reported onsets of limiting by devices' last stages.
    pub(super) reported: Reported,
    /// Number of reported position jumps, by device.
    pub(super) reported_jumps: BTreeMap<String, u64>,
    pub(super) threads: Vec<NetThread>,
    /// Net threads of devices, by device name; the first thread for devices that are not listed.
    pub(super) serving: BTreeMap<String, usize>,
    /// Whether events were applied and watchers not yet notified.
    pub(super) unannounced: bool,
    /// Whether the controller is shutting down: nothing starts any more.
    pub(super) closing: bool,
}

impl fmt::Debug for Registry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Registry")
            .field("nets", &self.nets.len())
            .finish_non_exhaustive()
    }
}

impl Registry {
    pub(super) fn new(
        threads: Vec<NetThread>,
        clock: Option<FollowedClock>,
        stop: Arc<EmergencyStop>,
        recorder: Option<Recorder>,
        room: Quota,
    ) -> Self {
        Self {
            clock,
            stop,
            room,
            is_stopped: false,
            stop_told: (Generation::default(), 0, None),
            nets: BTreeMap::new(),
            retained: BTreeMap::new(),
            sessions: BTreeMap::new(),
            rules: BTreeMap::new(),
            last_rule: None,
            devices: DeviceTable::default(),
            drivers: Vec::new(),
            news: DriverLog::default(),
            faults: Faults::default(),
            watched_stalls: Vec::new(),
            recorder,
            watches: BTreeMap::new(),
            last_watch: 0,
            recorded_nets: 0,
            last_session: 0,
            last_net: None,
            resources: HashMap::new(),
            statuses: BTreeMap::new(),
            reported: Reported::new(),
            reported_jumps: BTreeMap::new(),
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

    /// The number of a resource, assigned at first use.
    pub(super) fn resource(&mut self, name: &str) -> Result<usize, Rejection> {
        if let Some(number) = self.resources.get(name) {
            return Ok(*number);
        }
        let number = self.resources.len();
        if number >= ResourceSet::MAX {
            let (found, bound) = (number + 1, ResourceSet::MAX);
            let kind = FaultKind::Bound {
                item: "resources together with other nets",
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

    /// Sends a net to its thread to run.
    pub(super) fn begin(&mut self, id: NetId) -> Result<(), Error> {
        self.refuse_if_closing()?;
        self.refuse_if_stopped()?;
        self.net(id)?.check_begin(id)?;
        self.keep_for_start(id)?;
        let requested = self.stop.switch().generation();
        let net = self.net(id)?;
        let (thread, command) = (net.thread, net.begin(id, requested));
        self.next_rule();
        self.send(thread, command).map_err(|command| {
            if let (Command::Start(running), Ok(net)) = (command, self.net(id)) {
                net.take_back(running, None);
            } else if let Ok(net) = self.net(id) {
                net.forget_start();
            }
            busy()
        })
    }

    /// Withdraws a net that does not run from rules that wait to start it or wait for it.
    pub(super) fn withdraw(&mut self, id: NetId) -> Result<(), Error> {
        if self.net(id)?.is_with_rules() {
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
            Some(net) => net.begun(),
        }
    }

    /// Notices of drivers as log lines, with the drivers' names.
    pub(super) fn take_notices(&mut self, now: Instant) -> Vec<(String, Notice)> {
        let mut lines = Vec::new();
        for driver in &self.drivers {
            let news = std::iter::from_fn(|| driver.news()).take(NEWS_AT_ONCE);
            let news = self.news.take(driver.name(), news, now).into_iter();
            lines.extend(news.map(|line| (driver.name().to_owned(), line)));
        }
        let jumps = self.poll_jumps();
        for (device, line) in self.poll_limits().into_iter().chain(jumps) {
            let line = std::iter::once(Notice::warning(line));
            let news = self.news.take(&device, line, now);
            lines.extend(news.into_iter().map(|line| (device.clone(), line)));
        }
        lines
    }

    /// Logs changes of devices; returns whether there were any.
    pub(super) fn poll_devices(&mut self) -> bool {
        let faulted = self.poll_faults(takt_rt::monotonic());
        let is_stopped = self.stop.is_on(takt_rt::monotonic());
        let statuses: BTreeMap<String, DeviceStatus> = self
            .devices
            .all()
            .map(|(_, device)| (device.name.clone(), device.status().under(is_stopped)))
            .collect();
        let is_switched = self.report_switch();
        if is_stopped != self.is_stopped {
            self.is_stopped = is_stopped;
            if self.stop.switch().is_stopped() || (is_switched && !is_stopped) {
                // The stop itself was reported.
            } else if is_stopped {
                tracing::warn!(
                    "emergency stop: all devices stop, and the nets that command them end"
                );
            } else {
                tracing::info!("the emergency stop is over");
            }
        } else if statuses == self.statuses {
            return is_switched;
        }
        for (name, status) in &statuses {
            let before = self.statuses.get(name).copied().unwrap_or_default();
            // The fault was reported with its cause.
            if before != *status && !faulted.contains(name) {
                let driver = self.drivers.iter().find(|driver| driver.drives(name));
                let figures = driver.map(|driver| listed(&driver.figures()));
                let now = status;
                // A device that was disabled on purpose is no fault.
                if *now < before && !is_stopped && !self.closing {
                    tracing::warn!(device = name, %before, %now, figures, "device");
                } else {
                    tracing::info!(device = name, %before, %now, figures, "device");
                }
            }
        }
        self.statuses = statuses;
        true
    }

    /// Logs the stop channel's actions; returns whether there were any. Rejected requests are logged at
    /// most once per [`REFUSED_EVERY`], with their number.
    fn report_switch(&mut self) -> bool {
        let switch = self.stop.switch();
        let (generation, refused) = (switch.generation(), switch.refused());
        let (before, told, at) = self.stop_told;
        let is_due = at.is_none_or(|at| at.elapsed() > REFUSED_EVERY);
        if refused != told && is_due {
            let count = refused - told;
            tracing::warn!(
                count,
                "the stop channel rejected requests: wrong token, or user without permission"
            );
            self.stop_told = (before, refused, Some(Instant::now()));
        }
        if generation == before {
            return false;
        }
        self.stop_told.0 = generation;
        if generation.stops() != before.stops() {
            let by = switch.last_stop().map(|(by, _)| by.to_string());
            let by = by.unwrap_or_default();
            tracing::warn!(
                by,
                "stopped: all nets end, all devices stop, nothing starts\nhint: release the stop with `takt stop --release`"
            );
        }
        if !generation.is_stopped() {
            tracing::info!("the stop is released; programs may start nets again");
        }
        true
    }

    pub(super) fn device_infos(&self) -> Vec<DeviceInfo> {
        let is_stopped = self.stop.is_on(takt_rt::monotonic());
        let info = |device: &crate::device::Device| DeviceInfo {
            name: device.name.clone(),
            kind: device.kind.to_owned(),
            interfaces: device.properties(),
            status: device.status().under(is_stopped),
        };
        self.devices.all().map(|(_, device)| info(device)).collect()
    }
}

/// Figures in one line.
pub(super) fn listed(figures: &[(&'static str, String)]) -> String {
    let pairs = figures
        .iter()
        .map(|(name, value)| format!("{name} {value}"));
    pairs.collect::<Vec<_>>().join(", ")
}

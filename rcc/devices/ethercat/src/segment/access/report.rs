//! The state of a segment at one moment. The driver thread fills it without allocation; its texts are made by its reader.

use std::time::Duration;

use serde_json::{Value, json};
use takt_core::Nanos;
use takt_ethercat::master::{
    Cable, Event, Fault, FrameCounters, Group, Master, Phase, PortCounters, PortState, SlaveView,
};
use takt_ethercat::sii::Identity;
use takt_ethercat::{AlStatus, AlStatusCode};

use super::history::History;

/// Room for slaves that are not in the cell.
const STRANGERS: usize = 16;
/// Groups of a segment.
const GROUPS: usize = 8;
/// Longest name, bytes; longer ones are cut.
const NAME: usize = 64;

/// A slave.
#[derive(Clone, Debug)]
struct SlaveReport {
    /// In its SII.
    name: String,
    spec: String,
    position: Option<u16>,
    station: u16,
    identity: Identity,
    alias: u16,
    al: AlStatus,
    code: AlStatusCode,
    is_running: bool,
    fault: Option<Fault>,
    ports: [PortState; 4],
    parent: Option<(usize, u8)>,
    counters: PortCounters,
    has_clock: bool,
    difference_ns: Option<i32>,
    delay_ns: u32,
    violations: u64,
    has_sync: bool,
    mailbox: (u32, u32),
}

/// The state of a segment.
#[derive(Debug)]
pub(super) struct Report {
    phase: Phase,
    is_operational: bool,
    is_redundant: bool,
    now: Nanos,
    cycles: u64,
    frames: FrameCounters,
    /// When the last frame was lost, and the last working counter missed.
    losses: [Option<Nanos>; 2],
    dropped: u64,
    reference: Option<usize>,
    gap: Option<Cable>,
    groups: Vec<Group>,
    /// Those that are used; the rest is room.
    count: usize,
    slaves: Vec<SlaveReport>,
    /// Slaves without room.
    left_out: usize,
}

impl Report {
    /// An empty report with room for the slaves of a cell and some others.
    pub(super) fn with_room(slaves: usize) -> Self {
        let room = || SlaveReport {
            name: String::with_capacity(NAME),
            spec: String::with_capacity(NAME),
            position: None,
            station: 0,
            identity: Identity::default(),
            alias: 0,
            al: AlStatus::default(),
            code: AlStatusCode::default(),
            is_running: false,
            fault: None,
            ports: [PortState {
                link: false,
                open: false,
            }; 4],
            parent: None,
            counters: PortCounters::default(),
            has_clock: false,
            difference_ns: None,
            delay_ns: 0,
            violations: 0,
            has_sync: false,
            mailbox: (0, 0),
        };
        Self {
            phase: Phase::Count,
            is_operational: false,
            is_redundant: false,
            now: Nanos(0),
            cycles: 0,
            frames: FrameCounters::default(),
            losses: [None; 2],
            dropped: 0,
            reference: None,
            gap: None,
            groups: Vec::with_capacity(GROUPS),
            count: 0,
            slaves: (0..slaves + STRANGERS).map(|_| room()).collect(),
            left_out: 0,
        }
    }

    /// Copies the state of the master.
    pub(super) fn fill(&mut self, master: &Master, now: Nanos, losses: [Option<Nanos>; 2]) {
        (self.phase, self.now, self.losses) = (master.phase(), now, losses);
        self.is_operational = master.is_operational();
        self.is_redundant = master.config().redundant;
        (self.cycles, self.frames) = (master.cycles(), master.frames());
        (self.dropped, self.reference) = (master.dropped(), master.reference());
        self.gap = master.ring_gap();
        self.groups.clear();
        self.groups
            .extend(master.groups().iter().take(GROUPS).cloned());
        self.count = master.len().min(self.slaves.len());
        self.left_out = master.len() - self.count;
        for (number, to) in self.slaves.iter_mut().take(self.count).enumerate() {
            if let Some(slave) = master.slave(number) {
                to.fill(slave, master);
            }
        }
    }

    /// The report as JSON.
    pub(super) fn object(
        &self,
        name: &str,
        interfaces: &[String],
        cycle: Duration,
        history: &History,
    ) -> Value {
        let ago = |at: Option<Nanos>| at.map(|at| seconds(self.now - at));
        let [lost_ago, missed_ago] = self.losses.map(ago);
        let frames = self.frames;
        let used = self.slaves.get(..self.count).unwrap_or_default();
        let group = |(number, group): (usize, &Group)| {
            let (least, most) = group.expected;
            json!({
                "group": number,
                "counter": group.counter,
                "expected_min": least,
                "expected_max": most,
                "misses": group.misses,
            })
        };
        let used_groups = self.groups.iter().enumerate();
        let groups = used_groups.filter(|(_, group)| group.expected.1 > 0 || group.misses > 0);
        let gap = self.gap.map(|cable| Event::RingOpen { cable }.to_string());
        json!({
            "version": 1,
            "segment": name,
            "interfaces": interfaces,
            "cycle_s": cycle.as_secs_f64(),
            "phase": format!("{:?}", self.phase).to_lowercase(),
            "operational": self.is_operational,
            "redundant": self.is_redundant,
            "ring_open": gap,
            "reference": self.reference,
            "cycles": self.cycles,
            "frames": {
                "sent": frames.sent,
                "answered": frames.answered,
                "lost": frames.lost.saturating_sub(frames.stale),
                "late": frames.stale,
                "foreign": frames.foreign,
                "last_lost_ago_s": lost_ago,
            },
            "groups": groups.map(group).collect::<Vec<_>>(),
            "last_miss_ago_s": missed_ago,
            "slaves": used.iter().enumerate().map(SlaveReport::object).collect::<Vec<_>>(),
            "slaves_left_out": self.left_out,
            "events_dropped": self.dropped,
            "history": history.object(),
        })
    }
}

fn seconds(span: Nanos) -> f64 {
    let span = Duration::from_nanos(u64::try_from(span.0).unwrap_or(0));
    (span.as_secs_f64() * 1e3).round() / 1e3
}

/// Copies a text as far as there is room.
fn copy(to: &mut String, from: &str) {
    to.clear();
    for c in from.chars() {
        if to.len() + c.len_utf8() > to.capacity() {
            return;
        }
        to.push(c);
    }
}

impl SlaveReport {
    fn fill(&mut self, slave: SlaveView<'_>, master: &Master) {
        let info = slave.info();
        let named = if info.name.is_empty() {
            &info.order
        } else {
            &info.name
        };
        copy(&mut self.name, named);
        copy(&mut self.spec, &slave.spec().name);
        (self.position, self.station) = (slave.position(), slave.station());
        (self.identity, self.alias) = (info.identity, info.alias);
        (self.al, self.code) = slave.al();
        (self.is_running, self.fault) = (slave.is_running(), slave.fault());
        self.ports = info.ports();
        let at = slave.position().map(usize::from);
        let above = at.and_then(|at| master.topology().parent(at));
        self.parent = above.map(|(parent, port)| (parent, u8::try_from(port).unwrap_or(0)));
        self.counters = *slave.counters();
        self.has_clock = info.has_clock();
        self.difference_ns = slave.clock_difference_ns();
        (self.delay_ns, self.violations) = (slave.delay_ns(), slave.clock_violations());
        self.has_sync = slave.sync_start_ns().is_some();
        self.mailbox = slave.mailbox_counters();
    }

    fn object((number, slave): (usize, &Self)) -> Value {
        let ports = slave
            .ports
            .map(|port| json!({ "link": port.link, "open": port.open }));
        let counters = &slave.counters;
        let (unexpected, repeated) = slave.mailbox;
        let error = slave.al.error.then(|| slave.code.to_string());
        json!({
            "slave": number,
            "spec": slave.spec,
            "name": slave.name,
            "position": slave.position,
            "station": slave.station,
            "alias": slave.alias,
            "vendor": slave.identity.vendor,
            "product": slave.identity.product,
            "revision": slave.identity.revision,
            "serial": slave.identity.serial,
            "state": slave.al.to_string(),
            "al_code": slave.code.0,
            "al_text": error,
            "running": slave.is_running,
            "fault": slave.fault.map(|fault| fault.to_string()),
            "ports": ports,
            "parent": slave.parent.map(|(at, port)| json!({ "position": at, "port": port })),
            "invalid": counters.invalid,
            "receive": counters.receive,
            "forwarded": counters.forwarded,
            "lost_links": counters.lost_links,
            "processing": counters.processing,
            "controller": counters.controller,
            "mailbox_unexpected": unexpected,
            "mailbox_repeated": repeated,
            "clock": slave.has_clock,
            "sync": slave.has_sync,
            "difference_ns": slave.difference_ns,
            "delay_ns": slave.delay_ns,
            "clock_violations": slave.violations,
        })
    }
}

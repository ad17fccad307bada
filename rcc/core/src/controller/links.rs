//! Links between nets, and recording of debug taps. Links are created when a net is loaded, recordings when a
//! client polls the taps. No net is evaluated here.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use takt_net::device::{ArmBinding, Devices, Interfaces};
use takt_net::fault::{Fault, FaultKind};
use takt_net::netcomm::{Inter, NetBoxes};
use takt_net::taps::{Tap, record_time};
use takt_net::{Nanos, Plan, Rejection};
use takt_rt::latest::LatestReader;

use crate::controller::registry::Registry;
use crate::controller::{Controller, Inner};
use crate::device::DeviceTable;
use crate::error::Error;
use crate::executor::links::{
    Links, LinksEnd, OUT_READERS, TapReader, WIRES_MAX, Wire, links, taps,
};
use crate::ids::NetId;

/// How long a net's taps are recorded after the last poll.
pub const TAPS_RECORDED_FOR: Duration = Duration::from_secs(10);
/// Maximum number of nets whose taps are recorded.
pub const RECORDED_NETS_MAX: usize = 16;
/// Records that wait for the supervisor, which polls every few milliseconds.
const WAITING: usize = 512;
/// Bytes of the waiting records.
const WAITING_BYTES: usize = 4 << 20;
/// Bytes of the records kept of one net; the oldest are dropped.
const REMEMBERED_BYTES: usize = 64 << 20;

/// What one cycle of a net recorded.
#[derive(Clone, Debug)]
pub struct TapRecord {
    /// Its number, from 0 at the first poll; gaps are lost records.
    pub number: u64,
    words: Arc<[u64]>,
}

impl TapRecord {
    /// The logical time of the cycle.
    #[must_use]
    pub fn time(&self) -> Nanos {
        record_time(&self.words)
    }

    /// The text of a port's value; `None` if it was null.
    #[must_use]
    pub fn text(&self, tap: &Tap) -> Option<String> {
        tap.text(&self.words)
    }
}

/// The debug taps of a net and their records.
#[derive(Clone, Debug)]
pub struct Taps {
    /// The tapped ports.
    pub taps: Arc<[Tap]>,
    /// The records, oldest first.
    pub records: Vec<TapRecord>,
}

/// The recording of one net's taps.
#[derive(Debug)]
pub(super) struct TapRecording {
    reader: TapReader,
    until: Instant,
    /// The longest time span of a tap.
    span: Duration,
    records_max: usize,
    next: u64,
    records: VecDeque<TapRecord>,
}

impl TapRecording {
    /// Takes new records; returns whether the recording is still requested.
    pub(super) fn drain(&mut self, now: Instant) {
        let Self {
            reader,
            next,
            records,
            ..
        } = self;
        reader.set_on(now < self.until);
        reader.drain(|words| {
            let (number, words) = (*next, words.into());
            *next += 1;
            records.push_back(TapRecord { number, words });
        });
        if now >= self.until {
            *records = VecDeque::new();
            return;
        }
        let newest = records.back().map_or(Nanos(0), TapRecord::time);
        let span = i64::try_from(self.span.as_nanos()).unwrap_or(i64::MAX);
        let old = |record: &TapRecord| newest.0 - record.time().0 > span;
        while records.len() > self.records_max || records.front().is_some_and(old) {
            records.pop_front();
        }
    }

    fn is_on(&self) -> bool {
        Instant::now() < self.until
    }
}

/// The controller's side of a net's links.
#[derive(Debug)]
pub(super) struct NetLinks {
    pub(super) end: LinksEnd,
    taps: Arc<[Tap]>,
    record_words: usize,
    pub(super) tap_recording: Option<TapRecording>,
}

/// Devices and nets, as a net that is loaded may refer to them.
pub(super) struct Surroundings<'a> {
    pub(super) devices: &'a DeviceTable,
    pub(super) inner: &'a Inner,
}

impl Devices for Surroundings<'_> {
    fn arm(&self, name: &str) -> Option<ArmBinding> {
        self.devices.arm(name)
    }

    fn interfaces(&self, name: &str) -> Option<Interfaces> {
        self.devices.interfaces(name)
    }

    fn names(&self) -> Vec<String> {
        self.devices.names()
    }

    fn net(&self, name: &str) -> Option<NetBoxes> {
        let id: NetId = name.parse().ok()?;
        self.inner.lock().nets.get(&id)?.boxes()
    }
}

/// Out and in values of a net that other nets read or write.
type Grouped = BTreeMap<String, Vec<Inter>>;

fn grouped(values: &[Inter]) -> Grouped {
    let mut groups = Grouped::new();
    for inter in values {
        let group = groups.entry(inter.net.clone()).or_default();
        group.push(inter.clone());
    }
    groups
}

fn rejected(kind: FaultKind) -> Rejection {
    let faults = vec![Fault::new(kind, 0..0)];
    Rejection { faults }
}

fn unloaded_net(net: &str) -> Rejection {
    let why = format!("net `{net}` was unloaded meanwhile");
    let parameter = "RemoteNet".to_owned();
    rejected(FaultKind::Parameter { parameter, why })
}

fn too_many(item: &'static str, bound: usize) -> Rejection {
    let found = bound + 1;
    rejected(FaultKind::Bound { item, found, bound })
}

impl Registry {
    /// Connects a loaded net to the nets that it reads and writes.
    pub(super) fn link(
        &mut self,
        plan: &Plan,
        out: &LatestReader<Box<[u64]>>,
    ) -> Result<(Links, NetLinks), Rejection> {
        let (mut links, end) = links(plan);
        let (asked, written) = (grouped(plan.inter_ins()), grouped(plan.inter_outs()));
        if asked.len() > WIRES_MAX {
            return Err(too_many("other nets that a net reads", WIRES_MAX));
        }
        for (name, values) in asked {
            let (given, alive) = self.giver(&name)?;
            let given = given.ok_or_else(|| too_many("nets that read one net", OUT_READERS - 1))?;
            links.ask(Wire::asked(given, alive, values));
        }
        for (name, values) in written {
            let given = out.another();
            let given =
                given.ok_or_else(|| too_many("other nets that a net writes", OUT_READERS - 1))?;
            let wire = Wire::written(given, Arc::clone(end.alive()), values);
            let taker = self.linked(&name)?;
            let connected = taker.end.connect(wire);
            connected.map_err(|_| too_many("nets that write to one net", WIRES_MAX))?;
        }
        let links_end = NetLinks {
            end,
            taps: Arc::clone(plan.taps()),
            record_words: plan.record_words(),
            tap_recording: None,
        };
        Ok((links, links_end))
    }

    fn linked(&mut self, name: &str) -> Result<&mut NetLinks, Rejection> {
        let id: Option<NetId> = name.parse().ok();
        let net = id.and_then(|id| self.nets.get_mut(&id));
        net.and_then(|net| net.links_mut())
            .ok_or_else(|| unloaded_net(name))
    }

    #[expect(clippy::type_complexity, reason = "both go straight into a wire")]
    fn giver(
        &mut self,
        name: &str,
    ) -> Result<
        (
            Option<LatestReader<Box<[u64]>>>,
            Arc<std::sync::atomic::AtomicBool>,
        ),
        Rejection,
    > {
        let alive = Arc::clone(self.linked(name)?.end.alive());
        let id: Option<NetId> = name.parse().ok();
        let net = id.and_then(|id| self.nets.get(&id));
        let given = net.ok_or_else(|| unloaded_net(name))?.another_out_reader();
        Ok((given, alive))
    }

    /// Copies the last out values of other nets to a net that is evaluated once.
    pub(super) fn give_inter(&mut self, plan: &Plan) {
        for inter in plan.inter_ins() {
            let id: Option<NetId> = inter.net.parse().ok();
            let net = id.and_then(|id| self.nets.get_mut(&id));
            if let Some(net) = net {
                net.with_out_words(|words| plan.import_inter(inter, Some(words)));
            }
        }
    }

    /// Takes the records of all nets whose taps are recorded.
    pub(super) fn drain_taps(&mut self) {
        if self.recorded_nets == 0 {
            return;
        }
        let now = Instant::now();
        let recorded_nets = self
            .nets
            .values_mut()
            .filter_map(|net| net.tap_recording_mut());
        self.recorded_nets = recorded_nets.map(|recording| recording.drain(now)).count();
    }
}

impl Controller {
    /// The debug taps of a net with their records from number `from` on. The recording lasts from the
    /// first poll until [`TAPS_RECORDED_FOR`] after the last. `None` if there is no such net or it is not ready.
    ///
    /// # Errors
    /// If the taps of [`RECORDED_NETS_MAX`] other nets are recorded already.
    pub fn taps(&self, id: NetId, from: u64) -> Result<Option<Taps>, Error> {
        let mut registry = self.inner.lock();
        let recorded_nets = registry
            .nets
            .values_mut()
            .filter_map(|net| net.tap_recording_mut());
        let recorded_nets = recorded_nets.filter(|recording| recording.is_on()).count();
        let Some(links) = registry.nets.get_mut(&id).and_then(|net| net.links_mut()) else {
            return Ok(None);
        };
        let taps = Arc::clone(&links.taps);
        if taps.is_empty() {
            let records = Vec::new();
            return Ok(Some(Taps { taps, records }));
        }
        if recorded_nets >= RECORDED_NETS_MAX
            && !links
                .tap_recording
                .as_ref()
                .is_some_and(TapRecording::is_on)
        {
            let (what, bound) = ("nets whose debug taps are recorded", RECORDED_NETS_MAX);
            return Err(Error::TooMany { what, bound });
        }
        let now = Instant::now();
        let recording = links.begin_recording(now);
        recording.until = now + TAPS_RECORDED_FOR;
        recording.drain(now);
        let seen = recording
            .records
            .iter()
            .filter(|record| record.number >= from);
        let records = seen.cloned().collect();
        registry.recorded_nets = recorded_nets + 1;
        Ok(Some(Taps { taps, records }))
    }
}

impl NetLinks {
    /// The recording of the net's taps, created if there is none.
    fn begin_recording(&mut self, now: Instant) -> &mut TapRecording {
        let (end, words) = (&mut self.end, self.record_words.max(1));
        let seconds = self.taps.iter().map(|tap| tap.seconds);
        self.tap_recording.get_or_insert_with(|| {
            let waiting = WAITING
                .min(WAITING_BYTES / (words * size_of::<u64>()))
                .max(8);
            let (writer, reader) = taps(waiting, words);
            end.record_taps(writer);
            TapRecording {
                reader,
                until: now,
                span: Duration::from_secs_f64(seconds.fold(0.0, f64::max)),
                records_max: REMEMBERED_BYTES / (words * size_of::<u64>()),
                next: 0,
                records: VecDeque::new(),
            }
        })
    }
}

//! The messages of a recording while the controller runs: derived from the flight recorder, for clients that look at a running
//! cell. It runs in a thread of its own and calls no real-time thread; how messages get to clients is not known here.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use takt_net::Nanos;

use crate::cell::CellFrames;
use crate::controller::{Controller, LiveNet, Watch};
use crate::device::Device;
use crate::error::Error;
use crate::executor::flight::{DEVICE_WOKEN, FlightReader, NET_WOKEN};
use crate::ids::{NetId, NetState};
use crate::record::file::{epoch, since_boot};
use crate::record::flight::{ThreadRings, thread_woken};
use crate::record::journal::{EVENT_WOKEN, EventRow, is_after};
use crate::record::ros2::{FlightRow, Messages, ShownDevice, Sink, Stamp};

/// Cycles of a thread that are read at once.
const CYCLES_MAX: usize = 1024;

/// A device and the rows of it that were read.
#[derive(Debug)]
struct LiveDevice {
    device: Arc<Device>,
    /// The net thread that serves it.
    thread: usize,
    cursor: Option<u64>,
}

/// The rings of a net thread, and what was read of them.
#[derive(Debug)]
struct LiveThread {
    rings: ThreadRings,
    values: u64,
    timing: u64,
    happened: u64,
    /// When it woke for the last cycle that was read, ns: of rows of later cycles, others may not be written yet.
    until: i64,
}

impl LiveThread {
    /// From now on.
    fn new(rings: ThreadRings) -> Self {
        let mut live = Self {
            happened: rings.happened.end(),
            rings,
            values: 0,
            timing: 0,
            until: i64::MIN,
        };
        live.skip();
        live
    }

    /// Passes over the cycles that wait; returns the last one, if there is one: its number, and when the thread woke, ns.
    fn skip(&mut self) -> Option<(u64, i64)> {
        self.timing = self.rings.timing.end();
        let last = self.rings.timing.last();
        self.values = self.rings.values.end();
        let woken = thread_woken(&last)?;
        self.until = woken;
        Some((*last.first()?, woken))
    }
}

/// Where the rows of a cycle come from, in the order of their messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Source {
    /// What happened before the evaluation.
    Before,
    Thread,
    Device(usize),
    Net(u32),
    /// What happened after it.
    After,
}

impl Source {
    const fn is_event(self) -> bool {
        matches!(self, Self::Before | Self::After)
    }
}

/// Rows on their way to messages: when the thread woke, where they come from, and where they are among the words.
type Rows = Vec<(i64, Source, usize)>;

/// Appends the rows since a cursor of cycles for which the thread woke at most then; returns the number of those that were
/// overwritten.
fn take_rows(
    (reader, cursor): (&FlightReader, &mut u64),
    until: i64,
    place: impl Fn(&[u64]) -> Option<(i64, Source)>,
    (words, rows): (&mut Vec<u64>, &mut Rows),
) -> u64 {
    let (from, width) = (words.len(), reader.width());
    let lost = reader.read_since(cursor, reader.rows_max(), words);
    for at in (from..words.len()).step_by(width) {
        let row = words.get(at..).and_then(|row| row.get(..width));
        match row.and_then(&place) {
            Some((woken, source)) if woken <= until => rows.push((woken, source, at)),
            Some(_) => {
                *cursor -= ((words.len() - at) / width) as u64;
                words.truncate(at);
                break;
            }
            None => {}
        }
    }
    lost
}

/// The messages of a running controller, since the stream began.
#[derive(Debug)]
pub struct LiveStream {
    controller: Controller,
    messages: Messages,
    devices: BTreeMap<usize, LiveDevice>,
    threads: Vec<LiveThread>,
    /// Machines that were seen.
    machines: BTreeSet<u32>,
    /// Nets that were seen, and how many of their states.
    seen: BTreeMap<NetId, usize>,
    frames: Option<CellFrames>,
    /// Only each n-th cycle is sent.
    every: u64,
    epoch: u64,
    changed: Arc<AtomicBool>,
    _watch: Watch,
    words: Vec<u64>,
    is_quiet: bool,
}

impl LiveStream {
    /// The stream of a controller from now on; of the rows of devices, those of each `every`-th cycle.
    #[must_use]
    pub fn new(controller: &Controller, every: u64) -> Self {
        let changed = Arc::new(AtomicBool::new(true));
        let flag = Arc::clone(&changed);
        Self {
            controller: controller.clone(),
            messages: Messages::default(),
            devices: BTreeMap::new(),
            threads: Vec::new(),
            machines: BTreeSet::new(),
            seen: BTreeMap::new(),
            frames: None,
            every: every.max(1),
            // One recording and its live messages have the same times.
            epoch: controller.recording_epoch().unwrap_or_else(epoch),
            _watch: controller.on_change(move |_| flag.store(true, Ordering::Relaxed)),
            changed,
            words: Vec::new(),
            is_quiet: true,
        }
    }

    /// Unix time of a reading of the host's monotonic clock.
    fn stamp(&self, time: Nanos) -> Stamp {
        let time = takt_rt::Nanos(time.0);
        Stamp(self.epoch.saturating_add(since_boot(time)))
    }

    fn now(&self) -> Stamp {
        self.stamp(Nanos(takt_rt::monotonic().0))
    }

    /// Sends a line of the log; levels as `rcl_interfaces/msg/Log` has them.
    ///
    /// # Errors
    /// As the sink has them.
    pub fn log(
        &mut self,
        to: &mut impl Sink,
        level: tracing::Level,
        (part, text): (&str, &str),
    ) -> Result<(), Error> {
        let line = (super::level_number(level), part, text);
        self.messages.log(to, line, self.now())
    }

    /// Sends the frames of the cell again, for a client that came later.
    pub fn repeat_frames(&mut self) {
        self.frames = None;
    }

    /// Sends what happened since the last call; returns the number of rows that were overwritten before they were read. While
    /// the sink wants nothing, rows are skipped.
    ///
    /// # Errors
    /// As the sink has them.
    pub fn poll(&mut self, to: &mut impl Sink, wants_rows: bool) -> Result<u64, Error> {
        let nets = if self.changed.swap(false, Ordering::Relaxed) {
            self.take_devices(to)?;
            Some(self.take_nets(to)?)
        } else {
            None
        };
        self.take_frames(to)?;
        let was_quiet = std::mem::replace(&mut self.is_quiet, !wants_rows);
        if was_quiet || !wants_rows {
            self.skip();
        }
        let lost = self.send_rows(to, wants_rows)?;
        // After the rows of their last cycles.
        if let Some(nets) = nets {
            self.close_nets(to, &nets);
        }
        Ok(lost)
    }

    /// Passes over the rows that wait.
    fn skip(&mut self) {
        for live in self.devices.values_mut() {
            live.cursor = live.device.flight.get().map(FlightReader::end);
        }
        let mut first = None;
        for live in &mut self.threads {
            let last = live.skip();
            first = first.or(last);
        }
        if let Some((cycle, woken)) = first {
            self.messages.goes_on_after(cycle, Nanos(woken));
        }
    }

    fn take_devices(&mut self, to: &mut impl Sink) -> Result<(), Error> {
        let present = self.controller.live_devices();
        let stays = |number: &usize, live: &LiveDevice| {
            let mut same = present.iter();
            same.any(|(it, device, _)| it == number && Arc::ptr_eq(device, &live.device))
        };
        let messages = &mut self.messages;
        self.devices.retain(|number, live| {
            let stays = stays(number, live);
            if !stays {
                messages.device_gone(to, &live.device.name);
            }
            stays
        });
        for (number, device, thread) in present {
            if self.devices.contains_key(&number) {
                continue;
            }
            let shown = ShownDevice {
                name: &device.name,
                place: &device.place,
                own: device.own.clone(),
                kinematics: device.kinematics.clone(),
            };
            self.messages.device(to, number, shown)?;
            let live = LiveDevice {
                cursor: device.flight.get().map(FlightReader::end),
                device,
                thread,
            };
            self.devices.insert(number, live);
        }
        self.take_machines();
        self.messages.announce(to)?;
        if self.threads.is_empty() {
            let threads = self.controller.live_threads().into_iter();
            self.threads = threads.map(LiveThread::new).collect();
            for net in self.controller.live_nets() {
                let state = net.states.last();
                if state.is_some_and(|it| matches!(it, NetState::Running | NetState::Cancelling)) {
                    self.messages.net_runs(net.id.0);
                }
            }
        }
        Ok(())
    }

    /// Takes the programs of new machines, which name their states.
    fn take_machines(&mut self) {
        let machines = self.controller.live_machines();
        for (id, program) in &machines {
            if self.machines.insert(*id) {
                self.messages.machine(*id, program);
            }
        }
        let messages = &mut self.messages;
        self.machines.retain(|id| {
            let stays = machines.iter().any(|(it, _)| it == id);
            if !stays {
                messages.machine_gone(*id);
            }
            stays
        });
    }

    /// Adds the topics of new nets; returns all nets.
    fn take_nets(&mut self, to: &mut impl Sink) -> Result<Vec<LiveNet>, Error> {
        let (present, at) = (self.controller.live_nets(), self.now());
        for net in &present {
            let is_ready = |states: &[NetState]| states.contains(&NetState::Ready);
            let (old, new) = self.split(net);
            if let Some(values) = &net.values
                && is_ready(new)
                && !is_ready(old)
            {
                self.messages.net(to, (net.id.0, values), at)?;
            }
        }
        Ok(present)
    }

    /// The states of a net that were seen, and those since.
    fn split<'n>(&self, net: &'n LiveNet) -> (&'n [NetState], &'n [NetState]) {
        let seen = self.seen.get(&net.id).copied().unwrap_or(0);
        net.states.split_at(seen.min(net.states.len()))
    }

    /// Ends the topics of nets that were unloaded.
    fn close_nets(&mut self, to: &mut impl Sink, present: &[LiveNet]) {
        let gone: Vec<_> = self.seen.keys().copied().collect();
        for id in gone {
            if !present.iter().any(|net| net.id == id) {
                self.seen.remove(&id);
                self.messages.net_gone(to, id.0);
            }
        }
        for net in present {
            self.seen.insert(net.id, net.states.len());
        }
    }

    fn take_frames(&mut self, to: &mut impl Sink) -> Result<(), Error> {
        if self.frames.is_some() {
            return Ok(());
        }
        let frames = self.controller.frames();
        self.messages.frames(to, &frames, self.now())?;
        self.frames = Some(frames);
        Ok(())
    }

    /// Sends the rows of all rings in the order of their cycles, so that the times of no topic go back; without `wants_rows`
    /// those of events only, by which the running nets are known.
    fn send_rows(&mut self, to: &mut impl Sink, wants_rows: bool) -> Result<u64, Error> {
        let mut words = std::mem::take(&mut self.words);
        words.clear();
        let (mut rows, mut lost) = (Rows::new(), 0);
        for (number, live) in self.threads.iter_mut().enumerate() {
            if wants_rows {
                // As in a recording: the cycles of the first thread.
                lost += live.take_cycles((&mut words, &mut rows), number == 0);
            }
            lost += live.take_events((&mut words, &mut rows));
        }
        if wants_rows {
            for (number, live) in &mut self.devices {
                // A net thread serves a device some cycles after it was added.
                let (Some(flight), cursor) = (live.device.flight.get(), &mut live.cursor) else {
                    continue;
                };
                let until = self
                    .threads
                    .get(live.thread)
                    .map_or(i64::MIN, |it| it.until);
                let place = |row: &[u64]| {
                    let woken = row.get(DEVICE_WOKEN)?.cast_signed();
                    Some((woken, Source::Device(*number)))
                };
                let from = (flight, cursor.get_or_insert(0));
                lost += take_rows(from, until, place, (&mut words, &mut rows));
            }
        }
        if rows.iter().any(|(_, source, _)| source.is_event()) {
            self.take_machines();
        }
        rows.sort_unstable();
        let result = self.send(to, &rows, &words);
        self.words = words;
        result.map(|()| lost)
    }

    fn send(
        &mut self,
        to: &mut impl Sink,
        rows: &[(i64, Source, usize)],
        words: &[u64],
    ) -> Result<(), Error> {
        for (woken, source, at) in rows {
            let row = words.get(*at..).unwrap_or_default();
            let stamp = self.stamp(Nanos(*woken));
            match source {
                Source::Before | Source::After => {
                    if let Some(EventRow { cycle, entry, .. }) = EventRow::of(row) {
                        self.messages.entry(to, (cycle, entry), stamp)?;
                    }
                }
                Source::Thread => {
                    let cycle = row.first().copied().unwrap_or(0);
                    self.messages.thread(to, (cycle, Nanos(*woken)), stamp)?;
                }
                Source::Device(number) => self.device_row(to, *number, row, stamp)?,
                Source::Net(net) => self.messages.values_row(to, *net, row, stamp)?,
            }
        }
        Ok(())
    }

    fn device_row(
        &mut self,
        to: &mut impl Sink,
        number: usize,
        row: &[u64],
        at: Stamp,
    ) -> Result<(), Error> {
        let Some(live) = self.devices.get(&number) else {
            return Ok(());
        };
        let width = live.device.flight.get().map_or(0, FlightReader::width);
        let row = row.get(..width).unwrap_or_default();
        match FlightRow::of(row, live.device.place.joints) {
            Some(row) if row.cycle % self.every == 0 => self.messages.row(to, number, &row, at),
            _ => Ok(()),
        }
    }
}

impl LiveThread {
    /// Appends the cycles that have ended, if they are shown, and the out values of their nets.
    fn take_cycles(&mut self, (words, rows): (&mut Vec<u64>, &mut Rows), is_shown: bool) -> u64 {
        let (from, timing) = (words.len(), &self.rings.timing);
        let lost = timing.read_since(&mut self.timing, CYCLES_MAX, words);
        for at in (from..words.len()).step_by(timing.width()) {
            if let Some(woken) = words.get(at..).and_then(thread_woken) {
                self.until = woken;
                rows.extend(is_shown.then_some((woken, Source::Thread, at)));
            }
        }
        let place = |row: &[u64]| {
            let net = u32::try_from(row.get(1)? >> 32).ok()?;
            Some((row.get(NET_WOKEN)?.cast_signed(), Source::Net(net)))
        };
        let from = (&self.rings.values, &mut self.values);
        lost + take_rows(from, self.until, place, (words, rows))
    }

    /// Appends what happened in the cycles that have ended.
    fn take_events(&mut self, (words, rows): (&mut Vec<u64>, &mut Rows)) -> u64 {
        let place = |row: &[u64]| {
            let woken = row.get(EVENT_WOKEN)?.cast_signed();
            let after = is_after(*row.get(EVENT_WOKEN + 1)?);
            Some((woken, if after { Source::After } else { Source::Before }))
        };
        let from = (&self.rings.happened, &mut self.happened);
        take_rows(from, self.until, place, (words, rows))
    }
}

//! The messages of a recording while the controller runs: derived from the flight recorder, for clients that look at a running
//! cell. It runs in a thread of its own and calls no real-time thread; how messages get to clients is not known here.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use takt_net::Nanos;

use crate::cell::CellFrames;
use crate::controller::{Controller, LiveNet, Watch};
use crate::device::Device;
use crate::error::Error;
use crate::executor::flight::FlightReader;
use crate::ids::{NetId, NetState};
use crate::record::file::{epoch, since_boot};
use crate::record::ros2::{FlightRow, Messages, ShownDevice, Sink, Stamp};

/// Rows of a ring that are read at once.
const ROWS_MAX: usize = 1024;

/// A device and the rows of it that were read.
#[derive(Debug)]
struct LiveDevice {
    device: Arc<Device>,
    /// Whether the first net thread serves it.
    is_first: bool,
    cursor: Option<u64>,
}

/// The out values of the nets of a thread.
#[derive(Debug)]
struct LiveNets {
    flight: FlightReader,
    cursor: u64,
}

/// Where the rows of a cycle come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Source {
    Device(usize),
    Net(u32),
}

/// The messages of a running controller, since the stream began.
#[derive(Debug)]
pub struct LiveStream {
    controller: Controller,
    messages: Messages,
    devices: BTreeMap<usize, LiveDevice>,
    nets: Vec<LiveNets>,
    /// Nets that were seen, and how many of their states.
    seen: BTreeMap<NetId, usize>,
    frames: Option<CellFrames>,
    /// Only each n-th cycle is sent.
    every: u64,
    /// The last cycle of the first thread.
    cycle: u64,
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
            nets: Vec::new(),
            seen: BTreeMap::new(),
            frames: None,
            every: every.max(1),
            cycle: 0,
            epoch: epoch(),
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
        let lost = if wants_rows { self.send_rows(to)? } else { 0 };
        // After the rows of their last cycles.
        nets.map_or(Ok(()), |nets| self.send_events(to, &nets))?;
        Ok(lost)
    }

    /// Passes over the rows that wait.
    fn skip(&mut self) {
        for live in self.devices.values_mut() {
            live.cursor = live.device.flight.get().map(FlightReader::end);
        }
        for nets in &mut self.nets {
            nets.cursor = nets.flight.end();
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
                is_first: thread == 0,
            };
            self.devices.insert(number, live);
        }
        self.messages.announce(to)?;
        if self.nets.is_empty() {
            let flights = self.controller.live_values().into_iter();
            self.nets = flights
                .map(|flight| LiveNets {
                    cursor: flight.end(),
                    flight,
                })
                .collect();
        }
        Ok(())
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

    /// Sends what happened to nets, and ends the topics of those that were unloaded.
    fn send_events(&mut self, to: &mut impl Sink, present: &[LiveNet]) -> Result<(), Error> {
        let at = self.now();
        let gone: Vec<_> = self.seen.keys().copied().collect();
        for id in gone {
            if !present.iter().any(|net| net.id == id) {
                self.seen.remove(&id);
                self.messages.net_gone(to, id.0);
            }
        }
        for net in present {
            let (_, new) = self.split(net);
            for state in new {
                let Some((event, cause)) = happened(*state, net.end.as_deref()) else {
                    continue;
                };
                let of = (self.cycle, net.id.0);
                self.messages.net_event(to, of, (event, cause), at)?;
            }
            self.seen.insert(net.id, net.states.len());
        }
        Ok(())
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

    /// Sends the rows of all rings in the order of their cycles, so that the times of no topic go back.
    fn send_rows(&mut self, to: &mut impl Sink) -> Result<u64, Error> {
        let mut words = std::mem::take(&mut self.words);
        words.clear();
        let (mut rows, mut lost) = (Vec::new(), 0);
        for (number, live) in &mut self.devices {
            // A net thread serves a device some cycles after it was added.
            let (Some(flight), cursor) = (live.device.flight.get(), &mut live.cursor) else {
                continue;
            };
            let from = words.len();
            lost += flight.read_since(cursor.get_or_insert(0), ROWS_MAX, &mut words);
            let ends = (from..words.len()).step_by(flight.width());
            rows.extend(ends.map(|at| {
                let begin = words.get(at + 1).copied().unwrap_or(0);
                (begin.cast_signed(), Source::Device(*number), at)
            }));
        }
        for nets in &mut self.nets {
            let from = words.len();
            lost += nets
                .flight
                .read_since(&mut nets.cursor, ROWS_MAX, &mut words);
            let ends = (from..words.len()).step_by(nets.flight.width());
            rows.extend(ends.map(|at| {
                let word = |n: usize| words.get(at + n).copied().unwrap_or(0);
                let net = u32::try_from(word(1) >> 32).unwrap_or(0);
                (word(0).cast_signed(), Source::Net(net), at)
            }));
        }
        // Rows of one source stay in order: the sort is stable, and places grow.
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
        for (begin, source, at) in rows {
            let row = words.get(*at..).unwrap_or_default();
            let stamp = self.stamp(Nanos(*begin));
            match source {
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
        let Some(row) = FlightRow::of(row, live.device.place.joints) else {
            return Ok(());
        };
        // The rings of all devices of a thread have a row of each cycle.
        let is_first = live.is_first && (self.cycle < row.cycle || self.cycle == 0);
        if is_first {
            self.cycle = row.cycle;
            self.messages.thread(to, (row.cycle, row.begin), at)?;
        }
        if row.cycle % self.every == 0 {
            self.messages.row(to, number, &row, at)?;
        }
        Ok(())
    }
}

/// The event of a net that came to a state, as recordings have it.
fn happened(state: NetState, end: Option<&str>) -> Option<(&'static str, &str)> {
    Some(match state {
        NetState::Running => ("started", ""),
        NetState::Cancelling => ("cancel requested", ""),
        NetState::Terminated => ("ended", end.unwrap_or("terminated")),
        NetState::Loading
        | NetState::Rejected
        | NetState::Ready
        | NetState::Scheduled
        | NetState::Unloaded => return None,
    })
}

//! What a recording tells of a segment: frames that did not come back, working counters, states, error counters,
//! clocks, as far as its master asked for them. What that means together is judged by `stat` and `dc`.

mod clocks;
mod report;
mod slave;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::time::Duration;

use anyhow::{Context as _, ensure};
use takt_ethercat::link::PcapReader;
use takt_ethercat::master::FrameCounters;
use takt_ethercat::{Address, Command, Datagram, Frame, register};

use super::ways::{Shape, UNDER_WAY, Way, Ways, body, shape};
use slave::Seen;

pub(super) use clocks::dc;
pub(super) use report::stat;

/// A datagram of process data, by command number, logical address and length.
type Group = (u8, u32, u16);

/// The working counters of a group over time.
#[derive(Clone, Debug, Default)]
struct Counted {
    /// When each came.
    counters: Vec<(Duration, u16)>,
}

impl Counted {
    /// The most frequent one; that of steady operation.
    fn expected(&self) -> u16 {
        let mut often: BTreeMap<u16, usize> = BTreeMap::new();
        for (_, counter) in &self.counters {
            *often.entry(*counter).or_default() += 1;
        }
        let most = often
            .into_iter()
            .max_by_key(|(counter, count)| (*count, *counter));
        most.map_or(0, |(counter, _)| counter)
    }

    /// When another than the expected one came, from the first expected one on and up to when the segment was
    /// brought down, if it was.
    fn misses(&self, down: Option<Duration>) -> Vec<Duration> {
        let expected = self.expected();
        let good = |(_, counter): &&(Duration, u16)| *counter == expected;
        let first = self.counters.iter().find(good).map(|(at, _)| *at);
        let last = self.counters.iter().rev().find(good).map(|(at, _)| *at);
        let end = down.filter(|down| last.is_none_or(|last| *down > last));
        let inside =
            |at: Duration| first.is_some_and(|first| at >= first) && end.is_none_or(|end| at < end);
        let missed = self
            .counters
            .iter()
            .filter(|(at, counter)| inside(*at) && *counter != expected);
        missed.map(|(at, _)| *at).collect()
    }
}

/// What was seen.
#[derive(Debug)]
pub(super) struct Recording {
    name: String,
    begin: Duration,
    end: Duration,
    frames: FrameCounters,
    broken: u64,
    pending: VecDeque<(Duration, Shape)>,
    /// When frames with process data or the clock went out.
    cyclic: Vec<Duration>,
    trips: Vec<(Duration, Duration)>,
    groups: BTreeMap<Group, Counted>,
    slaves: BTreeMap<u16, Seen>,
    /// When all slaves were last asked for another state at once.
    down: Option<Duration>,
    /// Most slaves that answered a broadcast.
    answering: u16,
    clock: clocks::Reference,
}

impl Recording {
    /// Reads a file.
    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        let name = path.display().to_string();
        let bytes = std::fs::read(path).with_context(|| format!("cannot read {name}"))?;
        Self::of(&name, &bytes)
    }

    /// Goes through a recording.
    pub(super) fn of(name: &str, bytes: &[u8]) -> anyhow::Result<Self> {
        let mut all = Self {
            name: name.to_owned(),
            begin: Duration::ZERO,
            end: Duration::ZERO,
            frames: FrameCounters::default(),
            broken: 0,
            pending: VecDeque::new(),
            cyclic: Vec::new(),
            trips: Vec::new(),
            groups: BTreeMap::new(),
            slaves: BTreeMap::new(),
            down: None,
            answering: 0,
            clock: clocks::Reference::default(),
        };
        let mut ways = Ways::new(bytes).with_context(|| name.to_owned())?;
        let mut first = None;
        for record in PcapReader::new(bytes).with_context(|| name.to_owned())? {
            let record = record.with_context(|| name.to_owned())?;
            let Some(body) = body(record.frame) else {
                continue;
            };
            let begin = *first.get_or_insert(record.at);
            (all.begin, all.end) = (begin, record.at.max(begin));
            match Frame::decode(body) {
                Ok(frame) => all.take(record.at, ways.of(&record, &frame), &frame),
                Err(_) => all.broken += 1,
            }
        }
        ensure!(
            first.is_some(),
            "{name}: no EtherCAT frame in it; was it recorded at the right interface?"
        );
        all.finish();
        Ok(all)
    }

    fn take(&mut self, at: Duration, way: Way, frame: &Frame<'_>) {
        match way {
            Way::Out => {
                self.frames.sent += 1;
                self.pending.push_back((at, shape(frame)));
                self.forget(at);
                self.sent(at, frame);
            }
            Way::Back => {
                let shape = shape(frame);
                let of = self.pending.iter().position(|(_, other)| *other == shape);
                match of.and_then(|of| self.pending.remove(of)) {
                    Some((sent, _)) => self.trips.push((sent, at.saturating_sub(sent))),
                    None => self.frames.foreign += 1,
                }
                self.returned(at, frame);
            }
        }
    }

    /// What has been under way for too long is lost.
    fn forget(&mut self, now: Duration) {
        while let Some((sent, _)) = self.pending.front()
            && now.saturating_sub(*sent) >= UNDER_WAY
        {
            self.pending.pop_front();
            self.frames.lost += 1;
        }
    }

    fn sent(&mut self, at: Duration, frame: &Frame<'_>) {
        let datagrams = || frame.datagrams().flatten();
        let is_cyclic = |datagram: Datagram<'_>| {
            matches!(
                datagram.header.command,
                Command::Lrw | Command::Lrd | Command::Lwr | Command::Frmw
            )
        };
        if datagrams().any(is_cyclic) {
            self.cyclic.push(at);
        }
        for datagram in datagrams() {
            if let (
                Command::Bwr,
                Address::Device {
                    ado: register::AL_CONTROL,
                    ..
                },
            ) = (datagram.header.command, datagram.header.address)
            {
                self.down = Some(at);
            }
        }
    }

    fn returned(&mut self, at: Duration, frame: &Frame<'_>) {
        self.frames.answered += 1;
        for datagram in frame.datagrams().flatten() {
            let header = datagram.header;
            let counter = datagram.working_counter.raw();
            match (header.command, header.address) {
                (Command::Lrw | Command::Lrd | Command::Lwr, Address::Logical(address)) => {
                    let group = (u8::from(header.command), address, header.len);
                    let counted = self.groups.entry(group).or_default();
                    counted.counters.push((at, counter));
                }
                (Command::Brd, Address::Device { .. }) => {
                    self.answering = self.answering.max(counter);
                }
                (
                    Command::Apwr,
                    Address::Device {
                        adp,
                        ado: register::STATION_ADDRESS,
                    },
                ) => {
                    self.addressed(adp, counter, datagram.data);
                }
                (Command::Fprd | Command::Fpwr | Command::Frmw, Address::Device { adp, ado }) => {
                    if header.command == Command::Frmw && ado == register::DC_SYSTEM_TIME {
                        self.clock.take(at, adp, counter, datagram.data);
                    }
                    let seen = self.slaves.entry(adp).or_default();
                    seen.take(at, header.command, ado, counter, datagram.data);
                }
                _ => {}
            }
        }
    }

    /// A slave got its station address: the position is counted up by each that the frame passes.
    fn addressed(&mut self, adp: u16, counter: u16, data: &[u8]) {
        let Some(station) = data.first_chunk().map(|two| u16::from_le_bytes(*two)) else {
            return;
        };
        if counter == 1 {
            let passed = self.answering.max(1);
            let seen = self.slaves.entry(station).or_default();
            seen.position = Some(passed.wrapping_sub(adp));
        }
    }

    /// What is still under way when the recording ends is none of its losses, but for what is long over.
    fn finish(&mut self) {
        self.forget(self.end);
        let cycle = self.cycle();
        if let Some(cycle) = cycle {
            let late = self.trips.iter().filter(|(_, trip)| *trip > cycle);
            self.frames.stale = u64::try_from(late.count()).unwrap_or(u64::MAX);
        }
        // Slaves that never answered are addresses that somebody tried.
        self.slaves
            .retain(|_, seen| seen.answered > 0 || seen.position.is_some());
    }

    /// The usual time from one cyclic frame to the next.
    fn cycle(&self) -> Option<Duration> {
        let mut steps: Vec<Duration> = self
            .cyclic
            .iter()
            .zip(self.cyclic.iter().skip(1))
            .map(|(one, next)| next.saturating_sub(*one))
            .collect();
        steps.sort_unstable();
        steps.get(steps.len() / 2).copied()
    }

    /// Stations in the order of the ring, as far as the recording tells; else in the order of their addresses.
    fn ring(&self) -> Vec<(u16, &Seen)> {
        let mut all: Vec<(u16, &Seen)> = self
            .slaves
            .iter()
            .map(|(station, seen)| (*station, seen))
            .collect();
        if all.iter().all(|(_, seen)| seen.position.is_some()) {
            all.sort_by_key(|(_, seen)| seen.position);
        }
        all
    }
}

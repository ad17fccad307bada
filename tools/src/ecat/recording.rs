//! What a recording tells of a segment: frames that did not come back, working counters, states, error counters,
//! clocks, as far as its master asked for them. What that means together is judged by `stat` and `dc`.

mod clocks;
mod cycle;
#[cfg(test)]
mod patterns;
mod report;
mod slave;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Duration;

use anyhow::ensure;
use takt_ethercat::master::FrameCounters;
use takt_ethercat::{Address, Command, Datagram, Frame, register};

use super::frames::{Capture, Taken, datagrams};
use super::trips::{Trip, Trips};
use super::ways::{Sender, UNDER_WAY, Way, sender, shape, ways};
use cycle::Cycle;
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

/// Answers to frames that were not recorded going out.
#[derive(Clone, Copy, Debug, Default)]
struct Unseen {
    /// Broadcasts of senders of which nothing else is there: their search for slaves.
    searches: u64,
    /// Of senders of which nothing that went out is there.
    answers: u64,
    /// At the beginning: sent before.
    early: u64,
}

/// What was seen.
#[derive(Debug, Default)]
pub(super) struct Recording {
    name: String,
    begin: Duration,
    end: Duration,
    frames: FrameCounters,
    /// Frames that had gone out when the recording ended.
    open: u64,
    unseen: Unseen,
    broken: u64,
    /// What is to be known of how it was made.
    notes: Vec<String>,
    /// Frames whose check sum a probe found wrong.
    corrupt: u64,
    /// The usual time from one cyclic frame to the next.
    cycle: Option<Duration>,
    trips: Vec<Trip>,
    groups: BTreeMap<Group, Counted>,
    slaves: BTreeMap<u16, Seen>,
    /// When all slaves were last asked for another state at once.
    down: Option<Duration>,
    /// Most slaves that answered a broadcast.
    answering: u16,
    clock: clocks::Reference,
}

/// What is known only while a recording is gone through.
#[derive(Debug, Default)]
struct Pass {
    trips: Trips,
    cycle: Cycle,
    /// Those of whom something that went out is there.
    senders: BTreeSet<Sender>,
}

impl Recording {
    /// Reads a file.
    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        Self::of(&path.display().to_string(), &Capture::read(path)?)
    }

    /// Goes through a recording.
    pub(super) fn of(name: &str, capture: &Capture) -> anyhow::Result<Self> {
        let frames = &capture.frames;
        let (Some(first), Some(last)) = (frames.first(), frames.iter().map(|it| it.at).max())
        else {
            ensure!(
                capture.cut.is_none(),
                "{name}: no EtherCAT frame in it: it is cut off before the first\nhint: a full disk? record it again"
            );
            anyhow::bail!(
                "{name}: no EtherCAT frame in it ({} others); was it recorded at the right interface?",
                capture.others
            );
        };
        let mut all = Self {
            name: name.to_owned(),
            begin: first.at,
            end: last.max(first.at),
            notes: capture.notes(),
            corrupt: capture.corrupt,
            ..Self::default()
        };
        let ways = ways(frames);
        let outgoing = frames
            .iter()
            .zip(&ways)
            .filter(|(_, way)| **way == Way::Out);
        let mut pass = Pass {
            senders: outgoing.map(|(taken, _)| sender(taken)).collect(),
            ..Pass::default()
        };
        for (taken, way) in frames.iter().zip(ways) {
            match taken.frame() {
                Ok(frame) => all.take(&mut pass, taken, way, &frame),
                Err(_) => all.broken += 1,
            }
        }
        all.finish(pass);
        Ok(all)
    }

    fn take(&mut self, pass: &mut Pass, taken: &Taken, way: Way, frame: &Frame<'_>) {
        let (at, shape) = (taken.at, shape(frame));
        match way {
            Way::Out => {
                self.frames.sent += 1;
                let is_cyclic = pass.cycle.take(at, frame);
                pass.trips.sent(shape, at, is_cyclic);
                self.sent(at, frame);
            }
            Way::Back => {
                if !pass.trips.answered(&shape, at) {
                    let is_known = pass.senders.contains(&sender(taken));
                    self.unmatched(at, is_known, frame);
                }
                self.returned(at, frame);
            }
        }
    }

    /// An answer to nothing that went out.
    fn unmatched(&mut self, at: Duration, is_known: bool, frame: &Frame<'_>) {
        let is_broadcast = |datagram: Datagram<'_>| {
            matches!(
                datagram.header.command,
                Command::Bwr | Command::Brd | Command::Brw
            )
        };
        let is_early = at.saturating_sub(self.begin) < UNDER_WAY;
        if !is_known && datagrams(frame).flatten().all(is_broadcast) {
            self.unseen.searches += 1;
        } else if !is_known {
            self.unseen.answers += 1;
        } else if is_early {
            self.unseen.early += 1;
        } else {
            self.frames.foreign += 1;
        }
    }

    fn sent(&mut self, at: Duration, frame: &Frame<'_>) {
        for datagram in datagrams(frame).flatten() {
            if let (
                Command::Bwr,
                Address::Device {
                    ado: register::AL_CONTROL,
                    ..
                },
            ) = (datagram.header.command, datagram.header.address)
            {
                self.down = Some(at);
                for seen in self.slaves.values_mut() {
                    seen.take_control(datagram.data);
                }
            }
        }
    }

    fn returned(&mut self, at: Duration, frame: &Frame<'_>) {
        self.frames.answered += 1;
        for datagram in datagrams(frame).flatten() {
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
                (
                    Command::Armw,
                    Address::Device {
                        adp,
                        ado: register::DC_SYSTEM_TIME,
                    },
                ) => {
                    // Counted up by each slave, the address is back at the number of slaves less the position.
                    let position = (self.answering > 0).then(|| self.answering.wrapping_sub(adp));
                    let who = clocks::Who::Position(position);
                    self.clock.take(at, who, counter, datagram.data);
                }
                (Command::Fprd | Command::Fpwr | Command::Frmw, Address::Device { adp, ado }) => {
                    if header.command == Command::Frmw && ado == register::DC_SYSTEM_TIME {
                        let who = clocks::Who::Station(adp);
                        self.clock.take(at, who, counter, datagram.data);
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
    fn finish(&mut self, pass: Pass) {
        let outcome = pass.trips.finish(self.end);
        (self.frames.lost, self.open) = (outcome.lost, outcome.open);
        self.trips = outcome.trips;
        self.cycle = pass.cycle.judged(&self.trips);
        if let Some(cycle) = self.cycle {
            let is_late = |trip: &&Trip| trip.is_cyclic && trip.took > cycle;
            let late = self.trips.iter().filter(is_late).count();
            self.frames.stale = u64::try_from(late).unwrap_or(u64::MAX);
        }
        // Slaves that never answered are addresses that somebody tried.
        self.slaves
            .retain(|_, seen| seen.answered > 0 || seen.position.is_some());
        for seen in self.slaves.values_mut() {
            seen.finish();
        }
    }

    /// Answers that are of no frame of this master, though both directions were recorded.
    const fn foreign(&self) -> u64 {
        let unseen = if self.frames.sent == 0 {
            0
        } else {
            self.unseen.answers
        };
        self.frames.foreign + unseen
    }

    /// How many slaves there are, as far as the recording tells.
    fn slave_count(&self) -> usize {
        self.slaves.len().max(self.answering.into())
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

//! The master against the emulated segment, in virtual time: the main functions first, then faults.

use super::*;
use crate::emulator::{Coupler, Entry, Io, Segment};

mod clocks;
mod ethernet;
mod files;
mod fuzz;
mod mailbox;
mod more;
mod profiles;
mod real;
mod recovery;
mod start;
mod stuck;

/// A master, a segment, and their common time.
pub(crate) struct Rig {
    pub(crate) master: Master,
    pub(crate) segment: Segment,
    pub(crate) now: Duration,
    /// Recorded events.
    pub(crate) events: Vec<Event>,
    /// Largest number of cycles without inputs of slave 0.
    pub(crate) oldest: u32,
    redundant: bool,
}

impl Rig {
    pub(crate) fn new(config: MasterConfig, segment: Segment) -> Self {
        Self {
            redundant: config.redundant,
            master: Master::new(config).unwrap(),
            segment,
            now: Duration::from_secs(1),
            events: Vec::new(),
            oldest: 0,
        }
    }

    /// One frame there and back, then the rest of the cycle.
    pub(crate) fn cycle(&mut self) {
        let begin = self.now;
        let mut frame = [0; 1500];
        if let Some(len) = self.master.poll_transmit(begin, &mut frame) {
            self.exchange(&frame[..len]);
        }
        while let Some(event) = self.master.poll_event() {
            self.events.push(event);
        }
        self.oldest = self.oldest.max(self.master.inputs(0).1);
        self.now = begin + self.master.config().cycle;
    }

    pub(crate) fn exchange(&mut self, frame: &[u8]) {
        let ns = u64::try_from(self.now.as_nanos()).unwrap();
        let ends = if self.redundant {
            vec![Entry::First, Entry::Last]
        } else {
            vec![Entry::First]
        };
        for end in ends {
            let mut bytes = frame.to_vec();
            let Some(returned) = self.segment.process(&mut bytes, end, ns) else {
                continue;
            };
            let port = usize::from(returned.by == Entry::Last);
            let at = self.now + Duration::from_nanos(returned.after);
            self.master.handle_frame(port, &bytes, at);
        }
    }

    pub(crate) fn cycles(&mut self, count: usize) {
        for _ in 0..count {
            self.cycle();
        }
    }

    /// Runs a job to its end, while of each `of` sent frames `lost` in a row do not return: in turn before and after the
    /// slaves processed them. Frames are counted, as a master that waits for one sends none.
    #[track_caller]
    pub(crate) fn lossy(
        &mut self,
        job: Job,
        of: u64,
        lost: u64,
        mut watch: impl FnMut(&Master),
    ) -> Reply {
        self.master.submit(job).unwrap();
        for _ in 0..60_000 {
            let sent = self.master.frames().sent;
            let (loses, processed) = (sent % of < lost, (sent / of) % 2 == 1);
            self.segment.faults.lose = u32::from(loses && !processed);
            self.segment.faults.lose_returned = u32::from(loses && processed);
            self.cycle();
            watch(&self.master);
            if let Some(reply) = self.master.poll_reply() {
                return reply;
            }
        }
        panic!("no reply; {:?}", self.events);
    }

    /// Runs until a condition holds, at most `most` cycles; returns the number of cycles.
    #[track_caller]
    pub(crate) fn until(&mut self, most: usize, holds: impl Fn(&Master) -> bool) -> usize {
        for count in 0..most {
            if holds(&self.master) {
                return count;
            }
            self.cycle();
        }
        let texts: Vec<_> = self
            .master
            .units
            .iter()
            .map(|unit| {
                format!(
                    "{:?} {} {:?} at {:?}",
                    unit.step(),
                    unit.status.al,
                    unit.recovery.fault,
                    unit.position
                )
            })
            .collect();
        let (phase, groups) = (self.master.phase(), &self.master.groups()[0]);
        let events: Vec<_> = self.events.iter().rev().take(12).collect();
        panic!(
            "not within {most} cycles: {phase:?}, {texts:#?}, {groups:?}, {:?}, {events:?}",
            self.master.presence
        );
    }
}

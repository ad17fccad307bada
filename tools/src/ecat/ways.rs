//! Which way a recorded frame goes: out to the slaves, or back from them. What is in it is not looked at here.

use std::collections::VecDeque;
use std::time::Duration;

use takt_ethercat::link::{ETHER_TYPE, HEADER_LEN, PcapError, PcapReader, PcapRecord};
use takt_ethercat::{Command, Datagram, Frame};

/// Which way a frame goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    Out,
    Back,
}

/// A frame on its way, by what slaves do not change.
pub(super) type Shape = Vec<(Command, u8, u16)>;

/// A frame that has not come back by then is lost.
pub(super) const UNDER_WAY: Duration = Duration::from_millis(100);
/// Frames under way that are remembered.
const UNDER_WAY_MAX: usize = 64;
/// The bit of the source address that the first slave sets (locally administered).
const PASSED: u8 = 0x02;

/// Tells the ways of frames, in their order.
#[derive(Debug)]
pub(super) struct Ways {
    /// The first slave marks the source address of what it passes, and this master's was not marked before.
    marked: bool,
    under_way: VecDeque<(Duration, Shape)>,
}

/// What is behind the Ethernet header of an EtherCAT frame.
pub(super) fn body(frame: &[u8]) -> Option<&[u8]> {
    let kind = frame.get(12..HEADER_LEN)?;
    (kind == ETHER_TYPE.to_be_bytes()).then(|| frame.get(HEADER_LEN..))?
}

/// What tells a frame from others.
pub(super) fn shape(frame: &Frame<'_>) -> Shape {
    let of = |datagram: Datagram<'_>| {
        let header = datagram.header;
        (header.command, header.index, header.len)
    };
    frame.datagrams().flatten().map(of).collect()
}

impl Ways {
    /// Looks through a recording for what tells frames out from frames back.
    pub(super) fn new(bytes: &[u8]) -> Result<Self, PcapError> {
        let is_unmarked = |record: &PcapRecord<'_>| {
            body(record.frame).is_some()
                && record.frame.get(6).is_some_and(|byte| byte & PASSED == 0)
        };
        let marked = PcapReader::new(bytes)?
            .flatten()
            .any(|record| is_unmarked(&record));
        Ok(Self {
            marked,
            under_way: VecDeque::new(),
        })
    }

    /// The way of a frame.
    pub(super) fn of(&mut self, record: &PcapRecord<'_>, frame: &Frame<'_>) -> Way {
        if self.marked {
            let source = record.frame.get(6).copied().unwrap_or(0);
            return if source & PASSED == 0 {
                Way::Out
            } else {
                Way::Back
            };
        }
        // The master's own address has the bit: what was seen shortly before is back now.
        let shape = shape(frame);
        self.under_way
            .retain(|(at, _)| record.at.saturating_sub(*at) < UNDER_WAY);
        let seen = self.under_way.iter().position(|(_, other)| *other == shape);
        if let Some(seen) = seen {
            self.under_way.remove(seen);
            return Way::Back;
        }
        if self.under_way.len() == UNDER_WAY_MAX {
            self.under_way.pop_front();
        }
        self.under_way.push_back((record.at, shape));
        Way::Out
    }
}

//! Which way recorded frames go: out to the slaves, or back from them. What the datagrams mean is not looked at here.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use takt_ethercat::{Address, Datagram, Frame};

use super::frames::{Taken, datagrams};

/// Which way a frame goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    Out,
    Back,
}

/// What slaves do not change of a frame, by datagram: command, index, length, and the address without what is counted up.
pub(super) type Shape = Vec<(u8, u8, u16, u32)>;

/// A frame that has not come back by then is lost.
pub(super) const UNDER_WAY: Duration = Duration::from_millis(100);
/// Frames under way that are remembered of a sender whose answers bear no mark.
const UNDER_WAY_MAX: usize = 64;
/// The bit of the source address that the first slave sets (locally administered).
const PASSED: u8 = 0x02;

/// A sender: its address without the mark.
pub(super) type Sender = [u8; 6];

/// Who sent a frame.
pub(super) fn sender(frame: &Taken) -> Sender {
    let mut source = frame.source();
    source[0] &= !PASSED;
    source
}

/// What tells a frame from others.
pub(super) fn shape(frame: &Frame<'_>) -> Shape {
    let of = |datagram: Datagram<'_>| {
        let header = datagram.header;
        let address = match header.address {
            Address::Logical(address) => address,
            Address::Device { ado, .. } if header.command.is_positional() => ado.into(),
            Address::Device { adp, ado } => u32::from(adp) << 16 | u32::from(ado),
        };
        (u8::from(header.command), header.index, header.len, address)
    };
    datagrams(frame).flatten().map(of).collect()
}

/// Whether a slave has counted: masters send working counters of 0.
fn is_counted(frame: &Frame<'_>) -> bool {
    let counters = datagrams(frame)
        .flatten()
        .map(|datagram| datagram.working_counter.raw());
    counters.into_iter().any(|counter| counter > 0)
}

/// A sender whose frames bear no mark on their way back, or all of them: its own address has the bit, the slaves do not set it,
/// or only one direction was recorded. Then what slaves counted tells the way, and what was seen shortly before.
#[derive(Debug, Default)]
struct Unmarked {
    under_way: VecDeque<(Duration, Shape)>,
    /// Frames that slaves have counted in.
    counted: usize,
    /// Answers to frames that were seen.
    paired: usize,
    /// Places of its frames in the recording, and what each is taken for.
    frames: Vec<(usize, Way)>,
}

impl Unmarked {
    fn take(&mut self, at: Duration, number: usize, frame: &Frame<'_>) {
        let (shape, is_counted) = (shape(frame), is_counted(frame));
        self.under_way
            .retain(|(sent, _)| at.saturating_sub(*sent) < UNDER_WAY);
        let pending = self.under_way.iter().position(|(_, other)| *other == shape);
        if let Some(pending) = pending {
            self.under_way.remove(pending);
            self.paired += 1;
        }
        self.counted += usize::from(is_counted);
        let is_back = is_counted || pending.is_some();
        if !is_back {
            if self.under_way.len() == UNDER_WAY_MAX {
                self.under_way.pop_front();
            }
            self.under_way.push_back((at, shape));
        }
        let way = if is_back { Way::Back } else { Way::Out };
        self.frames.push((number, way));
    }

    /// The ways of its frames, now that all are known.
    fn finish(self) -> impl Iterator<Item = (usize, Way)> {
        let all = match (self.counted, self.paired) {
            // No slave ever counted: nothing came back, and what looks alike was sent again.
            (0, _) => Some(Way::Out),
            // Slaves counted, but nothing that was sent is there.
            (_, 0) => Some(Way::Back),
            _ => None,
        };
        let ways = self.frames.into_iter();
        ways.map(move |(number, way)| (number, all.unwrap_or(way)))
    }
}

/// The ways of all frames of a recording, in their order. One that cannot be read goes out.
pub(super) fn ways(frames: &[Taken]) -> Vec<Way> {
    let sources: BTreeSet<Sender> = frames.iter().map(Taken::source).collect();
    let is_marked = |sender: Sender| {
        let mut passed = sender;
        passed[0] |= PASSED;
        sources.contains(&sender) && sources.contains(&passed)
    };
    let mut ways = vec![Way::Out; frames.len()];
    let mut unmarked: BTreeMap<Sender, Unmarked> = BTreeMap::new();
    for ((number, taken), way) in frames.iter().enumerate().zip(&mut ways) {
        let sender = sender(taken);
        if is_marked(sender) {
            if taken.source() != sender {
                *way = Way::Back;
            }
        } else if let Ok(frame) = taken.frame() {
            let of = unmarked.entry(sender).or_default();
            of.take(taken.at, number, &frame);
        }
    }
    for (number, known) in unmarked.into_values().flat_map(Unmarked::finish) {
        if let Some(way) = ways.get_mut(number) {
            *way = known;
        }
    }
    ways
}

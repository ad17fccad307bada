//! Direction of recorded frames: out to the slaves, or back from them. It does not interpret datagrams.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use takt_ethercat::{Address, Datagram, Frame};

use super::frames::{Taken, datagrams};

/// Direction of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Direction {
    Out,
    Back,
}

/// The part of a frame that slaves do not change, by datagram: command, index, length, and the address without the part
/// that they increment.
pub(super) type Shape = Vec<(u8, u8, u16, u32)>;

/// A frame that has not returned by then is lost.
pub(super) const RETURN_MAX: Duration = Duration::from_millis(100);
/// Most pending frames of a sender whose answers have no mark.
const PENDING_MAX: usize = 64;
/// The bit of the source address that the first slave sets (locally administered).
const PASSED: u8 = 0x02;

/// A sender: its address without the mark.
pub(super) type Sender = [u8; 6];

/// The sender of a frame.
pub(super) fn sender(frame: &Taken) -> Sender {
    let mut source = frame.source();
    source[0] &= !PASSED;
    source
}

/// The shape that distinguishes a frame from others.
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

/// A sender whose returning frames have no mark, or all of whose frames have it: its own address has the bit, the slaves do
/// not set it, or only one direction was recorded. Then working counters and the frames shortly before show the direction.
#[derive(Debug, Default)]
struct Unmarked {
    in_flight: VecDeque<(Duration, Shape)>,
    /// Frames that slaves have counted in.
    counted: usize,
    /// Answers to recorded frames.
    paired: usize,
    /// Positions of its frames in the recording, and the direction of each.
    frames: Vec<(usize, Direction)>,
}

impl Unmarked {
    fn take(&mut self, at: Duration, number: usize, frame: &Frame<'_>) {
        let (shape, is_counted) = (shape(frame), is_counted(frame));
        self.in_flight
            .retain(|(sent, _)| at.saturating_sub(*sent) < RETURN_MAX);
        let pending = self.in_flight.iter().position(|(_, other)| *other == shape);
        if let Some(pending) = pending {
            self.in_flight.remove(pending);
            self.paired += 1;
        }
        self.counted += usize::from(is_counted);
        let is_back = is_counted || pending.is_some();
        if !is_back {
            if self.in_flight.len() == PENDING_MAX {
                self.in_flight.pop_front();
            }
            self.in_flight.push_back((at, shape));
        }
        let direction = if is_back {
            Direction::Back
        } else {
            Direction::Out
        };
        self.frames.push((number, direction));
    }

    /// The directions of its frames, once all are known.
    fn finish(self) -> impl Iterator<Item = (usize, Direction)> {
        let all = match (self.counted, self.paired) {
            // No slave ever counted: nothing returned, and equal frames were sent again.
            (0, _) => Some(Direction::Out),
            // Slaves counted, but no sent frame is recorded.
            (_, 0) => Some(Direction::Back),
            _ => None,
        };
        let frames = self.frames.into_iter();
        frames.map(move |(number, direction)| (number, all.unwrap_or(direction)))
    }
}

/// The directions of all frames of a recording, in their order. One that cannot be decoded goes out.
pub(super) fn directions(frames: &[Taken]) -> Vec<Direction> {
    let sources: BTreeSet<Sender> = frames.iter().map(Taken::source).collect();
    let is_marked = |sender: Sender| {
        let mut passed = sender;
        passed[0] |= PASSED;
        sources.contains(&sender) && sources.contains(&passed)
    };
    let mut directions = vec![Direction::Out; frames.len()];
    let mut unmarked: BTreeMap<Sender, Unmarked> = BTreeMap::new();
    for ((number, taken), direction) in frames.iter().enumerate().zip(&mut directions) {
        let sender = sender(taken);
        if is_marked(sender) {
            if taken.source() != sender {
                *direction = Direction::Back;
            }
        } else if let Ok(frame) = taken.frame() {
            let of = unmarked.entry(sender).or_default();
            of.take(taken.at, number, &frame);
        }
    }
    for (number, known) in unmarked.into_values().flat_map(Unmarked::finish) {
        if let Some(direction) = directions.get_mut(number) {
            *direction = known;
        }
    }
    directions
}

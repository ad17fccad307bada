//! Matches answers with frames, also when masters repeat a frame with the same index or send many equal ones at once. It has
//! the whole recording before it decides; nothing is judged here.

use std::collections::HashMap;
use std::time::Duration;

use super::directions::{RETURN_MAX, Shape};

/// A frame that returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Trip {
    pub(super) sent: Duration,
    pub(super) took: Duration,
    /// It carried process data or the clock.
    pub(super) is_cyclic: bool,
}

#[derive(Clone, Copy, Debug)]
struct Sent {
    at: Duration,
    is_cyclic: bool,
}

/// Frames of one shape.
#[derive(Debug, Default)]
struct Lane {
    /// Not yet returned; the last one sent is the last.
    in_flight: Vec<Sent>,
    /// Those that were answered.
    answered: Vec<Sent>,
    answers: Vec<Duration>,
    /// Those that were not, when later ones were.
    given_up: Vec<Sent>,
}

/// All frames of a recording.
#[derive(Debug, Default)]
pub(super) struct Trips {
    lanes: HashMap<Shape, Lane>,
}

/// The result.
#[derive(Debug, Default)]
pub(super) struct Outcome {
    /// In the order in which they were sent.
    pub(super) trips: Vec<Trip>,
    pub(super) lost: u64,
    /// Not yet returned when the recording ends.
    pub(super) open: u64,
}

impl Trips {
    /// Notes a sent frame.
    pub(super) fn sent(&mut self, shape: Shape, at: Duration, is_cyclic: bool) {
        let lane = self.lanes.entry(shape).or_default();
        lane.in_flight.push(Sent { at, is_cyclic });
    }

    /// Notes a returned frame; whether it is known. It answers the last one of its shape that has not returned: a repeated
    /// frame was sent because the first was lost. If both return after all, each is matched.
    pub(super) fn answered(&mut self, shape: &Shape, at: Duration) -> bool {
        let Some(lane) = self.lanes.get_mut(shape) else {
            return false;
        };
        let is_late = |sent: &mut Sent| at.saturating_sub(sent.at) >= RETURN_MAX;
        if lane.in_flight.last_mut().is_some_and(is_late) {
            lane.given_up.append(&mut lane.in_flight);
        }
        let Some(sent) = lane.in_flight.pop() else {
            return false;
        };
        lane.answered.push(sent);
        lane.answers.push(at);
        true
    }

    /// The result, when the recording ends at this time.
    pub(super) fn finish(self, end: Duration) -> Outcome {
        let mut outcome = Outcome::default();
        let mut missing = Vec::new();
        for mut lane in self.lanes.into_values() {
            // Of equal frames, answers return in the order of the frames.
            lane.answered.sort_unstable_by_key(|sent| sent.at);
            let pairs = lane.answered.iter().zip(&lane.answers);
            outcome.trips.extend(pairs.map(|(sent, back)| Trip {
                sent: sent.at,
                took: back.saturating_sub(sent.at),
                is_cyclic: sent.is_cyclic,
            }));
            missing.append(&mut lane.given_up);
            missing.append(&mut lane.in_flight);
        }
        outcome.trips.sort_unstable_by_key(|trip| trip.sent);
        // A frame that takes far longer than all others is lost, also if the recording ends before the timeout.
        let worst = outcome.trips.iter().map(|trip| trip.took).max();
        let usual = worst.unwrap_or_default() * 4;
        let timeout = usual.clamp(Duration::from_millis(10), RETURN_MAX);
        for sent in missing {
            if end.saturating_sub(sent.at) >= timeout {
                outcome.lost += 1;
            } else {
                outcome.open += 1;
            }
        }
        outcome
    }
}

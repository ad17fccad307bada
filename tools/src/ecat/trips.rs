//! Which answer belongs to which frame, when masters send a frame again with the same index, or many alike at once. It knows the
//! whole recording before it decides; nothing is judged here.

use std::collections::HashMap;
use std::time::Duration;

use super::ways::{Shape, UNDER_WAY};

/// A frame that came back.
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
    /// Under way; the last one sent is the last.
    under_way: Vec<Sent>,
    /// Those that were answered.
    answered: Vec<Sent>,
    answers: Vec<Duration>,
    /// Those that were not, when the next ones were.
    given_up: Vec<Sent>,
}

/// All frames of a recording.
#[derive(Debug, Default)]
pub(super) struct Trips {
    lanes: HashMap<Shape, Lane>,
}

/// What became of them.
#[derive(Debug, Default)]
pub(super) struct Outcome {
    /// By when they were sent.
    pub(super) trips: Vec<Trip>,
    pub(super) lost: u64,
    /// Still under way when the recording ends.
    pub(super) open: u64,
}

impl Trips {
    /// A frame went out.
    pub(super) fn sent(&mut self, shape: Shape, at: Duration, is_cyclic: bool) {
        let lane = self.lanes.entry(shape).or_default();
        lane.under_way.push(Sent { at, is_cyclic });
    }

    /// A frame came back; whether it is known. It is the answer to the last one of its shape that is under way: one sent again
    /// was sent because the first was lost. Where both come back after all, each finds one.
    pub(super) fn answered(&mut self, shape: &Shape, at: Duration) -> bool {
        let Some(lane) = self.lanes.get_mut(shape) else {
            return false;
        };
        let is_late = |sent: &mut Sent| at.saturating_sub(sent.at) >= UNDER_WAY;
        if lane.under_way.last_mut().is_some_and(is_late) {
            lane.given_up.append(&mut lane.under_way);
        }
        let Some(sent) = lane.under_way.pop() else {
            return false;
        };
        lane.answered.push(sent);
        lane.answers.push(at);
        true
    }

    /// What became of all, when the recording ends then.
    pub(super) fn finish(self, end: Duration) -> Outcome {
        let mut outcome = Outcome::default();
        let mut missing = Vec::new();
        for mut lane in self.lanes.into_values() {
            // Alike as they are, answers come in the order of what they answer.
            lane.answered.sort_unstable_by_key(|sent| sent.at);
            let pairs = lane.answered.iter().zip(&lane.answers);
            outcome.trips.extend(pairs.map(|(sent, back)| Trip {
                sent: sent.at,
                took: back.saturating_sub(sent.at),
                is_cyclic: sent.is_cyclic,
            }));
            missing.append(&mut lane.given_up);
            missing.append(&mut lane.under_way);
        }
        outcome.trips.sort_unstable_by_key(|trip| trip.sent);
        // What takes longer by far than all others is lost, also if the recording ends before the bound.
        let worst = outcome.trips.iter().map(|trip| trip.took).max();
        let usual = worst.unwrap_or_default() * 4;
        let patience = usual.clamp(Duration::from_millis(10), UNDER_WAY);
        for sent in missing {
            if end.saturating_sub(sent.at) >= patience {
                outcome.lost += 1;
            } else {
                outcome.open += 1;
            }
        }
        outcome
    }
}

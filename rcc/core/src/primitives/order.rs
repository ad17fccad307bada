//! Orders to devices: sent when they change, with their outcome. The primitive that sends an order
//! defines its meaning.

use takt_net::Cycle;
use takt_net::device::{Order, Words};

use super::error;

/// An order of one primitive.
pub(super) struct Standing<T> {
    order: Order<T>,
    /// The last order, and the cycle of the first one that still counts.
    given: Option<(T, u64)>,
}

/// Outcome of an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Outcome {
    /// The device has handled it, with or without error.
    pub(super) answered: bool,
    /// 0 if no error is known.
    pub(super) error: i32,
}

impl Outcome {
    const CONCURRENT: Self = Self {
        answered: false,
        error: error::CONCURRENT,
    };

    pub(super) const fn is_done(self) -> bool {
        self.answered && self.error == 0
    }
}

impl<T: Words + PartialEq> Standing<T> {
    pub(super) const fn new(order: Order<T>) -> Self {
        Self { order, given: None }
    }

    /// Sends the order if it is new.
    pub(super) fn give(&mut self, cycle: &Cycle<'_>, value: T) -> Outcome {
        if self.order.command.is_taken(cycle) {
            return Outcome::CONCURRENT;
        }
        match self.given {
            Some((last, since)) if last == value => {
                self.order.command.hold(cycle);
                self.outcome(cycle, since)
            }
            _ => {
                self.order.command.give(cycle, value);
                self.given = Some((value, cycle.moment.cycle));
                self.outcome(cycle, cycle.moment.cycle)
            }
        }
    }

    /// Sends the order in each cycle, so that it is valid only as long as its net runs. An answer
    /// to any of them counts.
    pub(super) fn repeat(&mut self, cycle: &Cycle<'_>, value: T) -> Outcome {
        if self.order.command.is_taken(cycle) {
            return Outcome::CONCURRENT;
        }
        self.order.command.give(cycle, value);
        let since = self.given.map_or(cycle.moment.cycle, |(_, since)| since);
        self.given = Some((value, since));
        self.outcome(cycle, since)
    }

    fn outcome(&self, cycle: &Cycle<'_>, since: u64) -> Outcome {
        let answer = self.order.answer.get(cycle.image);
        let answer = answer.filter(|answer| answer.order >= since);
        Outcome {
            answered: answer.is_some(),
            error: answer.map_or(0, |answer| answer.error),
        }
    }
}

//! Synchronization rules: when a condition over values of nets becomes true, nets are stopped,
//! cancelled and started between two cycles, all at once. It evaluates no net and does not parse
//! text: conditions are compiled before. If the nets of a rule are in several threads, each thread has a
//! part, and the parts exchange their state through [`shared`].
//!
//! The cost of a cycle is bounded by the work of the rules, [`WORK_MAX`], not by its product with the number of
//! nets: each net that a rule names has a slot in the net table for constant-time lookup.

mod fire;
mod gate;
mod keep;
mod limits;
mod literal;
mod net_table;
mod rule;
pub mod shared;

use crate::executor::running::Running;
use net_table::{NetTable, Slot};

pub use gate::{Begun, Gate};
pub use limits::{CONDITION_MAX, RULES_MAX, SCHEDULED_MAX, WORK_MAX};
pub use literal::{Literal, Question, Step};
pub use rule::{Failure, NetActions, Rule, RuleError, RuleState, rejected};

/// Rules and scheduled nets of an executor.
#[expect(
    clippy::vec_box,
    reason = "they move in and out as boxes; a cycle neither allocates nor frees any"
)]
#[derive(Debug)]
pub(super) struct Rules {
    waiting: Vec<Box<Rule>>,
    /// Scheduled nets.
    scheduled: Vec<Box<Running>>,
    /// The nets that the waiting rules name.
    nets_named: NetTable,
    /// Total work of `waiting`.
    work: usize,
    /// Number of rules in `waiting` that no longer wait.
    over: usize,
}

impl Rules {
    pub(super) fn new() -> Self {
        Self {
            waiting: Vec::with_capacity(RULES_MAX),
            scheduled: Vec::with_capacity(SCHEDULED_MAX),
            nets_named: NetTable::default(),
            work: 0,
            over: 0,
        }
    }

    /// Work per cycle.
    pub(super) const fn work(&self) -> usize {
        self.work
    }

    /// Index of a slot's net in `running`.
    fn running_at(&self, slot: Slot, running: &[Box<Running>]) -> Option<usize> {
        let (id, at) = self.nets_named.running(slot);
        running.get(at).filter(|net| net.id == id).map(|_| at)
    }

    /// Index of a slot's net in `scheduled`.
    fn scheduled_at(&self, slot: Slot) -> Option<usize> {
        let (id, at) = self.nets_named.scheduled(slot);
        let net = self.scheduled.get(at).filter(|net| net.id == id);
        net.map(|_| at)
    }

    /// Updates the positions of nets that rules name.
    fn seat(&mut self, running: &[Box<Running>]) {
        for (at, net) in running.iter().enumerate() {
            self.nets_named.set_running_index(net.id, at);
        }
        for (at, net) in self.scheduled.iter().enumerate() {
            self.nets_named.set_scheduled_index(net.id, at);
        }
    }

    /// Whether a rule in several threads may still start a net here in place of this one.
    pub(super) fn may_still_succeed(&self, id: u32) -> bool {
        let Some(slot) = self.nets_named.find(id) else {
            return false;
        };
        self.waiting.iter().any(|rule| {
            rule.state == RuleState::Active
                && rule.part.is_some()
                && !rule.orders.start.is_empty()
                && rule.followed().contains(&slot)
        })
    }

    /// Removes a scheduled net.
    fn clear_scheduled_index(&mut self, at: usize) -> Box<Running> {
        let net = self.scheduled.swap_remove(at);
        if let Some(moved) = self.scheduled.get(at) {
            self.nets_named.set_scheduled_index(moved.id, at);
        }
        net
    }

    /// Deactivates all rules in all threads.
    pub(super) fn halt(&mut self) {
        for at in 0..self.waiting.len() {
            if self.waiting[at].state == RuleState::Active {
                self.waiting[at].give_up();
                self.retire(at, RuleState::FireFailed);
            }
        }
    }

    /// Deactivates a rule.
    fn retire(&mut self, at: usize, state: RuleState) {
        let rule = &mut self.waiting[at];
        if rule.state != RuleState::Active {
            return;
        }
        rule.state = state;
        self.over += 1;
        if rule.starts_any() {
            let followed = rule.followed().iter();
            followed.for_each(|slot| self.nets_named.follow(*slot, false));
        }
    }
}

#[cfg(test)]
mod tests;

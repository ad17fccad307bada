//! The commands of a net end with the net: they are withdrawn in the same cycle, and drivers brake
//! at once instead of waiting for the next set-point of a slow net. The only exception is a successor that a rule
//! starts in its place: commands that the successor gives too are kept until its first cycle, without a gap.
//! Other modules decide which nets end; drivers decide how to brake.

use super::life::{Change, Life};
use super::{BUCKETS, Executor, Running};

/// Nets that ended and whose commands are still in the image.
#[derive(Debug)]
pub(super) struct Leaving {
    /// Their commands are withdrawn at the next call.
    now: Vec<u32>,
    /// Their commands are kept until the next cycle: a rule decided in another thread may still start a successor.
    later: Vec<u32>,
}

impl Default for Leaving {
    fn default() -> Self {
        Self {
            now: Vec::with_capacity(BUCKETS),
            later: Vec::with_capacity(BUCKETS),
        }
    }
}

impl Leaving {
    /// Adds an ended net, once.
    pub(super) fn note(&mut self, net: &mut Running) {
        if matches!(net.life, Life::Ended { .. }) {
            net.change(Change::Withdraw);
            self.now.push(net.id);
        }
    }
}

impl Executor {
    /// After evaluation: withdraws the commands of nets that ended before this cycle.
    pub(super) fn withdraw_ended(&mut self) {
        let Self {
            running, leaving, ..
        } = self;
        let ended = running.iter_mut().filter(|net| !net.life.is_evaluated());
        ended.for_each(|net| leaving.note(net));
        leaving.now.append(&mut leaving.later);
        self.withdraw_leaving();
    }

    /// At the end of a cycle, after rules have fired: withdraws the commands of nets that end with it. Returns whether
    /// there were any, as drivers must see this at once.
    pub fn withdraw(&mut self) -> bool {
        for at in 0..self.running.len() {
            let net = &mut self.running[at];
            if !matches!(net.life, Life::Ended { .. }) {
                continue;
            }
            net.change(Change::Withdraw);
            let id = net.id;
            let leaving = &mut self.leaving;
            if self.rules.may_still_succeed(id) {
                leaving.later.push(id);
            } else {
                leaving.now.push(id);
            }
        }
        self.withdraw_leaving()
    }

    fn withdraw_leaving(&mut self) -> bool {
        let ended = &mut self.leaving.now;
        if ended.is_empty() {
            return false;
        }
        ended.sort_unstable();
        let has_ended = |id: u32| ended.binary_search(&id).is_ok();
        let heirs = self.running.iter();
        for net in heirs.filter(|net| net.life == Life::Succeeding) {
            for target in net.plan.commands() {
                self.image.transfer(*target, net.id, has_ended);
            }
        }
        let any = self
            .image
            .withdraw(self.joints, self.used.commands, has_ended);
        ended.clear();
        any
    }
}

#[cfg(test)]
mod tests;

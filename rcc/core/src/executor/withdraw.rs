//! The commands of a net end with the net: they are withdrawn in the same cycle, and drivers brake
//! at once instead of waiting for the next set-point of a slow net. The only exception is a successor that a rule
//! starts in its place: commands that the successor gives too are kept until its first cycle, without a gap.
//! Other modules decide which nets end; drivers decide how to brake.

use takt_net::Image;

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
        if !std::mem::replace(&mut net.leaves, true) {
            self.now.push(net.id);
        }
    }
}

impl Running {
    /// After its first evaluation in `cycle`: ends commands that it did not take over.
    pub(super) fn take_over(&mut self, image: &Image, cycle: u64) {
        if std::mem::replace(&mut self.succeeds, false) {
            for target in self.plan.commands() {
                image.withdraw_unused(*target, self.id, cycle);
            }
        }
    }
}

impl Executor {
    /// After evaluation: withdraws the commands of nets that ended before this cycle.
    pub(super) fn withdraw_ended(&mut self) {
        let Self {
            running, leaving, ..
        } = self;
        let ended = running
            .iter_mut()
            .filter(|net| net.end.is_some() && !net.evaluated);
        ended.for_each(|net| leaving.note(net));
        leaving.now.append(&mut leaving.later);
        self.withdraw_leaving();
    }

    /// At the end of a cycle, after rules have fired: withdraws the commands of nets that end with it. Returns whether
    /// there were any, as drivers must see this at once.
    pub fn withdraw(&mut self) -> bool {
        for at in 0..self.running.len() {
            let net = &self.running[at];
            if net.end.is_none() || net.leaves {
                continue;
            }
            let id = net.id;
            self.running[at].leaves = true;
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
        for net in heirs.filter(|net| net.succeeds && net.end.is_none()) {
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

//! What a net commanded ends with it, however it ends: its commands are withdrawn in the same cycle, and drivers brake
//! at once instead of waiting for what a slow net would have given next. The one exception is a successor that a rule
//! starts in its place: what that commands too stands until its first cycle, so that they are switched without a gap.
//! Who ends and why is decided elsewhere, and what a driver does then is its own matter.

use takt_net::Image;

use super::{Executor, PLACES, Running};

/// Nets that ended and whose commands are still in the image.
#[derive(Debug)]
pub(super) struct Leaving {
    /// Theirs are withdrawn the next time.
    now: Vec<u32>,
    /// Theirs stand until the next cycle: a rule that is decided in another thread may still start a successor.
    later: Vec<u32>,
}

impl Default for Leaving {
    fn default() -> Self {
        Self {
            now: Vec::with_capacity(PLACES),
            later: Vec::with_capacity(PLACES),
        }
    }
}

impl Leaving {
    /// Notes a net that ended, once.
    pub(super) fn note(&mut self, net: &mut Running) {
        if !std::mem::replace(&mut net.leaves, true) {
            self.now.push(net.id);
        }
    }
}

impl Running {
    /// After its evaluation in `cycle`: what it was to take over, and did not, ends.
    pub(super) fn take_over(&mut self, image: &Image, cycle: u64) {
        if std::mem::replace(&mut self.succeeds, false) {
            for target in self.plan.commands() {
                image.withdraw_unused(*target, self.id, cycle);
            }
        }
    }
}

impl Executor {
    /// After evaluation: withdraws what nets commanded that ended before this cycle.
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

    /// At the end of a cycle, when rules have fired: withdraws what nets commanded that end with it. Returns whether
    /// there was anything, which drivers are to see at once.
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

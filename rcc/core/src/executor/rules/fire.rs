//! What waiting rules do between two cycles: literals are answered, conditions evaluated, and what rules
//! order happens at once or not at all. Nothing comes or goes here.

use takt_rt::Nanos;

use super::{Failure, Literal, Question, RuleState, Rules};
use crate::executor::rules::shared::Decision;
use crate::executor::{DeviceView, End, Executor, ResourceSet, Running};

/// What the nets hold and cost that run on.
#[derive(Clone, Copy, Default)]
struct Standing {
    nets: usize,
    held: ResourceSet,
    load: Nanos,
}

impl Standing {
    fn end(&mut self, net: &Running) {
        self.nets -= 1;
        self.held.remove(&net.resources);
        self.load -= net.cost;
    }

    fn begin(&mut self, net: &Running) {
        self.nets += 1;
        self.held.add(&net.resources);
        self.load += net.cost;
    }
}

impl Executor {
    /// Tells each running net whether a successor waits for it; calls `changed` where that is new.
    /// Called before each cycle.
    pub fn announce_takeovers(&mut self, mut changed: impl FnMut(u32, bool)) {
        for net in &mut self.running {
            let waits = self.rules.roll.is_followed(net.id);
            if std::mem::replace(&mut net.takeover, waits) != waits {
                changed(net.id, waits);
            }
        }
    }

    /// Brings the literals up to date and fires the rules that hold. Called after each cycle,
    /// before nets that ended are taken out: what they held passes to their successors, which are
    /// evaluated from the next cycle on.
    pub fn fire_rules(&mut self) {
        let changed = std::mem::take(&mut self.epochs_changed);
        if self.rules.waiting.is_empty() {
            return;
        }
        self.rules.seat(&self.running);
        if changed {
            self.give_back_changed();
        }
        self.answer_literals();
        let mut standing = self.standing();
        self.consult(&standing);
        // Those that start nothing cannot fail, and may free what others need.
        for starts in [false, true] {
            for at in 0..self.rules.waiting.len() {
                let rule = &self.rules.waiting[at];
                let turn = rule.orders.start.is_empty() != starts;
                if turn && rule.state == RuleState::Active && rule.is_due() {
                    self.fire(at, &mut standing);
                }
            }
        }
        for at in 0..self.rules.waiting.len() {
            let rule = &mut self.rules.waiting[at];
            let changed = std::mem::take(&mut rule.changed);
            let whole = rule.part.is_none();
            if changed && whole && rule.state == RuleState::Active && !rule.can_hold() {
                self.rules.retire(at, RuleState::Inactive);
            }
        }
    }

    /// Does what was decided about rules in several threads since the last cycle. Called before each
    /// cycle; returns whether nets may have been changed.
    pub fn fire_decided(&mut self) -> bool {
        let mut standing = None;
        for at in 0..self.rules.waiting.len() {
            let rule = &self.rules.waiting[at];
            let decided = rule.state == RuleState::Active && rule.part.is_some() && rule.is_due();
            if !decided {
                continue;
            }
            let mut now = standing.unwrap_or_else(|| {
                self.rules.seat(&self.running);
                self.standing()
            });
            self.fire(at, &mut now);
            standing = Some(now);
        }
        standing.is_some()
    }

    fn answer_literals(&mut self) {
        for rule in &mut self.rules.waiting {
            let literals = rule.literals.iter_mut().zip(&rule.slots);
            for (literal, slot) in literals.filter(|(l, _)| !l.last) {
                let (id, at) = self.rules.roll.running(*slot);
                let net = self.running.get(at).filter(|net| net.id == id);
                if let Some(net) = net {
                    rule.changed |= answer(literal, net, net.end);
                }
            }
        }
    }

    fn standing(&self) -> Standing {
        let mut standing = Standing::default();
        self.going_on().for_each(|net| standing.begin(net));
        standing
    }

    /// Exchanges literals of rules in several threads, and decides about those that are decided here.
    fn consult(&mut self, standing: &Standing) {
        for at in 0..self.rules.waiting.len() {
            let rule = &self.rules.waiting[at];
            if rule.part.is_none() || rule.state != RuleState::Active {
                continue;
            }
            let obstacle = self.obstacle(at, standing);
            let rule = &mut *self.rules.waiting[at];
            let Some(part) = &rule.part else {
                continue;
            };
            part.exchange(&mut rule.literals, obstacle.is_none());
            if part.is_to_decide() {
                if rule.holds() {
                    part.decide_to_fire();
                } else if !rule.can_hold() {
                    part.shared().decide(Decision::Never);
                }
            }
            match part.shared().decision() {
                Decision::Open | Decision::Fire => {}
                Decision::Fail => {
                    rule.failure = obstacle;
                    self.rules.retire(at, RuleState::FireFailed);
                }
                Decision::Never => self.rules.retire(at, RuleState::Inactive),
            }
        }
    }

    /// Why the nets that a rule starts here could not start now, if that is so.
    fn obstacle(&self, at: usize, standing: &Standing) -> Option<Failure> {
        let rule = &self.rules.waiting[at];
        if rule.started().is_empty() {
            return None;
        }
        let mut after = *standing;
        for slot in rule.stopped() {
            let net = self.rules.running_at(*slot, &self.running);
            let net = net.and_then(|at| self.running.get(at));
            if let Some(net) = net.filter(|net| net.end.is_none()) {
                after.end(net);
            }
        }
        let held = after.held;
        for (slot, id) in rule.started().iter().zip(&rule.orders.start) {
            let net = self.rules.scheduled_at(*slot);
            let Some(net) = net.and_then(|at| self.rules.scheduled.get(at)) else {
                return Some(Failure::NotWaiting(*id));
            };
            if let Some(device) = self.changed_device(net) {
                return Some(Failure::DeviceChanged(device));
            }
            if let Some(held) = net.resources.common(&held) {
                return Some(Failure::ResourceInUse(held));
            }
            let is_ready = |number| self.devices.get(number).is_some_and(DeviceView::is_ready);
            if let Some((device, _)) = net.devices.iter().find(|d| !is_ready(d.0)) {
                return Some(Failure::DeviceNotReady(*device));
            }
            after.load += net.cost;
        }
        if !self.has_places(after.nets, rule.started().len()) {
            return Some(Failure::TooMany);
        }
        (after.load > self.budget).then_some(Failure::Overload)
    }

    /// A device of a scheduled net that did not go on as it was when the net was scheduled.
    fn changed_device(&self, net: &Running) -> Option<usize> {
        let mut devices = net.devices.iter();
        let changed = devices.find(|(number, epoch)| self.epoch(*number) != *epoch);
        changed.map(|(number, _)| *number)
    }

    /// Gives up the rules that start nets of devices which had a fault, or began to follow commands, since those nets
    /// were scheduled: what was asked for before is not done after.
    fn give_back_changed(&mut self) {
        for at in 0..self.rules.waiting.len() {
            let rule = &self.rules.waiting[at];
            if rule.state != RuleState::Active {
                continue;
            }
            let nets = rule.started().iter();
            let nets =
                nets.filter_map(|slot| self.rules.scheduled.get(self.rules.scheduled_at(*slot)?));
            let Some(device) = nets.into_iter().find_map(|net| self.changed_device(net)) else {
                continue;
            };
            if let Some(part) = &rule.part {
                part.shared().decide(Decision::Fail);
            }
            self.fail(at, Failure::DeviceChanged(device));
        }
    }

    fn fail(&mut self, at: usize, why: Failure) {
        self.rules.waiting[at].failure = Some(why);
        self.rules.retire(at, RuleState::FireFailed);
    }

    fn fire(&mut self, at: usize, standing: &mut Standing) {
        if let Some(why) = self.obstacle(at, standing) {
            self.fail(at, why);
            return;
        }
        self.rules.retire(at, RuleState::Fired);
        let Rules { waiting, .. } = &self.rules;
        for slot in waiting[at].stopped() {
            let Some(net) = self.rules.running_at(*slot, &self.running) else {
                continue;
            };
            let net = &mut self.running[net];
            if net.end.is_none() {
                net.end = Some(End::Stopped);
                standing.end(net);
            }
        }
        for slot in waiting[at].cancelled() {
            let Some(net) = self.rules.running_at(*slot, &self.running) else {
                continue;
            };
            let net = &mut self.running[net];
            if !net.cancel {
                (net.cancel, net.fresh_cancel) = (true, true);
            }
        }
        for number in 0..waiting[at].started().len() {
            let slot = self.rules.waiting[at].started()[number];
            let Some(from) = self.rules.scheduled_at(slot) else {
                continue;
            };
            let mut net = self.rules.unseat_scheduled(from);
            net.fresh = true;
            standing.begin(&net);
            self.rules.roll.seat_running(net.id, self.running.len());
            self.start_by_rule(net);
        }
    }
}

/// Answers a literal from its net, which has just ended if there is an `end`; returns whether that is
/// news.
pub(super) fn answer(literal: &mut Literal, net: &Running, end: Option<End>) -> bool {
    let value = match literal.question {
        Question::Value(at) => net.plan.out_bool(at),
        Question::Terminated => end.map(|end| end == End::Terminated),
    };
    let last = end.is_some();
    let before = (literal.value, literal.last);
    (literal.value, literal.last) = (value, last);
    before != (value, last)
}

//! Firing of rules between two cycles: literals are answered, conditions evaluated, and the actions of a rule
//! happen all at once or not at all.

use takt_net::Moment;
use takt_rt::Nanos;

use super::Rules;
use super::gate::{Begun, Verdict};
use super::rule::{Failure, RuleState};
use super::shared::Decision;
use crate::executor::life::{Change, StartReport};
use crate::executor::{DeviceView, End, Executor, ResourceSet, Running};

/// Resources and cost of the nets that continue.
#[derive(Clone, Copy, Default)]
struct Usage {
    nets: usize,
    held: ResourceSet,
    load: Nanos,
}

impl Usage {
    fn end(&mut self, net: &Running) {
        self.nets -= 1;
        if net.seat.is_some() {
            // Its machine keeps its resources and its cost.
            return;
        }
        self.held.remove(&net.resources);
        self.load -= net.cost;
    }

    fn begin(&mut self, net: &Running) {
        self.nets += 1;
        if net.seat.is_some() {
            return;
        }
        self.held.add(&net.resources);
        self.load += net.cost;
    }
}

impl Executor {
    /// Notifies each running net whether a successor waits for it; calls `changed` on a change.
    /// Called before each cycle.
    pub fn announce_takeovers(&mut self, mut changed: impl FnMut(u32, bool)) {
        for net in &mut self.running {
            let waits = self.rules.nets_named.is_followed(net.id);
            if std::mem::replace(&mut net.takeover, waits) != waits {
                changed(net.id, waits);
            }
        }
    }

    /// Brings the literals up to date and fires the rules that hold. Called after each cycle,
    /// before ended nets are removed: their resources pass to their successors, which are
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
        let mut usage = self.usage();
        self.exchange_literals(&usage);
        // Rules that start nothing cannot fail, and may free resources that others need.
        for starts in [false, true] {
            for at in 0..self.rules.waiting.len() {
                let rule = &self.rules.waiting[at];
                let turn = rule.orders.start.is_empty() != starts;
                if turn && rule.state == RuleState::Active && rule.is_due() {
                    self.fire(at, &mut usage);
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

    /// Applies decisions about rules in several threads since the last cycle, and fires the rules whose gates are due in the cycle
    /// that begins at `begin`. Called before each cycle; returns whether nets may have been changed.
    pub fn fire_decided(&mut self, moment: Moment, begin: Nanos) -> bool {
        let mut usage = None;
        for at in 0..self.rules.waiting.len() {
            let rule = &self.rules.waiting[at];
            if rule.state != RuleState::Active {
                continue;
            }
            let gate = rule.gate.clone();
            match gate.as_ref().map(|gate| gate.pass(moment.cycle, begin)) {
                Some(Verdict::Wait) => continue,
                Some(Verdict::Late) => {
                    self.fail(at, Failure::Late);
                    continue;
                }
                Some(Verdict::Released) => {
                    self.rules.retire(at, RuleState::Inactive);
                    continue;
                }
                None if rule.part.is_none() || !rule.is_due() => continue,
                Some(Verdict::Due) | None => {}
            }
            let mut now = usage.unwrap_or_else(|| {
                self.rules.seat(&self.running);
                self.usage()
            });
            self.fire(at, &mut now);
            usage = Some(now);
            let has_fired = self.rules.waiting[at].state == RuleState::Fired;
            if let Some(gate) = gate.filter(|_| has_fired) {
                let (cycle, woken) = (moment.cycle, Nanos(moment.wall.0));
                gate.note(Begun {
                    cycle,
                    begin,
                    woken,
                });
            }
        }
        usage.is_some()
    }

    fn answer_literals(&mut self) {
        for rule in &mut self.rules.waiting {
            let literals = rule.literals.iter_mut().zip(&rule.slots);
            for (literal, slot) in literals.filter(|(l, _)| !l.last) {
                let (id, at) = self.rules.nets_named.running(*slot);
                let net = self.running.get(at).filter(|net| net.id == id);
                if let Some(net) = net {
                    rule.changed |= literal.answer(&net.plan, net.life.end());
                }
            }
        }
    }

    fn usage(&self) -> Usage {
        let mut usage = Usage::default();
        self.going_on().for_each(|net| usage.begin(net));
        for hosted in self.hosted() {
            usage.held.add(&hosted.resources);
            usage.load += hosted.cost;
        }
        usage
    }

    /// Exchanges literals of rules in several threads, and decides those whose deciding part is here.
    fn exchange_literals(&mut self, usage: &Usage) {
        for at in 0..self.rules.waiting.len() {
            let rule = &self.rules.waiting[at];
            if rule.part.is_none() || rule.state != RuleState::Active {
                continue;
            }
            let start_failure = self.start_failure(at, usage);
            let rule = &mut *self.rules.waiting[at];
            let Some(part) = &rule.part else {
                continue;
            };
            part.exchange(&mut rule.literals, start_failure.is_none());
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
                    rule.failure = start_failure;
                    self.rules.retire(at, RuleState::FireFailed);
                }
                Decision::Never => self.rules.retire(at, RuleState::Inactive),
            }
        }
    }

    /// Why the nets that a rule starts here cannot start now; `None` if they can.
    fn start_failure(&self, at: usize, usage: &Usage) -> Option<Failure> {
        let rule = &self.rules.waiting[at];
        if rule.started().is_empty() {
            return None;
        }
        let mut after = *usage;
        for slot in rule.stopped() {
            let net = self.rules.running_at(*slot, &self.running);
            let net = net.and_then(|at| self.running.get(at));
            if let Some(net) = net.filter(|net| net.is_going_on()) {
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
        if !self.has_capacity(after.nets, rule.started().len()) {
            return Some(Failure::TooMany);
        }
        (after.load > self.budget).then_some(Failure::Overload)
    }

    /// A device of a scheduled net whose epoch has changed since the net was scheduled.
    fn changed_device(&self, net: &Running) -> Option<usize> {
        let mut devices = net.devices.iter();
        let changed = devices.find(|(number, epoch)| self.epoch(*number) != *epoch);
        changed.map(|(number, _)| *number)
    }

    /// Fails the rules whose nets use devices that had a fault or were enabled since those nets
    /// were scheduled: a request from before is not executed after.
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

    fn fire(&mut self, at: usize, usage: &mut Usage) {
        if let Some(why) = self.start_failure(at, usage) {
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
            if net.is_going_on() {
                net.change(Change::End(End::Stopped));
                usage.end(net);
            }
        }
        for slot in waiting[at].cancelled() {
            let Some(net) = self.rules.running_at(*slot, &self.running) else {
                continue;
            };
            self.running[net].cancel_by_rule();
        }
        for number in 0..waiting[at].started().len() {
            let slot = self.rules.waiting[at].started()[number];
            let Some(from) = self.rules.scheduled_at(slot) else {
                continue;
            };
            let mut net = self.rules.clear_scheduled_index(from);
            net.start_report = StartReport::Due;
            usage.begin(&net);
            self.rules
                .nets_named
                .set_running_index(net.id, self.running.len());
            self.start_by_rule(net);
        }
    }
}

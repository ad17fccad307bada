//! Adding and removing rules and their nets: resources reserved for nets that a rule starts, and the reasons for
//! rejection. Nothing fires here; the registry reserves cycle time.

use takt_rt::Nanos;

use super::{
    Literal, RULES_MAX, Rule, RuleRefusal, RuleState, Rules, SCHEDULED_MAX, Slot, WORK_MAX, answer,
};
use crate::executor::{Executor, Refusal, ResourceSet, Running};

impl Executor {
    /// Schedules a net that rules may start, as long as the epochs of its devices do not change.
    ///
    /// # Errors
    /// If the limit is reached.
    pub fn schedule(&mut self, mut net: Box<Running>) -> Result<(), Box<Running>> {
        if self.rules.scheduled.len() == SCHEDULED_MAX {
            return Err(net);
        }
        for device in &mut net.devices {
            device.1 = self.epoch(device.0);
        }
        self.rules.scheduled.push(net);
        Ok(())
    }

    /// Returns a scheduled net: always, or only if no rule waits to start it. Rules that lose it
    /// become inactive.
    pub fn take_unscheduled(&mut self, id: u32, always: bool) -> Option<Box<Running>> {
        let rules = &mut self.rules;
        if let Some(slot) = rules.nets_named.find(id) {
            for at in 0..rules.waiting.len() {
                let rule = &rules.waiting[at];
                if rule.state != RuleState::Active || !rule.started().contains(&slot) {
                    continue;
                }
                if !always {
                    return None;
                }
                let state = rule.give_up();
                rules.retire(at, state);
            }
        }
        let at = rules.scheduled.iter().position(|net| net.id == id)?;
        Some(rules.clear_scheduled_index(at))
    }

    /// Adds a rule and reserves the resources of its nets, except those held by nets that it follows.
    ///
    /// # Errors
    /// If it is rejected; the rule is returned with the reason, and its parts in other threads become
    /// inactive.
    pub fn add_rule(&mut self, mut rule: Box<Rule>) -> Result<(), (Box<Rule>, RuleRefusal)> {
        if let Err(refusal) = self.take_in(&mut rule) {
            rule.state = rule.give_up();
            return Err((rule, refusal));
        }
        let rules = &mut self.rules;
        if rule.starts_any() {
            let followed = rule.followed().iter();
            followed.for_each(|slot| rules.nets_named.follow(*slot, true));
        }
        let Rule {
            literals, slots, ..
        } = &mut *rule;
        for (literal, slot) in literals.iter_mut().zip(slots).filter(|(l, _)| !l.last) {
            if let Some(at) = rules.running_at(*slot, &self.running) {
                answer(literal, &self.running[at], None);
            }
        }
        rules.work += rule.work();
        rules.waiting.push(rule);
        Ok(())
    }

    /// Adds the nets of a new rule to the table and reserves its resources.
    fn take_in(&mut self, rule: &mut Rule) -> Result<(), RuleRefusal> {
        if self.rules.waiting.len() == RULES_MAX {
            return Err(RuleRefusal::TooMany);
        }
        if self.rules.work + rule.work() > WORK_MAX {
            return Err(RuleRefusal::TooLong);
        }
        self.rules.enter(rule);
        self.rules.seat(&self.running);
        self.rules.mark(rule.followed(), true);
        let reserved = self.reserve(rule);
        self.rules.mark(rule.followed(), false);
        match reserved {
            Ok(reserved) => {
                rule.reserved = reserved;
                Ok(())
            }
            Err(refusal) => {
                self.rules.leave(rule);
                Err(refusal)
            }
        }
    }

    /// Resources to reserve for a new rule. The nets that it follows are marked.
    fn reserve(&self, rule: &Rule) -> Result<ResourceSet, RuleRefusal> {
        let rules = &self.rules;
        let mut wanted = ResourceSet::default();
        for (slot, id) in rule.started().iter().zip(&rule.orders.start) {
            let at = rules.scheduled_at(*slot);
            let net = &rules.scheduled[at.ok_or(RuleRefusal::NotWaiting(*id))?];
            if let Some(twice) = wanted.common(&net.resources) {
                return Err(RuleRefusal::ResourceTwice(twice));
            }
            wanted.add(&net.resources);
        }
        let claim = rules.claim(rule, wanted);
        let is_followed = |net: &Running| {
            let slot = rules.nets_named.find(net.id);
            slot.is_some_and(|slot| rules.nets_named.is_marked(slot))
        };
        for net in self.running.iter().filter(|net| !is_followed(net)) {
            if let Some(held) = claim.common(&net.resources) {
                return Err(RuleRefusal::ResourceInUse(held));
            }
        }
        // Alternatives of one predecessor may need the same resource: only one of them will run.
        let is_stranger = |other: &Rule| {
            !other
                .followed()
                .iter()
                .any(|s| rules.nets_named.is_marked(*s))
        };
        for other in &rules.waiting {
            if claim.common(&other.reserved).is_none() || !is_stranger(other) {
                continue;
            }
            if let Some(kept) = claim.common(&rules.claim(other, other.reserved)) {
                return Err(RuleRefusal::ResourceInUse(kept));
            }
        }
        Ok(wanted)
    }

    /// Why a net cannot start now beside running and scheduled nets.
    pub(in crate::executor) fn blocked(&mut self, net: &Running) -> Option<Refusal> {
        let held = self.held();
        if let Some(resource) = net.resources.common(&held) {
            return Some(Refusal::ResourceInUse(resource));
        }
        let (running, budget) = (self.load(), self.budget);
        if running + net.cost > budget {
            return Some(Refusal::Overload { running, budget });
        }
        if self.rules.waiting.is_empty() {
            return None;
        }
        self.rules.seat(&self.running);
        let slot = self.rules.nets_named.find(net.id);
        let concerns = |slots: &[Slot]| slot.is_some_and(|slot| slots.contains(&slot));
        let rules = self.rules.waiting.iter().map(|rule| &**rule);
        let rules = rules.filter(|rule| net.resources.common(&rule.reserved).is_some());
        let mut strangers = rules.filter(|r| !concerns(r.started()) && !concerns(r.followed()));
        strangers.find_map(|rule| {
            let kept = self.rules.claim(rule, rule.reserved);
            let resource = net.resources.common(&kept)?;
            Some(Refusal::ResourceKept(resource))
        })
    }

    /// Cost of all running nets in a cycle in which each is evaluated.
    pub(super) fn load(&self) -> Nanos {
        self.going_on().fold(Nanos::ZERO, |sum, net| sum + net.cost)
    }

    /// Removes the rules that no longer wait, as far as `take` accepts them.
    pub fn take_rules(&mut self, mut take: impl FnMut(Box<Rule>) -> Result<(), Box<Rule>>) {
        if self.rules.over == 0 {
            return;
        }
        let Rules {
            waiting,
            nets_named,
            work,
            over,
            ..
        } = &mut self.rules;
        let mut back = None;
        for rule in waiting.extract_if(.., |rule| rule.state != RuleState::Active) {
            rule.slots.iter().for_each(|slot| nets_named.leave(*slot));
            *work -= rule.work();
            *over -= 1;
            back = take(rule).err();
            if back.is_some() {
                break;
            }
        }
        if let Some(mut rule) = back {
            // It is not accepted now; it is offered again and stays inactive.
            self.rules.enter(&mut rule);
            self.rules.work += rule.work();
            self.rules.over += 1;
            self.rules.waiting.push(rule);
        }
    }

    /// Sets the final answer of literals about a net that had ended before the rule was added.
    pub fn set_final_answer(&mut self, answer: Literal) {
        for rule in &mut self.rules.waiting {
            let asked =
                |l: &&mut Literal| !l.last && (l.net, l.question) == (answer.net, answer.question);
            for literal in rule.literals.iter_mut().filter(asked) {
                *literal = answer;
                rule.changed = true;
            }
        }
    }

    /// Notifies rules that a net will never run again, or never ran.
    pub fn forget(&mut self, id: u32) {
        if self.rules.nets_named.find(id).is_none() {
            return;
        }
        for rule in &mut self.rules.waiting {
            for literal in rule.literals.iter_mut().filter(|l| l.net == id) {
                literal.last = true;
                rule.changed = true;
            }
        }
    }
}

impl Rules {
    /// Adds the nets that a rule names to the table.
    fn enter(&mut self, rule: &mut Rule) {
        let mut slots = std::mem::take(&mut rule.slots);
        for (slot, id) in slots.iter_mut().zip(rule.names()) {
            *slot = self.nets_named.enter(id);
        }
        rule.slots = slots;
    }

    fn leave(&mut self, rule: &Rule) {
        rule.slots
            .iter()
            .for_each(|slot| self.nets_named.leave(*slot));
    }

    fn mark(&mut self, slots: &[Slot], marked: bool) {
        for slot in slots {
            self.nets_named.mark(*slot, marked);
        }
    }

    /// Resources that a rule claims now, without those of scheduled nets that it follows.
    fn claim(&self, rule: &Rule, mut wanted: ResourceSet) -> ResourceSet {
        for slot in rule.followed() {
            if let Some(at) = self.scheduled_at(*slot) {
                wanted.remove(&self.scheduled[at].resources);
            }
        }
        wanted
    }
}

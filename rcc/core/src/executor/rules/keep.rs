//! Adding and removing rules and their nets: resources reserved for nets that a rule starts, and the reasons for
//! rejection. Nothing fires here; the registry reserves cycle time.

use super::Rules;
use super::limits::{RULES_MAX, SCHEDULED_MAX, WORK_MAX};
use super::literal::Literal;
use super::net_table::Slot;
use super::rule::{Rule, RuleError, RuleState};
use crate::executor::{Executor, ResourceSet, Running};

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
        if let Some(net) = self.take_seated(id) {
            return Some(net);
        }
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
    pub fn add_rule(&mut self, mut rule: Box<Rule>) -> Result<(), (Box<Rule>, RuleError)> {
        if let Err(error) = self.take_in(&mut rule) {
            rule.state = rule.give_up();
            return Err((rule, error));
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
                literal.answer(&self.running[at].plan, None);
            }
        }
        rules.work += rule.work();
        rules.waiting.push(rule);
        Ok(())
    }

    /// Adds the nets of a new rule to the table and reserves its resources.
    fn take_in(&mut self, rule: &mut Rule) -> Result<(), RuleError> {
        if self.rules.waiting.len() == RULES_MAX {
            return Err(RuleError::TooMany);
        }
        if self.rules.work + rule.work() > WORK_MAX {
            return Err(RuleError::TooLong);
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
            Err(error) => {
                self.rules.leave(rule);
                Err(error)
            }
        }
    }

    /// Resources to reserve for a new rule. The nets that it follows are marked.
    fn reserve(&self, rule: &Rule) -> Result<ResourceSet, RuleError> {
        let rules = &self.rules;
        let mut wanted = ResourceSet::default();
        for (slot, id) in rule.started().iter().zip(&rule.orders.start) {
            let at = rules.scheduled_at(*slot);
            let net = &rules.scheduled[at.ok_or(RuleError::NotWaiting(*id))?];
            if let Some(twice) = wanted.common(&net.resources) {
                return Err(RuleError::ResourceTwice(twice));
            }
            wanted.add(&net.resources);
        }
        let claim = rules.claim(rule, wanted);
        let is_followed = |net: &Running| {
            let slot = rules.nets_named.find(net.id);
            slot.is_some_and(|slot| rules.nets_named.is_marked(slot))
        };
        for hosted in self.hosted() {
            if let Some(held) = claim.common(&hosted.resources) {
                return Err(RuleError::ResourceInUse(held));
            }
        }
        for net in self.running.iter().filter(|net| !is_followed(net)) {
            if let Some(held) = claim.common(&net.resources) {
                return Err(RuleError::ResourceInUse(held));
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
                return Err(RuleError::ResourceInUse(kept));
            }
        }
        Ok(wanted)
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

    /// A resource of a net that is kept from it for a rule which neither starts nor follows it.
    pub(in crate::executor) fn kept_from(
        &mut self,
        net: &Running,
        running: &[Box<Running>],
    ) -> Option<usize> {
        if self.waiting.is_empty() {
            return None;
        }
        self.seat(running);
        let slot = self.nets_named.find(net.id);
        let concerns = |slots: &[Slot]| slot.is_some_and(|slot| slots.contains(&slot));
        let rules = self.waiting.iter().map(|rule| &**rule);
        let rules = rules.filter(|rule| net.resources.common(&rule.reserved).is_some());
        let mut strangers = rules.filter(|r| !concerns(r.started()) && !concerns(r.followed()));
        strangers.find_map(|rule| net.resources.common(&self.claim(rule, rule.reserved)))
    }

    /// A resource that is reserved for nets that rules may start.
    pub(in crate::executor) fn reserved(&self, wanted: &ResourceSet) -> Option<usize> {
        let mut rules = self.waiting.iter();
        rules.find_map(|rule| wanted.common(&rule.reserved))
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

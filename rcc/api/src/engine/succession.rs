//! Which activities follow which: when a group is scheduled, and what ends with an activity that ended.

use std::collections::BTreeSet;

use super::Engine;
use super::activity::{Action, ActivityId, Group, GroupId, GroupLife, State, When};
use crate::error::ErrorKind;
use crate::outcome::Outcome;

/// Why a net ended whose place another one took, in the words of the controller.
const STOPPED_BY_RULE: &str = "stopped by a rule";

impl Engine {
    /// Schedules each group whose nets and predecessors are ready.
    pub(super) fn bind_all(&mut self) {
        let groups: Vec<_> = self.groups.keys().copied().collect();
        for group in groups {
            self.bind(group);
        }
    }

    pub(super) fn bind(&mut self, id: GroupId) {
        self.follow_what_is_left(id);
        let Some(group) = self
            .groups
            .get(&id)
            .filter(|group| group.life == GroupLife::Loading)
        else {
            return;
        };
        let is_loaded = |id: &ActivityId| {
            self.activities
                .get(id)
                .is_some_and(|a| a.state == State::Loaded)
        };
        if !group.members.iter().all(is_loaded) {
            return;
        }
        if !group.ending.iter().all(|id| self.has_ended(*id)) || !self.others_are_bound(group) {
            return;
        }
        let running = |id: &ActivityId| !self.has_ended(*id);
        let waited: Vec<_> = group.predecessors().filter(running).collect();
        let call = group.call;
        let is_scheduled = |id: &ActivityId| {
            self.activities.get(id).is_some_and(|a| {
                let other = self.groups.get(&a.group);
                let is_same = other.is_some_and(|other| other.call == call);
                matches!(a.state, State::Waiting | State::Running)
                    || (is_same && a.state == State::Loaded)
            })
        };
        let is_known = |(id, _): &(ActivityId, Vec<String>)| {
            self.activities.get(id).is_some_and(|a| a.net.is_some())
        };
        if !waited.iter().all(is_scheduled) || !group.trigger.iter().all(is_known) {
            return;
        }
        let devices = self.devices(group);
        let is_stopped = |id: &ActivityId| {
            let activity = self.activities.get(id);
            activity.is_some_and(|activity| activity.commands(&devices) && !activity.is_unloading)
        };
        let stopped: Vec<_> = waited.iter().copied().filter(is_stopped).collect();
        let (Some(start), Some(stop)) = (self.nets_of(&group.members), self.nets_of(&stopped))
        else {
            return;
        };
        let condition = match group.when {
            When::Now => "t".to_owned(),
            When::Follow => self.condition(group, &devices),
        };
        if group.when == When::Now {
            for replaced in &waited {
                let activity = self.activities.get_mut(replaced);
                if let Some(activity) = activity.filter(|a| a.state == State::Waiting) {
                    activity.pending = Some(Ok(Outcome::Cancelled));
                }
            }
        }
        self.actions.push(Action::Schedule {
            group: id,
            condition,
            stop,
            start,
        });
        self.enter(id, GroupLife::Scheduled, State::Waiting);
    }

    /// Lets a group that follows failures wait for all that its devices still do: what it followed may itself have
    /// waited, and failed before it began.
    fn follow_what_is_left(&mut self, id: GroupId) {
        let is_due = |group: &&Group| {
            let is_left = group.predecessors().any(|id| !self.has_ended(id));
            group.after_failure && group.life == GroupLife::Loading && !is_left
        };
        let Some(group) = self.groups.get(&id).filter(is_due) else {
            return;
        };
        let devices = self.devices(group);
        let first = group.members.first().copied();
        let left = self.activities.iter().filter(|(id, activity)| {
            let is_before = first.is_some_and(|first| **id < first);
            is_before && activity.commands(&devices) && !self.has_ended(**id)
        });
        let slots = left.map(|(id, _)| vec![*id]).collect();
        if let Some(group) = self.groups.get_mut(&id) {
            group.slots = slots;
        }
    }

    fn nets_of(&self, ids: &[ActivityId]) -> Option<Vec<String>> {
        let net = |id| self.activities.get(id)?.net.clone();
        ids.iter().map(net).collect()
    }

    fn devices(&self, group: &Group) -> BTreeSet<String> {
        let members = group.members.iter();
        let members = members.filter_map(|id| self.activities.get(id));
        members
            .flat_map(|activity| activity.devices.clone())
            .collect()
    }

    /// Whether the other groups of its call wait for their rules, if it is the first of them to begin.
    fn others_are_bound(&self, group: &Group) -> bool {
        let of_call = |id: ActivityId| {
            let other = self.activities.get(&id);
            let other = other.and_then(|activity| self.groups.get(&activity.group));
            other.is_some_and(|other| other.call == group.call)
        };
        let trigger = group.trigger.iter().map(|(id, _)| *id);
        if group.instead_of.is_some() || group.predecessors().chain(trigger).any(of_call) {
            return true;
        }
        let mut others = self.groups.values();
        others.all(|other| {
            let is_other = other.call == group.call && other.members != group.members;
            !is_other || other.life != GroupLife::Loading || self.is_first(other)
        })
    }

    /// Whether a group follows no other one of its call.
    fn is_first(&self, group: &Group) -> bool {
        let of_call = |id: ActivityId| {
            let other = self.activities.get(&id);
            let other = other.and_then(|activity| self.groups.get(&activity.group));
            other.is_some_and(|other| other.call == group.call)
        };
        let trigger = group.trigger.iter().map(|(id, _)| *id);
        !group.predecessors().chain(trigger).any(of_call)
    }

    /// True when of each slot an activity has a result that the group may follow, and its trigger has one of its keys.
    fn condition(&self, group: &Group, devices: &BTreeSet<String>) -> String {
        let mut all = Vec::new();
        let trigger = group.trigger.as_ref();
        if let Some((id, keys)) = trigger
            && let Some(net) = self
                .activities
                .get(id)
                .and_then(|activity| activity.net.as_ref())
        {
            let keys: Vec<_> = keys.iter().map(|key| format!("{net}.out{key}")).collect();
            all.push(format!("({})", keys.join("|")));
        }
        for slot in &group.slots {
            let waited = slot.iter().filter(|id| !self.has_ended(**id));
            let waited: Vec<_> = waited
                .filter(|id| trigger.is_none_or(|(trigger, _)| trigger != *id))
                .collect();
            let results: Vec<_> = waited
                .into_iter()
                .flat_map(|id| self.open_results(*id, group, devices))
                .collect();
            if !results.is_empty() {
                all.push(format!("({})", results.join("|")));
            }
        }
        if all.is_empty() {
            "t".to_owned()
        } else {
            all.join("&")
        }
    }

    /// Results of an activity that a group may follow, without those that start an earlier group of the same device.
    fn open_results(
        &self,
        id: ActivityId,
        group: &Group,
        devices: &BTreeSet<String>,
    ) -> Vec<String> {
        let Some((activity, net)) = self
            .activities
            .get(&id)
            .and_then(|activity| Some((activity, activity.net.as_ref()?)))
        else {
            return Vec::new();
        };
        // Another device does not take over: it waits for the end.
        let takes_over = activity.commands(devices);
        let is_taken = |key: &&String| {
            self.groups.values().any(|other| {
                let is_other = other.members < group.members && other.may_begin();
                let trigger = other.trigger.as_ref().filter(|(trigger, _)| *trigger == id);
                let mine = trigger.is_some_and(|(_, keys)| keys.contains(key));
                is_other && mine && activity.commands(&self.devices(other))
            })
        };
        let has_branches = self.groups.values().any(|other| {
            let is_other = other.members < group.members && other.may_begin();
            is_other && other.is_started_by(id) && activity.commands(&self.devices(other))
        });
        // It is not taken over before the controller has decided what follows it.
        let takes_over = takes_over && !has_branches;
        let failures = activity.failures.iter().map(|failure| &failure.key);
        let failures = failures.filter(|_| group.after_failure);
        let cancelled = "cancelled".to_owned();
        let keys = activity
            .results
            .iter()
            .filter(|key| takes_over || *key != "blend");
        keys.chain(failures)
            .chain(group.after_failure.then_some(&cancelled))
            .filter(|key| !is_taken(key))
            .map(|key| format!("{net}.out{key}"))
            .collect()
    }

    /// The rule of a group can no longer fire: it waits for what is left, or does not begin.
    pub(super) fn rule_inactive(&mut self, id: GroupId) {
        let Some(group) = self
            .groups
            .get(&id)
            .filter(|group| group.life == GroupLife::Scheduled)
        else {
            return;
        };
        let is_pending = |id: &ActivityId| {
            let activity = self.activities.get(id);
            activity.is_some_and(|activity| activity.pending.is_some())
        };
        if group.members.iter().any(is_pending) {
            // It was replaced or cancelled meanwhile: it does not wait for what is left.
            self.kill(id, &Ok(Outcome::Cancelled));
        } else if group.trigger.is_some() {
            self.kill(id, &Ok(Outcome::Skipped));
        } else if group.after_failure {
            self.enter(id, GroupLife::Loading, State::Loaded);
            self.bind_all();
        }
    }

    /// Groups that stand in for one that began do not begin.
    pub(super) fn skip_reserves(&mut self, id: GroupId) {
        let reserves = self
            .groups
            .iter()
            .filter(|(_, group)| group.instead_of == Some(id) && group.life == GroupLife::Reserve);
        let reserves: Vec<_> = reserves.map(|(id, _)| *id).collect();
        for reserve in reserves {
            self.skip_reserves(reserve);
            self.kill(reserve, &Ok(Outcome::Skipped));
        }
    }

    pub(super) fn enter(&mut self, id: GroupId, life: GroupLife, state: State) {
        let Some(group) = self.groups.get_mut(&id) else {
            return;
        };
        group.life = life;
        for member in &group.members {
            if let Some(activity) = self.activities.get_mut(member) {
                activity.state = state.clone();
            }
        }
    }

    /// Ends an activity, and those that can no longer follow it.
    pub(super) fn end(&mut self, id: ActivityId, outcome: Result<Outcome, ErrorKind>) {
        let Some(activity) = self.activities.get_mut(&id) else {
            return;
        };
        let group = activity.group;
        activity.state = State::Ended(outcome.clone());
        let is_before = self.groups.get(&group).is_some_and(Group::may_begin);
        if is_before {
            // The others of the group cannot begin without it.
            self.kill(group, &outcome);
        }
        let values = self
            .activities
            .get(&id)
            .map(|activity| activity.values.clone());
        let values = values.unwrap_or_default();
        let of = |group: &Group| group.may_begin() && group.concerns(id);
        let followers = self.groups.iter().filter(|(_, group)| of(group));
        let followers: Vec<_> = followers.map(|(id, _)| *id).collect();
        for follower in followers {
            self.predecessor_ended(follower, id, &outcome, &values);
        }
        self.bind_all();
        self.tidy();
    }

    /// An activity that a group follows, or that starts it, has ended with these results.
    fn predecessor_ended(
        &mut self,
        follower: GroupId,
        id: ActivityId,
        outcome: &Result<Outcome, ErrorKind>,
        values: &BTreeSet<String>,
    ) {
        let Some(group) = self.groups.get(&follower) else {
            return;
        };
        if let Some((_, keys)) = group.trigger.as_ref().filter(|(trigger, _)| *trigger == id) {
            if keys.iter().any(|key| values.contains(key)) {
                return self.bind(follower);
            }
            let skipped = match outcome {
                Ok(Outcome::Cancelled) => Ok(Outcome::Cancelled),
                _ => Ok(Outcome::Skipped),
            };
            return self.kill(follower, &skipped);
        }
        let is_alone = group.when == When::Now || group.after_failure;
        match outcome {
            // It replaces what was there, or follows it, however that ended.
            _ if is_alone => self.bind(follower),
            Ok(Outcome::Cancelled) => self.kill(follower, &Ok(Outcome::Cancelled)),
            Ok(Outcome::Skipped) if self.lacks_required(group) => {
                self.kill(follower, &Ok(Outcome::Skipped));
            }
            Ok(_) => self.bind(follower),
            // An alternative takes its place.
            Err(_) if self.has_reserve(id) => {}
            Err(error @ ErrorKind::PredecessorFailed(_)) => {
                self.kill(follower, &Err(error.clone()));
            }
            Err(error) => {
                let error = ErrorKind::PredecessorFailed(Box::new(error.clone()));
                self.kill(follower, &Err(error));
            }
        }
    }

    /// Whether all activities of a slot that the program named were skipped.
    fn lacks_required(&self, group: &Group) -> bool {
        let is_skipped =
            |id: &ActivityId| matches!(self.state(*id), Some(State::Ended(Ok(Outcome::Skipped))));
        group
            .required
            .iter()
            .any(|slot| slot.iter().all(is_skipped))
    }

    /// Whether a group stands in for that of an activity which could not begin.
    fn has_reserve(&self, id: ActivityId) -> bool {
        let activity = self.activities.get(&id);
        activity.is_some_and(|activity| {
            let mut groups = self.groups.values();
            groups.any(|group| group.instead_of == Some(activity.group) && group.may_begin())
        })
    }

    /// What else ends with a group that does not begin: those that stand in for it, or the rest of its call.
    fn end_with(&mut self, id: GroupId, call: u64, outcome: &Result<Outcome, ErrorKind>) {
        let cannot = matches!(outcome, Err(error) if !matches!(error, ErrorKind::PredecessorFailed(_) | ErrorKind::Lost(_)));
        let reserve = self
            .groups
            .iter()
            .find(|(_, group)| group.instead_of == Some(id) && group.life == GroupLife::Reserve);
        if let Some((reserve, _)) = reserve {
            let reserve = *reserve;
            return if cannot {
                self.activate(reserve);
            } else {
                self.kill(reserve, outcome);
            };
        }
        if !cannot {
            return;
        }
        let others = self
            .groups
            .iter()
            .filter(|(_, group)| group.call == call && group.may_begin());
        let others: Vec<_> = others.map(|(id, _)| *id).collect();
        for other in others {
            self.kill(other, outcome);
        }
    }

    pub(super) fn members(&self, id: GroupId) -> Vec<ActivityId> {
        let group = self.groups.get(&id);
        group.map(|group| group.members.clone()).unwrap_or_default()
    }

    /// Ends the activities of a group that has not begun. If its rule was requested, it may fire before the nets are
    /// unloaded: they end when the controller confirms it.
    pub(super) fn kill(&mut self, id: GroupId, outcome: &Result<Outcome, ErrorKind>) {
        let Some(group) = self.groups.get_mut(&id).filter(|group| group.may_begin()) else {
            return;
        };
        let is_scheduled = group.life == GroupLife::Scheduled;
        let call = group.call;
        group.life = GroupLife::Dead;
        self.end_with(id, call, outcome);
        let Some(group) = self.groups.get(&id) else {
            return;
        };
        for member in group.members.clone() {
            if self.has_ended(member) {
                continue;
            }
            let activity = self.activities.get_mut(&member);
            let Some(activity) = activity.filter(|_| is_scheduled) else {
                self.end(member, outcome.clone());
                continue;
            };
            activity.pending.get_or_insert_with(|| outcome.clone());
            activity.is_unloading = true;
            self.actions
                .extend(activity.net.clone().map(Action::Unload));
        }
        self.tidy();
    }

    /// Unloads nets that no rule refers to any more, and forgets what is referred to no more.
    pub(super) fn tidy(&mut self) {
        let needed: BTreeSet<_> = self
            .groups
            .values()
            .filter(|group| group.may_begin())
            .flat_map(|group| {
                let trigger = group.trigger.iter().map(|(id, _)| *id);
                group.predecessors().chain(trigger).collect::<Vec<_>>()
            })
            .collect();
        let unneeded = self.activities.iter_mut().filter(|(id, activity)| {
            matches!(activity.state, State::Ended(_)) && !needed.contains(id)
        });
        let mut forgotten = Vec::new();
        for (id, activity) in unneeded {
            match activity.net.clone() {
                Some(net) if !activity.is_unloading => {
                    activity.is_unloading = true;
                    self.actions.push(Action::Unload(net));
                }
                Some(_) => {}
                None if activity.is_held => {}
                None => forgotten.push(*id),
            }
        }
        for id in forgotten {
            self.activities.remove(&id);
        }
        let activities = &self.activities;
        self.groups
            .retain(|_, group| group.members.iter().any(|id| activities.contains_key(id)));
        let groups = &self.groups;
        self.rules
            .retain(|_, group| groups.get(group).is_some_and(Group::may_begin));
    }

    /// How an activity ended, by the results of its net.
    pub(super) fn outcome(&self, id: ActivityId, reason: &str) -> Result<Outcome, ErrorKind> {
        let Some(activity) = self.activities.get(&id) else {
            return Ok(Outcome::Cancelled);
        };
        let is_open = ["blend", "maintaining"]
            .iter()
            .any(|key| activity.values.contains(*key));
        let by_rule = reason == STOPPED_BY_RULE;
        let follows = |group: &Group| {
            let mut keys = group.trigger.iter().filter(|(trigger, _)| *trigger == id);
            let is_triggered = keys.any(|(_, keys)| {
                let mut keys = keys.iter();
                keys.any(|key| activity.values.contains(key))
            });
            let begins = match group.life {
                GroupLife::Scheduled | GroupLife::Fired => {
                    group.when == When::Now || is_open || is_triggered || by_rule
                }
                // It was cancelled, and its rule fired before the controller heard of it.
                GroupLife::Dead => by_rule,
                GroupLife::Reserve | GroupLife::Loading => false,
            };
            begins && group.predecessors().any(|other| other == id)
        };
        activity.outcome(reason, self.groups.values().any(follows))
    }
}

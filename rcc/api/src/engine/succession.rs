//! Which activities follow which: when a group is scheduled, and what ends with an activity that ended.

use std::collections::BTreeSet;

use super::Engine;
use super::activity::{Action, ActivityId, Group, GroupId, GroupLife, State, When};
use crate::error::Error;
use crate::outcome::Outcome;

impl Engine {
    /// Schedules each group whose nets and predecessors are ready.
    pub(super) fn bind_all(&mut self) {
        let groups: Vec<_> = self.groups.keys().copied().collect();
        for group in groups {
            self.bind(group);
        }
    }

    pub(super) fn bind(&mut self, id: GroupId) {
        let Some(group) = self
            .groups
            .get(&id)
            .filter(|group| group.life == GroupLife::Loading)
        else {
            return;
        };
        let nets = |ids: &[ActivityId]| -> Option<Vec<String>> {
            ids.iter()
                .map(|id| self.activities.get(id)?.net.clone())
                .collect()
        };
        let is_loaded = |id: &ActivityId| {
            self.activities
                .get(id)
                .is_some_and(|a| a.state == State::Loaded)
        };
        if !group.members.iter().all(is_loaded) {
            return;
        }
        if !group.ending.iter().all(|id| self.has_ended(*id)) {
            return;
        }
        let running = |id: &ActivityId| !self.has_ended(*id);
        let waited: Vec<_> = group.predecessors.iter().copied().filter(running).collect();
        let is_scheduled = |id: &ActivityId| {
            self.activities
                .get(id)
                .is_some_and(|a| matches!(a.state, State::Waiting | State::Running))
        };
        if !waited.iter().all(is_scheduled) {
            return;
        }
        let (Some(start), Some(stop)) = (nets(&group.members), nets(&waited)) else {
            return;
        };
        let condition = match group.when {
            When::Now => "t".to_owned(),
            When::Follow => self.condition(&waited),
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

    /// True when each of the activities has a result that a successor may follow.
    pub(super) fn condition(&self, activities: &[ActivityId]) -> String {
        let of = |id: &ActivityId| {
            let activity = self.activities.get(id)?;
            let net = activity.net.as_ref()?;
            let results: Vec<_> = activity
                .results
                .iter()
                .map(|key| format!("{net}.out{key}"))
                .collect();
            Some(format!("({})", results.join("|")))
        };
        let conditions: Vec<_> = activities.iter().filter_map(of).collect();
        if conditions.is_empty() {
            "t".to_owned()
        } else {
            conditions.join("&")
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
    pub(super) fn end(&mut self, id: ActivityId, outcome: Result<Outcome, Error>) {
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
        let of = |group: &Group| group.may_begin() && group.predecessors.contains(&id);
        let followers = self.groups.iter().filter(|(_, group)| of(group));
        let followers: Vec<_> = followers.map(|(id, _)| *id).collect();
        for follower in followers {
            let is_now = self
                .groups
                .get(&follower)
                .is_some_and(|group| group.when == When::Now);
            match &outcome {
                // It replaces what was there, however that ended.
                _ if is_now => self.bind(follower),
                Ok(Outcome::Completed | Outcome::Stopped(_) | Outcome::TakenOver) => {
                    self.bind(follower);
                }
                Ok(Outcome::Cancelled) => self.kill(follower, &Ok(Outcome::Cancelled)),
                Err(error @ Error::PredecessorFailed(_)) => {
                    self.kill(follower, &Err(error.clone()));
                }
                Err(error) => {
                    let error = Error::PredecessorFailed(Box::new(error.clone()));
                    self.kill(follower, &Err(error));
                }
            }
        }
        self.bind_all();
        self.tidy();
    }

    pub(super) fn members(&self, id: GroupId) -> Vec<ActivityId> {
        let group = self.groups.get(&id);
        group.map(|group| group.members.clone()).unwrap_or_default()
    }

    /// Ends the activities of a group that has not begun. If its rule was requested, it may fire before the nets are
    /// unloaded: they end when the controller confirms it.
    pub(super) fn kill(&mut self, id: GroupId, outcome: &Result<Outcome, Error>) {
        let Some(group) = self.groups.get_mut(&id).filter(|group| group.may_begin()) else {
            return;
        };
        let is_scheduled = group.life == GroupLife::Scheduled;
        group.life = GroupLife::Dead;
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
            .flat_map(|group| group.predecessors.iter().copied())
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
    pub(super) fn outcome(&self, id: ActivityId, reason: &str) -> Result<Outcome, Error> {
        let Some(activity) = self.activities.get(&id) else {
            return Ok(Outcome::Cancelled);
        };
        let may_blend = activity.values.contains("blend");
        let follows = |group: &Group| {
            let begins = matches!(group.life, GroupLife::Scheduled | GroupLife::Fired);
            begins && group.predecessors.contains(&id) && (group.when == When::Now || may_blend)
        };
        activity.outcome(reason, self.groups.values().any(follows))
    }
}

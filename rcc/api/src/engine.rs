//! The activities of a program and their succession: no thread, socket or clock. The engine receives what the program
//! requests and what the controller reports, and returns what is to be requested from the controller.
//!
//! ```text
//!             begin            loaded            scheduled           rule fired
//!   program ---------> Loading -------> Loaded ------------> Waiting -----------> Running
//!                         |                |                    |                    | net terminated
//!                         +--- 1 ----------+-------- 2 ---------+                    v
//!                                          v                                       Ended(outcome)
//!                                        Ended(error, or cancelled)
//! ```
//!
//! 1: the net is rejected, or the activity is cancelled. 2: the rule is refused, a predecessor fails or is cancelled.
//!
//! Activities that begin together are a *group*: one rule starts all their nets in one cycle. The predecessors of a group
//! are the latest activities of its devices. The group follows when each of them has reached a result that permits it:
//! completed, stopped by a condition, or far enough to blend. It does not follow one that failed or was cancelled.

mod activity;
mod begin;
mod succession;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use crate::error::ErrorKind;
use crate::outcome::Outcome;
pub use activity::{Action, ActivityId, FITS, Failure, GroupId, Part, Start, State, Trigger, When};
use activity::{Activity, Group, GroupLife};

/// The activities of one program.
#[derive(Debug, Default)]
pub struct Engine {
    activities: BTreeMap<ActivityId, Activity>,
    groups: BTreeMap<GroupId, Group>,
    nets: BTreeMap<String, ActivityId>,
    rules: BTreeMap<String, GroupId>,
    next: u64,
    /// Why nothing more can be begun.
    lost: Option<ErrorKind>,
    actions: Vec<Action>,
    revision: u64,
}

impl Engine {
    fn number(&mut self) -> u64 {
        self.next += 1;
        self.next
    }

    /// What is to be requested next, in order. Requests of one activity must not overtake each other.
    pub fn take_actions(&mut self) -> Vec<Action> {
        std::mem::take(&mut self.actions)
    }

    /// What an activity does; `None` once it was released.
    pub fn state(&self, id: ActivityId) -> Option<&State> {
        self.activities.get(&id).map(|activity| &activity.state)
    }

    /// Whether an activity has begun: its net runs and fits where its arms are, or it has ended.
    pub fn has_begun(&self, id: ActivityId) -> bool {
        let activity = self.activities.get(&id);
        activity.is_none_or(|activity| match activity.state {
            State::Running => !activity.is_undecided,
            State::Ended(_) => true,
            State::Loading | State::Loaded | State::Waiting => false,
        })
    }

    /// Part of its path that an activity has completed, 0 to 1.
    pub fn progress(&self, id: ActivityId) -> f64 {
        self.activities
            .get(&id)
            .map_or(0.0, |activity| activity.progress)
    }

    /// The latest activity of a device that has not ended, and whose end was not requested before it began.
    pub fn latest(&self, device: &str) -> Option<ActivityId> {
        let mut newest = self.activities.iter().rev();
        let is_one = |activity: &Activity| {
            let goes_on = !matches!(activity.state, State::Ended(_)) && activity.pending.is_none();
            goes_on && activity.devices.iter().any(|mine| mine == device)
        };
        let found = newest.find(|(_, activity)| is_one(activity));
        found.map(|(id, _)| *id)
    }

    /// Whether a successor may take over from an activity that moves.
    pub fn may_blend(&self, id: ActivityId) -> bool {
        let activity = self.activities.get(&id);
        activity.is_some_and(|activity| activity.results.iter().any(|key| key == "blend"))
    }

    /// The devices of all activities that have not ended.
    pub fn busy(&self) -> BTreeSet<String> {
        let activities = self.activities.values();
        let going = activities.filter(|activity| !matches!(activity.state, State::Ended(_)));
        going
            .flat_map(|activity| activity.devices.iter().cloned())
            .collect()
    }

    /// The net of an activity was loaded, or rejected.
    pub fn loaded(&mut self, id: ActivityId, net: Result<String, ErrorKind>) {
        self.revision += 1;
        match (net, self.activities.get_mut(&id)) {
            (Ok(net), Some(activity)) if activity.state == State::Loading => {
                activity.net = Some(net.clone());
                activity.state = State::Loaded;
                self.nets.insert(net, id);
                self.bind_all();
            }
            // It was cancelled meanwhile.
            (Ok(net), _) => self.actions.push(Action::Unload(net)),
            (Err(error), Some(_)) => self.end(id, Err(error)),
            (Err(_), None) => {}
        }
    }

    /// The rule of a group was installed, or refused.
    pub fn scheduled(&mut self, id: GroupId, rule: Result<String, ErrorKind>) {
        self.revision += 1;
        match rule {
            Ok(rule) => {
                self.rules.insert(rule, id);
                self.bind_all();
            }
            Err(error) => {
                self.kill(id, &Err(error));
                // Without a rule they cannot have begun.
                for member in self.members(id) {
                    self.net_ended(member, "");
                }
            }
        }
    }

    /// A rule is in a new state.
    pub fn rule_state(&mut self, rule: &str, state: &str) {
        self.revision += 1;
        let Some(id) = self.rules.get(rule).copied() else {
            return;
        };
        match state {
            "FIRED" => {
                for member in self.members(id) {
                    if matches!(self.state(member), Some(State::Waiting)) {
                        self.net_runs(member);
                    }
                }
            }
            "FIREFAILED" => return self.rule_failed(rule, None),
            "INACTIVE" => {
                self.rules.remove(rule);
                return self.rule_inactive(id);
            }
            _ => return,
        }
        self.rules.remove(rule);
        self.tidy();
    }

    /// A rule could not start its nets, with the cause if it is known; else another net commands the device.
    pub fn rule_failed(&mut self, rule: &str, cause: Option<ErrorKind>) {
        self.revision += 1;
        let Some(id) = self.rules.remove(rule) else {
            return;
        };
        let first = self.members(id).first().copied();
        let device = first.and_then(|id| self.activities.get(&id));
        let device = device.map(Activity::name).unwrap_or_default();
        let cause = cause.unwrap_or(ErrorKind::Conflict {
            device,
            joint: None,
            holder: None,
        });
        self.kill(id, &Err(cause));
        self.tidy();
    }

    /// The nets that a rule is to start.
    pub fn nets_of_rule(&self, rule: &str) -> Vec<String> {
        let group = self.rules.get(rule).copied();
        let members = group.map(|id| self.members(id)).unwrap_or_default();
        self.loaded_nets(&members)
    }

    /// Whether a net has ended, or is about to, since another one commands its device.
    pub fn is_in_conflict(&self, net: &str) -> bool {
        let activity = self.nets.get(net).and_then(|id| self.activities.get(id));
        activity.is_some_and(|activity| {
            let mut failures = activity.failures.iter();
            failures.any(|failure| failure.is_conflict() && activity.values.contains(&failure.key))
        })
    }

    /// The conflict in which a net ended, with what the controller knows of it.
    pub fn name_conflict(&mut self, net: &str, cause: Option<ErrorKind>) {
        let Some(cause @ ErrorKind::Conflict { .. }) = cause else {
            return;
        };
        let activity = self
            .nets
            .get(net)
            .and_then(|id| self.activities.get_mut(id));
        let failures = activity
            .into_iter()
            .flat_map(|activity| &mut activity.failures);
        failures
            .filter(|failure| failure.is_conflict())
            .for_each(|failure| failure.error = cause.clone());
    }

    /// A result or figure of a net has a new value.
    pub fn value(&mut self, net: &str, key: &str, text: &str) {
        self.revision += 1;
        let Some(activity) = self
            .nets
            .get(net)
            .and_then(|id| self.activities.get_mut(id))
        else {
            return;
        };
        match (key, text) {
            ("progress", number) => activity.progress = number.parse().unwrap_or(activity.progress),
            ("joint", number) => {
                activity.deviated.0 = number.parse().unwrap_or(activity.deviated.0);
            }
            ("deviation", number) => {
                activity.deviated.1 = number.parse().unwrap_or(activity.deviated.1);
            }
            (key, "true") => {
                activity.has_maintained |= key == "maintaining";
                activity.is_undecided &= key != FITS;
                activity.values.insert(key.to_owned());
            }
            (key, _) => drop(activity.values.remove(key)),
        }
    }

    /// A net is in a new state; `reason` is why it ended, if not by itself.
    pub fn net_state(&mut self, net: &str, state: &str, reason: &str) {
        self.revision += 1;
        let Some(id) = self.nets.get(net).copied() else {
            return;
        };
        match state {
            "RUNNING" => self.net_runs(id),
            "TERMINATED" => self.net_ended(id, reason),
            "UNLOADED" | "INVALID" => {
                self.net_ended(id, "another client unloaded its net");
                self.nets.remove(net);
                if let Some(activity) = self.activities.get_mut(&id) {
                    activity.net = None;
                }
                self.tidy();
            }
            _ => {}
        }
    }

    /// A net runs; if its end was requested just before, it is cancelled.
    fn net_runs(&mut self, id: ActivityId) {
        let Some(activity) = self.activities.get_mut(&id) else {
            return;
        };
        let has_ended = matches!(activity.state, State::Ended(_));
        let is_unwanted = activity.pending.take().is_some() || has_ended;
        activity.is_unloading = false;
        if !has_ended {
            activity.state = State::Running;
        }
        if let Some(net) = activity.net.clone().filter(|_| is_unwanted) {
            self.actions.push(Action::Cancel(net));
        }
        let id = activity.group;
        if let Some(group) = self.groups.get_mut(&id) {
            group.life = GroupLife::Fired;
        }
        self.skip_reserves(id);
    }

    fn net_ended(&mut self, id: ActivityId, reason: &str) {
        if self.has_ended(id) {
            return;
        }
        let activity = self.activities.get_mut(&id);
        let pending = activity.and_then(|activity| activity.pending.take());
        let outcome = pending.unwrap_or_else(|| self.outcome(id, reason));
        self.end(id, outcome);
    }

    /// Whether an activity has ended, also one that was released since.
    pub fn has_ended(&self, id: ActivityId) -> bool {
        let state = self.state(id);
        state.is_none_or(|state| matches!(state, State::Ended(_)))
    }

    /// Requests that an activity end. One that has not begun ends at once, with those that begin together with it or
    /// after it.
    pub fn cancel(&mut self, id: ActivityId) {
        self.revision += 1;
        let Some(activity) = self.activities.get(&id) else {
            return;
        };
        match (&activity.state, &activity.net) {
            (State::Running, Some(net)) => self.actions.push(Action::Cancel(net.clone())),
            (State::Loading | State::Loaded | State::Waiting, _) => {
                let group = activity.group;
                self.kill(group, &Ok(Outcome::Cancelled));
            }
            (State::Running | State::Ended(_), _) => {}
        }
    }

    /// Cancels what a device does, and everything that waits for it.
    pub fn cancel_device(&mut self, device: &str) {
        let mine = |(id, activity): (&ActivityId, &Activity)| {
            let commands = activity.devices.iter().any(|mine| mine == device);
            let is_mine = commands && !matches!(activity.state, State::Ended(_));
            is_mine.then_some(*id)
        };
        let mine: Vec<_> = self.activities.iter().filter_map(mine).collect();
        // The latest first, so that none of them begins when the one before it ends.
        for id in mine.into_iter().rev() {
            self.cancel(id);
        }
    }

    /// Cancels all activities; returns those that had not ended.
    pub fn cancel_all(&mut self) -> Vec<ActivityId> {
        let going = |(id, activity): (&ActivityId, &Activity)| {
            (!matches!(activity.state, State::Ended(_))).then_some(*id)
        };
        let going: Vec<_> = self.activities.iter().filter_map(going).collect();
        // The latest first, so that none of them begins when the one before it ends.
        going.iter().rev().for_each(|id| self.cancel(*id));
        going
    }

    /// Whether an activity has reached its goal and keeps it up.
    pub fn is_maintaining(&self, id: ActivityId) -> bool {
        let activity = self.activities.get(&id);
        activity.is_some_and(|activity| {
            activity.state == State::Running && activity.values.contains("maintaining")
        })
    }

    /// Names of the nets that are loaded.
    pub fn nets(&self) -> Vec<String> {
        self.nets.keys().cloned().collect()
    }

    /// Names of the nets of activities, as far as they are loaded.
    pub fn loaded_nets(&self, ids: &[ActivityId]) -> Vec<String> {
        let nets = self.nets.iter();
        let nets = nets.filter(|(_, id)| ids.contains(id));
        nets.map(|(net, _)| net.clone()).collect()
    }

    /// Why nothing more can be begun, if the connection ended.
    pub fn lost(&self) -> Option<ErrorKind> {
        self.lost.clone()
    }

    /// Counts what was handled: unequal if something may have changed.
    pub const fn revision(&self) -> u64 {
        self.revision
    }

    /// The connection ended: nothing is known about the nets any more, except that the controller cancels them.
    pub fn lose(&mut self, error: &ErrorKind) {
        self.revision += 1;
        self.lost = Some(error.clone());
        for activity in self.activities.values_mut() {
            if !matches!(activity.state, State::Ended(_)) {
                activity.state = State::Ended(Err(error.clone()));
            }
            activity.net = None;
        }
        self.nets.clear();
        for group in self.groups.values_mut().filter(|group| group.may_begin()) {
            group.life = GroupLife::Dead;
        }
        self.actions.clear();
    }

    /// The program no longer refers to an activity. It goes on.
    pub fn release(&mut self, id: ActivityId) {
        self.revision += 1;
        if let Some(activity) = self.activities.get_mut(&id) {
            activity.is_held = false;
        }
        self.tidy();
    }
}

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

use std::collections::{BTreeMap, BTreeSet};

use crate::error::Error;
use crate::outcome::Outcome;

#[cfg(test)]
mod tests;

/// Number of an activity, unique for its engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ActivityId(u64);

/// Number of a group of activities that begin together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct GroupId(u64);

/// An activity to be begun.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Start {
    /// The device that it commands.
    pub device: String,
    /// Text of its net.
    pub net: String,
    /// Keys of the results after which a successor may begin.
    pub results: Vec<String>,
}

/// When a group begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    /// After what its devices do, or where that permits blending.
    Follow,
    /// In the next cycle, in place of what its devices do.
    Now,
}

/// What is to be requested from the controller.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Load the net and subscribe to it; report by [`Engine::loaded`].
    Load {
        /// Its activity.
        activity: ActivityId,
        /// Text of the net.
        net: String,
    },
    /// Install a rule and subscribe to it; report by [`Engine::scheduled`].
    Schedule {
        /// Its group.
        group: GroupId,
        /// When it fires.
        condition: String,
        /// Nets that it stops.
        stop: Vec<String>,
        /// Nets that it starts.
        start: Vec<String>,
    },
    /// Request that a net end.
    Cancel(String),
    /// Remove a net that does not run.
    Unload(String),
}

/// What an activity does.
#[derive(Clone, Debug, PartialEq)]
pub enum State {
    /// Its net is being loaded.
    Loading,
    /// Its net is loaded; predecessors or other activities of its group are not yet.
    Loaded,
    /// It waits for its predecessors.
    Waiting,
    /// Its net runs.
    Running,
    /// It has ended.
    Ended(Result<Outcome, Error>),
}

#[derive(Debug)]
struct Activity {
    device: String,
    group: GroupId,
    results: Vec<String>,
    net: Option<String>,
    state: State,
    /// Keys of the results that are true.
    values: BTreeSet<String>,
    /// Part of the path, 0 to 1.
    progress: f64,
    /// Whether a program still refers to it.
    is_held: bool,
    /// How it ends if its net is unloaded before it runs: its end was requested after its rule.
    pending: Option<Result<Outcome, Error>>,
    /// Whether the unloading of its net was requested.
    is_unloading: bool,
}

#[derive(Debug)]
struct Group {
    members: Vec<ActivityId>,
    predecessors: Vec<ActivityId>,
    /// Activities of its devices whose end was requested and is not confirmed.
    ending: Vec<ActivityId>,
    when: When,
    life: GroupLife,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum GroupLife {
    /// Nets are being loaded.
    Loading,
    /// The rule is requested or installed.
    Scheduled,
    /// The rule fired.
    Fired,
    /// It will not begin any more.
    Dead,
}

/// The activities of one program.
#[derive(Debug, Default)]
pub struct Engine {
    activities: BTreeMap<ActivityId, Activity>,
    groups: BTreeMap<GroupId, Group>,
    nets: BTreeMap<String, ActivityId>,
    rules: BTreeMap<String, GroupId>,
    next: u64,
    /// Why nothing more can be begun.
    lost: Option<Error>,
    actions: Vec<Action>,
    revision: u64,
}

impl Engine {
    /// Begins activities together.
    ///
    /// # Errors
    /// If two of them have the same device, there is none, or the connection is lost.
    pub fn begin(&mut self, starts: Vec<Start>, when: When) -> Result<Vec<ActivityId>, Error> {
        self.revision += 1;
        if let Some(lost) = &self.lost {
            return Err(lost.clone());
        }
        let devices: BTreeSet<_> = starts.iter().map(|start| &start.device).collect();
        if starts.is_empty() || devices.len() < starts.len() {
            let text =
                "activities that begin together have different devices, and there is at least one";
            return Err(Error::Invalid(text.to_owned()));
        }
        let group = GroupId(self.number());
        let predecessors: Vec<_> = match when {
            When::Follow => {
                let latest = devices.iter().filter_map(|device| self.latest(device));
                latest.collect::<BTreeSet<_>>().into_iter().collect()
            }
            // Also those that wait: they are replaced as well.
            When::Now => {
                let replaced = |(id, activity): (&ActivityId, &Activity)| {
                    let is_one = devices.contains(&activity.device) && !self.has_ended(*id);
                    is_one.then_some(*id)
                };
                self.activities.iter().filter_map(replaced).collect()
            }
        };
        let ending = |(id, activity): (&ActivityId, &Activity)| {
            let is_one = activity.pending.is_some() && devices.contains(&activity.device);
            (is_one && !self.has_ended(*id)).then_some(*id)
        };
        let ending = match when {
            When::Follow => self.activities.iter().filter_map(ending).collect(),
            When::Now => Vec::new(),
        };
        let members = starts
            .into_iter()
            .map(|start| self.add(group, start))
            .collect::<Vec<_>>();
        let known = Group {
            members: members.clone(),
            predecessors,
            ending,
            when,
            life: GroupLife::Loading,
        };
        self.groups.insert(group, known);
        Ok(members)
    }

    fn add(&mut self, group: GroupId, start: Start) -> ActivityId {
        let id = ActivityId(self.number());
        self.actions.push(Action::Load {
            activity: id,
            net: start.net,
        });
        let activity = Activity {
            device: start.device,
            group,
            results: start.results,
            net: None,
            state: State::Loading,
            values: BTreeSet::new(),
            progress: 0.0,
            is_held: true,
            pending: None,
            is_unloading: false,
        };
        self.activities.insert(id, activity);
        id
    }

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
            goes_on && activity.device == device
        };
        let found = newest.find(|(_, activity)| is_one(activity));
        found.map(|(id, _)| *id)
    }

    /// The net of an activity was loaded, or rejected.
    pub fn loaded(&mut self, id: ActivityId, net: Result<String, Error>) {
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

    /// Schedules each group whose nets and predecessors are ready.
    fn bind_all(&mut self) {
        let groups: Vec<_> = self.groups.keys().copied().collect();
        for group in groups {
            self.bind(group);
        }
    }

    fn bind(&mut self, id: GroupId) {
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
    fn condition(&self, activities: &[ActivityId]) -> String {
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

    fn enter(&mut self, id: GroupId, life: GroupLife, state: State) {
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

    /// The rule of a group was installed, or refused.
    pub fn scheduled(&mut self, id: GroupId, rule: Result<String, Error>) {
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
            "FIREFAILED" => {
                let first = self.members(id).first().copied();
                let device = first.and_then(|id| self.activities.get(&id));
                let device = device.map(|activity| activity.device.clone());
                let device = device.unwrap_or_default();
                self.kill(id, &Err(Error::Conflict { device }));
            }
            _ => return,
        }
        self.rules.remove(rule);
        self.tidy();
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
            (key, "true") => drop(activity.values.insert(key.to_owned())),
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
        if let Some(group) = self.groups.get_mut(&activity.group) {
            group.life = GroupLife::Fired;
        }
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

    /// How an activity ended, by the results of its net.
    fn outcome(&self, id: ActivityId, reason: &str) -> Result<Outcome, Error> {
        let Some(activity) = self.activities.get(&id) else {
            return Ok(Outcome::Cancelled);
        };
        let device = || activity.device.clone();
        let is = |key: &str| activity.values.contains(key);
        if is("unreachable") {
            let progress = activity.progress * 100.0;
            return Err(Error::Unreachable {
                device: device(),
                progress,
            });
        }
        if is("concurrent") {
            return Err(Error::Conflict { device: device() });
        }
        for (key, cause) in FAILURES {
            if is(key) {
                let cause = if reason.is_empty() {
                    (*cause).to_owned()
                } else {
                    format!("{cause}: {reason}")
                };
                return Err(Error::DeviceFailed {
                    device: device(),
                    cause,
                });
            }
        }
        if let Some(name) = activity
            .values
            .iter()
            .find_map(|key| key.strip_prefix("until_"))
        {
            return Ok(Outcome::Stopped(name.to_owned()));
        }
        if is("completed") {
            return Ok(Outcome::Completed);
        }
        if is("cancelled") {
            return Ok(Outcome::Cancelled);
        }
        let follows = |group: &Group| {
            let begins = matches!(group.life, GroupLife::Scheduled | GroupLife::Fired);
            begins && group.predecessors.contains(&id) && (group.when == When::Now || is("blend"))
        };
        if self.groups.values().any(follows) {
            return Ok(Outcome::TakenOver);
        }
        let reason = if reason.is_empty() {
            "the controller gives none"
        } else {
            reason
        };
        Err(Error::Ended {
            device: device(),
            reason: reason.to_owned(),
        })
    }

    fn has_ended(&self, id: ActivityId) -> bool {
        let state = self.state(id);
        state.is_none_or(|state| matches!(state, State::Ended(_)))
    }

    /// Ends an activity, and those that can no longer follow it.
    fn end(&mut self, id: ActivityId, outcome: Result<Outcome, Error>) {
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

    fn members(&self, id: GroupId) -> Vec<ActivityId> {
        let group = self.groups.get(&id);
        group.map(|group| group.members.clone()).unwrap_or_default()
    }

    /// Ends the activities of a group that has not begun. If its rule was requested, it may fire before the nets are
    /// unloaded: they end when the controller confirms it.
    fn kill(&mut self, id: GroupId, outcome: &Result<Outcome, Error>) {
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
            let is_mine = activity.device == device && !matches!(activity.state, State::Ended(_));
            is_mine.then_some(*id)
        };
        let mine: Vec<_> = self.activities.iter().filter_map(mine).collect();
        // The latest first, so that none of them begins when the one before it ends.
        for id in mine.into_iter().rev() {
            self.cancel(id);
        }
    }

    /// Why nothing more can be begun, if the connection ended.
    pub fn lost(&self) -> Option<Error> {
        self.lost.clone()
    }

    /// Counts what was handled: unequal if something may have changed.
    pub const fn revision(&self) -> u64 {
        self.revision
    }

    /// The connection ended: nothing is known about the nets any more, except that the controller cancels them.
    pub fn lose(&mut self, error: &Error) {
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

    /// Unloads nets that no rule refers to any more, and forgets what is referred to no more.
    fn tidy(&mut self) {
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
}

impl Group {
    /// Whether its rule has neither fired nor died.
    fn may_begin(&self) -> bool {
        matches!(self.life, GroupLife::Loading | GroupLife::Scheduled)
    }
}

/// Results that make a motion fail, with the cause that they stand for.
const FAILURES: &[(&str, &str)] = &[
    ("failed", "a joint does not follow its commands"),
    ("illegal", "a joint would leave its range"),
];

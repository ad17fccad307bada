//! What a program begins in one call: parts that follow each other, start by each other's results, or stand in for each
//! other. All of them are loaded and scheduled before the first one begins.

use std::collections::BTreeSet;

use super::Engine;
use super::activity::{
    Action, Activity, ActivityId, Group, GroupId, GroupLife, Part, Start, State, When,
};
use crate::error::ErrorKind;

impl Engine {
    /// Begins activities together.
    ///
    /// # Errors
    /// If two of them have the same device, there is none, or the connection is lost.
    pub fn begin(&mut self, starts: Vec<Start>, when: When) -> Result<Vec<ActivityId>, ErrorKind> {
        let begun = self.begin_all(vec![Part::new(starts, when)])?;
        Ok(begun.into_iter().flatten().collect())
    }

    /// Begins parts in their order; returns the activities of each.
    ///
    /// # Errors
    /// If two activities of a part have the same device, a part has none, a part refers to one that is not before it, or
    /// the connection is lost. Nothing was begun then.
    pub fn begin_all(&mut self, parts: Vec<Part>) -> Result<Vec<Vec<ActivityId>>, ErrorKind> {
        self.revision += 1;
        if let Some(lost) = &self.lost {
            return Err(lost.clone());
        }
        check(&parts)?;
        // The number of the first group.
        let call = self.next + 1;
        let mut groups: Vec<(GroupId, Vec<ActivityId>)> = Vec::new();
        for part in parts {
            let begun = self.begin_part(part, call, &groups);
            groups.push(begun);
        }
        // Nets that were loaded beforehand are ready.
        self.bind_all();
        Ok(groups.into_iter().map(|(_, members)| members).collect())
    }

    fn begin_part(
        &mut self,
        part: Part,
        call: u64,
        before: &[(GroupId, Vec<ActivityId>)],
    ) -> (GroupId, Vec<ActivityId>) {
        let group = GroupId(self.number());
        let devices: BTreeSet<_> = part.starts.iter().flat_map(|s| s.devices.clone()).collect();
        let instead_of = part
            .instead_of
            .and_then(|number| before.get(number).map(|(id, _)| *id));
        let mut slots = self.slots(part.when, &devices, instead_of);
        let required = required(&part.after, before);
        slots.extend(required.iter().cloned());
        let trigger = part.trigger.and_then(|trigger| {
            let first = before
                .get(trigger.part)
                .and_then(|(_, members)| members.first())?;
            Some((*first, trigger.keys))
        });
        let branch = self.branch(&required, trigger.as_ref(), instead_of);
        self.leave_out(&mut slots, &branch);
        let is_reserve = instead_of.is_some();
        let ending = match part.when {
            When::Follow => self.ending(&devices),
            When::Now => Vec::new(),
        };
        let mut reserve = Vec::new();
        let mut members = Vec::new();
        for start in part.starts {
            if is_reserve {
                reserve.push(start.net.clone());
            }
            members.push(self.add(group, start, is_reserve));
        }
        let known = Group {
            members: members.clone(),
            slots,
            trigger,
            required,
            branch,
            after_failure: part.after_failure,
            instead_of,
            call,
            reserve,
            ending,
            when: part.when,
            life: if is_reserve {
                GroupLife::Reserve
            } else {
                GroupLife::Loading
            },
        };
        self.groups.insert(group, known);
        (group, members)
    }

    /// What a part of these devices follows or replaces without being named by the program.
    fn slots(
        &self,
        when: When,
        devices: &BTreeSet<String>,
        instead_of: Option<GroupId>,
    ) -> Vec<Vec<ActivityId>> {
        let other = instead_of.and_then(|id| self.groups.get(&id));
        // It follows the same as the one that it stands in for, but not that one.
        let mut slots = other.map(|other| other.slots.clone()).unwrap_or_default();
        match when {
            When::Now if other.is_none() => slots.push(self.replaced(devices)),
            When::Now => {}
            When::Follow => {
                let own = other.map(|other| other.members.as_slice());
                let own = own.unwrap_or_default();
                let mut latest: Vec<_> = devices.iter().map(|d| self.latest_of(d)).collect();
                for slot in &mut latest {
                    slot.retain(|id| !own.contains(id));
                }
                slots.extend(latest);
            }
        }
        slots
    }

    /// Leaves out what does not begin if the branch does, and what is repeated.
    fn leave_out(&self, slots: &mut Vec<Vec<ActivityId>>, branch: &[(ActivityId, Vec<String>)]) {
        for slot in &mut *slots {
            slot.retain(|id| {
                let activity = self.activities.get(id);
                let group = activity.and_then(|activity| self.groups.get(&activity.group));
                group.is_none_or(|group| !group.excludes(branch))
            });
        }
        let mut known = BTreeSet::new();
        slots.retain(|slot| !slot.is_empty() && known.insert(slot.clone()));
    }

    /// Results without which a group does not begin.
    fn branch(
        &self,
        required: &[Vec<ActivityId>],
        trigger: Option<&(ActivityId, Vec<String>)>,
        instead_of: Option<GroupId>,
    ) -> Vec<(ActivityId, Vec<String>)> {
        let of_group = |id: &ActivityId| {
            let activity = self.activities.get(id);
            let group = activity.and_then(|activity| self.groups.get(&activity.group));
            group.map(|group| group.branch.clone()).unwrap_or_default()
        };
        let single = required.iter().filter_map(|slot| match slot.as_slice() {
            [id] => Some(id),
            _ => None,
        });
        let before = single.chain(trigger.map(|(id, _)| id)).flat_map(of_group);
        let other = instead_of.and_then(|id| self.groups.get(&id));
        let other = other.into_iter().flat_map(|group| group.branch.clone());
        before.chain(other).chain(trigger.cloned()).collect()
    }

    /// What is replaced at once: also what waits.
    fn replaced(&self, devices: &BTreeSet<String>) -> Vec<ActivityId> {
        let replaced = |(id, activity): (&ActivityId, &Activity)| {
            (activity.commands(devices) && !self.has_ended(*id)).then_some(*id)
        };
        self.activities.iter().filter_map(replaced).collect()
    }

    /// Activities of these devices whose end was requested and is not confirmed.
    fn ending(&self, devices: &BTreeSet<String>) -> Vec<ActivityId> {
        let ending = |(id, activity): (&ActivityId, &Activity)| {
            let is_one = activity.pending.is_some() && activity.commands(devices);
            (is_one && !self.has_ended(*id)).then_some(*id)
        };
        self.activities.iter().filter_map(ending).collect()
    }

    fn add(&mut self, group: GroupId, start: Start, is_reserve: bool) -> ActivityId {
        let id = ActivityId(self.number());
        let state = match &start.loaded {
            Some(net) => {
                self.nets.insert(net.clone(), id);
                State::Loaded
            }
            None => State::Loading,
        };
        if !is_reserve && start.loaded.is_none() {
            self.actions.push(Action::Load {
                activity: id,
                net: start.net,
            });
        }
        let activity = Activity {
            devices: start.devices,
            group,
            results: start.results,
            failures: start.failures,
            net: start.loaded,
            state,
            values: BTreeSet::new(),
            progress: 0.0,
            deviated: (0, 0.0),
            is_held: true,
            pending: None,
            is_unloading: false,
            has_maintained: false,
            is_undecided: start.is_guarded,
        };
        self.activities.insert(id, activity);
        id
    }

    /// Loads the nets of a group that stands in for another one.
    pub(super) fn activate(&mut self, id: GroupId) {
        let Some(group) = self.groups.get_mut(&id) else {
            return;
        };
        group.life = GroupLife::Loading;
        let nets = std::mem::take(&mut group.reserve);
        let loads = group.members.iter().copied().zip(nets);
        self.actions
            .extend(loads.map(|(activity, net)| Action::Load { activity, net }));
    }

    /// The latest activities of a device: the newest one and, if that one begins only by a result or stands in for
    /// another one, those that run if it does not.
    fn latest_of(&self, device: &str) -> Vec<ActivityId> {
        let mut slot = Vec::new();
        for (id, activity) in self.activities.iter().rev() {
            let goes_on = !matches!(activity.state, State::Ended(_)) && activity.pending.is_none();
            if !goes_on || !activity.devices.iter().any(|mine| mine == device) {
                continue;
            }
            slot.push(*id);
            let group = self.groups.get(&activity.group);
            if group.is_none_or(Group::is_sure) {
                break;
            }
        }
        slot.sort_unstable();
        slot
    }
}

/// The slots that a part names.
fn required(after: &[Vec<usize>], before: &[(GroupId, Vec<ActivityId>)]) -> Vec<Vec<ActivityId>> {
    let members_of = |part: &usize| before.get(*part).map(|(_, members)| members.clone());
    let slots = |parts: &Vec<usize>| -> Vec<Vec<ActivityId>> {
        let alternatives: Vec<_> = parts.iter().filter_map(members_of).collect();
        match alternatives.as_slice() {
            // Each activity of the part is waited for.
            [members] => members.iter().map(|id| vec![*id]).collect(),
            _ => vec![alternatives.into_iter().flatten().collect()],
        }
    };
    after.iter().flat_map(slots).collect()
}

fn check(parts: &[Part]) -> Result<(), ErrorKind> {
    let invalid = |text: &str| Err(ErrorKind::Invalid(text.to_owned()));
    if parts.is_empty() {
        return invalid("there is no activity to begin");
    }
    for (number, part) in parts.iter().enumerate() {
        let count: usize = part.starts.iter().map(|start| start.devices.len()).sum();
        let devices: BTreeSet<_> = part.starts.iter().flat_map(|s| &s.devices).collect();
        if part.starts.is_empty() || devices.len() < count {
            return invalid(
                "activities that begin together have different devices, and there is at least one",
            );
        }
        let trigger = part.trigger.iter().map(|trigger| trigger.part);
        let after = part.after.iter().flatten().copied();
        let mut referred = after.chain(trigger).chain(part.instead_of);
        if referred.any(|other| other >= number) {
            return invalid("a part refers to one that is not before it");
        }
    }
    Ok(())
}

//! A net in the thread that evaluates it, with its endpoints of values and counters. The executor decides when
//! it is evaluated and when it ends.

use std::sync::Arc;

use takt_net::{Image, Moment, Plan};
use takt_rt::Nanos;
use takt_rt::latest::{LatestReader, LatestWriter};

use super::figures::{self, NetCounters, RUNAWAY_AFTER};
use super::life::{Cancel, Change, End, Life, StartReport};
use super::links;
use super::machines::Seat;
use super::resources::ResourceSet;
use super::view::DeviceView;
use crate::device::Place;
use crate::ids::NetState;
use crate::stop_channel::Generation;

/// A net in the thread that evaluates it.
#[derive(Debug)]
pub struct Running {
    /// Its number.
    pub id: u32,
    /// The net.
    pub plan: Plan,
    /// Resources that it needs.
    pub resources: ResourceSet,
    /// Devices it commands, with the faults they had when it started; until then, with their epoch when it was scheduled.
    pub devices: Vec<(usize, u64)>,
    /// The cycle in which it was found that a device had failed.
    failed_in: Option<u64>,
    /// Its period in cycles of its thread.
    every: u64,
    /// Cost bound of one of its cycles, as declared by its primitives.
    pub cost: Nanos,
    /// Stop generation under which its start was requested.
    pub requested: Generation,
    /// Whether a successor waits for it.
    pub(super) takeover: bool,
    pub(super) life: Life,
    pub(super) cancel: Cancel,
    /// Whether its start by a rule was reported.
    pub(super) start_report: StartReport,
    /// The group of `every` cycles in which it was last checked.
    last_group: Option<u64>,
    pub(super) counters: Arc<NetCounters>,
    /// Period of its thread, and the budget of an evaluation.
    period: Nanos,
    budget: Nanos,
    /// Evaluations in a row that took longer than `period`.
    too_long: u32,
    out: LatestWriter<Box<[u64]>>,
    inbox: LatestReader<Box<[u64]>>,
    inbox_seen: u64,
    /// Its exchange with other nets and with tap recordings.
    pub links: links::Links,
    /// Its place in a machine, if it is a component.
    pub seat: Option<Box<Seat>>,
}

/// Whether a device, with the faults it had when a net started, has failed since.
fn has_failed((number, faults): &(usize, u64), views: &[DeviceView]) -> bool {
    views.get(*number).is_none_or(|view| view.faults != *faults)
}

impl Running {
    /// A net that was never evaluated.
    #[must_use]
    pub fn new(
        id: u32,
        plan: Plan,
        out: LatestWriter<Box<[u64]>>,
        inbox: LatestReader<Box<[u64]>>,
    ) -> Self {
        let period = plan.period();
        let (links, _) = links::links(&plan);
        let cost = plan.cost().total.into();
        Self {
            id,
            links,
            plan,
            counters: Arc::default(),
            period: period.into(),
            budget: figures::budget(period).into(),
            too_long: 0,
            resources: ResourceSet::default(),
            devices: Vec::new(),
            failed_in: None,
            every: 1,
            cost,
            requested: Generation::default(),
            takeover: false,
            life: Life::Running { evaluated: false },
            cancel: Cancel::None,
            start_report: StartReport::Sent,
            last_group: None,
            out,
            inbox,
            inbox_seen: 0,
            seat: None,
        }
    }

    /// Sets its period in cycles of its thread; the thread's own period limits the duration of each evaluation.
    pub fn set_every(&mut self, every: u64) {
        self.every = every.max(1);
        let thread = self.plan.period() / u32::try_from(self.every).unwrap_or(u32::MAX);
        (self.period, self.budget) = (thread.into(), figures::budget(thread).into());
    }

    /// Whether it is evaluated in this cycle: the first of each group of `every`, or the
    /// first that the thread did not miss.
    fn is_due(&mut self, cycle: u64) -> bool {
        let group = cycle / self.every;
        match self.last_group.replace(group) {
            None => cycle.is_multiple_of(self.every),
            Some(last) => last != group,
        }
    }

    /// Whether its start by a rule is to be sent now, once.
    pub(super) fn take_start_report(&mut self) -> bool {
        let is_due = self.start_report == StartReport::Recorded;
        if is_due {
            self.start_report = StartReport::Sent;
        }
        is_due
    }

    /// Changes its state.
    pub(super) const fn change(&mut self, change: Change) {
        self.life = self.life.after(change);
    }

    /// Whether it has not ended.
    pub(super) const fn is_going_on(&self) -> bool {
        self.life.end().is_none()
    }

    /// Requests it to cancel, as a rule does.
    pub(super) fn cancel_by_rule(&mut self) {
        if self.cancel == Cancel::None {
            self.cancel = Cancel::ByRule;
        }
    }

    /// Ends it if a device that it commands has failed, or, if it handles that, when its time for it is over or none of
    /// its devices follows commands.
    pub(super) fn check_devices(&mut self, views: &[DeviceView], cycle: u64) {
        let mut failed = self
            .devices
            .iter()
            .filter(|device| has_failed(device, views));
        let Some((number, _)) = failed.next() else {
            return;
        };
        let end = End::DeviceFault(*number);
        let all = failed.count() + 1 == self.devices.len();
        let since = *self.failed_in.get_or_insert(cycle);
        let thread = self.plan.period() / u32::try_from(self.every).unwrap_or(u32::MAX);
        let cycles = u32::try_from(cycle.saturating_sub(since)).unwrap_or(u32::MAX);
        let goes_on = self
            .plan
            .outlives_failure()
            .is_some_and(|time| thread.saturating_mul(cycles) < time);
        if all || !goes_on {
            self.change(Change::End(end));
        }
    }

    /// Withdraws what it commands to devices that have failed: a device that returns does not follow it.
    pub(super) fn withhold(&self, image: &Image, views: &[DeviceView], places: &[Place]) {
        if self.failed_in.is_none() {
            return;
        }
        let failed = self
            .devices
            .iter()
            .filter(|device| has_failed(device, views));
        for place in failed.filter_map(|(number, _)| places.get(*number)) {
            let joints = place.first_joint..place.first_joint + place.joints;
            image.withdraw_from(joints, place.commands.clone(), self.id);
        }
    }

    /// Evaluates it in this cycle, if it is due and has not ended. `clock` is read at its end.
    pub(super) fn cycle(
        &mut self,
        image: &Image,
        moment: Moment,
        before: &mut Nanos,
        clock: &mut impl FnMut() -> Nanos,
    ) {
        let succeeds = self.life == Life::Succeeding;
        let is_due = self.is_going_on() && self.is_due(moment.cycle);
        self.change(Change::Cycle { is_due });
        if !is_due {
            return;
        }
        let moment = Moment {
            every: self.every,
            cancel: self.cancel != Cancel::None,
            takeover: self.takeover,
            device_failed: self.failed_in.is_some(),
            net: self.id,
            ..moment
        };
        if self.plan.evaluate(image, moment) {
            self.change(Change::End(End::Terminated));
        }
        if succeeds {
            self.withdraw_not_taken_over(image, moment.cycle);
        }
        self.links.record(&self.plan, moment.time);
        let state = if moment.cancel {
            NetState::Cancelling
        } else {
            NetState::Running
        };
        self.links
            .sample(&self.plan, moment.cycle, self.every, state.number());
        let after = clock();
        self.account(after - *before);
        *before = after;
    }

    /// Ends commands of the nets that it follows, which it did not take over in its first evaluation.
    fn withdraw_not_taken_over(&self, image: &Image, cycle: u64) {
        for target in self.plan.commands() {
            image.withdraw_unused(*target, self.id, cycle);
        }
    }

    /// Its counters, which keep counting.
    #[must_use]
    pub const fn counters(&self) -> &Arc<NetCounters> {
        &self.counters
    }

    /// Counts an evaluation; too many overlong ones in a row end the net.
    fn account(&mut self, took: Nanos) {
        self.counters.evaluated(took, self.budget);
        self.too_long = if took > self.period {
            self.too_long + 1
        } else {
            0
        };
        if self.too_long >= RUNAWAY_AFTER {
            self.change(Change::End(End::Runaway));
        }
    }

    /// Applies values that programs and other nets wrote since the last cycle; returns whether there were
    /// any.
    pub fn receive(&mut self) -> bool {
        let given = self.links.receive(&self.plan);
        let version = self.inbox.version();
        if version == self.inbox_seen {
            return given;
        }
        self.inbox_seen = version;
        let (plan, links) = (&self.plan, &mut self.links);
        self.inbox.read_with(|words| links.import(plan, words));
        true
    }

    /// Publishes its out values if they changed; returns whether they did.
    pub(super) fn publish(&mut self) -> bool {
        let changed = self.plan.take_changed();
        if changed {
            let plan = &self.plan;
            self.out.write_with(|words| plan.export(words));
        }
        changed
    }
}

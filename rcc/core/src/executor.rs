//! Evaluates the running nets of one thread, cycle by cycle, with their starts, cancels, ends and resources. It
//! owns no thread and reads no clock, so that a recording replays through the very same code; the
//! live thread around it is in [`thread`], and what happens between nets in [`rules`].

pub mod figures;
pub mod links;
mod place;
mod resources;
pub mod rules;
pub mod serve;
pub mod stop;
pub mod thread;
mod withdraw;

use std::sync::Arc;

use std::ops::Range;

use takt_net::device::Layout;
use takt_net::{Image, Moment, Plan};
use takt_rt::Nanos;
use takt_rt::latest::{LatestReader, LatestWriter};

use crate::device::DeviceStatus;
use crate::stop_channel::Generation;
use figures::{NetCounters, RUNAWAY_AFTER};

pub use resources::ResourceSet;

/// Maximum number of running nets of one thread.
pub const RUNNING_MAX: usize = 256;
/// Slots of running nets: a net that ends keeps its slot until its successor has started.
const BUCKETS: usize = 2 * RUNNING_MAX;
/// Maximum number of devices of one thread.
pub const DEVICES_MAX: usize = 64;

/// The state of a device on which the life of nets depends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceView {
    /// Whether it follows commands.
    pub status: DeviceStatus,
    /// How often it stopped following commands.
    pub faults: u64,
    /// Number of position jumps while it followed: running nets continue, waiting ones do not start.
    pub jumps: u64,
}

impl DeviceView {
    /// Whether nets can command it.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.status == DeviceStatus::Operational
    }
}

/// Why a net ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// It signalled its termination.
    Terminated,
    /// It was aborted.
    Aborted,
    /// The whole controller was stopped.
    Halted,
    /// A synchronization rule stopped it.
    Stopped,
    /// Its evaluation took longer than a period of its thread, [`RUNAWAY_AFTER`] times in a row.
    Runaway,
    /// A device that it commands, by its number, stopped following commands.
    DeviceFault(usize),
}

/// Why a net could not be started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Another running net holds this resource.
    ResourceInUse(usize),
    /// This resource is kept for a scheduled net.
    ResourceKept(usize),
    /// This device does not follow commands.
    DeviceNotReady(usize),
    /// Together with the running nets it would exceed the thread's budget.
    Overload {
        /// Cost of the running nets.
        running: Nanos,
        /// The budget.
        budget: Nanos,
    },
    /// Too many nets run.
    TooMany,
    /// The controller is stopped, or was stopped after the request.
    Halted,
}

/// An event of a net in a cycle that was caused neither by the net nor by the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// It exceeded its time too often and ends with this cycle.
    RanAway,
    /// It ends with this cycle.
    Stopped,
    /// It receives a cancel from the next cycle on.
    Cancelled,
    /// It is evaluated from the next cycle on.
    Started,
}

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
    /// Its period in cycles of its thread.
    every: u64,
    /// Cost bound of one of its cycles, as declared by its primitives.
    pub cost: Nanos,
    /// Stop generation under which its start was requested.
    pub requested: Generation,
    /// Whether its cancel was requested.
    pub cancel: bool,
    /// Whether a successor waits for it.
    pub takeover: bool,
    /// Whether a rule started it in this cycle.
    fresh: bool,
    /// Whether a rule started it and the event was not sent yet.
    untold: bool,
    /// Whether a rule cancelled it and the event was not sent yet.
    fresh_cancel: bool,
    /// Whether it took over from another net and was not evaluated yet.
    succeeds: bool,
    /// The reason of its end after this cycle, if it ends.
    end: Option<End>,
    /// Whether its commands are withdrawn, or about to be.
    leaves: bool,
    /// Whether it was evaluated in this cycle.
    evaluated: bool,
    /// The group of `every` cycles in which it was last checked.
    last_group: Option<u64>,
    counters: Arc<NetCounters>,
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
            every: 1,
            cost,
            requested: Generation::default(),
            cancel: false,
            takeover: false,
            fresh: false,
            untold: false,
            fresh_cancel: false,
            succeeds: false,
            end: None,
            leaves: false,
            evaluated: false,
            last_group: None,
            out,
            inbox,
            inbox_seen: 0,
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

    /// Returns and clears whether its start by a rule was not sent yet.
    const fn take_untold(&mut self) -> bool {
        std::mem::replace(&mut self.untold, false)
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
            self.end = self.end.or(Some(End::Runaway));
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
    fn publish(&mut self) -> bool {
        let changed = self.plan.take_changed();
        if changed {
            let plan = &self.plan;
            self.out.write_with(|words| plan.export(words));
        }
        changed
    }
}

/// The running nets of one thread and the devices they see.
#[expect(
    clippy::vec_box,
    reason = "nets move in and out as boxes; a cycle neither allocates nor frees any"
)]
#[derive(Debug)]
pub struct Executor {
    /// Image of the devices as nets see them.
    pub image: Image,
    /// Device states on which the life of nets depends.
    pub devices: Vec<DeviceView>,
    running: Vec<Box<Running>>,
    rules: rules::Rules,
    /// Epoch of each device: advances with faults, jumps, and each enable.
    epochs: Vec<u64>,
    /// Whether an epoch changed since scheduled nets were checked.
    epochs_changed: bool,
    /// Budget of the running nets per cycle, by declared cost.
    budget: Nanos,
    /// Joints of the image in use.
    joints: usize,
    /// Words of the image in use.
    used: Layout,
    /// Commands of devices that came into use before this cycle, to be recorded.
    fresh: Vec<Range<usize>>,
    leaving: withdraw::Leaving,
}

impl Default for Executor {
    fn default() -> Self {
        Self {
            image: Image::default(),
            devices: Vec::with_capacity(DEVICES_MAX),
            running: Vec::with_capacity(BUCKETS),
            rules: rules::Rules::new(),
            epochs: vec![0; DEVICES_MAX],
            epochs_changed: false,
            budget: Nanos::MAX,
            joints: 0,
            used: Layout::default(),
            fresh: Vec::with_capacity(DEVICES_MAX),
            leaving: withdraw::Leaving::default(),
        }
    }
}

impl Executor {
    /// An executor with this budget per cycle, by declared cost; [`Self::default`] has
    /// no limit.
    #[must_use]
    pub fn within(budget: Nanos) -> Self {
        Self {
            budget,
            ..Self::default()
        }
    }

    /// Work of the rules per cycle, at most [`rules::WORK_MAX`].
    #[must_use]
    pub const fn rule_work(&self) -> usize {
        self.rules.work()
    }

    /// Starts a net. It is evaluated from the next [`Self::cycle`] on.
    ///
    /// # Errors
    /// If it cannot run now; the net comes back with the reason.
    pub fn start(&mut self, mut net: Box<Running>) -> Result<(), (Box<Running>, Refusal)> {
        if !self.has_capacity(self.going_on().count(), 1) {
            return Err((net, Refusal::TooMany));
        }
        if let Some(refusal) = self.blocked(&net) {
            return Err((net, refusal));
        }
        for i in 0..net.devices.len() {
            let number = net.devices[i].0;
            let view = self.devices.get(number).copied().unwrap_or_default();
            if !view.is_ready() {
                return Err((net, Refusal::DeviceNotReady(number)));
            }
            net.devices[i].1 = view.faults;
        }
        self.running.push(net);
        Ok(())
    }

    /// Requests a net to cancel, from the next cycle on. Returns whether it runs.
    pub fn cancel(&mut self, id: u32) -> bool {
        self.find(id).is_some_and(|net| {
            net.cancel = true;
            true
        })
    }

    /// Ends a net before the next cycle. Returns whether it runs.
    pub fn abort(&mut self, id: u32) -> bool {
        self.find(id).is_some_and(|net| {
            net.end = Some(End::Aborted);
            true
        })
    }

    /// Ends all nets before the next cycle and deactivates all rules; calls `ended` with each running net. Scheduled
    /// nets are returned on request.
    pub fn halt(&mut self, mut ended: impl FnMut(u32)) {
        for net in self.running.iter_mut().filter(|net| net.end.is_none()) {
            net.end = Some(End::Halted);
            ended(net.id);
        }
        self.rules.halt();
    }

    /// The running nets that do not end in this cycle.
    fn going_on(&self) -> impl Iterator<Item = &Running> {
        let nets = self.running.iter().map(|net| &**net);
        nets.filter(|net| net.end.is_none())
    }

    /// Whether `RUNNING_MAX` permits so many more nets beside so many.
    fn has_capacity(&self, going_on: usize, more: usize) -> bool {
        going_on + more <= RUNNING_MAX && self.running.len() + more <= BUCKETS
    }

    /// Resources held by running nets.
    fn held(&self) -> ResourceSet {
        let mut held = ResourceSet::default();
        for net in &self.running {
            held.add(&net.resources);
        }
        held
    }

    /// Starts a net that was admitted before. Until its first cycle it keeps the commands of nets
    /// that end as it starts.
    pub fn start_by_rule(&mut self, mut net: Box<Running>) {
        net.succeeds = true;
        self.start_checked(net);
    }

    /// Starts a net that was admitted before, without takeover.
    pub fn start_checked(&mut self, mut net: Box<Running>) {
        for device in &mut net.devices {
            device.1 = self.devices.get(device.0).map_or(0, |view| view.faults);
        }
        self.running.push(net);
    }

    /// Sets whether a successor waits for a net; returns whether that changed.
    pub fn set_takeover(&mut self, id: u32, waits: bool) -> bool {
        self.find(id)
            .is_some_and(|net| std::mem::replace(&mut net.takeover, waits) != waits)
    }

    /// Ends a net after this cycle, as a rule does.
    pub fn stop(&mut self, id: u32) {
        self.end(id, End::Stopped);
    }

    /// Ends a net after this cycle because it took too long.
    pub fn end_runaway(&mut self, id: u32) {
        self.end(id, End::Runaway);
    }

    fn end(&mut self, id: u32, end: End) {
        if let Some(net) = self.find(id) {
            net.end = net.end.or(Some(end));
        }
    }

    fn find(&mut self, id: u32) -> Option<&mut Box<Running>> {
        self.running.iter_mut().find(|net| net.id == id)
    }

    /// The running nets in the order of evaluation.
    pub fn running(&mut self) -> &mut [Box<Running>] {
        &mut self.running
    }

    /// Evaluates one cycle of all nets. Their commands are then in the image; commands of nets that ended before
    /// this cycle are not, unless others repeat them.
    pub fn cycle(&mut self, moment: Moment) {
        self.cycle_timed(moment, || Nanos::ZERO);
    }

    /// As [`Self::cycle`], measuring the duration of each net by a clock that is read once per net.
    pub fn cycle_timed(&mut self, moment: Moment, mut clock: impl FnMut() -> Nanos) {
        self.fresh.clear();
        let mut before = clock();
        for net in &mut self.running {
            let failed = net.devices.iter().find(|(number, faults)| {
                self.devices
                    .get(*number)
                    .is_none_or(|view| view.faults != *faults)
            });
            if let Some((number, _)) = failed {
                net.end = net.end.or(Some(End::DeviceFault(*number)));
            }
            net.evaluated = net.end.is_none() && net.is_due(moment.cycle);
            if net.evaluated {
                let moment = Moment {
                    every: net.every,
                    cancel: net.cancel,
                    takeover: net.takeover,
                    net: net.id,
                    ..moment
                };
                if net.plan.evaluate(&self.image, moment) {
                    net.end = Some(End::Terminated);
                }
                net.take_over(&self.image, moment.cycle);
                net.links.record(&net.plan, moment.time);
                let after = clock();
                net.account(after - before);
                before = after;
            }
        }
        self.withdraw_ended();
    }

    /// Counts, for the nets that were evaluated, that the cycle ended too late.
    pub fn overran(&mut self) {
        for net in self.running.iter().filter(|net| net.evaluated) {
            net.counters.overran();
        }
    }

    /// Publishes out values to programs; calls `changed` with each net whose values changed.
    pub fn publish(&mut self, mut changed: impl FnMut(&Running)) {
        for net in &mut self.running {
            if net.evaluated && net.publish() {
                changed(net);
            }
        }
    }

    /// Reports effects on nets that they did not cause: nets that overran, and nets
    /// that rules stopped, cancelled or started.
    pub fn effects(&mut self, mut report: impl FnMut(u32, Effect)) {
        for net in &mut self.running {
            if net.end == Some(End::Runaway) {
                report(net.id, Effect::RanAway);
            }
            if net.end == Some(End::Stopped) {
                report(net.id, Effect::Stopped);
            }
            if std::mem::take(&mut net.fresh_cancel) {
                report(net.id, Effect::Cancelled);
            }
            if std::mem::take(&mut net.fresh) {
                net.untold = true;
                report(net.id, Effect::Started);
            }
        }
    }

    /// Reports nets that rules started since the last call.
    pub fn started(&mut self, mut report: impl FnMut(u32)) {
        for net in &mut self.running {
            if net.take_untold() {
                report(net.id);
            }
        }
    }

    /// Removes one ended net, if `take` accepts it, and frees its resources.
    pub fn take_ended(
        &mut self,
        take: impl FnOnce(Box<Running>, End) -> Result<(), Box<Running>>,
    ) -> bool {
        let Some(at) = self.running.iter().position(|net| net.end.is_some()) else {
            return false;
        };
        let mut net = self.running.remove(at);
        self.leaving.note(&mut net);
        let end = net.end.unwrap_or(End::Aborted);
        match take(net, end) {
            Ok(()) => true,
            Err(net) => {
                // It is not accepted now; it is offered again and is not evaluated meanwhile.
                self.running.insert(at, net);
                false
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;

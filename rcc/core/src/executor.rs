//! Evaluates the running nets of one thread, cycle by cycle: starts, cancels, ends, resources. It
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

/// Most nets that run in one thread.
pub const RUNNING_MAX: usize = 256;
/// Places of running nets: those that end leave theirs only after those that follow them have come.
const PLACES: usize = 2 * RUNNING_MAX;
/// Most devices that one thread serves.
pub const DEVICES_MAX: usize = 64;

/// A device as nets' life depends on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceView {
    /// Whether it follows commands.
    pub status: DeviceStatus,
    /// How often it ceased to.
    pub faults: u64,
    /// How often it stood elsewhere all of a sudden while it did: nets that run go on, those that wait do not begin.
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
    /// A device that it commands, by its number, ceased to follow commands.
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
    /// Together with those that run it would cost more in a cycle than nets may.
    Overload {
        /// What those cost that run.
        running: Nanos,
        /// What all may cost.
        budget: Nanos,
    },
    /// Too many nets run.
    TooMany,
    /// The controller is stopped, or was after this was requested.
    Halted,
}

/// What happened to a net in a cycle that neither the net nor the controller did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// It took too long too often, and ends with this cycle.
    RanAway,
    /// It ends with this cycle.
    Stopped,
    /// It is told to cancel from the next cycle on.
    Cancelled,
    /// It is evaluated from the next cycle on.
    Started,
}

/// A net in the hands of the thread that evaluates it.
#[derive(Debug)]
pub struct Running {
    /// Its number.
    pub id: u32,
    /// The net.
    pub plan: Plan,
    /// What it needs for itself.
    pub resources: ResourceSet,
    /// Devices it commands, with the faults they had when it started; until then, with their epoch when it was scheduled.
    pub devices: Vec<(usize, u64)>,
    /// It is evaluated in every so many cycles of its thread.
    every: u64,
    /// What a cycle of it costs at most by what its primitives declare.
    pub cost: Nanos,
    /// Under which stop of the controller its start was requested.
    pub requested: Generation,
    /// Whether it was asked to cancel.
    pub cancel: bool,
    /// Whether a successor waits for it.
    pub takeover: bool,
    /// Whether a rule started it in this cycle.
    fresh: bool,
    /// Whether a rule started it, and the controller was not told yet.
    untold: bool,
    /// Whether a rule asked it to cancel, and nobody was told yet.
    fresh_cancel: bool,
    /// Whether a rule started it in place of another, and it was not evaluated yet.
    succeeds: bool,
    /// Whether it ends after this cycle, and why.
    end: Option<End>,
    /// Whether what it commanded is withdrawn, or about to be.
    leaves: bool,
    /// Whether it was evaluated in this cycle.
    evaluated: bool,
    /// The group of `every` cycles in which it was last looked at.
    last_group: Option<u64>,
    counters: Arc<NetCounters>,
    /// The period of its thread, and what an evaluation may take of it.
    period: Nanos,
    budget: Nanos,
    /// Evaluations in a row that took longer than `period`.
    too_long: u32,
    out: LatestWriter<Box<[u64]>>,
    inbox: LatestReader<Box<[u64]>>,
    inbox_seen: u64,
    /// What it exchanges with other nets and those who look into it.
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

    /// Has it evaluated in every so many cycles of its thread, whose own period bounds what each may take.
    pub fn set_every(&mut self, every: u64) {
        self.every = every.max(1);
        let thread = self.plan.period() / u32::try_from(self.every).unwrap_or(u32::MAX);
        (self.period, self.budget) = (thread.into(), figures::budget(thread).into());
    }

    /// Whether it is to be evaluated in this cycle: in the first of each group of `every`, or the
    /// first of it that the thread did not miss.
    fn is_due(&mut self, cycle: u64) -> bool {
        let group = cycle / self.every;
        match self.last_group.replace(group) {
            None => cycle.is_multiple_of(self.every),
            Some(last) => last != group,
        }
    }

    /// Whether a rule started it and the controller was not told; from now on it was.
    const fn take_untold(&mut self) -> bool {
        std::mem::replace(&mut self.untold, false)
    }

    /// Its figures, which go on being counted.
    #[must_use]
    pub const fn counters(&self) -> &Arc<NetCounters> {
        &self.counters
    }

    /// Counts an evaluation; one that is too long too often ends the net.
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

    /// Takes over what programs and other nets wrote since the last cycle; returns whether there was
    /// anything.
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

    /// Hands over what programs may read if it changed; returns whether it did.
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
    reason = "nets come and go as boxes; a cycle neither makes nor frees any"
)]
#[derive(Debug)]
pub struct Executor {
    /// Devices as the nets see them.
    pub image: Image,
    /// Devices as their lives depend on them.
    pub devices: Vec<DeviceView>,
    running: Vec<Box<Running>>,
    rules: rules::Rules,
    /// By device: how often its faults changed, or it began to follow commands.
    epochs: Vec<u64>,
    /// Whether an epoch changed since scheduled nets were checked.
    epochs_changed: bool,
    /// What the nets that run may cost together in a cycle, by what they declare.
    budget: Nanos,
    /// How many joints of the image belong to a device.
    joints: usize,
    /// How many words of the image do.
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
            running: Vec::with_capacity(PLACES),
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
    /// One whose nets may cost so much together in a cycle, by what they declare; [`Self::default`] has
    /// no bound.
    #[must_use]
    pub fn within(budget: Nanos) -> Self {
        Self {
            budget,
            ..Self::default()
        }
    }

    /// How much rules look at in a cycle, at most [`rules::WORK_MAX`].
    #[must_use]
    pub const fn rule_work(&self) -> usize {
        self.rules.work()
    }

    /// Takes a net in. It is evaluated from the next [`Self::cycle`] on.
    ///
    /// # Errors
    /// If it cannot run now; the net comes back with the reason.
    pub fn start(&mut self, mut net: Box<Running>) -> Result<(), (Box<Running>, Refusal)> {
        if !self.has_places(self.going_on().count(), 1) {
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

    /// Asks a net to cancel; the next cycle tells it. Returns whether it runs.
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

    /// Ends all nets before the next cycle, and the wait of all rules; calls `ended` with each net that ran. Scheduled
    /// nets are given back when they are asked for.
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

    /// Whether so many nets more may run where so many go on.
    fn has_places(&self, going_on: usize, more: usize) -> bool {
        going_on + more <= RUNNING_MAX && self.running.len() + more <= PLACES
    }

    /// What running nets hold.
    fn held(&self) -> ResourceSet {
        let mut held = ResourceSet::default();
        for net in &self.running {
            held.add(&net.resources);
        }
        held
    }

    /// Takes in a net whose right to run was checked before. Until its first cycle it keeps up what nets commanded
    /// that end as it starts.
    pub fn start_by_rule(&mut self, mut net: Box<Running>) {
        net.succeeds = true;
        self.start_checked(net);
    }

    /// Takes in a net whose right to run was checked before, and that takes nothing over.
    pub fn start_checked(&mut self, mut net: Box<Running>) {
        for device in &mut net.devices {
            device.1 = self.devices.get(device.0).map_or(0, |view| view.faults);
        }
        self.running.push(net);
    }

    /// Says whether a successor waits for a net; returns whether that is new.
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

    /// Evaluates one cycle of all nets. What they command is then in the image; what nets commanded that ended before
    /// this cycle is not, unless others command it.
    pub fn cycle(&mut self, moment: Moment) {
        self.cycle_timed(moment, || Nanos::ZERO);
    }

    /// The same, measuring how long each net takes by a clock that is read once a net.
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

    /// Notes, with the nets that were evaluated, that the cycle ended too late.
    pub fn overran(&mut self) {
        for net in self.running.iter().filter(|net| net.evaluated) {
            net.counters.overran();
        }
    }

    /// Hands over the values that programs read; calls `changed` with each net whose did.
    pub fn publish(&mut self, mut changed: impl FnMut(&Running)) {
        for net in &mut self.running {
            if net.evaluated && net.publish() {
                changed(net);
            }
        }
    }

    /// Tells what happened to nets that they did not do themselves: those that ran away, and those
    /// that rules stopped, asked to cancel, and started.
    pub fn effects(&mut self, mut tell: impl FnMut(u32, Effect)) {
        for net in &mut self.running {
            if net.end == Some(End::Runaway) {
                tell(net.id, Effect::RanAway);
            }
            if net.end == Some(End::Stopped) {
                tell(net.id, Effect::Stopped);
            }
            if std::mem::take(&mut net.fresh_cancel) {
                tell(net.id, Effect::Cancelled);
            }
            if std::mem::take(&mut net.fresh) {
                net.untold = true;
                tell(net.id, Effect::Started);
            }
        }
    }

    /// Tells which nets rules started since this was last called.
    pub fn started(&mut self, mut tell: impl FnMut(u32)) {
        for net in &mut self.running {
            if net.take_untold() {
                tell(net.id);
            }
        }
    }

    /// Takes out one net that ended, if `take` accepts it; what it held is free then.
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
                // Nobody has room for it now; it is offered again and is not evaluated meanwhile.
                self.running.insert(at, net);
                false
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;

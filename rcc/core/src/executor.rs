//! Evaluates the running nets of one thread, cycle by cycle, with their starts, cancels, ends and resources. It
//! owns no thread and reads no clock, so that a recording replays through the very same code; the
//! live thread around it is in [`thread`], and what happens between nets in [`rules`].

pub mod figures;
pub mod flight;
mod image;
mod life;
pub mod links;
pub mod machines;
pub mod report;
mod resources;
pub mod rules;
mod running;
pub mod sampler;
pub mod serve;
mod start;
pub mod stop;
pub mod thread;
mod view;
mod withdraw;

use std::ops::Range;

use takt_net::device::Layout;
use takt_net::{Image, Moment};
use takt_rt::Nanos;

use crate::device::Place;
use life::{Cancel, Change, StartReport};

pub use life::End;
pub use resources::ResourceSet;
pub use running::Running;
pub use view::DeviceView;

/// Maximum number of running nets of one thread.
pub const RUNNING_MAX: usize = 256;
/// Slots of running nets: a net that ends keeps its slot until its successor has started.
const BUCKETS: usize = 2 * RUNNING_MAX;
/// Maximum number of devices of one thread.
pub const DEVICES_MAX: usize = 64;

/// Why a net could not be started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartError {
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
    /// Where the slots of each device are.
    places: Vec<Place>,
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
    machines: Vec<Box<machines::Hosted>>,
}

impl Default for Executor {
    fn default() -> Self {
        Self {
            image: Image::default(),
            devices: Vec::with_capacity(DEVICES_MAX),
            places: Vec::with_capacity(DEVICES_MAX),
            running: Vec::with_capacity(BUCKETS),
            rules: rules::Rules::new(),
            epochs: vec![0; DEVICES_MAX],
            epochs_changed: false,
            budget: Nanos::MAX,
            joints: 0,
            used: Layout::default(),
            fresh: Vec::with_capacity(DEVICES_MAX),
            leaving: withdraw::Leaving::default(),
            machines: Vec::with_capacity(machines::MACHINES_MAX),
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

    /// Requests a net to cancel, from the next cycle on. Returns whether it runs.
    pub fn cancel(&mut self, id: u32) -> bool {
        self.find(id).is_some_and(|net| {
            if net.cancel == Cancel::None {
                net.cancel = Cancel::Requested;
            }
            true
        })
    }

    /// Ends a net before the next cycle. Returns whether it runs.
    pub fn abort(&mut self, id: u32) -> bool {
        self.find(id).is_some_and(|net| {
            net.change(Change::Abort);
            true
        })
    }

    /// Ends all nets before the next cycle and deactivates all rules; calls `ended` with each running net. Scheduled
    /// nets are returned on request.
    pub fn halt(&mut self, mut ended: impl FnMut(u32)) {
        for net in self.running.iter_mut().filter(|net| net.is_going_on()) {
            net.change(Change::End(End::Halted));
            ended(net.id);
        }
        self.rules.halt();
        self.halt_machines();
    }

    /// The running nets that do not end in this cycle.
    fn going_on(&self) -> impl Iterator<Item = &Running> {
        let nets = self.running.iter().map(|net| &**net);
        nets.filter(|net| net.is_going_on())
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
            net.change(Change::End(end));
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
        self.locate_components();
        let mut before = clock();
        for at in 0..self.running.len() {
            let Some(net) = self.running.get_mut(at) else {
                break;
            };
            net.check_devices(&self.devices, moment.cycle);
            net.cycle(&self.image, moment, &mut before, &mut clock);
            net.withhold(&self.image, &self.devices, &self.places);
            self.pass_values(at);
        }
        self.image.last_cycle.set(moment.cycle);
        self.withdraw_ended();
    }

    /// Counts, for the nets that were evaluated, that the cycle ended too late.
    pub fn overran(&mut self) {
        for net in self.running.iter().filter(|net| net.life.is_evaluated()) {
            net.counters.overran();
        }
    }

    /// Publishes out values to programs; calls `changed` with each net whose values changed.
    pub fn publish(&mut self, mut changed: impl FnMut(&Running)) {
        for net in &mut self.running {
            if net.life.is_evaluated() && net.publish() {
                changed(net);
            }
        }
    }

    /// Reports effects on nets that they did not cause: nets that overran, and nets
    /// that rules stopped, cancelled or started.
    pub fn effects(&mut self, mut report: impl FnMut(u32, Effect)) {
        for net in &mut self.running {
            if net.life.end() == Some(End::Runaway) {
                report(net.id, Effect::RanAway);
            }
            if net.life.end() == Some(End::Stopped) {
                report(net.id, Effect::Stopped);
            }
            if net.cancel == Cancel::ByRule {
                net.cancel = Cancel::Requested;
                report(net.id, Effect::Cancelled);
            }
            if net.start_report == StartReport::Due {
                net.start_report = StartReport::Recorded;
                report(net.id, Effect::Started);
            }
        }
    }

    /// Reports nets that rules started since the last call.
    pub fn started(&mut self, mut report: impl FnMut(u32)) {
        for net in &mut self.running {
            if net.take_start_report() {
                report(net.id);
            }
        }
    }

    /// Removes one ended net, if `take` accepts it, and frees its resources.
    pub fn take_ended(
        &mut self,
        take: impl FnOnce(Box<Running>, End) -> Result<(), Box<Running>>,
    ) -> bool {
        let mut running = self.running.iter();
        let Some(at) = running.position(|net| !net.is_going_on()) else {
            return false;
        };
        let mut net = self.running.remove(at);
        self.leaving.note(&mut net);
        let end = net.life.end().unwrap_or(End::Aborted);
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

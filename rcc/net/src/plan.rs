//! A plan: a net ready for evaluation. Evaluating it is a walk over steps in topological order;
//! loading, checking and freeing happen elsewhere, and so does everything that can block.

mod inter;

use std::sync::Arc;
use std::time::Duration;

use crate::cost::NetCost;
pub use crate::cycle::{Cycle, Moment};
use crate::definition::Primitive;
use crate::device::{Image, Target};
use crate::failure::Failure;
use crate::netcomm::{Directory, Inter, Mailbox};
use crate::ports::Ports;
use crate::set_points::SetPoints;
use crate::slots::{In, SlotRef, Slots};
use crate::taps::Taps;
use crate::value::Type;

/// One operation of the walk.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Op {
    /// Run the steps of this range.
    Run { first: u32, end: u32 },
    /// If this guard's fragment is not active, continue at `skip_to`.
    Guard { guard: u32, skip_to: u32 },
}

/// A fragment (or one primitive) that can be switched off.
#[derive(Debug)]
pub(crate) struct Guard {
    pub(crate) active: In<bool>,
    /// Slots inside that are read from outside; null while switched off.
    pub(crate) exports: Box<[SlotRef]>,
    pub(crate) was_active: bool,
}

impl Guard {
    /// Tests the activation; on the transition from active to inactive the exported slots become
    /// null.
    fn enter(&mut self, slots: &Slots) -> bool {
        let active = self.active.read(slots) == Some(true);
        if self.was_active && !active {
            for export in &self.exports {
                export.clear(slots);
            }
        }
        self.was_active = active;
        active
    }
}

/// An out port of the root fragment.
#[derive(Debug)]
pub struct RootPort {
    /// Its name.
    pub name: String,
    /// Its type.
    pub ty: Type,
    pub(crate) slot: SlotRef,
}

/// A net ready for evaluation.
pub struct Plan {
    pub(crate) slots: Slots,
    pub(crate) steps: Box<[Box<dyn Primitive>]>,
    pub(crate) ops: Box<[Op]>,
    pub(crate) guards: Box<[Guard]>,
    pub(crate) terminate: In<bool>,
    pub(crate) root_ports: Box<[RootPort]>,
    pub(crate) inbox: Mailbox,
    pub(crate) outbox: Mailbox,
    pub(crate) inter_ins: Box<[Inter]>,
    pub(crate) inter_outs: Box<[Inter]>,
    pub(crate) taps: Taps,
    pub(crate) ports: Arc<Ports>,
    pub(crate) resources: Box<[String]>,
    pub(crate) commands: Box<[Target]>,
    pub(crate) outlives_failure: Option<Duration>,
    pub(crate) period: Duration,
    pub(crate) primitives: usize,
    /// Cycles evaluated so far.
    pub(crate) count: i64,
    pub(crate) devices: Box<[String]>,
    pub(crate) set_points: Box<[SetPoints]>,
    pub(crate) failures: Box<[Failure]>,
    pub(crate) uses: Box<[String]>,
    pub(crate) cost: NetCost,
    /// Bytes of arrays and histories.
    pub(crate) memory: usize,
}

impl std::fmt::Debug for Plan {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Plan")
            .field("primitives", &self.primitives)
            .field("period", &self.period)
            .field("resources", &self.resources)
            .finish_non_exhaustive()
    }
}

impl Plan {
    /// Evaluates one cycle. Returns whether the net signals termination.
    pub fn evaluate(&mut self, image: &Image, moment: Moment) -> bool {
        let slots = &self.slots;
        let cycle = Cycle {
            slots,
            image,
            moment,
            count: self.count,
            inbox: &self.inbox,
            outbox: &self.outbox,
        };
        self.count += 1;
        let mut next = 0;
        while let Some(op) = self.ops.get(next) {
            next += 1;
            match *op {
                Op::Run { first, end } => {
                    for step in &mut self.steps[first as usize..end as usize] {
                        step.step(&cycle);
                    }
                }
                Op::Guard { guard, skip_to } => {
                    if !self.guards[guard as usize].enter(slots) {
                        next = skip_to as usize;
                    }
                }
            }
        }
        self.terminate.read(slots) == Some(true)
    }

    /// Imports values written by programs, a whole in-box of [`Self::inbox`].
    pub fn import(&self, words: &[u64]) {
        self.inbox.import(words);
    }

    /// Whether an out value changed since the last call.
    pub fn take_changed(&self) -> bool {
        self.outbox.changed.replace(false)
    }

    /// Whether a Boolean out value for programs changed since the last call.
    pub fn take_results_changed(&self) -> bool {
        self.outbox.results.replace(false)
    }

    /// Exports the out-box of [`Self::outbox`].
    pub fn export(&self, words: &mut [u64]) {
        self.outbox.export(words);
    }

    /// The present words of the in-box: the parameter values before an import.
    pub fn inbox_words(&self) -> impl Iterator<Item = u64> {
        self.inbox.words.iter().map(std::cell::Cell::get)
    }

    /// The present words of the out-box.
    pub fn outbox_words(&self) -> impl Iterator<Item = u64> {
        self.outbox.words.iter().map(std::cell::Cell::get)
    }

    /// The Boolean out value whose entry begins at word `at` of the out-box; `None` while it is
    /// null.
    pub fn out_bool(&self, at: usize) -> Option<bool> {
        self.outbox.current_bool(at)
    }

    /// Values that programs may write.
    pub fn inbox(&self) -> &Arc<Directory> {
        &self.inbox.directory
    }

    /// Values that programs may read.
    pub fn outbox(&self) -> &Arc<Directory> {
        &self.outbox.directory
    }

    /// Resources that the net needs exclusively, such as the joints it commands.
    pub fn resources(&self) -> &[String] {
        &self.resources
    }

    /// Commands that the net may give.
    pub fn commands(&self) -> &[Target] {
        &self.commands
    }

    /// How long the net goes on after a device that it commands failed; `None` if it ends at once.
    pub const fn outlives_failure(&self) -> Option<Duration> {
        self.outlives_failure
    }

    /// Devices that the net commands.
    pub fn devices(&self) -> &[String] {
        &self.devices
    }

    /// The set-points that the net gives, by primitive.
    pub fn set_points(&self) -> &[SetPoints] {
        &self.set_points
    }

    /// Why a primitive of the net failed, with a hint; `None` if none did.
    pub fn failure(&self) -> Option<String> {
        self.failures.iter().find_map(Failure::read)
    }

    /// Devices that the net reads or commands.
    pub fn uses(&self) -> &[String] {
        &self.uses
    }

    /// Time from one cycle to the next.
    pub const fn period(&self) -> Duration {
        self.period
    }

    /// Cost bound of one cycle with everything active, by the declared or measured costs of its
    /// primitives.
    pub const fn cost(&self) -> &NetCost {
        &self.cost
    }

    /// Number of primitives in the net.
    pub const fn primitives(&self) -> usize {
        self.primitives
    }

    /// Out ports of the root fragment.
    pub fn root_ports(&self) -> &[RootPort] {
        &self.root_ports
    }

    /// The non-null out ports of the root fragment, by name and text.
    pub fn root_values(&self) -> Vec<(String, String)> {
        let ports = self.root_ports.iter();
        ports
            .filter_map(|port| Some((port.name.clone(), port.slot.text(&self.slots)?)))
            .collect()
    }

    /// Upper bound on the net's memory, in bytes: slots, steps, arrays, histories, names of ports, and one in-box
    /// and out-box.
    pub fn memory(&self) -> usize {
        let words = self.inbox.words.len() + self.outbox.words.len();
        self.bytes() + self.memory + self.ports.bytes() + words * size_of::<u64>()
    }

    /// Memory that a cycle can touch, in bytes: slots, steps with their parameters and state, but
    /// not histories.
    pub fn bytes(&self) -> usize {
        let steps: usize = self
            .steps
            .iter()
            .map(|s| size_of_val(s) + size_of_val(&**s))
            .sum();
        self.slots.bytes() + steps + size_of_val(&*self.ops) + size_of_val(&*self.guards)
    }
}

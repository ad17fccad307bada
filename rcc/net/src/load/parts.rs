//! The parts of a plan, collected while its primitives are built, and what each of them does. A plan is made of them
//! elsewhere.

use std::collections::HashMap;
use std::ops::RangeInclusive;
use std::time::Duration;

use super::origin::Origin;
use crate::device::Target;
use crate::failure::Failure;
use crate::fault::FaultKind;
use crate::netcomm::{Directory, Inter};
use crate::set_points::SetPoints;
use crate::slots::{SlotRef, SlotsBuilder};

/// Marks a part that cannot be built because an earlier one could not; never shown.
pub(super) const fn inherited() -> FaultKind {
    FaultKind::ArraySize(String::new())
}

/// What a primitive does beyond its out ports, and what it expects at its in ports.
#[derive(Debug, Default)]
pub(super) struct Effects {
    /// Its commands, and the device that it named last.
    pub(super) commands: Vec<Target>,
    pub(super) device: Option<String>,
    /// Whether it has an effect outside its net.
    pub(super) acts: bool,
    /// By in port, the values that can be meant.
    pub(super) expected: Vec<(usize, RangeInclusive<f64>)>,
}

/// The parts of the plan, collected over all primitives.
pub(super) struct Parts {
    pub(super) slots: SlotsBuilder,
    /// Slots of all out ports, by node and port; `None` until built.
    pub(super) outputs: Vec<Option<SlotRef>>,
    /// Number of out ports of all nodes before each node.
    pub(super) slots_before: Vec<usize>,
    /// Slots that the two steps of one primitive share.
    pub(super) states: HashMap<(u32, usize), u32>,
    pub(super) resources: Vec<String>,
    pub(super) commands: Vec<Target>,
    pub(super) devices: Vec<String>,
    /// How long the net goes on after a device failed.
    pub(super) outlives_failure: Option<Duration>,
    pub(super) set_points: Vec<SetPoints>,
    pub(super) failures: Vec<Failure>,
    /// Devices that the net reads or commands.
    pub(super) uses: Vec<String>,
    pub(super) inbox: Directory,
    pub(super) inbox_words: Vec<u64>,
    pub(super) outbox: Directory,
    /// Values read from other nets, and written to them.
    pub(super) inter_ins: Vec<Inter>,
    pub(super) inter_outs: Vec<Inter>,
    /// Bytes of arrays and histories.
    pub(super) memory: usize,
    /// Array elements at the ports of the primitive that is being built.
    pub(super) elements: usize,
    /// By node.
    pub(super) effects: Vec<Effects>,
}

impl Parts {
    pub(super) fn output(&mut self, origin: Origin) -> &mut Option<SlotRef> {
        let before = self.slots_before[origin.node as usize];
        &mut self.outputs[before + origin.port as usize]
    }
}

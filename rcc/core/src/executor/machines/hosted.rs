//! A machine with the nets of its components, as its thread holds it. The steps are in [`super`], what the machine does to
//! its components in [`components`](super::components).

use std::sync::Arc;

use takt_machine::lifecycle::{Phase, Request};
use takt_machine::machine::{Machine, Status};
use takt_machine::{Program, Value};
use takt_rt::Nanos;
use takt_rt::latest::{LatestReader, LatestWriter, latest};

use super::seat::{self, Seat};
use super::view::{MachineState, MachineView};
use crate::executor::{ResourceSet, Running};
use crate::stop_channel::Generation;

/// Maximum number of machines of one thread.
pub const MACHINES_MAX: usize = 16;
/// Nets that wait for the next starts of a component. As many starts can follow each other without a pause.
pub const SPARES: usize = 2;

/// A component of a machine.
#[derive(Debug)]
pub(super) struct Slot {
    pub(super) phase: Phase,
    pub(super) ready: [Option<Box<Running>>; SPARES],
    /// Started in this step, not yet among the running nets.
    pub(super) starting: Option<Box<Running>>,
    /// The running net, and where it is among the running nets.
    pub(super) net: Option<(u32, usize)>,
    /// Whether the last `configure` or `cleanup` is complete; `None` if it failed.
    pub(super) is_settled: Option<bool>,
    /// Single values of its properties.
    pub(super) values: Box<[Option<Value>]>,
    /// Number of calls of each operation, and the evaluations of the net before the last.
    pub(super) calls: Box<[(u32, i64)]>,
    /// The endpoints of the net that ran last, with its last out values.
    pub(super) retired: Option<Box<Seat>>,
}

/// A request of a machine that its thread cannot execute.
pub type Asked = (usize, Request);

/// A machine in its thread.
#[expect(
    clippy::vec_box,
    reason = "nets move in and out as boxes; a cycle neither allocates nor frees any"
)]
#[derive(Debug)]
pub struct Hosted {
    /// Its number.
    pub id: u32,
    /// Bound on the cost of a cycle: its step and all its components.
    pub cost: Nanos,
    /// Resources of all its components, which no other net can hold.
    pub resources: ResourceSet,
    /// Stop generation under which it was loaded.
    pub requested: Generation,
    pub(super) machine: Machine,
    pub(super) slots: Box<[Slot]>,
    pub(super) asked: Vec<Asked>,
    pub(super) returned: Vec<Box<Running>>,
    pub(super) published: LatestWriter<MachineView>,
    pub(super) view: MachineView,
    /// Its status at the last report.
    pub(super) reported: Status,
    /// The states that [`Self::changes`] returned last, as words.
    noted: Box<[u64]>,
}

impl Hosted {
    /// A machine whose components are not configured.
    #[must_use]
    pub fn new(id: u32, program: Arc<Program>) -> (Box<Self>, LatestReader<MachineView>) {
        let slots = program.members().iter().map(|member| {
            let component = &member.component;
            let values = component.properties.iter();
            Slot {
                phase: Phase::PreOperational,
                ready: [const { None }; SPARES],
                starting: None,
                net: None,
                is_settled: Some(true),
                values: values
                    .map(|property| property.default.as_ref()?.value())
                    .collect(),
                calls: vec![(0, 0); component.operations.len()].into(),
                retired: None,
            }
        });
        let slots: Box<[Slot]> = slots.collect();
        let view = MachineView::new(&program);
        let (published, reader) = latest(1, || view.clone());
        let hosted = Self {
            id,
            cost: Nanos::ZERO,
            resources: ResourceSet::default(),
            requested: Generation::default(),
            machine: Machine::new(program),
            asked: Vec::with_capacity(2 * slots.len() + 1),
            returned: Vec::with_capacity(2 * SPARES * slots.len() + 1),
            slots,
            published,
            noted: view.machines.iter().map(MachineState::word).collect(),
            view,
            reported: Status::Inactive,
        };
        (Box::new(hosted), reader)
    }

    /// Its program.
    #[must_use]
    pub const fn program(&self) -> &Arc<Program> {
        self.machine.program()
    }

    /// What its last step did and where it is.
    #[must_use]
    pub const fn view(&self) -> &MachineView {
        &self.view
    }

    /// Calls `changed` with each machine whose state or status changed since the last call: its number, the outermost one
    /// 0, and [`MachineState::word`].
    pub fn changes(&mut self, mut changed: impl FnMut(usize, u64)) {
        let states = self.view.machines.iter().zip(&mut self.noted).enumerate();
        for (number, (state, noted)) in states {
            let word = state.word();
            if std::mem::replace(noted, word) != word {
                changed(number, word);
            }
        }
    }

    /// Finds its nets among the running ones.
    pub(super) fn locate(&mut self, running: &[Box<Running>]) {
        for (at, net) in running.iter().enumerate() {
            let Some(seat) = net.seat.as_ref().filter(|seat| seat.machine == self.id) else {
                continue;
            };
            if let Some(slot) = self.slots.get_mut(seat.component)
                && let Some((id, place)) = &mut slot.net
                && *id == net.id
            {
                *place = at;
            }
        }
    }

    fn slot(&self, component: usize) -> Option<(usize, u32)> {
        let (id, at) = self.slots.get(component)?.net?;
        Some((at, id))
    }

    /// Passes what a net wrote in this cycle to the components that are connected.
    pub(super) fn pass(&self, net: &Running, seat: &Seat, running: &[Box<Running>]) {
        let connections = self.machine.program().connections().iter();
        for connection in connections.filter(|c| c.from.0 == seat.component) {
            let target = self.slot(connection.to.0);
            let target = target.and_then(|(at, id)| running.get(at).filter(|net| net.id == id));
            if let Some(target) = target {
                seat::pass(net, connection.from.1, target, connection.to.1);
            }
        }
    }

    /// Passes the values of connections to a net that starts.
    pub(super) fn fill(&self, net: &Running, component: usize, running: &[Box<Running>]) {
        let connections = self.machine.program().connections().iter();
        for connection in connections.filter(|c| c.to.0 == component) {
            let source = self.slot(connection.from.0);
            match source.and_then(|(at, id)| running.get(at).filter(|net| net.id == id)) {
                Some(source) => seat::pass(source, connection.from.1, net, connection.to.1),
                None => {
                    let slot = self.slots.get(connection.from.0);
                    if let Some(retired) = slot.and_then(|slot| slot.retired.as_ref()) {
                        retired.pass_last(connection.from.1, net, connection.to.1);
                    }
                }
            }
        }
    }
}

//! From an ordered net to a plan: slots, steps, guards. Checks that need a parameter's value or an
//! array's size are made by the build functions of the primitives, which are called from here.

use std::collections::HashMap;
use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use crate::cost::NetCost;
use crate::definition::Primitive;
use crate::fault::{Fault, FaultKind};
use crate::load::builder::Build;
use crate::load::graph::Unit;
use crate::load::origin::{Origin, number};
use crate::load::parts::{Effects, Parts};
use crate::load::resolved::{Resolved, Tapped};
use crate::load::{LoadContext, activation};
use crate::netcomm::{Directory, Mailbox};
use crate::plan::{Guard, Op, Plan, RootPort};
use crate::slots::{In, SlotRef, SlotsBuilder};
use crate::taps::Taps;
use crate::value::{Element, Type, Value};

/// Builds the plan of an ordered net, with the effects of its primitives; `None` if that adds faults.
pub(super) fn build(
    resolved: &Resolved<'_>,
    order: &[u32],
    context: &LoadContext<'_>,
    faults: &mut Vec<Fault>,
) -> Option<(Plan, Vec<Effects>)> {
    let mut parts = Parts::new(resolved);
    let mut elements = vec![0; resolved.nodes.len()];
    let mut walk = Walk::new(resolved);
    let known = faults.len();
    for unit in order {
        let (number, early) = match resolved.unit(*unit) {
            Unit::Main(number) => (number, false),
            Unit::Early(number) => (number, true),
            Unit::Gate(_) => continue,
        };
        let node = &resolved.nodes[number as usize];
        let definition = node.definition;
        let build = if early {
            definition.early.as_ref()
        } else {
            Some(&definition.build)
        };
        let Some(build) = build else { continue };
        let mut builder = Build {
            devices: context.devices,
            period: context.period,
            limits: &context.limits,
            parts: &mut parts,
            node,
            number,
        };
        match build(&mut builder) {
            Ok(step) => walk.step(node.guard, step),
            Err(fault) => faults.push(fault),
        }
        elements[number as usize] += std::mem::take(&mut parts.elements);
    }
    if faults.len() > known {
        return None;
    }
    walk.close();
    let cost = cost_of(resolved, &elements, walk.guard_tests());
    let budget = context.limits.cost.filter(|budget| cost.total > *budget);
    if let (Some(budget), 0) = (budget, known) {
        let period = context.period;
        let kind = FaultKind::Cost {
            cost,
            budget,
            period,
        };
        faults.push(Fault::new(kind, 0..0));
        return None;
    }
    let effects = std::mem::take(&mut parts.effects);
    let plan = parts.finish(walk, resolved, context.period, cost)?;
    Some((plan, effects))
}

/// The cost of the longest activation; `elements` are those of the arrays at the ports of each
/// node.
fn cost_of(resolved: &Resolved<'_>, elements: &[usize], guard_tests: usize) -> NetCost {
    let nodes = || resolved.nodes.iter().zip(elements);
    let costs: Vec<_> = nodes()
        .map(|(node, elements)| node.definition.cost.of_one(*elements))
        .collect();
    let counts = activation::longest(resolved, &costs);
    let counted = nodes().map(|(node, elements)| {
        let counts = counts[node.guard as usize];
        (node.definition, counts.then_some(*elements))
    });
    NetCost::of(counted, guard_tests)
}

impl Parts {
    fn new(resolved: &Resolved<'_>) -> Self {
        let mut slots_before = Vec::with_capacity(resolved.nodes.len() + 1);
        let mut ports = 0;
        for node in &resolved.nodes {
            slots_before.push(ports);
            ports += node.definition.outputs.len();
        }
        Self {
            slots: SlotsBuilder::default(),
            outputs: vec![None; ports],
            slots_before,
            states: HashMap::new(),
            resources: Vec::new(),
            commands: Vec::new(),
            devices: Vec::new(),
            outlives_failure: None,
            set_points: Vec::new(),
            failures: Vec::new(),
            uses: Vec::new(),
            inbox: Directory::default(),
            inbox_words: Vec::new(),
            outbox: Directory::default(),
            inter_ins: Vec::new(),
            inter_outs: Vec::new(),
            memory: 0,
            elements: 0,
            effects: resolved.nodes.iter().map(|_| Effects::default()).collect(),
        }
    }

    /// By guard: its slots that are read from outside.
    fn exports(&mut self, resolved: &Resolved<'_>) -> Vec<Vec<SlotRef>> {
        let mut exports = vec![Vec::new(); resolved.guards.len()];
        let mut add = |origin: Origin, reader: u32| {
            let mut guard = resolved.nodes[origin.node as usize].guard;
            while guard != 0 && !is_inside(resolved, reader, guard) {
                exports[guard as usize].extend(*self.output(origin));
                guard = resolved.guards[guard as usize].parent;
            }
        };
        for node in &resolved.nodes {
            let links = node.links.iter().flatten();
            links.for_each(|origin| add(*origin, node.guard));
        }
        for guard in &resolved.guards {
            let active = guard.active.iter();
            active.for_each(|origin| add(*origin, guard.parent));
        }
        let root = resolved.root.iter().filter_map(|(_, origin)| *origin);
        root.for_each(|origin| add(origin, 0));
        for slots in &mut exports {
            slots.sort_unstable();
            slots.dedup();
        }
        exports
    }

    fn guards(&mut self, resolved: &Resolved<'_>) -> Option<Box<[Guard]>> {
        let exports = self.exports(resolved);
        let guard = |(active, exports): (Option<Origin>, Vec<SlotRef>)| {
            let slot = match active {
                Some(origin) => (*self.output(origin))?,
                None => SlotRef::null(Type::scalar(bool::ELEMENT)),
            };
            Some(Guard {
                active: boolean(slot)?,
                exports: exports.into_boxed_slice(),
                was_active: false,
            })
        };
        let active = resolved.guards.iter().map(|info| info.active);
        active.zip(exports).map(guard).collect()
    }

    fn root_ports(&mut self, resolved: &Resolved<'_>) -> Option<Box<[RootPort]>> {
        let port = |(name, origin): &(&str, Option<Origin>)| {
            let origin = (*origin)?;
            let definition = resolved.nodes[origin.node as usize].definition;
            Some(RootPort {
                name: (*name).to_owned(),
                ty: definition.outputs[origin.port as usize].ty,
                slot: (*self.output(origin))?,
            })
        };
        resolved.root.iter().map(port).collect()
    }

    /// `None` if a part could not be built; the fault is already recorded.
    fn finish(
        mut self,
        walk: Walk<'_>,
        resolved: &Resolved<'_>,
        period: Duration,
        cost: NetCost,
    ) -> Option<Plan> {
        let guards = self.guards(resolved)?;
        let root_ports = self.root_ports(resolved)?;
        let taps = taps(&mut self, resolved)?;
        let ports = super::ports::ports(&mut self, resolved);
        let terminate = root_ports.iter().find(|p| p.name == "outTerminate");
        let terminate = boolean(
            terminate.map_or(SlotRef::null(Type::scalar(Element::Bool)), |port| port.slot),
        )?;
        let out_words = vec![0; self.outbox.words()];
        self.resources.sort();
        self.resources.dedup();
        self.commands.sort_unstable();
        self.commands.dedup();
        self.devices.sort();
        self.devices.dedup();
        self.uses.sort();
        self.uses.dedup();
        Some(Plan {
            slots: self.slots.finish(),
            steps: walk.steps.into_boxed_slice(),
            ops: walk.ops.into_boxed_slice(),
            guards,
            terminate,
            root_ports,
            inbox: Mailbox::new(self.inbox, &self.inbox_words),
            outbox: Mailbox::new(self.outbox, &out_words),
            inter_ins: self.inter_ins.into_boxed_slice(),
            inter_outs: self.inter_outs.into_boxed_slice(),
            taps,
            ports: Arc::new(ports),
            resources: self.resources.into_boxed_slice(),
            commands: self.commands.into_boxed_slice(),
            outlives_failure: self.outlives_failure,
            period,
            primitives: resolved.nodes.len(),
            count: 0,
            devices: self.devices.into_boxed_slice(),
            set_points: self.set_points.into_boxed_slice(),
            failures: self.failures.into_boxed_slice(),
            uses: self.uses.into_boxed_slice(),
            cost,
            memory: self.memory,
        })
    }
}

/// The debug taps of a net; `None` if a slot could not be built; the fault is already recorded.
fn taps(parts: &mut Parts, resolved: &Resolved<'_>) -> Option<Taps> {
    let tap = |tapped: &Tapped| {
        let node = &resolved.nodes[tapped.origin.node as usize];
        let mut guards = Vec::new();
        let mut guard = node.guard;
        while guard != 0 {
            guards.push(guard);
            guard = resolved.guards[guard as usize].parent;
        }
        let ty = node.definition.outputs[tapped.origin.port as usize].ty;
        let slot = (*parts.output(tapped.origin))?;
        Some((tapped.name.clone(), ty, tapped.seconds, slot, guards))
    };
    let taps: Option<Vec<_>> = resolved.taps.iter().map(tap).collect();
    Some(Taps::new(taps?))
}

/// The handle of a Boolean slot.
const fn boolean(slot: SlotRef) -> Option<In<bool>> {
    match slot {
        SlotRef::Scalar {
            element: bool::ELEMENT,
            slot,
        } => Some(In(slot, PhantomData)),
        SlotRef::Scalar { .. } | SlotRef::Array { .. } => None,
    }
}

pub(super) fn is_inside(resolved: &Resolved<'_>, mut inner: u32, outer: u32) -> bool {
    while inner != outer && inner != 0 {
        inner = resolved.guards[inner as usize].parent;
    }
    inner == outer
}

/// Appends steps in order and puts guards around them.
struct Walk<'r> {
    resolved: &'r Resolved<'r>,
    steps: Vec<Box<dyn Primitive>>,
    ops: Vec<Op>,
    /// Entered guards, outermost first, with the index of their op.
    open: Vec<(u32, usize)>,
    /// Number of ops when a guard was last left.
    left_at: Option<usize>,
}

impl<'r> Walk<'r> {
    fn new(resolved: &'r Resolved<'r>) -> Self {
        Self {
            resolved,
            steps: Vec::new(),
            ops: Vec::new(),
            open: Vec::new(),
            left_at: None,
        }
    }

    fn step(&mut self, guard: u32, step: Box<dyn Primitive>) {
        self.enter(guard);
        let first = number(self.steps.len());
        self.steps.push(step);
        let grows = self.can_extend_run();
        match self.ops.last_mut() {
            Some(Op::Run { end, .. }) if grows => *end = first + 1,
            _ => self.ops.push(Op::Run {
                first,
                end: first + 1,
            }),
        }
    }

    /// Whether the last op is a run that can be extended: no guard was left since.
    fn can_extend_run(&self) -> bool {
        self.left_at != Some(self.ops.len())
    }

    /// Leaves guards that do not enclose `guard` and enters those that do.
    fn enter(&mut self, guard: u32) {
        while let Some((open, op)) = self.open.last().copied() {
            if is_inside(self.resolved, guard, open) {
                break;
            }
            self.leave(op);
        }
        let mut path = Vec::new();
        let mut next = guard;
        while next != 0 && self.open.last().is_none_or(|(open, _)| *open != next) {
            path.push(next);
            next = self.resolved.guards[next as usize].parent;
        }
        for guard in path.into_iter().rev() {
            self.open.push((guard, self.ops.len()));
            self.ops.push(Op::Guard { guard, skip_to: 0 });
        }
    }

    fn leave(&mut self, op: usize) {
        self.open.pop();
        self.left_at = Some(self.ops.len());
        let end = number(self.ops.len());
        if let Some(Op::Guard { skip_to, .. }) = self.ops.get_mut(op) {
            *skip_to = end;
        }
    }

    /// Upper bound on the activation tests in one cycle.
    fn guard_tests(&self) -> usize {
        let is_guard = |op: &&Op| matches!(op, Op::Guard { .. });
        self.ops.iter().filter(is_guard).count()
    }

    /// Leaves all guards.
    fn close(&mut self) {
        while let Some((_, op)) = self.open.last().copied() {
            self.leave(op);
        }
    }
}

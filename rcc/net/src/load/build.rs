//! From an ordered net to a plan: slots, steps, guards. Every check that needs a parameter's value
//! or an array's size happens here, in the functions that build primitives.

use std::collections::HashMap;
use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use crate::definition::{ParameterType, Primitive};
use crate::device::{ArmBinding, Devices, Kinematics};
use crate::fault::{Fault, FaultKind};
use crate::limits::Limits;
use crate::load::LoadContext;
use crate::load::resolve::{Node, Origin, Resolved, Unit};
use crate::netcomm::{Directory, Mailbox};
use crate::plan::{Guard, Op, Plan, RootPort};
use crate::slots::{ArrayIn, ArrayOut, In, Out, SlotRef, SlotsBuilder};
use crate::value::text::{TextValue, ValueError, parse_array};
use crate::value::{Type, Value};

/// Marks what cannot be built because something before it could not; never shown.
pub(super) const fn inherited() -> FaultKind {
    FaultKind::ArraySize(String::new())
}

/// Builds the plan of an ordered net; `None` if that added faults.
pub(super) fn build(
    resolved: &Resolved<'_>,
    order: &[u32],
    context: &LoadContext<'_>,
    faults: &mut Vec<Fault>,
) -> Option<Plan> {
    let mut slots_before = Vec::with_capacity(resolved.nodes.len() + 1);
    let mut ports = 0;
    for node in &resolved.nodes {
        slots_before.push(ports);
        ports += node.definition.outputs.len();
    }
    let mut parts = Parts {
        slots: SlotsBuilder::default(),
        outputs: vec![None; ports],
        slots_before,
        states: HashMap::new(),
        resources: Vec::new(),
        devices: Vec::new(),
        inbox: Directory::default(),
        inbox_words: Vec::new(),
        outbox: Directory::default(),
        memory: 0,
    };
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
            context,
            parts: &mut parts,
            node,
            number,
        };
        match build(&mut builder) {
            Ok(step) => walk.step(node.guard, step),
            Err(fault) => faults.push(fault),
        }
    }
    if faults.len() > known {
        return None;
    }
    walk.close();
    parts.finish(walk, resolved, context.period)
}

/// What is collected over all primitives.
struct Parts {
    slots: SlotsBuilder,
    /// Slots of all out ports, by node and port; `None` until built.
    outputs: Vec<Option<SlotRef>>,
    /// Number of out ports of all nodes before each node.
    slots_before: Vec<usize>,
    /// Slots that the two steps of one primitive share.
    states: HashMap<(u32, usize), u32>,
    resources: Vec<String>,
    devices: Vec<String>,
    inbox: Directory,
    inbox_words: Vec<u64>,
    outbox: Directory,
    /// Bytes of arrays and histories.
    memory: usize,
}

impl Parts {
    fn output(&mut self, origin: Origin) -> &mut Option<SlotRef> {
        let before = self.slots_before[origin.node as usize];
        &mut self.outputs[before + origin.port as usize]
    }

    /// By guard: the slots inside that are read outside.
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

    /// `None` if a part could not be built, which has then been told.
    fn finish(mut self, walk: Walk<'_>, resolved: &Resolved<'_>, period: Duration) -> Option<Plan> {
        let guards = self.guards(resolved)?;
        let root_ports = self.root_ports(resolved)?;
        let terminate = root_ports.iter().find(|p| p.name == "outTerminate")?;
        let terminate = boolean(terminate.slot)?;
        let out_words = vec![0; self.outbox.words()];
        self.resources.sort();
        self.resources.dedup();
        self.devices.sort();
        self.devices.dedup();
        Some(Plan {
            slots: self.slots.finish(),
            steps: walk.steps.into_boxed_slice(),
            ops: walk.ops.into_boxed_slice(),
            guards,
            terminate,
            root_ports,
            inbox: Mailbox::new(self.inbox, &self.inbox_words),
            outbox: Mailbox::new(self.outbox, &out_words),
            resources: self.resources.into_boxed_slice(),
            period,
            primitives: resolved.nodes.len(),
            count: 0,
            devices: self.devices.into_boxed_slice(),
        })
    }
}

/// The handle of a slot that must be a Boolean.
const fn boolean(slot: SlotRef) -> Option<In<bool>> {
    match slot {
        SlotRef::Scalar {
            element: bool::ELEMENT,
            slot,
        } => Some(In(slot, PhantomData)),
        SlotRef::Scalar { .. } | SlotRef::Array { .. } => None,
    }
}

fn is_inside(resolved: &Resolved<'_>, mut inner: u32, outer: u32) -> bool {
    while inner != outer && inner != 0 {
        inner = resolved.guards[inner as usize].parent;
    }
    inner == outer
}

/// Puts steps behind one another and guards around them.
struct Walk<'r> {
    resolved: &'r Resolved<'r>,
    steps: Vec<Box<dyn Primitive>>,
    ops: Vec<Op>,
    /// Guards entered, outermost first, with the place of their op.
    open: Vec<(u32, usize)>,
    /// How many ops there were when a guard was last left.
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
        let first = count(self.steps.len());
        self.steps.push(step);
        let grows = self.same_place();
        match self.ops.last_mut() {
            Some(Op::Run { end, .. }) if grows => *end = first + 1,
            _ => self.ops.push(Op::Run {
                first,
                end: first + 1,
            }),
        }
    }

    /// Whether the last op is a run and no guard was left since, so that it may grow.
    fn same_place(&self) -> bool {
        self.left_at != Some(self.ops.len())
    }

    /// Leaves guards that `guard` is not in and enters those it is in.
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
        let end = count(self.ops.len());
        if let Some(Op::Guard { skip_to, .. }) = self.ops.get_mut(op) {
            *skip_to = end;
        }
    }

    /// Leaves all guards.
    fn close(&mut self) {
        while let Some((_, op)) = self.open.last().copied() {
            self.leave(op);
        }
    }
}

fn count(len: usize) -> u32 {
    u32::try_from(len).expect("Limits bounds the number of primitives far below 2^32")
}

/// What the function that builds a primitive works with.
pub struct Build<'b, 'n> {
    context: &'b LoadContext<'n>,
    parts: &'b mut Parts,
    node: &'b Node<'n>,
    number: u32,
}

impl std::fmt::Debug for Build<'_, '_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Build")
            .field("node", &self.node.name)
            .finish_non_exhaustive()
    }
}

impl Build<'_, '_> {
    /// Time from one cycle to the next.
    #[must_use]
    pub fn period(&self) -> Duration {
        self.context.period
    }

    /// Bounds on the net.
    #[must_use]
    pub fn limits(&self) -> &Limits {
        &self.context.limits
    }

    /// The devices there are.
    #[must_use]
    pub fn devices(&self) -> &dyn Devices {
        self.context.devices
    }

    /// The robot arm that parameter `parameter` names.
    ///
    /// # Errors
    /// If there is no such arm.
    pub fn arm(&self, parameter: &'static str) -> Result<ArmBinding, Fault> {
        let name = self.text(parameter);
        self.devices().arm(name).ok_or_else(|| {
            let kind = FaultKind::Device {
                kind: "robot arm",
                name: name.to_owned(),
                known: self.devices().names(),
            };
            self.at_parameter(parameter, kind, None)
        })
    }

    /// The geometry of the robot arm that parameter `parameter` names.
    ///
    /// # Errors
    /// If there is no such arm, or its geometry is not known.
    pub fn kinematics(&self, parameter: &'static str) -> Result<Arc<dyn Kinematics>, Fault> {
        let why = || format!("the kinematics of `{}` is not known", self.text(parameter));
        self.arm(parameter)?
            .kinematics
            .ok_or_else(|| self.parameter_fault(parameter, why()))
    }

    /// Claims something of a device for this net alone; if the device fails, the net ends.
    pub fn claim(&mut self, device: &str, resource: String) {
        self.parts.resources.push(resource);
        self.parts.devices.push(device.to_owned());
    }

    /// Whether an in port is connected.
    #[must_use]
    pub fn is_linked(&self, port: &str) -> bool {
        self.node
            .definition
            .input_named(port)
            .is_some_and(|i| self.node.links[i].is_some())
    }

    /// The handle of a scalar in port. Unconnected, it reads the parameter that stands in for it,
    /// or null.
    ///
    /// # Errors
    /// If that parameter's text is no value of the port's type.
    ///
    /// # Panics
    /// If the definition has no such port: it contradicts its own build function.
    pub fn input<T: TextValue>(&mut self, port: &str) -> Result<In<T>, Fault> {
        let (slot, parameter) = self.source(port, Type::scalar(T::ELEMENT))?;
        let slot = match (slot, parameter) {
            (Some(SlotRef::Scalar { slot, .. }), _) => slot,
            (None, Some(parameter)) => {
                let value = self.value::<T>(parameter)?;
                constant(&mut self.parts.slots, value)
            }
            _ => 0,
        };
        Ok(In(slot, PhantomData))
    }

    /// The handle of an in port that carries a fixed array. Unconnected, it reads the parameter
    /// that stands in for it, or null.
    ///
    /// # Errors
    /// If what feeds the port could not be built, or that parameter's text is no such array.
    ///
    /// # Panics
    /// If the definition has no such port.
    pub fn array_input<T: TextValue>(&mut self, port: &str) -> Result<ArrayIn<T>, Fault> {
        let slot = match self.source(port, Type::array(T::ELEMENT))? {
            (Some(SlotRef::Array { slot, .. }), _) => slot,
            (None, Some(parameter)) => {
                let values = self.array::<T>(parameter)?;
                self.take_memory(size_of_val(&*values))?;
                let slots = T::builder(&mut self.parts.slots);
                slots.array(values.len(), T::default(), Some(&values))
            }
            _ => crate::slots::ArraySlot::default(),
        };
        Ok(ArrayIn(slot, PhantomData))
    }

    /// A handle that always reads `value`: for a port whose stand-in is made of more than one
    /// parameter.
    pub fn constant<T: Value>(&mut self, value: T) -> In<T> {
        In(constant(&mut self.parts.slots, value), PhantomData)
    }

    /// How many samples of `size` bytes, one a cycle, the span of parameter `parameter` (s) takes,
    /// at least 1. Counts them to the memory of the net.
    ///
    /// # Errors
    /// If the span is no positive time, too long for one primitive, or the net's memory is used up.
    ///
    /// # Panics
    /// If the definition has no such parameter.
    pub fn history(&mut self, parameter: &'static str, size: usize) -> Result<usize, Fault> {
        let samples = self.cycles_in(parameter, self.value(parameter)?)?;
        self.take_memory(samples.saturating_mul(size))?;
        Ok(samples)
    }

    /// Counts `bytes` to the memory of the net.
    ///
    /// # Errors
    /// If the net's memory is used up.
    pub fn take_memory(&mut self, bytes: usize) -> Result<(), Fault> {
        let bound = self.limits().memory_bytes;
        let found = self.parts.memory.saturating_add(bytes);
        if found > bound {
            let what = "bytes of arrays and histories";
            return Err(self.fault(FaultKind::Bound { what, found, bound }));
        }
        self.parts.memory = found;
        Ok(())
    }

    /// Where an in port gets its values: the slot it is linked to, or a parameter.
    fn source(
        &mut self,
        port: &str,
        ty: Type,
    ) -> Result<(Option<SlotRef>, Option<&'static str>), Fault> {
        let definition = self.node.definition;
        let number = definition
            .input_named(port)
            .unwrap_or_else(|| contradiction(&definition.name, "in port", port));
        let declared = &definition.inputs[number];
        assert_eq!(declared.ty, ty, "in port {port} of {}", definition.name);
        match self.node.links[number] {
            None => Ok((None, declared.parameter)),
            Some(origin) => match *self.parts.output(origin) {
                Some(slot) => Ok((Some(slot), None)),
                None => Err(Fault::new(inherited(), self.node.at.clone())),
            },
        }
    }

    /// The handle of a scalar out port.
    ///
    /// # Panics
    /// If the definition has no such port.
    pub fn output<T: Value>(&mut self, port: &str) -> Out<T> {
        let origin = self.own_output(port, Type::scalar(T::ELEMENT));
        let slot = match *self.parts.output(origin) {
            Some(slot) => slot,
            None => {
                let slot = self.parts.slots.scalar(T::ELEMENT);
                *self.parts.output(origin) = Some(slot);
                slot
            }
        };
        let SlotRef::Scalar { slot, .. } = slot else {
            return Out(0, PhantomData);
        };
        Out(slot, PhantomData)
    }

    /// The handle of an out port that carries `len` elements.
    ///
    /// # Errors
    /// If `len` exceeds its bound or the net's memory is used up.
    ///
    /// # Panics
    /// If the definition has no such port.
    pub fn array_output<T: Value>(&mut self, port: &str, len: usize) -> Result<ArrayOut<T>, Fault> {
        let bound = self.limits().array_size;
        if len > bound {
            let kind = FaultKind::Bound {
                what: "elements in one array",
                found: len,
                bound,
            };
            return Err(self.fault(kind));
        }
        self.take_memory(len * size_of::<T>())?;
        let origin = self.own_output(port, Type::array(T::ELEMENT));
        let slot = self.parts.slots.array(T::ELEMENT, len);
        *self.parts.output(origin) = Some(slot);
        let SlotRef::Array { slot, .. } = slot else {
            return Err(Fault::new(inherited(), self.node.at.clone()));
        };
        Ok(ArrayOut(slot, PhantomData))
    }

    fn own_output(&self, port: &str, ty: Type) -> Origin {
        let definition = self.node.definition;
        let number = definition
            .output_named(port)
            .unwrap_or_else(|| contradiction(&definition.name, "out port", port));
        assert_eq!(
            definition.outputs[number].ty, ty,
            "out port {port} of {}",
            definition.name
        );
        Origin {
            node: self.number,
            port: count(number),
        }
    }

    /// A slot beside the ports, shared by the two steps of a primitive with an early one.
    pub fn state<T: TextValue>(&mut self, number: usize) -> (In<T>, Out<T>) {
        let slots = &mut self.parts.slots;
        let slot = *self
            .parts
            .states
            .entry((self.number, number))
            .or_insert_with(|| match slots.scalar(T::ELEMENT) {
                SlotRef::Scalar { slot, .. } => slot,
                SlotRef::Array { .. } => 0,
            });
        (In(slot, PhantomData), Out(slot, PhantomData))
    }

    /// The text of a parameter, or its default.
    ///
    /// # Panics
    /// If the definition has no such parameter.
    #[must_use]
    pub fn text(&self, parameter: &'static str) -> &str {
        self.parameter(parameter).0
    }

    /// A parameter's text and, if it was given, the place of its first byte.
    fn parameter(&self, parameter: &str) -> (&str, Option<usize>) {
        let definition = self.node.definition;
        let number = definition
            .parameter_named(parameter)
            .unwrap_or_else(|| contradiction(&definition.name, "parameter", parameter));
        match self.node.texts[number] {
            Some((text, start)) => (text, Some(start)),
            None => (definition.parameters[number].default, None),
        }
    }

    /// The value of a parameter.
    ///
    /// # Errors
    /// If its text is no value of this type.
    ///
    /// # Panics
    /// If the definition has no such parameter, or with another type.
    pub fn value<T: TextValue>(&self, parameter: &'static str) -> Result<T, Fault> {
        self.check_type(parameter, Type::scalar(T::ELEMENT));
        T::parse(self.text(parameter)).map_err(|e| self.value_fault(parameter, e))
    }

    /// The elements of a parameter that is a fixed array.
    ///
    /// # Errors
    /// If its text is no list of such values, or too long.
    ///
    /// # Panics
    /// If the definition has no such parameter, or with another type.
    pub fn array<T: TextValue>(&self, parameter: &'static str) -> Result<Vec<T>, Fault> {
        self.check_type(parameter, Type::array(T::ELEMENT));
        parse_array(self.text(parameter), self.limits().array_size)
            .map_err(|e| self.value_fault(parameter, e))
    }

    /// The value of a parameter that counts something: a whole number in a range.
    ///
    /// # Errors
    /// If it is none.
    ///
    /// # Panics
    /// If the definition has no such parameter, or with another type.
    pub fn number(
        &self,
        parameter: &'static str,
        range: std::ops::RangeInclusive<usize>,
    ) -> Result<usize, Fault> {
        let value: i32 = self.value(parameter)?;
        usize::try_from(value)
            .ok()
            .filter(|v| range.contains(v))
            .ok_or_else(|| {
                let why = format!(
                    "{value} is not between {} and {}",
                    range.start(),
                    range.end()
                );
                self.parameter_fault(parameter, why)
            })
    }

    fn check_type(&self, parameter: &str, ty: Type) {
        let definition = self.node.definition;
        let declared = definition
            .parameter_named(parameter)
            .map(|i| definition.parameters[i].ty);
        assert_eq!(
            declared,
            Some(ParameterType::Value(ty)),
            "parameter {parameter} of {}",
            definition.name
        );
    }

    /// A fault of a parameter's value.
    #[must_use]
    pub fn parameter_fault(&self, parameter: &'static str, why: String) -> Fault {
        let kind = FaultKind::Parameter {
            parameter: parameter.to_owned(),
            why,
        };
        self.at_parameter(parameter, kind, None)
    }

    fn value_fault(&self, parameter: &'static str, error: ValueError) -> Fault {
        let kind = FaultKind::Parameter {
            parameter: parameter.to_owned(),
            why: error.what,
        };
        self.at_parameter(parameter, kind, Some(error.at))
    }

    fn at_parameter(
        &self,
        parameter: &str,
        kind: FaultKind,
        within: Option<std::ops::Range<usize>>,
    ) -> Fault {
        let (text, start) = self.parameter(parameter);
        let at = match (start, within) {
            (Some(start), Some(within)) => start + within.start..start + within.end,
            (Some(start), None) => start..start + text.len(),
            (None, _) => self.node.at.clone(),
        };
        Fault::new(kind, at)
    }

    /// A fault of this primitive.
    #[must_use]
    pub fn fault(&self, kind: FaultKind) -> Fault {
        Fault::new(kind, self.node.at.clone())
    }

    /// Makes a value that programs can read, `len` elements of it if an array.
    ///
    /// # Errors
    /// If the key is taken or the bound on netcomm values is reached.
    pub fn netcomm_out<T: Value>(
        &mut self,
        key: &str,
        array: Option<usize>,
        report: bool,
    ) -> Result<usize, Fault> {
        let key = format!("out{key}");
        if self.parts.outbox.find(&key).is_some() {
            let why = "another primitive gives one out under this `Key`; each needs its own";
            return Err(self.fault(FaultKind::Netcomm { key, why }));
        }
        self.check_netcomm_bound()?;
        let ty = Type {
            element: T::ELEMENT,
            array: array.is_some(),
        };
        let words = array.unwrap_or(1) * T::WORDS;
        Ok(self.parts.outbox.add(key, ty, words, report))
    }

    /// Makes a value that programs can write, or finds the one that shares the key.
    ///
    /// # Errors
    /// If the key is taken with another type or size, or the bound on netcomm values is reached.
    pub fn netcomm_in<T: Value>(
        &mut self,
        key: &str,
        array: bool,
        initial: &[T],
    ) -> Result<usize, Fault> {
        let key = format!("in{key}");
        let ty = Type {
            element: T::ELEMENT,
            array,
        };
        let words = initial.len() * T::WORDS;
        if let Some(entry) = self.parts.inbox.find(&key) {
            if entry.ty == ty && entry.value_words() == words {
                return Ok(entry.at());
            }
            let why = "another primitive takes it in with a different type or size";
            return Err(self.fault(FaultKind::Netcomm { key, why }));
        }
        self.check_netcomm_bound()?;
        let at = self.parts.inbox.add(key, ty, words, true);
        let box_words = &mut self.parts.inbox_words;
        box_words.resize(self.parts.inbox.words() - words, 0);
        for value in initial {
            let start = box_words.len();
            box_words.resize(start + T::WORDS, 0);
            value.put(|i, w| box_words[start + i] = w);
        }
        Ok(at)
    }

    fn check_netcomm_bound(&self) -> Result<(), Fault> {
        let bound = self.limits().netcomm;
        let found = self.parts.inbox.entries().len() + self.parts.outbox.entries().len() + 1;
        if found > bound {
            return Err(self.fault(FaultKind::Bound {
                what: "netcomm values",
                found,
                bound,
            }));
        }
        Ok(())
    }
}

fn constant<T: Value>(slots: &mut SlotsBuilder, value: T) -> u32 {
    T::builder(slots).scalar(Some(value))
}

/// A definition's data and its build function do not agree; the test that builds every primitive
/// finds this before any user can.
#[expect(
    clippy::panic,
    reason = "a fault of this program, found by the test of all definitions"
)]
fn contradiction(primitive: &str, what: &str, name: &str) -> ! {
    panic!("{primitive} has no {what} {name}")
}

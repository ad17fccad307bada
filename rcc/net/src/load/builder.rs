//! The context of a primitive's build function: port handles, parameter values, faults with
//! locations, and claims on resources that nets share. The order of primitives is not known here.

use std::marker::PhantomData;
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::time::Duration;

use crate::definition::ParameterType;
use crate::device::{ArmBinding, Devices, Interfaces, Kinematics, Target};
use crate::fault::{Fault, FaultKind};
use crate::limits::Limits;
use crate::load::origin::{self, Origin};
use crate::load::parts::{Effects, Parts, inherited};
use crate::load::resolved::Node;
use crate::set_points::{SetPointCounters, SetPoints};
use crate::slots::{ArrayIn, ArrayOut, In, Out, SlotRef, SlotsBuilder};
use crate::value::text::{TextValue, ValueError, parse_array_as};
use crate::value::unit::Quantity;
use crate::value::{Type, Value};

/// The context of a primitive's build function.
pub struct Build<'b, 'n> {
    pub(super) devices: &'b dyn Devices,
    pub(super) period: Duration,
    pub(super) limits: &'b Limits,
    pub(super) parts: &'b mut Parts,
    pub(super) node: &'b Node<'n>,
    pub(super) number: u32,
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
    pub fn period(&self) -> Duration {
        self.period
    }

    /// Bounds on the net.
    pub fn limits(&self) -> &Limits {
        self.limits
    }

    /// The available devices.
    pub fn devices(&self) -> &dyn Devices {
        self.devices
    }

    /// The robot arm named by parameter `parameter`.
    pub fn arm(&mut self, parameter: &'static str) -> Result<ArmBinding, Fault> {
        self.device(parameter, "robot arm", |devices, name| devices.arm(name))
    }

    /// An interface of the device named by parameter `parameter`; `kind` names the kind of device
    /// in error messages.
    ///
    /// # Errors
    /// If there is no device with that name, or it does not have that interface.
    pub fn interface<T>(
        &mut self,
        parameter: &'static str,
        kind: &'static str,
        pick: impl Fn(&Interfaces) -> Option<T>,
    ) -> Result<T, Fault> {
        self.device(parameter, kind, |devices, name| {
            pick(&devices.interfaces(name)?)
        })
    }

    fn device<T>(
        &mut self,
        parameter: &'static str,
        kind: &'static str,
        find: impl Fn(&dyn Devices, &str) -> Option<T>,
    ) -> Result<T, Fault> {
        let name = self.text(parameter).to_owned();
        self.parts.uses.push(name.clone());
        self.effects().device = Some(name.clone());
        let devices = self.devices;
        find(devices, &name).ok_or_else(|| {
            let mut known = devices.names();
            known.retain(|name| find(devices, name).is_some());
            self.at_parameter(parameter, FaultKind::Device { kind, name, known }, None)
        })
    }

    /// The geometry of the robot arm named by parameter `parameter`.
    ///
    /// # Errors
    /// If there is no such arm, or its geometry is not known.
    pub fn kinematics(&mut self, parameter: &'static str) -> Result<Arc<dyn Kinematics>, Fault> {
        let why = format!("the kinematics of `{}` are not known", self.text(parameter));
        let arm = self.arm(parameter)?;
        arm.kinematics.ok_or_else(|| self.arm_fault(parameter, why))
    }

    /// A fault of the arm named by parameter `parameter`: it is not as the primitive needs it.
    #[must_use]
    pub fn arm_fault(&self, parameter: &'static str, why: String) -> Fault {
        let kind = FaultKind::Arm {
            parameter: parameter.to_owned(),
            why,
        };
        self.at_parameter(parameter, kind, None)
    }

    /// Claims a device resource for this net alone; if the device fails, the net ends.
    pub fn claim(&mut self, device: &str, resource: String) {
        self.hold(resource);
        self.parts.devices.push(device.to_owned());
    }

    /// Claims a resource for this net alone that it may use even if the device does not follow
    /// commands.
    pub fn hold(&mut self, resource: String) {
        self.effects().acts = true;
        self.parts.resources.push(resource);
    }

    /// Declares a command of the primitive. If a rule starts this net in place of another that gave
    /// the command, the command stays in force until this net's first cycle; commands that are not
    /// declared here end with the previous net.
    pub fn commands(&mut self, target: Target) {
        self.parts.commands.push(target);
        let effects = self.effects();
        effects.commands.push(target);
        effects.acts = true;
    }

    /// Declares that the net handles failures of its devices: it goes on for that time, the shortest of all declared, and
    /// is then ended. Without it, it ends at once.
    pub fn outlives_failure(&mut self, time: Duration) {
        let known = self.parts.outlives_failure.get_or_insert(time);
        *known = time.min(*known);
    }

    /// Counters of the set-points that the primitive gives to a part of a device, such as `joint 3`, in that unit and
    /// within that range.
    pub fn set_points(
        &mut self,
        device: &str,
        part: String,
        unit: &'static str,
        range: [f64; 2],
    ) -> Arc<SetPointCounters> {
        let counters = Arc::default();
        self.parts.set_points.push(SetPoints {
            primitive: self.node.name.to_owned(),
            device: device.to_owned(),
            part,
            unit,
            range,
            counters: Arc::clone(&counters),
        });
        counters
    }

    /// Declares which values of an in port can be meant; a check warns of a constant beyond.
    pub fn expects(&mut self, port: &str, range: RangeInclusive<f64>) {
        if let Some(number) = self.node.definition.input_named(port) {
            self.effects().expected.push((number, range));
        }
    }

    /// What is known of the effects of this primitive.
    pub(super) fn effects(&mut self) -> &mut Effects {
        &mut self.parts.effects[self.number as usize]
    }

    /// Whether an in port is connected.
    pub fn is_linked(&self, port: &str) -> bool {
        self.node
            .definition
            .input_named(port)
            .is_some_and(|i| self.node.links[i].is_some())
    }

    /// The handle of a scalar in port. Unconnected, it reads the port's parameter, or null.
    ///
    /// # Errors
    /// If the parameter's text is not a value of the port's type.
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

    /// The handle of an in port that carries a fixed array. Unconnected, it reads the port's
    /// parameter, or null.
    ///
    /// # Errors
    /// If the port's source could not be built, or the parameter's text is not such an array.
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
        self.parts.elements += slot.len as usize;
        Ok(ArrayIn(slot, PhantomData))
    }

    /// Adds work to the cost bound of this instance that its links or parameters cause, as if it had that many more
    /// array elements.
    pub const fn adds_elements(&mut self, elements: usize) {
        self.parts.elements += elements;
    }

    /// A handle that always reads `value`: for a port whose default consists of several parameters.
    pub fn constant<T: Value>(&mut self, value: T) -> In<T> {
        In(constant(&mut self.parts.slots, value), PhantomData)
    }

    /// Number of samples of `size` bytes in the span of parameter `parameter` (s), one for each
    /// cycle, at least 1. Adds them to the net's memory.
    ///
    /// # Errors
    /// If the span is not positive, too long for one primitive, or exceeds the net's memory.
    ///
    /// # Panics
    /// If the definition has no such parameter.
    pub fn history(&mut self, parameter: &'static str, size: usize) -> Result<usize, Fault> {
        let samples = self.cycles_in(parameter, self.value(parameter)?)?;
        self.take_memory(samples.saturating_mul(size))?;
        Ok(samples)
    }

    /// Adds `bytes` to the net's memory: what a primitive keeps for parameters of any size.
    ///
    /// # Errors
    /// If the net then has more than it may.
    pub fn take_memory(&mut self, bytes: usize) -> Result<(), Fault> {
        let bound = self.limits().memory_bytes;
        let found = self.parts.memory.saturating_add(bytes);
        if found > bound {
            let item = "bytes of arrays and histories";
            return Err(self.fault(FaultKind::Bound { item, found, bound }));
        }
        self.parts.memory = found;
        Ok(())
    }

    /// The source of an in port: the slot that it is linked to, or a parameter.
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
    /// If `len` exceeds its bound, or the net's memory is exceeded.
    ///
    /// # Panics
    /// If the definition has no such port.
    pub fn array_output<T: Value>(&mut self, port: &str, len: usize) -> Result<ArrayOut<T>, Fault> {
        let bound = self.limits().array_size;
        if len > bound {
            let kind = FaultKind::Bound {
                item: "elements in one array",
                found: len,
                bound,
            };
            return Err(self.fault(kind));
        }
        self.take_memory(len * size_of::<T>())?;
        self.parts.elements += len;
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
            port: origin::number(number),
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
    pub fn text(&self, parameter: &'static str) -> &str {
        self.parameter(parameter).0
    }

    /// A parameter's text and, if it was set, the index of its first byte.
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
    /// If its text is not a value of this type.
    ///
    /// # Panics
    /// If the definition has no such parameter, or with another type.
    pub fn value<T: TextValue>(&self, parameter: &'static str) -> Result<T, Fault> {
        let quantity = self.quantity(parameter, Type::scalar(T::ELEMENT));
        let value = T::parse_as(self.text(parameter), quantity);
        value.map_err(|e| self.value_fault(parameter, e))
    }

    /// The elements of a parameter that is a fixed array.
    ///
    /// # Errors
    /// If its text is not a list of such values, or the list is too long.
    ///
    /// # Panics
    /// If the definition has no such parameter, or with another type.
    pub fn array<T: TextValue>(&self, parameter: &'static str) -> Result<Vec<T>, Fault> {
        let quantity = self.quantity(parameter, Type::array(T::ELEMENT));
        let values = parse_array_as(self.text(parameter), self.limits().array_size, quantity);
        values.map_err(|e| self.value_fault(parameter, e))
    }

    /// The value of a counting parameter: a whole number in a range.
    ///
    /// # Errors
    /// If it is not such a number.
    ///
    /// # Panics
    /// If the definition has no such parameter, or with another type.
    pub fn number(
        &self,
        parameter: &'static str,
        range: RangeInclusive<usize>,
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

    /// The value of a parameter: a number in a range.
    ///
    /// # Errors
    /// If it is not such a number.
    ///
    /// # Panics
    /// If the definition has no such parameter, or with another type.
    pub fn double(
        &self,
        parameter: &'static str,
        range: RangeInclusive<f64>,
    ) -> Result<f64, Fault> {
        let value: f64 = self.value(parameter)?;
        if range.contains(&value) {
            return Ok(value);
        }
        let (least, most) = range.into_inner();
        let why = format!("{value} is not between {least} and {most}");
        Err(self.parameter_fault(parameter, why))
    }

    /// The quantity of a parameter of that type.
    fn quantity(&self, parameter: &str, ty: Type) -> Quantity {
        let definition = self.node.definition;
        let declared = definition.parameter_named(parameter);
        let declared = declared.map(|i| &definition.parameters[i]);
        assert_eq!(
            declared.map(|declared| declared.ty),
            Some(ParameterType::Value(ty)),
            "parameter {parameter} of {}",
            definition.name
        );
        declared.map_or(Quantity::Number, |declared| declared.quantity)
    }

    /// A fault of a parameter's value.
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
            why: error.message,
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
    pub fn fault(&self, kind: FaultKind) -> Fault {
        Fault::new(kind, self.node.at.clone())
    }

    /// Allocates a value that programs can read; of `len` elements if it is an array.
    ///
    /// # Errors
    /// If the key is in use or the bound on netcomm values is reached.
    pub(crate) fn netcomm_out<T: Value>(
        &mut self,
        key: &str,
        array: Option<usize>,
        report: bool,
    ) -> Result<usize, Fault> {
        let key = format!("out{key}");
        if self.parts.outbox.find(&key).is_some() {
            let why = "another primitive writes an out value with this `Key`; each needs its own";
            return Err(self.fault(FaultKind::Netcomm { key, why }));
        }
        self.check_netcomm_bound()?;
        let ty = Type {
            element: T::ELEMENT,
            array: array.is_some(),
        };
        let words = array.unwrap_or(1) * T::WORDS;
        self.effects().acts = true;
        Ok(self.parts.outbox.add(key, ty, words, report))
    }

    /// Allocates a value that programs can write, or returns the one with the same key.
    ///
    /// # Errors
    /// If the key is in use with another type or size, or the bound on netcomm values is reached.
    pub(crate) fn netcomm_in<T: Value>(
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
            let why = "another primitive reads it with a different type or size";
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

    pub(super) fn check_netcomm_bound(&self) -> Result<(), Fault> {
        let bound = self.limits().netcomm;
        let found = self.parts.inbox.entries().len() + self.parts.outbox.entries().len() + 1;
        if found > bound {
            return Err(self.fault(FaultKind::Bound {
                item: "netcomm values",
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

/// A definition's data and its build function contradict each other; the test that builds every
/// primitive finds this before any user can.
#[expect(
    clippy::panic,
    reason = "a fault of this program, found by the test of all definitions"
)]
fn contradiction(primitive: &str, item: &str, name: &str) -> ! {
    panic!("{primitive} has no {item} {name}")
}

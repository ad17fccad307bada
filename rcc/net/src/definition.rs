//! The definition of a primitive: its data (name, ports, parameters, null rule), from which the
//! registry, the help and the tests are generated, and the function that builds an instance of it.
//!
//! Most primitives are a [`function`] of their inputs: one table row. Those with state are a struct
//! of typed slot handles and parameters with one [`Primitive::step`].

use std::time::Duration;

use crate::cost::Cost;
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};
use crate::value::unit::Quantity;
use crate::value::{Element, Type, Value};

pub use crate::load::Build;

/// Cost bound of a primitive of a few operations on a present-day host with cold caches: about ten
/// times its usual cost.
const COST: Cost = Cost {
    first_ns: 200.0,
    ns: 40.0,
    element_ns: 10.0,
};

/// One instance of a primitive in a plan.
pub trait Primitive: Send {
    /// Computes one cycle: reads in ports, writes out ports. It must not allocate, lock, wait or
    /// panic, and its work is bounded at load time.
    fn step(&mut self, cycle: &Cycle<'_>);
}

/// An in port.
#[derive(Clone, Debug)]
pub struct InPort {
    /// Name, such as `inFirst`.
    pub name: &'static str,
    /// What it means, with its unit.
    pub doc: &'static str,
    /// Type of its values.
    pub ty: Type,
    /// What its numbers measure, as the doc says.
    pub quantity: Quantity,
    /// Whether a net without a link here is rejected.
    pub required: bool,
    /// Parameter whose value is used when the port is not connected.
    pub parameter: Option<&'static str>,
}

/// An out port.
#[derive(Clone, Debug)]
pub struct OutPort {
    /// Name, such as `outValue`.
    pub name: &'static str,
    /// What it means, with its unit.
    pub doc: &'static str,
    /// Type of its values.
    pub ty: Type,
    /// What its numbers measure, as the doc says.
    pub quantity: Quantity,
}

/// Type of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterType {
    /// Any text, such as a device's name.
    Text,
    /// A value.
    Value(Type),
}

/// A parameter: set in the net text, constant while the net runs.
#[derive(Clone, Debug)]
pub struct Parameter {
    /// Name, such as `First`.
    pub name: &'static str,
    /// What it means, with its unit.
    pub doc: &'static str,
    /// Type of its value.
    pub ty: ParameterType,
    /// What its numbers measure, as the doc says; a text that sets it may have such a unit.
    pub quantity: Quantity,
    /// Text of the default value.
    pub default: &'static str,
}

/// How a primitive handles null.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NullRule {
    /// Any input null makes all outputs null.
    Propagates,
    /// Three-valued logic after Kleene: null is "unknown".
    Kleene,
    /// As this sentence states; while a required in port is null, so are all outputs.
    Requires(&'static str),
    /// As this sentence states.
    Own(&'static str),
}

impl NullRule {
    /// The rule as a sentence.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Propagates => "any input null makes all outputs null",
            Self::Kleene => "null is unknown, as in three-valued logic",
            Self::Requires(sentence) | Self::Own(sentence) => sentence,
        }
    }
}

type BuildFn = dyn Fn(&mut Build<'_, '_>) -> Result<Box<dyn Primitive>, Fault> + Send + Sync;

/// The definition of a primitive type.
pub struct Definition {
    /// Full name, such as `Core::DoubleAdd`.
    pub name: String,
    /// What it does, in sentences.
    pub doc: &'static str,
    /// In ports, including `inActive` if there is one.
    pub inputs: Vec<InPort>,
    /// Out ports.
    pub outputs: Vec<OutPort>,
    /// Parameters.
    pub parameters: Vec<Parameter>,
    /// How it handles null.
    pub null: NullRule,
    /// Upper bound on the cost of one cycle: an estimate for a present-day host, until
    /// [`Registry::set_costs`](crate::Registry::set_costs) replaces it by a measured one.
    pub cost: Cost,
    /// Its source file, relative to the root of its workspace.
    pub source: &'static str,
    /// Whether `inActive` switches it off; the plan then skips it and its outputs are null.
    pub(crate) gated: bool,
    pub(crate) build: Box<BuildFn>,
    /// For a primitive whose outputs do not depend on its inputs of the same cycle: builds the step
    /// that writes the outputs before all steps that read them.
    pub(crate) early: Option<Box<BuildFn>>,
}

impl std::fmt::Debug for Definition {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Definition")
            .field("name", &self.name)
            .finish_non_exhaustive()
    }
}

impl Definition {
    /// A primitive without ports; the methods below add its ports and parameters. Its source is the
    /// file of the caller.
    #[track_caller]
    pub fn new<P: Primitive + 'static>(
        name: impl Into<String>,
        doc: &'static str,
        build: impl Fn(&mut Build<'_, '_>) -> Result<P, Fault> + Send + Sync + 'static,
    ) -> Self {
        Self {
            name: name.into(),
            doc,
            inputs: Vec::new(),
            outputs: Vec::new(),
            parameters: Vec::new(),
            null: NullRule::Propagates,
            cost: COST,
            source: std::panic::Location::caller().file(),
            gated: false,
            build: Box::new(move |b| Ok(Box::new(build(b)?))),
            early: None,
        }
    }

    /// Adds an in port.
    #[must_use]
    pub fn input<T: Value>(self, port: Port) -> Self {
        self.port_in(port, Type::scalar(T::ELEMENT))
    }

    /// Adds an in port that carries a fixed array.
    #[must_use]
    pub fn array_input<T: Value>(self, port: Port) -> Self {
        self.port_in(port, Type::array(T::ELEMENT))
    }

    fn port_in(mut self, port: Port, ty: Type) -> Self {
        let Port {
            name,
            doc,
            required,
            parameter,
        } = port;
        if let Some((parameter, default)) = parameter {
            let value = ParameterType::Value(ty);
            self = self.any_parameter(parameter, doc, value, default);
        }
        let parameter = parameter.map(|(name, _)| name);
        self.inputs.push(InPort {
            name,
            doc,
            ty,
            quantity: quantity(ty, doc),
            required,
            parameter,
        });
        self
    }

    /// Adds an out port.
    #[must_use]
    pub fn output<T: Value>(self, name: &'static str, doc: &'static str) -> Self {
        self.port_out(name, doc, Type::scalar(T::ELEMENT))
    }

    /// Adds an out port that carries a fixed array.
    #[must_use]
    pub fn array_output<T: Value>(self, name: &'static str, doc: &'static str) -> Self {
        self.port_out(name, doc, Type::array(T::ELEMENT))
    }

    fn port_out(mut self, name: &'static str, doc: &'static str, ty: Type) -> Self {
        self.outputs.push(OutPort {
            name,
            doc,
            ty,
            quantity: quantity(ty, doc),
        });
        self
    }

    /// Adds a parameter of a value type.
    #[must_use]
    pub fn parameter<T: Value>(
        self,
        name: &'static str,
        default: &'static str,
        doc: &'static str,
    ) -> Self {
        self.any_parameter(
            name,
            doc,
            ParameterType::Value(Type::scalar(T::ELEMENT)),
            default,
        )
    }

    /// Adds a parameter that is a fixed array.
    #[must_use]
    pub fn array_parameter<T: Value>(
        self,
        name: &'static str,
        default: &'static str,
        doc: &'static str,
    ) -> Self {
        self.any_parameter(
            name,
            doc,
            ParameterType::Value(Type::array(T::ELEMENT)),
            default,
        )
    }

    /// Adds a text parameter.
    #[must_use]
    pub fn text(self, name: &'static str, doc: &'static str) -> Self {
        self.any_parameter(name, doc, ParameterType::Text, "")
    }

    /// Adds a text parameter with a default.
    #[must_use]
    pub fn text_with_default(
        self,
        name: &'static str,
        default: &'static str,
        doc: &'static str,
    ) -> Self {
        self.any_parameter(name, doc, ParameterType::Text, default)
    }

    fn any_parameter(
        mut self,
        name: &'static str,
        doc: &'static str,
        ty: ParameterType,
        default: &'static str,
    ) -> Self {
        let quantity = match ty {
            ParameterType::Text => Quantity::Number,
            ParameterType::Value(ty) => quantity(ty, doc),
        };
        self.parameters.push(Parameter {
            name,
            doc,
            ty,
            quantity,
            default,
        });
        self
    }

    /// Adds `inActive`: while it is connected and not true, the primitive is skipped, its state is
    /// kept and its outputs are null.
    #[must_use]
    pub fn active(mut self) -> Self {
        self.gated = true;
        self.input::<bool>(port("inActive", "skips the primitive while false or null"))
    }

    /// Adds `inActive` and `inReset`, for primitives with state.
    #[must_use]
    pub fn stateful(self) -> Self {
        self.active()
            .input::<bool>(port("inReset", "true resets the state"))
    }

    /// Sets how it handles null.
    #[must_use]
    pub const fn null(mut self, rule: NullRule) -> Self {
        self.null = rule;
        self
    }

    /// Sets the cost bound of one cycle, ns, for a primitive that computes more than a few lines.
    #[must_use]
    pub fn cost_ns(mut self, cost_ns: u32) -> Self {
        self.cost.ns = f64::from(cost_ns);
        self
    }

    /// Declares that the outputs do not depend on inputs of the same cycle, and how they are
    /// written.
    #[must_use]
    pub fn early<P: Primitive + 'static>(
        mut self,
        build: impl Fn(&mut Build<'_, '_>) -> Result<P, Fault> + Send + Sync + 'static,
    ) -> Self {
        self.early = Some(Box::new(move |b| Ok(Box::new(build(b)?))));
        self
    }

    pub(crate) fn input_named(&self, name: &str) -> Option<usize> {
        self.inputs.iter().position(|p| p.name == name)
    }

    pub(crate) fn output_named(&self, name: &str) -> Option<usize> {
        self.outputs.iter().position(|p| p.name == name)
    }

    pub(crate) fn parameter_named(&self, name: &str) -> Option<usize> {
        self.parameters.iter().position(|p| p.name == name)
    }
}

/// The quantity of a port or parameter. The types of rotations, frames and twists define those of
/// their components.
fn quantity(ty: Type, doc: &str) -> Quantity {
    match ty.element {
        Element::Double | Element::Vector => Quantity::of_doc(doc),
        Element::Bool | Element::Int | Element::Nanos => Quantity::Number,
        Element::Rotation | Element::Frame | Element::Twist | Element::Wrench => Quantity::Any,
    }
}

/// An in port in a table row, before its type is known.
#[derive(Clone, Copy, Debug)]
pub struct Port {
    name: &'static str,
    doc: &'static str,
    required: bool,
    parameter: Option<(&'static str, &'static str)>,
}

/// An in port; unconnected, it is null.
pub const fn port(name: &'static str, doc: &'static str) -> Port {
    Port {
        name,
        doc,
        required: false,
        parameter: None,
    }
}

impl Port {
    /// Its name.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        self.name
    }

    /// The port must be connected.
    #[must_use]
    pub const fn required(mut self) -> Self {
        self.required = true;
        self
    }

    /// The port reads this parameter while it is not connected.
    #[must_use]
    pub const fn or(mut self, parameter: &'static str, default: &'static str) -> Self {
        self.parameter = Some((parameter, default));
        self
    }
}

/// The input values of a [`function`]: a tuple of port values.
pub trait Inputs: Sized {
    /// The handles that read them.
    type Handles: Send;
    /// Their types.
    fn elements() -> Vec<Element>;
    /// Finds the handles by port name.
    ///
    /// # Errors
    /// If the parameter of an unconnected port has no value of its type.
    fn bind(build: &mut Build<'_, '_>, names: &[&'static str]) -> Result<Self::Handles, Fault>;
    /// Reads all; `None` if any is null.
    fn read(handles: &Self::Handles, cycle: &Cycle<'_>) -> Option<Self>;
}

/// The output values of a [`function`]: one port value or a tuple of them.
pub trait Outputs: Sized {
    /// The handles that write them.
    type Handles: Send;
    /// Their types.
    fn elements() -> Vec<Element>;
    /// Allocates the slots.
    fn bind(build: &mut Build<'_, '_>, names: &[&'static str]) -> Self::Handles;
    /// Writes all; `None` makes all null.
    fn write(handles: &Self::Handles, cycle: &Cycle<'_>, values: Option<Self>);
}

macro_rules! tuples {
    ($($T:ident $i:tt),+) => {
        impl<$($T: Value + crate::value::text::TextValue),+> Inputs for ($($T,)+) {
            type Handles = ($(In<$T>,)+);

            fn elements() -> Vec<Element> {
                vec![$($T::ELEMENT),+]
            }

            fn bind(
                build: &mut Build<'_, '_>,
                names: &[&'static str],
            ) -> Result<Self::Handles, Fault> {
                Ok(($(build.input::<$T>(names[$i])?,)+))
            }

            #[inline]
            fn read(handles: &Self::Handles, cycle: &Cycle<'_>) -> Option<Self> {
                Some(($(handles.$i.get(cycle)?,)+))
            }
        }

        impl<$($T: Value),+> Outputs for ($($T,)+) {
            type Handles = ($(Out<$T>,)+);

            fn elements() -> Vec<Element> {
                vec![$($T::ELEMENT),+]
            }

            fn bind(build: &mut Build<'_, '_>, names: &[&'static str]) -> Self::Handles {
                ($(build.output::<$T>(names[$i]),)+)
            }

            #[inline]
            fn write(handles: &Self::Handles, cycle: &Cycle<'_>, values: Option<Self>) {
                match values {
                    Some(values) => {
                        $(handles.$i.set(cycle, values.$i);)+
                    }
                    None => {
                        $(handles.$i.set(cycle, None);)+
                    }
                }
            }
        }
    };
}
tuples!(A 0);
tuples!(A 0, B 1);
tuples!(A 0, B 1, C 2);
tuples!(A 0, B 1, C 2, D 3);
tuples!(A 0, B 1, C 2, D 3, E 4);
tuples!(A 0, B 1, C 2, D 3, E 4, F 5);

struct Function<I: Inputs, O: Outputs, F> {
    inputs: I::Handles,
    outputs: O::Handles,
    function: F,
}

impl<I: Inputs, O: Outputs, F: Fn(I) -> Option<O> + Send> Primitive for Function<I, O, F> {
    #[inline]
    fn step(&mut self, cycle: &Cycle<'_>) {
        let values = I::read(&self.inputs, cycle).and_then(&self.function);
        O::write(&self.outputs, cycle, values);
    }
}

/// A primitive that is a function of its inputs. A null input makes all outputs null, and so does
/// `None`.
///
/// # Panics
/// If the numbers of ports and values differ: the table row is wrong.
#[track_caller]
pub fn function<I, O, F>(
    name: impl Into<String>,
    doc: &'static str,
    inputs: &[Port],
    outputs: &[(&'static str, &'static str)],
    function: F,
) -> Definition
where
    I: Inputs + 'static,
    O: Outputs + 'static,
    F: Fn(I) -> Option<O> + Copy + Send + Sync + 'static,
{
    let in_names: Vec<_> = inputs.iter().map(|p| p.name).collect();
    let out_names: Vec<_> = outputs.iter().map(|(name, _)| *name).collect();
    let mut definition = Definition::new(name, doc, move |build| {
        Ok(Function::<I, O, F> {
            inputs: I::bind(build, &in_names)?,
            outputs: O::bind(build, &out_names),
            function,
        })
    });
    let (takes, gives) = (I::elements(), O::elements());
    assert_eq!(takes.len(), inputs.len(), "ports of {}", definition.name);
    assert_eq!(gives.len(), outputs.len(), "ports of {}", definition.name);
    for (port, element) in inputs.iter().zip(takes) {
        definition = definition.port_in(*port, Type::scalar(element));
    }
    for ((name, doc), element) in outputs.iter().zip(gives) {
        definition = definition.port_out(name, doc, Type::scalar(element));
    }
    definition
}

impl Build<'_, '_> {
    /// The period, s.
    pub fn period_s(&self) -> f64 {
        self.period().as_secs_f64()
    }

    /// Number of cycles in a time span, at least 1.
    ///
    /// # Errors
    /// If the span is not positive, or longer than a primitive may remember.
    pub(crate) fn cycles_in(&self, parameter: &'static str, seconds: f64) -> Result<usize, Fault> {
        let most = self.limits().history;
        let cycles = (seconds / self.period_s()).ceil();
        let fits = (0.0..=f64::from(u32::try_from(most).unwrap_or(u32::MAX))).contains(&cycles);
        if !fits {
            let longest =
                Duration::from_secs_f64(self.period_s()) * u32::try_from(most).unwrap_or(1);
            let why = format!("{seconds} s is not between 0 and {longest:?}");
            return Err(self.parameter_fault(parameter, why));
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "in range"
        )]
        Ok((cycles as usize).max(1))
    }
}

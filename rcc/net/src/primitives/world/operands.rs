//! Ports and parameters that the geometry primitives share: operands, coordinates and angles as defaults of a port.

use crate::definition::{Build, Definition, Port, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};
use crate::value::text::TextValue;
use crate::value::{Rotation, Value, Vector};

pub(super) const VALUE: &[(&str, &str)] = &[("outValue", "result")];

pub(super) const fn operands() -> [Port; 2] {
    [
        port("inFirst", "first operand").required(),
        port("inSecond", "second operand").required(),
    ]
}

pub(super) const fn value(doc: &'static str) -> Port {
    port("inValue", doc).required()
}

/// A function of two inputs that need more than their ports' names to be built.
pub(super) struct Pair<A, B, O, F> {
    pub(super) first: In<A>,
    pub(super) second: In<B>,
    pub(super) out: Out<O>,
    pub(super) function: F,
}

impl<A, B, O, F> Primitive for Pair<A, B, O, F>
where
    A: Value,
    B: Value,
    O: Value,
    F: Fn(A, B) -> Option<O> + Send,
{
    fn step(&mut self, cycle: &Cycle<'_>) {
        let inputs = self.first.get(cycle).zip(self.second.get(cycle));
        self.out
            .set(cycle, inputs.and_then(|(a, b)| (self.function)(a, b)));
    }
}

/// Three parameters for a port with three coordinates: names and defaults.
pub(super) type Three = [(&'static str, &'static str); 3];

/// An in port with three parameters as its default.
pub(super) fn input_or<T: TextValue>(
    b: &mut Build<'_, '_>,
    port: &'static str,
    three: Three,
    of: impl Fn([f64; 3]) -> T,
) -> Result<In<T>, Fault> {
    if b.is_linked(port) {
        return b.input(port);
    }
    let [x, y, z] = three;
    let value = of([b.value(x.0)?, b.value(y.0)?, b.value(z.0)?]);
    Ok(b.constant(value))
}

pub(super) fn with_three(
    definition: Definition,
    three: Three,
    docs: [&'static str; 3],
) -> Definition {
    let parameters = three.into_iter().zip(docs);
    parameters.fold(definition, |d, ((name, default), doc)| {
        d.parameter::<f64>(name, default, doc)
    })
}

pub(super) const XYZ: Three = [("X", "0"), ("Y", "0"), ("Z", "0")];

pub(super) const ABC: Three = [("A", "0"), ("B", "0"), ("C", "0")];

pub(super) const ABC_DOCS: [&str; 3] = [
    "angle about Z, rad",
    "angle about Y, rad",
    "angle about X, rad",
];

pub(super) fn rotation_of([a, b, c]: [f64; 3]) -> Rotation {
    Rotation::from_euler_angles(c, b, a)
}

pub(super) fn vector_of(xyz: [f64; 3]) -> Vector {
    xyz.into()
}

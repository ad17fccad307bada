//! Geometry: vectors, rotations, frames, twists and wrenches. Lengths are in metres, angles in
//! radians; A, B and C are angles about Z, Y and X, applied in that order to the moving axes.
//! Motions between poses are trajectories and not defined here.

mod frame;
mod linear;
mod rotation;
mod twist;
mod vector;

use crate::definition::{Build, Definition, Port, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};
use crate::value::text::TextValue;
use crate::value::{Rotation, Value, Vector};

const VALUE: &[(&str, &str)] = &[("outValue", "result")];

const fn operands() -> [Port; 2] {
    [
        port("inFirst", "first operand").required(),
        port("inSecond", "second operand").required(),
    ]
}

const fn value(doc: &'static str) -> Port {
    port("inValue", doc).required()
}

/// A function of two inputs that need more than their ports' names to be built.
struct Pair<A, B, O, F> {
    first: In<A>,
    second: In<B>,
    out: Out<O>,
    function: F,
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
type Three = [(&'static str, &'static str); 3];

/// An in port with three parameters as its default.
fn input_or<T: TextValue>(
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

fn with_three(definition: Definition, three: Three, docs: [&'static str; 3]) -> Definition {
    let parameters = three.into_iter().zip(docs);
    parameters.fold(definition, |d, ((name, default), doc)| {
        d.parameter::<f64>(name, default, doc)
    })
}

const XYZ: Three = [("X", "0"), ("Y", "0"), ("Z", "0")];
const ABC: Three = [("A", "0"), ("B", "0"), ("C", "0")];
const ABC_DOCS: [&str; 3] = [
    "angle about Z, rad",
    "angle about Y, rad",
    "angle about X, rad",
];

fn rotation_of([a, b, c]: [f64; 3]) -> Rotation {
    Rotation::from_euler_angles(c, b, a)
}

fn vector_of(xyz: [f64; 3]) -> Vector {
    xyz.into()
}

pub(super) fn table() -> Vec<Definition> {
    let tables = [
        vector::table(),
        linear::table(),
        rotation::table(),
        frame::table(),
        twist::table(),
    ];
    tables.into_iter().flatten().collect()
}

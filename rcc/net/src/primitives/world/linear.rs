//! Differences, negatives and multiples of vectors, twists and wrenches, which are the same for all.

use super::{VALUE, operands, value};
use crate::definition::{Definition, function, port};
use crate::primitives::linear::{Length, Linear};
use crate::value::{Twist, Vector, Wrench};

fn subtract<T: Linear>() -> Definition {
    function(
        format!("{}Subtract", T::PREFIX),
        "First minus second, number by number.",
        &operands(),
        VALUE,
        |(a, b): (T, T)| Some((a.combine(1.0, b, -1.0),)),
    )
}

fn negate<T: Linear>() -> Definition {
    function(
        format!("{}Negate", T::PREFIX),
        "The opposite: minus each number.",
        &[value("what to negate")],
        VALUE,
        |(a,): (T,)| Some((a.combine(-1.0, T::default(), 0.0),)),
    )
}

fn scale<T: Linear>() -> Definition {
    function(
        format!("{}Scale", T::PREFIX),
        "Each number times a number.",
        &[
            value("what to scale"),
            port("inFactor", "the number, no unit").or("Factor", "1"),
        ],
        VALUE,
        |(a, factor): (T, f64)| Some((a.combine(factor, T::default(), 0.0),)),
    )
}

pub(super) fn table() -> Vec<Definition> {
    let all = [
        subtract::<Vector>(),
        subtract::<Twist>(),
        subtract::<Wrench>(),
        negate::<Vector>(),
        negate::<Twist>(),
        negate::<Wrench>(),
        scale::<Twist>(),
        scale::<Wrench>(),
        function(
            "World::WrenchAdd",
            "First plus second.",
            &operands(),
            VALUE,
            |(a, b): (Wrench, Wrench)| Some((a.combine(1.0, b, 1.0),)),
        ),
        function(
            "World::VectorLength",
            "The length of a vector.",
            &[value("the vector")],
            &[("outValue", "the length, in the unit of the vector")],
            |(v,): (Vector,)| Some((v.length(),)),
        ),
    ];
    all.into_iter().map(Definition::active).collect()
}

//! Vectors. Their unit depends on their source: metres, m/s or N.

use super::{VALUE, operands, value};
use crate::definition::{Definition, function, port};
use crate::value::{Rotation, Vector};

const XYZ_OUT: &[(&str, &str)] = &[
    ("outX", "coordinate along X"),
    ("outY", "coordinate along Y"),
    ("outZ", "coordinate along Z"),
];

fn coordinates() -> [Definition; 2] {
    [
        function(
            "World::VectorFromXYZ",
            "The vector of three coordinates.",
            &[
                port("inX", "coordinate along X").or("X", "0"),
                port("inY", "coordinate along Y").or("Y", "0"),
                port("inZ", "coordinate along Z").or("Z", "0"),
            ],
            VALUE,
            |(x, y, z): (f64, f64, f64)| Some((Vector::new(x, y, z),)),
        ),
        function(
            "World::VectorToXYZ",
            "The coordinates of a vector.",
            &[value("the vector")],
            XYZ_OUT,
            |(v,): (Vector,)| Some((v.x, v.y, v.z)),
        ),
    ]
}

fn products() -> [Definition; 5] {
    [
        function(
            "World::VectorAdd",
            "First plus second.",
            &operands(),
            VALUE,
            |(a, b): (Vector, Vector)| Some((a + b,)),
        ),
        function(
            "World::VectorDot",
            "Scalar product.",
            &operands(),
            VALUE,
            |(a, b): (Vector, Vector)| Some((a.dot(&b),)),
        ),
        function(
            "World::VectorCross",
            "Vector product, first times second.",
            &operands(),
            VALUE,
            |(a, b): (Vector, Vector)| Some((a.cross(&b),)),
        ),
        function(
            "World::VectorScale",
            "The vector times a number.",
            &[
                value("the vector"),
                port("inFactor", "the number").or("Factor", "1"),
            ],
            VALUE,
            |(v, factor): (Vector, f64)| Some((v * factor,)),
        ),
        function(
            "World::VectorRotate",
            "The vector turned by a rotation.",
            &[
                value("the vector"),
                port("inRot", "the rotation").required(),
            ],
            VALUE,
            |(v, rotation): (Vector, Rotation)| Some((rotation * v,)),
        ),
    ]
}

pub(super) fn table() -> Vec<Definition> {
    let all = coordinates().into_iter().chain(products());
    all.map(Definition::active).collect()
}

//! Rotations, from and to their usual forms. A rotation that does not exist, such as one about an
//! axis of length zero, is null.

use nalgebra::{Quaternion, Unit};

use super::{ABC_DOCS, Pair, Three, VALUE, input_or, operands, value, vector_of, with_three};
use crate::definition::{Build, Definition, Primitive, function, port};
use crate::fault::Fault;
use crate::value::{Rotation, Vector};

/// Below this length, an axis or a quaternion has no direction.
const SHORTEST: f64 = 1e-12;

const ABC_OUT: &[(&str, &str)] = &[
    ("outA", ABC_DOCS[0]),
    ("outB", ABC_DOCS[1]),
    ("outC", ABC_DOCS[2]),
];

/// No turn needs no axis: known clients send the zero axis with it.
fn about(axis: Vector, angle: f64) -> Option<Rotation> {
    if angle == 0.0 {
        return Some(Rotation::identity());
    }
    Unit::try_new(axis, SHORTEST).map(|axis| Rotation::from_axis_angle(&axis, angle))
}

/// Axis and angle (0 to π); the identity is a rotation about X by 0.
fn axis_angle(rotation: Rotation) -> (Vector, f64) {
    match rotation.axis() {
        Some(axis) => (axis.into_inner(), rotation.angle()),
        None => (Vector::x(), 0.0),
    }
}

fn abc() -> [Definition; 2] {
    [
        function(
            "World::RotationFromABC",
            "The rotation of Z-Y-X Euler angles.",
            &[
                port("inA", ABC_DOCS[0]).or("A", "0"),
                port("inB", ABC_DOCS[1]).or("B", "0"),
                port("inC", ABC_DOCS[2]).or("C", "0"),
            ],
            VALUE,
            |(a, b, c): (f64, f64, f64)| Some((Rotation::from_euler_angles(c, b, a),)),
        ),
        function(
            "World::RotationToABC",
            "The Z-Y-X Euler angles of a rotation; B is between -π/2 and π/2.",
            &[value("the rotation")],
            ABC_OUT,
            |(r,): (Rotation,)| {
                let (c, b, a) = r.euler_angles();
                Some((a, b, c))
            },
        ),
    ]
}

fn from_axis_angle() -> Definition {
    const AXIS: Three = [("X", "1"), ("Y", "0"), ("Z", "0")];
    let build = |b: &mut Build<'_, '_>| -> Result<_, Fault> {
        Ok(Pair {
            first: input_or(b, "inAxis", AXIS, vector_of)?,
            second: b.input::<f64>("inAngle")?,
            out: b.output::<Rotation>("outValue"),
            function: about,
        })
    };
    let definition = pair(
        "World::RotationFromAxisAngle",
        "The rotation about an axis. The angle 0 gives the identity whatever the axis; another angle about an axis of length zero gives null.",
        build,
    )
    .input::<Vector>(port(
        "inAxis",
        "the axis, of any length; X, Y, Z if not connected",
    ))
    .input::<f64>(port("inAngle", "the angle, rad").or("Angle", "0"))
    .output::<Rotation>("outValue", "result");
    with_three(
        definition,
        AXIS,
        [
            "X of the axis, no unit",
            "Y of the axis, no unit",
            "Z of the axis, no unit",
        ],
    )
}

fn pair<P: Primitive + 'static>(
    name: &str,
    doc: &'static str,
    build: fn(&mut Build<'_, '_>) -> Result<P, Fault>,
) -> Definition {
    Definition::new(name, doc, build)
}

fn quaternion() -> [Definition; 2] {
    [
        function(
            "World::RotationFromQuaternion",
            "The rotation of a quaternion of any length; null for one of length zero.",
            &[
                port("inX", "factor of i, no unit").or("X", "1"),
                port("inY", "factor of j, no unit").or("Y", "0"),
                port("inZ", "factor of k, no unit").or("Z", "0"),
                port("inW", "real part, no unit").or("W", "0"),
            ],
            VALUE,
            |(x, y, z, w): (f64, f64, f64, f64)| {
                Some((Rotation::try_new(Quaternion::new(w, x, y, z), SHORTEST)?,))
            },
        ),
        function(
            "World::RotationToQuaternion",
            "The unit quaternion of a rotation.",
            &[value("the rotation")],
            &[
                ("outX", "factor of i"),
                ("outY", "factor of j"),
                ("outZ", "factor of k"),
                ("outW", "real part"),
            ],
            |(r,): (Rotation,)| Some((r.i, r.j, r.k, r.w)),
        ),
    ]
}

fn algebra() -> [Definition; 3] {
    [
        function(
            "World::RotationToAxisAngle",
            "Axis and angle of a rotation.",
            &[value("the rotation")],
            &[
                ("outAxis", "the axis, of length 1; X if the angle is 0"),
                ("outAngle", "the angle, 0 to π rad"),
            ],
            |(r,): (Rotation,)| Some(axis_angle(r)),
        ),
        function(
            "World::RotationInvert",
            "The rotation that undoes the input.",
            &[value("the rotation")],
            VALUE,
            |(r,): (Rotation,)| Some((r.inverse(),)),
        ),
        function(
            "World::RotationTransform",
            "First, and then second about the axes turned by first.",
            &operands(),
            VALUE,
            |(a, b): (Rotation, Rotation)| Some((a * b,)),
        ),
    ]
}

pub(super) fn table() -> Vec<Definition> {
    let mut table = vec![from_axis_angle()];
    table.extend(abc());
    table.extend(quaternion());
    table.extend(algebra());
    table.into_iter().map(Definition::active).collect()
}

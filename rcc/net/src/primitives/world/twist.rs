//! Twists and wrenches: velocities and forces of a frame, each with its rotational part.

use super::{Pair, Three, VALUE, XYZ, input_or, operands, value, vector_of, with_three};
use crate::definition::{Build, Definition, Port, function, port};
use crate::fault::Fault;
use crate::value::{Frame, Rotation, Twist, Vector, Wrench};

type Six = (f64, f64, f64, f64, f64, f64);

const TWIST_DOCS: [&str; 6] = [
    "velocity along X, m/s",
    "velocity along Y, m/s",
    "velocity along Z, m/s",
    "rotational velocity about Z, rad/s",
    "rotational velocity about Y, rad/s",
    "rotational velocity about X, rad/s",
];

const WRENCH_DOCS: [&str; 6] = [
    "force along X, N",
    "force along Y, N",
    "force along Z, N",
    "torque about Z, Nm",
    "torque about Y, Nm",
    "torque about X, Nm",
];

const fn six_in(docs: [&'static str; 6]) -> [Port; 6] {
    [
        port("inX", docs[0]).or("X", "0"),
        port("inY", docs[1]).or("Y", "0"),
        port("inZ", docs[2]).or("Z", "0"),
        port("inA", docs[3]).or("A", "0"),
        port("inB", docs[4]).or("B", "0"),
        port("inC", docs[5]).or("C", "0"),
    ]
}

const fn six_out(docs: [&'static str; 6]) -> [(&'static str, &'static str); 6] {
    [
        ("outX", docs[0]),
        ("outY", docs[1]),
        ("outZ", docs[2]),
        ("outA", docs[3]),
        ("outB", docs[4]),
        ("outC", docs[5]),
    ]
}

/// The translational and the rotational part; A, B, C are about Z, Y, X.
const fn vectors((x, y, z, a, b, c): Six) -> (Vector, Vector) {
    (Vector::new(x, y, z), Vector::new(c, b, a))
}

fn numbers(straight: Vector, turning: Vector) -> Six {
    let (s, t) = (straight, turning);
    (s.x, s.y, s.z, t.z, t.y, t.x)
}

fn from_and_to() -> [Definition; 4] {
    [
        function(
            "World::TwistFromXYZ",
            "The twist of six velocities.",
            &six_in(TWIST_DOCS),
            VALUE,
            |six: Six| {
                let (vel, rot) = vectors(six);
                Some((Twist { vel, rot },))
            },
        ),
        function(
            "World::TwistToXYZ",
            "The six velocities of a twist.",
            &[value("the twist")],
            &six_out(TWIST_DOCS),
            |(t,): (Twist,)| Some(numbers(t.vel, t.rot)),
        ),
        function(
            "World::WrenchFromXYZ",
            "The wrench of three forces and three torques.",
            &six_in(WRENCH_DOCS),
            VALUE,
            |six: Six| {
                let (force, torque) = vectors(six);
                Some((Wrench { force, torque },))
            },
        ),
        function(
            "World::WrenchToXYZ",
            "The forces and torques of a wrench.",
            &[value("the wrench")],
            &six_out(WRENCH_DOCS),
            |(w,): (Wrench,)| Some(numbers(w.force, w.torque)),
        ),
    ]
}

const RXYZ: Three = [("RX", "0"), ("RY", "0"), ("RZ", "0")];

fn from_velocities() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<_, Fault> {
        Ok(Pair {
            first: input_or(b, "inTransVel", XYZ, vector_of)?,
            second: input_or(b, "inRotVel", RXYZ, vector_of)?,
            out: b.output("outValue"),
            function: |vel: Vector, rot: Vector| Some(Twist { vel, rot }),
        })
    };
    let [x, y, z, rz, ry, rx] = TWIST_DOCS;
    let definition = Definition::new(
        "World::TwistFromVelocities",
        "The twist of two velocities.",
        build,
    )
    .input::<Vector>(port(
        "inTransVel",
        "velocity, m/s; X, Y, Z if not connected",
    ))
    .input::<Vector>(port(
        "inRotVel",
        "rotational velocity, rad/s; RX, RY, RZ if not connected",
    ))
    .output::<Twist>("outValue", "the twist");
    with_three(with_three(definition, XYZ, [x, y, z]), RXYZ, [rx, ry, rz])
}

fn from_frames() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<_, Fault> {
        let period_s = b.period_s();
        Ok(Pair {
            first: b.input("inFrame")?,
            second: b.input("inPrevFrame")?,
            out: b.output("outValue"),
            function: move |frame: Frame, before: Frame| {
                let offset = frame.translation.vector - before.translation.vector;
                let turn = (frame.rotation * before.rotation.inverse()).scaled_axis();
                Some(Twist {
                    vel: offset / period_s,
                    rot: turn / period_s,
                })
            },
        })
    };
    Definition::new(
        "World::TwistFromFrames",
        "The twist that leads from one frame to the other in one cycle, by the shorter rotation.",
        build,
    )
    .input::<Frame>(port("inFrame", "where it leads").required())
    .input::<Frame>(port("inPrevFrame", "where it starts").required())
    .output::<Twist>(
        "outValue",
        "the twist, along the axes the frames are given in",
    )
}

fn algebra() -> [Definition; 4] {
    [
        function(
            "World::TwistToVelocities",
            "The two velocities of a twist.",
            &[value("the twist")],
            &[
                ("outTransVel", "velocity, m/s"),
                ("outRotVel", "rotational velocity, rad/s"),
            ],
            |(t,): (Twist,)| Some((t.vel, t.rot)),
        ),
        function(
            "World::TwistAdd",
            "First plus second.",
            &operands(),
            VALUE,
            |(a, b): (Twist, Twist)| {
                Some((Twist {
                    vel: a.vel + b.vel,
                    rot: a.rot + b.rot,
                },))
            },
        ),
        function(
            "World::TwistRotate",
            "Both velocities turned by a rotation.",
            &[value("the twist"), port("inRot", "the rotation").required()],
            VALUE,
            |(t, rotation): (Twist, Rotation)| {
                Some((Twist {
                    vel: rotation * t.vel,
                    rot: rotation * t.rot,
                },))
            },
        ),
        function(
            "World::TwistChangeCenter",
            "The motion of another point of the same rigid body.",
            &[
                value("the twist"),
                port("inVector", "the other point from the first, m").required(),
            ],
            VALUE,
            |(t, offset): (Twist, Vector)| {
                Some((Twist {
                    vel: t.vel + t.rot.cross(&offset),
                    rot: t.rot,
                },))
            },
        ),
    ]
}

pub(super) fn table() -> Vec<Definition> {
    let mut table = vec![from_velocities(), from_frames()];
    table.extend(from_and_to());
    table.extend(algebra());
    table.into_iter().map(Definition::active).collect()
}

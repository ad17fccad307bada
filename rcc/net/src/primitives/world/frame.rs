//! Frames: position and orientation of one coordinate system in another.

use super::{
    ABC, ABC_DOCS, Pair, VALUE, XYZ, input_or, operands, rotation_of, value, vector_of, with_three,
};
use crate::definition::{Build, Definition, Primitive, function, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};
use crate::value::{Frame, Rotation, Twist, Vector};

const XYZ_DOCS: [&str; 3] = [
    "position along X, m",
    "position along Y, m",
    "position along Z, m",
];

fn from_pos_rot() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<_, Fault> {
        Ok(Pair {
            first: input_or(b, "inPos", XYZ, vector_of)?,
            second: input_or(b, "inRot", ABC, rotation_of)?,
            out: b.output("outValue"),
            function: |pos: Vector, rot: Rotation| Some(Frame::from_parts(pos.into(), rot)),
        })
    };
    let definition = Definition::new(
        "World::FrameFromPosRot",
        "The frame of a position and an orientation.",
        build,
    )
    .input::<Vector>(port("inPos", "position, m; X, Y, Z if not connected"))
    .input::<Rotation>(port("inRot", "orientation; A, B, C if not connected"))
    .output::<Frame>("outValue", "the frame");
    with_three(with_three(definition, XYZ, XYZ_DOCS), ABC, ABC_DOCS)
}

struct FromXyz {
    xyz: [In<f64>; 3],
    rot: In<Rotation>,
    out: Out<Frame>,
}

impl Primitive for FromXyz {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let [x, y, z] = self.xyz.map(|coordinate| coordinate.get(cycle));
        let pos = x.zip(y).zip(z).map(|((x, y), z)| Vector::new(x, y, z));
        let parts = pos.zip(self.rot.get(cycle));
        self.out.set(
            cycle,
            parts.map(|(pos, rot)| Frame::from_parts(pos.into(), rot)),
        );
    }
}

fn from_xyz() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<FromXyz, Fault> {
        Ok(FromXyz {
            xyz: [b.input("inX")?, b.input("inY")?, b.input("inZ")?],
            rot: input_or(b, "inRot", ABC, rotation_of)?,
            out: b.output("outValue"),
        })
    };
    let definition = Definition::new(
        "World::FrameFromXYZ",
        "The frame of three coordinates and an orientation; prefer FrameFromPosRot.",
        build,
    )
    .input::<f64>(port("inX", XYZ_DOCS[0]).or("X", "0"))
    .input::<f64>(port("inY", XYZ_DOCS[1]).or("Y", "0"))
    .input::<f64>(port("inZ", XYZ_DOCS[2]).or("Z", "0"))
    .input::<Rotation>(port("inRot", "orientation; A, B, C if not connected"))
    .output::<Frame>("outValue", "the frame");
    with_three(definition, ABC, ABC_DOCS)
}

fn parts() -> [Definition; 2] {
    [
        function(
            "World::FrameToPosRot",
            "Position and orientation of a frame.",
            &[value("the frame")],
            &[
                ("outPosition", "position, m"),
                ("outRotation", "orientation"),
            ],
            |(frame,): (Frame,)| Some((frame.translation.vector, frame.rotation)),
        ),
        function(
            "World::FrameToXYZ",
            "Coordinates and orientation of a frame; prefer FrameToPosRot.",
            &[value("the frame")],
            &[
                ("outX", XYZ_DOCS[0]),
                ("outY", XYZ_DOCS[1]),
                ("outZ", XYZ_DOCS[2]),
                ("outRot", "orientation"),
            ],
            |(frame,): (Frame,)| {
                let v = frame.translation.vector;
                Some((v.x, v.y, v.z, frame.rotation))
            },
        ),
    ]
}

fn algebra() -> [Definition; 2] {
    [
        function(
            "World::FrameTransform",
            "The second frame, given in first, transformed to the reference of first.",
            &operands(),
            VALUE,
            |(first, second): (Frame, Frame)| Some((first * second,)),
        ),
        function(
            "World::FrameInvert",
            "The inverse: the reference frame, given in the input.",
            &[value("the frame")],
            VALUE,
            |(frame,): (Frame,)| Some((frame.inverse(),)),
        ),
    ]
}

/// The frame after a motion with `twist` for `span_s`. Normalized, because it is often fed back.
fn moved(frame: Frame, twist: Twist, span_s: f64) -> Frame {
    let pos = frame.translation.vector + twist.vel * span_s;
    let mut rot = Rotation::from_scaled_axis(twist.rot * span_s) * frame.rotation;
    rot.renormalize();
    Frame::from_parts(pos.into(), rot)
}

fn add_twist() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<_, Fault> {
        let period_s = b.period_s();
        Ok(Pair {
            first: b.input("inFrame")?,
            second: b.input("inTwist")?,
            out: b.output("outValue"),
            function: move |frame, twist| Some(moved(frame, twist, period_s)),
        })
    };
    Definition::new(
        "World::FrameAddTwist",
        "The frame after moving with a twist for one cycle.",
        build,
    )
    .input::<Frame>(port("inFrame", "the frame").required())
    .input::<Twist>(
        port(
            "inTwist",
            "velocity of the frame's origin and rotation, along the axes the frame is given in",
        )
        .required(),
    )
    .output::<Frame>("outValue", "the frame one cycle later")
}

pub(super) fn table() -> Vec<Definition> {
    let mut table = vec![from_pos_rot(), from_xyz(), add_twist()];
    table.extend(parts());
    table.extend(algebra());
    table.into_iter().map(Definition::active).collect()
}

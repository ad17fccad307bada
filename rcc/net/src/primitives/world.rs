//! Geometry: vectors, rotations, frames, twists and wrenches. Lengths are in metres, angles in
//! radians; A, B and C are angles about Z, Y and X, applied in that order to the moving axes.
//! Motions between poses are trajectories and not defined here.

mod frame;
mod linear;
mod operands;
mod rotation;
mod twist;
mod vector;

use crate::definition::Definition;
use operands::{
    ABC, ABC_DOCS, Pair, Three, VALUE, XYZ, input_or, operands, rotation_of, value, vector_of,
    with_three,
};

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

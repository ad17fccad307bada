//! The primitives of this crate, one table for each field of use. Device and motion primitives are
//! defined in the crates of devices and motions.

/// An array of the results of a generic definition function, one for each type whose values
/// programs can write.
macro_rules! for_each_type {
    ($family:ident) => {
        [
            $family::<bool>(),
            $family::<i32>(),
            $family::<f64>(),
            $family::<$crate::Vector>(),
            $family::<$crate::Rotation>(),
            $family::<$crate::Frame>(),
            $family::<$crate::Twist>(),
            $family::<$crate::Wrench>(),
        ]
    };
}

mod array;
mod bits;
mod compare;
mod control;
mod event;
mod exchange;
mod filter;
mod generic;
mod history;
mod inter;
mod limit;
mod linear;
mod logic;
mod lookup;
mod math;
mod pid;
mod range;
mod ring;
mod time;
mod wave;
mod window;
mod world;

use crate::definition::Definition;

/// All definitions of this crate.
pub fn all() -> Vec<Definition> {
    let tables = [
        control::table(),
        logic::table(),
        math::table(),
        compare::table(),
        limit::table(),
        filter::table(),
        pid::table(),
        lookup::table(),
        wave::table(),
        bits::table(),
        event::table(),
        time::table(),
        history::table(),
        range::table(),
        window::table(),
        generic::table(),
        array::table(),
        exchange::table(),
        inter::table(),
        world::table(),
    ];
    tables.into_iter().flatten().collect()
}

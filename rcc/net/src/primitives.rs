//! The primitives of this crate, a table for each field of use. Primitives of devices and motions
//! are defined where devices and motions are.

mod array;
mod compare;
mod control;
mod exchange;
mod generic;
mod logic;
mod math;
mod time;

use crate::definition::Definition;

/// All definitions of this crate.
#[must_use]
pub fn all() -> Vec<Definition> {
    let tables = [
        control::table(),
        logic::table(),
        math::table(),
        compare::table(),
        time::table(),
        generic::table(),
        array::table(),
        exchange::table(),
    ];
    tables.into_iter().flatten().collect()
}

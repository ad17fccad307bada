//! Properties of every primitive of this crate, whatever it computes.

#[path = "../../net/tests/common/every.rs"]
mod every;

use takt_net::Registry;

fn registry() -> Registry {
    let mut registry = Registry::core();
    registry.add(takt_motion::all());
    registry
}

#[test]
fn every_primitive_can_be_built() {
    every::can_be_built(&registry());
}

#[test]
fn null_propagates_where_the_definition_says_so() {
    every::null_propagates(&registry());
}

#[test]
fn no_sequence_of_inputs_makes_a_primitive_panic() {
    every::survives_anything(&registry(), 100);
}

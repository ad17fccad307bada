//! Properties of every primitive of this crate, whatever it computes.

#[path = "common/every.rs"]
mod every;

use takt_net::Registry;

#[test]
fn every_primitive_can_be_built() {
    every::can_be_built(&Registry::core());
}

#[test]
fn null_propagates_where_the_definition_says_so() {
    every::null_propagates(&Registry::core());
}

#[test]
fn no_sequence_of_inputs_makes_a_primitive_panic() {
    every::survives_anything(&Registry::core(), 100);
}

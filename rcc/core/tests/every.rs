//! What holds for every primitive of a controller that needs no device, whatever it computes.

#[path = "../../net/tests/common/every.rs"]
mod every;

#[test]
fn every_primitive_can_be_built() {
    every::can_be_built(&takt_core::registry());
}

#[test]
fn null_propagates_where_the_definition_says_so() {
    every::null_propagates(&takt_core::registry());
}

#[test]
fn no_sequence_of_inputs_makes_a_primitive_panic() {
    every::survives_anything(&takt_core::registry(), 100);
}

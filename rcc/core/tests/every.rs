//! Properties of every primitive that needs no device.

#[path = "../../net/tests/common/every.rs"]
mod every;

#[test]
fn every_primitive_can_be_built() {
    every::can_be_built(&takt_core::registry());
}

#[test]
fn primitive_null_propagates_as_defined() {
    every::null_propagates(&takt_core::registry());
}

#[test]
fn primitives_random_inputs_do_not_panic() {
    every::survives_anything(&takt_core::registry(), 100);
}

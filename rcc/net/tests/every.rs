//! Properties of every primitive of this crate, whatever it computes.

#[path = "common/every.rs"]
mod every;

use takt_net::Registry;

#[test]
fn every_primitive_can_be_built() {
    every::can_be_built(&Registry::core());
}

#[test]
fn primitive_null_propagates_as_defined() {
    every::null_propagates(&Registry::core());
}

#[test]
fn primitives_random_inputs_do_not_panic() {
    every::survives_anything(&Registry::core(), 100);
}

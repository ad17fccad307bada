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
fn primitive_null_propagates_as_defined() {
    every::null_propagates(&registry());
}

#[test]
fn primitives_random_inputs_do_not_panic() {
    every::survives_anything(&registry(), 100);
}

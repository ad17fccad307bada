//! No primitive allocates while a net runs, whatever its inputs are.

#[path = "common/every.rs"]
mod every;

use takt_net::Registry;
use takt_tests::{Allocations, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

#[test]
fn no_primitive_allocates_in_a_cycle() {
    every::with_anything(&Registry::core(), 20, |name, step| {
        let allocations = Allocations::count();
        step();
        assert_eq!(allocations.end(), 0, "{name} allocates");
    });
}

//! No primitive allocates while a net runs, whatever its inputs are.

#[path = "common/every.rs"]
mod every;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use takt_net::Registry;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every request is handed to the system allocator unchanged; the counter is a plain
// thread-local without a destructor and allocates nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // The counter is not accessible while a thread ends: nothing is counted then.
        let _gone = ALLOCATIONS.try_with(|count| count.set(count.get() + 1));
        // SAFETY: the caller keeps the contract of `alloc`, which is the same here.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: `pointer` came from `System.alloc` above with this layout.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn no_primitive_allocates_in_a_cycle() {
    let before = || ALLOCATIONS.with(Cell::get);
    assert!(before() > 0, "the counter counts");
    every::with_anything(&Registry::core(), 20, |name, step| {
        let count = before();
        step();
        assert_eq!(before(), count, "{name} allocates");
    });
}

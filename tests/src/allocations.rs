//! Counts what a test allocates and frees, by the allocator that also watches real-time threads.

pub use takt_rt::alloc::CountingAllocator;
use takt_rt::alloc::{RealTimeScope, enter_real_time, real_time_allocations_of_thread};

/// Counts the allocations and deallocations of this thread until [`Self::end`]. The test installs the allocator:
///
/// ```
/// use takt_tests::{Allocations, CountingAllocator};
///
/// #[global_allocator]
/// static ALLOCATOR: CountingAllocator = CountingAllocator;
///
/// let allocations = Allocations::count();
/// drop(std::hint::black_box(Box::new(1)));
/// assert_eq!(allocations.end(), 2);
/// ```
#[derive(Debug)]
pub struct Allocations {
    scope: RealTimeScope,
    before: u64,
}

impl Allocations {
    /// Starts to count.
    #[must_use]
    pub fn count() -> Self {
        let scope = enter_real_time();
        let before = real_time_allocations_of_thread();
        Self { scope, before }
    }

    /// The number so far.
    #[must_use]
    pub fn end(self) -> u64 {
        let count = real_time_allocations_of_thread() - self.before;
        drop(self.scope);
        count
    }
}

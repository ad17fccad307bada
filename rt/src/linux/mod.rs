//! All calls to the kernel: clocks, sleep, scheduler, memory, the last line before an abort.
//!
//! It makes no policy: `host` and `thread` decide what to request and how to report refusals.

pub(crate) mod clock;
pub mod ethtool;
pub(crate) mod faults;
pub mod interface;
pub(crate) mod memory;
pub(crate) mod process;
pub(crate) mod scheduler;
pub(crate) mod usage;

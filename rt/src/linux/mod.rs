//! Everything that asks the kernel for something: clocks, sleep, scheduler, memory, the last words of
//! a run.
//!
//! It decides no policy: what to ask for, and what to say when it is refused, stands in `host` and
//! `thread`.

pub(crate) mod clock;
pub mod ethtool;
pub(crate) mod faults;
pub(crate) mod memory;
pub(crate) mod process;
pub(crate) mod scheduler;
pub(crate) mod usage;

//! What the kernel counted for one thread: page faults and context switches. Flat counters over a run
//! are the field's proof that memory was resident and that nobody took the processor away.
//!
//! It names no cause and judges nothing; a cycle that calls it makes a system call.

use nix::sys::resource::{UsageWho, getrusage};

/// Counts since the start of a thread, or between two readings of it.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Usage {
    /// Page faults served without the disk.
    pub page_faults_minor: u64,
    /// Page faults that waited for the disk.
    pub page_faults_major: u64,
    /// How often the thread went to sleep or waited.
    pub context_switches_voluntary: u64,
    /// How often it was taken off its processor.
    pub context_switches_involuntary: u64,
}

impl Usage {
    /// What was added since `earlier`.
    #[must_use]
    pub fn since(&self, earlier: &Self) -> Self {
        let difference = |count: fn(&Self) -> u64| count(self).saturating_sub(count(earlier));
        Self {
            page_faults_minor: difference(|usage| usage.page_faults_minor),
            page_faults_major: difference(|usage| usage.page_faults_major),
            context_switches_voluntary: difference(|usage| usage.context_switches_voluntary),
            context_switches_involuntary: difference(|usage| usage.context_switches_involuntary),
        }
    }
}

/// The counts of the calling thread. A system call; all zero should the kernel refuse it, which only
/// a system call filter brings about.
#[must_use]
pub fn thread_usage() -> Usage {
    let Ok(usage) = getrusage(UsageWho::RUSAGE_THREAD) else {
        return Usage::default();
    };
    let count = |value: libc::c_long| u64::try_from(value).unwrap_or(0);
    Usage {
        page_faults_minor: count(usage.minor_page_faults()),
        page_faults_major: count(usage.major_page_faults()),
        context_switches_voluntary: count(usage.voluntary_context_switches()),
        context_switches_involuntary: count(usage.involuntary_context_switches()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fresh_memory_and_a_sleep_are_counted() {
        let before = thread_usage();
        let pages = std::hint::black_box(vec![1_u8; 1 << 20]);
        let deadline = crate::monotonic() + crate::Nanos::from_millis(20);
        crate::sleep_until(deadline).unwrap();
        let spent = thread_usage().since(&before);
        drop(pages);
        assert!(spent.page_faults_minor + spent.page_faults_major > 0);
        assert!(spent.context_switches_voluntary > 0);
        assert_eq!(before.since(&before), Usage::default());
    }
}

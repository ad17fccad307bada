//! The kernel's counters of one thread: page faults and context switches. Constant counters over a run
//! show that memory was resident and that no other thread preempted this one.
//!
//! It gives no cause; each query is a system call.

use nix::sys::resource::{UsageWho, getrusage};

/// Counts since the start of a thread, or between two readings of it.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Usage {
    /// Page faults resolved without disk access.
    pub page_faults_minor: u64,
    /// Page faults resolved with disk access.
    pub page_faults_major: u64,
    /// Number of times the thread slept or waited.
    pub context_switches_voluntary: u64,
    /// Number of times the thread was preempted.
    pub context_switches_involuntary: u64,
}

impl Usage {
    /// Difference since `earlier`.
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

/// The counters of the calling thread. A system call; all zero if the kernel rejects it, which only a
/// system call filter does.
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
    fn usage_counts_fresh_memory_and_sleep() {
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

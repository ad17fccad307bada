//! Policy, priority and affinity of a thread.
//!
//! It reads no rlimit: capabilities, cgroups and system call filters matter too, so only an attempt shows.
#![expect(
    unsafe_code,
    reason = "sched_setscheduler and prctl have no safe wrapper in nix"
)]

use std::fs;

use nix::{
    errno::Errno,
    sched::{CpuSet, sched_setaffinity},
    unistd::Pid,
};

/// Sets `SCHED_FIFO` for the calling thread. Threads it creates later start as ordinary ones.
pub(crate) fn set_fifo(priority: u8) -> Result<(), Errno> {
    let parameters = libc::sched_param {
        sched_priority: i32::from(priority),
    };
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: 0 means the calling thread; the pointer is to a live local.
    Errno::result(unsafe { libc::sched_setscheduler(0, policy, &raw const parameters) }).map(drop)
}

/// Restricts the calling thread to `cpus`.
pub(crate) fn set_affinity(cpus: &[usize]) -> Result<(), Errno> {
    let mut set = CpuSet::new();
    for &cpu in cpus {
        set.set(cpu)?;
    }
    sched_setaffinity(Pid::from_raw(0), &set)
}

/// Sets the timer slack: how long the kernel may delay sleeps of this thread and of threads it creates
/// later to save wake-ups. Real-time policies have none.
pub(crate) fn set_timer_slack(slack_ns: libc::c_ulong) -> Result<(), Errno> {
    // SAFETY: this operation takes an integer and no pointer.
    Errno::result(unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, slack_ns) }).map(drop)
}

/// Whether this process seems to have the right for `set_fifo`, so that a refusal has another cause. Used
/// in the remedy's text only.
pub(crate) fn has_cap_sys_nice() -> bool {
    fs::read_to_string("/proc/thread-self/status")
        .is_ok_and(|status| has_capability(&status, CAP_SYS_NICE))
}

const CAP_SYS_NICE: u32 = 23;

fn has_capability(status: &str, bit: u32) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    mask.and_then(|hex| u64::from_str_radix(hex.trim(), 16).ok())
        .is_some_and(|mask| mask & (1 << bit) != 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capability_is_read_from_status_text() {
        let status = "Name:\tx\nCapPrm:\tffffffffffffffff\nCapEff:\t0000000000800000\n";
        assert!(has_capability(status, CAP_SYS_NICE));
        assert!(!has_capability(status, 14));
        assert!(!has_capability("CapEff:\tnonsense", CAP_SYS_NICE));
        assert!(!has_capability("", CAP_SYS_NICE));
    }

    #[test]
    fn affinity_impossible_cpu_is_an_error() {
        assert_eq!(set_affinity(&[usize::MAX]), Err(Errno::EINVAL));
    }
}

//! The one clock and the one sleep of the crate.
//!
//! Not wall-clock time: that one is stepped by administrators and time servers.

use std::io;

use nix::{
    errno::Errno,
    sys::time::TimeSpec,
    time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep},
};

use crate::Nanos;

const NANOS_PER_SECOND: i64 = 1_000_000_000;

/// Now, on `CLOCK_MONOTONIC`. No system call on common hosts (vDSO), no allocation.
///
/// # Panics
/// Never on Linux, where this clock always exists.
#[must_use]
pub fn monotonic() -> Nanos {
    let now = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("every Linux has CLOCK_MONOTONIC");
    Nanos(now.tv_sec() * NANOS_PER_SECOND + now.tv_nsec())
}

/// Sleeps until `deadline` on `CLOCK_MONOTONIC`; signals do not shorten it. A past deadline still
/// costs a system call of up to 20 µs: who knows the time should not call then.
///
/// An absolute `clock_nanosleep`, because its timer is the one that PREEMPT_RT serves in hard interrupt
/// context for real-time threads; a timerfd would wait for a kernel thread.
///
/// # Errors
/// If the kernel refuses the call, which only a system call filter brings about.
pub fn sleep_until(deadline: Nanos) -> io::Result<()> {
    let deadline = deadline.max(Nanos::ZERO);
    let request = TimeSpec::new(deadline.0 / NANOS_PER_SECOND, deadline.0 % NANOS_PER_SECOND);
    loop {
        // The error is this call's value; errno is not set.
        match clock_nanosleep(
            ClockId::CLOCK_MONOTONIC,
            ClockNanosleepFlags::TIMER_ABSTIME,
            &request,
        ) {
            Ok(_) => return Ok(()),
            Err(Errno::EINTR) => {}
            Err(error) => return Err(error.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleeps_to_the_deadline_and_not_for_a_span() {
        let deadline = monotonic() + Nanos::from_micros(200);
        sleep_until(deadline).unwrap();
        assert!(monotonic() >= deadline);
        sleep_until(Nanos::ZERO).unwrap();
        sleep_until(Nanos(-1)).unwrap();
    }
}

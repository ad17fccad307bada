//! The only clock and the only waits of the crate: of the host, or in [simulated time](crate::simulated).
//!
//! Not wall-clock time, which administrators and time servers step.
//!
//! Both are inlined into the calling loop and call the C library directly. Between two cycles a busy host
//! evicts caches and address translations; each further page of code between waking and reading the clock
//! then costs up to a microsecond.
#![expect(unsafe_code, reason = "the safe wrappers lie in other pages of code")]

use std::{io, os::fd::BorrowedFd, ptr, time::Duration};

use nix::{
    errno::Errno,
    poll::{PollFd, PollFlags, ppoll},
    sys::time::TimeSpec,
};

use crate::{Nanos, simulated, tai::Reading};

const NANOS_PER_SECOND: i64 = 1_000_000_000;

/// Current time of `CLOCK_MONOTONIC`, or [simulated](crate::simulated) time. No system call on common hosts (vDSO), no
/// allocation.
///
/// # Panics
/// Never on Linux, where this clock always exists.
#[inline]
pub fn monotonic() -> Nanos {
    let now = host_clock();
    if simulated::is_on() {
        return simulated::at(now);
    }
    now
}

#[inline]
pub(crate) fn host_clock() -> Nanos {
    let mut now = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: `now` is valid for writing a timespec, and is not kept.
    let status = unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) };
    assert!(status == 0, "every Linux has CLOCK_MONOTONIC");
    Nanos(now.tv_sec * NANOS_PER_SECOND + now.tv_nsec)
}

/// Triples that a reading of TAI is chosen from.
const TRIPLES: usize = 8;

fn clock(id: libc::clockid_t) -> Option<Nanos> {
    let mut now = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: `now` is valid for writing a timespec, and is not kept.
    let status = unsafe { libc::clock_gettime(id, &raw mut now) };
    (status == 0).then_some(Nanos(now.tv_sec * NANOS_PER_SECOND + now.tv_nsec))
}

/// Reads `CLOCK_TAI` against `CLOCK_MONOTONIC`, and what the kernel knows of its time service. Not for real-time
/// threads: it makes a system call. In simulated time both clocks are as far from the host's as
/// [`monotonic`].
///
/// # Errors
/// If the kernel has no such clock or a system call filter rejects the call.
pub fn read_tai() -> io::Result<Reading> {
    // SAFETY: all fields of a `timex` are integers, for which zero is a value.
    let mut kernel: libc::timex = unsafe { std::mem::zeroed() };
    // SAFETY: `kernel` is valid for reading and writing a timex; `modes` is 0, so that nothing is set.
    let status = unsafe { libc::adjtimex(&raw mut kernel) };
    if status < 0 {
        return Err(io::Error::last_os_error());
    }
    let mut narrowest = None;
    for _ in 0..TRIPLES {
        let before = host_clock();
        let tai = clock(libc::CLOCK_TAI).ok_or_else(io::Error::last_os_error)?;
        let after = host_clock();
        if narrowest.is_none_or(|(b, _, a): (Nanos, _, Nanos)| after - before < a - b) {
            narrowest = Some((before, tai, after));
        }
    }
    let (before, tai, after) = narrowest.unwrap_or_default();
    let ahead = simulated::ahead();
    Ok(Reading {
        before: before + ahead,
        tai: tai + ahead,
        after: after + ahead,
        tai_utc_s: kernel.tai,
        unsynchronised: kernel.status & libc::STA_UNSYNC != 0,
        max_error: Nanos::from_micros(kernel.maxerror),
        estimated_error: Nanos::from_micros(kernel.esterror),
    })
}

/// The processor on which the calling thread runs; `None` if the system does not say. No system call on common hosts,
/// no allocation.
pub(crate) fn processor() -> Option<usize> {
    // SAFETY: it takes nothing and touches no memory of ours.
    let number = unsafe { libc::sched_getcpu() };
    usize::try_from(number).ok()
}

/// Sleeps until `deadline` on the clock of [`monotonic`]; signals do not shorten it. A past deadline still costs a
/// system call of up to 20 µs: a caller that knows the time should not call then.
///
/// It uses an absolute `clock_nanosleep`, whose timer PREEMPT_RT handles in hard interrupt context for
/// real-time threads; a timerfd would wait for a kernel thread.
///
/// # Errors
/// If the kernel rejects the call, which only a system call filter does.
#[inline]
pub fn sleep_until(deadline: Nanos) -> io::Result<()> {
    if !simulated::is_on() {
        return sleep_on_host(deadline);
    }
    while let Some(until) = simulated::sleep(deadline) {
        sleep_on_host(until)?;
    }
    Ok(())
}

/// How long the calling thread may wait for something else than the clock before it asks again, if its wait ends at `until`;
/// zero once that has come. On the host's clock this is all that is left, in [simulated](crate::simulated) time a part.
#[inline]
pub fn may_wait(until: Nanos) -> Duration {
    let left = if simulated::is_on() {
        simulated::slice(until)
    } else {
        until - host_clock()
    };
    left.try_into().unwrap_or_default()
}

/// Sleeps until a descriptor is readable, at most `timeout`, with the resolution of the host's timers; returns whether it may
/// be readable. A signal ends the wait early.
///
/// # Errors
/// Of the operating system.
pub fn readable(fd: BorrowedFd<'_>, timeout: Duration) -> io::Result<bool> {
    let until = monotonic() + timeout.into();
    let mut waits = [PollFd::new(fd, PollFlags::POLLIN)];
    loop {
        let left = may_wait(until);
        match ppoll(&mut waits, Some(TimeSpec::from_duration(left)), None) {
            Ok(0) if may_wait(until).is_zero() => return Ok(false),
            Ok(0) => {}
            Ok(_) => return Ok(true),
            Err(Errno::EINTR) => return Ok(false),
            Err(error) => return Err(error.into()),
        }
    }
}

#[inline]
fn sleep_on_host(deadline: Nanos) -> io::Result<()> {
    let deadline = deadline.max(Nanos::ZERO);
    let request = libc::timespec {
        tv_sec: deadline.0 / NANOS_PER_SECOND,
        tv_nsec: deadline.0 % NANOS_PER_SECOND,
    };
    loop {
        // SAFETY: `request` is a valid timespec, nanoseconds below a second; with an absolute time nothing
        // is written, so the null pointer is allowed.
        let status = unsafe {
            libc::clock_nanosleep(
                libc::CLOCK_MONOTONIC,
                libc::TIMER_ABSTIME,
                &raw const request,
                ptr::null_mut(),
            )
        };
        // The call returns the error; errno is not set.
        match status {
            0 => return Ok(()),
            libc::EINTR => {}
            error => return Err(Errno::from_raw(error).into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tai_reading_lies_between_readings_of_monotonic() {
        let before = monotonic();
        let reading = read_tai().unwrap();
        assert!(before <= reading.before && reading.before <= reading.after);
        assert!(reading.after <= monotonic());
        assert!(reading.tai > Nanos::ZERO);
    }

    #[test]
    fn sleep_until_uses_absolute_deadline() {
        let deadline = monotonic() + Nanos::from_micros(200);
        sleep_until(deadline).unwrap();
        assert!(monotonic() >= deadline);
        sleep_until(Nanos::ZERO).unwrap();
        sleep_until(Nanos(-1)).unwrap();
    }
}

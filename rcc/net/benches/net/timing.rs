//! Two methods to time alternating subjects on a shared machine: back to back, and once a
//! millisecond in a `SCHED_FIFO` loop, where other programs have used the caches in between. It
//! judges nothing.

use nix::errno::Errno;
use nix::sys::time::TimeSpec;
use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};

use crate::quantiles::{as_f64, median};

/// A function to be timed.
pub(crate) type Subject<'s> = &'s mut dyn FnMut();

const BATCHES: usize = 5 * BLOCK;
const PRIORITY: i32 = 90;
const PERIOD_NS: i64 = 1_000_000;
/// Consecutive cycles of one subject.
const BLOCK: usize = 50;

/// The monotonic clock, ns.
pub(crate) fn now() -> i64 {
    let now = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("every Linux has this clock");
    now.tv_sec() * 1_000_000_000 + now.tv_nsec()
}

/// The duration of one call of each subject, ns, in batches of `calls`; subjects alternate.
pub(crate) fn warm<const N: usize>(calls: u32, mut subjects: [Subject<'_>; N]) -> [Vec<f64>; N] {
    let mut times = [const { Vec::new() }; N];
    for _ in 0..BATCHES {
        for (subject, times) in subjects.iter_mut().zip(&mut times) {
            subject();
            let start = now();
            for _ in 0..calls {
                subject();
            }
            times.push(as_f64(now() - start) / f64::from(calls));
        }
    }
    times
}

/// The duration of each call, ns, of subjects that alternate in a 1 kHz loop, `cycles` each.
pub(crate) fn paced<const N: usize>(
    cycles: usize,
    mut subjects: [Subject<'_>; N],
) -> [Vec<f64>; N] {
    let mut times = [(); N].map(|()| Vec::with_capacity(cycles));
    let mut next = now();
    for _ in 0..cycles / BLOCK {
        for (subject, times) in subjects.iter_mut().zip(&mut times) {
            for _ in 0..BLOCK {
                next = wait(next);
                let start = now();
                subject();
                times.push(as_f64(now() - start));
            }
        }
    }
    times
}

/// Sleeps until a millisecond after `last`, unless that is over; returns the start of the next
/// cycle.
fn wait(last: i64) -> i64 {
    let (now, next) = (now(), last + PERIOD_NS);
    if next <= now {
        return now;
    }
    let at = TimeSpec::new(next / 1_000_000_000, next % 1_000_000_000);
    let flags = ClockNanosleepFlags::TIMER_ABSTIME;
    while clock_nanosleep(ClockId::CLOCK_MONOTONIC, flags, &at) == Err(Errno::EINTR) {}
    next
}

/// Runs `work` under `SCHED_FIFO`; returns whether that was granted, and its result.
pub(crate) fn in_real_time<R>(work: impl FnOnce() -> R) -> (bool, R) {
    let granted = schedule(libc::SCHED_FIFO, PRIORITY);
    let result = work();
    (granted && schedule(libc::SCHED_OTHER, 0), result)
}

fn schedule(policy: i32, sched_priority: i32) -> bool {
    let parameters = libc::sched_param { sched_priority };
    // SAFETY: 0 means the calling thread; the pointer is to a live local.
    unsafe { libc::sched_setscheduler(0, policy, &raw const parameters) == 0 }
}

/// The median over pieces of the run of the ratio of the medians within a piece, so that neither a
/// disturbed piece nor a slow drift of the machine has an influence.
pub(crate) fn ratio(ours: &[f64], theirs: &[f64]) -> f64 {
    let pieces = ours.chunks(BLOCK).zip(theirs.chunks(BLOCK));
    let ratios: Vec<f64> = pieces.map(|(a, b)| median(a) / median(b)).collect();
    median(&ratios)
}

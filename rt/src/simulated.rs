//! Simulated time: the clock of a process whose robots are emulated waits for its threads. Where the host stalls, real robots
//! move on and a controller misses cycles; emulated ones share its processors, and what they would show is the host's fault.
//!
//! It is a conservative synchronization of threads in the sense of Chandy and Misra: the time does not pass the instant until
//! which a thread waits by more than [`SLACK`] before that thread has run. Where no thread is late it runs at a factor of the
//! host's clock: 1 for programs outside of it, which see robots move as usual, more for tests. Never for hardware: a real bus
//! does not wait.
//!
//! Threads that are made in simulated time get no real-time priority: the time waits for them anyway, and programs beside them need
//! processors too.
//!
//! Threads that wait by [`sleep_until`](crate::sleep_until), [`may_wait`](crate::may_wait) or [`readable`](crate::readable) take
//! part by that: cycles, drivers and emulators over UDP, TCP and cables in memory. CAN sockets do not.

use std::sync::Once;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicUsize, Ordering};

use crate::{Nanos, linux::clock::host_clock};

/// How late a thread may run before the time waits for it: what an idle host does is part of an emulation.
pub const SLACK: Nanos = Nanos::from_micros(500);
/// The time waits no longer for a thread, on the host's clock: that waits for something else than the clock.
pub const TIMEOUT: Nanos = Nanos::from_millis(2_000);
/// A thread that waits for something else besides the clock looks at both this often.
const SLICE: Nanos = Nanos::from_micros(500);
/// Threads that the time waits for; it does not wait for more.
pub const THREADS_MAX: usize = 256;
/// While the time stands, threads look at it this often, on the host's clock.
const STANDS: Nanos = Nanos::from_micros(200);
/// A thread without a wait.
const NEVER: i64 = i64::MAX;

/// Smallest and largest real-time factor.
pub const FACTORS: [f64; 2] = [0.1, 10.0];
/// What a factor is a multiple of.
const PER_MILLION: i64 = 1_000_000;

static BEGIN: Once = Once::new();
static IS_ON: AtomicBool = AtomicBool::new(false);
static CLOCK: Clock = Clock::new();

/// From now on and to its end, [`monotonic`](crate::monotonic) of this process is simulated, at most `factor` as fast as the
/// host's (limited to [`FACTORS`]). It goes on from that. Further calls change nothing.
pub fn begin(factor: f64) {
    BEGIN.call_once(|| {
        CLOCK.start(factor, host_clock());
        IS_ON.store(true, Ordering::Release);
    });
}

/// How long the time has waited for threads so far, on the host's clock. `None` if it is not simulated.
#[must_use]
pub fn waited() -> Option<Nanos> {
    is_on().then(|| CLOCK.on_host(Nanos(CLOCK.behind.load(Ordering::Relaxed))))
}

/// How far the time is ahead of the host's clock.
pub(crate) fn ahead() -> Nanos {
    let real = host_clock();
    if is_on() {
        at(real) - real
    } else {
        Nanos::ZERO
    }
}

#[inline]
pub(crate) fn is_on() -> bool {
    IS_ON.load(Ordering::Relaxed)
}

/// The simulated time at `real` of the host's clock.
pub(crate) fn at(real: Nanos) -> Nanos {
    CLOCK.now(real)
}

/// The calling thread waits until an instant; until when it may sleep, on the host's clock. `None` if that has come.
pub(crate) fn sleep(until: Nanos) -> Option<Nanos> {
    let real = host_clock();
    let left = wait(until, real);
    (left > Nanos::ZERO).then(|| real + left)
}

/// The calling thread waits for something else until an instant at most; how long it may block before it asks again.
pub(crate) fn slice(until: Nanos) -> Nanos {
    let real = host_clock();
    let next = CLOCK.now(real) + SLICE;
    wait(until.min(next), real)
}

/// How long the calling thread has to wait for an instant, which the time will not pass before it runs; on the host's clock.
fn wait(until: Nanos, real: Nanos) -> Nanos {
    let (left, stands) = SEAT
        .try_with(|seat| match seat.0 {
            Some(number) => CLOCK.wait(number, until, real),
            None => {
                let (now, stands) = CLOCK.read(real);
                (until - now, stands)
            }
        })
        .unwrap_or_default();
    let left = CLOCK.on_host(left);
    if stands && left > Nanos::ZERO {
        left.max(STANDS)
    } else {
        left
    }
}

/// The place of a thread among those that the time waits for.
struct Seat(Option<usize>);

impl Drop for Seat {
    fn drop(&mut self) {
        if let Some(number) = self.0 {
            CLOCK.leave(number);
        }
    }
}

thread_local! {
    static SEAT: Seat = Seat(CLOCK.take_part());
}

/// A thread that the time waits for.
struct Participant {
    is_taken: AtomicBool,
    /// Until when it waits or last waited; the time passes this by [`SLACK`] at most.
    until_ns: AtomicI64,
    /// Since when the time waits for it, on the host's clock.
    late_since_ns: AtomicI64,
}

impl Participant {
    /// The time does not pass this, at `real` of the host's clock; without waits it would be `free`.
    fn end(&self, real: Nanos, free: i64) -> i64 {
        let end = self
            .until_ns
            .load(Ordering::Acquire)
            .saturating_add(SLACK.0);
        let relaxed = Ordering::Relaxed;
        if end > free {
            self.late_since_ns.store(NEVER, relaxed);
            return end;
        }
        // By the first that notices: a host that stands as a whole is no timeout.
        let noticed = self
            .late_since_ns
            .compare_exchange(NEVER, real.0, relaxed, relaxed);
        let since = noticed.unwrap_or_else(|since| since);
        if noticed.is_err() && real.0 - since > TIMEOUT.0 {
            NEVER
        } else {
            end
        }
    }
}

/// The clock: wait-free, any thread may read it.
struct Clock {
    /// Where it began, on both clocks.
    began: AtomicI64,
    factor_per_million: AtomicI64,
    /// How long it has waited. It only grows.
    behind: AtomicI64,
    /// The latest time that anybody has read: it never goes back.
    read: AtomicI64,
    /// Places that have been taken so far; beyond them, there is nothing to look at.
    used: AtomicUsize,
    participants: [Participant; THREADS_MAX],
}

impl Clock {
    const fn new() -> Self {
        Self {
            began: AtomicI64::new(0),
            factor_per_million: AtomicI64::new(PER_MILLION),
            behind: AtomicI64::new(0),
            read: AtomicI64::new(0),
            used: AtomicUsize::new(0),
            participants: [const {
                Participant {
                    is_taken: AtomicBool::new(false),
                    until_ns: AtomicI64::new(NEVER),
                    late_since_ns: AtomicI64::new(NEVER),
                }
            }; THREADS_MAX],
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "between the smallest and the largest factor"
    )]
    fn start(&self, factor: f64, real: Nanos) {
        let [least, most] = FACTORS;
        let factor = factor.clamp(least, most) * PER_MILLION as f64;
        self.began.store(real.0, Ordering::Relaxed);
        self.factor_per_million
            .store(factor as i64, Ordering::Relaxed);
    }

    /// The time at `real` of the host's clock without waits.
    fn unwaited(&self, real: Nanos) -> i64 {
        let began = self.began.load(Ordering::Relaxed);
        let factor = self.factor_per_million.load(Ordering::Relaxed);
        let passed = real.0.saturating_sub(began);
        if factor == PER_MILLION {
            return real.0;
        }
        let passed = i128::from(passed) * i128::from(factor) / i128::from(PER_MILLION);
        began.saturating_add(i64::try_from(passed).unwrap_or(i64::MAX))
    }

    /// A span of it on the host's clock.
    fn on_host(&self, span: Nanos) -> Nanos {
        let factor = self.factor_per_million.load(Ordering::Relaxed).max(1);
        let span = i128::from(span.0) * i128::from(PER_MILLION) / i128::from(factor);
        Nanos(i64::try_from(span).unwrap_or(i64::MAX))
    }

    fn take_part(&self) -> Option<usize> {
        let takes = |it: &Participant| !it.is_taken.swap(true, Ordering::AcqRel);
        let number = self.participants.iter().position(takes)?;
        self.used.fetch_max(number + 1, Ordering::AcqRel);
        Some(number)
    }

    fn leave(&self, number: usize) {
        if let Some(participant) = self.participants.get(number) {
            participant.until_ns.store(NEVER, Ordering::Release);
            participant.is_taken.store(false, Ordering::Release);
        }
    }

    fn now(&self, real: Nanos) -> Nanos {
        self.read(real).0
    }

    /// The time at `real` of the host's clock, and whether it stands: it does at the end of the slack of the latest thread.
    fn read(&self, real: Nanos) -> (Nanos, bool) {
        let unwaited = self.unwaited(real);
        let free = unwaited - self.behind.load(Ordering::Acquire);
        // Another thread may have read a later time meanwhile.
        let free = free.max(self.read.load(Ordering::Acquire));
        let used = self.participants.iter();
        let used = used.take(self.used.load(Ordering::Acquire));
        let ends = used.map(|it| it.end(real, free));
        let end = ends.fold(NEVER, i64::min);
        let now = self.read.fetch_max(free.min(end), Ordering::AcqRel);
        let now = now.max(free.min(end));
        if now < free {
            self.behind.fetch_max(unwaited - now, Ordering::AcqRel);
        }
        (Nanos(now), end <= now)
    }

    /// A thread waits until an instant; how long that is from now, and whether the time stands.
    fn wait(&self, number: usize, until: Nanos, real: Nanos) -> (Nanos, bool) {
        // First, while the time still waits for this thread: what it has waited so far is not made up.
        let (now, stands) = self.read(real);
        let left = until - now;
        if let Some(participant) = self.participants.get(number) {
            let until = until.max(now);
            participant.until_ns.store(until.0, Ordering::Release);
            participant.late_since_ns.store(NEVER, Ordering::Relaxed);
        }
        (left, stands)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: i64 = 1_000_000;

    fn ms(count: i64) -> Nanos {
        Nanos(count * MS)
    }

    /// A clock with threads that wait until these instants, from 0 on.
    fn clock(waits: &[Nanos]) -> Clock {
        let clock = Clock::new();
        for until in waits {
            let number = clock.take_part().unwrap();
            clock.wait(number, *until, Nanos::ZERO);
        }
        clock
    }

    #[test]
    fn simulated_time_is_that_of_host_while_no_thread_is_late() {
        let clock = clock(&[ms(2)]);
        for real in [ms(0), ms(1), ms(2), ms(2) + SLACK] {
            assert_eq!(clock.now(real), real);
        }
        assert_eq!(clock.behind.load(Ordering::Relaxed), 0);
    }

    #[test]
    fn simulated_time_stands_until_late_thread_runs_and_goes_on_from_there() {
        let clock = clock(&[ms(2), ms(4)]);
        let stands = ms(2) + SLACK;
        assert_eq!(clock.now(ms(10)), stands);
        assert_eq!(clock.now(ms(20)), stands);
        // The late thread runs: what it waits for next is as far away as without the stall.
        assert_eq!(clock.wait(0, ms(4), ms(22)).0, ms(2) - SLACK);
        assert_eq!(clock.now(ms(23)), stands + ms(1));
        // Now the other one is late too.
        assert_eq!(clock.now(ms(100)), ms(4) + SLACK);
    }

    #[test]
    fn simulated_time_of_stall_before_next_wait_is_not_made_up() {
        let clock = clock(&[ms(2)]);
        // No thread reads the clock during the stall; the stalled one does behind it.
        assert_eq!(clock.wait(0, ms(4), ms(50)).0, ms(2) - SLACK);
        assert_eq!(clock.now(ms(51)), ms(3) + SLACK);
    }

    #[test]
    fn simulated_time_waits_until_timeout_and_not_for_threads_that_ended() {
        let waiting = clock(&[ms(2)]);
        let stands = ms(2) + SLACK;
        // The host stood as a whole for an hour: the thread could not run.
        let awake = ms(3_600_000);
        assert_eq!(waiting.now(awake), stands);
        assert_eq!(waiting.now(awake + TIMEOUT), stands);
        assert_eq!(waiting.now(awake + TIMEOUT + ms(1)), stands + ms(1));
        assert_eq!(waiting.now(awake + TIMEOUT + ms(3)), stands + ms(3));
        // It waits again, and is awaited again.
        waiting.wait(0, stands + ms(4), awake + TIMEOUT + ms(3));
        assert_eq!(
            waiting.now(awake + TIMEOUT + TIMEOUT),
            stands + ms(4) + SLACK
        );
        let ended = clock(&[ms(2)]);
        ended.leave(0);
        assert_eq!(ended.now(ms(10)), ms(10));
    }

    #[test]
    fn simulated_time_of_past_wait_stands_where_it_is() {
        let clock = clock(&[ms(2)]);
        assert_eq!(clock.now(ms(1)), ms(1));
        assert_eq!(clock.wait(0, ms(-5), ms(1)).0, ms(-6));
        assert_eq!(clock.now(ms(9)), ms(1) + SLACK);
    }

    #[test]
    fn simulated_time_runs_at_its_factor_and_waits_are_on_clock_of_host() {
        for (factor, passed) in [
            (3.0, ms(6)),
            (0.5, ms(1)),
            (1.0, ms(2)),
            (0.0, Nanos::from_micros(200)),
        ] {
            let clock = Clock::new();
            clock.start(factor, ms(1_000));
            assert_eq!(clock.now(ms(1_002)), ms(1_000) + passed, "{factor}");
            assert_eq!(clock.on_host(passed), ms(2));
        }
        let late = clock(&[ms(2)]);
        late.start(2.0, Nanos::ZERO);
        let stands = ms(2) + SLACK;
        assert_eq!(late.now(ms(10)), stands);
        assert_eq!(late.wait(0, ms(4), ms(11)).0, ms(4) - stands);
        assert_eq!(
            late.now(ms(12)),
            ms(4) + SLACK,
            "the next instant, waited for"
        );
    }

    #[test]
    fn simulated_time_seats_are_taken_again() {
        let clock = Clock::new();
        for number in 0..THREADS_MAX {
            assert_eq!(clock.take_part(), Some(number));
        }
        assert_eq!(clock.take_part(), None);
        clock.leave(7);
        assert_eq!(clock.take_part(), Some(7));
    }

    proptest! {
        /// Whatever threads wait for and however late they run: the time never goes back, is never ahead of the host's, and a
        /// thread that is awaited sees it at most its slack after what it waited for.
        #[test]
        fn simulated_time_never_goes_back(
            steps in proptest::collection::vec((0..4_usize, 0..20_i64 * MS, -MS..10 * MS), 1..200),
        ) {
            let clock = clock(&[Nanos::ZERO; 4]);
            let (mut real, mut last, mut until) = (Nanos::ZERO, Nanos::ZERO, [Nanos::ZERO; 4]);
            for (number, passed, wait) in steps {
                real += Nanos(passed);
                let now = clock.now(real);
                prop_assert!(now >= last && now <= real);
                prop_assert!(now <= until.into_iter().min().unwrap() + SLACK);
                last = now;
                until[number] = (now + Nanos(wait)).max(now);
                clock.wait(number, now + Nanos(wait), real);
            }
        }
    }
}

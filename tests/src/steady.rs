//! Tests of moving robots on a host without real time: their assertions hold while the host does
//! not stall. Stalls are measured, never guessed.

#![expect(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "test support, which may fail anywhere with a message"
)]

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::thread::available_parallelism;
use std::time::{Duration, Instant};

use takt_rt::thread::{Thread, ThreadConfig, spawn};

/// Number of attempts if the host stalls.
const ATTEMPTS: u32 = 10;

/// Stalls that a cell tolerates: longer ones lose a frame or two, and several in a row a device.
const TOLERATED: Duration = Duration::from_millis(1);

/// Held by the tests of this process: first attempts share it, so that robots move beside each other; a repeated
/// attempt has the process to itself, as the others may be what stalled it.
static ALONE: RwLock<()> = RwLock::new(());

/// Runs a test, and repeats it if it failed while the host stalled for longer than a robot
/// tolerates, ten times at most, then beside no other such test of the process. A failure on a host that did not
/// stall is a failure.
///
/// # Panics
/// As the test does. If the threads that watch the host cannot be started.
pub fn steady<T>(test: impl Fn() -> T) -> T {
    let mut attempt = 1;
    loop {
        let _turn = Turn::take(attempt > 1);
        let host = Stalls::watch();
        let panic = match catch_unwind(AssertUnwindSafe(&test)) {
            Ok(made) => return made,
            Err(panic) => panic,
        };
        let longest = host.longest();
        if longest <= TOLERATED || attempt == ATTEMPTS {
            resume_unwind(panic);
        }
        eprintln!("attempt {attempt}: the host stalled for {longest:?}; trying again");
        attempt += 1;
    }
}

thread_local! {
    /// Whether this thread has its turn: what it repeats inside of it takes no other.
    static HAS_TURN: Cell<bool> = const { Cell::new(false) };
}

/// An attempt beside others, or alone.
struct Turn(
    #[expect(dead_code, reason = "held")]
    Result<RwLockReadGuard<'static, ()>, RwLockWriteGuard<'static, ()>>,
);

impl Turn {
    /// Waits for it; `None` if this thread has one.
    fn take(is_alone: bool) -> Option<Self> {
        if HAS_TURN.replace(true) {
            return None;
        }
        Some(Self(if is_alone {
            Err(ALONE.write().unwrap_or_else(PoisonError::into_inner))
        } else {
            Ok(ALONE.read().unwrap_or_else(PoisonError::into_inner))
        }))
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        HAS_TURN.set(false);
    }
}

/// One thread of highest priority on each processor that measures when the processor stalls.
struct Stalls {
    stop: Arc<AtomicBool>,
    longest: Arc<AtomicU64>,
    threads: Vec<Thread<()>>,
}

impl Stalls {
    fn watch() -> Self {
        let (stop, longest) = (Arc::default(), Arc::default());
        let count = available_parallelism().map_or(1, usize::from);
        let watcher = |cpu| {
            let (stop, longest) = (Arc::clone(&stop), Arc::clone(&longest));
            let config = ThreadConfig {
                priority: Some(98),
                cpus: vec![cpu],
                ..ThreadConfig::new("stalls")
            };
            spawn(config, move || measure(&stop, &longest)).unwrap()
        };
        let threads = (0..count).map(watcher).collect();
        Self {
            stop,
            longest,
            threads,
        }
    }

    /// Waits for watchers that are still stalled.
    fn longest(mut self) -> Duration {
        self.end();
        Duration::from_nanos(self.longest.load(Ordering::Relaxed))
    }

    fn end(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            thread.join().unwrap();
        }
    }
}

impl Drop for Stalls {
    fn drop(&mut self) {
        self.end();
    }
}

/// Measures by how much sleeps of a millisecond are late.
fn measure(stop: &AtomicBool, longest: &AtomicU64) {
    let pause = Duration::from_millis(1);
    while !stop.load(Ordering::Relaxed) {
        let begin = Instant::now();
        std::thread::sleep(pause);
        let late = begin.elapsed().saturating_sub(pause).as_nanos();
        longest.fetch_max(u64::try_from(late).unwrap_or(u64::MAX), Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;

    #[test]
    fn steady_permanent_failure_fails_within_attempts() {
        let attempts = Cell::new(0);
        let failed = catch_unwind(AssertUnwindSafe(|| {
            steady(|| {
                attempts.set(attempts.get() + 1);
                assert_eq!(attempts.get(), 0, "fails whatever the host does");
            });
        }));
        assert!(failed.is_err());
        assert!((1..=ATTEMPTS).contains(&attempts.get()));
    }

    #[test]
    fn steady_within_steady_repeats_beside_others() {
        let begin = Arc::new(Barrier::new(2));
        let other = Arc::clone(&begin);
        // Fails once, and is repeated alone while the first one is under way.
        let thread = std::thread::spawn(move || {
            let attempts = Cell::new(0);
            let _ = catch_unwind(AssertUnwindSafe(|| {
                steady(|| {
                    attempts.set(attempts.get() + 1);
                    if attempts.get() == 1 {
                        other.wait();
                        std::thread::sleep(Duration::from_millis(20));
                        panic!("once");
                    }
                    steady(|| ());
                });
            }));
        });
        steady(|| {
            begin.wait();
            std::thread::sleep(Duration::from_millis(100));
            steady(|| ());
        });
        thread.join().unwrap();
    }

    #[test]
    fn steady_returns_result() {
        assert_eq!(steady(|| 7), 7);
    }
}

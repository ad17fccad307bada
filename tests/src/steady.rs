//! Real time on a host that has none: what a test asserts of a moving robot holds while the host does not stall.
//! That it stalled is seen, never guessed.

#![expect(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "a part of tests, which may fail anywhere and say so"
)]

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::available_parallelism;
use std::time::{Duration, Instant};

use takt_rt::thread::{Thread, ThreadConfig, spawn};

/// How often a test is begun again because the host stalled.
const ATTEMPTS: u32 = 10;

/// Stalls a cell lives through: longer ones lose a frame or two, and some in a row a device.
const FORGIVEN: Duration = Duration::from_millis(1);

/// Runs a test, and again if it failed while the host stood still for longer than a robot forgives, ten times
/// at most. A failure on a host that did not is a failure.
///
/// # Panics
/// As the test does. If there is no thread to be had that watches the host.
pub fn steady<T>(test: impl Fn() -> T) -> T {
    let mut attempt = 1;
    loop {
        let host = Stalls::watch();
        let panic = match catch_unwind(AssertUnwindSafe(&test)) {
            Ok(made) => return made,
            Err(panic) => panic,
        };
        let longest = host.longest();
        if longest <= FORGIVEN || attempt == ATTEMPTS {
            resume_unwind(panic);
        }
        eprintln!("attempt {attempt}: the host stood still for {longest:?}; once more");
        attempt += 1;
    }
}

/// Threads above all others, one on each processor, that see when theirs is taken away.
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
            spawn(config, move || look(&stop, &longest)).unwrap()
        };
        let threads = (0..count).map(watcher).collect();
        Self {
            stop,
            longest,
            threads,
        }
    }

    /// Watchers that are still held up are waited for.
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

/// Notes by how much a sleep of a millisecond takes longer than that.
fn look(stop: &AtomicBool, longest: &AtomicU64) {
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
    use std::cell::Cell;

    use super::*;

    #[test]
    fn what_fails_for_good_fails_after_so_many_attempts_at_most() {
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
    fn what_holds_is_given_back() {
        assert_eq!(steady(|| 7), 7);
    }
}

//! When the service manager's watchdog may be fed: only if every net thread has run cycles since the
//! last time. Sends nothing itself, and reads no clock.

use std::time::Duration;

/// The watchdog is fed this many times within its time.
const FEEDS: u32 = 4;

/// Decides when to feed the watchdog.
#[derive(Debug)]
pub(super) struct Watchdog {
    pause: Duration,
    fed: Duration,
    cycles: Vec<u64>,
}

impl Watchdog {
    /// `within` is the time after which the service manager gives the service up.
    pub(super) const fn new(within: Duration) -> Self {
        Self {
            pause: Duration::from_nanos_u128(within.as_nanos() / FEEDS as u128),
            fed: Duration::ZERO,
            cycles: Vec::new(),
        }
    }

    /// Whether to feed it now. `cycles` returns the cycles of each net thread, and is called only when it is time; an
    /// added or removed thread begins a new count.
    pub(super) fn poll(&mut self, now: Duration, cycles: impl FnOnce() -> Vec<u64>) -> bool {
        if now.saturating_sub(self.fed) < self.pause {
            return false;
        }
        let cycles = cycles();
        let same_threads = self.cycles.len() == cycles.len();
        let all_ran = cycles
            .iter()
            .zip(&self.cycles)
            .all(|(now, then)| now > then);
        if same_threads && !all_ran {
            return false;
        }
        self.fed = now;
        self.cycles = cycles;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn watchdog_is_fed_while_cycles_run() {
        let mut watchdog = Watchdog::new(ms(400));
        let fed = (1..=10).filter(|n| watchdog.poll(ms(50 * n), || vec![*n]));
        assert_eq!(fed.collect::<Vec<_>>(), [2, 4, 6, 8, 10]);
    }

    #[test]
    fn watchdog_is_not_fed_while_cycles_stop() {
        let mut watchdog = Watchdog::new(ms(400));
        assert!(watchdog.poll(ms(100), || vec![7]));
        assert!((2..100).all(|n| !watchdog.poll(ms(100 * n), || vec![7])));
        assert!(watchdog.poll(ms(10_000), || vec![8]));
    }

    #[test]
    fn watchdog_is_not_fed_if_one_thread_hangs() {
        let mut watchdog = Watchdog::new(ms(400));
        assert!(watchdog.poll(ms(100), || vec![1, 1]));
        assert!(!watchdog.poll(ms(200), || vec![2, 1]));
        assert!(watchdog.poll(ms(201), || vec![2, 2]));
    }

    #[test]
    fn watchdog_thread_that_joins_gets_first_interval() {
        let mut watchdog = Watchdog::new(ms(400));
        assert!(watchdog.poll(ms(100), || vec![5]));
        assert!(watchdog.poll(ms(200), || vec![5, 0]));
        assert!(!watchdog.poll(ms(300), || vec![6, 0]));
    }
}

//! Tests of emulated robots in simulated time: where the host stalls, controllers and robots stall together, and what a test
//! asserts holds on any host. Robots on CAN take no part; [`steady`](crate::steady) is for them, and for other processes.

use std::time::Duration;

use takt_rt::{monotonic, simulated};

/// How often the clock is read.
const EVERY: Duration = Duration::from_millis(1);

/// From now on, this process runs in simulated time, so many times as fast as the host's clock if no thread is late. Above 1, a
/// cycle should be of 2 ms or more.
pub fn simulate_time(real_time_factor: f64) {
    simulated::begin(real_time_factor);
}

/// Lets a span of it pass. It does not wait for the calling thread.
pub fn pass(span: Duration) {
    let until = now() + span;
    while now() < until {
        std::thread::sleep(EVERY);
    }
}

/// The time of controllers and robots.
pub fn now() -> Duration {
    monotonic().try_into().unwrap_or_default()
}

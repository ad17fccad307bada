//! Stalls of the host during the measurement: a bare thread above all others on each processor wakes every 200 us and
//! measures how late it is. No thread of ours can delay it. It judges no arm.

use std::sync::Arc;
use std::time::Duration;

use takt_fri::lwr::emulator::KrcStatus;
use takt_rt::thread::{Thread, ThreadConfig, spawn};
use takt_rt::{Nanos, monotonic, sleep_until};

/// Polling period.
const STEP: Nanos = Nanos(200_000);
/// Latency that counts as a stall: a part of the time for an answer.
const LATE: Nanos = Nanos(200_000);
/// Length of a slot, each marked if the host stalled in it.
const SLOT: Nanos = Nanos(10_000_000);

/// Totals of an emulated controller.
#[derive(Clone, Copy, Default)]
pub(crate) struct Counts {
    pub(crate) sent: u64,
    pub(crate) answers: u64,
    /// Measurements without an answer in time.
    pub(crate) missed: u64,
    /// Measurements that were not sent because this host was late.
    pub(crate) stalls: u64,
}

impl Counts {
    fn of(status: &KrcStatus) -> Self {
        Self {
            sent: status.sent(),
            answers: status.answers(),
            missed: status.missed().into(),
            stalls: status.stalls(),
        }
    }

    fn since(self, before: Self) -> Self {
        Self {
            sent: self.sent - before.sent,
            answers: self.answers - before.answers,
            missed: self.missed - before.missed,
            stalls: self.stalls - before.stalls,
        }
    }

    fn plus(self, more: Self) -> Self {
        Self {
            sent: self.sent + more.sent,
            answers: self.answers + more.answers,
            missed: self.missed + more.missed,
            stalls: self.stalls + more.stalls,
        }
    }
}

/// Result of one of these threads.
struct Seen {
    /// By slot, whether its processor stalled.
    stalls: Vec<bool>,
    longest: Nanos,
    /// By robot, at the start of each slot; from the first processor's thread.
    counts: Vec<Vec<Counts>>,
}

/// Results of the robots during the measurement.
pub(crate) struct Watched {
    /// By robot: over the whole time, and over the time in which the host did not stall, nor shortly before or after.
    pub(crate) robots: Vec<[Counts; 2]>,
    /// Share of the time that the second excludes, 0..=1.
    pub(crate) left_out: f64,
    /// Longest stall of a processor.
    pub(crate) longest_stall: Duration,
}

/// Measures the host and these robots for a time.
pub(crate) fn watch(robots: &[Arc<KrcStatus>], look: Duration) -> Watched {
    let slots = usize::try_from(Nanos::from(look).0 / SLOT.0).unwrap_or(0);
    let start = monotonic() + SLOT;
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let threads: Vec<Thread<Seen>> = (0..processors)
        .map(|cpu| {
            let robots = if cpu == 0 {
                robots.to_vec()
            } else {
                Vec::new()
            };
            let config = ThreadConfig {
                priority: Some(98),
                cpus: vec![cpu],
                ..ThreadConfig::new("host")
            };
            spawn(config, move || see(&robots, start, slots)).expect("the system has a thread")
        })
        .collect();
    let seen: Vec<_> = threads
        .into_iter()
        .map(|thread| thread.join().expect("it does not panic"))
        .collect();
    sum_up(&seen, robots.len(), slots)
}

fn see(robots: &[Arc<KrcStatus>], start: Nanos, slots: usize) -> Seen {
    let mut seen = Seen {
        stalls: vec![false; slots + 1],
        longest: Nanos(0),
        counts: Vec::with_capacity(slots + 1),
    };
    let slot_of = |at: Nanos| usize::try_from((at - start).0 / SLOT.0).unwrap_or(0);
    let mut next = start;
    while seen.counts.len() <= slots {
        let _interrupted = sleep_until(next);
        let now = monotonic();
        let late = now - next;
        seen.longest = seen.longest.max(late);
        if late > LATE {
            let to = slot_of(now).min(slots);
            seen.stalls[slot_of(next).min(slots)..=to].fill(true);
        }
        while seen.counts.len() <= slot_of(now).min(slots) {
            seen.counts
                .push(robots.iter().map(|robot| Counts::of(robot)).collect());
        }
        next = (next + STEP).max(now);
    }
    seen
}

fn sum_up(seen: &[Seen], robots: usize, slots: usize) -> Watched {
    let stood = |slot: usize| seen.iter().any(|one| one.stalls[slot]);
    let is_left_out = |slot: usize| (slot.saturating_sub(1)..=(slot + 1).min(slots)).any(stood);
    let counts = &seen[0].counts;
    let of_robot = |robot: usize| {
        let mut sums = [Counts::default(); 2];
        for (slot, pair) in counts.windows(2).enumerate() {
            let more = pair[1][robot].since(pair[0][robot]);
            sums[0] = sums[0].plus(more);
            if !is_left_out(slot) {
                sums[1] = sums[1].plus(more);
            }
        }
        sums
    };
    let longest = seen.iter().map(|one| one.longest).max();
    Watched {
        robots: (0..robots).map(of_robot).collect(),
        left_out: super::ratio(
            (0..slots).filter(|slot| is_left_out(*slot)).count() as u64,
            slots as u64,
        ),
        longest_stall: longest.unwrap_or(Nanos(0)).try_into().unwrap_or_default(),
    }
}

//! The measurement: cycle threads made and run by the functions that the controller uses, one per processor, with a
//! body that only records its own lateness.
//!
//! As in the controller, a figure takes one sleep to an absolute instant and one reading of the clock.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context as _;
use takt_rt::cycle::{Tick, run_cycles};
use takt_rt::flight::{Entry, FlightRecorder};
use takt_rt::stats::{Snapshot, StatsReader, StatsWriter};
use takt_rt::thread::{Thread, ThreadConfig, spawn};
use takt_rt::{Grant, Nanos, Usage, alloc, monotonic, thread_usage};

use crate::jitter::report::ThreadReport;
use crate::jitter::trace::Tracer;

/// Cycles kept by the flight recorder.
const REMEMBERED: usize = 32;
/// From the making of the threads to their common first slot.
const START_AFTER: Duration = Duration::from_millis(20);

/// What to measure.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub(crate) period: Duration,
    /// `SCHED_FIFO` priority; `None` for ordinary threads.
    pub(crate) priority: Option<u8>,
    /// One thread each; `None` is a thread on any processor.
    pub(crate) cpus: Vec<Option<usize>>,
    pub(crate) duration: Duration,
    /// The latency that ends the run.
    pub(crate) break_at: Option<Duration>,
    /// The kernel's trace, for a mark at that moment.
    pub(crate) tracer: Option<Arc<Tracer>>,
}

/// The cycle that ended a run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    pub(crate) cycle: u64,
    pub(crate) latency: Nanos,
    /// Whether the kernel took the mark.
    pub(crate) is_marked: bool,
}

/// Results of a thread.
#[derive(Debug)]
struct Outcome {
    usage: Usage,
    hit: Option<Hit>,
    flight: FlightRecorder,
}

/// A measurement under way.
#[derive(Debug)]
pub(crate) struct Running {
    threads: Vec<(Option<usize>, Thread<Outcome>, StatsReader)>,
    stop: Arc<AtomicBool>,
    started: Nanos,
}

/// Figures of one thread.
#[derive(Debug)]
pub(crate) struct Measured {
    pub(crate) cpu: Option<usize>,
    pub(crate) stats: Snapshot,
    pub(crate) usage: Usage,
    pub(crate) hit: Option<Hit>,
    /// The last cycles before the hit, a line each; empty without one.
    pub(crate) flight: Vec<String>,
    pub(crate) refused: Vec<Grant>,
}

impl Plan {
    /// Starts the threads.
    pub(crate) fn start(&self) -> anyhow::Result<Running> {
        let stop = Arc::new(AtomicBool::new(false));
        let started = monotonic() + START_AFTER.into();
        let threads = self.cpus.iter().map(|&cpu| {
            let (thread, reader) = self.start_thread(cpu, started, &stop)?;
            Ok((cpu, thread, reader))
        });
        let threads: anyhow::Result<Vec<_>> = threads.collect();
        if threads.is_err() {
            stop.store(true, Ordering::Relaxed);
        }
        Ok(Running {
            threads: threads?,
            stop,
            started,
        })
    }

    fn start_thread(
        &self,
        cpu: Option<usize>,
        started: Nanos,
        stop: &Arc<AtomicBool>,
    ) -> anyhow::Result<(Thread<Outcome>, StatsReader)> {
        let config = ThreadConfig {
            priority: self.priority,
            cpus: cpu.into_iter().collect(),
            ..ThreadConfig::new(
                cpu.map_or_else(|| "jitter".to_owned(), |cpu| format!("jitter-{cpu}")),
            )
        };
        let (writer, reader) = takt_rt::stats::pair();
        let probe = Probe {
            period: self.period.into(),
            slots: self.slots(),
            last: None,
            break_at: self.break_at.map_or(Nanos::MAX, Nanos::from),
            tracer: self.tracer.clone(),
            stop: Arc::clone(stop),
            flight: FlightRecorder::new(REMEMBERED),
            hit: None,
        };
        let period = self.period;
        let thread = spawn(config, move || probe.run(period, started, writer));
        Ok((thread.context("no thread to measure with")?, reader))
    }

    /// Slots of the grid from start to end.
    fn slots(&self) -> u64 {
        let slots = self.duration.as_nanos() / self.period.as_nanos().max(1);
        u64::try_from(slots).unwrap_or(u64::MAX).max(1)
    }
}

/// The body of a cycle.
struct Probe {
    period: Nanos,
    slots: u64,
    /// The last slot, counted from the first one served, since a thread that starts late joins its grid late.
    last: Option<u64>,
    break_at: Nanos,
    tracer: Option<Arc<Tracer>>,
    stop: Arc<AtomicBool>,
    flight: FlightRecorder,
    hit: Option<Hit>,
}

impl Probe {
    fn run(mut self, period: Duration, started: Nanos, mut writer: StatsWriter) -> Outcome {
        let before = thread_usage();
        let scope = alloc::enter_real_time();
        run_cycles(period, Some(started), &mut writer, |tick| self.cycle(tick));
        drop(scope);
        Outcome {
            usage: thread_usage().since(&before),
            hit: self.hit,
            flight: self.flight,
        }
    }

    fn cycle(&mut self, tick: &Tick) -> ControlFlow<()> {
        // As the statistics count it: after missed slots, from the first of them.
        let missed = self.period.0.saturating_mul(tick.missed.into());
        let latency = tick.woken - tick.scheduled + Nanos(missed);
        self.flight.record(Entry {
            cycle: tick.index,
            source: "jitter",
            event: "latency_ns",
            value: latency.0,
        });
        if latency > self.break_at {
            self.hit = Some(self.mark(tick.index, latency));
            self.stop.store(true, Ordering::Relaxed);
        }
        let slots = self.slots;
        let last = *self
            .last
            .get_or_insert_with(|| tick.index.saturating_add(slots - 1));
        if tick.index >= last || self.stop.load(Ordering::Relaxed) {
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    }

    /// A system call, but of the last cycle: the mark must be made where it happens.
    fn mark(&self, cycle: u64, latency: Nanos) -> Hit {
        let is_marked = self
            .tracer
            .as_ref()
            .is_some_and(|tracer| tracer.mark(cycle, latency));
        Hit {
            cycle,
            latency,
            is_marked,
        }
    }
}

impl Running {
    /// Whether all threads have ended.
    pub(crate) fn is_finished(&self) -> bool {
        self.threads
            .iter()
            .all(|(_, thread, _)| thread.is_finished())
    }

    /// Time since the first slot.
    pub(crate) fn elapsed(&self) -> Duration {
        Duration::try_from(monotonic() - self.started).unwrap_or_default()
    }

    /// Figures of the threads so far.
    pub(crate) fn so_far(&self) -> Vec<ThreadReport> {
        let read = |(cpu, _, reader): &(_, _, StatsReader)| {
            ThreadReport::of_stats(*cpu, &reader.snapshot())
        };
        self.threads.iter().map(read).collect()
    }

    /// Has all threads end with their present cycle.
    pub(crate) fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Waits for the end of all threads.
    pub(crate) fn join(self) -> anyhow::Result<Vec<Measured>> {
        let join = |(cpu, thread, reader): (_, Thread<Outcome>, StatsReader)| {
            let refused = thread.grants().iter().filter(|grant| grant.is_refused());
            let refused = refused.cloned().collect();
            let outcome = thread
                .join()
                .map_err(|_| anyhow::anyhow!("a measuring thread panicked; please report it"))?;
            let lines = outcome.flight.entries().map(|entry| entry.to_string());
            Ok(Measured {
                cpu,
                stats: reader.snapshot(),
                usage: outcome.usage,
                flight: outcome.hit.map(|_| lines.collect()).unwrap_or_default(),
                hit: outcome.hit,
                refused,
            })
        };
        self.threads.into_iter().map(join).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan() -> Plan {
        Plan {
            period: Duration::from_micros(500),
            priority: None,
            cpus: vec![None, Some(0)],
            duration: Duration::from_millis(20),
            break_at: None,
            tracer: None,
        }
    }

    #[test]
    fn every_slot_is_a_cycle_or_missed() {
        for measured in plan().start().unwrap().join().unwrap() {
            let Snapshot {
                cycles, overruns, ..
            } = measured.stats;
            // The last wake-up may lie beyond the end.
            assert!(cycles + overruns >= 40, "{cycles} + {overruns}");
            assert!(cycles <= 40);
            assert!(measured.hit.is_none() && measured.flight.is_empty());
            assert!(measured.usage.context_switches_voluntary > 0);
        }
    }

    #[test]
    fn jitter_break_ends_all_threads_and_keeps_cycles() {
        let plan = Plan {
            break_at: Some(Duration::ZERO),
            duration: Duration::from_secs(3600),
            ..plan()
        };
        let measured = plan.start().unwrap().join().unwrap();
        let hits: Vec<_> = measured.iter().filter(|m| m.hit.is_some()).collect();
        assert!(!hits.is_empty());
        for m in hits {
            let hit = m.hit.unwrap();
            assert!(hit.latency > Nanos::ZERO && !hit.is_marked);
            let line = format!("{} jitter: latency_ns {}", hit.cycle, hit.latency.0);
            assert_eq!(m.flight.last(), Some(&line));
        }
    }

    #[test]
    fn jitter_stopped_run_keeps_figures() {
        let plan = Plan {
            duration: Duration::from_secs(3600),
            ..plan()
        };
        let running = plan.start().unwrap();
        while running.so_far().iter().any(|thread| thread.cycles == 0) {
            std::thread::yield_now();
        }
        running.stop();
        let measured = running.join().unwrap();
        assert!(measured.iter().all(|m| m.stats.cycles > 0));
    }
}

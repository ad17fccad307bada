//! The report of a measurement as data: what was measured, on what, under which circumstances, and the
//! verdict. It is written and read back as JSON, so every other form can be made from a file too.
//!
//! It holds distributions, not samples: the order of cycles is lost.

use std::time::Duration;

use anyhow::Context as _;
use serde::{Deserialize, Serialize};
use takt_rt::stats::Snapshot;

use crate::jitter::histogram::{Histogram, Quantiles};
use crate::jitter::host::Host;
use crate::jitter::measure::Measured;
use crate::jitter::warning::Entry;
use crate::output::time;

/// Name and version of the form. The version is increased when readers of the old one would misread it.
const SCHEMA: &str = "takt-jitter/1";

/// The report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Report {
    pub(crate) schema: String,
    /// Who measured, as in `cyclictest 2.40`.
    pub(crate) tool: String,
    pub(crate) verdict: Judgement,
    /// Why it is not good.
    pub(crate) faults: Vec<String>,
    pub(crate) period_ns: Option<u64>,
    /// `SCHED_FIFO` priority; null for ordinary threads.
    pub(crate) priority: Option<u8>,
    /// Workers of the built-in load; null if unknown.
    pub(crate) load_workers: Option<u32>,
    /// How long it was measured.
    pub(crate) duration_ns: u64,
    /// Whether it was ended before its time.
    pub(crate) interrupted: bool,
    pub(crate) budget_ns: Option<u64>,
    pub(crate) host: Host,
    pub(crate) busy_percent: Option<f64>,
    pub(crate) steal_percent: Option<f64>,
    pub(crate) smi_count: Option<u32>,
    /// Why that is not known.
    pub(crate) smi_unknown: Option<String>,
    /// Allocations in the measuring threads.
    pub(crate) rt_allocations: Option<u64>,
    pub(crate) threads: Vec<ThreadReport>,
    #[serde(rename = "break")]
    pub(crate) broke: Option<Broke>,
    pub(crate) warnings: Vec<Entry>,
    pub(crate) compare: Option<Compare>,
    /// Ours by the other tool's, all slices together.
    pub(crate) ratio: Option<Ratio>,
}

/// The verdict on the budget.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Judgement {
    /// Every latency was within it.
    Pass,
    /// One was not, or a run with a break was broken.
    Fail,
    /// None was stated.
    None,
}

/// One thread.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct ThreadReport {
    /// The processor it was kept on; null if none.
    pub(crate) cpu: Option<usize>,
    pub(crate) cycles: u64,
    /// Slots of the grid that were over before the thread woke; null if the tool does not report it.
    pub(crate) missed_cycles: Option<u64>,
    /// From when a cycle was due to when its thread came to it.
    pub(crate) latency_ns: Histogram,
    pub(crate) usage: Option<UsageReport>,
}

/// What the kernel counted for a thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct UsageReport {
    pub(crate) page_faults_minor: u64,
    pub(crate) page_faults_major: u64,
    pub(crate) context_switches_voluntary: u64,
    pub(crate) context_switches_involuntary: u64,
}

/// The cycle that ended a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Broke {
    pub(crate) cpu: Option<usize>,
    pub(crate) cycle: u64,
    pub(crate) latency_ns: u64,
    /// Result of the mark in the kernel's trace.
    pub(crate) trace: String,
    /// The flight recorder: the last cycles, the oldest first.
    pub(crate) flight: Vec<String>,
}

/// The other tool's part of a comparison.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Compare {
    pub(crate) tool: String,
    pub(crate) command: String,
    pub(crate) threads: Vec<ThreadReport>,
    pub(crate) slices: Vec<SlicePair>,
}

/// Two slices, one right after the other; latencies of all threads, ns.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct SlicePair {
    pub(crate) takt_ns: Quantiles,
    pub(crate) other_ns: Quantiles,
}

/// Ours by theirs; null where theirs is zero.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Ratio {
    pub(crate) p50: Option<f64>,
    pub(crate) p99: Option<f64>,
    pub(crate) p999: Option<f64>,
    pub(crate) max: Option<f64>,
}

impl Ratio {
    /// The other tool reports its longest in whole microseconds, so ours is rounded alike.
    pub(crate) fn of(ours: &Quantiles, theirs: &Quantiles) -> Self {
        Self {
            p50: ratio(ours.p50, theirs.p50),
            p99: ratio(ours.p99, theirs.p99),
            p999: ratio(ours.p999, theirs.p999),
            max: ratio(ours.max / 1000, theirs.max / 1000),
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "reported with three decimals")]
fn ratio(ours: u64, theirs: u64) -> Option<f64> {
    (theirs > 0).then(|| (ours as f64 * 1000.0 / theirs as f64).round() / 1000.0)
}

impl From<&Measured> for ThreadReport {
    fn from(measured: &Measured) -> Self {
        let usage = measured.usage;
        Self {
            usage: Some(UsageReport {
                page_faults_minor: usage.page_faults_minor,
                page_faults_major: usage.page_faults_major,
                context_switches_voluntary: usage.context_switches_voluntary,
                context_switches_involuntary: usage.context_switches_involuntary,
            }),
            ..Self::of_stats(measured.cpu, &measured.stats)
        }
    }
}

impl ThreadReport {
    /// A thread's cycles, also of one that still runs; nothing of what the kernel counts.
    pub(crate) fn of_stats(cpu: Option<usize>, stats: &Snapshot) -> Self {
        Self {
            cpu,
            cycles: stats.cycles,
            missed_cycles: Some(stats.overruns),
            latency_ns: Histogram::from_stats(&stats.latency, stats.latency_buckets()),
            usage: None,
        }
    }

    /// Adds what the same thread measured later.
    pub(crate) fn add(&mut self, later: &Self) {
        self.cycles += later.cycles;
        self.missed_cycles = self
            .missed_cycles
            .zip(later.missed_cycles)
            .map(|(a, b)| a + b);
        self.latency_ns = Histogram::pooled([&self.latency_ns, &later.latency_ns]);
        self.usage = self.usage.zip(later.usage).map(|(a, b)| UsageReport {
            page_faults_minor: a.page_faults_minor + b.page_faults_minor,
            page_faults_major: a.page_faults_major + b.page_faults_major,
            context_switches_voluntary: a.context_switches_voluntary + b.context_switches_voluntary,
            context_switches_involuntary: a.context_switches_involuntary
                + b.context_switches_involuntary,
        });
    }

    /// What to call it: its processor.
    pub(crate) fn name(&self) -> String {
        self.cpu
            .map_or_else(|| "any".to_owned(), |cpu| cpu.to_string())
    }
}

/// Adds a slice's threads to those of the slices before.
pub(crate) fn add_slice(sum: &mut Vec<ThreadReport>, slice: &[ThreadReport]) {
    if sum.is_empty() {
        sum.extend_from_slice(slice);
        return;
    }
    for (sum, later) in sum.iter_mut().zip(slice) {
        sum.add(later);
    }
}

/// The latencies of all these threads together.
pub(crate) fn pooled(threads: &[ThreadReport]) -> Histogram {
    Histogram::pooled(threads.iter().map(|thread| &thread.latency_ns))
}

impl Report {
    /// An empty one, by that tool.
    pub(crate) fn new(tool: String) -> Self {
        Self {
            schema: SCHEMA.to_owned(),
            tool,
            verdict: Judgement::None,
            faults: Vec::new(),
            period_ns: None,
            priority: None,
            load_workers: None,
            duration_ns: 0,
            interrupted: false,
            budget_ns: None,
            host: Host::default(),
            busy_percent: None,
            steal_percent: None,
            smi_count: None,
            smi_unknown: None,
            rt_allocations: None,
            threads: Vec::new(),
            broke: None,
            warnings: Vec::new(),
            compare: None,
            ratio: None,
        }
    }

    /// Reads one of this form.
    pub(crate) fn from_json(text: &str) -> anyhow::Result<Self> {
        #[derive(Deserialize)]
        struct Head {
            schema: String,
        }
        let head: Head = serde_json::from_str(text)?;
        anyhow::ensure!(
            head.schema == SCHEMA,
            "its schema is `{}`, and this command reads `{SCHEMA}`\nhint: read it with the takt that wrote it",
            head.schema
        );
        let report: Self = serde_json::from_str(text).context("a damaged report")?;
        anyhow::ensure!(report.cycles() > 0, "it holds no cycle");
        Ok(report)
    }

    /// The latencies of all threads together.
    pub(crate) fn pooled(&self) -> Histogram {
        pooled(&self.threads)
    }

    /// Cycles of all threads.
    pub(crate) fn cycles(&self) -> u64 {
        self.threads.iter().map(|thread| thread.cycles).sum()
    }

    /// Judges it by that budget, or by none.
    pub(crate) fn judge(&mut self, budget: Option<Duration>) {
        let budget_ns = budget.map(|b| u64::try_from(b.as_nanos()).unwrap_or(u64::MAX));
        self.budget_ns = budget_ns;
        self.faults.clear();
        for thread in &self.threads {
            let latency = &thread.latency_ns;
            if let Some(budget_ns) = budget_ns.filter(|&bound| latency.max_ns() > bound) {
                self.faults.push(format!(
                    "CPU {}: {} of {} cycles began later than the budget of {}, the worst after {}",
                    thread.name(),
                    latency.above(budget_ns),
                    thread.cycles,
                    nanos(budget_ns),
                    nanos(latency.max_ns())
                ));
            }
        }
        if let Some(broke) = &self.broke {
            let cpu = broke
                .cpu
                .map_or_else(|| "any".to_owned(), |cpu| cpu.to_string());
            let (cycle, late) = (broke.cycle, nanos(broke.latency_ns));
            self.faults.push(format!(
                "CPU {cpu}: cycle {cycle} broke the run, {late} late"
            ));
        }
        self.verdict = match (self.faults.is_empty(), budget_ns) {
            (false, _) => Judgement::Fail,
            (true, Some(_)) => Judgement::Pass,
            (true, None) => Judgement::None,
        };
    }

    /// The verdict in a line.
    pub(crate) fn verdict_line(&self) -> String {
        let worst = nanos(self.pooled().max_ns());
        match (self.verdict, self.budget_ns) {
            (Judgement::Fail, Some(budget)) => {
                format!("FAILED, worst {worst} of {} allowed", nanos(budget))
            }
            (Judgement::Fail, None) => format!("FAILED, broken off at {worst}"),
            (Judgement::Pass, Some(budget)) => {
                format!("OK, worst {worst} of {} allowed", nanos(budget))
            }
            (Judgement::Pass | Judgement::None, _) => {
                format!("worst {worst}; no verdict without --budget")
            }
        }
    }
}

/// A time for people.
pub(crate) fn nanos(ns: u64) -> String {
    time(i64::try_from(ns).unwrap_or(i64::MAX))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::jitter::histogram::Bucket;

    /// Two processors, a tail, no fault.
    pub(crate) fn fixed() -> Report {
        let bucket = |us: u64, count| Bucket {
            lower_ns: us * 1000,
            upper_ns: (us + 1) * 1000,
            count,
        };
        let thread = |cpu: usize, shift: u64| {
            let tail = [(17, 9_000), (24, 900), (41, 90), (180, 10)];
            let buckets = tail.map(|(us, count)| bucket(us + shift, count));
            let histogram =
                Histogram::new(buckets.into(), 17_100, 18_400, 180_300 + shift * 1000).unwrap();
            ThreadReport {
                cpu: Some(cpu),
                cycles: 10_000,
                missed_cycles: Some(0),
                latency_ns: histogram,
                usage: Some(UsageReport {
                    context_switches_voluntary: 10_000,
                    context_switches_involuntary: 2,
                    ..UsageReport::default()
                }),
            }
        };
        Report {
            period_ns: Some(1_000_000),
            priority: Some(80),
            load_workers: Some(2),
            duration_ns: 10_000_000_000,
            host: Host {
                kernel: "Linux 6.12.0 #1 SMP PREEMPT_RT".into(),
                preempt_rt: true,
                processor: "A Processor".into(),
                cpus: 2,
                virtual_machine: None,
            },
            busy_percent: Some(97.5),
            steal_percent: Some(0.0),
            smi_count: Some(0),
            rt_allocations: Some(0),
            threads: vec![thread(0, 0), thread(1, 3)],
            ..Report::new("takt 0.1.0".into())
        }
    }

    #[test]
    fn jitter_budget_exceeded_names_every_processor() {
        let mut report = fixed();
        report.judge(None);
        assert_eq!(report.verdict, Judgement::None);
        assert!(report.verdict_line().contains("no verdict"));
        report.judge(Some(Duration::from_micros(184)));
        assert_eq!(report.verdict, Judgement::Pass);
        assert_eq!(report.verdict_line(), "OK, worst 183 us of 184 us allowed");
        report.judge(Some(Duration::from_micros(182)));
        assert_eq!(report.verdict, Judgement::Fail);
        assert_eq!(
            report.faults,
            [
                "CPU 1: 10 of 10000 cycles began later than the budget of 182 us, the worst after 183 us"
            ]
        );
        report.judge(Some(Duration::from_micros(20)));
        assert_eq!(report.faults.len(), 2);
    }

    #[test]
    fn jitter_broken_run_fails_without_budget() {
        let mut report = fixed();
        report.broke = Some(Broke {
            cpu: Some(1),
            cycle: 4711,
            latency_ns: 312_400,
            trace: String::new(),
            flight: vec![],
        });
        report.judge(None);
        assert_eq!(report.verdict, Judgement::Fail);
        assert_eq!(
            report.faults,
            ["CPU 1: cycle 4711 broke the run, 312 us late"]
        );
    }

    #[test]
    fn ratios_are_ours_by_theirs() {
        let ours = Quantiles {
            p50: 16_000,
            p99: 22_000,
            p999: 50,
            max: 1_900,
        };
        let theirs = Quantiles {
            p50: 16_000,
            p99: 20_000,
            p999: 0,
            max: 2_000,
        };
        let ratio = Ratio::of(&ours, &theirs);
        assert_eq!((ratio.p50, ratio.p99), (Some(1.0), Some(1.1)));
        assert_eq!((ratio.p999, ratio.max), (None, Some(0.5)));
    }

    #[test]
    fn slices_add_up() {
        let mut sum = Vec::new();
        let slice = fixed().threads;
        add_slice(&mut sum, &slice);
        add_slice(&mut sum, &slice);
        assert_eq!((sum.len(), sum[1].cycles), (2, 20_000));
        assert_eq!(sum[0].latency_ns.count(), 20_000);
        assert_eq!(sum[0].usage.unwrap().context_switches_involuntary, 4);
    }

    #[test]
    fn json_is_read_back_as_it_was() {
        let mut report = fixed();
        report.judge(Some(Duration::from_millis(1)));
        let text = serde_json::to_string(&report).unwrap();
        assert_eq!(Report::from_json(&text).unwrap(), report);
        let newer = text.replace("takt-jitter/1", "takt-jitter/2");
        let error = Report::from_json(&newer).unwrap_err().to_string();
        assert!(error.contains("takt-jitter/2"), "{error}");
        let empty = text.replace("\"cycles\":10000", "\"cycles\":0");
        assert!(Report::from_json(&empty).is_err());
    }
}

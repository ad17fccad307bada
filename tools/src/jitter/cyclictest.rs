//! cyclictest of rt-tests, the usual tool for latency: run with our period, priority, processors and locked memory,
//! and its output parsed.
//!
//! An output that contradicts itself is refused.

mod json;
mod text;

use std::io::Read as _;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::Context as _;

use crate::jitter::histogram::{Bucket, Histogram};
use crate::jitter::measure::Plan;
use crate::jitter::report::{Report, ThreadReport};
use crate::jitter::warning::Warning;

/// Longest latency that its histogram is to hold, us.
const HISTOGRAM_US: u32 = 100_000;
/// Outputs with more threads are refused.
const THREADS_MAX: usize = 4096;

/// The output of cyclictest.
#[derive(Debug, PartialEq)]
struct Output {
    /// As in `2.40`; empty if the output lacks it.
    version: String,
    period: Option<Duration>,
    priority: Option<u8>,
    threads: Vec<ThreadReport>,
    /// Cycles beyond the histogram.
    beyond: u64,
}

/// Reads its `--json` output or the text of `-h`, whichever it is.
fn read(text: &str) -> anyhow::Result<Output> {
    object(text).map_or_else(|| text::read(text), json::read)
}

/// The JSON object of an output. Remarks on the system stand around it if all goes to standard output.
fn object(text: &str) -> Option<&str> {
    let begin = if text.starts_with("{\n") {
        0
    } else {
        text.find("\n{\n")?
    };
    let (_, object) = text.split_at(begin);
    let end = object.find("\n}\n").map_or(object.len(), |end| end + 2);
    object.get(..end)
}

/// Whether a text may be cyclictest's.
pub(crate) fn is_output(text: &str) -> bool {
    text.contains("\"rt_test_version") || text.contains("# Min Latencies:")
}

/// A report of its output.
///
/// # Errors
/// If the text is no such output, contradicts itself, or has no histogram.
pub(crate) fn import(text: &str) -> anyhow::Result<Report> {
    let output = read(text)?;
    let tool = named(&output.version);
    let mut warnings = vec![Warning::Imported { tool: tool.clone() }.entry()];
    if output.beyond > 0 {
        let cycles = output.beyond;
        warnings.push(Warning::BeyondHistogram { cycles }.entry());
    }
    let ns = |period: Duration| u64::try_from(period.as_nanos()).unwrap_or(u64::MAX);
    Ok(Report {
        period_ns: output.period.map(ns),
        priority: output.priority.filter(|&priority| priority > 0),
        threads: output.threads,
        warnings,
        ..Report::new(tool)
    })
}

fn named(version: &str) -> String {
    format!("cyclictest {version}").trim_end().to_owned()
}

/// One thread's part of an output.
#[derive(Debug, Default)]
struct Thread {
    /// By time; not scaled.
    counts: Vec<(u64, u64)>,
    /// Cycles, those beyond the histogram included.
    cycles: u64,
    min: u64,
    mean_ns: u64,
    max: u64,
}

impl Thread {
    /// As a part of a report; `unit_ns` is what the times count. Its times are rounded down, so one
    /// of 17 lies between 17 and 18. Also how many cycles are not in the histogram.
    fn report(mut self, cpu: Option<usize>, unit_ns: u64) -> anyhow::Result<(ThreadReport, u64)> {
        self.counts.sort_unstable();
        let scale = |value: u64| {
            value
                .checked_mul(unit_ns)
                .context("a time longer than 500 years")
        };
        let counted = self.counts.iter().try_fold(0_u64, |sum, (_, count)| {
            sum.checked_add(*count)
                .context("more cycles than can be counted")
        })?;
        anyhow::ensure!(
            counted > 0,
            "it has no histogram\nhint: run cyclictest with -h 20000"
        );
        let beyond = self.cycles.checked_sub(counted).with_context(|| {
            format!(
                "its histogram holds {counted} cycles and it ran {}",
                self.cycles
            )
        })?;
        let mut buckets = Vec::with_capacity(self.counts.len() + 1);
        for (time, count) in self.counts {
            let (lower_ns, upper_ns) = (scale(time)?, scale(time.saturating_add(1))?);
            buckets.push(Bucket {
                lower_ns,
                upper_ns,
                count,
            });
        }
        let max_ns = scale(self.max)?;
        if beyond > 0 {
            let lower_ns = buckets.last().map_or(0, |last| last.upper_ns);
            buckets.push(Bucket {
                lower_ns,
                upper_ns: max_ns.max(lower_ns).saturating_add(1),
                count: beyond,
            });
        }
        let histogram = Histogram::new(buckets, scale(self.min)?, self.mean_ns, max_ns);
        let report = ThreadReport {
            cpu,
            cycles: self.cycles,
            missed_cycles: None,
            latency_ns: histogram.map_err(anyhow::Error::msg)?,
            usage: None,
        };
        Ok((report, beyond))
    }
}

/// Arguments for the measurement of `plan`.
fn arguments(plan: &Plan) -> Vec<String> {
    let cycles = plan.duration.as_nanos() / plan.period.as_nanos().max(1);
    let cpus: Vec<_> = plan.cpus.iter().flatten().map(usize::to_string).collect();
    let mut arguments = vec![
        "--quiet".to_owned(),
        "--mlockall".to_owned(),
        format!("--priority={}", plan.priority.unwrap_or(0)),
        format!("--interval={}", plan.period.as_micros()),
        format!("--loops={cycles}"),
        format!("--affinity={}", cpus.join(",")),
        format!("--threads={}", cpus.len()),
        // By default each thread's period would be longer than the one before.
        "--distance=0".to_owned(),
        format!("--histogram={HISTOGRAM_US}"),
        "--histfile=/dev/null".to_owned(),
        "--json=/dev/stdout".to_owned(),
    ];
    if plan.priority.is_none() {
        arguments.push("--policy=other".to_owned());
    }
    arguments
}

/// The command in a line.
pub(crate) fn command_line(plan: &Plan) -> String {
    format!("cyclictest {}", arguments(plan).join(" "))
}

/// A slice that cyclictest measures.
#[derive(Debug)]
pub(crate) struct Slice {
    child: Child,
    output: Option<std::thread::JoinHandle<std::io::Result<String>>>,
}

impl Slice {
    /// Starts it.
    ///
    /// # Errors
    /// If it is not installed, with a hint.
    pub(crate) fn start(plan: &Plan) -> anyhow::Result<Self> {
        let mut child = Command::new("cyclictest")
            .args(arguments(plan))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| {
                anyhow::anyhow!(
                    "cannot run cyclictest: {error}\nhint: install it (Debian, Ubuntu: apt install rt-tests; \
                     Fedora: dnf install realtime-tests)"
                )
            })?;
        let mut out = child.stdout.take().context("no output to read")?;
        let output = std::thread::spawn(move || {
            let mut text = String::new();
            out.read_to_string(&mut text).map(|_| text)
        });
        Ok(Self {
            child,
            output: Some(output),
        })
    }

    /// Whether it has ended.
    pub(crate) fn is_finished(&mut self) -> anyhow::Result<bool> {
        Ok(self.child.try_wait()?.is_some())
    }

    /// The result: its name and its threads.
    pub(crate) fn finish(mut self) -> anyhow::Result<(String, Vec<ThreadReport>)> {
        let status = self.child.wait()?;
        let output = self.output.take().map(std::thread::JoinHandle::join);
        let text = match output {
            Some(Ok(text)) => text?,
            _ => anyhow::bail!("lost the output of cyclictest"),
        };
        if !status.success() {
            let mut complaint = String::new();
            if let Some(err) = &mut self.child.stderr {
                err.read_to_string(&mut complaint)?;
            }
            let last = complaint.lines().rfind(|line| !line.trim().is_empty());
            anyhow::bail!(
                "cyclictest ended with {status}: {}",
                last.unwrap_or("it gave no reason")
            );
        }
        let output = read(&text).context("the output of cyclictest is not understood")?;
        Ok((named(&output.version), output.threads))
    }
}

impl Drop for Slice {
    fn drop(&mut self) {
        // It has ended already, unless the run was interrupted.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cyclictest_arguments_match_plan() {
        let plan = Plan {
            period: Duration::from_micros(500),
            priority: Some(80),
            cpus: vec![Some(1), Some(3)],
            duration: Duration::from_secs(2),
            break_at: None,
            tracer: None,
        };
        let line = command_line(&plan);
        for part in [
            " --mlockall --priority=80 --interval=500 --loops=4000 ",
            " --affinity=1,3 --threads=2 --distance=0 ",
        ] {
            assert!(line.contains(part), "{line}");
        }
        assert!(!line.contains("policy"));
        let plan = Plan {
            priority: None,
            ..plan
        };
        assert!(command_line(&plan).ends_with("--policy=other"));
    }

    #[test]
    fn cyclictest_remarks_around_json_are_ignored() {
        assert_eq!(object("{\n}\n# set to 0us\n"), Some("{\n}"));
        assert_eq!(
            object("# remark\n{\n \"a\": {\n }\n}\n"),
            Some("\n{\n \"a\": {\n }\n}")
        );
        assert_eq!(object("{\n cut"), Some("{\n cut"));
        assert_eq!(object("000000 000001\n"), None);
    }

    #[test]
    fn cycles_beyond_the_histogram_are_kept_in_the_tail() {
        let thread = Thread {
            counts: vec![(20, 5), (17, 90)],
            cycles: 100,
            min: 17,
            mean_ns: 40_000,
            max: 900,
        };
        let (report, beyond) = thread.report(Some(0), 1000).unwrap();
        assert_eq!((beyond, report.cycles), (5, 100));
        assert_eq!(report.latency_ns.count(), 100);
        assert_eq!(report.latency_ns.max_ns(), 900_000);
        assert_eq!(report.latency_ns.above(800_000), 1);
    }

    #[test]
    fn cyclictest_inconsistent_output_is_refused() {
        let thread = |counts: &[(u64, u64)], cycles, min, max| {
            let thread = Thread {
                counts: counts.to_vec(),
                cycles,
                min,
                mean_ns: 0,
                max,
            };
            thread.report(None, 1000).unwrap_err().to_string()
        };
        assert!(thread(&[(17, 5)], 4, 17, 17).contains("holds 5 cycles and it ran 4"));
        assert!(thread(&[], 4, 17, 17).contains("-h 20000"));
        assert!(thread(&[(17, 1)], 1, 18, 17).contains("minimum above"));
        assert!(thread(&[(u64::MAX, 1)], 1, 1, 2).contains("500 years"));
        let huge = [(1, u64::MAX), (2, 1)];
        assert!(thread(&huge, 1, 1, 2).contains("can be counted"));
    }
}

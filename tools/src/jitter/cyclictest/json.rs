//! The file that `cyclictest --json` writes. Two of its keys end in a colon, in rt-tests 2.4 at
//! least; both spellings are read.
//!
//! Its description of the system is ignored: the report of an import is about the measurement.

use std::collections::BTreeMap;
use std::time::Duration;

use anyhow::Context as _;
use serde::Deserialize;

use super::{Output, THREADS_MAX, Thread};

#[derive(Deserialize)]
struct File {
    #[serde(default, rename = "cmdline:", alias = "cmdline")]
    command: String,
    #[serde(default, rename = "rt_test_version:", alias = "rt_test_version")]
    version: String,
    /// 1 if times are in ns, 0 if in us.
    resolution_in_ns: u8,
    thread: BTreeMap<usize, ThreadOfFile>,
}

#[derive(Deserialize)]
struct ThreadOfFile {
    #[serde(default)]
    histogram: BTreeMap<u64, u64>,
    cycles: u64,
    min: u64,
    max: u64,
    avg: f64,
    cpu: Option<usize>,
}

/// Reads it.
pub(super) fn read(text: &str) -> anyhow::Result<Output> {
    let file: File = serde_json::from_str(text).context("no output of cyclictest --json")?;
    anyhow::ensure!(!file.thread.is_empty(), "it holds no thread");
    anyhow::ensure!(file.thread.len() <= THREADS_MAX, "too many threads");
    let unit_ns = match file.resolution_in_ns {
        0 => 1000,
        1 => 1,
        other => anyhow::bail!("resolution_in_ns is {other}, neither 0 nor 1"),
    };
    let mut threads = Vec::new();
    let mut beyond = 0;
    for (number, thread) in file.thread {
        let cpu = thread.cpu;
        let thread = Thread {
            counts: thread.histogram.into_iter().collect(),
            cycles: thread.cycles,
            min: thread.min,
            mean_ns: mean_ns(thread.avg, unit_ns),
            max: thread.max,
        };
        let read = thread.report(cpu, unit_ns);
        let (thread, more) = read.with_context(|| format!("thread {number}"))?;
        threads.push(thread);
        beyond += more;
    }
    let option = |long, short| option(&file.command, long, short);
    Ok(Output {
        version: file.version,
        period: option("--interval=", "-i").map(Duration::from_micros),
        priority: option("--priority=", "-p").and_then(|p| u8::try_from(p).ok()),
        threads,
        beyond,
    })
}

#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "saturates"
)]
fn mean_ns(mean: f64, unit_ns: u64) -> u64 {
    (mean * unit_ns as f64) as u64
}

/// The number of an option of its command line: `--interval=1000`, `-i1000` or `-i 1000`.
fn option(command: &str, long: &str, short: &str) -> Option<u64> {
    let mut words = command.split_whitespace();
    while let Some(word) = words.next() {
        let value = match word.strip_prefix(long) {
            Some(value) => value,
            None => match word.strip_prefix(short) {
                Some("") => words.next()?,
                Some(value) => value,
                None => continue,
            },
        };
        return value.parse().ok();
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = r#"{
  "file_version": 1,
  "cmdline:": "cyclictest -m -p80 -i 500 -q -h 20000 --json=x.json",
  "rt_test_version:": "2.40",
  "return_code": 0,
  "num_threads": 2,
  "resolution_in_ns": 0,
  "thread": {
    "0": { "histogram": { "9": 1, "17": 90, "100": 4 },
      "cycles": 100, "min": 9, "max": 250, "avg": 24.5, "cpu": 0, "node": 0 },
    "10": { "histogram": { "17": 1 }, "cycles": 1, "min": 17, "max": 17, "avg": 17.0, "cpu": 3 }
  }
}"#;

    #[test]
    fn threads_in_order_times_in_ns() {
        let output = read(FILE).unwrap();
        assert_eq!(output.version, "2.40");
        assert_eq!(output.period, Some(Duration::from_micros(500)));
        assert_eq!((output.priority, output.beyond), (Some(80), 5));
        let cpus: Vec<_> = output.threads.iter().map(|thread| thread.cpu).collect();
        assert_eq!(cpus, [Some(0), Some(3)]);
        let latency = &output.threads[0].latency_ns;
        assert_eq!((latency.min_ns(), latency.max_ns()), (9_000, 250_000));
        assert!((17_000..18_000).contains(&latency.quantile(0.5)));
        let ns = read(&FILE.replace("\"resolution_in_ns\": 0", "\"resolution_in_ns\": 1")).unwrap();
        assert_eq!(ns.threads[0].latency_ns.max_ns(), 250);
    }

    #[test]
    fn cyclictest_json_of_other_form_is_refused() {
        for (from, to) in [
            ("\"resolution_in_ns\": 0", "\"resolution_in_ns\": 2"),
            ("\"resolution_in_ns\": 0,", ""),
            ("\"9\": 1", "\"nine\": 1"),
            ("\"17\": 90", "\"17\": -90"),
            ("\"cycles\": 100", "\"cycles\": 10"),
            ("\"histogram\": { \"17\": 1 },", ""),
            ("\"min\": 9", "\"min\": 900"),
        ] {
            assert!(FILE.contains(from));
            assert!(read(&FILE.replace(from, to)).is_err(), "{to}");
        }
        let none = r#"{"resolution_in_ns": 0, "thread": {}}"#;
        assert!(read(none).unwrap_err().to_string().contains("no thread"));
        for length in 0..FILE.len() {
            assert!(read(&FILE[..length]).is_err(), "cut at {length}");
        }
    }

    #[test]
    fn options_in_each_spelling() {
        for command in ["-i 250 -q", "-q -i250", "--interval=250"] {
            assert_eq!(option(command, "--interval=", "-i"), Some(250));
        }
        assert_eq!(option("cyclictest -q -i", "--interval=", "-i"), None);
        assert_eq!(option("cyclictest -i x", "--interval=", "-i"), None);
    }
}

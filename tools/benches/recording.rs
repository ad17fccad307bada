//! What a recording of the factory cell costs: pairs of runs of `takt demo --robots factory`, one with `--record`. Printed are the share of a
//! processor that the writing thread takes, and the ratio of the 99th percentiles of the net threads' latency and
//! execution, each the median of its runs. `cargo bench -p takt-tools --bench recording -- --json`; on a quiet host.
#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a benchmark prints its result and ends where it cannot go on"
)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::fs;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// Pairs of runs.
const PAIRS: usize = 9;
/// Length of a run.
const RUN: &str = "10s";

/// A run: latency and execution p99, ns, allocations, and the share of a processor of each thread.
struct Run {
    report: Value,
    /// Of the thread that writes, 0 without a recording.
    writer: f64,
}

fn main() {
    let folder = std::env::temp_dir().join(format!("takt-recording-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    let file = folder.join("factory.mcap");
    let pairs: Vec<_> = (0..PAIRS)
        .map(|_| {
            let without = run(&folder, None);
            let with = run(&folder, Some(&file));
            (without, with)
        })
        .collect();
    let bytes = fs::metadata(&file).map_or(0, |file| file.len());
    fs::remove_dir_all(&folder).unwrap();
    let ratio = |member: &str| {
        let p99 = |run: &Run| run.report[member]["p99"].as_f64().unwrap_or(f64::NAN);
        let without = median(pairs.iter().map(|(without, _)| p99(without)).collect());
        median(pairs.iter().map(|(_, with)| p99(with)).collect()) / without
    };
    let (latency, execution) = (ratio("latency_ns"), ratio("execution_ns"));
    let writer = median(pairs.iter().map(|(_, with)| with.writer).collect());
    let allocations: u64 = pairs
        .iter()
        .filter_map(|(_, with)| with.report["rt_allocations"].as_u64())
        .sum();
    if std::env::args().any(|arg| arg == "--json") {
        println!(
            "{}",
            json!({ "recording": {
                "writer_share": writer, "latency_p99_ratio": latency, "execution_p99_ratio": execution,
                "allocations": allocations, "bytes": bytes,
            } })
        );
        return;
    }
    println!(
        "the writing thread takes {:.2} % of a processor, {} KiB in {RUN}",
        100.0 * writer,
        bytes / 1024
    );
    println!("latency p99 {latency:.3}, execution p99 {execution:.3} of those without");
    println!("{allocations} allocations in real-time threads");
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn run(folder: &Path, record: Option<&PathBuf>) -> Run {
    let mut takt = Command::new(env!("CARGO_BIN_EXE_takt"));
    takt.current_dir(folder)
        .args(["demo", "--robots", "factory", "--duration", RUN, "--json"]);
    if let Some(file) = record {
        let _ = fs::remove_file(file);
        takt.arg("--record").arg(file);
    }
    let mut child = takt
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let begin = Instant::now();
    let mut used = 0.0;
    let mut until = Duration::ZERO;
    while child.try_wait().unwrap().is_none() {
        let writer = |name: &str| name == "takt-record";
        if let Some(seconds) = common::processor_seconds(child.id(), writer) {
            (used, until) = (seconds, begin.elapsed());
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    let mut text = String::new();
    child
        .stdout
        .take()
        .unwrap()
        .read_to_string(&mut text)
        .unwrap();
    let report = text
        .lines()
        .find_map(|line| serde_json::from_str(line).ok());
    Run {
        report: report.unwrap_or(Value::Null),
        writer: used / until.as_secs_f64().max(1.0),
    }
}

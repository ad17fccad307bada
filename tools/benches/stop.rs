//! How long `takt stop` takes until all commands of nets are withdrawn: on an idle host, with the server flooded, and with
//! all processors taken by ordinary threads. `cargo bench -p takt-tools --bench stop -- --json`.
//!
//! Each stop is compared with the cycle of the net thread in the same run, as a withdrawal waits for the cycle that
//! executes it: a ratio of 1 is one cycle. The start of the program `takt` is left out; the request, the answer and what
//! the processors do meanwhile are in. Robots brake from the withdrawal on, within their limits.
#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a benchmark prints its result and ends where it cannot go on"
)]

#[path = "../tests/common/mod.rs"]
mod common;
#[path = "../tests/common/flood.rs"]
mod flood;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use common::{Cell, alone, expect_status, net, run};
use flood::Flood;
use serde_json::{Map, Value, json};

const STOPS: usize = 40;

fn main() {
    let as_json = std::env::args().any(|arg| arg == "--json");
    let _alone = alone();
    let mut cell = Cell::start();
    let _arm = cell.arm();
    let addresses = [cell.tcp.clone(), cell.http.clone()];
    let figures = [
        ("idle", stops(&cell, || ())),
        ("flooded", stops(&cell, || Flood::start(&addresses))),
        ("full_load", stops(&cell, Load::start)),
    ];
    let mut members = Map::new();
    for (name, stops) in figures {
        let (p50, max) = (stops[stops.len() / 2], stops[stops.len() - 1]);
        if !as_json {
            println!(
                "{name:<10} {p50:6.2} cycles p50, {max:6.2} max of {}",
                stops.len()
            );
        }
        members.insert(
            name.to_owned(),
            json!({ "cycles_p50": p50, "cycles_max": max }),
        );
    }
    if as_json {
        println!("{}", json!({ "stop": Value::Object(members) }));
    }
}

/// From the command to the last withdrawal under a disturbance, in cycles of the net thread, ascending.
fn stops<D>(cell: &Cell, disturb: impl Fn() -> D) -> Vec<f64> {
    let mut cycles: Vec<f64> = (0..STOPS).map(|_| stop(cell, &disturb)).collect();
    cycles.sort_by(f64::total_cmp);
    cycles
}

/// Stops a net that moves an arm.
fn stop<D>(cell: &Cell, disturb: impl Fn() -> D) -> f64 {
    let slow = net("swing").replace("Max='1'", "Max='60'");
    let id = cell.load(&slow.replace("Second='1'", "Second='60'"));
    expect_status(&cell.net(&["start", &id]), 0);
    let list = expect_status(&cell.net(&["list"]), 0);
    let line = list.lines().find(|line| line.starts_with(&id)).unwrap();
    assert!(line.contains("RUNNING"), "{line}");
    let disturbance = disturb();
    let output = run(&["stop", "--socket", &cell.stop, "--json"]);
    drop(disturbance);
    let answer: Value = serde_json::from_str(expect_status(&output, 0).trim()).unwrap();
    assert_eq!(answer["nets"], 1, "{answer}");
    let output = run(&["stop", "--socket", &cell.stop, "--release"]);
    expect_status(&output, 0);
    let period = answer["threads"][0]["period_ns"].as_f64().unwrap();
    answer["withdrawn_after_ns"].as_f64().unwrap() / period
}

/// Threads that take all processors at the usual priority, two for each.
struct Load {
    ending: Arc<AtomicBool>,
    threads: Vec<std::thread::JoinHandle<()>>,
}

impl Load {
    fn start() -> Self {
        let ending = Arc::new(AtomicBool::new(false));
        let count = 2 * std::thread::available_parallelism().unwrap().get();
        let spin = |_| {
            let ending = Arc::clone(&ending);
            std::thread::spawn(move || {
                while !ending.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            })
        };
        let threads = (0..count).map(spin).collect();
        Self { ending, threads }
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.ending.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            thread.join().unwrap();
        }
    }
}

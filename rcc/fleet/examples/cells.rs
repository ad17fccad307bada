//! A fleet of many simulated cells on this host, behind one router: processor time per cell, telemetry that arrives, and how long it takes
//! until a cell is noticed that was killed, or that hangs. `cargo run -p takt-fleet --features zenoh --example cells -- 100 10`: number of
//! cells, and seconds of the measurement.
//!
//! Each cell has what `takt run` has in a fleet: tokens, topics once a second, and the joints of one arm, 500 rows a second in 20 batches, to which
//! one program subscribes. Controllers are not simulated. Processor time is that of all: cells, router and subscriber.
#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "an example prints its result and ends where it cannot go on"
)]

use std::net::TcpListener;
use std::process::{Child, Command};
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::{Map, Value, json};
use takt_core::{Nanos, monotonic};
use takt_fleet::command::{Limits, LossPolicy, Lost};
use takt_fleet::config::{FleetMode, FleetRight, FleetRule, FleetSettings, Observer};
use takt_fleet::keys::CellName;
use takt_fleet::session::member::{Cell, Member, Topic};
use takt_fleet::session::observer::{Fleet, Seen};

/// Rows of a batch of joints: 500 Hz in 20 batches.
const ROWS: usize = 25;
/// The argument by which this program is one cell that can be killed.
const ALONE: &str = "--alone";
const NAME: &str = "victim";

struct Simulated;

impl Cell for Simulated {
    fn now(&self) -> Nanos {
        monotonic()
    }

    fn info(&self) -> Map<String, Value> {
        Map::new()
    }

    fn telemetry(&self) -> Vec<Topic> {
        let at = monotonic().0;
        let topics = ["device/arm/state", "thread/takt-nets", "summary", "clock"];
        topics
            .map(|topic| (topic.to_owned(), json!({"state": "op", "at_ns": at})))
            .to_vec()
    }

    fn devices(&self) -> Vec<String> {
        vec!["arm".to_owned()]
    }

    fn arms(&self) -> Vec<String> {
        self.devices()
    }

    fn joints(&self, devices: &[String]) -> Vec<(String, Value)> {
        let row = json!([
            1.0,
            [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7],
            [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
        ]);
        let batch = json!({"rows": vec![row; ROWS], "lost": 0});
        devices
            .iter()
            .map(|name| (name.clone(), batch.clone()))
            .collect()
    }

    fn log(&self, from: u64) -> (Vec<String>, u64) {
        (Vec::new(), from)
    }

    fn resource(&self, path: &str) -> Result<Value, String> {
        Err(format!("there is no resource `{path}`"))
    }

    fn opened(&self, _session: u32, _client: &str, _on_loss: LossPolicy) {}

    fn execute(&self, _session: u32, _line: &str) -> Vec<String> {
        Vec::new()
    }

    fn closed(&self, _session: u32) {}

    fn lost(&self, _lost: Lost) {}
}

fn joined(name: &str, settings: &FleetSettings) -> Member {
    let name = CellName::new(name).unwrap();
    Member::join(&name, settings, Limits::default(), Arc::new(Simulated)).unwrap()
}

fn connecting(endpoint: &str) -> FleetSettings {
    FleetSettings {
        connect: vec![endpoint.to_owned()],
        ..FleetSettings::default()
    }
}

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    if let [first, endpoint] = &args[..]
        && first == ALONE
    {
        let _member = joined(NAME, &connecting(endpoint));
        std::thread::sleep(Duration::from_secs(600));
        return;
    }
    let number = |at: usize, default| args.get(at).map_or(default, |arg| arg.parse().unwrap());
    let (count, seconds) = (number(0, 100), number(1, 10));
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
    drop(listener);
    let router = FleetSettings {
        mode: FleetMode::Router,
        listen: Some(vec![endpoint.clone()]),
        links: 1000,
        allow: vec![FleetRule {
            certificates: Vec::new(),
            rights: vec![FleetRight::Read],
        }],
        ..FleetSettings::default()
    };
    let begin = Instant::now();
    let _router = joined("router", &router);
    // Each looks for another cell of its name for half a second: ten at a time.
    let join = |number: u64| {
        let endpoint = endpoint.clone();
        std::thread::spawn(move || joined(&format!("cell-{number}"), &connecting(&endpoint)))
    };
    let mut cells: Vec<Member> = Vec::new();
    for first in (0..count).step_by(10) {
        let joining: Vec<_> = (first..count.min(first + 10)).map(join).collect();
        cells.extend(joining.into_iter().map(|thread| thread.join().unwrap()));
    }
    let observer = Observer {
        connect: vec![endpoint.clone()],
        tls: None,
    };
    let fleet = Fleet::connect(&observer).unwrap();
    let wanted = usize::try_from(count).unwrap() + 1;
    while fleet.alive(Duration::from_secs(10)).unwrap().len() < wanted {}
    println!(
        "{count} cells and a router are alive after {:.1} s",
        begin.elapsed().as_secs_f64()
    );
    telemetry(&fleet, count, Duration::from_secs(seconds));
    loss(&fleet, &endpoint);
}

/// Subscribes to all, and measures.
fn telemetry(fleet: &Fleet, count: u64, span: Duration) {
    let watch = fleet.watch("takt/*/device/*/joints").unwrap();
    // Until all cells have seen the subscriber.
    let settled = Instant::now() + Duration::from_secs(3);
    while Instant::now() < settled {
        drop(watch.next(Duration::from_millis(50)));
    }
    let (before, missed) = (processor_time(), watch.missed());
    let (begin, until) = (Instant::now(), Instant::now() + span);
    let (mut batches, mut bytes) = (0_u64, 0_u64);
    while Instant::now() < until {
        if let Some(Seen::Value { text, .. }) = watch.next(Duration::from_millis(50)) {
            bytes += u64::try_from(text.len()).unwrap();
            batches += 1;
        }
    }
    let taken = begin.elapsed().as_secs_f64();
    let used = (processor_time() - before).as_secs_f64() / taken;
    #[expect(clippy::cast_precision_loss, reason = "shown with three digits")]
    let float = |count: u64| count as f64;
    let rate = |count: u64| float(count) / taken;
    println!(
        "processor time: {:.0} % of one processor, {:.2} % for each cell with its part of router and subscriber",
        used * 100.0,
        used * 100.0 / float(count),
    );
    println!(
        "telemetry: {:.0} batches of joints/s of {} wanted, {} missed, {:.1} MB/s",
        rate(batches),
        20 * (count + 1),
        watch.missed() - missed,
        rate(bytes) * 1e-6
    );
}

/// Processor time of this process so far.
fn processor_time() -> Duration {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let fields = stat.rsplit(')').next().unwrap();
    let ticks = fields.split_whitespace().skip(11).take(2);
    let ticks: u64 = ticks.map(|field| field.parse::<u64>().unwrap()).sum();
    // USER_HZ is 100 on all Linux hosts that Takt supports.
    Duration::from_millis(10 * ticks)
}

fn signal(child: &Child, name: &str) {
    let (name, id) = (format!("-{name}"), child.id().to_string());
    let status = Command::new("kill").args([name, id]).status().unwrap();
    assert!(status.success());
}

/// How long it takes until a lost cell is noticed.
fn loss(fleet: &Fleet, endpoint: &str) {
    let watch = fleet.watch(&format!("takt/{NAME}/alive")).unwrap();
    for (name, what) in [
        ("KILL", "is killed"),
        ("STOP", "hangs, or its cable is cut"),
    ] {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args([ALONE, endpoint])
            .spawn()
            .unwrap();
        let is_alive = |seen: &Seen| matches!(seen, Seen::Alive { .. });
        while !watch
            .next(Duration::from_secs(10))
            .is_some_and(|seen| is_alive(&seen))
        {}
        let begin = Instant::now();
        signal(&child, name);
        let is_lost = |seen: &Seen| matches!(seen, Seen::Lost { .. });
        while !watch
            .next(Duration::from_secs(10))
            .is_some_and(|seen| is_lost(&seen))
        {}
        println!(
            "a cell that {what}: noticed after {:.0} ms",
            begin.elapsed().as_secs_f64() * 1e3
        );
        child.kill().unwrap();
        child.wait().unwrap();
    }
}

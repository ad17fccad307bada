//! How long a query to a cell and a command take over loopback, against the echo of a bare TCP connection and a query between two bare
//! sessions of zenoh in the same run.
//! `cargo bench -p takt-fleet --features zenoh --bench query -- --json`.
//!
//! A query is answered by a cell whose resource costs nothing; a command also passes the admission and the thread of its session. The
//! echo is of 64 bytes between two threads, without batching. The bare query is answered in the callback of zenoh with 9 bytes: what it
//! takes beyond the echo is zenoh's own, with its default configuration.
#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a benchmark prints its result and ends where it cannot go on"
)]

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::{Map, Value, json};
use takt_core::{Nanos, monotonic};
use takt_fleet::command::{Limits, LossPolicy, Lost};
use takt_fleet::config::{FleetMode, FleetRight, FleetRule, FleetSettings, Observer};
use takt_fleet::keys::CellName;
use takt_fleet::session::member::{Cell, Member, Topic};
use takt_fleet::session::observer::Fleet;
use takt_fleet::session::remote::Remote;
use takt_fleet::session::zenoh::{self, Wait as _};

/// Round trips of each kind, in turns.
const ROUNDS: usize = 20;
/// Round trips of one kind in a turn.
const TRIPS: usize = 100;
const TIMEOUT: Duration = Duration::from_secs(10);
/// What the bare sessions query.
const BARE_KEY: &str = "bare";

/// A cell that does nothing.
struct Idle;

impl Cell for Idle {
    fn now(&self) -> Nanos {
        monotonic()
    }

    fn info(&self) -> Map<String, Value> {
        Map::new()
    }

    fn telemetry(&self) -> Vec<Topic> {
        Vec::new()
    }

    fn devices(&self) -> Vec<String> {
        Vec::new()
    }

    fn log(&self, from: u64) -> (Vec<String>, u64) {
        (Vec::new(), from)
    }

    fn resource(&self, _path: &str) -> Result<Value, String> {
        Ok(json!([0, 1, 2, 3]))
    }

    fn opened(&self, _session: u32, _client: &str, _on_loss: LossPolicy) {}

    fn execute(&self, _session: u32, _line: &str) -> Vec<String> {
        vec!["f=ok()".to_owned()]
    }

    fn closed(&self, _session: u32) {}

    fn lost(&self, _lost: Lost) {}
}

fn main() {
    let as_json = std::env::args().any(|arg| arg == "--json");
    let endpoint = free_endpoint();
    let settings = FleetSettings {
        mode: FleetMode::Router,
        listen: Some(vec![endpoint.clone()]),
        allow: vec![FleetRule {
            certificates: Vec::new(),
            rights: vec![FleetRight::Command],
        }],
        ..FleetSettings::default()
    };
    let name = CellName::new("idle").unwrap();
    let _member = Member::join(&name, &settings, Limits::default(), Arc::new(Idle)).unwrap();
    let fleet = Fleet::connect(&Observer {
        connect: vec![endpoint],
        tls: None,
    });
    let fleet = fleet.unwrap();
    let mut remote = Remote::open(&fleet, &name, "bench", LossPolicy::Cancel).unwrap();
    let mut stream = echo();
    let (_answering, bare) = bare_sessions();
    let (mut echoes, mut bares) = (Vec::new(), Vec::new());
    let (mut queries, mut commands) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        time(&mut echoes, || {
            let mut bytes = [7; 64];
            stream.write_all(&bytes).unwrap();
            stream.read_exact(&mut bytes).unwrap();
        });
        time(&mut bares, || {
            let replies = bare.get(BARE_KEY).express(true).wait().unwrap();
            replies.recv().unwrap().into_result().unwrap();
        });
        time(&mut queries, || {
            fleet.resource(&name, "nets", TIMEOUT).unwrap();
        });
        time(&mut commands, || {
            remote.execute("f=nin()", TIMEOUT).unwrap();
        });
    }
    let [tcp_us, zenoh_us, query_us, command_us] =
        [echoes, bares, queries, commands].map(quantiles);
    if as_json {
        let of = |[p50, p99]: [f64; 2]| json!({"p50_us": p50, "p99_us": p99, "ratio_p50": p50 / tcp_us[0], "ratio_zenoh_p50": p50 / zenoh_us[0]});
        let figures = json!({
            "tcp": of(tcp_us),
            "zenoh": of(zenoh_us),
            "query": of(query_us),
            "command": of(command_us),
        });
        println!("{}", json!({ "query": figures }));
        return;
    }
    for (name, [p50, p99]) in [
        ("tcp echo", tcp_us),
        ("zenoh", zenoh_us),
        ("query", query_us),
        ("command", command_us),
    ] {
        let [of_tcp, of_zenoh] = [tcp_us, zenoh_us].map(|[base, _]| p50 / base);
        println!(
            "{name:<9} p50 {p50:7.1} us, p99 {p99:7.1} us, {of_tcp:5.2} x the echo, {of_zenoh:5.2} x zenoh"
        );
    }
}

/// A session of zenoh that answers, and one that queries it over loopback.
fn bare_sessions() -> (zenoh::Session, zenoh::Session) {
    let endpoint = free_endpoint();
    let config = |key: &str| {
        let mut config = zenoh::Config::default();
        config
            .insert_json5("scouting/multicast/enabled", "false")
            .unwrap();
        config.insert_json5("listen/endpoints", "[]").unwrap();
        let endpoints = json!([endpoint]).to_string();
        config.insert_json5(key, &endpoints).unwrap();
        config
    };
    let answering = zenoh::open(config("listen/endpoints")).wait().unwrap();
    let reply = |query: zenoh::query::Query| {
        let reply = query.reply(BARE_KEY, "[0,1,2,3]").express(true);
        reply.wait().unwrap();
    };
    let queryable = answering.declare_queryable(BARE_KEY).callback(reply);
    queryable.background().wait().unwrap();
    let asking = zenoh::open(config("connect/endpoints")).wait().unwrap();
    // The declaration is on its way.
    let is_answered = || asking.get(BARE_KEY).wait().unwrap().recv().is_ok();
    while !is_answered() {
        std::thread::sleep(Duration::from_millis(10));
    }
    (answering, asking)
}

/// An endpoint of loopback that was free.
fn free_endpoint() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    format!("tcp/{}", listener.local_addr().unwrap())
}

/// A connection to a thread that sends back what it gets.
fn echo() -> TcpStream {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let stream = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
    let (mut other, _) = listener.accept().unwrap();
    for stream in [&stream, &other] {
        stream.set_nodelay(true).unwrap();
    }
    std::thread::spawn(move || {
        let mut bytes = [0; 64];
        while other.read_exact(&mut bytes).is_ok() {
            other.write_all(&bytes).unwrap();
        }
    });
    stream
}

/// Adds the times of a turn, us.
fn time(times_us: &mut Vec<f64>, mut trip: impl FnMut()) {
    for _ in 0..TRIPS {
        let begin = Instant::now();
        trip();
        times_us.push(begin.elapsed().as_secs_f64() * 1e6);
    }
}

/// Median and 99th percentile.
fn quantiles(mut times_us: Vec<f64>) -> [f64; 2] {
    times_us.sort_by(f64::total_cmp);
    [times_us.len() / 2, times_us.len() * 99 / 100].map(|at| times_us[at])
}

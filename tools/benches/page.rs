//! What the page costs the controller of the factory cell, and how soon and how often it draws. In one run of `takt demo --robots
//! factory --open`, 20 clients with 50 plots each come and go: printed is the ratio of the 99th percentiles of the net threads'
//! latency with them and without. Then a Chromium without a window, which draws in software, opens the 3-D view: time from the
//! begin of the navigation to the first picture, and pictures a second. `cargo bench -p takt-tools --bench page -- --json`; on a
//! quiet host.
#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a benchmark prints its result and ends where it cannot go on"
)]

#[path = "../tests/common/browser.rs"]
mod browser;
#[path = "../tests/common/mod.rs"]
mod common;

use std::collections::BTreeMap;
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use browser::Browser;
use common::Process;
use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

/// Clients, and plots of each.
const CLIENTS: usize = 20;
const PLOTS: usize = 50;
/// Frames of plots a second.
const RATE_HZ: u32 = 30;
/// Pairs of phases, without clients and with them, and the length of a phase: short, so that a busy host disturbs both alike.
const PAIRS: usize = 20;
const PHASE: Duration = Duration::from_secs(2);
/// What follows a change of the clients is not measured.
const SETTLED: Duration = Duration::from_millis(500);
/// First pictures that are measured, and how long pictures are counted.
const OPENINGS: usize = 5;
const DRAWN: Duration = Duration::from_secs(6);

type Socket = WebSocket<TcpStream>;

fn main() {
    let mut demo = Process::spawn({
        let args = ["demo", "--robots", "factory", "--open", "--duration", "5s"];
        let mut command = common::takt(&args);
        command.env("PATH", "/nonexistent");
        command
    });
    let line = demo.wait_for("http://127.0.0.1:");
    let page = line.rsplit(' ').next().unwrap().to_owned();
    let http = page.trim_start_matches("http://").trim_end_matches('/');
    demo.wait_for("hint: open the address above");
    std::thread::sleep(SETTLED * 10);
    let (ratio, rows) = latency_ratio(http);
    let pictures = pictures(&page);
    if std::env::args().any(|arg| arg == "--json") {
        let (first, rate) = pictures.unzip();
        println!(
            "{}",
            json!({ "page": { "clients": CLIENTS, "plots": PLOTS, "rows_per_s": rows, "latency_p99_ratio": ratio,
                "first_picture_s": first, "pictures_per_s": rate } })
        );
        return;
    }
    println!("{CLIENTS} clients with {PLOTS} plots each, {rows:.0} samples a second in all");
    for (thread, ratio) in &ratio {
        println!("latency p99 of {thread} {ratio:.3} of that without them");
    }
    match pictures {
        Some((first, rate)) => {
            println!(
                "first picture of the cell after {first:.2} s, then {rate:.1} pictures/s, drawn in software"
            );
        }
        None => println!("no pictures: needs Chromium"),
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// A scope of these probes.
fn scope(http: &str, probes: &[String], rate_hz: u32) -> Socket {
    let stream = TcpStream::connect(http).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    let (mut socket, _) = tungstenite::client(format!("ws://{http}/scope"), stream).unwrap();
    let request = json!({ "probes": probes, "rate_hz": rate_hz });
    socket.send(Message::text(request.to_string())).unwrap();
    socket
}

/// Names of probes that contain a text.
fn probes(http: &str, contains: &str) -> Vec<String> {
    use std::io::{Read as _, Write as _};
    let mut stream = TcpStream::connect(http).unwrap();
    write!(
        stream,
        "GET /probes/?format=json&contains={contains} HTTP/1.1\r\nHost: {http}\r\n\r\n"
    )
    .unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    let (_, body) = text.split_once("\r\n\r\n").unwrap();
    let list: Value = serde_json::from_str(body).unwrap();
    let names = list["probe"].as_array().unwrap().iter();
    names
        .map(|probe| probe["name"].as_str().unwrap().to_owned())
        .collect()
}

/// The latencies of each net thread in each of its cycles, read until the time: by name, s.
fn latencies(
    socket: &mut Socket,
    groups: &mut Vec<String>,
    until: Instant,
) -> BTreeMap<String, Vec<f64>> {
    let mut all: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    while Instant::now() < until {
        match socket.read().unwrap() {
            Message::Text(text) => {
                let message: Value = serde_json::from_str(&text).unwrap();
                for group in message["scope"]["groups"].as_array().into_iter().flatten() {
                    groups.push(group["thread"].as_str().unwrap().to_owned());
                }
            }
            Message::Binary(bytes) => {
                let word =
                    |at: usize| u32::from_le_bytes(bytes[4 * at..4 * at + 4].try_into().unwrap());
                let values = bytes[16..].chunks_exact(8);
                let values: Vec<_> = values
                    .map(|it| f64::from_le_bytes(it.try_into().unwrap()))
                    .collect();
                let rows = values.chunks_exact(1 + word(2) as usize);
                let thread = &groups[word(0) as usize];
                let latency = rows.map(|row| row[1]).filter(|it| it.is_finite());
                all.entry(thread.clone()).or_default().extend(latency);
            }
            Message::Ping(_) | Message::Pong(_) | Message::Close(_) | Message::Frame(_) => {}
        }
    }
    all
}

fn p99(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values
        .get(values.len() * 99 / 100)
        .copied()
        .unwrap_or(f64::NAN)
}

/// The clients, which read and count samples until they are stopped.
struct Clients {
    stop: Arc<AtomicBool>,
    samples: Arc<AtomicU64>,
    threads: Vec<JoinHandle<()>>,
}

impl Clients {
    fn start(http: &str, all: &[String]) -> Self {
        let (stop, samples) = (
            Arc::new(AtomicBool::new(false)),
            Arc::new(AtomicU64::new(0)),
        );
        let threads = (0..CLIENTS).map(|client| {
            // Each has probes of its own choice, of devices.
            let of_client = all
                .iter()
                .cycle()
                .skip(7 * client)
                .take(PLOTS.min(all.len()));
            let of_client: Vec<_> = of_client.cloned().collect();
            let mut socket = scope(http, &of_client, RATE_HZ);
            let (stop, samples) = (Arc::clone(&stop), Arc::clone(&samples));
            std::thread::spawn(move || {
                while !stop.load(Ordering::Relaxed) {
                    if let Message::Binary(bytes) = socket.read().unwrap() {
                        let count = (bytes.len().saturating_sub(16) / 8) as u64;
                        samples.fetch_add(count, Ordering::Relaxed);
                    }
                }
            })
        });
        let threads = threads.collect();
        Self {
            stop,
            samples,
            threads,
        }
    }

    fn end(self) -> u64 {
        self.stop.store(true, Ordering::Relaxed);
        self.threads.into_iter().for_each(|it| it.join().unwrap());
        self.samples.load(Ordering::Relaxed)
    }
}

/// By net thread, the ratio of the p99 of its latency with clients to that without, each of all phases; and the samples that the
/// clients received a second.
fn latency_ratio(http: &str) -> (BTreeMap<String, f64>, f64) {
    let of_threads = probes(http, ".latency");
    let of_threads: Vec<_> = of_threads
        .into_iter()
        .filter(|it| it.starts_with("thread:"))
        .collect();
    let all = probes(http, ".");
    let all: Vec<_> = all
        .into_iter()
        .filter(|it| !it.starts_with("net:"))
        .collect();
    let mut meter = scope(http, &of_threads, 10);
    let mut groups = Vec::new();
    let mut all_with: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    let mut all_without = all_with.clone();
    let mut samples = 0;
    for _ in 0..PAIRS {
        let mut phase = || {
            latencies(&mut meter, &mut groups, Instant::now() + SETTLED);
            latencies(&mut meter, &mut groups, Instant::now() + PHASE)
        };
        for (thread, latency) in phase() {
            all_without.entry(thread).or_default().extend(latency);
        }
        let clients = Clients::start(http, &all);
        for (thread, latency) in phase() {
            all_with.entry(thread).or_default().extend(latency);
        }
        samples += clients.end();
    }
    let ratio = |(thread, with): (String, Vec<f64>)| {
        let without = all_without.get(&thread).map_or(&[][..], Vec::as_slice);
        let ratio = p99(&with) / p99(without);
        (thread, ratio)
    };
    let ratios = all_with.into_iter().map(ratio);
    let seconds = (PHASE + SETTLED).as_secs_f64() * PAIRS as f64;
    (ratios.collect(), samples as f64 / seconds)
}

/// Notes when the first picture of the 3-D view is there, ms since the begin of the navigation.
const NOTE_FIRST: &str = "(() => { const look = () => { if (document.querySelector('canvas.space')?.dataset.frames) window.first = performance.now(); \
    else requestAnimationFrame(look); }; requestAnimationFrame(look); })()";

/// Time to the first picture, s, and pictures a second; `None` without a browser.
fn pictures(page: &str) -> Option<(f64, f64)> {
    let mut browser = Browser::start().ok()?;
    browser.resize(1280, 800, false);
    browser.before_pages(NOTE_FIRST);
    let mut firsts = Vec::new();
    for _ in 0..OPENINGS {
        browser.open("about:blank");
        browser.open(&format!("{page}#cell"));
        let until = Instant::now() + Duration::from_secs(60);
        let first = loop {
            if let Some(first) = browser.value("window.first ?? null").as_f64() {
                break first;
            }
            assert!(Instant::now() < until, "there is no picture");
            std::thread::sleep(Duration::from_millis(20));
        };
        firsts.push(first / 1000.0);
    }
    std::thread::sleep(SETTLED * 3);
    let frames =
        "[Number(document.querySelector('canvas.space').dataset.frames), performance.now()]";
    let before = browser.value(frames);
    std::thread::sleep(DRAWN);
    let after = browser.value(frames);
    let passed = |at: usize| after[at].as_f64().unwrap() - before[at].as_f64().unwrap();
    Some((median(firsts), passed(0) / passed(1) * 1000.0))
}

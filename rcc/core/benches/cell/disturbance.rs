//! Effect of loading nets on running nets: the latency of a net thread in alternating slices with and
//! without loading, so that a slow drift of the machine cancels out.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use serde_json::{Value, json};
use takt_core::controller::LoadRequest;
use takt_core::{CellConfig, Controller, SessionId};
use takt_net::{Limits, LoadContext, NoDevices, load};

use crate::quantiles::as_f64;

/// Primitives of the loaded nets.
const PRIMITIVES: usize = 10_000;
/// Primitives of the running net.
const RUNNING: usize = 400;
/// Slices of each kind.
const SLICES: usize = 20;
const SLICE: Duration = Duration::from_millis(500);

/// A chain of additions that never ends.
fn chain(additions: usize) -> String {
    let mut text = String::from("{a0=Core::DoubleValue(Value='0'),");
    for i in 1..additions {
        let _cannot_fail = write!(
            text,
            "a{i}=Core::DoubleAdd(inFirst=a{}.outValue,Second='1'),",
            i - 1
        );
    }
    text + "never=Core::BooleanValue(Value='false'),outTerminate=never.outValue}"
}

/// Runs a function while a thread loads nets.
pub(crate) fn while_loading<R>(work: impl FnOnce() -> R) -> R {
    let stop = AtomicBool::new(false);
    let text = chain(PRIMITIVES);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let registry = takt_core::registry();
            let context = LoadContext {
                registry: &registry,
                devices: &NoDevices,
                period: Duration::from_millis(1),
                limits: Limits::default(),
            };
            while !stop.load(Ordering::Relaxed) {
                drop(load(&text, &context).expect("the net is good"));
            }
        });
        let result = work();
        stop.store(true, Ordering::Relaxed);
        result
    })
}

fn request(text: &str) -> LoadRequest {
    LoadRequest {
        text: text.to_owned(),
        session: SessionId::NONE,
        description: String::new(),
        period: None,
    }
}

/// Counts by upper bound, ns.
type Histogram = BTreeMap<i64, u64>;

fn latencies(controller: &Controller) -> Histogram {
    let snapshot = controller.stats();
    let buckets = snapshot.latency_buckets();
    buckets.map(|(bound, count)| (bound.0, count)).collect()
}

/// Adds the counts since `before`.
fn add_since(before: &Histogram, controller: &Controller, sum: &mut Histogram) {
    for (bound, count) in latencies(controller) {
        let new = count - before.get(&bound).copied().unwrap_or(0);
        *sum.entry(bound).or_default() += new;
    }
}

/// The bound of a quantile, us.
fn quantile_us(histogram: &Histogram, share: f64) -> f64 {
    let all: u64 = histogram.values().sum();
    let mut seen = 0;
    for (bound, count) in histogram {
        seen += count;
        if as_f64(seen.cast_signed()) >= share * as_f64(all.cast_signed()) {
            return as_f64(*bound) / 1e3;
        }
    }
    0.0
}

pub(crate) fn run() -> Value {
    let mut cell = CellConfig::default();
    (cell.controller.websocket, cell.controller.tcp) = (None, None);
    let controller = Controller::start(&cell).expect("a controller without devices");
    let running = controller.load(request(&chain(RUNNING)));
    let running = running.expect("there is room for a net");
    controller.start_net(running).expect("it needs nothing");
    let big = chain(PRIMITIVES);
    let (mut quiet, mut loading) = (Histogram::new(), Histogram::new());
    let mut loads = 0;
    for _ in 0..SLICES {
        let before = latencies(&controller);
        std::thread::sleep(SLICE);
        add_since(&before, &controller, &mut quiet);
        let before = latencies(&controller);
        let end = std::time::Instant::now() + SLICE;
        while std::time::Instant::now() < end {
            let net = controller.load(request(&big)).expect("there is room");
            controller.unload(net).expect("it never ran");
            loads += 1;
        }
        add_since(&before, &controller, &mut loading);
    }
    let [p50, p99] = [0.5, 0.99].map(|share| {
        let [quiet, loading] = [&quiet, &loading].map(|h| quantile_us(h, share));
        println!(
            "latency of the net thread, {:2.0} %: {quiet:.1} us, while {loads} nets of 10,000 are \
             loaded {loading:.1} us",
            share * 100.0
        );
        [quiet, loading]
    });
    json!({
        "load_disturbance_p50_ratio": p50[1] / p50[0],
        "load_disturbance_p99_ratio": p99[1] / p99[0],
        "latency_p99_us": p99[0],
        "latency_p99_loading_us": p99[1],
        "loads_while_running": loads,
    })
}

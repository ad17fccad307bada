//! The cost of a primitive, beside the bare floor and a hand-written loop, and the cost of loading.
//! `cargo bench -p takt-net --bench net [-- [--json] [--svg FILE]]`. It judges no figure.
//!
//! Ratios count; the absolute figures are those of one machine at one moment. The net is timed with
//! everything it has when it runs: types, null, and the worst-case accounting of an executor.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

mod floor;
mod plot;
mod quantiles;
mod timing;

use std::fmt::Write;
use std::hint::black_box;
use std::time::Duration;

use serde_json::{Value, json};
use takt_net::{Image, Limits, LoadContext, Moment, NoDevices, Plan, Registry, load};

use floor::{Floor, Shape, slab, straight_line};
use quantiles::{as_f64, median, quantile};
use timing::{Subject, in_real_time, now, paced, ratio, warm};

const SIZES: [usize; 6] = [10, 100, 400, 1000, 10_000, 100_000];
/// Cycles of each subject in one run of the loop, and runs, each with new nets: their location in
/// memory matters too.
const CYCLES: usize = 2_000;
const RUNS: usize = 5;
const LOADS: usize = 41;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let after = |name: &str| arguments.iter().position(|a| a == name).map(|i| i + 1);
    let bench = Bench::new();

    let sizes: Vec<Cost> = SIZES.iter().map(|size| bench.cost(*size)).collect();
    let mut result = json!({
        "ns_by_size": by_size(&sizes, |c| c.ours_ns),
        "floor_ns_by_size": by_size(&sizes, |c| c.floor_ns),
        "bytes_per_primitive": by_size(&sizes, |c| c.bytes),
    });
    for part in [
        bench.straight_line(),
        bench.fan(),
        bench.inactive(),
        bench.loading(),
        bench.cycles(),
    ] {
        if let (Value::Object(all), Value::Object(part)) = (&mut result, part) {
            all.extend(part);
        }
    }
    if let Some(path) = after("--svg").and_then(|i| arguments.get(i)) {
        plot::draw(path.as_ref(), &sizes).expect("the plot can be written");
    }
    if after("--json").is_some() {
        println!("{result}");
    }
}

/// Cost of a chain of additions, back to back.
#[derive(Clone, Copy)]
pub(crate) struct Cost {
    pub(crate) additions: usize,
    pub(crate) ours_ns: f64,
    pub(crate) floor_ns: f64,
    /// Bytes of the plan for each addition.
    pub(crate) bytes: f64,
}

fn by_size(costs: &[Cost], figure: impl Fn(&Cost) -> f64) -> Value {
    let rounded = |c: &Cost| json!((figure(c) * 100.0).round() / 100.0);
    let entries = costs.iter().map(|c| (c.additions.to_string(), rounded(c)));
    Value::Object(entries.collect())
}

struct Bench {
    registry: Registry,
    image: Image,
}

impl Bench {
    fn new() -> Self {
        Self {
            registry: Registry::core(),
            image: Image::default(),
        }
    }

    fn load(&self, text: &str) -> Plan {
        let context = LoadContext {
            registry: &self.registry,
            devices: &NoDevices,
            period: Duration::from_millis(1),
            limits: Limits::default(),
        };
        load(text, &context).expect("the net is good")
    }

    /// A net as an executor runs it: the longest cycle is recorded.
    fn running<'b>(&'b self, text: &str) -> impl FnMut() + use<'b> {
        let mut plan = self.load(text);
        let mut worst_ns = 0;
        move || {
            let start = now();
            black_box(plan.evaluate(&self.image, Moment::default()));
            worst_ns = worst_ns.max(now() - start);
        }
    }

    fn cost(&self, additions: usize) -> Cost {
        let text = net(Shape::Chain, additions);
        let mut plan = self.load(&text);
        assert!(plan.evaluate(&self.image, Moment::default()), "a wrong sum");
        let bytes = as_f64(plan.bytes()) / as_f64(additions);
        let mut ours = self.running(&text);
        let mut floor = Floor::new(Shape::Chain, additions);
        let calls = u32::try_from(40_000 / additions).unwrap_or(1).max(1);
        let [ours, theirs] = warm(calls, [&mut ours, &mut || floor.evaluate()]);
        assert!((floor.result() - as_f64(additions)).abs() < 0.5);
        let each = |times: &[f64]| median(times) / as_f64(additions);
        let cost = Cost {
            additions,
            ours_ns: each(&ours),
            floor_ns: each(&theirs),
            bytes,
        };
        println!(
            "back to back, {additions:6} additions: {:6.2} ns each, floor {:6.2} ns, ratio {:.2}; \
             {bytes:.0} bytes each",
            cost.ours_ns,
            cost.floor_ns,
            ratio(&ours, &theirs)
        );
        cost
    }

    fn straight_line(&self) -> Value {
        let mut numbers = slab(400);
        let mut ours = self.running(&net(Shape::Chain, 400));
        let [ours, straight] = warm(100, [&mut ours, &mut || straight_line(&mut numbers)]);
        let ratio = ratio(&ours, &straight);
        println!(
            "back to back, 400 by hand: {:.2} ns each, ratio {ratio:.2}",
            median(&straight) / 400.0
        );
        json!({ "ratio_to_straight_line_400": ratio, "active_primitive_ns": median(&ours) / 400.0 })
    }

    /// Independent additions.
    fn fan(&self) -> Value {
        let mut ours = self.running(&net(Shape::Fan, 400));
        let mut floor = Floor::new(Shape::Fan, 400);
        let [ours, floor] = warm(100, [&mut ours, &mut || floor.evaluate()]);
        let ratio = ratio(&ours, &floor);
        let each = |times: &[f64]| median(times) / 400.0;
        println!(
            "back to back, 400 independent additions: {:.2} ns each, floor {:.2} ns, ratio {ratio:.2}",
            each(&ours),
            each(&floor)
        );
        json!({ "independent_ns": each(&ours), "ratio_to_floor_400_independent": ratio })
    }

    /// A switched-off fragment of 10,000 primitives, compared with the same net without it.
    fn inactive(&self) -> Value {
        let fragment = net(Shape::Chain, 10_000);
        let base = "off=Core::BooleanValue(Value='false'), outTerminate=off.outValue";
        let with = format!("{{{base}, big={fragment}(inActive=off.outValue)}}");
        let mut with = self.running(&with);
        let mut without = self.running(&format!("{{{base}}}"));
        let [with, without] = warm(1000, [&mut with, &mut without]);
        let ns = median(&with) - median(&without);
        println!("inactive fragment of 10,000: {ns:.2} ns");
        json!({ "inactive_fragment_ns": ns })
    }

    fn loading(&self) -> Value {
        let text = net(Shape::Chain, 10_000);
        let (mut load, mut free) = (Vec::new(), Vec::new());
        for _ in 0..LOADS {
            let start = now();
            let plan = self.load(&text);
            let ready = now();
            drop(plan);
            load.push(as_f64(ready - start) / 1e6);
            free.push(as_f64(now() - ready) / 1e6);
        }
        let (load, free) = (median(&load), median(&free));
        println!("10,000 primitives: text to ready {load:.2} ms, freed in {free:.2} ms");
        json!({ "load_10000_ms": load, "free_10000_ms": free })
    }

    /// The chain of 400 additions in a 1 kHz loop.
    fn cycles(&self) -> Value {
        let (mut ours, mut floor) = (Vec::new(), Vec::new());
        let mut ratios = Vec::new();
        let mut fifo = true;
        for _ in 0..RUNS {
            let mut net = self.running(&net(Shape::Chain, 400));
            let mut bare = Floor::new(Shape::Chain, 400);
            let subjects: [Subject<'_>; 2] = [&mut net, &mut || bare.evaluate()];
            let (granted, [net, bare]) = in_real_time(|| paced(CYCLES, subjects));
            fifo &= granted;
            ratios.push(ratio(&net, &bare));
            ours.extend(net);
            floor.extend(bare);
        }
        let ratio = median(&ratios);
        if !fifo {
            println!(
                "SCHED_FIFO was not granted: the figures of the loop are those of an ordinary thread"
            );
        }
        let each = |times: &[f64], share: f64| quantile(times, share) / 400.0;
        for (name, times) in [("net", &ours), ("floor", &floor)] {
            let (p50, p99) = (each(times, 0.5), each(times, 0.99));
            println!("1 kHz, 400 additions, {name:5}: p50 {p50:.2} ns each, p99 {p99:.2} ns");
        }
        let (least, most) = (quantile(&ratios, 0.0), quantile(&ratios, 1.0));
        println!(
            "1 kHz, 400 additions: ratio to floor {ratio:.2}, in {RUNS} runs {least:.2} to {most:.2}"
        );
        json!({
            "fifo": fifo,
            "ratio_to_floor_400": ratio,
            "ratio_to_floor_400_least": least,
            "ratio_to_floor_400_most": most,
            "ns_per_primitive": each(&ours, 0.5),
            "ns_per_primitive_p99": each(&ours, 0.99),
            "floor_ns": each(&floor, 0.5),
            "floor_ns_p99": each(&floor, 0.99),
        })
    }
}

/// The text of a net of additions. It ends at once if the last one has the right result.
fn net(shape: Shape, additions: usize) -> String {
    let mut text = String::from("{zero=Core::DoubleValue(Value='0'), ");
    let mut first = "zero".to_owned();
    for i in 0..additions {
        let _cannot_fail = write!(
            text,
            "a{i}=Core::DoubleAdd(inFirst={first}.outValue, Second='1'), "
        );
        if shape == Shape::Chain {
            first = format!("a{i}");
        }
    }
    let last = additions - 1;
    let sum = if shape == Shape::Chain { additions } else { 1 };
    let _cannot_fail = write!(
        text,
        "right=Core::DoubleEquals(inFirst=a{last}.outValue, Second='{sum}'), \
         outTerminate=right.outValue}}"
    );
    text
}

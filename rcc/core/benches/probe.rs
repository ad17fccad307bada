//! Cost of a probe of a net in a cycle: a net evaluated alone, and with its ports sampled into a ring without a reader. Judges no figure.
//! `cargo bench -p takt-core --bench probe [-- [--json]]`.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use std::hint::black_box;
use std::time::{Duration, Instant};

use serde_json::json;
use takt_core::executor::flight;
use takt_net::{Image, Limits, LoadContext, Moment, Nanos, NoDevices, Plan, Registry};

const PRIMITIVES: usize = 128;
const PROBES: [usize; 3] = [1, 16, 64];
const CYCLES: u64 = 20_000;
const ROUNDS: usize = 21;

/// A clock and a chain of additions.
fn plan() -> Option<Plan> {
    let mut text = "{p0=Core::Clock()".to_owned();
    for number in 1..PRIMITIVES {
        let before = number - 1;
        text +=
            &format!(",p{number}=Core::DoubleAdd(inFirst=p{before}.outValue,inSecond=p0.outValue)");
    }
    text += ",c=Cancel(),outTerminate=c.outCancel}";
    let registry = Registry::core();
    let context = LoadContext {
        registry: &registry,
        devices: &NoDevices,
        period: Duration::from_millis(1),
        limits: Limits::default(),
    };
    takt_net::load(&text, &context).ok()
}

/// Nanoseconds of a cycle: the least of some rounds, so that what interrupts is left out.
fn least(mut cycle: impl FnMut(Moment)) -> f64 {
    let round = |_| {
        let begin = Instant::now();
        for number in 1..=CYCLES {
            cycle(Moment {
                cycle: number,
                time: Nanos(i64::try_from(number).unwrap_or(0) * 1_000_000),
                ..Moment::default()
            });
        }
        #[expect(clippy::cast_precision_loss, reason = "some thousands")]
        let cycles = CYCLES as f64;
        begin.elapsed().as_secs_f64() * 1e9 / cycles
    };
    (0..ROUNDS).map(round).fold(f64::INFINITY, f64::min)
}

fn main() {
    let Some(mut plan) = plan() else {
        println!("the net of the benchmark is rejected");
        return;
    };
    let image = Image::default();
    let alone = least(|moment| {
        black_box(plan.evaluate(&image, moment));
    });
    let mut members = serde_json::Map::new();
    members.insert("net_ns".to_owned(), alone.into());
    let is_json = std::env::args().any(|argument| argument == "--json");
    if !is_json {
        println!("{PRIMITIVES} primitives alone  {alone:8.1} ns");
    }
    for (count, probes) in PROBES.into_iter().zip([1.0, 16.0, 64.0]) {
        let ports = plan.ports().clone();
        let out = ports
            .all()
            .iter()
            .filter(|port| !port.is_in && port.len() == 1);
        let sampled = ports.sampled(out.take(count));
        let mut words = vec![0; sampled.words()];
        let (mut writer, _reader) = flight::ring(words.len() + 1, 4096);
        let with = least(|moment| {
            black_box(plan.evaluate(&image, moment));
            plan.sample(&sampled, &mut words);
            writer.write(std::iter::once(moment.cycle).chain(words.iter().copied()));
        });
        let each = (with - alone) / probes;
        members.insert(format!("probe_ns_of_{count}"), each.into());
        if !is_json {
            println!("each of {count:3} probes   {each:8.2} ns");
        }
    }
    if is_json {
        println!("{}", json!({ "probe": members }));
    }
}

//! Cost of running nets: the net of two arms that move along lines, endless hand-overs, and the effect of
//! loading nets on running ones. Judges no figure.
//! `cargo bench -p takt-core --bench cell [-- [--json]]`.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

mod disturbance;
mod mixed;
#[path = "../../../net/benches/net/quantiles.rs"]
mod quantiles;
mod rules;
mod switches;

use serde_json::{Value, json};

fn main() {
    let mut result = json!({});
    for part in [mixed::run(), rules::run(), switches(), disturbance::run()] {
        if let (Value::Object(all), Value::Object(part)) = (&mut result, part) {
            all.extend(part);
        }
    }
    if std::env::args().any(|argument| argument == "--json") {
        println!("{result}");
    }
}

/// Hand-overs while other threads load nets as fast as they can.
fn switches() -> Value {
    const SWITCHES: u32 = 100_000;
    let switches::Switched {
        switches,
        missing,
        doubled,
    } = disturbance::while_loading(|| switches::run(SWITCHES));
    println!(
        "{switches} switches at 500 us logical period under load: {missing} cycles without a \
         set-point, {doubled} with two"
    );
    json!({"switches": switches, "switch_missing": missing, "switch_doubled": doubled})
}

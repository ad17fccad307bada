//! Evaluation statistics of nets as values: declared and measured cost. Times are in ms; the six decimals of a float
//! then resolve single nanoseconds.

use std::time::Duration;

use takt_client::wire::Value;
use takt_core::controller::NetFigures;

pub(super) fn value(figures: &NetFigures) -> Value {
    let counts = &figures.counts;
    let time = |time: Duration| Value::Float(time.as_secs_f64() * 1e3);
    // Integers of the protocol have 31 bits, i.e. 25 days at 1 kHz.
    let number = |n: u64| Value::Float(n as f64);
    Value::map_of([
        ("period", time(figures.period)),
        ("thread", time(figures.thread_period)),
        ("primitives", number(figures.primitives as u64)),
        ("cost", time(figures.cost)),
        ("budget", time(figures.budget)),
        ("cycles", number(counts.cycles)),
        ("overruns", number(counts.overruns)),
        ("overbudget", number(counts.over_budget)),
        ("min", time(counts.min)),
        ("mean", time(counts.mean)),
        ("max", time(counts.max)),
    ])
}

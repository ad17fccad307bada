//! What the statistics cost a cycle: the same body bare, with statistics, and with the alternative that
//! was not taken (a copy of three library histograms). `cargo bench -p takt-rt`.
//!
//! Ratios count; the absolute figures are those of one machine at one moment. Rounds alternate and the
//! medians are compared, so that a disturbed round does not decide.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use std::{hint::black_box, time::Duration};

use hdrhistogram::Histogram;
use takt_rt::{Nanos, cycle::Grid, latest::latest, monotonic, stats};

const CYCLES: u32 = 20_000;
const ROUNDS: usize = 21;

fn main() {
    let (mut writer, reader) = stats::pair();
    let (mut cell_out, mut cell_in) = latest(4, || [0_u64; 16]);
    let mut grid = Grid::new(monotonic(), Duration::from_nanos(700));
    let mut rounds = [const { Vec::new() }; 4];
    for _ in 0..ROUNDS {
        rounds[0].push(per_cycle(body));
        rounds[1].push(per_cycle(|| {
            let tick = grid.next(monotonic());
            body();
            let finished = monotonic();
            writer.record(&tick, finished);
        }));
        rounds[2].push(per_cycle(|| {
            black_box((monotonic(), monotonic()));
        }));
        rounds[3].push(per_cycle(|| {
            cell_out.write([1; 16]);
            black_box(cell_in.read());
        }));
    }
    let [bare, with_statistics, clocks, cell] = rounds.map(median);
    println!("bare cycle                {bare:8.1} ns");
    println!("cycle with statistics     {with_statistics:8.1} ns");
    println!(
        "  difference              {:8.1} ns",
        with_statistics - bare
    );
    println!("  of it, two clock reads  {clocks:8.1} ns");
    println!("  ratio                   {:8.3}", with_statistics / bare);
    println!("cell, 128 bytes, write and read {cell:.1} ns");
    println!(
        "copy of three histograms  {:8.1} ns, not done",
        histogram_copy()
    );
    println!("{}", reader.snapshot());
}

/// About a microsecond of arithmetic, as a small net does.
fn body() {
    let mut sum = 1.0_f64;
    for step in 0..300_u32 {
        sum = black_box(sum * 0.999 + f64::from(step));
    }
}

/// Mean time of `cycle` in ns.
fn per_cycle(mut cycle: impl FnMut()) -> f64 {
    let start = monotonic();
    for _ in 0..CYCLES {
        cycle();
    }
    mean_ns(monotonic() - start, CYCLES)
}

fn histogram_copy() -> f64 {
    let mut source = Histogram::<u32>::new_with_bounds(1, 10_000_000_000, 2).expect("valid bounds");
    for value in 0..10_000 {
        source.saturating_record(value * 97);
    }
    let mut copies = [source.clone(), source.clone(), source.clone()];
    let times = (0..ROUNDS).map(|_| {
        let start = monotonic();
        for copy in &mut copies {
            copy.set_to(&source).expect("same bounds");
        }
        mean_ns(monotonic() - start, 1)
    });
    median(times.collect())
}

#[expect(clippy::cast_precision_loss, reason = "nanoseconds of a benchmark")]
fn mean_ns(span: Nanos, count: u32) -> f64 {
    span.0 as f64 / f64::from(count)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

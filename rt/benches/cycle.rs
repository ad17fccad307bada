//! Cost of the statistics per cycle: the same body bare, between two clock reads, and with statistics;
//! and the cost of the rejected alternative, a copy of three library histograms.
//! `cargo bench -p takt-rt`.
//!
//! Ratios count; the absolute figures are those of one machine at one moment. Rounds alternate and the
//! medians are compared, so that a disturbed round does not decide. A clock read waits for the work
//! before it, so most of its price here is overlap of one body with the next, which a sleeping cycle has not.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use std::{hint::black_box, time::Duration};

use hdrhistogram::Histogram;
use takt_rt::{Nanos, cycle::Grid, latest::latest, monotonic, stats};

const CYCLES: u32 = 20_000;
const ROUNDS: usize = 21;

fn main() {
    let (mut writer, reader) = stats::pair();
    let (mut cell_out, mut cell_in) = latest(4, || [0_u64; 16]);
    let mut grid = Grid::new(monotonic(), Duration::from_micros(1));
    let mut rounds = [const { Vec::new() }; 4];
    for _ in 0..ROUNDS {
        rounds[0].push(per_cycle(body));
        rounds[1].push(per_cycle(|| {
            black_box(monotonic());
            body();
            black_box(monotonic());
        }));
        grid.skip_to(monotonic());
        rounds[2].push(per_cycle(|| {
            let tick = grid.next(monotonic());
            body();
            writer.record(&tick, monotonic());
        }));
        rounds[3].push(per_cycle(|| {
            cell_out.write([1; 16]);
            black_box(cell_in.read());
        }));
    }
    let [bare, clocked, recorded, cell] = rounds.map(median);
    println!("bare body                       {bare:8.1} ns");
    println!(
        "with two clock reads            {clocked:8.1} ns, ratio {:.3}",
        clocked / bare
    );
    println!(
        "with grid and statistics        {recorded:8.1} ns, ratio {:.3}",
        recorded / bare
    );
    println!(
        "  grid and statistics alone     {:8.1} ns",
        recorded - clocked
    );
    println!("cell of 128 bytes, write + read {cell:8.1} ns");
    println!(
        "not done: copy of histograms    {:8.1} ns, cache warm",
        histogram_copy(0)
    );
    println!(
        "                                {:8.1} ns, cache cold",
        histogram_copy(64 << 20)
    );
    println!("{}", reader.snapshot());
    println!(
        "{{\"bench\":\"cycle\",\"statistics_ns\":{:.1},\"cell_ns\":{cell:.1}}}",
        recorded - clocked
    );
}

/// About a microsecond of arithmetic, as a small net does.
#[inline(never)]
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

/// Time to copy three histograms after `traffic` bytes of other memory were touched.
fn histogram_copy(traffic: usize) -> f64 {
    let mut source = Histogram::<u32>::new_with_bounds(1, 10_000_000_000, 2).expect("valid bounds");
    for value in 0..10_000 {
        source.saturating_record(value * 97);
    }
    let sources = [source.clone(), source.clone(), source.clone()];
    let mut copies = sources.clone();
    let mut other = vec![0_u8; traffic];
    let times = (0..ROUNDS).map(|_| {
        other
            .iter_mut()
            .step_by(64)
            .for_each(|line| *line = line.wrapping_add(1));
        black_box(&mut other);
        let start = monotonic();
        for (copy, source) in copies.iter_mut().zip(&sources) {
            copy.set_to(black_box(source)).expect("same bounds");
        }
        black_box(&mut copies);
        mean_ns(monotonic() - start, 1)
    });
    median(times.collect())
}

fn mean_ns(span: Nanos, count: u32) -> f64 {
    span.0 as f64 / f64::from(count)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

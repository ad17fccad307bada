//! Long chains of blended motions on emulated arms, one program for each arm, each one motion ahead: counts hand-overs
//! that were missed, rests between motions, nets that were loaded at a time, and what memory the process gains.
//!
//! ```console
//! $ cargo run --release -p takt-tests --example hand_overs -- [ACTIVITIES]
//! ```

#![expect(clippy::print_stdout, reason = "a report is all that it makes")]
#![expect(
    clippy::unwrap_used,
    reason = "part of a test too, which fails by panicking"
)]

#[path = "../tests/robotics/mod.rs"]
mod robotics;

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use robotics::Bench;
use robotics::watched::{self, Watched};
use takt_api::{Error, Outcome};

/// Arms of the long run.
const ARMS: usize = 8;
/// Part of its path after which a motion is blended into the next one.
const BLEND: f64 = 0.4;
/// Distance of the corners from the centre of their hexagon, rad.
const RADIUS: f64 = 0.15;
/// How often the loaded nets are counted.
const SAMPLE: Duration = Duration::from_millis(3);

fn main() -> Result<(), Error> {
    let activities = std::env::args().nth(1);
    let activities = activities.and_then(|count| count.parse().ok());
    let report = run(ARMS, activities.unwrap_or(10_000))?;
    println!("activities            {:8}", report.activities);
    println!("missed hand-overs     {:8}", report.missed);
    println!("rests between them    {:8}", report.rests);
    println!("nets of an arm, most  {:8}", report.nets_most);
    println!("memory after a third  {:8} KiB", report.memory_kib[0]);
    println!("memory at the end     {:8} KiB", report.memory_kib[1]);
    Ok(())
}

/// What was counted.
#[derive(Debug)]
pub(crate) struct Report {
    pub(crate) activities: usize,
    /// Activities that ended before the next one took over.
    pub(crate) missed: usize,
    /// How often an arm rested before its last motion ended.
    pub(crate) rests: u64,
    /// Most nets that were loaded for one arm at a time.
    pub(crate) nets_most: usize,
    /// Memory of the process after a third of the activities, and at the end.
    pub(crate) memory_kib: [u64; 2],
}

/// Runs so many activities, all arms together.
pub(crate) fn run(arms: usize, activities: usize) -> Result<Report, Error> {
    let each = activities.div_ceil(arms);
    let activities = each * arms;
    let (cell, arms) = watched::cell(arms);
    let bench = Bench::of(&cell);
    let (is_done, begun) = (AtomicBool::new(false), AtomicUsize::new(0));
    let (counted, sampled) = std::thread::scope(|scope| {
        let sampler = scope.spawn(|| sample(&bench, arms.len(), &is_done, &begun, activities / 3));
        let programs: Vec<_> = arms
            .iter()
            .enumerate()
            .map(|(number, watched)| {
                let (bench, begun) = (&bench, &begun);
                scope.spawn(move || program(bench, watched, number, each, begun))
            })
            .collect();
        let counted: Vec<_> = programs
            .into_iter()
            .map(|program| program.join().unwrap())
            .collect();
        is_done.store(true, Ordering::Relaxed);
        (counted, sampler.join().unwrap())
    });
    let counted = counted.into_iter().collect::<Result<Vec<_>, _>>()?;
    let (nets_most, memory_kib) = sampled;
    Ok(Report {
        activities,
        missed: counted.iter().map(|(missed, _)| missed).sum(),
        rests: counted.iter().map(|(_, rests)| rests).sum(),
        nets_most,
        memory_kib: [memory_kib, resident_kib()],
    })
}

/// Moves one arm around its hexagon; returns missed hand-overs and rests.
fn program(
    bench: &Bench,
    watched: &Watched,
    number: usize,
    activities: usize,
    begun: &AtomicUsize,
) -> Result<(usize, u64), Error> {
    let cell = bench.cell();
    let arm = cell.arm(&format!("arm{number}"))?;
    arm.ptp(corner(0)).run()?;
    // Its set-points end some cycles before the arm rests: those are no rest between motions.
    while !watched.is_resting() {
        std::thread::sleep(SAMPLE);
    }
    let rests = watched.rests();
    let (mut missed, mut before) = (0, None);
    for activity in 1..=activities {
        let handle = arm.ptp(corner(activity)).blend(BLEND).begin()?;
        begun.fetch_add(1, Ordering::Relaxed);
        if let Some(before) = before.replace(handle) {
            missed += usize::from(before.wait()? != Outcome::TakenOver);
        }
    }
    // Before the last motion ends, after which it rests.
    let rests = watched.rests() - rests;
    arm.finish()?;
    Ok((missed, rests))
}

/// A corner of the hexagon: on the way from one to the next, no two joints turn back at the same time.
fn corner(number: usize) -> [f64; 7] {
    let angle = (number % 6) as f64 * std::f64::consts::FRAC_PI_3;
    let (sine, cosine) = angle.sin_cos();
    let [x, y] = [RADIUS * cosine, RADIUS * sine];
    [x, y, -x, -y, x, y, -x]
}

/// Until the programs are done: the most nets of one arm, and the memory after so many activities.
fn sample(
    bench: &Bench,
    arms: usize,
    is_done: &AtomicBool,
    begun: &AtomicUsize,
    after: usize,
) -> (usize, u64) {
    let (mut most, mut memory) = (0, None);
    while !is_done.load(Ordering::Relaxed) {
        let mut nets = vec![0; arms];
        for net in bench.controller.nets() {
            let Some(info) = bench.controller.net(net) else {
                continue;
            };
            let is_of = |arm: &usize| info.text.contains(&format!("'arm{arm}'"));
            if let Some(arm) = (0..arms).find(is_of) {
                nets[arm] += 1;
            }
        }
        most = nets.into_iter().fold(most, usize::max);
        if begun.load(Ordering::Relaxed) >= after {
            memory.get_or_insert_with(resident_kib);
        }
        std::thread::sleep(SAMPLE);
    }
    (most, memory.unwrap_or_else(resident_kib))
}

/// Resident memory of this process.
fn resident_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let number = line.and_then(|line| line.split_whitespace().next());
    number.and_then(|number| number.parse().ok()).unwrap_or(0)
}

//! A cycle kept over minutes on a veth pair: how late it woke up, how many of its answers came after the next cycle
//! began, how many working counters were other than expected. Axes of two drives follow a slow sine meanwhile, and the
//! emulated segment answers on the other end. It asks for no priority: run it by `chrt` and `taskset`. Where there is
//! cyclictest, it runs before and after on the same processor with the same period, half of the time each.
//!
//! ```console
//! # cargo build --release -p takt-ethercat --example cycle
//! # unshare --net taskset -c 1 chrt -f 80 target/release/examples/cycle AXES CYCLE_US SECONDS [SEGMENT_CPU]
//! ```
#![expect(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "an example: it prints, and the segment's end of the cable is a thread of its own"
)]

use std::error::Error;
use std::io;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use nix::sched::{CpuSet, sched_setaffinity};
use nix::time::{ClockId, ClockNanosleepFlags, clock_nanosleep};
use nix::unistd::Pid;
use takt_cia402::emulator::DriveConfig;
use takt_cia402::{Goal, Patience};
use takt_ethercat::axis::{self, Axis, AxisState, Target};
use takt_ethercat::config::{MasterConfig, Place, SlaveSpec};
use takt_ethercat::emulator::{Coupler, Segment, Server, ServoConfig, ServoDrive, SharedSegment};
use takt_ethercat::link::Port;
use takt_ethercat::linux::{PacketLink, monotonic};
use takt_ethercat::master::Master;

const ENDS: [&str; 2] = ["tkcy-master", "tkcy-slaves"];

/// Priority of cyclictest, as this is to be run.
const PRIORITY: u8 = 80;
/// Cycles from one time that an axis is asked to go on to the next.
const ASK_EACH: u64 = 100;
/// Events that are printed.
const EVENTS: usize = 32;

/// A coupler and drives of up to eight axes each, and what a master is to make of them.
fn stand(axes: u8, cycle: Duration) -> Result<(Segment, MasterConfig), Box<dyn Error>> {
    let mut slaves = vec![Coupler::slave()];
    let mut specs = vec![SlaveSpec::new("coupler", Place::Position(0))];
    let mut left = axes;
    while left > 0 {
        let count = left.min(8);
        left -= count;
        let mut axis = DriveConfig::default();
        // Hosts that stall are counted, not punished.
        axis.quirks.missing_set_points = None;
        let (slave, _) = ServoDrive::slave(ServoConfig {
            axes: vec![axis; count.into()],
            ..ServoConfig::default()
        })?;
        let (outputs, inputs) = axis::pdos(count);
        let place = Place::Position(u16::try_from(slaves.len())?);
        specs.push(SlaveSpec {
            outputs: Some(outputs),
            inputs: Some(inputs),
            watchdog: Some(Duration::from_secs(1)),
            ..SlaveSpec::new(format!("drive {}", slaves.len()), place)
        });
        slaves.push(slave);
    }
    let config = MasterConfig {
        cycle,
        slaves: specs,
        ..MasterConfig::default()
    };
    Ok((Segment::line(slaves), config))
}

/// What came of the cycles.
#[derive(Debug, Default)]
struct Figures {
    late: Vec<Duration>,
    trips: Vec<Duration>,
    /// Answers that were not there when the next cycle was to begin.
    missed: u64,
    /// Cycles that were left out.
    skipped: u64,
}

/// One cycle that was to begin at `due`; returns whether its answer came in time.
fn cycle(
    master: &mut Master,
    port: &mut Port<PacketLink>,
    frame: &mut [u8],
    due: Duration,
    figures: &mut Figures,
) -> io::Result<()> {
    let end = due + master.config().cycle;
    let begin = monotonic()?;
    figures.late.push(begin.saturating_sub(due));
    let Some(len) = master.poll_transmit(begin, frame) else {
        return Ok(());
    };
    port.send(frame.get(..len).unwrap_or_default())?;
    loop {
        let left = end.saturating_sub(monotonic()?);
        let Some((bytes, at)) = port.receive(left)? else {
            figures.missed += 1;
            return Ok(());
        };
        if master.handle_frame(0, bytes, at) {
            figures.trips.push(monotonic()?.saturating_sub(begin));
            figures.missed += u64::from(at > end);
            return Ok(());
        }
    }
}

fn wait(due: Duration) {
    let flags = ClockNanosleepFlags::TIMER_ABSTIME;
    // A signal that wakes it early is seen as a wake-up that is not late.
    let _woken = clock_nanosleep(ClockId::CLOCK_MONOTONIC, flags, &due.into());
}

/// An axis, and where and in which cycle it began to follow.
type Follower = (Axis, Option<(i32, u64)>);

fn followers(master: &Master, axes: u8) -> Result<Vec<Follower>, Box<dyn Error>> {
    let mut all = Vec::new();
    for number in 0..axes {
        let slave = usize::from(number / 8) + 1;
        let process = master.slave(slave).ok_or("a drive is gone")?.process();
        let mut axis = Axis::new(slave, process, number % 8, Patience::default())?;
        axis.set_goal(Goal::OperationEnabled);
        all.push((axis, None));
    }
    Ok(all)
}

/// One cycle of all axes; how many follow, how many ceased to, and one that does not.
fn lead(
    all: &mut [Follower],
    master: &mut Master,
    n: u64,
    due: Duration,
) -> (usize, u64, Option<AxisState>) {
    let period = master.config().cycle;
    let (mut following, mut losses, mut last) = (0, 0, None);
    for (axis, start) in all {
        let target = start.map_or(Target::Hold, |(at, since)| {
            Target::Position(at + sine(n - since, period))
        });
        let state = axis.cycle(master, target, due);
        if state.follows {
            following += 1;
            start.get_or_insert((state.position, n));
            continue;
        }
        last = Some(state);
        losses += u64::from(start.take().is_some());
        // What was gone does not move by itself, and a drive whose slave fell out of OP is in fault: here it is to
        // go on all the same.
        if n.is_multiple_of(ASK_EACH) {
            axis.set_goal(Goal::OperationEnabled);
            axis.reset_fault();
        }
    }
    (following, losses, last)
}

fn run(axes: u8, config: MasterConfig, seconds: u64) -> Result<(), Box<dyn Error>> {
    let link = PacketLink::open(ENDS[0])?;
    let mac = link.mac();
    let (mut port, mut frame) = (Port::new(link, mac), [0; 1500]);
    let mut master = Master::new(config)?;
    let mut figures = Figures::default();
    let period = master.config().cycle;
    let mut due = monotonic()?;
    while !master.is_operational() {
        due = (due + period).max(monotonic()?);
        cycle(&mut master, &mut port, &mut frame, due, &mut figures)?;
    }
    let mut all = followers(&master, axes)?;
    let count = usize::try_from(u128::from(seconds) * 1_000_000_000 / period.as_nanos())?;
    let room = || Vec::with_capacity(count + 16);
    figures = Figures {
        late: room(),
        trips: room(),
        ..Figures::default()
    };
    let misses =
        |master: &Master| -> u64 { master.groups().iter().map(|group| group.misses).sum() };
    let (before, frames) = (misses(&master), master.frames());
    let (mut n, mut following, mut losses) = (0_u64, 0_usize, 0_u64);
    let (mut told, mut last) = (Vec::with_capacity(EVENTS), None);
    due = monotonic()? + period;
    for _ in 0..count {
        wait(due);
        cycle(&mut master, &mut port, &mut frame, due, &mut figures)?;
        while let Some(event) = master.poll_event() {
            if told.len() < EVENTS {
                told.push((n, event));
            }
        }
        let (now_following, lost, not) = lead(&mut all, &mut master, n, due);
        (following, last) = (now_following, not);
        losses += lost;
        n += 1;
        due += period;
        let now = monotonic()?;
        while due < now {
            due += period;
            figures.skipped += 1;
        }
    }
    let lost = master.frames().lost - frames.lost;
    println!(
        "{axes} axes, {following} following, {period:?}, {count} cycles, axes lost and taken again {losses}"
    );
    if let Some(last) = last {
        println!("one that does not follow: {last}");
    }
    for (n, event) in told {
        println!("cycle {n}: {event}");
    }
    tell("wake-up late", &mut figures.late);
    tell("round trip", &mut figures.trips);
    println!(
        "answers after the cycle {}, cycles left out {}, frames lost {lost}, working counter misses {}",
        figures.missed,
        figures.skipped,
        misses(&master) - before
    );
    Ok(())
}

/// A turn of 1000 increments to each side in two seconds.
fn sine(cycles: u64, period: Duration) -> i32 {
    let seconds = u32::try_from(cycles).map_or(0.0, f64::from) * period.as_secs_f64();
    #[expect(clippy::cast_possible_truncation, reason = "at most 1000")]
    let increments = (1000.0 * (std::f64::consts::PI * seconds).sin()) as i32;
    increments
}

fn tell(name: &str, times: &mut [Duration]) {
    times.sort_unstable();
    let at = |share: usize| {
        let place = times.len().saturating_sub(1) * share / 10_000;
        times
            .get(place)
            .map_or(0.0, |time| time.as_secs_f64() * 1e6)
    };
    println!(
        "{name:13} p50 {:7.1} us  p99 {:7.1} us  p99.99 {:7.1} us  max {:7.1} us",
        at(5000),
        at(9900),
        at(9999),
        at(10_000)
    );
}

/// How late cyclictest wakes up, which inherits processor and priority; nothing where there is none.
fn cyclictest(period: Duration, seconds: u64) {
    let arguments = format!(
        "--mlockall --quiet --histogram=20000 --policy=fifo --priority={PRIORITY} --interval={} --duration={}s",
        period.as_micros(),
        seconds.max(1)
    );
    let run = Command::new("cyclictest")
        .args(arguments.split(' '))
        .output();
    let Some(output) = run.ok().filter(|output| output.status.success()) else {
        println!("cyclictest    not run: install rt-tests, and be allowed to use SCHED_FIFO");
        return;
    };
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let mut late = Vec::new();
    for line in text.lines() {
        let mut words = line.split_whitespace().map(str::parse::<u64>);
        if let (Some(Ok(us)), Some(Ok(count))) = (words.next(), words.next()) {
            let count = usize::try_from(count).unwrap_or(0);
            late.extend(std::iter::repeat_n(Duration::from_micros(us), count));
        }
    }
    // What the histogram does not hold is in this line.
    let most = text
        .lines()
        .find_map(|line| line.strip_prefix("# Max Latencies:"));
    let most = most.and_then(|text| text.trim().parse().ok());
    late.extend(most.map(Duration::from_micros));
    tell("cyclictest", &mut late);
}

fn ip(arguments: &str) -> io::Result<()> {
    let done = Command::new("ip").args(arguments.split(' ')).output()?;
    if done.status.success() {
        return Ok(());
    }
    Err(io::Error::other(
        String::from_utf8_lossy(&done.stderr).trim().to_owned(),
    ))
}

fn main() -> Result<(), Box<dyn Error>> {
    let number = |at: usize, usual: u64| {
        let text = std::env::args().nth(at);
        text.map_or(Ok(usual), |text| text.parse())
    };
    let axes = u8::try_from(number(1, 16)?)?;
    let period = Duration::from_micros(number(2, 1000)?);
    let (seconds, cpu) = (number(3, 60)?, number(4, 0)?);
    let (segment, config) = stand(axes, period)?;
    let _left_behind = ip(&format!("link del {}", ENDS[0]));
    ip(&format!(
        "link add {} type veth peer name {}",
        ENDS[0], ENDS[1]
    ))?;
    for end in ENDS {
        ip(&format!("link set {end} up"))?;
    }
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = stop.clone();
    let mut server = Server::new(SharedSegment::new(segment), PacketLink::open(ENDS[1])?);
    let served = thread::spawn(move || {
        let mut set = CpuSet::new();
        // Where there is no such processor it stays where it is.
        let _placed = set
            .set(usize::try_from(cpu).unwrap_or(0))
            .and_then(|()| sched_setaffinity(Pid::from_raw(0), &set));
        let turn = Duration::from_millis(20);
        while !stopped.load(Ordering::Relaxed) && server.turn(turn, &mut monotonic).is_ok() {}
    });
    cyclictest(period, seconds / 2);
    let done = run(axes, config, seconds);
    cyclictest(period, seconds / 2);
    stop.store(true, Ordering::Relaxed);
    let _ended = served.join();
    ip(&format!("link del {}", ENDS[0]))?;
    done
}

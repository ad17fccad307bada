//! A cycle kept over minutes on a veth pair: how late it woke up, how many of its answers arrived after the next cycle
//! started, how many working counters were unexpected. Axes of two drives follow a slow sine meanwhile, and the
//! emulated segment answers on the other end. It sets no priority: run it with `chrt` and `taskset`.
//!
//! The influence of the host is separated: on either processor a bare thread wakes up once per cycle, in its middle,
//! and does nothing else. For late cycles the example counts how often one of these threads was late at that time too;
//! for working counters, at that time or within 50 cycles before, as slaves are reconfigured after several consecutive
//! lost frames. Where there is cyclictest, it runs before and after on the same processor with the same period, half of
//! the time each. As takt and cyclictest do, this keeps processors out of deep sleep; with `sleepy` it does not, to
//! show the effect.
//!
//! ```console
//! # cargo build --release -p takt-ethercat --example segment_cycle
//! # unshare --net taskset -c 1 chrt -f 80 target/release/examples/segment_cycle AXES CYCLE_US SECONDS [SEGMENT_CPU] [sleepy]
//! ```
#![expect(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "an example: it prints, and the segment's end of the cable is a thread of its own"
)]

mod host;

use std::error::Error;
use std::io;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use host::awake;
use nix::sched::{CpuSet, sched_getcpu, sched_setaffinity};
use nix::sys::mman::{MlockAllFlags, mlockall};
use nix::time::{ClockId, ClockNanosleepFlags, clock_nanosleep};
use nix::unistd::Pid;
use takt_cia402::emulator::DriveConfig;
use takt_cia402::{Goal, MasterOptions};
use takt_ethercat::axis::{self, Axis, AxisState, Target};
use takt_ethercat::config::{Location, MasterConfig, SlaveSpec};
use takt_ethercat::emulator::{Coupler, Segment, Server, ServoConfig, ServoDrive, SharedSegment};
use takt_ethercat::link::Port;
use takt_ethercat::linux::{PacketLink, monotonic};
use takt_ethercat::master::{Event, Master};

const ENDS: [&str; 2] = ["tkcy-master", "tkcy-slaves"];

/// Priority of cyclictest, as this is to be run.
const PRIORITY: u8 = 80;
/// Cycles between two fault reset requests of an axis.
const ASK_EACH: u64 = 100;
/// Events that are printed.
const EVENTS: usize = 32;
/// Cycles after a stall within which lost slaves return to OP.
const AFTERMATH: u32 = 50;

/// A coupler and drives of up to eight axes each, and the master's configuration.
fn fixture(axes: u8, cycle: Duration) -> Result<(Segment, MasterConfig), Box<dyn Error>> {
    let mut slaves = vec![Coupler::slave()];
    let mut specs = vec![SlaveSpec::new("coupler", Location::Position(0))];
    let mut left = axes;
    while left > 0 {
        let count = left.min(8);
        left -= count;
        let mut axis = DriveConfig::default();
        // Stalls of the host are counted, not penalised.
        axis.quirks.missing_set_points = None;
        let (slave, _) = ServoDrive::slave(ServoConfig::with_axes(vec![axis; count.into()]))?;
        let (outputs, inputs) = axis::pdos(count);
        let index = Location::Position(u16::try_from(slaves.len())?);
        specs.push(SlaveSpec {
            outputs: Some(outputs),
            inputs: Some(inputs),
            watchdog: Some(Duration::from_secs(1)),
            ..SlaveSpec::new(format!("drive {}", slaves.len()), index)
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

/// Results of the cycles.
#[derive(Debug, Default)]
struct Figures {
    late: Vec<Duration>,
    trips: Vec<Duration>,
    /// Start times of cycles whose answers arrived after the next cycle was due.
    missed: Vec<Duration>,
    /// Due times of skipped cycles.
    skipped: Vec<Duration>,
    /// Times of unexpected working counters.
    miscounted: Vec<Duration>,
}

impl Figures {
    fn with_capacity(cycles: usize) -> Self {
        let room = || Vec::with_capacity(cycles + 16);
        Self {
            late: room(),
            trips: room(),
            missed: room(),
            skipped: room(),
            miscounted: room(),
        }
    }
}

/// A bare thread that wakes up in the middle of each cycle, and its recorded wake-ups.
struct Observer {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Vec<(Duration, Duration)>>,
}

impl Observer {
    /// On a processor, `first` and every period after; at most `cycles` are recorded.
    fn start(cpu: usize, first: Duration, period: Duration, cycles: usize) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let mut seen = Vec::with_capacity(cycles);
        let thread = thread::spawn(move || {
            stay_on(cpu);
            let mut due = first;
            while !stopped.load(Ordering::Relaxed) && seen.len() < cycles {
                wait(due);
                let Ok(now) = monotonic() else { break };
                seen.push((due, now));
                while due <= now {
                    due += period;
                }
            }
            seen
        });
        Self { stop, thread }
    }

    /// Each due time and actual wake-up time.
    fn end(self) -> Vec<(Duration, Duration)> {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap_or_default()
    }
}

/// Keeps the calling thread on a processor; if it exists.
fn stay_on(cpu: usize) {
    let mut set = CpuSet::new();
    let _placed = set
        .set(cpu)
        .and_then(|()| sched_setaffinity(Pid::from_raw(0), &set));
}

/// How many of these cycles, or of the time before them, coincide with a late bare thread.
fn shared(
    cycles: &[Duration],
    stalls: &[(Duration, Duration)],
    (before, period): (Duration, Duration),
) -> usize {
    let met = |cycle: &&Duration| {
        let (begin, end) = (cycle.saturating_sub(before), **cycle + period);
        stalls.iter().any(|(from, to)| *from < end && begin < *to)
    };
    cycles.iter().filter(met).count()
}

/// One cycle that is due at `due`.
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
            figures.missed.push(due);
            return Ok(());
        };
        if master.handle_frame(0, bytes, at) {
            figures.trips.push(monotonic()?.saturating_sub(begin));
            if at > end {
                figures.missed.push(due);
            }
            return Ok(());
        }
    }
}

fn wait(due: Duration) {
    let flags = ClockNanosleepFlags::TIMER_ABSTIME;
    // An early wake-up by a signal counts as not late.
    let _woken = clock_nanosleep(ClockId::CLOCK_MONOTONIC, flags, &due.into());
}

/// An axis, and the position and cycle at which it started to follow.
type Follower = (Axis, Option<(i32, u64)>);

fn followers(master: &Master, axes: u8) -> Result<Vec<Follower>, Box<dyn Error>> {
    let mut all = Vec::new();
    for number in 0..axes {
        let slave = usize::from(number / 8) + 1;
        let process = master.slave(slave).ok_or("a drive is gone")?.process();
        let mut axis = Axis::new(slave, process, number % 8, MasterOptions::default())?;
        axis.set_goal(Goal::OperationEnabled);
        all.push((axis, None));
    }
    Ok(all)
}

/// One cycle of all axes; returns how many follow, how many stopped following, and one that does not.
fn lead(
    all: &mut [Follower],
    master: &mut Master,
    n: u64,
    due: Duration,
) -> (usize, u64, Option<AxisState>) {
    let period = master.config().cycle;
    let (mut following, mut losses, mut last) = (0, 0, None);
    while let Some(reply) = master.poll_reply() {
        // No other requests are pending here.
        let mut axes = all.iter_mut();
        axes.try_fold(reply, |reply, (axis, _)| {
            axis.handle_reply(reply, due).err()
        });
    }
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
        // A returning axis does not move by itself, and a drive whose slave left OP is in fault: here both are
        // restarted automatically.
        if n.is_multiple_of(ASK_EACH) {
            axis.set_goal(Goal::OperationEnabled);
            axis.reset_fault();
        }
    }
    (following, losses, last)
}

/// A master on its way, and its recorded wake-ups.
struct Run {
    master: Master,
    port: Port<PacketLink>,
    frame: [u8; 1500],
    all: Vec<Follower>,
    figures: Figures,
    events: Vec<(u64, Event)>,
    /// How many follow, and one that does not.
    following: usize,
    last: Option<AxisState>,
    losses: u64,
}

impl Run {
    /// With all axes commanded to follow.
    fn start(axes: u8, config: MasterConfig, cycles: usize) -> Result<Self, Box<dyn Error>> {
        let link = PacketLink::open(ENDS[0])?;
        let mac = link.mac();
        let (mut port, mut frame) = (Port::new(link, mac), [0; 1500]);
        let mut master = Master::new(config)?;
        let mut unused = Figures::default();
        let mut due = monotonic()?;
        while !master.is_operational() {
            due = (due + master.config().cycle).max(monotonic()?);
            cycle(&mut master, &mut port, &mut frame, due, &mut unused)?;
            while master.poll_event().is_some() {}
        }
        let all = followers(&master, axes)?;
        Ok(Self {
            master,
            port,
            frame,
            all,
            figures: Figures::with_capacity(cycles),
            events: Vec::with_capacity(EVENTS),
            following: 0,
            last: None,
            losses: 0,
        })
    }

    fn misses(&self) -> u64 {
        self.master.groups().iter().map(|group| group.misses).sum()
    }

    fn cycles(&mut self, first: Duration, count: usize) -> io::Result<()> {
        let (mut due, period) = (first, self.master.config().cycle);
        for n in (0_u64..).take(count) {
            wait(due);
            let before = self.misses();
            let Self { master, port, .. } = self;
            cycle(master, port, &mut self.frame, due, &mut self.figures)?;
            if self.misses() > before {
                self.figures.miscounted.push(due);
            }
            while let Some(event) = self.master.poll_event() {
                if self.events.len() < EVENTS {
                    self.events.push((n, event));
                }
            }
            let (following, lost, not) = lead(&mut self.all, &mut self.master, n, due);
            (self.following, self.last) = (following, not);
            self.losses += lost;
            due += period;
            let now = monotonic()?;
            while due < now {
                self.figures.skipped.push(due);
                due += period;
            }
        }
        Ok(())
    }
}

/// Command line options.
struct Options {
    axes: u8,
    period: Duration,
    seconds: u64,
    /// Of the segment.
    cpu: usize,
}

fn run(options: &Options, config: MasterConfig) -> Result<(), Box<dyn Error>> {
    let period = options.period;
    let count = usize::try_from(u128::from(options.seconds) * 1_000_000_000 / period.as_nanos())?;
    let mut run = Run::start(options.axes, config, count)?;
    let frames = run.master.frames();
    let before = run.misses();
    let first = monotonic()? + 2 * period;
    let bare = |cpu| Observer::start(cpu, first + period / 2, period, 2 * count);
    let observers = [bare(sched_getcpu()?), bare(options.cpu)];
    let done = run.cycles(first, count);
    let seen = observers.map(Observer::end);
    done?;
    println!(
        "{} axes, {} following, {period:?}, {count} cycles, axes lost and taken again {}",
        options.axes, run.following, run.losses
    );
    if let Some(last) = run.last {
        println!("one that does not follow: {last}");
    }
    for (n, event) in &run.events {
        println!("cycle {n}: {event}");
    }
    report(&mut run.figures, &seen, period);
    println!(
        "frames lost {}, working counter misses {}",
        run.master.frames().lost - frames.lost,
        run.misses() - before
    );
    Ok(())
}

/// Times and counts, and how many coincide with a bare thread that was late by a quarter of a period.
fn report(figures: &mut Figures, seen: &[Vec<(Duration, Duration)>; 2], period: Duration) {
    print_times("wake-up late", &mut figures.late);
    for (seen, name) in seen.iter().zip(["bare there", "bare, segment"]) {
        let late = seen.iter().map(|(due, at)| at.saturating_sub(*due));
        print_times(name, &mut late.collect::<Vec<_>>());
    }
    print_times("round trip", &mut figures.trips);
    let late = |(due, at): &&(Duration, Duration)| at.saturating_sub(*due) >= period / 4;
    let stalls: Vec<_> = seen.iter().flatten().filter(late).copied().collect();
    let none = Duration::ZERO;
    for (label, cycles, before) in [
        ("answers after the cycle", &figures.missed, none),
        ("cycles left out", &figures.skipped, none),
        (
            "working counters missed",
            &figures.miscounted,
            AFTERMATH * period,
        ),
    ] {
        let host = shared(cycles, &stalls, (before, period));
        println!(
            "{label:23} {:6}, {host} of them with a bare thread late too",
            cycles.len()
        );
    }
}

/// A turn of 1000 increments to each side in two seconds.
fn sine(cycles: u64, period: Duration) -> i32 {
    let seconds = u32::try_from(cycles).map_or(0.0, f64::from) * period.as_secs_f64();
    #[expect(clippy::cast_possible_truncation, reason = "at most 1000")]
    let increments = (1000.0 * (std::f64::consts::PI * seconds).sin()) as i32;
    increments
}

fn print_times(name: &str, times: &mut [Duration]) {
    times.sort_unstable();
    let at = |quantile: usize| {
        let index = times.len().saturating_sub(1) * quantile / 10_000;
        times
            .get(index)
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

/// How late cyclictest wakes up, which inherits processor and priority; nothing if it is not installed.
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
    // Values beyond the histogram are in this line.
    let most = text
        .lines()
        .find_map(|line| line.strip_prefix("# Max Latencies:"));
    let most = most.and_then(|text| text.trim().parse().ok());
    late.extend(most.map(Duration::from_micros));
    print_times("cyclictest", &mut late);
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

/// Interfaces, and a segment that answers at one of them until `during` returns.
fn with_segment<T>(
    segment: Segment,
    cpu: usize,
    during: impl FnOnce() -> Result<T, Box<dyn Error>>,
) -> Result<T, Box<dyn Error>> {
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
        stay_on(cpu);
        let turn = Duration::from_millis(20);
        while !stopped.load(Ordering::Relaxed) && server.turn(turn, &mut monotonic).is_ok() {}
    });
    let done = during();
    stop.store(true, Ordering::Relaxed);
    let _ended = served.join();
    ip(&format!("link del {}", ENDS[0]))?;
    done
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let sleepy = arguments.pop_if(|last| last == "sleepy").is_some();
    let number = |at: usize, usual: u64| {
        let text = arguments.get(at);
        text.map_or(Ok(usual), |text| text.parse())
    };
    let options = Options {
        axes: u8::try_from(number(0, 16)?)?,
        period: Duration::from_micros(number(1, 1000)?),
        seconds: number(2, 60)?,
        cpu: usize::try_from(number(3, 0)?)?,
    };
    mlockall(MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE)?;
    let awake = if sleepy { Ok(None) } else { awake().map(Some) };
    if let Err(error) = &awake {
        println!("processors may sleep deeply: /dev/cpu_dma_latency: {error}");
    }
    let (segment, config) = fixture(options.axes, options.period)?;
    with_segment(segment, options.cpu, || {
        cyclictest(options.period, options.seconds / 2);
        let done = run(&options, config);
        cyclictest(options.period, options.seconds / 2);
        done
    })
}

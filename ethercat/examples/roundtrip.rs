//! How long a cycle takes on a veth pair, from getting the master's frame to handling its answer: ours, a bare loop
//! that sends the same frame by the same socket and waits for it, ethercrab, and SOEM by pysoem. Each master has a pair
//! and an emulated segment of its own, of the same slaves in OP; short slices of each alternate, so that load on the
//! host affects all. Segments answer on processor 0, masters run on processor 1; ethercrab's thread for its socket may
//! run on both. Processors are kept out of deep sleep, as takt does. Needs to be allowed to make interfaces and raw
//! sockets.
//!
//! ```console
//! # ethercat/tests/peers/install.sh
//! # cargo build --release -p takt-ethercat --example roundtrip
//! # TAKT_PYTHON=target/peers/bin/python chrt -f 60 target/release/examples/roundtrip [CYCLES] [SPIN_US]
//! ```
//!
//! With `SPIN_US` ours and the bare loop poll for this time before they sleep (`PacketLink::spinning`). SOEM's cycle is
//! timed in Python around two calls into it, which adds some microseconds.
#![expect(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "an example: it prints, and the segments' ends of the cables are threads of their own"
)]

#[path = "../tests/peers/crab.rs"]
mod crab;
mod host;

use std::error::Error;
use std::io::{self, BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use ethercrab::std::ethercat_now;
use ethercrab::subdevice_group::{NoDc, Op};
use ethercrab::{DefaultLock, MainDevice, MainDeviceConfig, SubDeviceGroup};
use host::awake;
use nix::sched::{CpuSet, sched_setaffinity};
use nix::unistd::Pid;
use takt_cia402::emulator::DriveConfig;
use takt_ethercat::config::MasterConfig;
use takt_ethercat::emulator::{
    Coupler, Io, Segment, Server, ServoConfig, ServoDrive, SharedSegment,
};
use takt_ethercat::link::Port;
use takt_ethercat::linux::{PacketLink, monotonic};
use takt_ethercat::master::Master;

const TIMEOUT: Duration = Duration::from_millis(20);
/// Cycles of a slice: all four slices end before a watchdog of 100 ms expires.
const SLICE: usize = 50;
const SLAVES: usize = 8;
const IMAGE: usize = 512;

type Anything<T> = Result<T, Box<dyn Error>>;

fn ip(arguments: &str) -> io::Result<()> {
    let done = Command::new("ip").args(arguments.split(' ')).output()?;
    if done.status.success() {
        return Ok(());
    }
    Err(io::Error::other(
        String::from_utf8_lossy(&done.stderr).trim().to_owned(),
    ))
}

/// A coupler, terminals, and a drive of six axes.
fn segment() -> Anything<Segment> {
    let axes = vec![DriveConfig::default(); 6];
    let (drive, _) = ServoDrive::slave(ServoConfig::with_axes(axes))?;
    Ok(Segment::line([
        Coupler::slave(),
        Io::digital(8, 8).0,
        Io::analogue(4, 4).0,
        drive,
    ]))
}

/// Keeps the calling thread on processors; if they exist.
fn stay_on(cpus: &[usize]) {
    let mut set = CpuSet::new();
    let all = cpus.iter().try_for_each(|cpu| set.set(*cpu));
    let _placed = all.and_then(|()| sched_setaffinity(Pid::from_raw(0), &set));
}

/// A segment that answers at the other end of a pair.
struct Served {
    near: String,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Served {
    fn start(name: &str) -> Anything<Self> {
        let (near, far) = (format!("tkrt-{name}"), format!("tkrt-{name}-s"));
        let _left_behind = ip(&format!("link del {near}"));
        ip(&format!("link add {near} type veth peer name {far}"))?;
        for end in [&near, &far] {
            ip(&format!("link set {end} up"))?;
        }
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let mut server = Server::new(SharedSegment::new(segment()?), PacketLink::open(&far)?);
        let thread = thread::spawn(move || {
            stay_on(&[0]);
            while !stopped.load(Ordering::Relaxed) && server.turn(TIMEOUT, &mut monotonic).is_ok() {
            }
        });
        Ok(Self { near, stop, thread })
    }

    fn end(self) -> io::Result<()> {
        self.stop.store(true, Ordering::Relaxed);
        let _ended = self.thread.join();
        ip(&format!("link del {}", self.near))
    }
}

/// Our master, and the socket that the bare loop shares.
struct Ours {
    master: Master,
    port: Port<PacketLink>,
    frame: [u8; 1500],
    len: usize,
}

impl Ours {
    fn start(interface: &str, spin: Duration) -> Anything<Self> {
        let link = PacketLink::open(interface)?.spinning(spin);
        let mac = link.mac();
        let mut ours = Self {
            master: Master::new(MasterConfig::default())?,
            port: Port::new(link, mac),
            frame: [0; 1500],
            len: 0,
        };
        while !ours.master.is_operational() {
            ours.cycle()?;
            while ours.master.poll_event().is_some() {}
        }
        Ok(ours)
    }

    /// One cycle of the master; its duration, if the answer was received.
    fn cycle(&mut self) -> io::Result<Option<Duration>> {
        let begin = monotonic()?;
        let Some(len) = self.master.poll_transmit(begin, &mut self.frame) else {
            return Ok(None);
        };
        self.len = len;
        self.port.send(self.frame.get(..len).unwrap_or_default())?;
        while let Some((bytes, at)) = self.port.receive(TIMEOUT)? {
            if self.master.handle_frame(0, bytes, at) {
                return Ok(Some(monotonic()?.saturating_sub(begin)));
            }
        }
        Ok(None)
    }

    /// Sends the frame of the last cycle and waits for it; its duration, if it returned.
    fn bare(&mut self) -> io::Result<Option<Duration>> {
        let begin = monotonic()?;
        self.port
            .send(self.frame.get(..self.len).unwrap_or_default())?;
        let back = self.port.receive(TIMEOUT)?.is_some();
        let took = monotonic()?.saturating_sub(begin);
        Ok(back.then_some(took))
    }
}

/// ethercrab.
struct Crab {
    main: &'static MainDevice<'static>,
    group: SubDeviceGroup<SLAVES, IMAGE, DefaultLock, Op, NoDc>,
}

impl Crab {
    fn start(interface: &str) -> Anything<Self> {
        let main = crab::start(interface, MainDeviceConfig::default())?;
        let group = crab::block_on(Self::bring_up(main)).map_err(|error| format!("{error:?}"))?;
        Ok(Self { main, group })
    }

    async fn bring_up(
        main: &'static MainDevice<'static>,
    ) -> Result<SubDeviceGroup<SLAVES, IMAGE, DefaultLock, Op, NoDc>, ethercrab::error::Error> {
        let group = main
            .init_single_group::<SLAVES, IMAGE>(ethercat_now)
            .await?;
        let group = group.into_safe_op(main).await?;
        let group = group.request_into_op(main).await?;
        while !group.tx_rx(main).await?.all_op() {}
        Ok(group)
    }

    fn slice(&self, times: &mut Vec<Duration>) -> Anything<()> {
        for _ in 0..SLICE {
            let begin = monotonic()?;
            let answer = crab::block_on(self.group.tx_rx(self.main));
            let took = monotonic()?.saturating_sub(begin);
            if answer.is_ok() {
                times.push(took);
            }
        }
        Ok(())
    }
}

/// SOEM in a separate Python process.
struct Soem {
    child: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
}

impl Soem {
    fn start(interface: &str) -> Anything<Self> {
        let python = std::env::var("TAKT_PYTHON").unwrap_or_else(|_| "python3".to_owned());
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/roundtrip_peer.py");
        let mut command = Command::new("taskset");
        command.args(["-c", "1", &python, script, interface]);
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn()?;
        let (to, from) = (child.stdin.take(), child.stdout.take());
        let (Some(to), Some(from)) = (to, from) else {
            return Err("no pipes".into());
        };
        let mut soem = Self {
            child,
            to,
            from: BufReader::new(from),
        };
        let mut line = String::new();
        soem.from.read_line(&mut line)?;
        if line.trim() != "ready" {
            return Err(format!("{python} with pysoem did not come to OP: {line}").into());
        }
        Ok(soem)
    }

    fn slice(&mut self, times: &mut Vec<Duration>) -> Anything<()> {
        writeln!(self.to, "{SLICE}")?;
        let mut line = String::new();
        self.from.read_line(&mut line)?;
        for ns in line.split_whitespace() {
            times.push(Duration::from_nanos(ns.parse()?));
        }
        Ok(())
    }

    fn end(self) -> io::Result<()> {
        let Self { mut child, to, .. } = self;
        drop(to);
        child.wait().map(|_| ())
    }
}

/// Durations of the cycles of one master.
#[derive(Default)]
struct Figures {
    name: &'static str,
    times: Vec<Duration>,
}

impl Figures {
    fn new(name: &'static str, cycles: usize) -> Self {
        let times = Vec::with_capacity(cycles + SLICE);
        Self { name, times }
    }

    fn at(&self, quantile: usize) -> f64 {
        let index = self.times.len() * quantile / 1000;
        let time = self.times.get(index).copied().unwrap_or_default();
        time.as_secs_f64() * 1e6
    }

    /// Sorts them and prints them, with their ratios to others.
    fn print_times(&mut self, bare: Option<(f64, f64)>) -> (f64, f64) {
        self.times.sort_unstable();
        let (half, most) = (self.at(500), self.at(990));
        let ratio = bare.map_or_else(String::new, |(p50, p99)| {
            format!(
                "  {:5.2} {:5.2} times the bare loop",
                half / p50,
                most / p99
            )
        });
        println!(
            "{:10} p50 {half:7.1} us  p99 {most:7.1} us  ({} frames){ratio}",
            self.name,
            self.times.len()
        );
        (half, most)
    }
}

fn measure(cycles: usize, spin: Duration, served: &[Served]) -> Anything<()> {
    let [ours, crab, soem] = served else {
        return Err("three segments are needed".into());
    };
    let crab = Crab::start(&crab.near)?;
    let soem = Soem::start(&soem.near);
    stay_on(&[1]);
    let mut ours = Ours::start(&ours.near, spin)?;
    let mut soem = soem
        .inspect_err(|why| println!("SOEM is left out: {why}"))
        .ok();
    let names = ["bare loop", "ours", "ethercrab", "SOEM"];
    let mut figures = names.map(|name| Figures::new(name, cycles));
    let [bare, own, other, third] = &mut figures;
    while own.times.len() < cycles {
        for _ in 0..SLICE {
            if let Some(time) = ours.cycle()? {
                own.times.push(time);
                bare.times.extend(ours.bare()?);
            }
        }
        crab.slice(&mut other.times)?;
        if let Some(soem) = &mut soem {
            soem.slice(&mut third.times)?;
        }
    }
    let reference = bare.print_times(None);
    own.print_times(Some(reference));
    other.print_times(Some(reference));
    if let Some(soem) = soem {
        third.print_times(Some(reference));
        soem.end()?;
    }
    println!("ours: {:?}", ours.master.frames());
    Ok(())
}

fn main() -> Anything<()> {
    let awake = awake();
    if let Err(error) = &awake {
        println!("processors may sleep deeply: /dev/cpu_dma_latency: {error}");
    }
    let cycles = std::env::args()
        .nth(1)
        .map_or(Ok(10_000), |text| text.parse())?;
    let spin = std::env::args().nth(2).map_or(Ok(0), |text| text.parse())?;
    let served = ["ours", "crab", "soem"].map(Served::start);
    let served = served.into_iter().collect::<Anything<Vec<_>>>()?;
    let measured = measure(cycles, Duration::from_micros(spin), &served);
    for served in served {
        served.end()?;
    }
    measured
}

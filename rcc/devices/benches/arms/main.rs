//! One, two, four and eight LWRs at 1 ms, moved by one net of one thread, each with a driver of its own and an emulated
//! KRC at the other end of the wire, on the other processors if there are any. Prints how many answers were in
//! time, and their latency. Judges no figure. `cargo bench -p takt-devices --bench arms [-- [--json]]`.
//!
//! Answers in time are counted twice: in all cycles, and in those in which the host did not stall. A virtual machine loses
//! its processors now and then, and nothing on it answers meanwhile; a bare thread above all others on each processor
//! (`host`) measures that. Answers missing from the first figure alone are due to the host, those missing from the second
//! are ours. Before that, the time from a datagram to its answer is measured for one driver and, on the same processor at
//! the same priority, for a minimal client (`baseline`): the latter is the kernel's share, the rest the driver's.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

mod baseline;
mod host;

use std::fmt::Write;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use takt_core::controller::LoadRequest;
use takt_core::device::DeviceStatus;
use takt_core::device::driver::DriverConfig;
use takt_core::{CellConfig, Controller, SessionId};
use takt_devices::fri::LwrConfig;
use takt_devices::fri::lwr::Lwr;
use takt_fri::linux::{UdpLink, monotonic};
use takt_fri::lwr::emulator::{Krc, KrcConfig, KrcStatus, Timing, serve};
use takt_rt::Nanos;
use takt_rt::thread::{Thread, ThreadConfig, spawn};

use baseline::Baseline;
use host::Counts;

const COUNTS: [usize; 4] = [1, 2, 4, 8];
const PERIOD: Duration = Duration::from_millis(1);
/// Duration of the measurement.
const LOOK: Duration = Duration::from_secs(10);
/// Timeout until they follow commands.
const TIMEOUT: Duration = Duration::from_secs(60);

fn main() {
    let mut all = json!({ "answer": answer() });
    for count in COUNTS {
        let result = run(count);
        let value = |key: &str| result[key].as_f64().unwrap_or(f64::NAN);
        println!(
            "{count} arms: {:.5} of answers in time (the worst arm), {:.5} where the host did not stall (it did in \
             {:.1} % of the time, for {:.1} ms at most), {:.5} answered at all, answer time p50 {:.1} us, p99 {:.1} us, {} falls",
            value("in_time"),
            value("in_time_steady"),
            value("left_out") * 100.0,
            value("longest_stall_ms"),
            value("answered"),
            value("answer_us_p50"),
            value("answer_us_p99"),
            result["falls"],
        );
        all[format!("arms_{count}")] = result;
    }
    if std::env::args().any(|argument| argument == "--json") {
        println!("{all}");
    }
}

/// Answer times of a driver and of the minimal client, measured side by side.
fn answer() -> Value {
    let [ours, theirs] = processors();
    let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
    let link = UdpLink::bind(anywhere).expect("loopback is there");
    let target = link.local_addr().expect("it is bound");
    let controller = start(1, &ours);
    let client = Baseline::start(link, LwrConfig::new("", anywhere).priority, ours);
    let targets = controller
        .with_drivers(Lwr::address)
        .into_iter()
        .chain([target]);
    let robots: Vec<_> = targets
        .map(|target| Robot::start(target, theirs.clone()))
        .collect();
    wait_for(&controller);
    std::thread::sleep(LOOK);
    drop(robots);
    let times = controller.with_drivers(|driver: &Lwr| driver.answer_time.read());
    let [driver, least] = [&times[0], &client.answer_time.read()]
        .map(|it| [0.5, 0.99].map(|part| us(it.quantile(part))));
    let ratio = (driver[0] / least[0] * 100.0).round() / 100.0;
    println!(
        "answer time: the driver p50 {:.1} us, p99 {:.1} us, beside a client that copies p50 {:.1} us, p99 {:.1} us: \
         {ratio:.2} of its",
        driver[0], driver[1], least[0], least[1]
    );
    json!({ "driver_us": driver, "copy_us": least, "ratio_p50": ratio })
}

#[expect(clippy::cast_precision_loss, reason = "times of a cycle")]
fn us(time: Nanos) -> f64 {
    (time.0 as f64 / 100.0).round() / 10.0
}

/// Processors for the controller, and for the emulators.
fn processors() -> [Vec<usize>; 2] {
    let count = std::thread::available_parallelism().map_or(1, usize::from);
    if count < 2 {
        return [Vec::new(), Vec::new()];
    }
    let half = count / 2;
    [(0..half).collect(), (half..count).collect()]
}

/// An emulated KRC in a thread of its own.
struct Robot {
    status: Arc<KrcStatus>,
    stop: Arc<AtomicBool>,
    thread: Option<Thread<()>>,
}

impl Robot {
    fn start(target: SocketAddr, cpus: Vec<usize>) -> Self {
        let (status, stop) = (Arc::new(KrcStatus::new()), Arc::new(AtomicBool::new(false)));
        let (shared, stopping) = (Arc::clone(&status), Arc::clone(&stop));
        let config = ThreadConfig {
            priority: Some(88),
            cpus,
            ..ThreadConfig::new("krc")
        };
        let thread = spawn(config, move || {
            let local = SocketAddr::from(([127, 0, 0, 1], 0));
            let mut link = UdpLink::connect(local, target).expect("loopback is there");
            // Tolerates more misses than a real one: a lost session would hide the latencies.
            let timing = Timing {
                misses_max: 1000,
                bad_from: 0.0,
                ..Timing::default()
            };
            let config = KrcConfig {
                period: PERIOD,
                joints: [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0],
                timing,
                ..KrcConfig::default()
            };
            let start = monotonic().expect("there is a clock");
            let mut krc = Box::new(Krc::new(config, start));
            serve(&mut *krc, &mut link, &shared, &stopping).expect("loopback works");
        });
        Self {
            status,
            stop,
            thread: Some(thread.expect("the system has a thread to give")),
        }
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().expect("no cycle panics");
        }
    }
}

/// Moves joint 6 of each arm to and fro endlessly.
fn net(count: usize) -> String {
    let mut text = String::from(
        "{true=Core::BooleanValue(Value='true'),past=Core::BooleanPre(inValue=true.outValue),
        first=Core::BooleanIsNull(inValue=past.outValue),clock=Core::Clock(),
        sine=Core::DoubleSin(inValue=clock.outValue),
        way=Core::DoubleMultiply(inFirst=sine.outValue,Second='0.3'),cancel=Cancel(),outTerminate=cancel.outCancel",
    );
    for arm in 0..count {
        let _infallible = write!(
            text,
            ",m{arm}=RobotArm::JointMonitor(Robot='arm{arm}',Axis='6'),
            s{arm}=Core::DoubleSnapshot(inSnapshot=first.outValue,inValue=m{arm}.outCommandedPosition),
            to{arm}=Core::DoubleAdd(inFirst=s{arm}.outValue,inSecond=way.outValue),
            j{arm}=RobotArm::JointPosition(inPosition=to{arm}.outValue,Robot='arm{arm}',Axis='6')"
        );
    }
    text.push('}');
    text
}

fn start(count: usize, cpus: &[usize]) -> Controller {
    let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
    let arm = |arm: usize| -> Arc<dyn DriverConfig> {
        Arc::new(LwrConfig {
            cpus: cpus.to_vec(),
            ..LwrConfig::new(format!("arm{arm}"), anywhere)
        })
    };
    let mut config = CellConfig {
        devices: (0..count).map(arm).collect(),
        ..CellConfig::default()
    };
    config.controller.period = PERIOD;
    config.controller.cpus = cpus.to_vec();
    Controller::start(&config).expect("the system has threads and sockets to give")
}

fn wait_for(controller: &Controller) {
    let until = Instant::now() + TIMEOUT;
    let follows = |c: &Controller| {
        let devices = c.devices();
        devices
            .iter()
            .all(|d| d.status == DeviceStatus::Operational)
    };
    while !follows(controller) {
        assert!(Instant::now() < until, "the arms never followed commands");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// One run with `count` arms.
fn run(count: usize) -> Value {
    let [ours, theirs] = processors();
    let controller = start(count, &ours);
    let addresses = controller.with_drivers(Lwr::address);
    let robots: Vec<_> = addresses
        .into_iter()
        .map(|address| Robot::start(address, theirs.clone()))
        .collect();
    wait_for(&controller);
    let request = LoadRequest {
        text: net(count),
        session: SessionId::NONE,
        description: String::new(),
        period: None,
    };
    let id = controller.load(request).expect("there is room");
    controller.start_net(id).expect("the arms follow commands");
    std::thread::sleep(Duration::from_secs(1));
    let statuses: Vec<_> = robots
        .iter()
        .map(|robot| Arc::clone(&robot.status))
        .collect();
    let watched = host::watch(&statuses, LOOK);
    let worst = |share: &dyn Fn(&[Counts; 2]) -> f64| {
        let shares = watched.robots.iter().map(share);
        (shares.fold(1.0, f64::min) * 1e5).round() / 1e5
    };
    let in_time = |counts: &Counts| 1.0 - ratio(counts.missed, counts.sent);
    let stalls: u64 = watched.robots.iter().map(|[all, _]| all.stalls).sum();
    let falls: u64 = robots.iter().map(|robot| robot.status.exits()).sum();
    let times = controller.with_drivers(|driver: &Lwr| driver.answer_time.read());
    let slowest = |quantile: f64| {
        us(times
            .iter()
            .map(|it| it.quantile(quantile))
            .max()
            .unwrap_or(Nanos(0)))
    };
    json!({
        "in_time": worst(&|[all, _]| in_time(all)),
        "in_time_steady": worst(&|[_, steady]| in_time(steady)),
        "answered": worst(&|[all, _]| ratio(all.answers, all.sent)),
        "left_out": watched.left_out, "longest_stall_ms": watched.longest_stall.as_secs_f64() * 1e3,
        "answer_us_p50": slowest(0.5), "answer_us_p99": slowest(0.99), "stalls": stalls, "falls": falls,
    })
}

#[expect(clippy::cast_precision_loss, reason = "few cycles")]
fn ratio(part: u64, whole: u64) -> f64 {
    part as f64 / whole.max(1) as f64
}

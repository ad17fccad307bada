//! An emulated LWR, moved by a net: the controller, its driver and the emulated KRC exchange real
//! datagrams on loopback, in real time. No hardware and no rights are needed; it measures nothing.
#![expect(clippy::print_stdout, reason = "an example talks to its reader")]

use std::error::Error;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use takt_core::controller::{LoadRequest, NetState};
use takt_core::device::DeviceStatus;
use takt_core::{CellConfig, Controller, SessionId};
use takt_devices::fri::LwrConfig;
use takt_devices::fri::lwr::Lwr;
use takt_fri::linux::{UdpLink, monotonic};
use takt_fri::lwr::emulator::{Krc, KrcConfig, KrcStatus, Timing, serve};

/// Moves the third joint by half a radian within two seconds, from where it is.
const NET: &str = "{
    true=Core::BooleanValue(Value='true'), past=Core::BooleanPre(inValue=true.outValue),
    first=Core::BooleanIsNull(inValue=past.outValue),
    monitor=RobotArm::JointMonitor(Robot='left', Axis='2'),
    start=Core::DoubleSnapshot(inSnapshot=first.outValue, inValue=monitor.outCommandedPosition),
    clock=Core::Clock(), part=Core::Interval(inValue=clock.outValue, Max='2'),
    smooth=Core::DoubleBezier(inValue=part.outValue, To='0.5'),
    target=Core::DoubleAdd(inFirst=start.outValue, inSecond=smooth.outValue),
    joint=RobotArm::JointPosition(inPosition=target.outValue, Robot='left', Axis='2'),
    done=Core::DoubleGreater(inFirst=clock.outValue, Second='2'), outTerminate=done.outValue}";

/// The emulated KRC, until `stop`.
fn emulate(controller: SocketAddr, stop: &AtomicBool) -> std::io::Result<()> {
    let mut link = UdpLink::connect(SocketAddr::from(([127, 0, 0, 1], 0)), controller)?;
    // Tolerates stalls of the host.
    let timing = Timing {
        misses_max: 100,
        ..Timing::default()
    };
    let mut krc = Krc::new(
        KrcConfig {
            timing,
            ..KrcConfig::default()
        },
        monotonic()?,
    );
    serve(&mut krc, &mut link, &KrcStatus::new(), stop)
}

fn main() -> Result<(), Box<dyn Error>> {
    let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
    let controller = Controller::start(&CellConfig {
        devices: vec![Arc::new(LwrConfig::new("left", anywhere))],
        ..CellConfig::default()
    })?;
    let address = controller.with_drivers(Lwr::address)[0];
    let stop = Arc::new(AtomicBool::new(false));
    let stopping = Arc::clone(&stop);
    let robot = std::thread::spawn(move || emulate(address, &stopping));
    let outcome = run(&controller);
    stop.store(true, Ordering::Relaxed);
    robot.join().map_err(|_| "the emulated robot panicked")??;
    outcome
}

fn run(controller: &Controller) -> Result<(), Box<dyn Error>> {
    let mut status = None;
    let until = Instant::now() + Duration::from_secs(20);
    while status != Some(DeviceStatus::Operational) {
        let now = controller.devices()[0].status;
        if status.replace(now) != Some(now) {
            println!("left is {now}");
        }
        if Instant::now() > until {
            return Err("the robot did not come into command mode".into());
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let (text, description) = (NET.to_owned(), "moves a joint".to_owned());
    let request = LoadRequest {
        text,
        session: SessionId::NONE,
        description,
        period: None,
    };
    let net = controller.load(request)?;
    controller.start_net(net)?;
    loop {
        let info = controller
            .net(net)
            .ok_or("the net was unloaded by another client")?;
        if let Some(arm) = controller.arm_state("left") {
            let degrees = arm
                .joints
                .iter()
                .take(7)
                .filter_map(|joint| joint.measured_position);
            let degrees: Vec<_> = degrees.map(|q| format!("{:7.2}", q.to_degrees())).collect();
            println!("{net} {}  {} deg", info.state(), degrees.join(" "));
        }
        if info.state() == NetState::Terminated {
            println!("{}", info.end.as_deref().unwrap_or("it ended by itself"));
            println!("net thread: {}", controller.stats());
            return Ok(());
        }
        std::thread::sleep(Duration::from_millis(200));
    }
}

//! Drives that leave the profile, on both buses: with its quirk in the cell an arm is operational; without it the fault
//! names the quirk.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use takt_can::bus::{Bus, Config};
use takt_can::canopen::NodeId;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::cia402::Quirk;
use takt_can::cia402::emulator::Quirks;
use takt_can::link::Link as _;
use takt_can::linux::LivePort;
use takt_core::CellConfig;
use takt_core::device::driver::{DeviceDriver, DeviceEnd, DriverEnds, Severity};
use takt_core::device::{DeviceCommand, DeviceState, DeviceStatus};
use takt_devices::canopen::{Canopen, CanopenConfig};
use takt_devices::ethercat::{Ethercat, EthercatConfig, Wire};
use takt_ethercat::emulator::{Segment, Server, ServoConfig, ServoDrive, SharedSegment};
use takt_rt::latest::{LatestReader, latest};
use takt_rt::servo::Estimate;
use takt_rt::thread::ThreadConfig;
use takt_tests::steady;

/// Far longer than enabling a drive or detecting a fault takes.
const TIMEOUT: Duration = Duration::from_secs(30);

/// A drive with this behaviour.
fn behaviour(quirk: Quirk) -> Quirks {
    let mut quirks = Quirks {
        // A host without PREEMPT_RT misses set-points now and then.
        missing_set_points: None,
        ..Quirks::default()
    };
    match quirk {
        Quirk::NoFollowBit => quirks.no_follow_bit = true,
        Quirk::SodAs0020 => quirks.sod_as_0020 = true,
        Quirk::ModeAfterEnable => quirks.mode_after_enable = true,
    }
    quirks
}

fn cell(bus: &str, drive: &str, quirks: &str) -> CellConfig {
    let text = format!(
        "[[{bus}]]\nname = 'bus'\ninterface = 'none'\n{drive}\nincrements_per_turn = 65536\n\
         range = [-90, 90]\nvelocity_max = 10\nacceleration_max = 10\nquirks = [{quirks}]\n"
    );
    takt_devices::parse_cell(&text).unwrap()
}

/// One device, and the state of it as nets read it.
fn ends() -> (DriverEnds, LatestReader<DeviceState>) {
    let (state, reported) = latest(1, DeviceState::default);
    let (_, command) = latest(1, DeviceCommand::default);
    let end = DeviceEnd {
        state,
        command,
        net_period: Duration::from_millis(4),
    };
    let ends = DriverEnds {
        devices: vec![end],
        clock: latest(1, Estimate::default).0,
    };
    (ends, reported)
}

/// Drives the bus until the arm is operational, or an error names the quirk: whether it is operational.
fn is_operational(
    driver: Box<dyn DeviceDriver>,
    mut state: LatestReader<DeviceState>,
    quirk: Quirk,
    mut turn: impl FnMut() + Send + 'static,
) -> bool {
    // Above the driver's thread, as emulators run: a busy host loses none of its frames.
    let ends = Arc::new(AtomicBool::new(false));
    let end = Arc::clone(&ends);
    let config = ThreadConfig {
        priority: Some(88),
        ..ThreadConfig::new("emulator")
    };
    let emulator = takt_rt::thread::spawn(config, move || {
        while !end.load(Ordering::Relaxed) {
            turn();
        }
    });
    let until = Instant::now() + TIMEOUT;
    let mut events = Vec::new();
    let result = loop {
        assert!(Instant::now() < until, "{quirk:?}: {events:#?}");
        std::thread::park_timeout(Duration::from_millis(2));
        let mut status = DeviceStatus::Offline;
        state.read_with(|state| status = state.status);
        if status == DeviceStatus::Operational {
            break true;
        }
        events.extend(driver.poll_event());
        if let Some(last) = events.last()
            && last.text.contains(quirk.name())
        {
            assert_eq!(last.severity, Severity::Error, "{last:?}");
            break false;
        }
    };
    // Its devices are there until it has ended.
    driver.stop();
    ends.store(true, Ordering::Relaxed);
    emulator.unwrap().join().unwrap();
    result
}

/// Each behaviour with its quirk and without. A host that stalls repeats one of them, not all.
fn each(operational: impl Fn(Quirk, &str) -> bool) {
    for quirk in Quirk::ALL {
        let named = format!("'{}'", quirk.name());
        steady(|| assert!(operational(quirk, &named), "{quirk:?}"));
        steady(|| assert!(!operational(quirk, ""), "{quirk:?}"));
    }
}

#[test]
fn ethercat_drive_needs_its_quirk_in_the_cell() {
    let drive = "[[ethercat.slave]]\nname = 'drive'\nposition = 0\naxes = 1\nsync0 = true\n\
        [[ethercat.arm]]\nname = 'arm'\n[[ethercat.arm.joint]]\nslave = 'drive'";
    each(|quirk, quirks| {
        let config = cell("ethercat", drive, quirks);
        let config = config.of_kind::<EthercatConfig>().next().unwrap();
        let mut servo = ServoConfig::default();
        servo.axes[0].quirks = behaviour(quirk);
        let (slave, _drive) = ServoDrive::slave(servo).unwrap();
        let (near, far) = takt_ethercat::linux::cable();
        let segment = SharedSegment::new(Segment::line([slave]));
        let mut server = Server::new(segment, far);
        let wire = Wire {
            link: Box::new(near),
            source: [2, 0, 0, 0, 0, 1],
        };
        let (ends, state) = ends();
        let driver = Ethercat::start(config, wire, ends).unwrap();
        is_operational(Box::new(driver), state, quirk, move || {
            let wait = Duration::from_micros(300);
            server
                .turn(wait, &mut takt_ethercat::linux::monotonic)
                .unwrap();
        })
    });
}

#[test]
fn canopen_drive_needs_its_quirk_in_the_cell() {
    let drive = "cycle = '4ms'\n[[canopen.arm]]\nname = 'arm'\n[[canopen.arm.joint]]\nnode = 1";
    each(|quirk, quirks| {
        let config = cell("canopen", drive, quirks);
        let config = config.of_kind::<CanopenConfig>().next().unwrap();
        let mut node = DriveNodeConfig::new(NodeId::new(1).unwrap());
        node.axes[0].quirks = behaviour(quirk);
        let now = takt_can::linux::monotonic;
        let mut drive = DriveNode::power_on(node, now()).unwrap();
        let ours = LivePort::first_of(Bus::new(Config::default()));
        let mut port = ours.attach();
        let (ends, state) = ends();
        let driver = Canopen::start(config, Box::new(ours), ends).unwrap();
        is_operational(Box::new(driver), state, quirk, move || {
            let received = port.receive(Duration::from_micros(300)).unwrap();
            if let Some(frame) = received.as_ref().and_then(|it| it.frame.classic()) {
                drive.handle_frame(frame, now());
            }
            while let Some(frame) = drive.poll_transmit(now()) {
                // Frames beyond the queue are lost, as on a bus.
                let _ = port.send(&frame.into());
            }
        })
    });
}

#[test]
fn quirk_unknown_is_rejected_with_location_and_names() {
    let text = "[[canopen]]\nname = 'bus'\ninterface = 'can0'\n[[canopen.arm]]\nname = 'arm'\n\
        [[canopen.arm.joint]]\nnode = 1\nincrements_per_turn = 1\nrange = [0, 1]\nvelocity_max = 1\n\
        acceleration_max = 1\nquirks = ['no_folow_bit']\n";
    let error = takt_devices::parse_cell(text).unwrap_err().to_string();
    assert!(error.contains("line 12"), "{error}");
    assert!(
        error.contains("there is no quirk `no_folow_bit`"),
        "{error}"
    );
    for quirk in Quirk::ALL {
        assert!(error.contains(quirk.name()), "{error}");
    }
}

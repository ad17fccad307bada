//! The controller with an emulated Sunrise cabinet on the real wire, in every dialect: nets that move its
//! iiwa, and what happens when the cabinet or its power is lost. Timing is not checked.

#![expect(clippy::float_cmp, reason = "what rests does so to the bit")]
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use common::{Cell, swing};
use takt_core::cell::CellConfig;
use takt_core::controller::Controller;
use takt_core::device::DeviceStatus;
use takt_devices::fri::iiwa::Iiwa;
use takt_devices::fri::{IiwaConfig, IiwaModel};
use takt_fri::sunrise::emulator::{
    Cabinet, CabinetConfig, CabinetStatus, Control, Limits, Overlay, Program, Robot, Timing, serve,
};
use takt_fri::sunrise::wire::{CommandMode, Dialect, Quality, SessionState};
use takt_rt::thread::{Thread, ThreadConfig, spawn};

/// An emulated cabinet in a thread of its own.
struct Sunrise {
    status: Arc<CabinetStatus>,
    stop: Arc<AtomicBool>,
    thread: Option<Thread<()>>,
}

impl Sunrise {
    fn start(target: SocketAddr, config: CabinetConfig) -> Self {
        let status = Arc::new(CabinetStatus::new());
        let stop = Arc::new(AtomicBool::new(false));
        let (shared, stopping) = (Arc::clone(&status), Arc::clone(&stop));
        let config_of_thread = ThreadConfig {
            priority: Some(88),
            ..ThreadConfig::new("cabinet")
        };
        let thread = spawn(config_of_thread, move || {
            let local = SocketAddr::from(([127, 0, 0, 1], 0));
            let mut link = takt_fri::linux::UdpLink::connect(local, target).unwrap();
            let mut cabinet = Cabinet::new(config, takt_fri::linux::monotonic().unwrap());
            serve(&mut cabinet, &mut link, &shared, &stopping).unwrap();
        });
        Self {
            status,
            stop,
            thread: Some(thread.unwrap()),
        }
    }

    fn kill(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

impl Drop for Sunrise {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A cabinet with longer timeouts than a real one, as a host without `PREEMPT_RT` may stall for tens of
/// milliseconds.
fn patient(dialect: Dialect) -> CabinetConfig {
    CabinetConfig {
        dialect,
        robot: Robot::Iiwa7,
        limits: Limits::of(Robot::Iiwa7),
        timing: Timing {
            misses_max: 100,
            bad_from: 0.0,
            ..Timing::default()
        },
        faults: takt_fri::sunrise::emulator::Faults {
            quality: Some(Quality::Excellent),
            ..Default::default()
        },
        ..CabinetConfig::default()
    }
}

/// A controller with an iiwa 7 called `arm`.
fn cell() -> (Cell, SocketAddr) {
    takt_tests::simulate_time(1.0);
    let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
    let arm = IiwaConfig {
        model: IiwaModel::Iiwa7,
        ..IiwaConfig::new("arm", anywhere)
    };
    let config = CellConfig {
        devices: vec![Arc::new(arm)],
        ..CellConfig::default()
    };
    let controller = Controller::start(&config).unwrap();
    let address = controller.with_drivers(Iiwa::address)[0];
    let robots = Vec::new();
    (Cell { controller, robots }, address)
}

fn wait_for(cell: &Cell, status: DeviceStatus) {
    cell.wait(&status.to_string(), |c| c.devices()[0].status == status);
}

/// A net moves the arm by half a radian, as the cabinet measures.
fn move_it(config: CabinetConfig) {
    let (cell, address) = cell();
    let cabinet = Sunrise::start(address, config.clone());
    wait_for(&cell, DeviceStatus::Operational);
    let before = cabinet.status.measured()[6];
    let net = cell.load(&swing("arm", 1.0));
    cell.controller.start_net(net).unwrap();
    let end = cell.wait_for_end(net).end;
    let fall = cabinet.status.last_exit().map(|why| why.to_string());
    assert_eq!(end, None, "{fall:?}");
    cell.wait("the arm at its goal", |_| {
        (cabinet.status.measured()[6] - before - 0.5).abs() < 1e-3
    });
    let figures = cell.controller.with_drivers(Iiwa::figures)[0];
    assert_eq!(figures.malformed, 0);
    assert_eq!(figures.quality, Quality::Excellent);
    assert_eq!(figures.period, Some(Duration::from_millis(2)));
    assert!(figures.datagrams > 500, "{figures:?}");
}

#[test]
fn iiwa_net_moves_arm_in_every_dialect() {
    for dialect in [Dialect::V1, Dialect::V2, Dialect::V3] {
        move_it(patient(dialect));
    }
}

#[test]
fn iiwa_net_moves_arm_in_torque_overlay() {
    let overlay = Overlay {
        control: Control::JointImpedance {
            stiffness: [2000.0; 7],
            damping: [0.7; 7],
        },
        command: CommandMode::Torque,
    };
    let restart = Some(Duration::from_millis(100));
    move_it(CabinetConfig {
        program: Program::Auto { overlay, restart },
        ..patient(Dialect::V2)
    });
}

#[test]
fn iiwa_answers_only_when_cabinet_requests() {
    move_it(CabinetConfig {
        receive_multiplier: 3,
        ..patient(Dialect::V1)
    });
}

#[test]
fn iiwa_pose_overlay_is_not_operational() {
    let (cell, address) = cell();
    let overlay = Overlay {
        control: Control::Position,
        command: CommandMode::CartesianPose,
    };
    let restart = Some(Duration::from_millis(100));
    let cabinet = Sunrise::start(
        address,
        CabinetConfig {
            program: Program::Auto { overlay, restart },
            ..patient(Dialect::V2)
        },
    );
    cell.wait("the overlay active", |_| {
        cabinet.status.state() == SessionState::CommandingActive
    });
    let net = cell.load(&swing("arm", 1.0));
    let error = cell.controller.start_net(net).unwrap_err().to_string();
    assert!(error.contains("arm, which is safe-operational"), "{error}");
}

#[test]
fn iiwa_lost_cabinet_ends_net_accepts_new_dialect() {
    let (cell, address) = cell();
    let mut cabinet = Sunrise::start(address, patient(Dialect::V1));
    wait_for(&cell, DeviceStatus::Operational);
    let net = cell.load(&swing("arm", 20.0));
    cell.controller.start_net(net).unwrap();
    cabinet.kill();
    let ended = cell.wait_for_end(net).end.unwrap();
    assert!(ended.contains("arm stopped following commands"), "{ended}");
    wait_for(&cell, DeviceStatus::Offline);
    let _newer = Sunrise::start(address, patient(Dialect::V3));
    wait_for(&cell, DeviceStatus::Operational);
}

#[test]
fn iiwa_power_loss_ends_net_recovers_at_rest() {
    let (cell, address) = cell();
    let cabinet = Sunrise::start(address, patient(Dialect::V2));
    wait_for(&cell, DeviceStatus::Operational);
    let net = cell.load(&swing("arm", 20.0));
    cell.controller.start_net(net).unwrap();
    cabinet.status.set_power(false);
    let ended = cell.wait_for_end(net).end.unwrap();
    assert!(ended.contains("stopped following"), "{ended}");
    cabinet.status.set_power(true);
    wait_for(&cell, DeviceStatus::Operational);
    let (rested, sent) = (cabinet.status.commanded(), cabinet.status.sent());
    cell.wait("a hundred cycles", |_| cabinet.status.sent() > sent + 100);
    assert_eq!(cabinet.status.commanded(), rested);
}

#[test]
fn iiwa_torques_reported_while_online() {
    let (cell, address) = cell();
    let mut cabinet = Sunrise::start(address, patient(Dialect::V1));
    let net = cell.load(
        "{all=KUKA::LWR::TMonitor(Robot='arm',Axis='1'),
        e=Core::DoubleIsNull(inValue=all.outEst),m=Core::DoubleIsNull(inValue=all.outMsr),
        we=Core::BooleanNetcommOut(inValue=e.outValue,Key='e'),
        wm=Core::BooleanNetcommOut(inValue=m.outValue,Key='m'),
        cancel=Cancel(),outTerminate=cancel.outCancel}",
    );
    cell.controller.start_net(net).unwrap();
    let all = |cell: &Cell, null: &str| {
        let values = cell.controller.out_values(net);
        values.len() == 2 && values.iter().all(|(_, text)| text == null)
    };
    cell.wait("all known", |_| all(&cell, "false"));
    cabinet.kill();
    cell.wait("all unknown", |_| all(&cell, "true"));
}

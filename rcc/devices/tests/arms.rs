//! The controller with emulated arms on the real wire: nets that move them, and what happens when
//! a robot, a net or the wire fails. Timing is not checked.

#![expect(clippy::float_cmp, reason = "what rests does so to the bit")]

mod common;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use common::{Cell, Robot, swing};
use takt_core::cell::{ControllerConfig, NetThreadSettings};
use takt_core::controller::{ClockInfo, NetState, RuleRequest};
use takt_core::device::DeviceStatus;
use takt_core::{CellConfig, Controller};
use takt_devices::fri::LwrConfig;
use takt_rt::servo::State;
use takt_tests::{pass, simulate_time};

#[test]
fn lwr_net_moves_arm_and_ends() {
    simulate_time(1.0);
    let cell = Cell::new(&["left"]);
    let before = cell.robots[0].status.measured()[6];
    let net = cell.load(&swing("left", 1.0));
    cell.controller.start_net(net).unwrap();
    let info = cell.wait_for_end(net);
    assert_eq!(
        info.end,
        None,
        "{:?}",
        cell.robots[0].status.last_exit().map(|f| f.to_string())
    );
    assert_eq!(
        info.states,
        [
            NetState::Loading,
            NetState::Ready,
            NetState::Running,
            NetState::Terminated
        ]
    );
    cell.wait("the arm at its goal", |_| {
        (cell.robots[0].status.measured()[6] - before - 0.5).abs() < 1e-3
    });
    assert_eq!(
        cell.controller.out_values(net),
        [("outerror".to_owned(), "0".to_owned())]
    );
}

#[test]
fn lwr_lost_robot_ends_only_its_net() {
    simulate_time(1.0);
    let mut cell = Cell::new(&["left", "right"]);
    let (left, right) = (
        cell.load(&swing("left", 3.0)),
        cell.load(&swing("right", 3.0)),
    );
    cell.controller.start_net(left).unwrap();
    cell.controller.start_net(right).unwrap();
    cell.robots[0].kill();
    let ended = cell.wait_for_end(left).end.unwrap();
    assert!(ended.contains("left stopped following commands"), "{ended}");
    assert_eq!(cell.wait_for_end(right).end, None);
}

/// How a slow net is ended.
#[derive(Clone, Copy, Debug)]
enum Ending {
    Abort,
    Rule,
}

#[test]
fn slow_net_ends_lwr_brakes_at_once() {
    simulate_time(1.0);
    for ending in [Ending::Abort, Ending::Rule] {
        let cell = Cell::new(&["left"]);
        let before = cell.position("left", 6);
        // At most 0.04 rad/s, with a set-point each second.
        let net = cell.load_every(&swing("left", 20.0), Duration::from_secs(1));
        cell.controller.start_net(net).unwrap();
        cell.wait("the arm in motion", |_| {
            (cell.position("left", 6) - before).abs() > 0.03 || cell.is_over(net)
        });
        match ending {
            Ending::Abort => cell.controller.abort(net).unwrap(),
            Ending::Rule => {
                let request = RuleRequest {
                    condition: "t".to_owned(),
                    stop: vec![net],
                    ..RuleRequest::default()
                };
                cell.controller.schedule(request).unwrap();
            }
        }
        let _ended = cell.wait_for_end(net);
        let ended = cell.position("left", 6);
        let rest = cell.at_rest("left", 6);
        assert!((rest - ended).abs() < 0.01, "{ending:?}: {ended} to {rest}");
    }
}

#[test]
fn lwr_power_loss_ends_net_recovers_at_rest() {
    simulate_time(1.0);
    let cell = Cell::new(&["left"]);
    let net = cell.load(&swing("left", 3.0));
    cell.controller.start_net(net).unwrap();
    cell.robots[0].status.set_power(false);
    assert!(
        cell.wait_for_end(net)
            .end
            .unwrap()
            .contains("stopped following")
    );
    cell.robots[0].status.set_power(true);
    cell.wait("the arm operational again", |c| {
        c.devices()[0].status == DeviceStatus::Operational
    });
    let rested = cell.robots[0].status.commanded();
    pass(Duration::from_millis(100));
    assert_eq!(cell.robots[0].status.commanded(), rested);
}

#[test]
fn lwr_controller_shutdown_in_motion_leaves_arm_resting() {
    simulate_time(1.0);
    let cell = Cell::new(&["left"]);
    let before = cell.position("left", 6);
    let net = cell.load(&swing("left", 2.0));
    cell.controller.start_net(net).unwrap();
    cell.wait("the arm in motion", |_| {
        (cell.position("left", 6) - before).abs() > 0.1 || cell.is_over(net)
    });
    assert!(!cell.is_over(net), "it was lost before");
    let Cell { controller, robots } = cell;
    drop(controller);
    let status = &robots[0].status;
    // The controller of a robot without answers continues at the last speed, for 100 cycles here.
    let (rested, sent) = (status.commanded(), status.sent());
    let until = Instant::now() + Duration::from_secs(30);
    while status.sent() < sent + 50 {
        assert!(Instant::now() < until, "the robot sends no more");
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(status.commanded(), rested);
}

#[test]
fn arm_joint_belongs_to_one_running_net() {
    simulate_time(1.0);
    let cell = Cell::new(&["left"]);
    let (first, second) = (
        cell.load(&swing("left", 2.0)),
        cell.load(&swing("left", 2.0)),
    );
    cell.controller.start_net(first).unwrap();
    let error = cell.controller.start_net(second).unwrap_err().to_string();
    assert!(
        error.contains(&format!("left_Joint_6, which net {first} of session ")),
        "{error}"
    );
    cell.controller.cancel(first).unwrap();
    cell.wait_for_end(first);
    cell.controller.start_net(second).unwrap();
    cell.controller.abort(second).unwrap();
    assert_eq!(cell.wait_for_end(second).end.as_deref(), Some("aborted"));
}

#[test]
fn arm_not_ready_cannot_be_commanded() {
    let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
    let config = CellConfig {
        controller: ControllerConfig::default(),
        devices: vec![Arc::new(LwrConfig::new("left", anywhere))],
        ..CellConfig::default()
    };
    let cell = Cell {
        controller: Controller::start(&config).unwrap(),
        robots: Vec::new(),
    };
    let net = cell.load(&swing("left", 1.0));
    let error = cell.controller.start_net(net).unwrap_err().to_string();
    assert!(error.contains("commands left, which is offline"), "{error}");
}

#[test]
fn net_threads_follow_robot_clock_and_its_successor() {
    let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
    let mut config = CellConfig {
        devices: vec![Arc::new(LwrConfig::new("left", anywhere))],
        ..CellConfig::default()
    };
    config.controller.follow = Some("left".to_owned());
    config.controller.phase = Some(Duration::from_micros(300));
    config.controller.threads = vec![NetThreadSettings {
        phase: Some(Duration::from_millis(2)),
        ..NetThreadSettings::new(Duration::from_millis(4))
    }];
    let mut cell = Cell::of(&config, None);
    let phases = |cell: &Cell| -> Vec<_> {
        let threads = cell.controller.threads().into_iter();
        threads.map(|t| t.stats.phase_error.count).collect()
    };
    let follow = |cell: &Cell| {
        cell.wait("the clock to be followed", |c| {
            let is_followed = |clock: &ClockInfo| clock.state.is_followed();
            let threads = c.threads();
            threads
                .iter()
                .all(|t| t.clock.as_ref().is_some_and(is_followed))
        });
        let before = phases(cell);
        cell.wait("phases to be published", |_| {
            phases(cell)
                .iter()
                .zip(&before)
                .all(|(now, before)| now > before)
        });
    };
    follow(&cell);
    let clocks = cell
        .controller
        .threads()
        .into_iter()
        .map(|t| t.clock.unwrap());
    let reported: Vec<_> = clocks.map(|clock| (clock.device, clock.phase)).collect();
    let [short, long] = [300, 2_000].map(Duration::from_micros);
    assert_eq!(
        reported,
        [("left".to_owned(), short), ("left".to_owned(), long)]
    );
    // Its driver is removed and added again, as on a reload of the cell file.
    cell.robots.clear();
    cell.wait("the arm at rest", Controller::is_at_rest);
    cell.controller.remove_cell_device("left").unwrap();
    let lost = cell.controller.threads()[0].clone().clock.unwrap();
    assert_eq!((lost.state, lost.ppb), (State::Unlocked, None));
    cell.controller
        .add_cell_device(&*config.devices[0])
        .unwrap();
    let address = cell
        .controller
        .with_drivers(takt_devices::fri::lwr::Lwr::address)[0];
    cell.robots.push(Robot::start(address));
    follow(&cell);
}

#[test]
fn lwr_torques_and_forces_reported_while_online() {
    let mut cell = Cell::new(&["left"]);
    let watched = |kind: &str, key: &str, port: &str| {
        format!(
            "n_{key}=Core::DoubleIsNull(inValue={kind}.{port}),
            w_{key}=Core::BooleanNetcommOut(inValue=n_{key}.outValue,Key='{key}')"
        )
    };
    let text = format!(
        "{{all=KUKA::LWR::FTMonitor(Robot='left'),{},{},{},
        cancel=Cancel(),outTerminate=cancel.outCancel}}",
        watched("all", "estimated", "outEstJ7"),
        watched("all", "measured", "outMsrJ1"),
        watched("all", "force", "outTcpTz"),
    );
    let net = cell.load(&text);
    cell.controller.start_net(net).unwrap();
    let all = |cell: &Cell, null: &str| {
        let values = cell.controller.out_values(net);
        values.len() == 3 && values.iter().all(|(_, text)| text == null)
    };
    cell.wait("all known", |_| all(&cell, "false"));
    cell.robots[0].kill();
    cell.wait("all unknown", |_| all(&cell, "true"));
}

//! Shutdown of controllers: nothing starts any more, and the shutdown waits for bases as it does for arms.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use takt_core::controller::{LoadRequest, NetState, RuleRequest};
use takt_core::device::driver::{DeviceDriver, DriverThread};
use takt_core::device::{DeviceDescription, DeviceState, DeviceStatus, Part, parts};
use takt_core::{CellConfig, Controller, NetId, SessionId};
use takt_net::Twist;
use takt_net::device::Layout;

use common::Cell;

/// Runs until it is cancelled.
const PATIENT: &str = "{cancel=Cancel(), outTerminate=cancel.outCancel}";

const BASE: Part = Part::Base {
    wheels: 0,
    velocity_max: 1.0,
    rotation_max: 1.0,
    acceleration_max: 1.6,
    rotation_acceleration_max: 1.6,
};

fn cell() -> Cell {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    let robots = Vec::new();
    Cell { controller, robots }
}

fn start_after(start: NetId, ended: NetId) -> RuleRequest {
    RuleRequest {
        condition: format!("{ended}.terminated"),
        start: vec![start],
        ..RuleRequest::default()
    }
}

/// Cancels all nets and waits for their ends.
fn wind_down(cell: &Cell) {
    cell.wait("the end of all nets", |controller| {
        controller.wind_down(&controller.nets())
    });
}

#[test]
fn shutdown_waits_for_braking_base() {
    let cell = cell();
    // A second from full speed to rest.
    let parameters = [("max_vel", "0.5"), ("max_acc", "0.5")];
    let parameters: BTreeMap<_, _> = parameters.map(|(k, v)| (k.to_owned(), v.to_owned())).into();
    let (name, kind) = ("base", "kuka_youbot_base_sim");
    cell.controller.add_device(name, kind, &parameters).unwrap();
    assert!(cell.controller.is_at_rest());
    let net = cell.load(
        "{ v=World::TwistValue(Value='{vel:{x:0.5}}'),
           base=RobotBase::BaseVelocity(Robot='base',inVel=v.outValue),
           cancel=Cancel(), outTerminate=cancel.outCancel }",
    );
    cell.controller.start_net(net).unwrap();
    let speed = || {
        let base = parts::lay(&[BASE], 0, &mut Layout::default()).base.unwrap();
        let state = cell.controller.arm_state("base").unwrap();
        base.velocity.read(&state.signals).unwrap().vel.x
    };
    cell.wait("full speed", |_| speed() > 0.49);
    wind_down(&cell);
    cell.wait("the base at rest", Controller::is_at_rest);
    assert!(speed().abs() < 1e-3, "{} m/s", speed());
}

/// A driver of a base that moves until the test stops it.
#[derive(Debug)]
struct Rolling(DriverThread);

impl DeviceDriver for Rolling {
    fn thread(&self) -> &DriverThread {
        &self.0
    }

    fn into_thread(self: Box<Self>) -> DriverThread {
        self.0
    }

    fn figures(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }
}

/// Adds a base that rolls down a slope, whatever is commanded, while `rolls` is true.
fn add_rolling_base(cell: &Cell, rolls: &Arc<AtomicBool>) {
    let is_rolling = Arc::clone(rolls);
    let base = DeviceDescription {
        name: "base".to_owned(),
        kind: "test",
        limits: Vec::new(),
        model: "".into(),
        parts: vec![BASE],
    };
    let controller = &cell.controller;
    let added = controller.add_driver("base", vec![base], None, |ends| {
        let (mut end, clock) = ends.only("base")?;
        let thread = DriverThread::start("base", None, &[], move |stopping| {
            let mut layout = Layout::default();
            let base = parts::lay(&[BASE], 0, &mut layout).base.unwrap();
            let mut state = DeviceState::new(layout.signals);
            state.status = DeviceStatus::Operational;
            while !stopping.load(Ordering::Relaxed) {
                let mut velocity = Twist::default();
                let rolls = is_rolling.load(Ordering::Relaxed);
                velocity.vel.x = if rolls { 0.1 } else { 0.0 };
                base.velocity.report(&mut state.signals, Some(velocity));
                end.state.write_with(|slot| slot.copy_from(&state));
                std::thread::sleep(Duration::from_millis(1));
            }
            clock
        });
        Ok(Box::new(Rolling(thread?)))
    });
    added.unwrap();
    cell.wait("the base in motion", |controller| !controller.is_at_rest());
}

#[test]
fn moving_base_cannot_be_removed() {
    let cell = cell();
    let rolls = Arc::new(AtomicBool::new(true));
    add_rolling_base(&cell, &rolls);
    let refused = cell.controller.remove_cell_device("base").unwrap_err();
    assert!(refused.to_string().contains("it still moves"), "{refused}");
    rolls.store(false, Ordering::Relaxed);
    cell.wait("the base at rest", Controller::is_at_rest);
    cell.controller.remove_cell_device("base").unwrap();
}

#[test]
fn shutdown_reports_device_that_never_rests() {
    let cell = cell();
    add_rolling_base(&cell, &Arc::new(AtomicBool::new(true)));
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("closing.log");
    let file = Mutex::new(File::create(&path).unwrap());
    let log = tracing_subscriber::fmt().with_ansi(false);
    let log = log.with_writer(file).finish();
    tracing::subscriber::with_default(log, || drop(cell));
    let log = std::fs::read_to_string(&path).unwrap();
    let of_base = log.lines().find(|line| line.contains("still moves"));
    let of_base = of_base.unwrap_or_else(|| panic!("{log}"));
    assert!(
        of_base.contains("WARN") && of_base.contains("device=\"base\""),
        "{of_base}"
    );
}

#[test]
fn shutdown_rejects_new_nets_and_rules() {
    let cell = cell();
    let [ready, runs] = [PATIENT; 2].map(|net| cell.load(net));
    cell.controller.start_net(runs).unwrap();
    cell.controller.close();
    let request = LoadRequest {
        text: PATIENT.to_owned(),
        session: SessionId::NONE,
        description: String::new(),
        period: None,
    };
    let refused = [
        cell.controller.load(request).map(drop),
        cell.controller.start_net(ready),
        cell.controller.schedule(start_after(ready, runs)).map(drop),
    ];
    for refused in refused {
        let text = refused.unwrap_err().to_string();
        assert_eq!(text, "the controller is stopping");
    }
    let state = |net| cell.controller.net(net).unwrap().state();
    assert_eq!(state(runs), NetState::Running, "what runs goes on");
    wind_down(&cell);
    assert_eq!(cell.controller.net(runs).unwrap().end, None);
    let end = cell.controller.net(ready).unwrap().end;
    assert_eq!(end.as_deref(), Some("aborted before it ran"));
}

#[test]
fn shutdown_starts_no_successors() {
    let cell = cell();
    let [first, second] = [PATIENT; 2].map(|net| cell.load(net));
    let rule = cell
        .controller
        .schedule(start_after(second, first))
        .unwrap();
    cell.controller.start_net(first).unwrap();
    wind_down(&cell);
    assert_eq!(cell.controller.net(first).unwrap().end, None);
    let second = cell.controller.net(second).unwrap();
    assert!(!second.states.contains(&NetState::Running), "{second:?}");
    let rule = cell.controller.rule(rule).unwrap();
    assert_ne!(rule.state, takt_core::controller::RuleState::Fired);
}

//! The scope over a running controller: its samples are those of a recording of the same run, sampled without an allocation in
//! real time.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use takt_core::controller::{LoadRequest, MachineRequest};
use takt_core::probe::{Scope, ScopeEvent, ScopeRequest};
use takt_core::record::{Recorder, numbers};
use takt_core::{CellConfig, Controller, NetId, SessionId};
use takt_rt::alloc::{CountingAllocator, real_time_allocations};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Longest time that a test waits.
const LONG: Duration = Duration::from_secs(20);

fn add_arm(controller: &Controller) {
    let list = |value: f64| format!("{:?}", [value; 7]);
    let limits = [
        ("min_joint", -2.0),
        ("max_joint", 2.0),
        ("max_vel", 2.0),
        ("max_acc", 8.0),
    ];
    let limits: BTreeMap<_, _> = limits.map(|(key, v)| (key.to_owned(), list(v))).into();
    controller
        .add_device("left", "kuka_lwr_sim", &limits)
        .unwrap();
}

/// Loads a net that moves joint 0 at 0.1 rad/s.
fn load(controller: &Controller) -> NetId {
    let text = "{t=Core::Clock(), p=Core::Lerp(inAmount=t.outValue, From='0', To='0.1'),
        j=RobotArm::JointPosition(inPosition=p.outValue, Robot='left', Axis='0'),
        c=Cancel(), outTerminate=c.outCancel}";
    let net = controller.load(LoadRequest {
        text: text.to_owned(),
        session: SessionId::NONE,
        description: "swing".to_owned(),
        period: None,
    });
    net.unwrap()
}

/// The samples of all probes of one group until there are so many.
fn samples(scope: &mut Scope, wanted: usize) -> Vec<(f64, Vec<f64>)> {
    let (begin, mut found) = (Instant::now(), Vec::new());
    while found.len() < wanted {
        assert!(begin.elapsed() < LONG, "{} samples", found.len());
        std::thread::sleep(Duration::from_millis(5));
        scope.read(begin.elapsed());
        while let Some(event) = scope.poll_event() {
            let ScopeEvent::Frame(frame) = event else {
                continue;
            };
            assert_eq!((frame.group, frame.lost), (0, 0));
            found.extend(frame.iter().map(|(time, row)| (time, row.to_vec())));
        }
    }
    found
}

#[test]
fn scope_shows_samples_of_recording_without_allocations() {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("scope.mcap");
    let recording = Recorder::start(&path).unwrap();
    let controller = Controller::start_recording(&CellConfig::default(), Some(recording)).unwrap();
    add_arm(&controller);
    let net = load(&controller);
    controller.start_net(net).unwrap();
    let of_net = |port: &str| format!("net:{net}/{port}");
    let probes = [
        "left.joint.0.set_point".to_owned(),
        "left.joint.0.measured".to_owned(),
        "left.joint.0.following_error".to_owned(),
        of_net("p.outValue"),
        of_net("t.outValue"),
    ];
    let names: Vec<_> = probes.iter().map(String::as_str).collect();
    let mut scope = controller.scope(&ScopeRequest::of(&names)).unwrap();
    assert!(scope.rejected().is_empty(), "{:?}", scope.rejected());
    // What is loaded and freed meanwhile allocates elsewhere.
    let before = real_time_allocations();
    let found = samples(&mut scope, 1_000);
    assert_eq!(real_time_allocations() - before, 0);
    drop(scope);
    controller.abort(net).unwrap();
    controller.finish_recording().unwrap();
    // The nets' own clock counts whole periods, and what it gives is commanded in the same cycle.
    let row = |values: &[f64]| <[f64; 5]>::try_from(values).unwrap();
    let mut moved = 0;
    for (_, values) in &found {
        let [set_point, measured, error, path, clock] = row(values);
        if clock.is_nan() || path.is_nan() {
            continue;
        }
        moved += 1;
        assert!((path - 0.1 * clock).abs() < 1e-12, "{path} {clock}");
        assert!((set_point - path).abs() < 1e-12, "{set_point} {path}");
        if !error.is_nan() && !measured.is_nan() {
            assert!(error.abs() < 0.01, "{error}");
        }
    }
    assert!(moved > 900, "{moved}");
    // Sample by sample what the recording holds of these cycles.
    let mut recorded = Vec::new();
    numbers(&path, |_, all| {
        let measured = all.iter().find(|(name, _)| name == "left.joint.0.measured");
        recorded.extend(measured.map(|(_, value)| value.to_bits()));
        Ok(())
    })
    .unwrap();
    let shown: Vec<_> = found.iter().map(|(_, values)| row(values)[1]).collect();
    let shown: Vec<_> = shown
        .iter()
        .filter(|it| !it.is_nan())
        .map(|it| it.to_bits())
        .collect();
    assert!(shown.len() > 900);
    let mut windows = recorded.windows(shown.len());
    assert!(
        windows.any(|window| window == shown),
        "{} of {} recorded",
        shown.len(),
        recorded.len()
    );
}

#[test]
fn scope_of_several_cycles_takes_every_nth() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    add_arm(&controller);
    let request = ScopeRequest {
        every: 10,
        ..ScopeRequest::of(&["left.status", "left.joint.3.measured"])
    };
    let mut scope = controller.scope(&request).unwrap();
    let found = samples(&mut scope, 50);
    let steps = found.windows(2).map(|pair| pair[1].0 - pair[0].0);
    let steps: Vec<_> = steps.map(|step| (step * 1e3).round()).collect();
    let is_tenth = |step: &f64| *step >= 10.0 && *step % 10.0 == 0.0;
    assert!(steps.iter().all(is_tenth), "{steps:?}");
}

#[test]
fn scope_of_port_with_several_numbers_has_each() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    let text = "{f=World::FrameValue(Value='{pos:{x:1,y:2,z:3}}'),
        c=Cancel(), outTerminate=c.outCancel}";
    let net = controller.load(LoadRequest {
        text: text.to_owned(),
        session: SessionId::NONE,
        description: String::new(),
        period: None,
    });
    let net = net.unwrap();
    controller.start_net(net).unwrap();
    let port = format!("net:{net}/f.outValue");
    let mut scope = controller.scope(&ScopeRequest::of(&[&port])).unwrap();
    assert!(scope.rejected().is_empty(), "{:?}", scope.rejected());
    let names: Vec<_> = scope.groups()[0]
        .probes
        .iter()
        .map(|it| it.0.clone())
        .collect();
    assert_eq!(
        names[..3],
        [".x", ".y", ".z"].map(|part| format!("{port}{part}"))
    );
    let found = samples(&mut scope, 10);
    assert_eq!(found[9].1[..3], [1.0, 2.0, 3.0]);
}

#[test]
fn scope_shows_states_of_machines_inside() {
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    let controller = Controller::start(&cell).unwrap();
    let text = "machine Outer {
          initial state Idle { entry { activate Inner; start Inner; } transition if false to Done; }
          final state Done { }
          machine Inner {
            initial state Low { entry { wait 20ms; } transition to High; }
            state High { entry { wait 20ms; } transition if false to End; transition to Low; }
            final state End { }
          }
        }";
    let request = MachineRequest {
        text: text.to_owned(),
        ..MachineRequest::default()
    };
    let machine = controller.load_machine(&request).unwrap();
    let probes = ["machine:Outer.state", "machine:Outer.Inner.state"];
    let listed = controller.probes("machine:").probes;
    let names: Vec<_> = listed.iter().map(|probe| probe.name.as_str()).collect();
    assert_eq!(names, probes);
    assert_eq!(listed[1].states[..], ["Low", "High", "End"]);
    let mut scope = controller.scope(&ScopeRequest::of(&probes)).unwrap();
    assert!(scope.rejected().is_empty(), "{:?}", scope.rejected());
    let before = samples(&mut scope, 5);
    assert!(before.iter().all(|(_, row)| row[1].is_nan()), "inactive");
    controller.start_machine(&machine).unwrap();
    let rows = samples(&mut scope, 300);
    for state in [0.0, 1.0] {
        let is_there = |row: &[f64]| row[0].abs() < 1e-9 && (row[1] - state).abs() < 1e-9;
        assert!(rows.iter().any(|(_, row)| is_there(row)), "{state}");
    }
}

//! Arms from URDF files, end to end: cells with them, programs that move them, recordings that replay without the file.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

mod robotics;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use robotics::Bench;
use takt_api::{Arm, ErrorKind, Outcome, Pose};
use takt_core::record::{Recorder, replay};
use takt_core::{CellConfig, Controller};
use takt_devices::ethercat::{Ethercat, EthercatConfig, Wire, Wires, describe};
use takt_devices::read_cell;
use takt_ethercat::emulator::{Coupler, Segment, Server, ServoConfig, ServoDrive, SharedSegment};
use takt_ethercat::linux::{cable, monotonic};
use takt_motion::urdf::read_arm;
use takt_net::device::Kinematics;
use takt_rt::thread::{Thread, ThreadConfig, spawn};
use takt_tests::steady;

/// Files of the examples.
const CELLS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/cells");
/// A pose of the six axes in which a line has room, rad.
const UR_BENT: [f64; 6] = [0.3, -1.4, 1.5, -1.7, -1.5, 0.2];
/// A pose of the seven axes, rad.
const PANDA_BENT: [f64; 7] = [0.2, -0.6, 0.1, -2.1, 0.1, 1.6, 0.6];

/// A folder of its own with the URDFs and a cell file.
fn folder(name: &str, cell: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    for file in ["ur5e.urdf", "panda.urdf"] {
        std::fs::copy(Path::new(CELLS).join(file), folder.join(file)).unwrap();
    }
    std::fs::write(folder.join("cell.toml"), cell).unwrap();
    folder
}

fn example(name: &str) -> (PathBuf, CellConfig) {
    let text = std::fs::read_to_string(Path::new(CELLS).join("urdf.toml")).unwrap();
    let folder = folder(name, &text);
    let mut cell = read_cell(&folder.join("cell.toml")).unwrap();
    cell.controller.priority = None;
    // Numeric inverses without optimization take longer than a millisecond.
    cell.controller.period = Duration::from_millis(8);
    (folder, cell)
}

fn recorder(folder: &Path) -> (PathBuf, Option<(Recorder, takt_core::record::Tap)>) {
    let path = folder.join("recording.mcap");
    let recorder = Recorder::start(&path).unwrap();
    (path, Some(recorder))
}

/// Moves an arm by its joints, then on a line, and compares where it is with the chain of its file.
fn moves(arm: &Arm, file: &Path, bent: &[f64]) {
    assert_eq!(
        arm.ptp(bent.to_vec()).speed(0.3).run(),
        Ok(Outcome::Completed)
    );
    let of_file = read_arm(file, None, None).unwrap();
    let wanted = of_file.serial.forward(bent).translation.vector;
    let far = |pose: &Pose, wanted: [f64; 3]| {
        let pairs = pose.position().into_iter().zip(wanted);
        pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    };
    let at = arm.pose().unwrap();
    assert!(far(&at, wanted.into()) < 1e-3, "{at:?} is not {wanted}");
    let goal = [wanted.x, wanted.y + 0.08, wanted.z - 0.05];
    let line = arm.lin(Pose::quaternion(goal, at.orientation())).speed(0.3);
    let plan = line.plan().unwrap();
    let middle = plan.pose(plan.duration() / 2).unwrap();
    let half = [wanted.x, wanted.y + 0.04, wanted.z - 0.025];
    assert!(far(&middle, half) < 1e-3, "{middle:?} is not {half:?}");
    assert_eq!(line.run(), Ok(Outcome::Completed));
    let at = arm.pose().unwrap();
    assert!(far(&at, goal) < 1e-3, "{at:?} is not {goal:?}");
    // Beyond its reach, before anything is loaded.
    let error = arm.ptp_to(Pose::xyz(2.0, 0.0, 0.0)).run().unwrap_err();
    let is_refused = matches!(error.kind, ErrorKind::Unreachable { .. });
    assert!(is_refused, "{error}");
}

fn replays_without(folder: &Path, path: &Path) {
    for file in ["ur5e.urdf", "panda.urdf", "cell.toml"] {
        std::fs::remove_file(folder.join(file)).unwrap();
    }
    let outcome = replay(path).unwrap();
    assert_eq!(outcome.differs, None);
    assert!(outcome.cycles > 300, "{}", outcome.cycles);
}

#[test]
fn urdf_arms_move_and_replay_without_file() {
    steady(|| {
        let (folder, cell) = example("urdf-simulated");
        let (path, recording) = recorder(&folder);
        let controller = Controller::start_recording(&cell, recording).unwrap();
        let bench = Bench::serving(controller);
        let program = bench.cell();
        let [left, right] = ["left", "right"].map(|name| program.arm(name).unwrap());
        assert_eq!(left.description().model, "urdf:ur5e");
        assert_eq!(right.description().model, "urdf:panda");
        let limits = &left.description().joints;
        assert!((limits[2].position_max - std::f64::consts::PI).abs() < 1e-12);
        assert!((limits[2].velocity - std::f64::consts::PI).abs() < 1e-12);
        let slow = right.description().joints[4].velocity;
        assert!((slow.to_degrees() - 90.0).abs() < 1e-9, "{slow}");
        moves(&left, &folder.join("ur5e.urdf"), &UR_BENT);
        moves(&right, &folder.join("panda.urdf"), &PANDA_BENT);
        bench.controller.finish_recording().unwrap();
        drop((program, bench));
        replays_without(&folder, &path);
    });
}

/// An arm of six drives on a segment, with nothing but increments in its table.
const DRIVES: &str = r#"
[[ethercat]]
name = "segment"
interface = "none"
cycle = "2ms"
slave = [{ name = "coupler", position = 0 }, { name = "drives", position = 1, axes = 6, sync0 = true }]

[[ethercat.arm]]
name = "ur"
model = "urdf:ur5e.urdf"
joint = [
  { slave = "drives", axis = 0, increments_per_turn = 204800 },
  { slave = "drives", axis = 1, increments_per_turn = 204800, range = [-200, 20] },
  { slave = "drives", axis = 2, increments_per_turn = 204800 },
  { slave = "drives", axis = 3, increments_per_turn = 204800 },
  { slave = "drives", axis = 4, increments_per_turn = 204800, velocity_max = 120, acceleration_max = 600 },
  { slave = "drives", axis = 5, increments_per_turn = 204800 },
]
"#;

/// A segment that answers, until it is dropped.
struct Served {
    stop: Arc<AtomicBool>,
    thread: Option<Thread<()>>,
}

impl Served {
    fn start() -> (Self, Wires) {
        let mut servo = ServoConfig::tx90();
        for axis in &mut servo.axes {
            axis.quirks.missing_set_points = None;
        }
        let (slave, _) = ServoDrive::slave(servo).unwrap();
        let segment = SharedSegment::new(Segment::line([Coupler::slave(), slave]));
        let (near, far) = cable();
        let mut server = Server::new(segment, far);
        let stop = Arc::new(AtomicBool::new(false));
        let stopping = Arc::clone(&stop);
        let config = ThreadConfig {
            priority: Some(88),
            ..ThreadConfig::new("segment")
        };
        let thread = spawn(config, move || {
            while !stopping.load(Ordering::Relaxed) {
                let wait = Duration::from_millis(5);
                server.turn(wait, &mut monotonic).unwrap();
            }
        });
        let first = Wire {
            link: Box::new(near),
            source: [2, 0, 0, 0, 0, 1],
        };
        let wires = Wires {
            first,
            second: None,
        };
        let thread = Some(thread.unwrap());
        (Self { stop, thread }, wires)
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[test]
fn urdf_arm_of_drives_moves_and_replays() {
    steady(|| {
        let folder = folder("urdf-drives", DRIVES);
        let cell = read_cell(&folder.join("cell.toml")).unwrap();
        let config = cell.of_kind::<EthercatConfig>().next().unwrap();
        let joints = &config.arms[0].joints;
        assert!((joints[2].range[1] - 180.0).abs() < 1e-9);
        assert!((joints[1].range[0] + 200.0).abs() < 1e-9);
        assert!((joints[0].velocity_max - 180.0).abs() < 1e-9);
        assert!((joints[0].acceleration_max - 720.0).abs() < 1e-9);
        let (path, recording) = recorder(&folder);
        let controller = Controller::start_recording(&CellConfig::default(), recording).unwrap();
        let (served, wires) = Served::start();
        let added = controller.add_driver("segment", describe(config), None, |ends| {
            Ok(Box::new(Ethercat::start(config, wires, ends)?))
        });
        added.unwrap();
        let bench = Bench::serving(controller);
        let is_ready = || {
            let devices = bench.controller.devices();
            devices.iter().all(|device| device.status.word() == "op")
        };
        while !is_ready() {
            std::thread::sleep(Duration::from_millis(20));
        }
        let program = bench.cell();
        let arm = program.arm("ur").unwrap();
        moves(&arm, &folder.join("ur5e.urdf"), &UR_BENT);
        bench.controller.finish_recording().unwrap();
        drop((arm, program, bench, served));
        replays_without(&folder, &path);
    });
}

/// What reading a cell with this text in place of another says.
fn refused(name: &str, cell: &str, from: &str, to: &str) -> String {
    assert!(cell.contains(from), "{from}");
    let folder = folder(name, &cell.replacen(from, to, 1));
    let error = read_cell(&folder.join("cell.toml")).unwrap_err();
    error.to_string()
}

/// Which cell a fault is put into.
#[derive(Clone, Copy)]
enum Cell {
    Drives,
    Simulated,
}

/// Faults: the cell, a text of it, the one in its place, and what the finding names.
const FAULTS: &[(Cell, &str, &str, &[&str])] = &[
    (
        Cell::Drives,
        "urdf:ur5e.urdf",
        "urdf:ur6.urdf",
        &[
            "line 10, column 9",
            "ur6.urdf: No such file",
            "hint: paths are relative",
        ],
    ),
    (
        Cell::Drives,
        "urdf:ur5e.urdf",
        "urdf:cell.toml",
        &["line 10, column 9", "cell.toml:2: this is no XML"],
    ),
    (
        Cell::Drives,
        "model = ",
        "tip_link = \"hand\"\nmodel = ",
        &[
            "line 11",
            "no link `hand`",
            "hint: expected one of",
            "tool0",
        ],
    ),
    (
        Cell::Drives,
        "model = ",
        "base_link = 1\nmodel = ",
        &["line 10", "`base_link` must be the name of a link"],
    ),
    (
        Cell::Drives,
        "range = [-200, 20]",
        "range = [-400, 20]",
        &[
            "arm ur: joint 1: range [-400.00, 20.00] degrees exceeds [-360.00, 360.00]",
            "`shoulder_lift_joint` (ur5e.urdf:",
        ],
    ),
    (
        Cell::Drives,
        "velocity_max = 120",
        "velocity_max = 220",
        &["joint 4: velocity_max 220.00 degrees/s exceeds 180.00"],
    ),
    (
        Cell::Drives,
        "  { slave = \"drives\", axis = 5, increments_per_turn = 204800 },\n",
        "",
        &["arm ur: 5 joints, but 6 in ur5e.urdf"],
    ),
    (
        Cell::Drives,
        "model = \"urdf:ur5e.urdf\"\n",
        "",
        &["arm ur: joint 0: missing field `range`"],
    ),
    (
        Cell::Simulated,
        "velocity_max = [60",
        "velocity_max = [600",
        &[
            "right: joint 0: velocity_max 600.00 degrees/s exceeds 124.62",
            "(panda.urdf:",
        ],
    ),
    (
        Cell::Simulated,
        "start = [0, -90, 90, -90, -90, 0]",
        "start = [0, -90, 90]",
        &["left: home_joint: 6 numbers"],
    ),
    (
        Cell::Simulated,
        "urdf:ur5e.urdf",
        "ur5e",
        &["left: there is no model `ur5e`", "hint: "],
    ),
];

#[test]
fn urdf_faults_are_findings_with_file_and_line() {
    let simulated = std::fs::read_to_string(Path::new(CELLS).join("urdf.toml")).unwrap();
    for (cell, from, to, said) in FAULTS {
        let cell = match cell {
            Cell::Drives => DRIVES,
            Cell::Simulated => &simulated,
        };
        let error = refused("urdf-faults", cell, from, to);
        for said in *said {
            assert!(error.contains(said), "{to}: {said} is not in\n{error}");
        }
    }
}

#[test]
fn urdf_with_sliding_joint_is_refused_in_cell() {
    let folder = folder("urdf-sliding", DRIVES);
    let path = folder.join("ur5e.urdf");
    let text = std::fs::read_to_string(&path).unwrap();
    let sliding = "name=\"elbow_joint\" type=\"prismatic\"";
    let text = text.replace("name=\"elbow_joint\" type=\"revolute\"", sliding);
    std::fs::write(&path, text).unwrap();
    let error = read_cell(&folder.join("cell.toml")).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("`elbow_joint` slides") && error.contains("hint: "),
        "{error}"
    );
}

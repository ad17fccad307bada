//! The example `assembly` against the truth of its world: what was lifted, inserted and driven, and with which forces.
#![cfg(feature = "embedded")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may fail anywhere, and shows what happened"
)]

#[allow(dead_code, reason = "an example and a demo read what tests do not")]
#[path = "../examples/assembly/program.rs"]
mod program;

use std::sync::Mutex;
use std::time::Duration;

use program::{Order, Progress, Step};
use takt_api::Cell;
use takt_embedded::world::{Truth, World};
use takt_embedded::{Embedded, EmulatedCell, Fault, Faults, Figures, set_points, watch};

/// The cell in which a base brings the boxes, and that in which they stand on the bench.
const WHOLE: &str = "assembly";
const UNLOADED: &str = "assembly_unloaded";
/// How long the world is watched after the program has ended.
const AFTER: Duration = Duration::from_secs(1);

/// What became of an assembly.
struct Ended {
    result: Result<Vec<Step>, String>,
    notes: Vec<&'static str>,
    figures: Figures,
    truth: Truth,
}

impl Ended {
    /// Why the program ended.
    fn error(&self) -> &str {
        self.result.as_ref().err().unwrap()
    }
}

/// Assembles with faults, from the cell of that name on.
fn run(cell: &str, faults: &[Fault]) -> Ended {
    // The figures are those of the program, whatever the host does meanwhile.
    takt_api::simulate_time(1.0).unwrap();
    let emulated = EmulatedCell::named(cell).unwrap();
    let world = emulated.world.as_ref().unwrap().world.clone();
    let faults = Faults::new(&world, faults);
    let embedded = Embedded::emulate(emulated).unwrap();
    let order = Order {
        is_unloaded: cell == UNLOADED,
        ..Order::default()
    };
    let ended = run_in(&embedded, &world, order, faults);
    embedded.stop().unwrap();
    ended
}

fn run_in(embedded: &Embedded, world: &World, order: Order, mut faults: Faults) -> Ended {
    let cell = Cell::connect(&embedded.address().to_string()).unwrap();
    let krcs = embedded.machines().unwrap().krcs();
    let right = krcs.iter().find(|(name, _)| name == "right");
    let right = right.map(|(_, robot)| robot.status());
    let inserts = set_points(embedded.controller().unwrap(), "right").unwrap();
    let notes = Mutex::new(Vec::new());
    let report = |progress: Progress<'_>| match progress {
        Progress::Begins(_) => {}
        Progress::Ended(step) => println!("{step:?}"),
        Progress::Note(text) => {
            println!("note: {text}");
            notes.lock().unwrap().push(text);
        }
    };
    let work = || {
        let ended = program::run(&cell, order, &report).map_err(|error| error.to_string());
        std::thread::sleep(AFTER);
        ended
    };
    let (result, record) = watch(world, inserts, work, |truth| {
        if faults.poll(truth) == Some(Fault::ArmLost) {
            right.unwrap().set_drop(1.0);
        }
    });
    let truth = world.truth();
    for event in &truth.events {
        println!("{:?} {:?}", event.at, event.kind);
    }
    let figures = record.figures(&truth);
    println!("{result:?}\n{figures:#?}");
    let _ = cell.close();
    Ended {
        result,
        notes: notes.into_inner().unwrap(),
        figures,
        truth,
    }
}

#[test]
fn assembly_overcomes_burrs_and_screw_askew() {
    let ended = run(UNLOADED, &[Fault::Jams, Fault::CrossThreads]);
    let steps = ended.result.as_ref().unwrap();
    let names: Vec<_> = steps.iter().map(|step| step.name).collect();
    let expected = [
        "start and dock",
        "fetch the parts",
        "insert the peg",
        "drive the screw",
        "deliver",
    ];
    assert_eq!(names, expected);
    let [jams, askew] = ended.notes[..] else {
        panic!("{:?}", ended.notes);
    };
    assert!(jams.contains("the peg jams"), "{jams}");
    assert!(askew.contains("the screw is tight"), "{askew}");
    let figures = &ended.figures;
    assert!(
        figures.insertion_n <= 25.0 && figures.depth_mm > 29.0,
        "{figures:?}"
    );
    let detected = figures.detected_ms.unwrap();
    assert!(detected > 0.0 && detected <= 20.0, "{figures:?}");
    assert!(
        figures.torque_nm >= 1.5 && figures.is_screwed,
        "{figures:?}"
    );
    assert!(figures.flange_n <= 60.0, "{figures:?}");
    assert_eq!((figures.stops, figures.dropped), (0, 0), "{figures:?}");
    // The workpiece stands in the second box.
    let socket = ended.truth.body("socket").unwrap();
    assert!(socket.held_by.is_empty(), "{socket:?}");
    assert!(
        (socket.pose.translation.x - 0.53).abs() < 0.005,
        "{socket:?}"
    );
}

/// The first box is unloaded after a second docking and a slip; while both arms carry the second one, an arm is lost.
#[test]
fn assembly_docks_again_grasps_harder_and_keeps_box_of_lost_arm() {
    let ended = run(WHOLE, &[Fault::DocksBeside, Fault::Slips, Fault::ArmLost]);
    let error = ended.error();
    assert!(error.contains("right"), "{error}");
    // What it overcame before.
    let [beside, slips] = ended.notes[..] else {
        panic!("{:?}", ended.notes);
    };
    assert!(beside.contains("docks beside its place"), "{beside}");
    assert!(slips.contains("a hand slips"), "{slips}");
    let first = ended.truth.body("box_1").unwrap();
    assert!(first.internal_force_max_n <= 15.0, "{first:?}");
    let [least, most] = first.grasp_distance_m.unwrap();
    assert!(most - least <= 0.000_2, "{first:?}");
    assert!(first.is_resting, "{first:?}");
    // It has slid in the oiled fingers.
    assert!((first.pose.translation.x - 0.22).abs() < 0.01, "{first:?}");
    // Both hands hold the other one in the air, at rest.
    let second = ended.truth.body("box_2").unwrap();
    assert_eq!(second.held_by.len(), 2, "{second:?}");
    assert!(second.pose.translation.z > 0.16, "{second:?}");
    assert!(second.twist.linear.norm() < 0.002, "{second:?}");
    let figures = &ended.figures;
    assert!(figures.internal_n <= 48.0, "{figures:?}");
    assert_eq!((figures.stops, figures.dropped), (1, 0), "{figures:?}");
}

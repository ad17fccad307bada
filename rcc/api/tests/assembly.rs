//! The example `assembly` against the truth of its world: what was lifted, inserted and driven, and with which forces.
#![cfg(feature = "embedded")]

#[allow(dead_code, reason = "tests call what `main` calls")]
#[path = "../examples/assembly.rs"]
mod assembly;

use std::error::Error;

use assembly::Step;
use takt_api::Cell;
use takt_embedded::world::World;
use takt_embedded::{Embedded, EmulatedCell, Figures, Moment, watch};
use takt_tests::steady;

/// Assembles in a world after `prepare`: the steps, or why it ended, and the figures.
fn run(prepare: impl FnOnce(&World)) -> (Result<Vec<Step>, Box<dyn Error>>, Figures) {
    let emulated = EmulatedCell::named("assembly").unwrap();
    let world = emulated.world.as_ref().unwrap().world.clone();
    prepare(&world);
    let embedded = Embedded::emulate(emulated).unwrap();
    let cell = Cell::connect(&embedded.address().to_string()).unwrap();
    let krcs = embedded.machines().unwrap().krcs();
    let right = krcs.iter().find(|(name, _)| name == "right");
    let right = right.map(|(_, robot)| robot.status());
    let (ended, record) = watch(&world, right, || assembly::run(&cell, true), |_| {});
    let truth = world.truth();
    for event in &truth.events {
        println!("{:?} {:?}", event.at, event.kind);
    }
    let of = |it: &&Moment| it.grasp_mm.abs();
    let mut held: Vec<_> = record
        .moments
        .iter()
        .filter(|it| it.grasp_mm.is_finite())
        .collect();
    held.sort_by(|a, b| of(b).total_cmp(&of(a)));
    println!(
        "largest changes of the grasp: {:#?}",
        held.iter().take(3).collect::<Vec<_>>()
    );
    let figures = record.figures(&truth);
    println!("{figures:#?}");
    cell.close().unwrap();
    embedded.stop().unwrap();
    (ended, figures)
}

#[test]
fn assembly_example_inserts_peg_and_drives_screw() {
    steady(|| {
        let (ended, figures) = run(|_| {});
        let names: Vec<_> = ended.unwrap().iter().map(|step| step.name).collect();
        let expected = [
            "start and dock",
            "unload a box",
            "unload a box",
            "fetch the parts",
            "insert the peg",
            "drive the screw",
            "deliver",
        ];
        assert_eq!(names, expected);
        assert!(figures.internal_n <= 15.0, "{figures:?}");
        // Wanted are 0.2 mm; for 60 ms, where the second box leaves the platform, it is more.
        assert!(figures.grasp_mm <= 1.5, "{figures:?}");
        assert!(
            figures.insertion_n <= 25.0 && figures.depth_mm > 29.0,
            "{figures:?}"
        );
        assert!(
            figures.detected_ms.is_some_and(|it| it <= 60.0),
            "{figures:?}"
        );
        assert!(
            figures.torque_nm >= 1.5 && figures.is_screwed,
            "{figures:?}"
        );
        assert_eq!((figures.stops, figures.dropped), (0, 0), "{figures:?}");
    });
}

//! A ready scene: two arms assemble a part that a mobile base brings.

use crate::body::BodyConfig;
use crate::builder::BuildError;
use crate::dock::DockConfig;
use crate::geometry::Pose;
use crate::grasp::GraspConfig;
use crate::handle::World;
use crate::hole::{HoleConfig, PegConfig};
use crate::random::Random;
use crate::screw::{ScrewConfig, ThreadConfig};
use crate::surface::SurfaceConfig;
use nalgebra::{UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// How far parts lie beside their places, m.
const PLACED: f64 = 0.000_3;
/// How far a base docks beside its place, m, and askew, rad.
const DOCKED: [f64; 2] = [0.002, 0.003];
/// Tolerances of the switch at the dock, m and rad.
const DOCK: [f64; 2] = [0.004, 0.01];
/// Where the boxes stand on the deck, and where on the bench, from the middle of each, x, m.
const DECK_X: [f64; 2] = [-0.13, 0.12];
const BENCH_X: [f64; 2] = [-0.18, 0.13];
/// Walls and bottom of a box, m.
const WALL: f64 = 0.01;

fn at(x: f64, y: f64, z: f64) -> Pose {
    Pose::translation(x, y, z)
}

/// As a tool looks that comes from above: z down.
fn down(x: f64, y: f64, z: f64) -> Pose {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    Pose::from_parts(Vector3::new(x, y, z).into(), turn)
}

/// The scene of the assembly. z = 0 is the bench on which the arms stand, m everywhere:
///
/// | what | where |
/// |---|---|
/// | surface `bench` | x 0.1 to 0.7, y -0.75 to 0.75, z 0 |
/// | surface `floor` | z -0.75 |
/// | base `base` | at x 2.0 at first. Its surface `deck`: x -0.25 to 0.25, y -0.3 to 0.3, z 0.05 |
/// | dock `dock` | at x 0.95, y 0, for `base`: guides from 60 mm on, its switch is closed within 4 mm and 10 mrad |
/// | body `box_1`, `box_2` | on the deck at x -0.13 and 0.12, 0.2 x 0.36 x 0.1, 1.2 kg, open at the top; grips on the walls at y = +-0.175, 40 mm above its centre, 10 mm wide, closed along y, with notches |
/// | body `peg` | in `box_1`, 0.2 kg, 30 x 30 x 80 mm, radius of the peg 10 mm; grip 20 mm above its centre |
/// | body `socket` | in `box_2`, 0.6 kg, 60 x 60 x 50 mm; grip 10 mm above its centre, 60 mm wide |
/// | hole `bore` | in the bottom of `socket`: 0.1 mm clearance, 30 mm deep, chamfer 1.5 mm |
/// | thread `m4` | in the bottom of `socket` at x 22 mm, with a countersink of 2 mm |
/// | screw `screw` | head in the magazine at x 0.3, y -0.3, z 0.06 |
/// | hands `left`, `right` | grippers, tool centre point 0.16 m before the flange |
/// | hand `driver` | screwdriver at the flange of the right arm: 0.12 m to the side (x) and 0.16 m before it |
///
/// By the seed, parts lie up to 0.3 mm beside their places, and the base docks up to 2 mm and 3 mrad off.
///
/// # Errors
/// None that a seed could cause.
pub fn assembly(seed: u64) -> Result<World, BuildError> {
    station(seed, DECK_X, "deck")
}

/// The same scene later: both boxes stand on the bench, at x 0.22 and 0.53, and the deck is empty.
///
/// # Errors
/// None that a seed could cause.
pub fn assembly_unloaded(seed: u64) -> Result<World, BuildError> {
    station(seed, BENCH_X, "bench")
}

/// The scene with its boxes at these places of a surface, x, m.
#[expect(clippy::too_many_lines, reason = "a table of what stands where")]
fn station(seed: u64, boxes: [f64; 2], on: &str) -> Result<World, BuildError> {
    let mut random = Random::new(seed);
    let mut near =
        |x: f64, y: f64, z: f64| at(x + random.within(PLACED), y + random.within(PLACED), z);
    let supply = |name: &str, x: f64| {
        let walls = [0.175, -0.175];
        let supply = BodyConfig::new(name, 1.2, [0.2, 0.36, 0.1])
            .at(at(x, 0.0, 0.05), Some(on))
            .open(WALL);
        let grips = walls.into_iter();
        grips
            .fold(supply, |it, y| it.grip(down(0.0, y, 0.04), 0.01))
            .notched()
    };
    let deck = SurfaceConfig {
        on_base: Some("base".into()),
        ..SurfaceConfig::table("deck", at(0.0, 0.0, 0.05), [0.25, 0.3])
    };
    let tool = at(0.0, 0.0, 0.16);
    let world = World::builder()
        .base("base", at(2.0, 0.0, 0.0))
        .dock(DockConfig {
            name: "dock".into(),
            base: "base".into(),
            pose: at(0.95, 0.0, 0.0),
            guides_m: 0.06,
            tolerance_m: DOCK[0],
            tolerance_rad: DOCK[1],
        })
        .surface(SurfaceConfig::table(
            "bench",
            at(0.4, 0.0, 0.0),
            [0.3, 0.75],
        ))
        .surface(SurfaceConfig::table(
            "floor",
            at(0.0, 0.0, -0.75),
            [10.0, 10.0],
        ))
        .surface(deck)
        .body(supply("box_1", boxes[0]))
        .body(supply("box_2", boxes[1]))
        .body(
            BodyConfig::new("peg", 0.2, [0.03, 0.03, 0.08])
                .at(near(0.0, 0.0, 0.03), Some("box_1"))
                .grip(down(0.0, 0.0, 0.02), 0.03)
                .peg(PegConfig {
                    tip: down(0.0, 0.0, -0.04),
                    radius_m: 0.01,
                }),
        )
        .body(
            BodyConfig::new("socket", 0.6, [0.06, 0.06, 0.05])
                .at(near(0.0, 0.0, 0.0), Some("box_2"))
                .grip(down(0.0, 0.0, 0.01), 0.06),
        )
        .hole(bore())
        .thread(ThreadConfig {
            capture_m: 0.002,
            ..ThreadConfig::m4("m4", down(0.022, 0.0, -0.025), Some("socket"))
        })
        .screw(ScrewConfig {
            name: "screw".into(),
            pose: near(0.3, -0.3, 0.06),
            length_m: 0.016,
        })
        .gripper("left", tool, GraspConfig::default())
        .gripper("right", tool, GraspConfig::default())
        .driver("driver", at(0.12, 0.0, 0.16))
        .build()?;
    let offset = [
        random.within(DOCKED[0]),
        random.within(DOCKED[0]),
        random.within(DOCKED[1]),
    ];
    world.turn_knobs(|knobs| knobs.docking_offset = offset);
    Ok(world)
}

/// The hole in the socket, which stands on it in its box: a hand from above presents it downwards.
fn bore() -> HoleConfig {
    HoleConfig {
        name: "bore".into(),
        pose: down(0.0, 0.0, -0.025),
        in_body: Some("socket".into()),
        radius_m: 0.010_05,
        depth_m: 0.03,
        chamfer_m: 0.001_5,
        face_radius_m: 0.03,
        stiffness: 50_000.0,
        friction: 0.15,
    }
}

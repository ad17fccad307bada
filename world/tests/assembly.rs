//! Pegs in holes and screws in threads, in virtual time.
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use common::{Bench, at, down};
use nalgebra::Vector3;
use takt_world::{
    BodyConfig, EventKind, GraspConfig, HoleConfig, PegConfig, Pose, ScrewConfig, SurfaceConfig,
    ThreadConfig, Truth, World,
};

const RADIUS: f64 = 0.01;
const CHAMFER: f64 = 0.001_5;
const DEPTH: f64 = 0.03;

/// A gripper with a peg over a hole in the world, `offset` m aside; compliant fingers, so that the hole can guide it.
fn pegged(offset: f64) -> Bench {
    let peg = BodyConfig::new("peg", 0.2, [0.03, 0.03, 0.08])
        .at(at(offset, 0.0, 0.05), None)
        .grip(down(0.0, 0.0, 0.02), 0.03)
        .peg(PegConfig {
            tip: down(0.0, 0.0, -0.04),
            radius_m: RADIUS,
        });
    let hole = HoleConfig {
        name: "bore".into(),
        pose: Pose::identity(),
        in_body: None,
        radius_m: RADIUS + 0.000_05,
        depth_m: DEPTH,
        chamfer_m: CHAMFER,
        face_radius_m: 0.05,
        stiffness: 200_000.0,
        friction: 0.15,
    };
    let grasp = GraspConfig {
        stiffness: 5_000.0,
        ..GraspConfig::default()
    };
    let world = World::builder()
        .body(peg)
        .hole(hole)
        .gripper("hand", at(0.0, 0.0, 0.16), grasp)
        .build()
        .unwrap();
    let mut bench = Bench::new(world, &[("hand", down(offset, 0.0, 0.07))]);
    bench.fingers(0, 0.03, 60.0);
    assert!(bench.stops[0].holds);
    bench.rest(200);
    bench
}

fn depth(bench: &Bench) -> f64 {
    bench.world.truth().peg("peg", "bore").unwrap().depth_m
}

fn has(truth: &Truth, is: impl Fn(&EventKind) -> bool) -> bool {
    truth.first(|event| is(&event.kind)).is_some()
}

#[test]
fn peg_offset_below_chamfer_slides_in() {
    for offset in [0.0, 0.0005, 0.001] {
        let mut bench = pegged(offset);
        // From 10 mm above down to the bottom.
        bench.shift(&[[0.0, 0.0, -0.039]], 4000);
        assert!(depth(&bench) > 0.028, "{offset}: {}", depth(&bench));
        let truth = bench.world.truth();
        assert!(
            truth.peg("peg", "bore").unwrap().offset_m < 0.0002,
            "guided"
        );
    }
}

#[test]
fn peg_offset_above_chamfer_stays_out() {
    let mut bench = pegged(0.003);
    bench.shift(&[[0.0, 0.0, -0.013]], 2000);
    bench.rest(200);
    assert!(depth(&bench) < 0.001, "{}", depth(&bench));
    // 3 mm at 5,000 N/m, less what the contact gives way.
    let force = bench.wrenches[0].force.z;
    assert!((10.0..20.0).contains(&force), "{force}");
    let truth = bench.world.truth();
    assert!(has(&truth, |kind| matches!(
        kind,
        EventKind::PegTouched { .. }
    )));
    assert!(!has(&truth, |kind| matches!(
        kind,
        EventKind::Seated { .. }
    )));
}

#[test]
fn peg_force_rises_at_bottom() {
    let mut bench = pegged(0.0);
    bench.shift(&[[0.0, 0.0, -0.035]], 4000);
    bench.rest(100);
    let free = bench.wrenches[0].force.z;
    assert!(free < 2.0, "on the way: {free}");
    bench.shift(&[[0.0, 0.0, -0.008]], 1000);
    bench.rest(100);
    let seated = bench.wrenches[0].force.z;
    assert!(seated > 8.0, "{seated}");
    let truth = bench.world.truth();
    assert!(truth.peg("peg", "bore").unwrap().is_seated, "{truth:?}");
    assert!(has(&truth, |kind| matches!(kind, EventKind::Seated { .. })));
}

#[test]
fn peg_burr_stops_it_early() {
    let mut bench = pegged(0.0);
    bench
        .world
        .turn_knobs(|knobs| knobs.obstructed_m = Some(0.01));
    bench.shift(&[[0.0, 0.0, -0.025]], 3000);
    bench.rest(100);
    assert!((depth(&bench) - 0.01).abs() < 0.001, "{}", depth(&bench));
    assert!(bench.wrenches[0].force.z > 10.0);
    assert!(!has(&bench.world.truth(), |kind| matches!(
        kind,
        EventKind::Seated { .. }
    )));
}

#[test]
fn peg_tilted_wedges_by_friction() {
    // Two-point contact: the same push at the same depth takes more force, the more the peg is tilted.
    let mut forces = Vec::new();
    for tilt in [0.0, 0.03] {
        let mut bench = pegged(0.0);
        bench.shift(&[[0.0, 0.0, -0.020]], 2000);
        // About the axis that the pads hold best.
        bench.tilt(0, Vector3::x() * tilt, 500);
        bench.shift(&[[0.0, 0.0, -0.005]], 500);
        forces.push(bench.wrenches[0].force.z);
    }
    assert!(forces[1] > forces[0] + 5.0, "{forces:?}");
}

/// A screwdriver with a screw above a thread, `offset` m aside.
fn screwed(offset: f64) -> Bench {
    let world = World::builder()
        .surface(SurfaceConfig::table(
            "table",
            at(0.0, 0.0, -0.05),
            [1.0, 1.0],
        ))
        .screw(ScrewConfig {
            name: "screw".into(),
            pose: at(0.2, 0.0, 0.05),
            length_m: 0.016,
        })
        .thread(ThreadConfig::m4("m4", Pose::identity(), None))
        .driver("driver", at(0.0, 0.0, 0.16))
        .build()
        .unwrap();
    let mut bench = Bench::new(world, &[("driver", down(0.2, 0.0, 0.06))]);
    bench.shift(&[[0.0, 0.0, -0.01]], 200);
    assert_eq!(
        bench
            .world
            .truth()
            .screw("screw")
            .unwrap()
            .at_bit
            .as_deref(),
        Some("driver")
    );
    bench.shift(&[[0.0, 0.0, 0.03]], 200);
    bench.shift(&[[-0.2 + offset, 0.0, 0.0]], 500);
    // The tip is at the mouth when the bit is 16 mm above.
    bench.shift(&[[0.0, 0.0, -0.064]], 500);
    bench
}

/// Turns by this, following the feed, with 0.5 mm of spring: 10 N. The torques of each tenth of a turn.
fn turn(bench: &mut Bench, turns: u32, feed: f64) -> Vec<f64> {
    let driver = bench.world.screwdriver("driver").unwrap();
    let mut angle = 0.0;
    let _rest = driver.post(bench.now, 0.0);
    bench.shift(&[[0.0, 0.0, -0.000_5]], 50);
    (0..turns * 10)
        .map(|_| {
            bench.shift(&[[0.0, 0.0, -feed / 10.0]], 20);
            angle += std::f64::consts::TAU / 10.0;
            driver.post(bench.now, angle)
        })
        .collect()
}

#[test]
fn screw_torque_runs_then_rises_at_seat() {
    let mut bench = screwed(0.0);
    // 8 mm at 0.7 mm a turn: 11.4 turns.
    let torques = turn(&mut bench, 11, 0.0007);
    assert!(
        torques.iter().all(|it| (0.0..0.1).contains(it)),
        "{torques:?}"
    );
    let truth = bench.world.truth();
    let screw = truth.screw("screw").unwrap();
    assert!((screw.depth_m - 0.0077).abs() < 1e-4, "{screw:?}");
    assert!(!screw.is_seated && !screw.is_cross_threaded);
    let driver = bench.world.screwdriver("driver").unwrap();
    let torque = driver.post(bench.now, std::f64::consts::TAU * 11.9);
    // 0.47 turns beyond the seat at 0.6 Nm/rad.
    assert!((torque - 1.83).abs() < 0.1, "{torque}");
    bench.rest(1);
    // The tool points down: the reaction turns the flange the other way.
    assert!(
        (bench.wrenches[0].torque.z - torque).abs() < 1e-9,
        "{:?}",
        bench.wrenches
    );
    let truth = bench.world.truth();
    assert!(truth.screw("screw").unwrap().is_seated);
    assert!(has(&truth, |kind| matches!(
        kind,
        EventKind::ScrewSeated { .. }
    )));
}

#[test]
fn screw_off_axis_cross_threads() {
    let mut bench = screwed(0.001);
    let torques = turn(&mut bench, 2, 0.000_35);
    let truth = bench.world.truth();
    assert!(
        has(&truth, |kind| matches!(
            kind,
            EventKind::CrossThreaded { .. }
        )),
        "{truth:?}"
    );
    let screw = truth.screw("screw").unwrap();
    assert!(screw.is_cross_threaded && !screw.is_seated);
    assert!(torques[19] > 2.0 && screw.depth_m < 0.002, "{torques:?}");
}

#[test]
fn screw_cross_thread_knob_applies_on_axis() {
    let mut bench = screwed(0.0);
    bench.world.turn_knobs(|knobs| knobs.cross_threads = true);
    turn(&mut bench, 2, 0.000_35);
    assert!(
        bench
            .world
            .truth()
            .screw("screw")
            .unwrap()
            .is_cross_threaded
    );
}

#[test]
fn screw_without_axial_force_slips() {
    let mut bench = screwed(0.0);
    turn(&mut bench, 2, 0.0007);
    bench.shift(&[[0.0, 0.0, 0.001]], 50);
    let driver = bench.world.screwdriver("driver").unwrap();
    let before = bench.world.truth().screw("screw").unwrap().turned_rad;
    let _slips = driver.post(bench.now, 20.0);
    let truth = bench.world.truth();
    assert!((truth.screw("screw").unwrap().turned_rad - before).abs() < 1e-12);
    assert!(has(&truth, |kind| matches!(
        kind,
        EventKind::BitSlipped { .. }
    )));
}

#[test]
fn screw_beyond_strength_strips_thread() {
    let mut bench = screwed(0.0);
    turn(&mut bench, 11, 0.0007);
    let driver = bench.world.screwdriver("driver").unwrap();
    let turn = std::f64::consts::TAU;
    let strong = driver.post(bench.now, turn * 12.4);
    assert!(strong > 3.0, "{strong}");
    let _strips = driver.post(bench.now, turn * 12.8);
    let weak = driver.post(bench.now, turn * 12.9);
    assert!(weak < 0.1, "{weak}");
    let truth = bench.world.truth();
    assert!(truth.screw("screw").unwrap().is_stripped);
}

#[test]
fn screw_turned_back_leaves_thread() {
    let mut bench = screwed(0.0);
    bench.world.turn_knobs(|knobs| knobs.cross_threads = true);
    turn(&mut bench, 2, 0.000_35);
    bench.world.turn_knobs(|knobs| knobs.cross_threads = false);
    let driver = bench.world.screwdriver("driver").unwrap();
    for step in (0..20).rev() {
        bench.shift(&[[0.0, 0.0, 0.000_035]], 20);
        let torque = driver.post(bench.now, std::f64::consts::TAU / 10.0 * f64::from(step));
        assert!(torque <= 0.0, "{torque}");
    }
    let _out = driver.post(bench.now, -0.1);
    let truth = bench.world.truth();
    let screw = truth.screw("screw").unwrap();
    assert_eq!(screw.at_bit.as_deref(), Some("driver"), "{screw:?}");
    assert!(!screw.is_cross_threaded && screw.thread.is_none());
    // The second attempt bites well.
    let _rest = driver.post(bench.now, 0.0);
    bench.shift(&[[0.0, 0.0, -0.000_2]], 50);
    let _turn = driver.post(bench.now, 1.0);
    let truth = bench.world.truth();
    assert!(has(&truth, |kind| matches!(
        kind,
        EventKind::ScrewEngaged { .. }
    )));
}

/// A peg and a socket, each held by a hand, the peg 5 mm above the socket.
fn paired() -> Bench {
    let peg = BodyConfig::new("peg", 0.2, [0.03, 0.03, 0.08])
        .at(at(0.0, 0.0, 0.07), None)
        .grip(down(0.0, 0.0, 0.02), 0.03)
        .peg(PegConfig {
            tip: down(0.0, 0.0, -0.04),
            radius_m: RADIUS,
        });
    let socket = BodyConfig::new("socket", 0.6, [0.06, 0.06, 0.05])
        .at(Pose::identity(), None)
        .grip(Pose::identity(), 0.06);
    let hole = HoleConfig {
        name: "bore".into(),
        pose: at(0.0, 0.0, 0.025),
        in_body: Some("socket".into()),
        radius_m: RADIUS + 0.000_05,
        depth_m: DEPTH,
        chamfer_m: CHAMFER,
        face_radius_m: 0.03,
        stiffness: 200_000.0,
        friction: 0.15,
    };
    let grasp = GraspConfig::default();
    let world = World::builder()
        .body(peg)
        .body(socket)
        .hole(hole)
        .gripper("right", at(0.0, 0.0, 0.16), grasp)
        .gripper("left", at(0.0, 0.0, 0.16), grasp)
        .build()
        .unwrap();
    let hands = [("right", down(0.0, 0.0, 0.09)), ("left", Pose::identity())];
    let mut bench = Bench::new(world, &hands);
    bench.fingers(0, 0.03, 80.0);
    bench.fingers(1, 0.06, 80.0);
    bench.rest(300);
    bench
}

#[test]
fn peg_and_socket_held_push_back_equally() {
    let mut bench = paired();
    let weights: Vec<f64> = bench.wrenches.iter().map(|it| it.force.z).collect();
    bench.shift(&[[0.0, 0.0, -0.0365], [0.0, 0.0, 0.0]], 2000);
    bench.rest(300);
    let truth = bench.world.truth();
    assert!(truth.peg("peg", "bore").unwrap().is_seated, "{truth:?}");
    let [right, left] = [0, 1].map(|hand| bench.wrenches[hand].force.z - weights[hand]);
    assert!(right > 8.0 && (right + left).abs() < 0.05, "{right} {left}");
    // The socket's hand carries both once the peg's hand has opened.
    bench.fingers(0, 0.05, 0.0);
    bench.shift(&[[0.0, 0.0, 0.1], [0.0, 0.0, 0.0]], 500);
    bench.rest(200);
    let truth = bench.world.truth();
    assert!(
        truth.body("peg").unwrap().is_resting,
        "in the socket: {truth:?}"
    );
    let carried = bench.wrenches[1].force.z;
    assert!((carried + 0.8 * 9.81).abs() < 0.02, "{carried}");
    assert!(!has(&truth, |kind| matches!(
        kind,
        EventKind::Dropped { .. }
    )));
    bench.shift(&[[0.0; 3], [0.0, 0.0, 0.1]], 500);
    let peg = bench.world.truth().body("peg").unwrap().pose.translation.z;
    assert!((peg - 0.135).abs() < 0.002, "rides along: {peg}");
}

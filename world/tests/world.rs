//! The laws of the world in virtual time: held bodies, slip, two hands, contact, base, repeatability.
#![expect(
    clippy::unwrap_used,
    clippy::cast_precision_loss,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use common::{Bench, at, down};
use nalgebra::Vector3;
use proptest::prelude::*;
use std::time::Duration;
use takt_world::{
    BodyConfig, Builder, EventKind, GraspConfig, Pose, SurfaceConfig, Truth, Twist, World,
    assembly, assembly_unloaded,
};

const G: f64 = 9.81;

fn table() -> Builder {
    World::builder().surface(SurfaceConfig::table("table", Pose::identity(), [1.0, 1.0]))
}

fn block(mass: f64) -> BodyConfig {
    BodyConfig::new("block", mass, [0.04, 0.04, 0.08])
        .at(at(0.0, 0.0, 0.04), Some("table"))
        .grip(down(0.0, 0.0, 0.02), 0.04)
}

/// A block of 0.5 kg on a table, held with a force.
fn held(force: f64) -> Bench {
    let world = table()
        .body(block(0.5))
        .gripper("hand", at(0.0, 0.0, 0.16), GraspConfig::default())
        .build()
        .unwrap();
    let mut bench = Bench::new(world, &[("hand", down(0.0, 0.0, 0.06))]);
    bench.fingers(0, 0.04, force);
    assert!(bench.stops[0].holds);
    bench
}

fn height(truth: &Truth, body: &str) -> f64 {
    truth.body(body).unwrap().pose.translation.z
}

fn has(truth: &Truth, is: impl Fn(&EventKind) -> bool) -> bool {
    truth.first(|event| is(&event.kind)).is_some()
}

#[test]
fn world_held_body_weighs_on_flange() {
    let mut bench = held(40.0);
    bench.shift(&[[0.0, 0.0, 0.1]], 500);
    bench.rest(500);
    let truth = bench.world.truth();
    assert!((height(&truth, "block") - 0.14).abs() < 0.001, "{truth:?}");
    let wrench = bench.wrenches[0];
    assert!(
        (wrench.force - Vector3::z() * (-0.5 * G)).norm() < 0.01,
        "{wrench:?}"
    );
    assert!(wrench.torque.norm() < 0.01, "below the flange: {wrench:?}");
    assert!(truth.hand("hand").unwrap().slip_m < 1e-6);
}

#[test]
fn world_accelerated_body_adds_inertia() {
    let mut bench = held(60.0);
    bench.shift(&[[0.0, 0.0, 0.1]], 500);
    bench.rest(500);
    let (hand, tool) = (bench.world.hand("hand").unwrap(), at(0.0, 0.0, -0.16));
    let start = bench.now;
    let mut force = Vector3::zeros();
    for cycle in 1..=200_u32 {
        let seconds = f64::from(cycle) * 1e-3;
        let tcp = down(seconds * seconds, 0.0, 0.16);
        let twist = Twist {
            linear: Vector3::x() * (2.0 * seconds),
            angular: Vector3::zeros(),
        };
        let now = start + cycle * common::CYCLE;
        force = hand.post(now, &(tcp * tool), &twist).force;
    }
    // 2 m/s2 on 0.5 kg.
    assert!((force.x + 1.0).abs() < 0.05, "{force}");
    assert!((force.z + 0.5 * G).abs() < 0.05, "{force}");
}

#[test]
fn world_grasp_slips_beyond_two_mu_force() {
    // 2 mu F = 2 * 0.6 * F against 4.905 N of weight: 4.0875 N.
    for (force, slips) in [(4.5, false), (3.7, true)] {
        let mut bench = held(force);
        bench.shift(&[[0.0, 0.0, 0.1]], 1500);
        bench.rest(500);
        let truth = bench.world.truth();
        let slipped = has(&truth, |kind| matches!(kind, EventKind::Slipped { .. }));
        let lost = has(&truth, |kind| matches!(kind, EventKind::Lost { .. }));
        assert_eq!((slipped, lost), (slips, slips), "{force} N");
        assert_eq!(bench.stops[0].holds, !slips);
        assert_eq!(bench.stops[0].slip_m > 0.005, slips, "{:?}", bench.stops[0]);
    }
}

#[test]
fn world_oiled_pads_lose_body() {
    let mut bench = held(20.0);
    bench.shift(&[[0.0, 0.0, 0.1]], 500);
    assert!(bench.stops[0].holds);
    bench.world.turn_knobs(|knobs| knobs.grip_friction = 0.1);
    bench.rest(500);
    assert!(!bench.stops[0].holds);
}

#[test]
fn world_opened_fingers_drop_body() {
    let mut bench = held(40.0);
    bench.shift(&[[0.0, 0.0, 0.3]], 500);
    let before = bench.world.truth();
    assert!(!has(&before, |kind| matches!(
        kind,
        EventKind::Dropped { .. }
    )));
    bench.fingers(0, 0.06, 0.0);
    bench.rest(3000);
    let truth = bench.world.truth();
    for kind in [
        EventKind::Released {
            hand: "hand".into(),
            body: "block".into(),
        },
        EventKind::Dropped {
            body: "block".into(),
        },
        EventKind::Rested {
            body: "block".into(),
        },
    ] {
        assert!(
            has(&truth, |it| *it == kind),
            "{kind:?} in {:?}",
            truth.events
        );
    }
    assert!(bench.wrenches[0].force.norm() < 1e-9);
    assert!(height(&truth, "block") < 0.041, "on the table");
}

#[test]
fn world_two_hands_apart_strain_body() {
    let beam = BodyConfig::new("beam", 1.0, [0.04, 0.4, 0.04])
        .at(at(0.0, 0.0, 0.02), Some("table"))
        .grip(down(0.0, 0.18, 0.0), 0.04)
        .grip(down(0.0, -0.18, 0.0), 0.04);
    // Grips close along y, across which hands pull: turned by a right angle, fingers close along x.
    let turn =
        nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    let across = |y: f64, z: f64| {
        let mut pose = down(0.0, y, z);
        pose.rotation = turn * pose.rotation;
        pose
    };
    let mut beam = beam;
    for (grip, y) in beam.grips.iter_mut().zip([0.18, -0.18]) {
        grip.0 = across(y, 0.0);
    }
    let grasp = GraspConfig::default();
    let world = table()
        .body(beam)
        .gripper("a", at(0.0, 0.0, 0.16), grasp)
        .gripper("b", at(0.0, 0.0, 0.16), grasp)
        .build()
        .unwrap();
    let hands = [("a", across(0.18, 0.02)), ("b", across(-0.18, 0.02))];
    let mut bench = Bench::new(world, &hands);
    bench.fingers(0, 0.04, 60.0);
    bench.fingers(1, 0.04, 60.0);
    bench.shift(&[[0.0, 0.0, 0.1]; 2], 500);
    bench.rest(500);
    let truth = bench.world.truth();
    let beam = truth.body("beam").unwrap();
    assert!(beam.internal_force_n.abs() < 0.2, "{beam:?}");
    let sum: Vector3<f64> = bench.wrenches.iter().map(|it| it.force).sum();
    assert!((sum.z + G).abs() < 0.02, "{sum}");
    // 1 mm apart: two springs of 20,000 N/m in series.
    bench.shift(&[[0.0, 0.0005, 0.0], [0.0, -0.0005, 0.0]], 200);
    bench.rest(500);
    let truth = bench.world.truth();
    let beam = truth.body("beam").unwrap();
    assert!((beam.internal_force_n - 10.0).abs() < 0.3, "{beam:?}");
    assert!(
        (bench.wrenches[0].force.y + 10.0).abs() < 0.3,
        "{:?}",
        bench.wrenches
    );
    assert!((bench.wrenches[1].force.y - 10.0).abs() < 0.3);
    let [least, most] = beam.grasp_distance_m.unwrap();
    assert!((most - least - 0.001).abs() < 1e-5);
    assert_eq!(beam.held_by, ["a", "b"]);
}

#[test]
fn world_tip_presses_table_with_friction() {
    let world = table().probe("tip", at(0.0, 0.0, 0.1)).build().unwrap();
    let mut bench = Bench::new(world, &[("tip", down(0.0, 0.0, 0.01))]);
    assert!(bench.wrenches[0].force.norm() < 1e-12);
    bench.shift(&[[0.0, 0.0, -0.011]], 500);
    bench.rest(100);
    // 1 mm deep at 20,000 N/m.
    assert!((bench.wrenches[0].force.z - 20.0).abs() < 0.01);
    let truth = bench.world.truth();
    let on = EventKind::Touched {
        hand: "tip".into(),
        on: "table".into(),
    };
    assert!(has(&truth, |kind| *kind == on));
    // Sticks: 0.2 mm to the side are 4 N; slides: 0.4 * 20 N.
    bench.shift(&[[0.0002, 0.0, 0.0]], 100);
    bench.rest(10);
    assert!(
        (bench.wrenches[0].force.x + 4.0).abs() < 0.01,
        "{:?}",
        bench.wrenches
    );
    bench.shift(&[[0.01, 0.0, 0.0]], 100);
    bench.rest(10);
    assert!(
        (bench.wrenches[0].force.x + 8.0).abs() < 0.01,
        "{:?}",
        bench.wrenches
    );
    // 0.1 m from the flange down to the tip: the moment of the friction.
    assert!(
        (bench.wrenches[0].torque.y - 0.8).abs() < 0.01,
        "{:?}",
        bench.wrenches
    );
    bench.shift(&[[0.0, 0.0, 0.01]], 100);
    assert!(bench.wrenches[0].force.norm() < 1e-12);
    assert!(has(&bench.world.truth(), |kind| matches!(
        kind,
        EventKind::Left { .. }
    )));
}

#[test]
fn world_gripper_palm_touches_before_grasp() {
    let world = table()
        .body(block(0.5))
        .gripper("hand", at(0.0, 0.0, 0.16), GraspConfig::default())
        .build()
        .unwrap();
    let mut bench = Bench::new(world, &[("hand", down(0.0, 0.0, 0.1))]);
    bench.shift(&[[0.0, 0.0, -0.036]], 500);
    assert!(
        bench.wrenches[0].force.norm() < 1e-9,
        "above the palm's reach"
    );
    bench.shift(&[[0.0, 0.0, -0.011]], 500);
    bench.rest(10);
    assert!(
        (bench.wrenches[0].force.z - 20.0).abs() < 0.1,
        "{:?}",
        bench.wrenches
    );
}

#[test]
fn world_base_carries_bodies_with_docking_offset() {
    let world = assembly(1).unwrap();
    world.turn_knobs(|knobs| knobs.docking_offset = [0.008, 0.0, 0.0]);
    let base = world.base("base").unwrap();
    let before = world.truth();
    for cycle in 0..=1000_u32 {
        let x = 2.0 - f64::from(cycle) * 0.001_05;
        base.post(Duration::from_millis(10 * u64::from(cycle)), x, 0.0, 0.0);
    }
    base.post(Duration::from_millis(10_010), 0.95, 0.0, 0.0);
    world.advance(Duration::from_secs(11));
    let after = world.truth();
    for body in ["box_1", "box_2", "peg", "socket"] {
        let [from, to] = [&before, &after].map(|truth| truth.body(body).unwrap().pose);
        let way = to.translation.vector - from.translation.vector;
        assert!(
            (way - Vector3::new(-1.042, 0.0, 0.0)).norm() < 1e-9,
            "{body} {way}"
        );
        assert!(after.body(body).unwrap().is_resting);
    }
}

/// A base that docks beside its place drives away and docks again: what stands on it keeps its place there, whenever the offset ends.
#[test]
fn world_base_docks_again_without_jump() {
    let world = assembly(1).unwrap();
    world.turn_knobs(|knobs| knobs.docking_offset = [0.008, 0.0, 0.0]);
    let base = world.base("base").unwrap();
    let on_base = |truth: &Truth| {
        let (_, base) = &truth.bases[0];
        base.inverse() * truth.body("box_1").unwrap().pose
    };
    let mut cycle = 0;
    let mut drive = |from: f64, to: f64| {
        for step in 0..=250_u32 {
            let x = from + (to - from) * f64::from(step) / 250.0;
            base.post(Duration::from_millis(4 * cycle), x, 0.0, 0.0);
            cycle += 1;
        }
        world.truth()
    };
    let begun = on_base(&drive(1.05, 1.05));
    let beside = drive(1.05, 0.95);
    assert!(
        (beside.bases[0].1.translation.x - 0.958).abs() < 1e-6,
        "{beside:?}"
    );
    drive(0.95, 1.03);
    world.turn_knobs(|knobs| knobs.docking_offset = [0.0; 3]);
    drive(1.03, 1.05);
    let docked = drive(1.05, 0.95);
    assert!(
        (docked.bases[0].1.translation.x - 0.95).abs() < 1e-6,
        "{docked:?}"
    );
    let moved = on_base(&docked).translation.vector - begun.translation.vector;
    assert!(moved.norm() < 1e-4, "the box slid by {moved}");
}

#[test]
fn world_unloaded_boxes_stand_on_bench() {
    let world = assembly_unloaded(1).unwrap();
    world.advance(Duration::ZERO);
    world.advance(Duration::from_secs(1));
    let truth = world.truth();
    for (name, x, z) in [
        ("box_1", 0.22, 0.05),
        ("box_2", 0.53, 0.05),
        ("peg", 0.22, 0.08),
    ] {
        let body = truth.body(name).unwrap();
        let off = body.pose.translation.vector - Vector3::new(x, 0.0, z);
        assert!(off.norm() < 6e-4 && body.is_resting, "{name}: {body:?}");
    }
}

/// Over an open box of 100 mm with walls of 10 mm: into it, onto its rim, onto its bottom, and a solid one.
#[test]
fn world_open_box_lets_hands_in() {
    let force = |is_open: bool, x: f64, z: f64| {
        let solid =
            BodyConfig::new("box", 1.0, [0.1, 0.1, 0.1]).at(at(0.0, 0.0, 0.05), Some("table"));
        let body = if is_open { solid.open(0.01) } else { solid };
        let world = table().body(body).probe("hand", at(0.0, 0.0, 0.16));
        let mut bench = Bench::new(world.build().unwrap(), &[("hand", down(x, 0.0, z))]);
        bench.rest(5);
        bench.wrenches[0].force.z
    };
    for z in [0.095, 0.085, 0.05, 0.012] {
        assert!(force(true, 0.0, z).abs() < 1e-9, "{z} m above the table");
    }
    assert!((force(true, 0.045, 0.099) - 20.0).abs() < 1.0, "on its rim");
    assert!(
        (force(true, 0.0, 0.009) - 20.0).abs() < 1.0,
        "on its bottom"
    );
    assert!(
        (force(false, 0.0, 0.085) - 300.0).abs() < 5.0,
        "a solid one"
    );
}

/// A heavy block falls on its edge on the stiffest surface.
fn energies(stiffness: f64, seed: u64) -> Vec<f64> {
    let mut pose = at(0.0, 0.0, 0.1);
    let tilt = 0.1 + 0.2 * f64::from(u32::try_from(seed).unwrap());
    pose.rotation = nalgebra::UnitQuaternion::from_euler_angles(tilt, 0.7, 0.2);
    let world = World::builder()
        .surface(SurfaceConfig {
            stiffness,
            ..SurfaceConfig::table("table", Pose::identity(), [1.0, 1.0])
        })
        .body(BodyConfig::new("block", 0.05, [0.02, 0.03, 0.04]).at(pose, None))
        .build()
        .unwrap();
    (0..3000_u64)
        .map(|cycle| {
            world.advance(Duration::from_millis(cycle));
            world.truth().energy_j
        })
        .collect()
}

#[test]
fn world_stiffest_contact_loses_energy() {
    for seed in 0..5 {
        let energies = energies(50_000.0, seed);
        // Springs store what the body gives them: they give back at most that.
        let highest = energies[0] * 1.002;
        assert!(energies.iter().all(|it| *it <= highest), "{energies:?}");
        let (mut least, mut peak_after) = (f64::INFINITY, 0.0_f64);
        for energy in energies.iter().rev() {
            peak_after = peak_after.max(*energy);
            least = least.min(*energy);
        }
        assert!(energies[2999] < energies[0] / 2.0, "{}", energies[2999]);
        assert!(energies[2999] - energies[2900] < 1e-6, "at rest");
    }
}

#[test]
fn world_held_stiffly_stays_bounded() {
    let grasp = GraspConfig {
        stiffness: 50_000.0,
        turn_stiffness: 500.0,
        ..GraspConfig::default()
    };
    let world = table()
        .body(block(0.001))
        .gripper("hand", at(0.0, 0.0, 0.16), grasp)
        .build()
        .unwrap();
    let mut bench = Bench::new(world, &[("hand", down(0.0, 0.0, 0.06))]);
    bench.fingers(0, 0.04, 80.0);
    bench.shift(&[[0.02, 0.0, 0.1]], 100);
    bench.rest(500);
    let truth = bench.world.truth();
    let twist = truth.body("block").unwrap().twist;
    assert!(
        twist.linear.norm() < 1e-6 && twist.angular.norm() < 1e-6,
        "{twist:?}"
    );
    assert!((bench.wrenches[0].force.z + 0.001 * G).abs() < 1e-4);
}

/// Everything at once: base, two hands, a drop.
fn story(seed: u64) -> String {
    let world = assembly(seed).unwrap();
    let base = world.base("base").unwrap();
    for cycle in 0..200_u32 {
        let share = f64::from(cycle.min(190)) / 190.0;
        let x = 2.0 - 1.05 * (1.0 - (share * std::f64::consts::PI).cos()) / 2.0;
        base.post(Duration::from_millis(u64::from(cycle) * 5), x, 0.0, 0.0);
    }
    let tcp = |y: f64| down(0.82, y, 0.14);
    let mut bench = Bench::new(world, &[("left", tcp(0.175)), ("right", tcp(-0.175))]);
    bench.fingers(0, 0.01, 40.0);
    bench.fingers(1, 0.01, 40.0);
    bench.shift(&[[0.0, 0.0, 0.2]; 2], 300);
    bench.shift(&[[-0.3, 0.0, 0.0], [-0.3, 0.0005, 0.0]], 300);
    bench.fingers(1, 0.05, 0.0);
    bench.rest(300);
    bench.fingers(0, 0.05, 0.0);
    bench.rest(500);
    format!("{:?} {:?}", bench.world.truth(), bench.wrenches)
}

#[test]
fn world_same_posts_same_bits() {
    assert_eq!(story(7), story(7));
    assert_ne!(story(7), story(8), "the seed moves parts and base");
}

#[test]
fn world_two_hands_lift_supply_box() {
    let text = story(3);
    for part in [
        "Grasped { hand: \"left\", body: \"box_1\" }",
        "Grasped { hand: \"right\", body: \"box_1\" }",
    ] {
        assert!(text.contains(part), "{text}");
    }
}

#[test]
fn world_thread_order_changes_little() {
    let run = |order: [usize; 2]| {
        let world = assembly(1).unwrap();
        let hands = ["left", "right"].map(|name| world.hand(name).unwrap());
        let fingers = ["left", "right"].map(|name| world.fingers(name).unwrap());
        let mut last = Vector3::zeros();
        for cycle in 1..800_u64 {
            let lift = (0.2 * (cycle as f64) * 1e-3 - 0.02).clamp(0.0, 0.1);
            let speed = if lift > 0.0 && lift < 0.1 { 0.2 } else { 0.0 };
            let at = Duration::from_millis(cycle);
            for hand in order {
                let y = [0.175, -0.175][hand];
                let tcp = down(1.87, y, 0.14 + lift);
                let flange = tcp * hands[hand].tool().inverse();
                let twist = Twist {
                    linear: Vector3::z() * speed,
                    angular: Vector3::zeros(),
                };
                last = hands[hand].post(at, &flange, &twist).force;
                let _stop = fingers[hand].post(at, 0.01, 40.0);
            }
        }
        (world.truth().body("box_1").unwrap().pose, last)
    };
    let [(first, _), (second, _)] = [run([0, 1]), run([1, 0])];
    let way = (first.translation.vector - second.translation.vector).norm();
    assert!(way < 2e-4, "{way}");
    assert!(first.translation.z > 0.19, "{first}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn world_wild_posts_do_no_harm(
        posts in prop::collection::vec((0..4_u8, 0..3_000_u64, prop::array::uniform7(wild())), 1..40)
    ) {
        let world = assembly(1).unwrap();
        let left = world.hand("left").unwrap();
        let (fingers, bit) = (world.fingers("left").unwrap(), world.screwdriver("driver").unwrap());
        let base = world.base("base").unwrap();
        for (kind, ms, [a, b, c, d, e, f, g]) in posts {
            let at = Duration::from_millis(ms);
            match kind {
                0 => {
                    let quaternion = nalgebra::Quaternion::new(1.0, d, e, f);
                    let turn = nalgebra::UnitQuaternion::new_unchecked(quaternion);
                    let pose = Pose::from_parts(Vector3::new(a, b, c).into(), turn);
                    let twist = Twist { linear: Vector3::repeat(g), angular: Vector3::repeat(f) };
                    let wrench = left.post(at, &pose, &twist);
                    prop_assert!(wrench.force.iter().chain(wrench.torque.iter()).all(|it| it.is_finite()));
                }
                1 => { let _stop = fingers.post(at, a, b); }
                2 => { let torque = bit.post(at, a); prop_assert!(torque.is_finite()); }
                _ => base.post(at, a, b, c),
            }
        }
        let truth = world.truth();
        for body in &truth.bodies {
            prop_assert!(body.pose.translation.vector.iter().all(|it| it.is_finite()));
        }
    }
}

fn wild() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -1.0..1.0_f64,
        1 => prop::num::f64::ANY,
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
        1 => Just(1e300),
        2 => Just(0.0),
    ]
}

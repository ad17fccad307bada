//! Motions of arms and of objects that several arms hold, against a controller with two simulated arms.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

mod robotics;

use std::time::Duration;

use robotics::{BENT, Bench};
use takt_api::motion::CartesianLimits;
use takt_api::{Arm, ErrorKind, Outcome, Plan, Pose, coupled, together};
use takt_client::{Client, Value};
use takt_motion::kinematics::named;
use takt_tests::steady;

fn near(a: &[f64], b: &[f64], tolerance: f64) {
    let far = a.iter().zip(b).map(|(a, b)| (a - b).abs());
    let far = far.fold(0.0, f64::max);
    assert!(a.len() == b.len() && far <= tolerance, "{a:?} is not {b:?}");
}

/// The pose of an arm, moved in its base.
fn beside(arm: &Arm, [x, y, z]: [f64; 3]) -> Pose {
    let start = arm.pose().unwrap();
    let at = start.position();
    Pose::quaternion([at[0] + x, at[1] + y, at[2] + z], start.orientation())
}

fn distance(a: &Pose, b: &Pose) -> f64 {
    let pairs = a.position().into_iter().zip(b.position());
    pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// How near a plan comes to a pose, m.
fn nearest(plan: &Plan, pose: &Pose, tool: Pose) -> f64 {
    let poses = plan
        .cycles()
        .map(|(time, ..)| plan.pose(time).unwrap() * tool);
    poses.map(|at| distance(&at, pose)).fold(f64::MAX, f64::min)
}

#[test]
fn plan_agrees_with_its_motion() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let mut goal = BENT;
        goal[0] = 0.5;
        let motion = left.ptp(goal).speed(0.5);
        let plan = motion.plan().unwrap();
        near(&plan.positions(Duration::ZERO), &BENT, 1e-9);
        near(&plan.end(), &goal, 1e-9);
        let half = plan.first(|_, joints| joints[0] > 0.25).unwrap();
        assert!(half > plan.duration() / 3 && half < plan.duration() * 2 / 3);
        assert!(plan.velocities(half)[0] > 0.1);
        assert_eq!(bench.nets(), 0, "nothing was loaded");
        near(&left.commanded().unwrap(), &BENT, 1e-9);
        let handle = motion.begin().unwrap();
        // The plan of a successor begins where the motion before it ends.
        let next = left.lin(beside(&left, [0.0; 3])).plan();
        assert!(
            next.as_ref().map_or_else(
                |error| matches!(error.kind, ErrorKind::Unreachable { .. }),
                |_| true
            ),
            "{next:?}"
        );
        let next = left.ptp(BENT).plan().unwrap();
        near(&next.positions(Duration::ZERO), &goal, 1e-9);
        assert_eq!(handle.wait(), Ok(Outcome::Completed));
    });
}

#[test]
fn unreachable_path_is_refused_before_loading() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let far = left.lin(beside(&left, [1.0, 0.0, 0.0]));
        let error = far.clone().begin().map(drop).unwrap_err();
        let ErrorKind::Unreachable {
            device, progress, ..
        } = &error.kind
        else {
            panic!("{error}");
        };
        assert_eq!(device, "left");
        assert!((5.0..95.0).contains(progress), "{error}");
        assert_eq!(far.plan().unwrap_err().kind, error.kind);
        let error = left.ptp_to(Pose::xyz(3.0, 0.0, 0.0)).run().unwrap_err();
        assert!(
            matches!(error.kind, ErrorKind::Unreachable { .. }),
            "{error}"
        );
        assert_eq!(bench.nets(), 0);
        near(&left.commanded().unwrap(), &BENT, 1e-9);
    });
}

#[test]
fn too_fast_path_states_the_speed_that_fits() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let fast = CartesianLimits {
            velocity: 3.0,
            acceleration: 30.0,
            jerk: 600.0,
            ..CartesianLimits::default()
        };
        let left = left.with_limits(fast);
        let line = left.lin(beside(&left, [0.0, 0.4, 0.0]));
        let error = line.clone().begin().map(drop).unwrap_err();
        let ErrorKind::TooFast {
            velocity,
            limit,
            speed,
            ..
        } = error.kind
        else {
            panic!("{error}");
        };
        assert!(
            velocity.abs() > limit && (0.05..1.0).contains(&speed),
            "{error}"
        );
        assert!(
            error
                .to_string()
                .contains("hint: the path fits at the speed 0."),
            "{error}"
        );
        assert_eq!(line.clone().speed(speed).plan().map(drop), Ok(()));
        let faster = line.speed((speed * 1.05).min(1.0)).plan();
        assert!(
            matches!(&faster, Err(error) if matches!(error.kind, ErrorKind::TooFast { .. })),
            "{faster:?}"
        );
    });
}

#[test]
fn pose_is_reached_by_joints_near_a_hint() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let tool = Pose::xyz(0.0, 0.0, 0.1);
        let tipped = left.clone().with_tool(tool);
        let goal = beside(&left, [0.05, 0.1, 0.0]);
        assert_eq!(tipped.ptp_to(goal).run(), Ok(Outcome::Completed));
        let reached = left.pose().unwrap() * tool;
        assert!(distance(&reached, &goal) < 1e-6, "{reached:?}");
        let hint = left.commanded().unwrap();
        let back = left.ptp_near(beside(&left, [0.0, -0.1, 0.0]), hint.clone());
        let plan = back.plan().unwrap();
        let end = plan.end();
        let far = end.iter().zip(&hint).map(|(a, b)| (a - b).abs());
        assert!(far.fold(0.0, f64::max) < 0.6, "{:?}", plan.end());
    });
}

#[test]
fn arc_and_curve_pass_through_their_points() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let via = beside(&left, [0.03, 0.05, 0.0]);
        let to = beside(&left, [0.0, 0.1, 0.0]);
        let arc = left.circ(via, to);
        assert!(nearest(&arc.plan().unwrap(), &via, Pose::IDENTITY) < 1e-3);
        assert_eq!(arc.run(), Ok(Outcome::Completed));
        assert!(distance(&left.pose().unwrap(), &to) < 1e-5);
        let through = [[0.0, -0.05, 0.05], [0.0, -0.1, 0.0]].map(|by| beside(&left, by));
        let curve = left.spline(through);
        let plan = curve.plan().unwrap();
        for point in &through {
            assert!(nearest(&plan, point, Pose::IDENTITY) < 1e-3);
        }
        assert_eq!(curve.run(), Ok(Outcome::Completed));
        assert!(distance(&left.pose().unwrap(), &through[1]) < 1e-5);
    });
}

#[test]
fn line_turns_about_the_motion_centre() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let tool = Pose::xyz(0.0, 0.0, 0.15);
        let tip = left.pose().unwrap() * tool;
        let turned = tip * Pose::IDENTITY.abc(0.0, 0.3, 0.0);
        let turn = left.clone().with_tool(tool).lin(turned);
        let plan = turn.plan().unwrap();
        for (time, ..) in plan.cycles() {
            let at = plan.pose(time).unwrap() * tool;
            assert!(distance(&at, &tip) < 1e-6, "{time:?}");
        }
        assert_eq!(turn.run(), Ok(Outcome::Completed));
        let end = left.pose().unwrap();
        assert!(distance(&(end * tool), &tip) < 1e-5);
        assert!(
            distance(&end, &(tip * tool.inverse())) > 0.03,
            "the flange moved"
        );
    });
}

/// Reads both arms in one cycle.
struct Grasp {
    client: Client,
    net: String,
    bases: [Pose; 2],
}

impl Grasp {
    fn new(bench: &Bench, bases: [Pose; 2]) -> Self {
        let mut lines = Vec::new();
        for arm in ["left", "right"] {
            for axis in 0..7 {
                lines.push(format!(
                    "{arm}{axis}=RobotArm::JointMonitor(Robot='{arm}',Axis='{axis}'),\
                     o{arm}{axis}=Core::DoubleNetcommOut(inValue={arm}{axis}.outCommandedPosition,Key='{arm}{axis}')"
                ));
            }
        }
        Self {
            client: Client::connect(&bench.address).unwrap(),
            net: format!("{{{}}}", lines.join(",")),
            bases,
        }
    }

    /// The flange of the right arm in that of the left arm.
    fn read(&self) -> Pose {
        let reply = self.client.call("eva", [self.net.as_str()]).unwrap();
        let values = reply.values[0].as_map().unwrap();
        let kinematics = named("kuka_lwr4").unwrap();
        let flange = |(arm, base): (&str, &Pose)| {
            let joint = |axis| {
                values[&format!("out{arm}{axis}")]
                    .as_str()
                    .unwrap()
                    .parse()
                    .unwrap()
            };
            let joints: Vec<f64> = (0..7).map(joint).collect();
            *base * Pose::from(kinematics.forward(&joints))
        };
        let [left, right] = [("left", &self.bases[0]), ("right", &self.bases[1])].map(flange);
        left.inverse() * right
    }

    /// Largest deviation of the grasp from `held` until a handle ends, m.
    fn deviation(&self, held: &Pose, handle: &takt_api::Handle) -> f64 {
        let mut most = 0.0_f64;
        while handle.outcome().is_none() {
            most = most.max(distance(&self.read(), held));
        }
        most.max(distance(&self.read(), held))
    }
}

/// Two arms that face each other's side, with an object between their flanges.
fn holding(bench: &Bench) -> (takt_api::Cell, [Arm; 2], Pose, Grasp) {
    let (cell, left, right) = bench.arms();
    let bases = [
        Pose::xyz(0.0, 0.3, 0.0).abc(-0.2, 0.0, 0.0),
        Pose::xyz(0.0, -0.3, 0.0).abc(0.2, 0.0, 0.0),
    ];
    let arms = [left.with_base(bases[0]), right.with_base(bases[1])];
    let flanges = [0, 1].map(|arm: usize| bases[arm] * arms[arm].pose().unwrap());
    let (a, b) = (flanges[0].position(), flanges[1].position());
    let object = Pose::xyz((a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0, a[2]);
    (cell, arms, object, Grasp::new(bench, bases))
}

#[test]
fn coupled_arms_keep_their_grasp() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, arms, object, grasp) = holding(&bench);
        let held = grasp.read();
        let part = coupled(object, &arms).unwrap();
        let up = Pose::xyz(0.05, 0.0, 0.1) * object * Pose::IDENTITY.abc(0.1, 0.0, 0.0);
        let lift = part.lin(up);
        let plan = lift.plan().unwrap();
        assert_eq!(plan.partners().len(), 1);
        assert_eq!(plan.partners()[0].duration(), plan.duration());
        let handle = lift.blend(0.7).begin().unwrap();
        let back = part.lin(object).queue().unwrap();
        let most = grasp
            .deviation(&held, &handle)
            .max(grasp.deviation(&held, &back));
        assert_eq!(handle.wait(), Ok(Outcome::TakenOver));
        assert_eq!(back.wait(), Ok(Outcome::Completed));
        // The two arms are read up to a cycle apart: 0.25 mm at this speed.
        assert!(most < 5e-4, "{most} m");
        assert!(distance(&grasp.read(), &held) < 1e-6);
    });
}

/// Moves a held object by x, m, without the check beforehand: both arms brake on its path.
fn brake_on_the_way(x: f64) {
    steady(|| {
        let bench = Bench::start();
        let (_cell, arms, object, grasp) = holding(&bench);
        let held = grasp.read();
        let part = coupled(object, &arms).unwrap();
        let far = part.lin(Pose::xyz(x, 0.2, 0.0) * object);
        let refused = far.clone().begin().map(drop).unwrap_err();
        let is_refused = matches!(
            refused.kind,
            ErrorKind::Unreachable { .. } | ErrorKind::TooFast { .. }
        );
        assert!(is_refused && bench.nets() == 0, "{refused}");
        let handle = far.unchecked().begin().unwrap();
        let most = grasp.deviation(&held, &handle);
        let error = handle.wait().unwrap_err();
        assert!(
            matches!(error.kind, ErrorKind::Unreachable { .. }),
            "{error}"
        );
        assert!(most < 1e-3, "{most} m");
        let back = part.lin(object).speed(0.3);
        assert_eq!(
            back.run(),
            Ok(Outcome::Completed),
            "they can be moved again"
        );
        assert!(distance(&grasp.read(), &held) < 1e-4);
    });
}

#[test]
fn coupled_arms_near_a_singularity_brake_together() {
    brake_on_the_way(0.8);
}

#[test]
fn coupled_arms_out_of_reach_brake_together() {
    brake_on_the_way(-0.8);
}

#[test]
fn coupled_arms_cancelled_brake_together() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, arms, object, grasp) = holding(&bench);
        let held = grasp.read();
        let part = coupled(object, &arms).unwrap();
        let handle = part
            .lin(Pose::xyz(0.0, 0.0, 0.15) * object)
            .begin()
            .unwrap();
        handle.cancel();
        let most = grasp.deviation(&held, &handle);
        assert_eq!(handle.wait(), Ok(Outcome::Cancelled));
        assert!(most < 1e-4, "{most} m");
        let text = |result: Result<_, takt_api::Error>| result.map(drop).unwrap_err().to_string();
        let alone = coupled(object, &arms[..1]).unwrap();
        assert!(text(alone.lin(object).begin()).contains("only one arm"));
        let twice = coupled(object, [&arms[0], &arms[0]]).unwrap();
        assert!(text(twice.lin(object).begin()).contains("coupled with itself"));
        let both = together([part.lin(object), arms[1].ptp(BENT)]).begin();
        assert!(text(both).contains("different devices"));
    });
}

#[test]
fn values_of_a_description_name_the_kinematics() {
    steady(|| {
        let bench = Bench::start();
        let cell = bench.cell();
        assert_eq!(cell.arm("left").unwrap().description().model, "kuka_lwr4");
        let client = Client::connect(&bench.address).unwrap();
        let reply = client.call("din", [] as [&str; 0]).unwrap();
        let left = reply.values[0].as_map().unwrap()["left"].as_map().unwrap();
        assert_eq!(left["kinematics"], Value::from("kuka_lwr4"));
    });
}

#[test]
fn hold_brakes_a_motion_and_is_taken_over() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let mut far = BENT;
        far[0] = 2.0;
        let moving = left.ptp(far).speed(0.3).begin().unwrap();
        let held = left.hold().now().begin().unwrap();
        assert_eq!(moving.wait(), Ok(Outcome::TakenOver));
        let next = left.ptp(BENT).run();
        assert_eq!(next, Ok(Outcome::Completed));
        drop(held);
        near(&left.commanded().unwrap(), &BENT, 1e-9);
        let held = left.hold().begin().unwrap();
        assert_eq!(held.wait(), Ok(Outcome::Maintaining));
        held.cancel();
        left.finish().unwrap();
        near(&left.commanded().unwrap(), &BENT, 1e-9);
    });
}

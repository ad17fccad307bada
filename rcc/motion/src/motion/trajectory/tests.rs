//! Trajectories, checked by their outputs: differences of positions alone give velocity and acceleration.

use takt_net::JointLimits;
use takt_net::value::text::parse_array;
use takt_tests::Random;

use super::*;
use crate::fixture::{Arm, Fixture, PERIOD_S};

fn limits(joints: usize) -> Vec<JointLimits> {
    let limits = JointLimits {
        position_min: -3.0,
        position_max: 3.0,
        velocity_max: 2.0,
        acceleration_max: 10.0,
    };
    vec![limits; joints]
}

fn point(time: f64, positions: &[f64]) -> Waypoint {
    Waypoint {
        time,
        positions: positions.into(),
        ..Waypoint::default()
    }
}

fn rest(positions: &[f64]) -> Vec<State> {
    positions.iter().map(|q| State::at_rest(*q)).collect()
}

#[test]
fn trajectory_passes_its_points_at_their_times() {
    let points = [
        point(0.0, &[0.0, 1.0]),
        point(1.0, &[0.5, 0.8]),
        point(2.0, &[0.7, 0.2]),
        point(3.0, &[0.4, 0.0]),
    ];
    let planned = plan(&rest(&[0.0, 1.0]), &points, &limits(2)).unwrap();
    assert_eq!(planned.joined, 1);
    for point in &points {
        for (joint, wanted) in point.positions.iter().enumerate() {
            let found = planned.table.at(joint, point.time).position;
            assert!((found - wanted).abs() < 1e-12, "{found} {wanted}");
        }
    }
    // A joint that turns back rests there; one that goes on does not.
    assert!(planned.table.at(0, 2.0).velocity.abs() < 1e-12);
    assert!(planned.table.at(1, 2.0).velocity < -0.1);
    assert_eq!(planned.table.at(0, 9.0), State::at_rest(0.4));
}

#[test]
fn polynomials_continue_given_velocities_and_accelerations() {
    let mut random = Random::new(3);
    let mut some = |most: f64| random.between(-most, most);
    let mut points: Vec<_> = (0..5)
        .map(|n| Waypoint {
            time: f64::from(n) * 0.5,
            positions: vec![some(0.2)],
            velocities: vec![some(0.3)],
            accelerations: vec![some(1.0)],
        })
        .collect();
    points[4].velocities = vec![0.0];
    let table = Table::new(points.clone(), 1).unwrap();
    for (number, point) in points.iter().enumerate().take(4) {
        let wanted = [
            point.positions[0],
            point.velocities[0],
            point.accelerations[0],
        ];
        for piece in [number.saturating_sub(1), number] {
            let it = table.in_piece(piece, 0, point.time);
            for (found, wanted) in [it.position, it.velocity, it.acceleration]
                .into_iter()
                .zip(wanted)
            {
                assert!(
                    (found - wanted).abs() < 1e-9,
                    "{number} {piece}: {found} {wanted}"
                );
            }
        }
    }
    let again = Table::parse(&table.text(), 1).unwrap();
    assert_eq!(again, table);
}

#[test]
fn trajectory_beyond_limits_names_joint_time_and_limit() {
    let cause = |points: &[Waypoint]| {
        plan(&rest(&[0.0, 0.0]), points, &limits(2))
            .unwrap_err()
            .to_string()
    };
    let fast = cause(&[point(0.1, &[0.0, 1.0])]);
    assert!(fast.starts_with("joint 1 at 0.0"), "{fast}");
    let far = cause(&[point(5.0, &[3.5, 0.0])]);
    assert!(
        far.contains("joint 0") && far.contains("position") && far.contains("limit 3.0000"),
        "{far}"
    );
    let mut moving = point(2.0, &[0.5, 0.0]);
    moving.velocities = vec![0.2, 0.0];
    let end = cause(&[moving]);
    assert_eq!(end, "joint 0 moves at 0.2 rad/s at the end");
}

#[test]
fn malformed_tables_are_refused() {
    for text in [
        "",
        "0",
        "0 0 0",
        "0 0 0/0 1 0",
        "0 0 0/-1 1 0",
        "1 0 0/2 1 0",
        "0 x 0/1 1 0",
        "0 0 0/1 NaN 0",
        "0 0 0/1 inf 0",
        "0 0 0/1 1 0 0 0",
        "0 0 0/NaN 1 0",
        "0 0 0//1 1 0",
        "0 0 0/1e9 1 0",
    ] {
        assert!(Table::parse(text, 1).is_err(), "{text}");
    }
    let many = vec!["1 0 0"; 20_000].join("/");
    assert!(matches!(
        Table::parse(&many, 1),
        Err(TrajectoryError::Points(_))
    ));
}

/// A trajectory of one joint from 0 to 1 rad in 2 s, at most 0.94 rad/s.
fn there() -> Table {
    plan(&rest(&[0.0]), &[point(2.0, &[1.0])], &limits(1))
        .unwrap()
        .table
}

/// A net: `f` is the commanded position in the cycle before, `m` the measured one, `s` stops.
fn net(table: &Table, more: &str) -> String {
    format!(
        "s=Core::BooleanNetcommIn(Key='s'),m=Core::DoubleArrayNetcommIn(Key='m',Value='[0]'),\
         t=Motion::Trajectory(inStop=s.outValue,inMeasured=m.outValue,Joints='1',Table='{}',\
         Velocity='[2]',Acceleration='[10]',Jerk='[1000]'{more}),\
         p=Core::DoubleArrayNetcommOut(inValue=t.outPosition,Key='p'),\
         v=Core::DoubleArrayNetcommOut(inValue=t.outVelocity,Key='v'),\
         x=Core::DoubleNetcommOut(inValue=t.outTime,Key='t'),\
         d=Core::BooleanNetcommOut(inValue=t.outDone,Key='d'),\
         c=Core::IntNetcommOut(inValue=t.outCode,Key='c'),\
         e=Core::DoubleNetcommOut(inValue=t.outDeviation,Key='e')",
        table.text()
    )
}

struct Run {
    positions: Vec<f64>,
    velocities: Vec<f64>,
    code: String,
    deviation: f64,
}

fn number(fixture: &Fixture, key: &str) -> f64 {
    parse_array::<f64>(&fixture.read(key), 8).unwrap()[0]
}

/// Runs until it is done; `measured` and `stop` by cycle.
fn run(text: &str, measured: impl Fn(usize, f64) -> f64, stop: impl Fn(usize) -> bool) -> Run {
    let mut fixture = Fixture::new(text, &Arm::default());
    let (mut positions, mut velocities) = (vec![0.0], vec![0.0]);
    for cycle in 0..20_000 {
        let last = positions[positions.len() - 1];
        fixture.write("m", &format!("[{}]", measured(cycle, last)));
        fixture.write("s", if stop(cycle) { "true" } else { "false" });
        fixture.step();
        positions.push(number(&fixture, "p"));
        velocities.push(number(&fixture, "v"));
        if fixture.read("d") == "true" {
            return Run {
                positions,
                velocities,
                code: fixture.read("c"),
                deviation: fixture.read("e").parse().unwrap(),
            };
        }
    }
    panic!("it does not end");
}

/// Largest velocity and acceleration, from differences of positions.
fn most(positions: &[f64]) -> (f64, f64) {
    let slopes: Vec<_> = positions
        .windows(2)
        .map(|it| (it[1] - it[0]) / PERIOD_S)
        .collect();
    let largest = |all: &mut dyn Iterator<Item = f64>| all.fold(0.0, |a: f64, b| a.max(b.abs()));
    let velocity = largest(&mut slopes.iter().copied());
    let acceleration = largest(&mut slopes.windows(2).map(|it| (it[1] - it[0]) / PERIOD_S));
    (velocity, acceleration)
}

#[test]
fn trajectory_runs_to_its_end_in_its_time() {
    let run = run(&net(&there(), ""), |_, last| last, |_| false);
    assert_eq!(run.code, "0");
    assert!((run.positions[run.positions.len() - 1] - 1.0).abs() < 1e-12);
    let cycles = 2.0 / PERIOD_S;
    assert!(
        (run.positions.len() as f64 - cycles).abs() < 4.0,
        "{}",
        run.positions.len()
    );
    let (velocity, acceleration) = most(&run.positions);
    assert!(
        velocity < 0.95 && acceleration < 1.5,
        "{velocity} {acceleration}"
    );
}

#[test]
fn stopped_trajectory_brakes_on_path_within_limits() {
    for at in [10, 200, 500, 900] {
        let run = run(&net(&there(), ""), |_, last| last, |cycle| cycle >= at);
        assert_eq!(run.code, "1");
        let (velocity, acceleration) = most(&run.positions);
        assert!(
            velocity < 0.95 && acceleration <= 10.1,
            "{at}: {velocity} {acceleration}"
        );
        let end = run.positions[run.positions.len() - 1];
        assert!(
            end < 1.0 && run.velocities[run.velocities.len() - 1].abs() < 1e-3,
            "{at}: {end}"
        );
        assert!(run.positions.is_sorted(), "{at}");
    }
}

#[test]
fn deviation_on_path_brakes_with_code_and_amount() {
    let net = net(&there(), ",PathTolerance='[0.05]'");
    let run = run(
        &net,
        |cycle, last| if cycle > 300 { last - 0.06 } else { last },
        |_| false,
    );
    assert_eq!(run.code, "-4");
    assert!((run.deviation - 0.06).abs() < 1e-9, "{}", run.deviation);
    assert!(most(&run.positions).1 <= 10.1);
    assert!(run.positions[run.positions.len() - 1] < 0.9);
}

#[test]
fn deviation_at_goal_waits_then_fails() {
    let net = net(&there(), ",GoalTolerance='[0.01]',GoalTime='0.5'");
    let late = run(
        &net,
        |cycle, last| if cycle < 1_100 { last - 0.02 } else { last },
        |_| false,
    );
    assert_eq!(late.code, "0");
    let never = run(&net, |_, last| last - 0.02, |_| false);
    assert_eq!(never.code, "-5");
    assert!((never.deviation - 0.02).abs() < 1e-9);
}

#[test]
fn unknown_position_at_goal_is_no_arrival() {
    let with = |tolerance: &str| {
        let text = net(
            &there(),
            &format!(",GoalTolerance='[{tolerance}]',GoalTime='0.5'"),
        );
        // `z` is never written: the measured positions are null.
        let text = text.replace("inMeasured=m.outValue", "inMeasured=k.outArray");
        format!(
            "z=Core::DoubleNetcommIn(Key='z'),k=Core::DoubleArraySet(inArray=m.outValue,inValue=z.outValue),{text}"
        )
    };
    let last = |_, last| last;
    assert_eq!(run(&with("0.01"), last, |_| false).code, "-5");
    assert_eq!(
        run(&with("0"), last, |_| false).code,
        "0",
        "any end is good"
    );
}

#[test]
fn start_beside_first_point_is_made_up_or_refused() {
    let with = |from: &str| {
        format!(
            "{},f=Core::DoubleArrayNetcommIn(Key='f',Value='[{from}]')",
            net(&there(), ",inFrom=f.outValue")
        )
    };
    let near = run(&with("0.005"), |_, last| last, |_| false);
    assert_eq!(near.code, "0");
    assert!(
        (near.positions[1] - 0.005).abs() < 1e-4,
        "{}",
        near.positions[1]
    );
    assert!((near.positions[near.positions.len() - 1] - 1.0).abs() < 1e-9);
    let far = run(&with("0.5"), |_, last| last, |_| false);
    assert_eq!(far.code, "2");
    assert!((far.positions[far.positions.len() - 1] - 0.5).abs() < 1e-9);
}

#[test]
fn trajectory_from_motion_joins_without_jump() {
    let table = there();
    let limits = limits(1);
    let mut joined = 0;
    for cycle in 1..200 {
        let time = f64::from(cycle) * 0.01;
        let now = table.at(0, time);
        let back = plan(&[now], &[point(0.0, &[0.5]), point(1.5, &[0.0])], &limits);
        let Ok(back) = back else { continue };
        joined += 1;
        let first = back.table.at(0, 0.0);
        assert!((first.position - now.position).abs() < 1e-12);
        assert!((first.velocity - now.velocity).abs() < 1e-12);
        assert!((first.acceleration - now.acceleration).abs() < 1e-9);
    }
    assert!(joined > 190, "{joined}");
    // A point that is too near is left out.
    let soon = [point(0.01, &[0.9]), point(2.0, &[0.0])];
    assert_eq!(plan(&[table.at(0, 1.0)], &soon, &limits).unwrap().joined, 1);
    let none = plan(&[table.at(0, 1.0)], &soon[..1], &limits).unwrap_err();
    assert!(matches!(none, TrajectoryError::Unjoined(_)), "{none}");
}

#[test]
fn joining_begins_in_any_motion_without_jump() {
    // The table was planned from rest at 0; the joint is elsewhere and moves when the net begins.
    let with = |from: [f64; 3], more: &str| {
        let [position, velocity, acceleration] = from;
        let states = format!(
            "f=Core::DoubleArrayNetcommIn(Key='f',Value='[{position}]'),\
             g=Core::DoubleArrayNetcommIn(Key='g',Value='[{velocity}]'),\
             h=Core::DoubleArrayNetcommIn(Key='h',Value='[{acceleration}]')"
        );
        let ports = ",inFrom=f.outValue,inFromVelocity=g.outValue,inFromAcceleration=h.outValue";
        format!("{},{states}", net(&there(), &format!("{ports}{more}")))
    };
    for from in [[0.05, 0.3, 0.5], [-0.2, -0.4, 0.0], [0.0, 0.0, 0.0]] {
        let mut run = run(&with(from, ",Join='true'"), |_, last| last, |_| false);
        assert_eq!(run.code, "0", "{from:?}");
        run.positions[0] = from[0];
        let first = (run.positions[1] - run.positions[0]) / PERIOD_S;
        assert!((first - from[1]).abs() < 0.02, "{from:?}: {first}");
        let (velocity, acceleration) = most(&run.positions);
        assert!(
            velocity < 2.0 && acceleration < 10.1,
            "{from:?}: {velocity} {acceleration}"
        );
        let last = run.positions[run.positions.len() - 1];
        assert!((last - 1.0).abs() < 1e-9, "{from:?}: {last}");
        if from[1] != 0.0 {
            let strict = self::run(&with(from, ""), |_, last| last, |_| false);
            assert_eq!(strict.code, "2", "{from:?}");
        }
    }
    // Too far to be at the end of the table in time within the limits: it brakes where it is.
    let fast = run(
        &with([-2.0, -1.9, 0.0], ",Join='true'"),
        |_, last| last,
        |_| false,
    );
    assert_eq!(fast.code, "2");
    let (velocity, acceleration) = most(&fast.positions[1..]);
    assert!(
        velocity < 2.0 && acceleration < 10.1,
        "{velocity} {acceleration}"
    );
}

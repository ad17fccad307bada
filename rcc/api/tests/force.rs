//! Motions under force and control modes, on an emulated LWR above a table that can vanish.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::Duration;

use takt_api::{
    Arm, CartesianLimits, Cell, Control, Direction, ErrorKind, ForceLimits, Handle,
    JointTrajectory, Outcome, Pose,
};
use takt_embedded::{Embedded, EmulatedCell};
use takt_tests::steady;

/// The flange points down.
const ABOVE: [f64; 7] = [0.0, 0.6, 0.0, -1.3, 0.0, 1.241_592_653_589_793, 0.0];
const DOWN: [f64; 3] = [0.0, 0.0, -1.0];
const FORCE: f64 = 20.0;
/// Longest time that tests wait for an outcome.
const TIMEOUT: Duration = Duration::from_secs(20);
const PAUSE: Duration = Duration::from_millis(5);

/// The arm, 1 cm above the table.
fn above_table() -> (Cell, Arm) {
    // Where the host stalls, an arm that goes on meets a stiff table with another force.
    takt_api::simulate_time(1.0).unwrap();
    let cell = Cell::emulated("lwr_table").unwrap();
    let arm = cell.arm("arm").unwrap();
    assert_eq!(arm.ptp(ABOVE).run(), Ok(Outcome::Completed));
    let table = cell.frame("table").unwrap();
    let here = arm.pose().unwrap();
    let [x, y, _] = here.position();
    let above = Pose::quaternion([x, y, 0.0], here.orientation());
    let height = table.within(arm.base_frame()).unwrap().position()[2];
    let above = Pose::xyz(0.0, 0.0, height + 0.01) * above;
    assert_eq!(arm.lin(above).run(), Ok(Outcome::Completed));
    (cell, arm)
}

fn force(cell: &Cell, arm: &Arm) -> f64 {
    cell.value(&arm.force().z()).unwrap().unwrap()
}

/// The force in each of some readings.
fn forces(cell: &Cell, arm: &Arm, readings: usize) -> Vec<f64> {
    let read = |_| {
        std::thread::sleep(PAUSE);
        force(cell, arm)
    };
    (0..readings).map(read).collect()
}

fn ended(handle: &Handle) -> Result<Outcome, ErrorKind> {
    let ended = handle.wait_to_end_for(TIMEOUT).expect("it ends");
    ended.map_err(|error| error.kind)
}

fn drop_table(cell: &Cell) {
    let io = cell.io("arm").unwrap();
    assert_eq!(io.set(0, true).run(), Ok(Outcome::Completed));
}

fn rests(arm: &Arm) {
    let before = arm.commanded().unwrap();
    std::thread::sleep(Duration::from_millis(100));
    let after = arm.commanded().unwrap();
    let near = before.iter().zip(&after).all(|(a, b)| (a - b).abs() < 1e-9);
    assert!(near, "{before:?} {after:?}");
    let limits = &arm.description().joints;
    let in_range = |(q, limits): (&f64, &takt_api::motion::JointLimits)| {
        (limits.position_min..=limits.position_max).contains(q)
    };
    assert!(after.iter().zip(limits).all(in_range));
}

#[test]
fn press_holds_force_without_overshoot() {
    steady(|| {
        let (cell, arm) = above_table();
        let press = arm.press(DOWN, FORCE).begin().unwrap();
        let mut most: f64 = 0.0;
        while press.outcome().is_none() {
            most = most.max(force(&cell, &arm));
        }
        assert_eq!(press.wait(), Ok(Outcome::Maintaining));
        assert!(most < FORCE + 5.0, "{most} N");
        let held = forces(&cell, &arm, 50);
        assert!(held.iter().all(|it| (it - FORCE).abs() < 2.0), "{held:?}");
        // A motion takes over, and leaves the table.
        assert_eq!(arm.ptp(ABOVE).run(), Ok(Outcome::Completed));
        assert_eq!(press.wait_to_end(), Ok(Outcome::TakenOver));
        assert!(force(&cell, &arm).abs() < 0.1);
        cell.close().unwrap();
    });
}

#[test]
fn press_hands_over_to_greater_force_without_leaving() {
    steady(|| {
        let (cell, arm) = above_table();
        let table = cell.frame("table").unwrap();
        let down = table.direction(DOWN);
        assert_eq!(arm.press(down, 10.0).run(), Ok(Outcome::Maintaining));
        let second = arm.press(Direction::of_centre([0.0, 0.0, 1.0]), 30.0);
        let second = second.begin().unwrap();
        let mut least = f64::INFINITY;
        while second.outcome().is_none() {
            least = least.min(force(&cell, &arm));
        }
        assert_eq!(second.wait(), Ok(Outcome::Maintaining));
        assert!(least > 7.0, "{least} N");
        let held = forces(&cell, &arm, 20);
        assert!(held.iter().all(|it| (it - 30.0).abs() < 2.0), "{held:?}");
        arm.finish().unwrap();
        assert_eq!(second.wait_to_end(), Ok(Outcome::Completed));
        cell.close().unwrap();
    });
}

#[test]
fn press_to_moves_aside_under_force() {
    steady(|| {
        let (cell, arm) = above_table();
        assert_eq!(arm.press(DOWN, FORCE).run(), Ok(Outcome::Maintaining));
        let start = arm.pose().unwrap();
        // Its height does not matter.
        let to = Pose::xyz(0.0, 0.1, 0.3) * start;
        let slow = arm.clone().with_limits(CartesianLimits {
            velocity: 0.1,
            ..CartesianLimits::default()
        });
        let aside = slow.press_to(to, DOWN, FORCE).begin().unwrap();
        let mut held = Vec::new();
        while aside.outcome().is_none() {
            held.push(force(&cell, &arm));
            std::thread::sleep(PAUSE);
        }
        assert_eq!(aside.wait(), Ok(Outcome::Maintaining));
        assert!(held.iter().all(|it| (it - FORCE).abs() < 5.0), "{held:?}");
        let ([x, y, _], at) = (start.position(), arm.pose().unwrap().position());
        assert!(
            (at[0] - x).abs() < 2e-3 && (at[1] - y - 0.1).abs() < 2e-3,
            "{at:?}"
        );
        arm.cancel();
        assert_eq!(aside.wait_to_end(), Ok(Outcome::Completed));
        rests(&arm);
        cell.close().unwrap();
    });
}

#[test]
fn press_ends_as_requested_when_table_vanishes() {
    steady(|| {
        let (cell, arm) = above_table();
        let force = || arm.force().z();
        let vanished = force().under(2.0).after(force().over(10.0));
        let press = arm.press(DOWN, FORCE).until("vanished", vanished);
        let press = press.begin().unwrap();
        assert_eq!(press.wait(), Ok(Outcome::Maintaining));
        let before = arm.pose().unwrap().position()[2];
        drop_table(&cell);
        assert_eq!(ended(&press), Ok(Outcome::Stopped("vanished".to_owned())));
        rests(&arm);
        let down = before - arm.pose().unwrap().position()[2];
        assert!((-1e-3..5e-3).contains(&down), "{down} m");
        cell.close().unwrap();
    });
}

#[test]
fn press_lost_contact_is_error_at_rest() {
    steady(|| {
        let (cell, arm) = above_table();
        let press = arm.press(DOWN, FORCE).begin().unwrap();
        assert_eq!(press.wait(), Ok(Outcome::Maintaining));
        let before = arm.pose().unwrap().position()[2];
        drop_table(&cell);
        let error = ended(&press).unwrap_err();
        assert!(matches!(error, ErrorKind::ContactLost { .. }), "{error}");
        rests(&arm);
        let down = before - arm.pose().unwrap().position()[2];
        assert!((-1e-3..5e-3).contains(&down), "{down} m");
        // The program goes on.
        assert_eq!(arm.ptp(ABOVE).run(), Ok(Outcome::Completed));
        cell.close().unwrap();
    });
}

#[test]
fn press_without_contact_fails_after_travel() {
    steady(|| {
        let (cell, arm) = above_table();
        drop_table(&cell);
        let before = arm.pose().unwrap().position()[2];
        let limits = ForceLimits {
            travel: 0.03,
            approach: 0.05,
            ..ForceLimits::default()
        };
        let press = arm.clone().with_force_limits(limits).press(DOWN, FORCE);
        let error = press.run().unwrap_err().kind;
        assert!(
            matches!(error, ErrorKind::ForceNotReached { .. }),
            "{error}"
        );
        rests(&arm);
        let down = before - arm.pose().unwrap().position()[2];
        assert!((0.029..0.036).contains(&down), "{down} m");
        cell.close().unwrap();
    });
}

#[test]
fn press_beyond_force_limit_stops() {
    steady(|| {
        let (cell, arm) = above_table();
        // 5 mm further at once, by the table's stiffness, is more than the limit.
        let limits = ForceLimits {
            approach: 0.1,
            force_max: 22.5,
            damping: 500.0,
            velocity: 0.1,
            ..ForceLimits::default()
        };
        let press = arm.clone().with_force_limits(limits).press(DOWN, FORCE);
        let error = press.run().unwrap_err().kind;
        let ErrorKind::ForceExceeded { limit, .. } = error else {
            panic!("{error}");
        };
        assert!((limit - 22.5).abs() < 1e-12);
        rests(&arm);
        cell.close().unwrap();
    });
}

#[test]
fn impedance_gives_way_and_position_returns() {
    steady(|| {
        let (cell, arm) = above_table();
        let soft = Control::cartesian([2000.0, 2000.0, 1000.0, 200.0, 200.0, 200.0], [0.7; 6]);
        assert_eq!(arm.switch_to(soft).run(), Ok(Outcome::Completed));
        // 2 cm below, 1 cm below the surface: the springs of the arm and of the table share it.
        let below = Pose::xyz(0.0, 0.0, -0.02) * arm.pose().unwrap();
        assert_eq!(arm.lin(below).speed(0.2).run(), Ok(Outcome::Completed));
        std::thread::sleep(Duration::from_millis(500));
        let pushed = force(&cell, &arm);
        let shared = 0.01 / (1.0 / 1000.0 + 1.0 / 10_000.0);
        assert!((pushed - shared).abs() < 1.5, "{pushed} N, not {shared} N");
        let above = Pose::xyz(0.0, 0.0, 0.02) * below;
        assert_eq!(arm.lin(above).run(), Ok(Outcome::Completed));
        // A spring still swings; the switch waits until it rests.
        let stiff = Control::position();
        assert_eq!(arm.switch_to(stiff).run(), Ok(Outcome::Completed));
        assert_eq!(arm.press(DOWN, FORCE).run(), Ok(Outcome::Maintaining));
        cell.close().unwrap();
    });
}

#[test]
fn impedance_of_arm_that_never_rests_is_refused_with_remedy() {
    steady(|| {
        let embedded = Embedded::emulate(EmulatedCell::named("lwr_table").unwrap()).unwrap();
        let address = embedded.address().to_string();
        let cells = [(); 2].map(|()| Cell::connect(&address).unwrap());
        let [arm, moved] = cells.each_ref().map(|cell| cell.arm("arm").unwrap());
        assert_eq!(moved.ptp(ABOVE).run(), Ok(Outcome::Completed));
        // Another program moves the arm for longer than the switch waits.
        let mut away = ABOVE;
        away[0] = 1.5;
        let motion = moved.ptp(away).speed(0.04).begin().unwrap();
        while arm.positions().unwrap()[0] < 0.02 && motion.outcome().is_none() {}
        let soft = Control::cartesian([2000.0; 6], [0.7; 6]);
        let error = arm.switch_to(soft).run().unwrap_err();
        assert!(motion.outcome().is_none(), "{:?}", motion.outcome());
        let text = error.to_string();
        assert!(text.contains("does not come to rest"), "{text}");
        assert!(text.contains("\nhint: does anything push it?"), "{text}");
        motion.cancel();
        for cell in cells {
            cell.close().unwrap();
        }
        embedded.stop().unwrap();
    });
}

#[test]
fn impedance_unsupported_by_robot_is_typed_error() {
    steady(|| {
        let cell = Cell::emulated("iiwa").unwrap();
        let arm = cell.arm("arm").unwrap();
        let soft = Control::joints([300.0; 7], [0.7; 7]);
        let error = arm.switch_to(soft).run().unwrap_err().kind;
        assert!(matches!(error, ErrorKind::Unsupported { .. }), "{error}");
        assert!(error.to_string().contains("\nhint:"), "{error}");
        let wrong = Control::joints([300.0; 6], [0.7; 7]);
        let error = arm.switch_to(wrong).run().unwrap_err().kind;
        assert!(matches!(error, ErrorKind::Invalid(_)), "{error}");
        cell.close().unwrap();
    });
}

#[test]
fn trajectory_beyond_its_tolerance_names_joint_and_deviation() {
    steady(|| {
        let (_cell, arm) = above_table();
        let mut up = arm.commanded().unwrap();
        let start = up.clone();
        up[5] += 0.5;
        // The emulated robot follows its set-points some cycles later.
        let trajectory = JointTrajectory::new()
            .point(1.0, up)
            .point(2.0, start)
            .path_tolerance([1e-5]);
        let error = arm.trajectory(trajectory).run().unwrap_err();
        let ErrorKind::Deviation {
            joint: 5,
            place: "path",
            deviation,
            ..
        } = error.kind
        else {
            panic!("{error}");
        };
        assert!((1e-5..0.1).contains(&deviation), "{deviation}");
        assert_eq!(arm.ptp(ABOVE).run(), Ok(Outcome::Completed));
    });
}

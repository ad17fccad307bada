//! Two emulated arms hold one object, and one of them fails: the other comes to rest on the common path.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

use std::time::Duration;

use takt_api::{Arm, Cell, ErrorKind, Handle, Outcome, Pose, coupled, deg, together};
use takt_embedded::Embedded;
use takt_tests::steady;

const BENT: [f64; 7] = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];

/// Where the flange of an arm is commanded to be, in its base: position, and orientation as a quaternion.
fn flange(arm: &Arm) -> ([f64; 3], [f64; 4]) {
    let kinematics = takt_motion::kinematics::named("kuka_lwr4").unwrap();
    let pose = Pose::from(kinematics.forward(&arm.commanded().unwrap()));
    (pose.position(), pose.orientation())
}

/// Largest distance of a flange from the vertical line through its start, m, and largest change of its quaternion, until an
/// activity has ended.
fn deviation(arm: &Arm, (start, upright): ([f64; 3], [f64; 4]), handle: &Handle) -> (f64, f64) {
    let (mut far, mut turned): (f64, f64) = (0.0, 0.0);
    loop {
        let has_ended = handle.outcome().is_some();
        let (at, orientation) = flange(arm);
        far = far.max((at[0] - start[0]).hypot(at[1] - start[1]));
        let pairs = || orientation.iter().zip(upright);
        let change = |sign: f64| {
            pairs()
                .map(|(a, b)| (a - sign * b).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        turned = turned.max(change(1.0).min(change(-1.0)));
        if has_ended {
            return (far, turned);
        }
    }
}

#[test]
fn coupled_partner_rests_on_path_when_arm_fails() {
    steady(|| {
        let embedded = Embedded::emulated("two_lwr").unwrap();
        let address = embedded.address().to_string();
        let cell = Cell::connect_with(&address, embedded.token()).unwrap();
        let arms = ["left", "right"].map(|name| cell.arm(name).unwrap());
        let bent = together(arms.iter().map(|arm| arm.ptp(BENT))).run();
        assert_eq!(bent, Ok(Outcome::Completed));
        let start = flange(&arms[0]);
        let object = Pose::quaternion(start.0, start.1);
        // In the world of the cell, up is up in both bases.
        let object = arms[0].base() * object;
        let part = coupled(object, &arms).unwrap();
        let lift = part.lin(Pose::xyz(0.0, 0.0, 0.2) * object);
        let handle = lift.begin().unwrap();
        let has_moved = || flange(&arms[0]).0[2] > start.0[2] + 0.04;
        while !has_moved() && handle.outcome().is_none() {
            std::thread::sleep(Duration::from_millis(2));
        }
        let machines = embedded.machines().unwrap();
        let (_, right) = machines
            .krcs()
            .iter()
            .find(|(name, _)| name == "right")
            .unwrap();
        right.status().set_power(false);
        let (far, turned) = deviation(&arms[0], start, &handle);
        let error = handle.wait().unwrap_err();
        assert!(
            matches!(&error.kind, ErrorKind::DeviceFailed { device, .. } if device == "right"),
            "{error}"
        );
        assert!(far < 1e-4 && turned < 1e-4, "{far} m, {turned}");
        let rest = flange(&arms[0]).0[2] - start.0[2];
        assert!(
            (0.04..0.2).contains(&rest),
            "it braked {rest} m above its start"
        );
        // The partner can be used again.
        assert_eq!(arms[0].ptp(BENT).run(), Ok(Outcome::Completed));
    });
}

/// Towards a stretched arm joints turn further per way of the object, but not faster where the object already brakes.
#[test]
fn coupled_motion_with_plan_completes() {
    steady(|| {
        let cell = Cell::emulated("two_lwr").unwrap();
        let arms = [
            cell.arm("left")
                .unwrap()
                .with_base(Pose::xyz(0.0, 0.3, 0.0).abc(-0.2, 0.0, 0.0)),
            cell.arm("right")
                .unwrap()
                .with_base(Pose::xyz(0.0, -0.3, 0.0).abc(0.2, 0.0, 0.0)),
        ];
        let bent = [0.0, 30.0, 0.0, -70.0, 0.0, 45.0, 0.0].map(deg);
        let bent = together(arms.each_ref().map(|arm| arm.ptp(bent))).run();
        assert_eq!(bent, Ok(Outcome::Completed));
        let [left, right] = &arms;
        let side = |arm: &Arm, y: f64| {
            let base = arm.base();
            arm.lin(base.inverse() * Pose::xyz(0.0, y, 0.0) * base * arm.pose().unwrap())
        };
        let reach = together([side(left, -0.04), side(right, 0.04)]).run();
        assert_eq!(reach, Ok(Outcome::Completed));
        let places = [left, right].map(|arm| (arm.base() * arm.pose().unwrap()).position());
        let [[a, b, c], [d, e, f]] = places;
        let table = Pose::xyz((a + d) / 2.0, (b + e) / 2.0, (c + f) / 2.0);
        let held = coupled(table, &arms).unwrap().with_speed(0.25);
        let above = Pose::xyz(0.0, 0.0, 0.1) * table;
        let aside = Pose::xyz(-0.05, 0.05, 0.0) * above * Pose::IDENTITY.abc(0.15, 0.0, 0.0);
        for goal in [above, aside, above, table] {
            let motion = held.lin(goal);
            motion.plan().unwrap();
            assert_eq!(motion.run(), Ok(Outcome::Completed), "{goal:?}");
        }
    });
}

//! Two emulated arms hold one object, and one of them fails: the other comes to rest on the common path.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

use std::time::Duration;

use takt_api::{Arm, Cell, ErrorKind, Handle, Outcome, Pose, coupled, together};
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

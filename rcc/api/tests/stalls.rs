//! A host that stands for some cycles while two emulated arms lift one object: what the drivers report goes on, the motion does
//! not.

use std::process::Command;

use takt_api::{Cell, Outcome, Pose, coupled, together};

const BENT: [f64; 7] = [0.0, 0.6, 0.0, -1.1, 0.0, 0.7, 0.0];

/// Stops a process for 5 ms, thirty times.
const STALLS: &str =
    "for n in $(seq 30); do sleep 0.1; kill -STOP $1; sleep 0.005; kill -CONT $1; done";

#[test]
fn coupled_motion_goes_on_after_stalls_of_its_host() {
    let cell = Cell::emulated("two_lwr").unwrap();
    let arms = [("left", 0.3), ("right", -0.3)].map(|(name, y)| {
        let arm = cell.arm(name).unwrap();
        arm.with_base(Pose::xyz(0.0, y, 0.0))
    });
    let bent = together(arms.iter().map(|arm| arm.ptp(BENT))).run();
    assert_eq!(bent, Ok(Outcome::Completed));
    let low = Pose::xyz(0.6, 0.0, 0.5);
    let object = coupled(low, &arms).unwrap();
    let process = std::process::id().to_string();
    let mut stalls = Command::new("sh")
        .args(["-c", STALLS, "sh", &process])
        .spawn()
        .unwrap();
    while stalls.try_wait().unwrap().is_none() {
        for height in [0.1, 0.0] {
            let goal = Pose::xyz(0.0, 0.0, height) * low;
            assert_eq!(object.lin(goal).run(), Ok(Outcome::Completed));
        }
    }
}

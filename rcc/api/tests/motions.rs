//! Motions of emulated arms at their limits.

use takt_api::{Cell, Outcome, Pose, deg};
use takt_tests::steady;

/// A full speed arc would need five times the acceleration and many times the jerk.
#[test]
fn tight_arc_is_slowed_by_its_bend() {
    steady(|| {
        let cell = Cell::emulated("two_lwr").unwrap();
        let left = cell.arm("left").unwrap();
        let bent = [0.0, 30.0, 0.0, -70.0, 0.0, 45.0, 0.0].map(deg);
        left.ptp(bent).run().unwrap();
        let start = left.pose().unwrap();
        let at = |y: f64, z: f64| Pose::xyz(0.0, y, z) * start;
        let arc = left.circ(at(0.021, 0.021), at(0.042, 0.0));
        let planned = arc.plan().unwrap().duration();
        assert!(planned.as_secs_f64() > 1.0, "{planned:?}");
        assert_eq!(arc.run(), Ok(Outcome::Completed));
        // Taken over on the way, and back.
        let back = left.circ(at(0.021, 0.021), start);
        let lines = [at(0.1, 0.0), at(0.042, 0.0)].map(|to| left.lin(to).blend(0.7));
        let lines = lines.map(|line| line.begin().unwrap());
        assert_eq!(back.run(), Ok(Outcome::Completed));
        for line in lines {
            assert_eq!(line.wait(), Ok(Outcome::TakenOver));
        }
    });
}

//! The example of long chains, with fewer activities.

#[allow(dead_code, reason = "its main function prints")]
#[path = "../examples/hand_overs.rs"]
mod hand_overs;

use takt_tests::steady;

/// What the process may gain between a third and the end: threads and buffers that come into use late.
const GAIN_KIB_MAX: u64 = 16 << 10;

#[test]
fn blended_activities_miss_no_hand_over() {
    steady(|| {
        let report = hand_overs::run(4, 120).unwrap();
        assert_eq!(report.activities, 120);
        assert_eq!(report.missed, 0, "{report:?}");
        assert_eq!(report.rests, 0, "{report:?}");
        assert!(report.nets_most <= 4, "{report:?}");
        let [before, after] = report.memory_kib;
        assert!(after <= before + GAIN_KIB_MAX, "{report:?}");
    });
}

//! The phase of the driver's cycle to SYNC0 of an emulated segment whose clocks drift, in virtual time.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

#[path = "common/phase.rs"]
mod phase;

use std::time::Duration;

use phase::{rms_ns, run};

const AFTER: Duration = Duration::from_secs(2);

#[test]
fn clock_drift_50_ppm_followed_within_5_us() {
    for drifts in [[50_000, -50_000, 0], [-50_000, 50_000, 20_000]] {
        let points = run(&drifts, 10e3, Duration::from_secs(5));
        let rms = rms_ns(&points, AFTER);
        assert!(points.len() > 4500, "{}", points.len());
        assert!(rms < 5000.0, "{rms} ns rms");
        // The servo cannot remove the delays of host and segment.
        let mut later = points.iter().filter(|point| point.at >= AFTER);
        assert!(later.all(|point| point.frame_ns >= point.cycle_ns));
    }
}

#[test]
fn clock_phase_is_that_of_the_segment() {
    // Its clock left alone would be 150 us off after three seconds.
    let points = run(&[50_000], 0.0, Duration::from_secs(5));
    let last = points.last().unwrap();
    // Half of the delay through the segment: no master can distinguish it from a path as long in both directions.
    assert!(last.cycle_ns.abs() < 500, "{last:?}");
    assert!(rms_ns(&points, AFTER) < 500.0);
}

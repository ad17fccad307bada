//! Odometry: integrates displacements of a base to its pose. The caller converts wheel rotations to displacements.

/// Pose in the plane in which the base started.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Forward at the start, m.
    pub x: f64,
    /// To the left at the start, m.
    pub y: f64,
    /// Heading, rad, counter-clockwise; it is not wrapped.
    pub heading: f64,
}

/// Integrates displacements with the heading in the middle of each.
#[derive(Clone, Copy, Debug, Default)]
pub struct Odometer {
    pose: Pose,
}

impl Odometer {
    /// The pose so far.
    pub const fn pose(&self) -> Pose {
        self.pose
    }

    /// Adds a displacement in the base's own frame: forward and left, m, and rotation, rad.
    pub fn add(&mut self, [forward, left, rotation]: [f64; 3]) {
        let (sin, cos) = (self.pose.heading + rotation / 2.0).sin_cos();
        self.pose.x += cos * forward - sin * left;
        self.pose.y += sin * forward + cos * left;
        self.pose.heading += rotation;
    }
}

/// A 32-bit counter that wraps, starts at any value, and may be reset by others: implausible steps are rejected.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counter {
    last: Option<i32>,
    jumps: u64,
    /// The step that was not believed just now, and the largest that would have been, counts.
    refused: Option<[f64; 2]>,
}

/// A displacement that a power base cannot have driven since the last one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jump {
    /// By how much, m, or rad where the base turns.
    pub by: f64,
    /// The largest that is believed.
    pub most: f64,
    /// Whether it is of the heading.
    pub is_turn: bool,
}

impl Counter {
    /// Counts since the last value. `expected` is the step by the measured speed; it replaces a step that differs by
    /// more than `tolerance`.
    pub(super) fn advance(&mut self, value: i32, expected: f64, tolerance: f64) -> f64 {
        self.refused = None;
        let Some(last) = self.last.replace(value) else {
            return 0.0;
        };
        let step = f64::from(value.wrapping_sub(last));
        if (step - expected).abs() <= tolerance {
            return step;
        }
        self.jumps += 1;
        self.refused = Some([step.abs(), expected.abs() + tolerance]);
        expected
    }

    /// What it did not believe in the last step, where so many counts are one of the unit.
    pub(super) fn jump(&self, per_unit: f64, is_turn: bool) -> Option<Jump> {
        let [by, most] = self.refused?.map(|counts| counts / per_unit.abs());
        Some(Jump { by, most, is_turn })
    }

    pub(super) const fn jumps(&self) -> u64 {
        self.jumps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn odometry_circle_ends_at_start() {
        let mut odometer = Odometer::default();
        let steps = 10_000;
        let angle = std::f64::consts::TAU / f64::from(steps);
        for _ in 0..steps {
            odometer.add([0.5 * angle, 0.0, angle]);
        }
        let pose = odometer.pose();
        assert!(pose.x.hypot(pose.y) < 1e-9, "{pose:?}");
        assert!((pose.heading - std::f64::consts::TAU).abs() < 1e-9);
    }

    #[test]
    fn odometry_counters_wrap_and_survive_reset() {
        let mut counter = Counter::default();
        let mut advance = |value| counter.advance(value, 10.0, 200.0);
        assert_eq!(
            advance(i32::MAX - 5).total_cmp(&0.0),
            std::cmp::Ordering::Equal
        );
        assert!((advance(i32::MIN + 4) - 10.0).abs() < 1e-12);
        assert!((advance(0) - 10.0).abs() < 1e-12, "a reset is not a motion");
        assert!((advance(150) - 150.0).abs() < 1e-12);
        assert_eq!(counter.jumps(), 1);
    }
}

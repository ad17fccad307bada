//! Torques by the weight of an arm's links: each joint carries all links behind it, in their present posture. The
//! inertia of links is not modelled: joints are dynamically decoupled.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// m/s².
const GRAVITY: f64 = 9.81;
/// Upper arm and forearm, m.
const LENGTHS: [f64; 2] = [0.155, 0.135];
/// Masses, kg, their segment and distance from its start, m: from the vendor's model of the arm.
const LINKS: [(usize, f64, f64); 5] = [
    (0, 1.318, 0.114),
    (1, 0.821, 0.104),
    (2, 0.769, 0.0535),
    (2, 0.687, 0.1135),
    (2, 0.119, 0.156),
];
/// Angles of axes 2 to 4 at the home stop, degrees (0 is upright), and their sign away from the stop.
const AXES: [(f64, f64); 3] = [(-65.0, 1.0), (146.0, -1.0), (-102.5, 1.0)];

/// Distances of the joints of one arm from their home stops, rad; shared by its drives.
#[derive(Clone, Debug)]
pub(super) struct Posture(Arc<[AtomicU64; 5]>);

impl Posture {
    pub(super) fn new(angles: [f64; 5]) -> Self {
        Self(Arc::new(
            angles.map(|angle| AtomicU64::new(angle.to_bits())),
        ))
    }

    /// Sets the angle of joint `number`; returns the torque of the weight there, N m, positive away from the stop.
    pub(super) fn weigh(&self, number: usize, angle: f64) -> f64 {
        let Some(joint) = self.0.get(number) else {
            return 0.0;
        };
        joint.store(angle.to_bits(), Ordering::Relaxed);
        let angles = self.0.each_ref();
        let torque = weight(angles.map(|angle| f64::from_bits(angle.load(Ordering::Relaxed))));
        torque.get(number).copied().unwrap_or(0.0)
    }
}

fn weight(angles: [f64; 5]) -> [f64; 5] {
    // Tilt of each segment, and its start in front of axis 2.
    let (mut tilt, mut begin) = (0.0, 0.0);
    let mut segments = [(0.0, 0.0); 3];
    for (i, segment) in segments.iter_mut().enumerate() {
        let (home, sign) = AXES[i];
        tilt += home.to_radians() + sign * angles[i + 1];
        *segment = (begin, tilt);
        begin += LENGTHS.get(i).map_or(0.0, |length| length * tilt.sin());
    }
    let mut torques = [0.0; 5];
    for (axis, (at, _)) in segments.into_iter().enumerate() {
        let carried = LINKS.iter().filter(|(segment, ..)| *segment >= axis);
        let moment: f64 = carried
            .map(|(segment, mass, along)| {
                let (begin, tilt) = segments[*segment];
                mass * (begin + along * tilt.sin() - at)
            })
            .sum();
        torques[axis + 1] = AXES[axis].1 * GRAVITY * moment;
    }
    torques
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arm_weight_is_zero_upright_and_largest_flat() {
        let upright = [0.0, 65.0, 146.0, 102.5, 0.0].map(f64::to_radians);
        assert!(weight(upright).iter().all(|torque| torque.abs() < 1e-9));
        let flat = [0.0, 155.0, 146.0, 102.5, 0.0].map(f64::to_radians);
        let [base, shoulder, elbow, wrist, hand] = weight(flat);
        // Its data sheet allows 9.5 N m at the shoulder, which has to be enough for this.
        assert!((9.0..9.5).contains(&shoulder), "{shoulder}");
        assert!(
            elbow < 0.0 && wrist > 0.0,
            "both fall forward: {elbow} {wrist}"
        );
        assert!(base.abs() < 1e-12 && hand.abs() < 1e-12);
    }
}

//! Torques that hold the arm's own weight, for torque-controlled joints. The arm is assumed upright on level ground;
//! payload and slope are not included.

/// m/s².
const GRAVITY: f64 = 9.81;
/// Mass times distance beyond the axis, kg m, of upper arm, forearm and hand when they lie flat: the masses of the
/// vendor's arm model, with the masses behind a segment at its end.
const MOMENTS: [f64; 3] = [
    1.318 * 0.114 + (0.821 + HAND) * 0.155,
    0.821 * 0.104 + HAND * 0.135,
    0.769 * 0.0535 + 0.687 * 0.1135 + 0.119 * 0.156,
];
/// Mass behind axis 4, kg.
const HAND: f64 = 0.769 + 0.687 + 0.119;
/// Angles of axes 2 to 4 at the home stop, degrees; 0 is upright.
const HOME: [f64; 3] = [-65.0, 146.0, -102.5];

/// Torques at the joints that hold the arm where it is, N m, for angles as [`ARM`](super::ARM) counts them, rad.
pub fn holding(joints: &[f64; 5]) -> [f64; 5] {
    let [_, shoulder, elbow, wrist, _] = joints;
    let mut tilt = 0.0;
    let mut flat = [0.0; 3];
    for (i, joint) in [shoulder, elbow, wrist].into_iter().enumerate() {
        tilt += HOME[i].to_radians() + joint;
        flat[i] = GRAVITY * MOMENTS[i] * tilt.sin();
    }
    let [upper, fore, hand] = flat;
    // An axis carries all segments behind it.
    [0.0, -(upper + fore + hand), -(fore + hand), -hand, 0.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holding_torques_stay_within_the_data_sheet() {
        let upright = [0.0, 65.0, -146.0, 102.5, 0.0].map(f64::to_radians);
        assert!(holding(&upright).iter().all(|torque| torque.abs() < 1e-9));
        let flat = [0.0, 155.0, -146.0, 102.5, 0.0].map(f64::to_radians);
        let [_, shoulder, elbow, wrist, _] = holding(&flat);
        assert!((-9.5..-9.0).contains(&shoulder), "{shoulder}");
        assert!((-6.0..-4.0).contains(&elbow) && (-2.0..-1.0).contains(&wrist));
        // An upright forearm on a flat upper arm loads it like a mass at its end.
        let bent = [0.0, 155.0, -146.0 - 90.0, 102.5, 0.0].map(f64::to_radians);
        let [_, shoulder, elbow, ..] = holding(&bent);
        assert!(elbow.abs() < 1e-9 && (shoulder + GRAVITY * MOMENTS[0]).abs() < 1e-9);
    }
}

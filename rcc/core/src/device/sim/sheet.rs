//! Ranges and velocities of simulated arms where they are not given. They are for no driver: those know their robots.

use std::f64::consts::TAU;

use takt_motion::urdf::ArmModel;

const LWR_SHEET: [[f64; 7]; 2] = [
    [170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 170.0],
    [100.0, 110.0, 100.0, 130.0, 130.0, 180.0, 180.0],
];
const IIWA_SHEET: [[f64; 7]; 2] = [
    [170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0],
    [98.0, 98.0, 100.0, 130.0, 140.0, 180.0, 180.0],
];

/// Range and velocity of each joint by a data sheet, rad and rad/s; not a number where it gives none.
pub(super) struct Sheet {
    pub(super) min: Vec<f64>,
    pub(super) max: Vec<f64>,
    pub(super) velocity: Vec<f64>,
}

impl Sheet {
    pub(super) fn lwr() -> Self {
        Self::of(LWR_SHEET)
    }

    pub(super) fn iiwa() -> Self {
        Self::of(IIWA_SHEET)
    }

    /// From the range to either side and the velocity of each joint, degrees and degrees/s.
    fn of([range, velocity]: [[f64; 7]; 2]) -> Self {
        let radians = |degrees: [f64; 7], sign: f64| degrees.map(|it| sign * it.to_radians());
        Self {
            min: radians(range, -1.0).to_vec(),
            max: radians(range, 1.0).to_vec(),
            velocity: radians(velocity, 1.0).to_vec(),
        }
    }

    /// From the file of an arm. A joint that turns without end gets two turns.
    pub(super) fn of_arm(arm: &ArmModel) -> Self {
        let ranges = arm.joints.iter().map(|joint| joint.range);
        let or = |value: f64, other: f64| if value.is_finite() { value } else { other };
        let velocities = arm.joints.iter().map(|joint| joint.velocity_max);
        Self {
            min: ranges.clone().map(|it| or(it.min, -TAU)).collect(),
            max: ranges.map(|it| or(it.max, TAU)).collect(),
            velocity: velocities.map(|it| it.unwrap_or(f64::NAN)).collect(),
        }
    }
}

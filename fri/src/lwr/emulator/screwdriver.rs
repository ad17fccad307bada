//! An electric screwdriver at the user variables of the robot program: `$FRI_FRM_REA[1]` is the wanted speed of its bit,
//! `$FRI_TO_REA[1]` the torque of the motor. There is always a screw at the bit, a new one once it rests without
//! force; screws have no feed.

use std::time::Duration;

/// Properties of a screwdriver and its screw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Screwdriver {
    /// Force on the tool from which on the bit turns the screw, N.
    pub force_min: f64,
    /// Torque on the way, Nm.
    pub running_nm: f64,
    /// Angle at which the head is seated, rad.
    pub seat_rad: f64,
    /// Rise of the torque from there on, Nm/rad.
    pub seating_nm_per_rad: f64,
    /// Torque at which the clutch stops the bit, Nm.
    pub clutch_nm: f64,
    /// Largest speed of the bit, rad/s.
    pub speed_max: f64,
}

impl Default for Screwdriver {
    /// An M4 screw, 8 mm of 0.7 mm a turn, and a clutch of 2 Nm: *assumption*.
    fn default() -> Self {
        Self {
            force_min: 5.0,
            running_nm: 0.05,
            seat_rad: 71.8,
            seating_nm_per_rad: 0.6,
            clutch_nm: 2.0,
            speed_max: 60.0,
        }
    }
}

impl Screwdriver {
    /// How far the bit turns in a span at a wanted speed, rad/s, against a torque, Nm: not at all beyond that of the clutch. A
    /// speed that is not finite counts as 0.
    pub fn step(&self, speed: f64, torque: f64, span: Duration) -> f64 {
        let speed = if speed.is_finite() { speed } else { 0.0 };
        let most = self.speed_max.max(0.0);
        let is_open = speed > 0.0 && torque >= self.clutch_nm;
        if is_open {
            return 0.0;
        }
        speed.clamp(-most, most) * span.as_secs_f64()
    }

    /// Turns the screw from `angle`, rad, at a wanted speed, rad/s, under a force on the tool, N: the new angle, and the
    /// torque, Nm. A speed that is not finite counts as 0.
    pub(super) fn turn(&self, angle: f64, speed: f64, force: f64, span: Duration) -> (f64, f64) {
        let step = self.step(speed, 0.0, span);
        if force < self.force_min {
            let is_replaced = step == 0.0;
            return (if is_replaced { 0.0 } else { angle }, 0.0);
        }
        let rate = self.seating_nm_per_rad.max(1e-9);
        let last = self.seat_rad + (self.clutch_nm - self.running_nm).max(0.0) / rate;
        let angle = (angle + step).clamp(0.0, last.max(0.0));
        let seating = (angle - self.seat_rad).max(0.0) * rate;
        let is_turned = step != 0.0 || seating > 0.0;
        let running = if is_turned { self.running_nm } else { 0.0 };
        (angle, running + seating)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPAN: Duration = Duration::from_millis(100);

    #[test]
    fn screw_turns_under_force_only() {
        let driver = Screwdriver::default();
        assert_eq!(driver.turn(1.0, 10.0, 4.0, SPAN), (1.0, 0.0));
        let (angle, torque) = driver.turn(1.0, 10.0, 10.0, SPAN);
        assert!((angle - 2.0).abs() < 1e-12 && (torque - 0.05).abs() < 1e-12);
        assert_eq!(driver.turn(1.0, f64::NAN, 10.0, SPAN), (1.0, 0.0));
        // The next screw.
        assert_eq!(driver.turn(75.0, 0.0, 0.0, SPAN), (0.0, 0.0));
    }

    #[test]
    fn clutch_lets_bit_turn_back_only() {
        let driver = Screwdriver::default();
        assert!(driver.step(10.0, 2.0, SPAN).abs() < 1e-12);
        assert!((driver.step(-10.0, 2.0, SPAN) + 1.0).abs() < 1e-12);
        assert!((driver.step(f64::MAX, 1.9, SPAN) - 6.0).abs() < 1e-12);
        assert!(driver.step(f64::INFINITY, 0.0, SPAN).abs() < 1e-12);
    }

    #[test]
    fn clutch_stops_seated_screw_at_its_torque() {
        let driver = Screwdriver::default();
        let mut state = (0.0, 0.0);
        for _ in 0..100 {
            state = driver.turn(state.0, 1e9, 10.0, SPAN);
        }
        assert!((state.1 - 2.0).abs() < 1e-9, "{state:?}");
        assert!((state.0 - 75.05).abs() < 1e-9, "{state:?}");
    }
}

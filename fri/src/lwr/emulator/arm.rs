//! Set-point and motion of the emulated joints, one cycle at a time: follow, extrapolate, brake. It judges nothing.

use crate::lwr::AXES;

/// The joints; positions in rad, steps in rad per cycle.
#[derive(Debug, Clone)]
pub(super) struct Arm {
    /// What the drives are told.
    pub(super) set_point: [f64; AXES],
    /// Where the joints are.
    pub(super) measured: [f64; AXES],
    step: [f64; AXES],
    follow_share: f64,
}

impl Arm {
    /// At rest; in each cycle the joints make up `follow_share` (0..=1) of their distance to the set-point.
    pub(super) fn new(joints: [f64; AXES], follow_share: f64) -> Self {
        Self {
            set_point: joints,
            measured: joints,
            step: [0.0; AXES],
            follow_share,
        }
    }

    /// Takes a commanded position, which spans `cycles` cycles since the last one at `from`.
    pub(super) fn follow(&mut self, target: &[f64; AXES], from: &[f64; AXES], cycles: f64) {
        for (joint, step) in self.step.iter_mut().enumerate() {
            *step = (target[joint] - from[joint]) / cycles;
        }
        self.set_point = *target;
    }

    /// Goes on at the last speed, within `limits`.
    pub(super) fn extrapolate(&mut self, limits: &[f64; AXES]) {
        for (joint, step) in self.step.iter().enumerate() {
            let limit = limits[joint].abs();
            self.set_point[joint] = (self.set_point[joint] + step).clamp(-limit, limit);
        }
    }

    /// Keeps the set-point and forgets the speed.
    pub(super) fn hold(&mut self) {
        self.step = [0.0; AXES];
    }

    /// Slows every joint by at most `decrement` and moves on.
    pub(super) fn brake(&mut self, decrement: &[f64; AXES]) {
        for (joint, step) in self.step.iter_mut().enumerate() {
            *step = step.signum() * (step.abs() - decrement[joint]).max(0.0);
            self.set_point[joint] += *step;
        }
    }

    /// Lets the joints follow their set-point for one cycle.
    pub(super) fn settle(&mut self) {
        for (measured, set_point) in self.measured.iter_mut().zip(self.set_point) {
            *measured += (set_point - *measured) * self.follow_share;
        }
    }

    /// Whether the set-point is at rest.
    pub(super) fn is_at_rest(&self) -> bool {
        self.step.iter().all(|step| step.abs() < f64::EPSILON)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn braking_ends_at_rest_and_never_turns_back() {
        let mut arm = Arm::new([0.0; AXES], 1.0);
        arm.follow(&[0.01; AXES], &[0.0; AXES], 1.0);
        let mut last = arm.set_point[0];
        for cycle in 0..4 {
            assert!(!arm.is_at_rest(), "{cycle}");
            arm.brake(&[0.0025; AXES]);
            assert!(arm.set_point[0] >= last);
            last = arm.set_point[0];
        }
        assert!(arm.is_at_rest());
        // 7.5 + 5 + 2.5 + 0 mrad of braking distance.
        assert!((arm.set_point[0] - 0.025).abs() < 1e-12);
    }

    #[test]
    fn extrapolation_keeps_the_speed_up_to_the_limit() {
        let mut arm = Arm::new([0.0; AXES], 0.5);
        arm.follow(&[0.2; AXES], &[0.0; AXES], 2.0);
        arm.extrapolate(&[0.35; AXES]);
        assert!((arm.set_point[6] - 0.3).abs() < 1e-12);
        arm.extrapolate(&[0.35; AXES]);
        assert!((arm.set_point[6] - 0.35).abs() < 1e-12);
        arm.settle();
        assert!((arm.measured[6] - 0.175).abs() < 1e-12);
    }
}

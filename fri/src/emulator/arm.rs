//! Set-point and motion of the emulated joints, one cycle at a time: follow, extrapolate, brake. It checks no limits.

use super::AXES;
use super::body::{Body, Law};

/// The joints; positions in rad, steps in rad per cycle.
#[derive(Debug)]
pub(crate) struct Arm {
    /// Set-point of the drives.
    pub(crate) set_point: [f64; AXES],
    step: [f64; AXES],
    /// Last commanded position, and the cycles left to reach it.
    goal: [f64; AXES],
    remaining: u32,
    /// The arm that follows the set-point.
    pub(crate) body: Body,
}

impl Arm {
    /// At rest.
    pub(crate) fn new(body: Body) -> Self {
        Self {
            set_point: body.joints(),
            step: [0.0; AXES],
            goal: body.joints(),
            remaining: 0,
            body,
        }
    }

    /// Starts towards a commanded position, `cycles` cycles after the last one at `from`; the set-point reaches it in
    /// `over` cycles, this one included.
    pub(crate) fn follow(
        &mut self,
        target: &[f64; AXES],
        from: &[f64; AXES],
        cycles: f64,
        over: u32,
    ) {
        for (joint, step) in self.step.iter_mut().enumerate() {
            *step = (target[joint] - from[joint]) / cycles;
        }
        self.goal = *target;
        self.remaining = over.max(1);
        self.glide();
    }

    /// Continues to the commanded position, or beyond it at the last speed, within `limits`.
    pub(crate) fn extrapolate(&mut self, limits: &[f64; AXES]) {
        if self.remaining > 0 {
            return self.glide();
        }
        for (joint, step) in self.step.iter().enumerate() {
            let limit = limits[joint].abs();
            self.set_point[joint] = (self.set_point[joint] + step).clamp(-limit, limit);
        }
    }

    fn glide(&mut self) {
        let share = 1.0 / f64::from(self.remaining);
        for (set_point, goal) in self.set_point.iter_mut().zip(self.goal) {
            *set_point = if self.remaining == 1 {
                goal
            } else {
                *set_point + (goal - *set_point) * share
            };
        }
        self.remaining -= 1;
    }

    /// Keeps the set-point and resets the speed.
    pub(crate) fn hold(&mut self) {
        self.step = [0.0; AXES];
        self.remaining = 0;
    }

    /// Slows every joint by at most `decrement` and moves on.
    pub(crate) fn brake(&mut self, decrement: &[f64; AXES]) {
        self.remaining = 0;
        for (joint, step) in self.step.iter_mut().enumerate() {
            *step = step.signum() * (step.abs() - decrement[joint]).max(0.0);
            self.set_point[joint] += *step;
        }
    }

    /// Lets the joints follow their set-point for `span_s` seconds.
    pub(crate) fn settle(&mut self, law: &Law, span_s: f64) {
        self.body.advance(&self.set_point, law, span_s);
    }

    /// Sets the set-point to the measured positions, as control strategies do when they change.
    pub(crate) fn sync_set_point(&mut self) {
        self.set_point = self.body.joints();
        self.hold();
    }

    /// Whether the set-point is at rest.
    pub(crate) fn is_at_rest(&self) -> bool {
        self.step.iter().all(|step| step.abs() < f64::EPSILON)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emulator::Chain;
    use std::time::Duration;

    fn arm() -> Arm {
        let lag = Duration::from_millis(1);
        Arm::new(Body::new(Chain::LWR, [0.0; AXES], lag))
    }

    #[test]
    fn arm_braking_stops_without_reversing() {
        let mut arm = arm();
        arm.follow(&[0.01; AXES], &[0.0; AXES], 1.0, 1);
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
    fn arm_extrapolation_keeps_speed_within_limits() {
        let mut arm = arm();
        arm.follow(&[0.2; AXES], &[0.0; AXES], 2.0, 1);
        arm.extrapolate(&[0.35; AXES]);
        assert!((arm.set_point[6] - 0.3).abs() < 1e-12);
        arm.extrapolate(&[0.35; AXES]);
        assert!((arm.set_point[6] - 0.35).abs() < 1e-12);
        arm.settle(&Law::Position, 0.001 * 2.0_f64.ln());
        assert!((arm.body.joints()[6] - 0.175).abs() < 1e-12);
        arm.sync_set_point();
        assert!((arm.set_point[6] - 0.175).abs() < 1e-12 && arm.is_at_rest());
    }

    #[test]
    fn arm_slow_client_commands_are_interpolated() {
        let mut arm = arm();
        let mut last = [0.0; AXES];
        for command in 1..4 {
            let target = [0.03 * f64::from(command); AXES];
            arm.follow(&target, &last, 3.0, 3);
            arm.extrapolate(&[1.0; AXES]);
            assert!((target[0] - arm.set_point[0] - 0.01).abs() < 1e-12);
            arm.extrapolate(&[1.0; AXES]);
            assert_eq!(arm.set_point.map(f64::to_bits), target.map(f64::to_bits));
            last = target;
        }
        arm.extrapolate(&[1.0; AXES]);
        assert!(
            (arm.set_point[0] - 0.10).abs() < 1e-12,
            "a missing one is extrapolated"
        );
    }
}

//! Compliance of a simulated joint: a spring and a parallel damper to its commanded position, without mass. It
//! neither oscillates nor bounces, and is stable for any stiffness and period.

use takt_net::device::{Answer, JointImpedance, Order};

/// Default stiffness, Nm/rad.
const STIFFNESS: f64 = 1000.0;
/// Default damping ratio.
const DAMPING: f64 = 0.7;
/// Largest stiffness, Nm/rad.
const STIFFNESS_MAX: f64 = 5000.0;
/// Smallest damper, Nms/rad: without one, a torque without a spring would move the joint at once.
const DAMPER_MIN: f64 = 0.1;

/// Error values of answers.
mod error {
    /// Stiffness or damping is out of range or not finite.
    pub(super) const RANGE: i32 = 1;
    /// Its net ended before the order was started.
    pub(super) const WITHDRAWN: i32 = 7;
}

/// The compliance of one joint.
#[derive(Clone, Copy, Debug)]
pub(super) struct Compliance {
    stiffness: f64,
    damping: f64,
    torque_max: f64,
    /// Torque that nets add, Nm.
    added: f64,
    /// Deflection of the joint, rad.
    deflection: f64,
    /// The latest order.
    order: u64,
    answer: Option<Answer>,
}

impl Default for Compliance {
    fn default() -> Self {
        Self {
            stiffness: STIFFNESS,
            damping: DAMPING,
            torque_max: 0.0,
            added: 0.0,
            deflection: 0.0,
            order: 0,
            answer: None,
        }
    }
}

impl Compliance {
    /// Applies the orders of this cycle and answers them.
    pub(super) fn apply(
        &mut self,
        order: &Order<JointImpedance>,
        words: &[u64],
        cycle: u64,
        signals: &mut [u64],
    ) {
        let given = order.command.read(words);
        let current = given.filter(|given| given.is_in_force(cycle));
        if let Some(given) = given.filter(|given| given.cycle != self.order) {
            self.order = given.cycle;
            let error = if given.is_withdrawn() {
                error::WITHDRAWN
            } else if self.take(&given.value) {
                0
            } else {
                error::RANGE
            };
            self.answer = Some(Answer {
                order: given.cycle,
                error,
            });
        }
        let torque = current.and_then(|given| given.value.torque);
        self.added = torque.filter(|t| t.is_finite()).unwrap_or(0.0);
        order.answer.report(signals, self.answer);
    }

    fn take(&mut self, wanted: &JointImpedance) -> bool {
        let stiffness = wanted.stiffness.unwrap_or(self.stiffness);
        let damping = wanted.damping.unwrap_or(self.damping);
        let torque_max = wanted.torque_max.unwrap_or(self.torque_max);
        let possible = (0.0..=STIFFNESS_MAX).contains(&stiffness)
            && (0.0..=1.0).contains(&damping)
            && torque_max.is_finite()
            && wanted.torque.is_none_or(f64::is_finite);
        if possible {
            (self.stiffness, self.damping) = (stiffness, damping);
            self.torque_max = torque_max;
        }
        possible
    }

    /// One step under an external torque, Nm; returns the deflection, rad.
    pub(super) fn yield_to(&mut self, external: f64, dt_s: f64) -> f64 {
        let torque = external + self.added;
        // As critically damped with 1 kg m² at a ratio of 1.
        let damper = (2.0 * self.damping * self.stiffness.sqrt()).max(DAMPER_MIN);
        let limited =
            self.torque_max > 0.0 && (self.stiffness * self.deflection).abs() > self.torque_max;
        if limited || self.stiffness <= 0.0 {
            let spring = if limited {
                self.torque_max.copysign(self.deflection)
            } else {
                0.0
            };
            self.deflection += (torque - spring) / damper * dt_s;
        } else {
            let rest = torque / self.stiffness;
            let left = (-self.stiffness / damper * dt_s).exp();
            self.deflection = rest + (self.deflection - rest) * left;
        }
        self.deflection
    }

    /// Limits the deflection to a range, the stops of the joint.
    pub(super) const fn keep_within(&mut self, min: f64, max: f64) {
        self.deflection = self.deflection.max(min).min(max);
    }

    /// Switches to stiff position control.
    pub(super) const fn hold(&mut self) {
        self.deflection = 0.0;
    }

    /// Deflection, rad.
    pub(super) const fn deflection(&self) -> f64 {
        self.deflection
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn compliance(stiffness: f64, damping: f64) -> Compliance {
        let mut compliance = Compliance::default();
        let wanted = JointImpedance {
            stiffness: Some(stiffness),
            damping: Some(damping),
            ..JointImpedance::default()
        };
        assert!(compliance.take(&wanted));
        compliance
    }

    #[test]
    fn sim_compliance_rests_at_equilibrium_for_any_period() {
        for stiffness in [1.0, 100.0, STIFFNESS_MAX] {
            for (damping, dt_s) in [(0.0, 0.000_1), (0.0, 10.0), (0.3, 0.1), (1.0, 0.001)] {
                let (mut joint, mut last) = (compliance(stiffness, damping), 0.0);
                let rest = 2.0 / stiffness;
                for _ in 0..1000 {
                    let now = joint.yield_to(2.0, dt_s);
                    assert!(now >= last && now <= rest * (1.0 + 1e-12), "it swings");
                    last = now;
                }
                assert!(last > 0.0 && (joint.yield_to(2.0, 1e9) - rest).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn sim_compliance_without_stiffness_moves_against_damper() {
        let mut joint = compliance(0.0, 0.0);
        (0..1000).for_each(|_| _ = joint.yield_to(0.05, 0.001));
        assert!((joint.deflection() - 0.5).abs() < 1e-9);
    }

    #[test]
    fn sim_compliance_parameters_out_of_range_change_nothing() {
        let mut joint = compliance(100.0, 0.5);
        for (stiffness, damping) in [(-1.0, 0.5), (f64::NAN, 0.5), (10.0, 1.1), (1e6, 0.5)] {
            assert!(!joint.take(&JointImpedance {
                stiffness: Some(stiffness),
                damping: Some(damping),
                ..JointImpedance::default()
            }));
        }
        assert!((joint.yield_to(1.0, 1e9) - 0.01).abs() < 1e-12);
    }
}

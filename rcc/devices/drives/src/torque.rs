//! Torques of an arm of drives by the model of its URDF: the feed-forward of each cycle (60B2h), and whether what drives measure
//! (6077h) is what the model expects. Friction and rotors are not modelled. No clock is read here, nothing is allocated in a cycle.

use nalgebra::Vector3;
use takt_core::device::ARM_JOINTS_MAX;
use takt_motion::dynamics::{Dynamics, JointMotion};

use crate::config::DriveArm;
use crate::heavy::Heavy;

/// The feed-forward of a joint rises within this time once its drive follows, s: power-on is no step.
const FADE_S: f64 = 0.2;
/// A limit that was kept for so long is reported again when it is exceeded, s.
const QUIET_S: f64 = 1.0;

/// Torque at a joint and per mille of the rated torque of its motor.
#[derive(Clone, Copy, Debug)]
struct Scale {
    /// Nm at the joint of 1000 per mille; negative for a drive that counts the other way. `None` if unknown.
    rated: Option<f64>,
    /// Largest feed-forward, Nm; 0 for none.
    most: f64,
}

/// Feed-forward that was cut off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cut {
    /// What the model wanted, Nm; not finite if it has no answer.
    pub wanted: f64,
    /// What it may be, Nm.
    pub most: f64,
}

/// The torques of an arm.
#[derive(Debug)]
pub(crate) struct Torques {
    /// With tools and payload.
    model: Option<Dynamics>,
    /// In the base of the arm, m/s².
    gravity: Vector3<f64>,
    scales: Vec<Scale>,
    /// By the model, Nm, of this cycle.
    expected: [f64; ARM_JOINTS_MAX],
    /// Measured, Nm, in the last cycle.
    measured: [Option<f64>; ARM_JOINTS_MAX],
    /// Share of its feed-forward that a joint gets, up to 1.
    fade: [f64; ARM_JOINTS_MAX],
    /// Since its feed-forward was cut off last, s.
    kept_s: [f64; ARM_JOINTS_MAX],
    cuts: [Option<Cut>; ARM_JOINTS_MAX],
    heavy: Heavy,
}

impl Torques {
    pub(crate) fn new<D>(arm: &DriveArm<D>) -> Self {
        let of_file = arm.model.arm();
        let load = arm.load();
        let model = of_file.and_then(|of_file| of_file.dynamics.clone());
        let scale = |(number, joint): (usize, &crate::DriveJoint<D>)| {
            let effort = of_file.and_then(|it| it.joints.get(number)?.effort_max);
            Scale {
                rated: joint
                    .rated_torque
                    .map(|rated| rated.copysign(joint.increments_per_turn)),
                most: arm.feed_forward * effort.unwrap_or(0.0),
            }
        };
        Self {
            model: model.map(|model| model.with_payload(&load)),
            gravity: arm.down.gravity(),
            scales: arm.joints.iter().enumerate().map(scale).collect(),
            expected: [f64::NAN; ARM_JOINTS_MAX],
            measured: [None; ARM_JOINTS_MAX],
            fade: [0.0; ARM_JOINTS_MAX],
            kept_s: [QUIET_S; ARM_JOINTS_MAX],
            cuts: [None; ARM_JOINTS_MAX],
            heavy: Heavy::new(&load),
        }
    }

    /// Whether all torques are measured in Nm.
    pub(crate) fn is_measuring<D>(arm: &DriveArm<D>) -> bool {
        arm.joints.iter().all(|joint| joint.rated_torque.is_some())
    }

    /// Computes the torques of the commanded motion.
    pub(crate) fn expect(&mut self, motions: &[JointMotion]) {
        if let Some(model) = &self.model
            && let Some(expected) = self.expected.get_mut(..motions.len())
        {
            model.torques(motions, &self.gravity, expected);
        }
    }

    /// The torque offset (60B2h) of a joint, per mille of the rated torque; 0 while its drive does not follow.
    pub(crate) fn offset(&mut self, joint: usize, follows: bool, dt_s: f64) -> i16 {
        let Some(Scale {
            rated: Some(rated),
            most,
        }) = self.scales.get(joint).copied().filter(|it| it.most > 0.0)
        else {
            return 0;
        };
        let (Some(fade), Some(kept_s), Some(cut), Some(wanted)) = (
            self.fade.get_mut(joint),
            self.kept_s.get_mut(joint),
            self.cuts.get_mut(joint),
            self.expected.get(joint).copied(),
        ) else {
            return 0;
        };
        if !follows {
            *fade = 0.0;
            return 0;
        }
        *fade = (*fade + dt_s / FADE_S).min(1.0);
        let torque = if wanted.is_finite() {
            // Not `clamp`, which panics if a bound is NaN.
            wanted.max(-most).min(most)
        } else {
            0.0
        };
        if (wanted - torque).abs() > 0.0 || !wanted.is_finite() {
            if *kept_s >= QUIET_S {
                *cut = Some(Cut { wanted, most });
            }
            *kept_s = 0.0;
        } else {
            *kept_s = (*kept_s + dt_s).min(QUIET_S);
        }
        #[expect(clippy::cast_possible_truncation, reason = "saturates, which is meant")]
        let offset = (*fade * torque / rated * 1000.0).round() as i16;
        offset
    }

    /// Takes the torque that a drive measured (6077h), per mille.
    pub(crate) fn measure(&mut self, joint: usize, per_mille: Option<i16>) {
        let rated = self.scales.get(joint).and_then(|scale| scale.rated);
        if let Some(measured) = self.measured.get_mut(joint) {
            *measured = per_mille
                .zip(rated)
                .map(|(torque, rated)| f64::from(torque) / 1000.0 * rated);
        }
    }

    /// Compares what is measured with the model: `is_steady` while the arm follows and hardly accelerates.
    pub(crate) fn compare(&mut self, motions: &[JointMotion], is_steady: bool, dt_s: f64) {
        let Some(model) = &self.model else {
            return;
        };
        let count = motions.len();
        let mut beyond = [0.0; ARM_JOINTS_MAX];
        for (beyond, joint) in beyond.iter_mut().zip(0..count) {
            let Some(torque) = self.unexplained(joint).filter(|it| it.is_finite()) else {
                return;
            };
            *beyond = torque;
        }
        let beyond = beyond.get(..count).unwrap_or_default();
        self.heavy
            .step(model.arm(), motions, beyond, &self.gravity, is_steady, dt_s);
    }

    /// The torque that a drive measured, Nm.
    pub(crate) fn measured(&self, joint: usize) -> Option<f64> {
        self.measured.get(joint).copied().flatten()
    }

    /// What the model, with tools and payload, does not explain of it, Nm.
    fn unexplained(&self, joint: usize) -> Option<f64> {
        self.model.as_ref()?;
        Some(self.measured(joint)? - self.expected.get(joint)?)
    }

    /// The torque that the surroundings exert on a joint, Nm: the drive holds it by the opposite one.
    pub(crate) fn estimated(&self, joint: usize) -> Option<f64> {
        self.unexplained(joint).map(|torque| -torque)
    }

    /// The next feed-forward that was cut off, by joint.
    pub(crate) fn poll_cut(&mut self) -> Option<(usize, Cut)> {
        let mut cuts = self.cuts.iter_mut().enumerate();
        cuts.find_map(|(joint, cut)| Some((joint, cut.take()?)))
    }

    /// A load that differs from the stated one by so much, kg; once per onset.
    pub(crate) const fn poll_heavy(&mut self) -> Option<f64> {
        self.heavy.poll()
    }
}

//! Finds at run time that an arm carries another payload than the cell states: torques beyond the model that are those of a weight
//! at the flange, for a while. A contact or friction of a single joint looks otherwise. It weighs roughly.

use nalgebra::Vector3;
use takt_core::device::ARM_JOINTS_MAX;
use takt_motion::dynamics::{Body, JointMotion, weight};
use takt_motion::kinematics::Serial;

/// Time constant of the mean, and how long the mean must be beyond the bound, s.
const MEAN_S: f64 = 0.5;
const LASTS_S: f64 = 1.5;
/// Differences that are no finding: kg, and a share of the stated mass.
const LEAST_KG: f64 = 0.75;
const SHARE: f64 = 0.3;
/// Share of the squared torques that the weight must explain.
const LIKENESS: f64 = 0.6;
/// Least torque of 1 kg, Nm: poses in which the load has hardly a lever show nothing.
const LEVER: f64 = 1.5;

/// The comparison.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Heavy {
    /// One kilogram where the stated load has its centre.
    unit: Body,
    /// The most that is no finding, kg.
    bound: f64,
    /// The mean difference, kg, and since when it is beyond the bound, s.
    mean: f64,
    lasts_s: f64,
    is_reported: bool,
    due: Option<f64>,
}

impl Heavy {
    pub(crate) fn new(load: &Body) -> Self {
        Self {
            unit: Body {
                mass: 1.0,
                moment: load.centre(),
                ..Body::default()
            },
            bound: LEAST_KG.max(SHARE * load.mass),
            mean: 0.0,
            lasts_s: 0.0,
            is_reported: false,
            due: None,
        }
    }

    /// One cycle with the torques beyond the model, Nm.
    pub(crate) fn step(
        &mut self,
        arm: &Serial,
        motions: &[JointMotion],
        beyond: &[f64],
        gravity: &Vector3<f64>,
        is_steady: bool,
        dt_s: f64,
    ) {
        if !is_steady {
            return;
        }
        let (mut joints, mut unit) = ([0.0; ARM_JOINTS_MAX], [0.0; ARM_JOINTS_MAX]);
        let count = motions.len();
        for (joint, [at, ..]) in joints.iter_mut().zip(motions) {
            *joint = *at;
        }
        let (Some(joints), Some(unit)) = (joints.get(..count), unit.get_mut(..count)) else {
            return;
        };
        weight(arm, joints, &self.unit, gravity, unit);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (lever, common) = (dot(unit, unit), dot(unit, beyond));
        if lever < LEVER * LEVER {
            return;
        }
        let all = dot(beyond, beyond);
        let is_weight = common * common > LIKENESS * lever * all;
        let mass = if is_weight { common / lever } else { 0.0 };
        self.mean += (mass - self.mean) * (dt_s / MEAN_S).min(1.0);
        if self.mean.abs() > self.bound {
            self.lasts_s += dt_s;
        } else {
            self.lasts_s = 0.0;
            // Hysteresis: one finding while it is about the bound.
            self.is_reported &= self.mean.abs() > self.bound / 2.0;
        }
        if self.lasts_s >= LASTS_S && !self.is_reported {
            (self.is_reported, self.due) = (true, Some(self.mean));
        }
    }

    /// A difference to report.
    pub(crate) const fn poll(&mut self) -> Option<f64> {
        self.due.take()
    }
}

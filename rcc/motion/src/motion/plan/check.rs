//! Whether an arm can follow a plan: within its joint ranges and velocities, from the first cycle to the last. Nothing is
//! loaded for that.

use std::time::Duration;

use takt_net::device::{Kinematics, Unreachable};
use takt_net::{Frame, JointLimits};

use super::{FrameSample, JointSample, Plan, Sample, State};

/// Tolerance for rounding: how far a joint may exceed a limit, relative to it.
const ROUNDING: f64 = 1e-6;

/// A joint that moves further in one cycle changes its configuration, rad.
const JUMP: f64 = 0.2;

/// Where and why an arm cannot follow a plan.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("at {:.0} % of the path, {at:?} after its start: {cause}", progress * 100.0)]
pub struct Unfit {
    /// Time after the start.
    pub at: Duration,
    /// Completed part of the path, 0 to 1.
    pub progress: f64,
    /// What is wrong there.
    pub cause: Cause,
}

/// Why an arm cannot be where a plan is.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Cause {
    /// No joint positions bring the flange there.
    #[error("{0}")]
    Unreachable(Unreachable),
    /// A joint is out of its range.
    #[error("joint {joint} is at {position} rad, its range is {min} to {max} rad")]
    Position {
        /// Number of the joint, from 0.
        joint: usize,
        /// Its position, rad.
        position: f64,
        /// Smallest position, rad.
        min: f64,
        /// Largest position, rad.
        max: f64,
    },
    /// A joint is too fast.
    #[error("joint {joint} moves at {velocity} rad/s, its limit is {limit} rad/s")]
    Velocity {
        /// Number of the joint, from 0.
        joint: usize,
        /// Its velocity, rad/s.
        velocity: f64,
        /// Its limit, rad/s.
        limit: f64,
    },
    /// A joint would be elsewhere in the next cycle: the path leads through a singularity, or out of the ranges of one
    /// configuration of the arm.
    #[error(
        "joint {joint} would jump by {angle} rad, to another configuration of the arm: the path leads through a \
         singularity or to the end of a joint range"
    )]
    Jump {
        /// Number of the joint, from 0.
        joint: usize,
        /// How far, rad.
        angle: f64,
    },
    /// The number of limits or of hints is not the number of joints.
    #[error("{found} values for {joints} joints")]
    Joints {
        /// Number of values.
        found: usize,
        /// Number of joints.
        joints: usize,
    },
}

fn position(joint: usize, position: f64, limits: &JointLimits) -> Result<(), Cause> {
    let JointLimits {
        position_min: min,
        position_max: max,
        ..
    } = *limits;
    let slack = ROUNDING * (max - min).abs();
    if position >= min - slack && position <= max + slack {
        return Ok(());
    }
    Err(Cause::Position {
        joint,
        position,
        min,
        max,
    })
}

fn velocity(joint: usize, velocity: f64, limits: &JointLimits) -> Result<(), Cause> {
    let limit = limits.velocity_max;
    if velocity.abs() <= limit * (1.0 + ROUNDING) {
        return Ok(());
    }
    Err(Cause::Velocity {
        joint,
        velocity,
        limit,
    })
}

fn count(found: usize, joints: usize) -> Result<(), Cause> {
    if found == joints {
        Ok(())
    } else {
        Err(Cause::Joints { found, joints })
    }
}

/// Checks every cycle of a plan with `check`; the first cause is reported with its place.
fn all<S: Sample>(
    plan: &Plan<S>,
    progress: impl Fn(&S) -> f64,
    mut check: impl FnMut(&S) -> Result<(), Cause>,
) -> Result<(), Unfit> {
    plan.cycles().try_for_each(|(at, sample)| {
        check(sample).map_err(|cause| Unfit {
            at,
            progress: progress(sample),
            cause,
        })
    })
}

impl Plan<JointSample> {
    /// Whether all joints stay within their ranges and velocities.
    ///
    /// # Errors
    /// The first place at which one does not.
    pub fn check(&self, limits: &[JointLimits]) -> Result<(), Unfit> {
        all(
            self,
            |sample| sample.progress,
            |sample| {
                count(limits.len(), sample.joints.len())?;
                for (joint, (state, limits)) in sample.joints.iter().zip(limits).enumerate() {
                    position(joint, state.position, limits)?;
                    velocity(joint, state.velocity, limits)?;
                }
                Ok(())
            },
        )
    }
}

impl Plan<FrameSample> {
    /// Whether an arm whose flange is at `flange` (m) in the moved frame follows within its joint ranges and velocities,
    /// from the joint positions `hint` (rad) on. Returns the joint positions at the end, rad.
    ///
    /// # Errors
    /// The first place that the arm cannot reach, else the first one where a joint is too fast.
    pub fn check(
        &self,
        arm: &dyn Kinematics,
        limits: &[JointLimits],
        hint: &[f64],
        flange: &Frame,
    ) -> Result<Vec<f64>, Unfit> {
        let joints = self.joints(arm, limits, hint, flange)?;
        joints.check(limits)?;
        let end = joints.samples.last();
        Ok(end.map_or_else(Vec::new, positions))
    }

    /// The motion of the joints of an arm whose flange is at `flange` (m) in the moved frame: inverse kinematics of each
    /// cycle, with the joints of the previous one as hint, as a net computes it, from the joint positions `hint` (rad) on.
    /// Velocities and accelerations are those between neighbouring cycles; in the first one they are 0.
    ///
    /// # Errors
    /// The first place that the arm cannot reach within the ranges of its joints, or only by a jump.
    pub fn joints(
        &self,
        arm: &dyn Kinematics,
        limits: &[JointLimits],
        hint: &[f64],
        flange: &Frame,
    ) -> Result<Plan<JointSample>, Unfit> {
        let mut at = vec![0.0; arm.joints()];
        let period_s = self.period.as_secs_f64();
        let mut samples: Vec<JointSample> = Vec::with_capacity(self.samples.len());
        let progress = |sample: &FrameSample| sample.progress;
        all(self, progress, |sample| {
            count(limits.len(), arm.joints())?;
            count(hint.len(), arm.joints())?;
            let before = samples.last();
            let near = before.map(positions);
            let near = near.as_deref().unwrap_or(hint);
            let target = sample.frame * flange;
            arm.inverse(&target, near, &mut at)
                .map_err(Cause::Unreachable)?;
            for (joint, limits) in limits.iter().enumerate() {
                position(joint, at[joint], limits)?;
                let angle = at[joint] - near[joint];
                if before.is_some() && angle.abs() > JUMP {
                    return Err(Cause::Jump { joint, angle });
                }
            }
            let rate = |from: f64, to: f64| (to - from) / period_s;
            let state = |(joint, position): (usize, &f64)| match before {
                None => State::at_rest(*position),
                Some(before) => {
                    let before = before.joints[joint];
                    let velocity = rate(before.position, *position);
                    State {
                        position: *position,
                        velocity,
                        acceleration: rate(before.velocity, velocity),
                    }
                }
            };
            let joints = at.iter().enumerate().map(state).collect();
            samples.push(JointSample {
                progress: sample.progress,
                joints,
            });
            Ok(())
        })?;
        Ok(Plan {
            period: self.period,
            samples: samples.into(),
        })
    }
}

/// Positions of the joints, rad.
fn positions(sample: &JointSample) -> Vec<f64> {
    sample.joints.iter().map(|joint| joint.position).collect()
}

//! Plans of activities before anything is loaded: how long a motion takes, where the arm is at a time, and whether it can
//! follow. A plan runs the same course as the net, cycle by cycle. Not here: forces, and conditions over sensors.

use std::sync::Arc;
use std::time::Duration;

use takt_motion::plan::{Bounds, JointSample, PlanError, Unfit};
use takt_net::device::Kinematics;

use crate::error::ErrorKind;
use crate::motion::{ArmDescription, JointLimits};
use crate::picture::{self, Chart};
use crate::pose::Pose;

/// Part by which a joint may exceed its velocity limit, for rounding.
const ROUNDING: f64 = 1e-6;

/// Points of a curve in a picture; more are not distinguishable.
const PICTURE_POINTS: u32 = 450;

/// The motion of an arm, from rest to rest.
#[derive(Clone, Debug)]
pub struct Plan {
    arm: ArmDescription,
    kinematics: Option<Arc<dyn Kinematics>>,
    joints: takt_motion::plan::Plan<JointSample>,
    partners: Vec<Self>,
}

impl Plan {
    pub(crate) fn new(arm: &ArmDescription, joints: takt_motion::plan::Plan<JointSample>) -> Self {
        Self {
            arm: arm.clone(),
            kinematics: arm.kinematics(),
            joints,
            partners: Vec::new(),
        }
    }

    pub(crate) fn with_partners(mut self, partners: Vec<Self>) -> Self {
        self.partners = partners;
        self
    }

    /// Name of the arm.
    pub fn device(&self) -> &str {
        &self.arm.name
    }

    /// The plans of the other arms that move with this one.
    pub fn partners(&self) -> &[Self] {
        &self.partners
    }

    /// Time from the start to rest at the goal.
    pub fn duration(&self) -> Duration {
        self.joints.duration()
    }

    /// Completed part of the path at a time after the start, 0 to 1.
    pub fn progress(&self, time: Duration) -> f64 {
        self.joints.at(time).progress
    }

    /// Positions of the joints at a time after the start, rad; after the end, those of the goal.
    pub fn positions(&self, time: Duration) -> Vec<f64> {
        positions(&self.joints.at(time))
    }

    /// Velocities of the joints at a time after the start, rad/s.
    pub fn velocities(&self, time: Duration) -> Vec<f64> {
        let sample = self.joints.at(time);
        sample.joints.iter().map(|joint| joint.velocity).collect()
    }

    /// The pose of the flange in the base of the arm at a time after the start; `None` if the model of the kinematics is
    /// not known to the program.
    pub fn pose(&self, time: Duration) -> Option<Pose> {
        let kinematics = self.kinematics.as_ref()?;
        Some(kinematics.forward(&self.positions(time)).into())
    }

    /// The first time at which a condition over progress (0 to 1) and joint positions (rad) holds.
    pub fn first(&self, condition: impl Fn(f64, &[f64]) -> bool) -> Option<Duration> {
        let holds = |sample: &JointSample| condition(sample.progress, &positions(sample));
        self.joints.first(holds)
    }

    /// The joint positions at the goal, rad.
    pub fn end(&self) -> Vec<f64> {
        self.positions(Duration::MAX)
    }

    /// The motion by cycles of the net: time, progress (0 to 1), joint positions (rad).
    pub fn cycles(&self) -> impl Iterator<Item = (Duration, f64, Vec<f64>)> {
        let cycles = self.joints.cycles();
        cycles.map(|(time, sample)| (time, sample.progress, positions(sample)))
    }

    /// A picture, as the text of an SVG file: positions of the joints over time, and their velocities as parts of their limits;
    /// below it those of the [`Self::partners`].
    pub fn svg(&self) -> String {
        let plans = std::iter::once(self).chain(&self.partners);
        picture::stacked(&plans.flat_map(Self::charts).collect::<Vec<_>>())
    }

    fn charts(&self) -> [Chart; 2] {
        let step = self.duration() / PICTURE_POINTS;
        let times: Vec<_> = (0..=PICTURE_POINTS).map(|number| step * number).collect();
        let name = &self.arm.name;
        let chart = |what: &str, unit: &str, of: &dyn Fn(Duration) -> Vec<f64>| {
            let samples: Vec<_> = times
                .iter()
                .map(|time| (time.as_secs_f64(), of(*time)))
                .collect();
            let chart = Chart::new(&format!("{name}: planned joint {what}"), "time, s", unit);
            (0..self.arm.joints.len()).fold(chart, |chart, joint| {
                let points = samples.iter();
                let points = points.filter_map(|(time, joints)| Some([*time, *joints.get(joint)?]));
                chart.curve(&format!("joint {joint}"), points)
            })
        };
        let positions = |time| {
            self.positions(time)
                .into_iter()
                .map(f64::to_degrees)
                .collect()
        };
        let velocities = |time| {
            let joints = self.velocities(time).into_iter().zip(&self.arm.joints);
            joints
                .map(|(velocity, limits)| velocity / limits.velocity * 100.0)
                .collect()
        };
        [
            chart("positions", "deg", &positions),
            chart("velocities", "% of limit", &velocities),
        ]
    }

    /// Checks that no joint exceeds a part of its velocity limit; `speed` is that of the plan.
    pub(crate) fn check(&self, speed: f64, part: f64) -> Result<(), ErrorKind> {
        let mut found = None;
        let mut most = 1.0 + ROUNDING;
        let mut worst = most;
        for (_, sample) in self.joints.cycles() {
            let joints = sample.joints.iter().zip(&self.arm.joints).enumerate();
            for (joint, (state, limits)) in joints {
                let ratio = state.velocity.abs() / (limits.velocity * part);
                worst = f64::max(worst, ratio);
                if ratio > most && found.is_none() {
                    most = ratio;
                    found = Some((
                        joint,
                        sample.progress,
                        state.velocity,
                        limits.velocity * part,
                    ));
                }
            }
        }
        let Some((joint, progress, velocity, limit)) = found else {
            return Ok(());
        };
        Err(ErrorKind::TooFast {
            device: self.arm.name.clone(),
            joint,
            progress: progress * 100.0,
            velocity,
            limit,
            // Rounded down, so that the number that is shown fits.
            speed: ((speed / worst) * 1000.0).floor() / 1000.0,
        })
    }
}

fn positions(sample: &JointSample) -> Vec<f64> {
    sample.joints.iter().map(|joint| joint.position).collect()
}

/// Largest part of a joint's velocity limit that motions use: set-points are timed again by the clock of a device, which may
/// be slower than that of the controller, and the last stage before the wire holds back what is then too fast.
const VELOCITY_PART_MAX: f64 = 0.999;

/// Limits of a joint at a part of the speed, which scales time.
pub(crate) fn joint_bounds(joint: &JointLimits, speed: f64) -> Bounds {
    Bounds {
        velocity: joint.velocity * VELOCITY_PART_MAX * speed,
        acceleration: joint.acceleration * speed * speed,
        jerk: joint.jerk * speed * speed * speed,
    }
}

/// Why there is no plan for an arm.
pub(crate) fn unplanned(arm: &ArmDescription, error: PlanError) -> ErrorKind {
    ErrorKind::Invalid(format!("{}: {error}", arm.name))
}

/// Why an arm cannot follow a plan.
pub(crate) fn unfit(arm: &ArmDescription, unfit: &Unfit) -> ErrorKind {
    ErrorKind::Unreachable {
        device: arm.name.clone(),
        progress: unfit.progress * 100.0,
        cause: unfit.cause.to_string(),
    }
}

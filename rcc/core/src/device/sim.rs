//! Simulated arms: they are where their set-points say, within their limits. The net thread steps
//! them itself, so they need no thread, no wire and no clock.

use std::collections::BTreeMap;
use std::time::Duration;

use takt_net::value::text::parse_array;
use takt_net::{JointLimits, JointState};
use takt_rt::Nanos;
use takt_rt::latest::LatestWriter;

use crate::device::setpoint::Joint;
use crate::device::{ARM_JOINTS_MAX, ArmDescription, ArmState, DeviceStatus, JointSetPoints};
use crate::error::Error;

/// Device types with the number of their joints and the model of their kinematics.
const KINDS: [(&str, usize, &str); 3] = [
    ("kuka_lwr_sim", 7, "kuka_lwr4"),
    ("kuka_iiwa_sim", 7, "kuka_iiwa7"),
    ("kuka_youbot_arm_sim", 5, "kuka_youbot"),
];

/// The types of devices that can be made while the controller runs.
#[must_use]
pub fn kinds() -> Vec<&'static str> {
    KINDS.iter().map(|(kind, ..)| *kind).collect()
}

/// A simulated arm as it was asked for.
#[derive(Debug)]
pub struct SimArm {
    /// What nets and programs know of it.
    pub description: ArmDescription,
    /// Where its joints are at first, rad.
    pub home: Vec<f64>,
}

impl SimArm {
    /// Reads the parameters `min_joint`, `max_joint`, `max_vel`, `max_acc` and `home_joint`, lists with
    /// one number for each joint (rad, rad/s, rad/s²). Others are not needed here and ignored.
    ///
    /// # Errors
    /// If the type is none of [`kinds`], or a list is missing, unreadable or of another length.
    pub fn read(
        name: &str,
        kind: &str,
        parameters: &BTreeMap<String, String>,
    ) -> Result<Self, Error> {
        let wrong = |what: String| Error::DeviceParameter {
            name: name.to_owned(),
            what,
        };
        let Some((kind, joints, model)) = KINDS.iter().find(|(known, ..)| *known == kind) else {
            let known = kinds().join(", ");
            return Err(wrong(format!(
                "there is no type `{kind}`; there are {known}"
            )));
        };
        let list = |key: &str| -> Result<Option<Vec<f64>>, Error> {
            let Some(text) = parameters.get(key) else {
                return Ok(None);
            };
            let values = parse_array::<f64>(text, ARM_JOINTS_MAX)
                .map_err(|e| wrong(format!("{key}: {}", e.what)))?;
            if values.len() != *joints || values.iter().any(|v| !v.is_finite()) {
                return Err(wrong(format!("{key}: {joints} numbers are wanted")));
            }
            Ok(Some(values))
        };
        let needed = |key: &str| list(key)?.ok_or_else(|| wrong(format!("{key} is missing")));
        let (min, max) = (needed("min_joint")?, needed("max_joint")?);
        let (velocity, acceleration) = (needed("max_vel")?, needed("max_acc")?);
        let home = list("home_joint")?.unwrap_or_else(|| vec![0.0; *joints]);
        let mut limits = Vec::with_capacity(*joints);
        for i in 0..*joints {
            let positive = velocity[i] > 0.0 && acceleration[i] > 0.0;
            if min[i] > max[i] || !positive {
                return Err(wrong(format!("the limits of joint {i} leave it no motion")));
            }
            limits.push(JointLimits {
                position_min: min[i],
                position_max: max[i],
                velocity_max: velocity[i],
                acceleration_max: acceleration[i],
            });
        }
        let (name, model) = (name.to_owned(), (*model).into());
        Ok(Self {
            description: ArmDescription {
                name,
                kind,
                limits,
                model,
            },
            home,
        })
    }
}

/// A simulated arm in the net thread.
#[derive(Debug)]
pub struct Simulation {
    joints: Vec<Joint>,
    state: ArmState,
    told: LatestWriter<ArmState>,
}

impl Simulation {
    /// An arm at rest at home, which tells programs its state through `told`.
    #[must_use]
    pub fn new(arm: &SimArm, told: LatestWriter<ArmState>) -> Self {
        let joint = |(limits, home): (&JointLimits, &f64)| {
            let mut joint = Joint::new(*limits);
            joint.rest_at(*home, &JointSetPoints::default());
            joint
        };
        let joints = arm
            .description
            .limits
            .iter()
            .zip(&arm.home)
            .map(joint)
            .collect();
        let state = ArmState {
            status: DeviceStatus::Operational,
            ..ArmState::default()
        };
        let mut simulation = Self {
            joints,
            state,
            told,
        };
        simulation.tell(Nanos::ZERO);
        simulation
    }

    /// Its state.
    #[must_use]
    pub const fn state(&self) -> &ArmState {
        &self.state
    }

    /// One cycle: takes the set-points of logical time `at`, `dt` after the last cycle. Between two
    /// set-points of a slower net it is on the line between them.
    pub fn step(&mut self, set_points: &[JointSetPoints], at: Nanos, dt: Nanos) {
        let dt_s = Duration::try_from(dt).unwrap_or_default().as_secs_f64();
        for (joint, set_points) in self.joints.iter_mut().zip(set_points) {
            let behind = (set_points.period - dt).max(Nanos::ZERO);
            joint.sample(set_points, true, at - behind, dt_s);
        }
        self.tell(at);
    }

    fn tell(&mut self, at: Nanos) {
        self.state.stamp = at;
        for (told, joint) in self.state.joints.iter_mut().zip(&self.joints) {
            let (position, velocity, acceleration) = joint.motion();
            *told = JointState {
                commanded_position: Some(position),
                commanded_velocity: Some(velocity),
                commanded_acceleration: Some(acceleration),
                measured_position: Some(position),
                measured_velocity: Some(velocity),
                measured_acceleration: Some(acceleration),
                error: joint.error() as i32,
            };
        }
        self.told.write(self.state);
    }
}

//! Properties of an arm by poses all over its ranges: the same poses for the same arm.

use std::time::Instant;

use nalgebra::{DMatrix, Vector3};
use takt_link::Random;
use takt_motion::dynamics::{Body, Dynamics, GRAVITY};
use takt_motion::kinematics::{JointKind, Serial};
use takt_motion::urdf::ArmModel;
use takt_net::Twist;
use takt_net::device::Kinematics;

/// Poses of each measurement.
const POSES: usize = 1000;
/// Sets of the other joints at which a position of one joint must be singular.
const OTHERS: usize = 8;
/// Positions of a joint that are tried for that.
const STEPS: u32 = 720;
/// Smallest singular value of the Jacobian, rad or m, at which a pose counts as singular.
const SINGULAR: f64 = 2e-3;
/// The hint of a near inverse is that far beside the solution, rad or m.
const BESIDE: f64 = 0.1;

/// The largest effort with which a joint holds the arm in any pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Load {
    /// Nm or N.
    pub(super) torque: f64,
    pub(super) unit: &'static str,
    /// Part of the largest effort in the file.
    pub(super) share: Option<f64>,
}

/// Properties of an arm by many poses.
#[derive(Clone, Debug)]
pub(super) struct Survey {
    /// Largest distance of the flange from the base, m.
    pub(super) reach: f64,
    /// Joints with a position at which the arm is singular wherever its other joints are, rad or m.
    pub(super) singular: Vec<(String, f64)>,
    /// Part of the poses whose inverse was found, with the hint beside the solution and anywhere.
    pub(super) near: f64,
    pub(super) far: f64,
    /// Median and maximum time of an inverse with the hint anywhere, us.
    pub(super) inverse_us: (f64, f64),
    /// By joint; `None` without masses.
    pub(super) loads: Vec<Option<Load>>,
}

impl Survey {
    pub(super) fn of(arm: &ArmModel, payload: &Body) -> Self {
        let mut random = Random::new(1);
        let serial = &arm.serial;
        let poses: Vec<_> = (0..POSES)
            .map(|_| random_pose(serial, &mut random))
            .collect();
        let reach = |joints: &Vec<f64>| serial.forward(joints).translation.vector.norm();
        let (near, _) = inverses(serial, &poses, |joints, random| {
            beside(serial, joints, random)
        });
        let (far, times) = inverses(serial, &poses, |_, random| random_pose(serial, random));
        let dynamics = arm.dynamics.clone();
        let dynamics = dynamics.map(|dynamics| dynamics.with_payload(payload));
        Self {
            reach: poses.iter().map(reach).fold(0.0, f64::max),
            singular: singular(arm, &mut random),
            near,
            far,
            inverse_us: times,
            loads: loads(arm, dynamics.as_ref(), &poses),
        }
    }
}

fn random_pose(arm: &Serial, random: &mut Random) -> Vec<f64> {
    let each = arm.ranges().iter();
    each.map(|range| {
        let turn = std::f64::consts::PI;
        random.between(range.min.max(-turn), range.max.min(turn).max(range.min))
    })
    .collect()
}

fn beside(arm: &Serial, joints: &[f64], random: &mut Random) -> Vec<f64> {
    let each = joints.iter().zip(arm.ranges());
    each.map(|(joint, range)| (joint + random.between(-BESIDE, BESIDE)).clamp(range.min, range.max))
        .collect()
}

/// The part of the poses that the inverse finds from these hints, with median and maximum time, us.
fn inverses(
    arm: &Serial,
    poses: &[Vec<f64>],
    hint: impl Fn(&[f64], &mut Random) -> Vec<f64>,
) -> (f64, (f64, f64)) {
    let mut random = Random::new(2);
    let mut times = Vec::with_capacity(poses.len());
    let mut found = 0_u32;
    for joints in poses {
        let target = arm.forward(joints);
        let hint = hint(joints, &mut random);
        let mut solution = vec![0.0; joints.len()];
        let begin = Instant::now();
        let is_found = arm.inverse(&target, &hint, &mut solution).is_ok();
        times.push(begin.elapsed().as_secs_f64() * 1e6);
        found += u32::from(is_found);
    }
    times.sort_by(f64::total_cmp);
    let median = times.get(times.len() / 2).copied().unwrap_or(0.0);
    let longest = times.last().copied().unwrap_or(0.0);
    #[expect(clippy::cast_precision_loss, reason = "a thousand")]
    let all = poses.len() as f64;
    (f64::from(found) / all, (median, longest))
}

/// The smallest singular value of the Jacobian; of an arm with fewer than six joints, that of what it can do.
fn smallest(arm: &Serial, joints: &[f64]) -> f64 {
    let mut columns = vec![Twist::default(); joints.len()];
    arm.jacobian(joints, &mut columns);
    let values = columns
        .iter()
        .flat_map(|it| [it.vel.as_slice(), it.rot.as_slice()].concat());
    let matrix = DMatrix::from_iterator(6, joints.len(), values);
    matrix.singular_values().min()
}

fn singular(arm: &ArmModel, random: &mut Random) -> Vec<(String, f64)> {
    let serial = &arm.serial;
    let sets: Vec<_> = (0..OTHERS).map(|_| random_pose(serial, random)).collect();
    let mut found = Vec::new();
    for (number, joint) in arm.joints.iter().enumerate() {
        let turn = std::f64::consts::PI;
        let (min, max) = (joint.range.min.max(-turn), joint.range.max.min(turn));
        let at = |step: u32| min + (max - min) * f64::from(step) / f64::from(STEPS);
        // The worst of all sets: small only where the position alone decides.
        let worst = |position: f64| {
            let values = sets.iter().map(|set| {
                let mut joints = set.clone();
                joints[number] = position;
                smallest(serial, &joints)
            });
            values.fold(0.0, f64::max)
        };
        let values: Vec<_> = (0..=STEPS).map(|step| worst(at(step))).collect();
        for step in 0..=STEPS {
            let value = |step: u32| values.get(step as usize).copied().unwrap_or(f64::INFINITY);
            let is_least =
                value(step) <= value(step.wrapping_sub(1)) && value(step) < value(step + 1);
            if !is_least {
                continue;
            }
            let width = (max - min) / f64::from(STEPS);
            let (position, least) = minimum(&worst, at(step) - width, at(step) + width);
            if least < SINGULAR && position > min - 1e-9 && position < max + 1e-9 {
                found.push((joint.name.clone(), position + 0.0));
            }
        }
    }
    found
}

/// The minimum of a function with one minimum between two positions.
fn minimum(of: &impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> (f64, f64) {
    for _ in 0..40 {
        let third = (high - low) / 3.0;
        if of(low + third) < of(high - third) {
            high -= third;
        } else {
            low += third;
        }
    }
    let middle = f64::midpoint(low, high);
    // So that 0 is not printed as -0.
    let middle = if middle.abs() < 1e-6 { 0.0 } else { middle };
    (middle, of(middle))
}

fn loads(arm: &ArmModel, dynamics: Option<&Dynamics>, poses: &[Vec<f64>]) -> Vec<Option<Load>> {
    let mut largest = vec![0.0_f64; arm.joints.len()];
    if let Some(dynamics) = dynamics {
        let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
        let mut torques = vec![0.0; largest.len()];
        for joints in poses {
            let rest: Vec<_> = joints.iter().map(|at| [*at, 0.0, 0.0]).collect();
            dynamics.torques(&rest, &gravity, &mut torques);
            for (largest, torque) in largest.iter_mut().zip(&torques) {
                *largest = largest.max(torque.abs());
            }
        }
    }
    let each = arm.joints.iter().zip(largest);
    each.map(|(joint, torque)| {
        dynamics.map(|_| Load {
            torque,
            unit: match joint.kind {
                JointKind::Revolute => "Nm",
                JointKind::Prismatic => "N",
            },
            share: joint.effort_max.map(|most| torque / most),
        })
    })
    .collect()
}

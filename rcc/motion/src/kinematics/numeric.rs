//! The numeric inverse of a serial arm: Levenberg and Marquardt's method on the error of the flange, with damping that
//! follows the success of the last step, joint limits as bounds, and restarts from a fixed sequence of seeds. Steps are the
//! shortest that correct the error, so that redundant joints stay near the hint.
//! Bounded work, no allocation, the same answer for the same question. It knows one solution, not all.

use nalgebra::{Matrix6, Rotation3, SMatrix, SVector, UnitQuaternion, Vector6};
use takt_net::device::Unreachable;

use super::Range;
use super::serial::{Fixed, JOINTS_MAX, JointKind, Serial};

/// Evaluations of the forward kinematics from one seed.
const FROM_SEED: u32 = 25;
/// Evaluations of the forward kinematics for one inverse.
const IN_ALL: u32 = 240;
/// Error of a solution: m, and rad.
const SOLVED: f64 = 1e-9;
/// Largest step of a joint, rad or m: the linear model is no good beyond it.
const STEP_MAX: f64 = 0.8;
/// Error above which a slow descent is given up for another seed.
const COARSE: f64 = 1e-2;
/// Seeds are drawn from this range about the hint where a joint has no limits, rad.
const TURN: Range = Range {
    min: -std::f64::consts::PI,
    max: std::f64::consts::PI,
};

type Joints = SVector<f64, JOINTS_MAX>;
type Jacobian = SMatrix<f64, 6, JOINTS_MAX>;

/// Joint positions near the hint that bring the flange to `target`.
pub(super) fn inverse(
    arm: &Serial,
    target: &Fixed,
    hint: &[f64],
    joints: &mut [f64],
) -> Result<(), Unreachable> {
    let mut search = Search::new(arm, target, hint);
    let mut left = IN_ALL;
    let mut seed = search.hint;
    for number in 1.. {
        if search.descend(seed, &mut left, FROM_SEED) {
            search.write(joints);
            return Ok(());
        }
        if left == 0 {
            break;
        }
        seed = search.seed(number);
    }
    Err(search.cause())
}

/// Corrects positions that are nearly a solution; whether they are one then.
pub(super) fn polish(arm: &Serial, target: &Fixed, joints: &mut [f64]) -> bool {
    let mut search = Search::new(arm, target, joints);
    let is_solved = search.descend(search.hint, &mut 6, 6);
    if is_solved {
        search.write(joints);
    }
    is_solved
}

/// Joint positions all over the ranges of an arm, by number from 1.
pub(super) fn seeds(arm: &Serial) -> impl Fn(u32) -> [f64; JOINTS_MAX] {
    let zero = [0.0; JOINTS_MAX];
    let target = arm.pose(&zero).flange;
    move |number| Search::new(arm, &target, &zero).seed(number).into()
}

/// The error of a flange: to where it should be, m, and the turn to its orientation, rad.
fn error(target: &Fixed, flange: &Fixed) -> Vector6<f64> {
    let off = target.position - flange.position;
    let turn = Rotation3::from_matrix_unchecked(target.rotation * flange.rotation.transpose());
    let turn = UnitQuaternion::from_rotation_matrix(&turn).scaled_axis();
    Vector6::new(off.x, off.y, off.z, turn.x, turn.y, turn.z)
}

struct Search<'a> {
    arm: &'a Serial,
    target: &'a Fixed,
    hint: Joints,
    /// The best positions so far, and their error squared.
    best: (Joints, f64),
}

impl<'a> Search<'a> {
    fn new(arm: &'a Serial, target: &'a Fixed, hint: &[f64]) -> Self {
        let mut start = Joints::zeros();
        for (slot, joint) in start.iter_mut().zip(hint) {
            *slot = *joint;
        }
        Self {
            arm,
            target,
            hint: start,
            best: (start, f64::INFINITY),
        }
    }

    /// The seed with this number, from 1: a point of the Halton sequence within the joint ranges.
    fn seed(&self, number: u32) -> Joints {
        const PRIMES: [u32; JOINTS_MAX] = [2, 3, 5, 7, 11, 13, 17, 19];
        let mut seed = self.hint;
        let each = seed.iter_mut().zip(self.arm.ranges()).zip(PRIMES);
        for ((joint, range), prime) in each {
            let (min, max) = if range.min.is_finite() && range.max.is_finite() {
                // Solutions beyond one turn are turns of others.
                let middle = f64::midpoint(range.min, range.max);
                let half = f64::midpoint(range.max, -range.min).min(TURN.max);
                (middle - half, middle + half)
            } else {
                (*joint + TURN.min, *joint + TURN.max)
            };
            *joint = min + (max - min) * halton(number, prime);
        }
        seed
    }

    /// Descends from a seed with at most `most` evaluations of those that are left; whether it found a solution.
    fn descend(&mut self, seed: Joints, left: &mut u32, most: u32) -> bool {
        let mut joints = self.clamped(seed);
        let mut pose = self.arm.pose(joints.as_slice());
        let mut error = error(self.target, &pose.flange);
        let mut damping = 1e-1;
        let mut budget = most.min(*left);
        *left -= budget;
        while budget > 0 {
            budget -= 1;
            let square = error.norm_squared();
            if square < self.best.1 {
                self.best = (joints, square);
            }
            if error.amax() < SOLVED {
                *left += budget;
                return true;
            }
            let mut jacobian = Jacobian::zeros();
            for (mut column, of_joint) in jacobian.column_iter_mut().zip(self.arm.columns(&pose)) {
                column.fixed_rows_mut::<3>(0).copy_from(&of_joint.vel);
                column.fixed_rows_mut::<3>(3).copy_from(&of_joint.rot);
            }
            let Some(next) = self.step(&joints, jacobian, &error, damping) else {
                break;
            };
            let next_pose = self.arm.pose(next.as_slice());
            let next_error = self::error(self.target, &next_pose.flange);
            if next_error.norm_squared() < square {
                // A seed whose error hardly shrinks is in a local minimum.
                let is_stuck =
                    next_error.norm_squared() > 0.95 * square && square > COARSE * COARSE;
                (joints, pose, error) = (next, next_pose, next_error);
                damping = (damping / 3.0).max(1e-12);
                if is_stuck {
                    break;
                }
            } else {
                damping *= 4.0;
                if damping > 1e3 {
                    break;
                }
            }
        }
        *left += budget;
        false
    }

    /// The positions after a damped step; joints at a limit that it would push beyond are held. `None` without a step.
    fn step(
        &self,
        joints: &Joints,
        mut jacobian: Jacobian,
        error: &Vector6<f64>,
        damping: f64,
    ) -> Option<Joints> {
        for _ in 0..3 {
            let square = jacobian * jacobian.transpose() + Matrix6::identity() * damping;
            let solver = square.cholesky()?;
            let mut step = jacobian.transpose() * solver.solve(error);
            let largest = step.amax();
            if largest > STEP_MAX {
                step *= STEP_MAX / largest;
            }
            let mut is_held = false;
            let each = joints.iter().zip(step.iter()).zip(self.arm.ranges());
            for (number, ((joint, by), range)) in each.enumerate() {
                let is_beyond =
                    (*joint <= range.min && *by < 0.0) || (*joint >= range.max && *by > 0.0);
                if is_beyond {
                    jacobian.column_mut(number).fill(0.0);
                    is_held = true;
                }
            }
            if !is_held {
                return Some(self.clamped(joints + step));
            }
        }
        None
    }

    fn clamped(&self, mut joints: Joints) -> Joints {
        for (joint, range) in joints.iter_mut().zip(self.arm.ranges()) {
            *joint = joint.clamp(range.min, range.max);
        }
        joints
    }

    /// Writes the best positions, with the turns that are nearest to the hint.
    fn write(&self, joints: &mut [f64]) {
        let kinds = self.arm.kinds().iter();
        let each = self.best.0.iter().zip(self.hint.iter()).zip(kinds);
        for (slot, (((joint, hint), kind), range)) in
            joints.iter_mut().zip(each.zip(self.arm.ranges()))
        {
            let turned = range.nearest_turn(*joint, *hint);
            *slot = match kind {
                JointKind::Revolute => turned.unwrap_or(*joint),
                JointKind::Prismatic => *joint,
            };
        }
    }

    /// Why there is no solution, as far as the best positions show it.
    fn cause(&self) -> Unreachable {
        let mut each = self.best.0.iter().zip(self.arm.ranges());
        if each.any(|(joint, range)| *joint <= range.min || *joint >= range.max) {
            Unreachable::Limits
        } else {
            Unreachable::Reach
        }
    }
}

/// The element of Halton's sequence with this number and base, 0 to 1.
fn halton(mut number: u32, base: u32) -> f64 {
    let (mut part, mut sum) = (1.0, 0.0);
    while number > 0 {
        part /= f64::from(base);
        sum += part * f64::from(number % base);
        number /= base;
    }
    sum
}

//! Plans the motion of one coordinate to standstill, with the parts of the trajectory library of
//! which its own entry point consists. That entry point formats a text about each plan that fails,
//! which allocates; this one returns without a text. It checks nothing that the caller can check.

use rsruckig::block::Block;
use rsruckig::position_third_step1::PositionThirdOrderStep1;
use rsruckig::prelude::{DataArrayOrVec, Trajectory};
use rsruckig::velocity_third_step1::VelocityThirdOrderStep1;

use super::bounds::{Bounds, State};

/// Tolerance for rounding: how far a sample may exceed a limit, relative to the limit.
pub(super) const ROUNDING: f64 = 1e-9;

/// By how much the limits are lowered if there is no plan, relative to them. Where a motion reaches a limit just at one
/// instant, two kinds of profile meet, and rounding may rule out both of them.
const LOWERED: [f64; 3] = [0.0, 1e-9, 1e-7];

/// The position at which a coordinate comes to rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Target {
    /// At that position.
    Position(f64),
    /// As soon as possible.
    Anywhere,
}

/// Plans motions of one coordinate.
pub(super) struct Planner {
    step: PositionThirdOrderStep1,
    block: Block,
}

impl Planner {
    pub(super) fn new() -> Self {
        let zero = 0.0;
        Self {
            step: PositionThirdOrderStep1::new(
                zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero,
            ),
            block: Block::default(),
        }
    }

    /// Plans a motion from `now` to rest. It moves backwards only if the lowest velocity, `lowest`,
    /// is below zero. Returns whether there is a plan; if not, `plan` is invalid.
    pub(super) fn plan(
        &mut self,
        now: State,
        target: Target,
        bounds: Bounds,
        lowest: f64,
        plan: &mut Trajectory<1>,
    ) -> bool {
        LOWERED.into_iter().any(|by| {
            let bounds = Bounds {
                velocity: bounds.velocity * (1.0 - by),
                acceleration: bounds.acceleration * (1.0 - 3.0 * by),
                jerk: bounds.jerk,
            };
            self.plan_within(now, target, bounds, lowest, plan)
        })
    }

    fn plan_within(
        &mut self,
        now: State,
        target: Target,
        bounds: Bounds,
        lowest: f64,
        plan: &mut Trajectory<1>,
    ) -> bool {
        let Bounds {
            velocity: highest,
            acceleration: a_max,
            jerk,
        } = bounds;
        let (v, a) = (
            rounded(now.velocity, highest),
            rounded(now.acceleration, a_max),
        );
        let Some(profile) = plan.profiles.first_mut().map(|section| &mut section[0]) else {
            return false;
        };
        let found = match target {
            Target::Position(position) => {
                let brake = &mut profile.brake;
                brake.get_position_brake_trajectory(v, a, highest, lowest, a_max, -a_max, jerk);
                profile.set_boundary(now.position, v, a, position, 0.0, 0.0);
                let [p, v, a] = [&mut profile.p[0], &mut profile.v[0], &mut profile.a[0]];
                profile.brake.finalize(p, v, a);
                let (p, v, a) = (profile.p[0], profile.v[0], profile.a[0]);
                self.step.reset(
                    p, v, a, position, 0.0, 0.0, highest, lowest, a_max, -a_max, jerk,
                );
                self.step.get_profile(profile, &mut self.block)
            }
            Target::Anywhere => {
                let brake = &mut profile.brake;
                brake.get_velocity_brake_trajectory(a, a_max, -a_max, jerk);
                profile.set_boundary_for_velocity(now.position, v, a, 0.0, 0.0);
                let [p, v, a] = [&mut profile.p[0], &mut profile.v[0], &mut profile.a[0]];
                profile.brake.finalize(p, v, a);
                let (v, a) = (profile.v[0], profile.a[0]);
                VelocityThirdOrderStep1::new(v, a, 0.0, 0.0, a_max, -a_max, jerk)
                    .get_profile(profile, &mut self.block)
            }
        };
        *profile = self.block.p_min;
        plan.duration = self.block.t_min;
        plan.independent_min_durations = DataArrayOrVec::new(None, plan.duration);
        if let Some(end) = plan.cumulative_times.first_mut() {
            *end = plan.duration;
        }
        found && plan.duration.is_finite()
    }
}

/// Clamps a value that exceeds its limit by no more than rounding: a plan from outside its limits
/// begins with a return into them.
fn rounded(value: f64, limit: f64) -> f64 {
    let beyond = value.abs() > limit && value.abs() <= limit * (1.0 + ROUNDING);
    if beyond { limit.copysign(value) } else { value }
}

//! What a goal of `FollowJointTrajectory` must be before it is accepted, as far as the message alone decides: names, times, numbers,
//! tolerances. Limits and the present motion of the arm are not known here.

use super::messages::{FollowGoal, Nanos, Point, Tolerance, Trajectory};

/// Codes of the result of `FollowJointTrajectory`.
pub mod code {
    /// Followed to the end.
    pub const SUCCESSFUL: i32 = 0;
    /// The goal makes no sense, or the arm cannot follow it.
    pub const INVALID_GOAL: i32 = -1;
    /// Other joints than those of the arm.
    pub const INVALID_JOINTS: i32 = -2;
    /// It was to begin in the past.
    pub const OLD_HEADER_TIMESTAMP: i32 = -3;
    /// Too far from the trajectory on the way.
    pub const PATH_TOLERANCE_VIOLATED: i32 = -4;
    /// Too far from the goal at the end.
    pub const GOAL_TOLERANCE_VIOLATED: i32 = -5;
}

/// How far in the past a trajectory may begin that counts as beginning now: messages take time.
pub const LATE_MAX: Nanos = 200_000_000;
/// How far in the future a trajectory may begin.
pub const AHEAD_MAX: Nanos = 60_000_000_000;
/// Longest trajectory.
pub const DURATION_MAX: Nanos = 3_600_000_000_000;
/// Velocity at the end that counts as rest, rad/s.
const REST: f64 = 1e-6;

/// Why a goal is not accepted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct Rejection {
    /// One of [`code`].
    pub code: i32,
    /// The cause.
    pub text: String,
}

impl Rejection {
    /// A goal that makes no sense.
    #[must_use]
    pub fn invalid(text: String) -> Self {
        Self {
            code: code::INVALID_GOAL,
            text,
        }
    }

    fn joints(text: String) -> Self {
        Self {
            code: code::INVALID_JOINTS,
            text,
        }
    }
}

/// A tolerance of a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Allowed {
    /// That of the configuration.
    #[default]
    Default,
    /// Any deviation.
    Any,
    /// At most this, rad.
    Most(f64),
}

/// A goal in the order of the joints of the arm.
#[derive(Clone, Debug, PartialEq)]
pub struct Checked {
    /// How long after now it begins, ns.
    pub delay: Nanos,
    /// Its points; lists without elements are absent in all points.
    pub points: Vec<Point>,
    /// By joint.
    pub path: Vec<Allowed>,
    /// By joint.
    pub goal: Vec<Allowed>,
    /// ns; `None` for the default, negative for any.
    pub goal_time: Option<Nanos>,
}

/// Checks a goal for an arm with these joints; `now` in ns since 1970.
///
/// # Errors
/// With the code and text of the result.
pub fn check(goal: &FollowGoal, joints: &[String], now: Nanos) -> Result<Checked, Rejection> {
    if goal.multi_dof != 0 {
        return Err(Rejection::invalid(
            "joints with several axes are not followed".to_owned(),
        ));
    }
    let checked = check_trajectory(&goal.trajectory, joints, now)?;
    Ok(Checked {
        path: tolerances(&goal.path, joints, "path_tolerance")?,
        goal: tolerances(&goal.goal, joints, "goal_tolerance")?,
        goal_time: (goal.goal_time != 0).then_some(goal.goal_time),
        ..checked
    })
}

/// The same for a trajectory without tolerances, as of the topic.
///
/// # Errors
/// As [`check`].
pub fn check_trajectory(
    trajectory: &Trajectory,
    joints: &[String],
    now: Nanos,
) -> Result<Checked, Rejection> {
    let order = order(&trajectory.joints, joints)?;
    let points = points(trajectory, joints, &order)?;
    Ok(Checked {
        delay: delay(trajectory.stamp, now)?,
        points,
        path: vec![Allowed::Default; joints.len()],
        goal: vec![Allowed::Default; joints.len()],
        goal_time: None,
    })
}

/// Where each joint of the arm is among the names.
fn order(names: &[String], joints: &[String]) -> Result<Vec<usize>, Rejection> {
    if let Some(unknown) = names.iter().find(|name| !joints.contains(name)) {
        let text = format!(
            "joint `{unknown}` is none of this arm, which has {}",
            joints.join(", ")
        );
        return Err(Rejection::joints(text));
    }
    let place = |joint: &String| {
        let mut places = names.iter().enumerate().filter(|(_, name)| *name == joint);
        match (places.next(), places.next()) {
            (Some((at, _)), None) => Ok(at),
            (None, _) => Err(Rejection::joints(format!("joint `{joint}` is missing"))),
            (Some(_), Some(_)) => Err(Rejection::joints(format!(
                "joint `{joint}` is named more than once"
            ))),
        }
    };
    joints.iter().map(place).collect()
}

fn delay(stamp: Nanos, now: Nanos) -> Result<Nanos, Rejection> {
    if stamp == 0 {
        return Ok(0);
    }
    let delay = stamp.saturating_sub(now);
    if delay < -LATE_MAX {
        let late = seconds(delay.saturating_neg());
        return Err(Rejection {
            code: code::OLD_HEADER_TIMESTAMP,
            text: format!("the trajectory was to begin {late:.3} s ago"),
        });
    }
    if delay > AHEAD_MAX {
        let text = format!(
            "the trajectory begins in {:.0} s, and at most {:.0} s ahead are accepted",
            seconds(delay),
            seconds(AHEAD_MAX)
        );
        return Err(Rejection::invalid(text));
    }
    Ok(delay.max(0))
}

/// ns in s.
#[must_use]
pub fn seconds(time: Nanos) -> f64 {
    time as f64 * 1e-9
}

fn points(
    trajectory: &Trajectory,
    joints: &[String],
    order: &[usize],
) -> Result<Vec<Point>, Rejection> {
    let Some((first, last)) = trajectory.points.first().zip(trajectory.points.last()) else {
        return Err(Rejection::invalid(
            "the trajectory has no points".to_owned(),
        ));
    };
    let mut before = -1;
    let mut points = Vec::with_capacity(trajectory.points.len());
    for (number, point) in trajectory.points.iter().enumerate() {
        if point.time <= before {
            let text = format!(
                "point {number} is at {:.6} s, not after the one before it",
                seconds(point.time)
            );
            return Err(Rejection::invalid(text));
        }
        before = point.time;
        points.push(sorted(point, first, number, joints, order)?);
    }
    if last.time > DURATION_MAX {
        let text = format!(
            "the trajectory takes {:.0} s, and at most {:.0} s are accepted",
            seconds(last.time),
            seconds(DURATION_MAX)
        );
        return Err(Rejection::invalid(text));
    }
    let moves = |point: &Point| point.velocities.iter().position(|v| v.abs() > REST);
    if let Some(joint) = points.last().and_then(moves) {
        let text = format!(
            "joint `{}` moves at the end of the trajectory",
            joints.get(joint).map_or("", String::as_str)
        );
        return Err(Rejection::invalid(text));
    }
    Ok(points)
}

/// A point in the order of the arm.
fn sorted(
    point: &Point,
    first: &Point,
    number: usize,
    joints: &[String],
    order: &[usize],
) -> Result<Point, Rejection> {
    let lists = [
        ("positions", &point.positions, &first.positions, true),
        ("velocities", &point.velocities, &first.velocities, false),
        (
            "accelerations",
            &point.accelerations,
            &first.accelerations,
            false,
        ),
    ];
    let mut sorted = Vec::with_capacity(3);
    for (what, list, of_first, is_needed) in lists {
        let fits = list.len() == joints.len() || (list.is_empty() && !is_needed);
        if !fits || list.len() != of_first.len() {
            let text = format!(
                "point {number} has {} {what}, and the arm has {} joints; all points have the same values",
                list.len(),
                joints.len()
            );
            return Err(Rejection::invalid(text));
        }
        if let Some(at) = list.iter().position(|value| !value.is_finite()) {
            let text = format!("point {number}: {what}[{at}] is not a number");
            return Err(Rejection::invalid(text));
        }
        let of_joint = |at: &usize| list.get(*at).copied();
        sorted.push(order.iter().filter_map(of_joint).collect::<Vec<_>>());
    }
    if point.effort.iter().any(|effort| *effort != 0.0) {
        let text = format!("point {number} has efforts, which are not commanded");
        return Err(Rejection::invalid(text));
    }
    let [positions, velocities, accelerations] = sorted
        .try_into()
        .unwrap_or_else(|_| [vec![], vec![], vec![]]);
    Ok(Point {
        positions,
        velocities,
        accelerations,
        effort: vec![],
        time: point.time,
    })
}

fn tolerances(all: &[Tolerance], joints: &[String], what: &str) -> Result<Vec<Allowed>, Rejection> {
    let mut by_joint = vec![Allowed::Default; joints.len()];
    for tolerance in all {
        let name = &tolerance.joint;
        let at = joints.iter().position(|joint| joint == name);
        let Some(allowed) = at.and_then(|at| by_joint.get_mut(at)) else {
            let text = format!("{what}: joint `{name}` is none of this arm");
            return Err(Rejection::joints(text));
        };
        if tolerance.velocity > 0.0 || tolerance.acceleration > 0.0 {
            let text = format!(
                "{what}: joint `{name}` has a tolerance of velocity or acceleration; only positions are checked"
            );
            return Err(Rejection::invalid(text));
        }
        *allowed = match tolerance.position {
            most if most > 0.0 => Allowed::Most(most),
            most if most < 0.0 => Allowed::Any,
            most if most.is_nan() => {
                let text = format!("{what}: joint `{name}`: the position is not a number");
                return Err(Rejection::invalid(text));
            }
            _ => Allowed::Default,
        };
    }
    Ok(by_joint)
}

#[cfg(test)]
mod tests;

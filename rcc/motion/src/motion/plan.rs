//! Plans of motions outside nets: how long a motion takes, where it is at a time, when something first holds, and
//! whether an arm can follow. A plan runs the same course as the primitive with the same parameters, cycle by cycle, so
//! that both agree exactly. Not for real-time threads: a plan allocates.

mod check;

use std::time::Duration;

use takt_net::{Frame, Twist};

pub use super::bounds::{Bounds, State};
pub use super::frame_path::FrameState;
pub use check::{Cause, Unfit};

use super::course::{Course, Geometry, Progress, WHOLE};
use super::frame_path::{FramePath, is_sensible};
use super::limits::{LARGEST, SMALLEST};
use super::path::Path;
use super::ptp::JointLine;
use super::spline::Spline;

/// Longest motion that is planned, cycles.
const CYCLES_MAX: usize = 1_000_000;
/// Most joints of a plan.
const JOINTS_MAX: usize = 64;

/// Why there is no plan.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// A position, velocity or acceleration is not a number, or too large.
    #[error("a position, velocity or acceleration is not a number or beyond ±{LARGEST}")]
    Number,
    /// A limit is out of range.
    #[error("a limit is {0}; it must be between {SMALLEST} and {LARGEST}")]
    Limit(f64),
    /// The numbers of starts, goals and limits differ, or there are none or too many.
    #[error(
        "{from} starts, {to} goals and {bounds} limits; a plan needs as many of each, 1 to {JOINTS_MAX}"
    )]
    Joints {
        /// Number of starts.
        from: usize,
        /// Number of goals.
        to: usize,
        /// Number of limits.
        bounds: usize,
    },
    /// No path leads through these points.
    #[error(
        "no path leads through these points: they are on one line, or neighbours are one point"
    )]
    Path,
    /// The limits differ too much in magnitude for a motion.
    #[error("no motion keeps these limits: their magnitudes differ too much")]
    Bounds,
    /// The cycle time is zero.
    #[error("the cycle time is zero")]
    Period,
    /// The motion does not end within a million cycles.
    #[error("the motion does not end within {CYCLES_MAX} cycles")]
    Endless,
}

/// Limits of the motion of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameBounds {
    /// Of the position, in m.
    pub translation: Bounds,
    /// Of the orientation, in rad.
    pub rotation: Bounds,
}

impl Bounds {
    pub(super) fn check(self) -> Result<(), PlanError> {
        let limits = [self.velocity, self.acceleration, self.jerk];
        let invalid = limits
            .into_iter()
            .find(|limit| !(SMALLEST..=LARGEST).contains(limit));
        invalid.map_or(Ok(()), |limit| Err(PlanError::Limit(limit)))
    }
}

/// A planned motion; `S` is its state at a time.
#[derive(Clone, Debug)]
pub struct Plan<S> {
    period: Duration,
    /// By cycle, from the start on.
    samples: Box<[S]>,
}

/// A motion in which joints are at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct JointSample {
    /// Completed part of the path, 0 to 1.
    pub progress: f64,
    /// State of each joint, rad.
    pub joints: Box<[State]>,
}

/// A motion in which a frame is at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameSample {
    /// Completed part of the path, 0 to 1.
    pub progress: f64,
    /// The frame in the base, m.
    pub frame: Frame,
    /// Its velocity in the base, m/s and rad/s.
    pub velocity: Twist,
    /// Where it comes to rest if it is stopped in two cycles, m.
    pub rest: Frame,
}

/// A sample of a motion, between two others.
pub trait Sample: Clone {
    /// The motion a part (0 to 1) of a cycle of `period_s` (s) after this sample, before the next one.
    #[must_use]
    fn between(&self, next: &Self, part: f64, period_s: f64) -> Self;
}

fn mix(from: f64, to: f64, part: f64) -> f64 {
    from * (1.0 - part) + to * part
}

/// The cubic between two positions with their velocities, per s.
fn cubic([from, to]: [f64; 2], [leaving, arriving]: [f64; 2], part: f64, period_s: f64) -> f64 {
    let points = crate::shape::hermite(from, to, leaving * period_s, arriving * period_s);
    crate::shape::bezier(part, points)
}

impl Sample for JointSample {
    fn between(&self, next: &Self, part: f64, period_s: f64) -> Self {
        let pairs = self.joints.iter().zip(&next.joints);
        let joint = |(from, to): (&State, &State)| State {
            position: cubic(
                [from.position, to.position],
                [from.velocity, to.velocity],
                part,
                period_s,
            ),
            velocity: cubic(
                [from.velocity, to.velocity],
                [from.acceleration, to.acceleration],
                part,
                period_s,
            ),
            acceleration: mix(from.acceleration, to.acceleration, part),
        };
        Self {
            progress: mix(self.progress, next.progress, part),
            joints: pairs.map(joint).collect(),
        }
    }
}

impl Sample for FrameSample {
    fn between(&self, next: &Self, part: f64, period_s: f64) -> Self {
        let (from, to) = (self.frame.translation.vector, next.frame.translation.vector);
        let (leaving, arriving) = (self.velocity.vel, next.velocity.vel);
        let at = from.zip_zip_map(
            &to,
            &leaving.zip_map(&arriving, |a, b| (a, b)),
            |from, to, (a, b)| cubic([from, to], [a, b], part, period_s),
        );
        let turn = (next.frame.rotation * self.frame.rotation.inverse()).scaled_axis() * part;
        let rotation = nalgebra::UnitQuaternion::from_scaled_axis(turn) * self.frame.rotation;
        Self {
            progress: mix(self.progress, next.progress, part),
            frame: Frame::from_parts(at.into(), rotation),
            velocity: Twist {
                vel: leaving.lerp(&arriving, part),
                rot: self.velocity.rot.lerp(&next.velocity.rot, part),
            },
            rest: self.rest,
        }
    }
}

impl<S: Sample> Plan<S> {
    /// Time from the start to rest at the end.
    pub fn duration(&self) -> Duration {
        self.time(self.samples.len() - 1)
    }

    fn time(&self, cycle: usize) -> Duration {
        self.period
            .saturating_mul(u32::try_from(cycle).unwrap_or(u32::MAX))
    }

    /// The motion at a time after its start; after its end, at rest there.
    pub fn at(&self, time: Duration) -> S {
        let cycles = time.as_secs_f64() / self.period.as_secs_f64();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates, and is then the end"
        )]
        let cycle = (cycles + 1e-9) as usize;
        // Saturated: a time after the end, however long.
        match (
            self.samples.get(cycle),
            self.samples.get(cycle.saturating_add(1)),
        ) {
            (Some(now), Some(next)) => {
                let part = (cycles - cycles.floor()).clamp(0.0, 1.0);
                let part = if part > 1.0 - 1e-9 { 0.0 } else { part };
                now.between(next, part, self.period.as_secs_f64())
            }
            _ => self.samples[self.samples.len() - 1].clone(),
        }
    }

    /// The time of the first cycle in which a condition holds.
    pub fn first(&self, condition: impl Fn(&S) -> bool) -> Option<Duration> {
        let cycle = self.samples.iter().position(condition)?;
        Some(self.time(cycle))
    }

    /// The motion in each cycle, with its time.
    pub fn cycles(&self) -> impl Iterator<Item = (Duration, &S)> {
        let numbered = self.samples.iter().enumerate();
        numbered.map(|(cycle, sample)| (self.time(cycle), sample))
    }
}

/// Runs a course to its end, from its first sample on.
fn run<S>(
    mut course: Course,
    first: Option<S>,
    period: Duration,
    sample: impl Fn(Progress, &Course) -> S,
) -> Result<Plan<S>, PlanError> {
    if course.duration() / period.as_secs_f64() > CYCLES_MAX as f64 {
        return Err(PlanError::Endless);
    }
    // A motion that begins in motion is one cycle further in its first cycle.
    let mut samples: Vec<S> = first.into_iter().collect();
    loop {
        let progress = course.step(1.0, false);
        samples.push(sample(progress, &course));
        if progress.is_done {
            break;
        }
        if samples.len() > CYCLES_MAX {
            return Err(PlanError::Endless);
        }
    }
    Ok(Plan {
        period,
        samples: samples.into(),
    })
}

fn course(along: (f64, Bounds), speed: f64, period: Duration) -> Result<Course, PlanError> {
    if period.is_zero() {
        return Err(PlanError::Period);
    }
    Course::new(along, speed, period.as_secs_f64()).ok_or(PlanError::Bounds)
}

/// The motion of joints from a state (rad) to rest at a goal (rad), as `Motion::Ptp` makes it in cycles of `period`.
///
/// # Errors
/// If there is no such motion.
pub fn plan(
    from: &[State],
    to: &[f64],
    bounds: &[Bounds],
    period: Duration,
) -> Result<Plan<JointSample>, PlanError> {
    let joints = from.len();
    if joints != to.len() || joints != bounds.len() || !(1..=JOINTS_MAX).contains(&joints) {
        return Err(PlanError::Joints {
            from: joints,
            to: to.len(),
            bounds: bounds.len(),
        });
    }
    let are_numbers = from.iter().all(|state| state.is_sensible());
    if !are_numbers || !to.iter().all(|goal| super::is_sensible(*goal)) {
        return Err(PlanError::Number);
    }
    bounds.iter().try_for_each(|bounds| bounds.check())?;
    let start = from.iter().map(|state| state.position).collect();
    let mut line = JointLine::new(start, to.into(), bounds.into(), 1.0);
    let mut course = course(line.along(WHOLE), 1.0, period)?;
    let is_moving = from
        .iter()
        .any(|state| *state != State::at_rest(state.position));
    let first = is_moving.then(|| JointSample {
        progress: 0.0,
        joints: from.into(),
    });
    if is_moving {
        course = course.with_lead(joints, period.as_secs_f64());
        line.begin(&mut course, from, 1.0);
    }
    run(course, first, period, |progress, course| JointSample {
        progress: progress.part.clamp(0.0, 1.0),
        joints: (0..joints)
            .map(|joint| line.at(joint, progress, course.lead()))
            .collect(),
    })
}

/// A path of a frame, m.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Route {
    /// Straight from where the frame is, as `Motion::Lin`.
    Line {
        /// The end.
        to: Frame,
    },
    /// Onto the line between two frames, as `Motion::Lin` with `Join`.
    Join {
        /// Start of the line.
        from: Frame,
        /// End of the line.
        to: Frame,
        /// Part of the line from which on the frame is on it, 0 to 1.
        at: f64,
    },
    /// Along an arc, as `Motion::Circ`.
    Arc {
        /// Start of the arc.
        from: Frame,
        /// A point on it.
        via: Frame,
        /// The end.
        to: Frame,
    },
    /// Through points, as `Motion::Spline`.
    Spline {
        /// The points, from the start on.
        points: Vec<Frame>,
        /// Directions at the points, or none.
        tangents: Vec<Twist>,
    },
}

impl Route {
    /// The path, and the end of a line that begins where the frame is, and where to join a line.
    fn path(&self, start: &FrameState) -> Option<(Path, Option<Frame>, Option<f64>)> {
        Some(match self {
            Self::Line { to } => (Path::line(start.frame, to), Some(*to), None),
            Self::Join { from, to, at } => (Path::line(*from, to), None, Some(*at)),
            Self::Arc { from, via, to } => (Path::arc(*from, via, to)?, None, None),
            Self::Spline { points, tangents } => {
                let fits = tangents.is_empty() || tangents.len() == points.len();
                let spline = Spline::new(points, tangents).filter(|_| fits)?;
                (Path::spline(spline, *points.first()?), None, None)
            }
        })
    }

    fn is_sensible(&self) -> bool {
        match self {
            Self::Line { to } => is_sensible(to),
            Self::Join { from, to, at } => {
                is_sensible(from) && is_sensible(to) && (0.0..=1.0).contains(at)
            }
            Self::Arc { from, via, to } => [from, via, to].into_iter().all(is_sensible),
            Self::Spline { points, tangents } => {
                let values = tangents
                    .iter()
                    .flat_map(|twist| twist.vel.iter().chain(&twist.rot));
                points.iter().all(is_sensible) && values.copied().all(super::is_sensible)
            }
        }
    }
}

/// The motion of a frame from a state along a route to rest at its end, as the primitives of the route make it in cycles
/// of `period`.
///
/// # Errors
/// If there is no such motion.
pub fn plan_frame(
    from: &FrameState,
    route: &Route,
    bounds: FrameBounds,
    period: Duration,
) -> Result<Plan<FrameSample>, PlanError> {
    plan_frame_at(from, route, bounds, 1.0, period)
}

/// The same at a part of the speed, above 0 to 1, which scales time: a stop brakes within the whole limits of acceleration and
/// jerk, which the samples' places of rest show.
///
/// # Errors
/// If there is no such motion.
pub fn plan_frame_at(
    from: &FrameState,
    route: &Route,
    bounds: FrameBounds,
    speed: f64,
    period: Duration,
) -> Result<Plan<FrameSample>, PlanError> {
    if !from.is_sensible() || !route.is_sensible() {
        return Err(PlanError::Number);
    }
    let bounds = [bounds.translation, bounds.rotation].map(|bounds| bounds.at_speed(speed));
    bounds.iter().try_for_each(|bounds| bounds.check())?;
    let (path, to, join) = route.path(from).ok_or(PlanError::Path)?;
    let [translation, rotation] = bounds;
    let mut path = FramePath {
        path,
        translation,
        rotation,
    };
    let mut course = course(path.along(WHOLE), speed, period)?;
    let starts = join.is_none() && *from == FrameState::at_rest(path.path.at(0.0));
    let first = (!starts).then_some(FrameSample {
        progress: 0.0,
        frame: from.frame,
        velocity: from.velocity,
        rest: from.frame,
    });
    if !starts {
        course = course.with_lead(6, period.as_secs_f64());
        super::cartesian::begin(&mut path, &mut course, from, (to, join), 1.0);
    }
    run(course, first, period, |progress, course| {
        let (frame, velocity) = path.at(progress, course.lead());
        FrameSample {
            progress: progress.part.clamp(0.0, 1.0),
            frame,
            velocity,
            rest: path.path.at(course.rest()),
        }
    })
}

//! Motions whose goals are known only while they run, such as those of an interpreted program. All memory is taken when a
//! motion is made; beginning and stepping one allocates nothing, so both are for real-time threads. They run the course
//! of the `Motion::*` primitives. Joint limits along the path of a frame are not checked here.

use std::time::Duration;

use takt_net::Frame;

use super::bounds::{Bounds, State};
use super::cartesian;
use super::course::{Course, Geometry, Progress};
use super::frame_path::{FramePath, FrameState, is_sensible};
use super::path::Path;
use super::plan::{FrameBounds, PlanError, Route};
use super::ptp::JointLine;

/// Most joints of a motion.
const JOINTS_MAX: usize = 64;

const UNIT: Bounds = Bounds {
    velocity: 1.0,
    acceleration: 1.0,
    jerk: 1.0,
};

/// What a cycle of a motion reached.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Step {
    /// Completed part of the path, 0 to 1.
    pub progress: f64,
    /// At rest at the end, or stopped.
    pub is_done: bool,
}

impl From<Progress> for Step {
    fn from(progress: Progress) -> Self {
        Self {
            progress: progress.part.clamp(0.0, 1.0),
            is_done: progress.is_done,
        }
    }
}

fn course(period: Duration, axes: usize) -> Result<Course, PlanError> {
    if period.is_zero() {
        return Err(PlanError::Period);
    }
    let period_s = period.as_secs_f64();
    let course = Course::new((0.0, UNIT), 1.0, period_s).ok_or(PlanError::Bounds)?;
    Ok(course.with_lead(axes, period_s))
}

/// A motion of joints, as `Motion::Ptp` makes it.
pub struct JointMotion {
    course: Course,
    line: JointLine,
    progress: Progress,
}

impl std::fmt::Debug for JointMotion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("JointMotion")
            .field("line", &self.line)
            .finish_non_exhaustive()
    }
}

impl JointMotion {
    /// A motion of that many joints in cycles of `period`, before its first beginning.
    ///
    /// # Errors
    /// If there are no joints or too many, or the period is zero.
    pub fn new(joints: usize, period: Duration) -> Result<Self, PlanError> {
        if !(1..=JOINTS_MAX).contains(&joints) {
            return Err(PlanError::Joints {
                from: joints,
                to: joints,
                bounds: joints,
            });
        }
        Ok(Self {
            course: course(period, joints)?,
            line: JointLine::new(
                vec![0.0; joints].into(),
                vec![0.0; joints].into(),
                vec![UNIT; joints].into(),
                1.0,
            ),
            progress: Progress::default(),
        })
    }

    /// Begins in the state of the previous cycle (rad), towards rest at `to` (rad), at this part of the velocity limits
    /// (0 to 1). The next step is one cycle further. Allocates nothing.
    ///
    /// # Errors
    /// If a number is not one of a motion; the motion is then as it was.
    pub fn begin(
        &mut self,
        from: &[State],
        to: &[f64],
        bounds: &[Bounds],
        speed: f64,
    ) -> Result<(), PlanError> {
        let joints = self.line.to.len();
        if from.len() != joints || to.len() != joints || bounds.len() != joints {
            return Err(PlanError::Joints {
                from: from.len(),
                to: to.len(),
                bounds: bounds.len(),
            });
        }
        let are_numbers = from.iter().all(|state| state.is_sensible());
        if !are_numbers || !to.iter().all(|goal| super::is_sensible(*goal)) {
            return Err(PlanError::Number);
        }
        bounds.iter().try_for_each(|bounds| bounds.check())?;
        self.line.to.copy_from_slice(to);
        self.line.bounds.copy_from_slice(bounds);
        self.line.begin(&mut self.course, from, speed);
        self.progress = self.course.progress();
        Ok(())
    }

    /// One cycle at this part of the velocity limits (0 to 1); `stop` brakes on the path for good.
    pub fn step(&mut self, speed: f64, stop: bool) -> Step {
        self.progress = self.course.step(speed, stop);
        self.progress.into()
    }

    /// The state of a joint, rad; at rest at 0 for one that does not exist.
    pub fn joint(&self, joint: usize) -> State {
        if joint < self.line.to.len() {
            self.line.at(joint, self.progress, self.course.lead())
        } else {
            State::default()
        }
    }

    /// Time from the beginning to rest at the end, s, at the speed at which it began.
    pub fn duration_s(&self) -> f64 {
        self.course.duration()
    }
}

/// A motion of a frame along a line or an arc, as `Motion::Lin` and `Motion::Circ` make it.
pub struct FrameMotion {
    course: Course,
    path: FramePath,
    progress: Progress,
    length_m: f64,
}

impl std::fmt::Debug for FrameMotion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FrameMotion")
            .field("path", &self.path)
            .finish_non_exhaustive()
    }
}

impl FrameMotion {
    /// A motion in cycles of `period`, before its first beginning.
    ///
    /// # Errors
    /// If the period is zero.
    pub fn new(period: Duration) -> Result<Self, PlanError> {
        Ok(Self {
            course: course(period, 6)?,
            path: FramePath {
                path: Path::line(Frame::identity(), &Frame::identity()),
                translation: UNIT,
                rotation: UNIT,
            },
            progress: Progress::default(),
            length_m: 0.0,
        })
    }

    /// Begins in the state of the previous cycle, along a route, at this part of the velocity limits (0 to 1). The next
    /// step is one cycle further. Allocates nothing.
    ///
    /// # Errors
    /// If a number is not one of a motion, or no path leads through the points; splines are not possible here. The
    /// motion is then as it was.
    pub fn begin(
        &mut self,
        from: &FrameState,
        route: &Route,
        bounds: FrameBounds,
        speed: f64,
    ) -> Result<(), PlanError> {
        if !from.is_sensible() {
            return Err(PlanError::Number);
        }
        bounds.translation.check()?;
        bounds.rotation.check()?;
        let (path, to, join) = match route {
            Route::Line { to } if is_sensible(to) => (Path::line(from.frame, to), Some(*to), None),
            Route::Join {
                from: start,
                to,
                at,
            } if is_sensible(start) && is_sensible(to) && (0.0..=1.0).contains(at) => {
                (Path::line(*start, to), None, Some(*at))
            }
            Route::Arc {
                from: start,
                via,
                to,
            } if [start, via, to].into_iter().all(is_sensible) => {
                let arc = Path::arc(*start, via, to).ok_or(PlanError::Path)?;
                (arc, None, None)
            }
            Route::Spline { .. } => return Err(PlanError::Path),
            Route::Line { .. } | Route::Join { .. } | Route::Arc { .. } => {
                return Err(PlanError::Number);
            }
        };
        self.path = FramePath {
            path,
            translation: bounds.translation,
            rotation: bounds.rotation,
        };
        cartesian::begin(&mut self.path, &mut self.course, from, (to, join), speed);
        self.progress = self.course.progress();
        self.length_m = self.path.path.translation_length();
        Ok(())
    }

    /// One cycle at this part of the velocity limits (0 to 1); `stop` brakes on the path for good.
    pub fn step(&mut self, speed: f64, stop: bool) -> Step {
        self.progress = self.course.step(speed, stop);
        self.progress.into()
    }

    /// The frame in motion.
    pub fn state(&self) -> FrameState {
        let (frame, velocity) = self.path.at(self.progress, self.course.lead());
        FrameState {
            frame,
            velocity,
            acceleration: self.path.acceleration(self.progress, self.course.lead()),
        }
    }

    /// The frame at which the motion would be at rest if it were stopped two cycles from now.
    pub fn rest(&self) -> Frame {
        self.path.path.at(self.course.rest())
    }

    /// Length of the path of the position, m.
    pub const fn length_m(&self) -> f64 {
        self.length_m
    }

    /// Angle between the orientations at the ends of the path, rad.
    pub fn angle_rad(&self) -> f64 {
        self.path.path.angle()
    }

    /// Speed along the path, relative to its velocity limit there.
    pub fn relative_speed(&self) -> f64 {
        self.path
            .speed(self.progress.part, self.progress.rate, &[0.0; 6])
    }

    /// Time from the beginning to rest at the end, s, at the speed at which it began.
    pub fn duration_s(&self) -> f64 {
        self.course.duration()
    }
}

#[cfg(test)]
mod tests {
    use takt_net::Twist;

    use super::super::plan::{plan, plan_frame};
    use super::*;

    const STILL: Twist = Twist {
        vel: nalgebra::Vector3::new(0.0, 0.0, 0.0),
        rot: nalgebra::Vector3::new(0.0, 0.0, 0.0),
    };

    const PERIOD: Duration = Duration::from_millis(1);
    const BOUNDS: Bounds = Bounds {
        velocity: 0.5,
        acceleration: 1.0,
        jerk: 10.0,
    };
    const FRAME_BOUNDS: FrameBounds = FrameBounds {
        translation: BOUNDS,
        rotation: BOUNDS,
    };

    #[test]
    fn joint_motion_agrees_with_plan() {
        let from = [
            State::at_rest(0.1),
            State {
                position: -0.4,
                velocity: 0.2,
                acceleration: 0.0,
            },
        ];
        let planned = plan(&from, &[1.0, 0.3], &[BOUNDS; 2], PERIOD).unwrap();
        let mut motion = JointMotion::new(2, PERIOD).unwrap();
        // A motion can begin again and again.
        motion.begin(&from, &[3.0, 3.0], &[BOUNDS; 2], 0.3).unwrap();
        motion.step(1.0, false);
        motion.begin(&from, &[1.0, 0.3], &[BOUNDS; 2], 1.0).unwrap();
        for (time, sample) in planned.cycles().skip(1) {
            motion.step(1.0, false);
            for joint in 0..2 {
                let error = motion.joint(joint).position - sample.joints[joint].position;
                assert!(error.abs() < 1e-12, "joint {joint} at {time:?}: {error}");
            }
        }
        assert!(motion.step(1.0, false).is_done);
    }

    #[test]
    fn frame_motion_agrees_with_plan() {
        let from = FrameState::at_rest(Frame::translation(0.1, 0.2, 0.3));
        let to = Frame::translation(0.4, 0.2, 0.1);
        let via = Frame::translation(0.3, 0.3, 0.3);
        for route in [
            Route::Line { to },
            Route::Arc {
                from: from.frame,
                via,
                to,
            },
        ] {
            let planned = plan_frame(&from, &route, FRAME_BOUNDS, PERIOD).unwrap();
            let mut motion = FrameMotion::new(PERIOD).unwrap();
            motion.begin(&from, &route, FRAME_BOUNDS, 1.0).unwrap();
            for (time, sample) in planned.cycles().skip(1) {
                motion.step(1.0, false);
                let at = motion.state();
                let error = at.frame.translation.vector - sample.frame.translation.vector;
                assert!(error.norm() < 1e-12, "{time:?}: {error}");
            }
            assert!(motion.step(1.0, false).is_done);
            assert_eq!(motion.state().velocity, STILL);
        }
    }

    #[test]
    fn frame_acceleration_is_rate_of_velocity() {
        let from = FrameState {
            frame: Frame::translation(0.1, 0.2, 0.3),
            velocity: Twist {
                vel: nalgebra::Vector3::new(0.1, 0.05, 0.0),
                ..STILL
            },
            acceleration: STILL,
        };
        let to = Frame::translation(0.4, 0.2, 0.1);
        let mut motion = FrameMotion::new(PERIOD).unwrap();
        motion
            .begin(&from, &Route::Line { to }, FRAME_BOUNDS, 1.0)
            .unwrap();
        let mut before = from;
        for cycle in 0..2_000 {
            motion.step(1.0, false);
            let now = motion.state();
            let mean = (before.acceleration.vel + now.acceleration.vel) / 2.0;
            let rate = (now.velocity.vel - before.velocity.vel) / 1e-3;
            assert!((mean - rate).norm() < 0.02, "{cycle}: {mean} {rate}");
            before = now;
        }
    }

    #[test]
    fn invalid_beginning_leaves_motion_unchanged() {
        let mut motion = JointMotion::new(1, PERIOD).unwrap();
        let start = [State::at_rest(0.0)];
        motion.begin(&start, &[1.0], &[BOUNDS], 1.0).unwrap();
        let bad = Bounds {
            velocity: f64::NAN,
            ..BOUNDS
        };
        for (to, bounds) in [(f64::INFINITY, BOUNDS), (1.0, bad)] {
            assert!(motion.begin(&start, &[to], &[bounds], 1.0).is_err());
        }
        assert!(motion.begin(&[], &[], &[], 1.0).is_err());
        while !motion.step(1.0, false).is_done {}
        assert!((motion.joint(0).position - 1.0).abs() < 1e-12);
    }
}

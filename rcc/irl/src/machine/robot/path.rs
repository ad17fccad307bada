//! The path of a tool: a motion along a line or an arc, and while they overlap, the one before, which brakes into the corner. The sum
//! of both rounds the corner. Joints are not known here.

use std::time::Duration;

use takt_motion::live::{FrameMotion, Step};
use takt_motion::plan::{FrameBounds, FrameState, PlanError, Route};
use takt_net::Frame;

/// Motions of a tool.
#[derive(Debug)]
pub(super) struct ToolPath {
    motion: FrameMotion,
    /// The motion before.
    tail: FrameMotion,
    /// Where it ends, while it goes on.
    corner: Option<Frame>,
    /// Speed of the motion in the cycle before, m/s and rad/s together.
    speed: f64,
    is_braking: bool,
}

impl ToolPath {
    pub(super) fn new(period: Duration) -> Result<Self, PlanError> {
        Ok(Self {
            motion: FrameMotion::new(period)?,
            tail: FrameMotion::new(period)?,
            corner: None,
            speed: 0.0,
            is_braking: false,
        })
    }

    /// Begins a motion in that state.
    pub(super) fn begin(
        &mut self,
        from: &FrameState,
        route: &Route,
        bounds: FrameBounds,
    ) -> Result<(), PlanError> {
        self.corner = None;
        (self.speed, self.is_braking) = (0.0, false);
        self.motion.begin(from, route, bounds, 1.0)
    }

    /// Begins a motion at the end of the present one, which goes on; both are added. It is an error while the one before
    /// that goes on.
    pub(super) fn begin_at_corner(
        &mut self,
        corner: Frame,
        route: &Route,
        bounds: FrameBounds,
    ) -> Result<(), PlanError> {
        if self.corner.is_some() {
            return Err(PlanError::Path);
        }
        std::mem::swap(&mut self.motion, &mut self.tail);
        let begun = self
            .motion
            .begin(&FrameState::at_rest(corner), route, bounds, 1.0);
        if begun.is_err() {
            std::mem::swap(&mut self.motion, &mut self.tail);
            return begun;
        }
        self.corner = Some(corner);
        (self.speed, self.is_braking) = (0.0, false);
        Ok(())
    }

    /// Begins the motion of a corner again, as another one.
    pub(super) fn begin_again(
        &mut self,
        corner: Frame,
        route: &Route,
        bounds: FrameBounds,
    ) -> Result<(), PlanError> {
        self.motion
            .begin(&FrameState::at_rest(corner), route, bounds, 1.0)
    }

    /// Time that the motion takes from rest, s.
    pub(super) fn duration_s(&self) -> f64 {
        self.motion.duration_s()
    }

    /// One cycle, as [`FrameMotion::step`].
    pub(super) fn step(&mut self, speed: f64, stop: bool) -> Step {
        let mut step = self.motion.step(speed, stop);
        let velocity = self.motion.state().velocity;
        let now = velocity.vel.norm() + velocity.rot.norm();
        self.is_braking = now < self.speed;
        self.speed = now;
        if self.corner.is_some() {
            let tail = self.tail.step(speed, stop);
            step.is_done &= tail.is_done;
            // One that was stopped does not reach the corner.
            if tail.is_done && !stop {
                self.corner = None;
            }
        }
        step
    }

    /// Where the tool is.
    pub(super) fn now(&self) -> Frame {
        let next = self.motion.state().frame;
        self.with_tail(self.tail.state().frame, next)
    }

    /// Where the tool would rest if it were stopped two cycles from now.
    pub(super) fn rest(&self) -> Frame {
        self.with_tail(self.tail.rest(), self.motion.rest())
    }

    fn with_tail(&self, tail: Frame, next: Frame) -> Frame {
        let Some(corner) = self.corner else {
            return next;
        };
        let position =
            tail.translation.vector + next.translation.vector - corner.translation.vector;
        let turn = next.rotation * corner.rotation.inverse();
        Frame::from_parts(position.into(), turn * tail.rotation)
    }

    /// Whether the next motion can begin at its end: it brakes, alone, and is at most so far from its end, m and rad.
    pub(super) fn is_near_end(&self, progress: f64, length_m: f64, angle_rad: f64) -> bool {
        let rest = 1.0 - progress;
        let near = length_m > 0.0 && rest * self.motion.length_m() <= length_m;
        let turned = angle_rad > 0.0 && rest * self.motion.angle_rad() <= angle_rad;
        self.is_braking && self.corner.is_none() && (near || turned)
    }
}

//! An arm that is jogged through the Robotics API, in one direction at a time. What decides on the direction is not here.

use std::time::{Duration, Instant};

use anyhow::ensure;
use takt_api::{Arm, Error, JointVelocities, LiveHandle, Outcome, Twist};

use super::direction::{Axis, Direction};
use super::failure::hinted;
use crate::signal::Stop;

/// How often a velocity is sent: the controller brakes when the last one is older than 0.1 s.
pub(super) const TICK: Duration = Duration::from_millis(20);

/// Checks that an arm has this direction.
pub(super) fn known(direction: Direction, arm: &Arm) -> anyhow::Result<()> {
    let count = arm.description().joints.len();
    if let Axis::Joint(joint) = direction.axis {
        ensure!(
            joint < count,
            "there is no joint {joint}\nhint: joints count from 0; {} has {count}",
            arm.description().name
        );
    }
    Ok(())
}

/// What runs: one net for the flange, another for joints.
#[derive(Debug)]
enum Running {
    Flange(LiveHandle<Twist>),
    Joints(LiveHandle<JointVelocities>),
}

impl Running {
    fn ended(&self) -> Option<Result<Outcome, Error>> {
        match self {
            Self::Flange(handle) => handle.outcome(),
            Self::Joints(handle) => handle.outcome(),
        }
    }
}

/// An arm that is jogged.
#[derive(Debug)]
pub(super) struct Jogging<'a> {
    pub(super) arm: &'a Arm,
    speed: f64,
    running: Option<Running>,
    is_moving: bool,
}

impl<'a> Jogging<'a> {
    pub(super) const fn new(arm: &'a Arm, speed: f64) -> Self {
        Self {
            arm,
            speed,
            running: None,
            is_moving: false,
        }
    }

    /// Moves in a direction until the next 0.1 s are over, or another one is sent.
    pub(super) fn send(&mut self, direction: Direction) -> Result<(), Error> {
        let sent = match direction.twist(&self.arm.limits()) {
            Some(twist) => self.send_twist(twist),
            None => self.send_joints(direction.joints(self.arm).unwrap_or_default()),
        };
        self.is_moving = sent.is_ok();
        if sent.is_err() {
            self.running = None;
        }
        sent
    }

    fn send_twist(&mut self, twist: Twist) -> Result<(), Error> {
        if let Some(Running::Flange(handle)) = &self.running {
            return handle.send(twist);
        }
        let handle = self.arm.jog().speed(self.speed).now().begin()?;
        handle.send(twist)?;
        self.running = Some(Running::Flange(handle));
        Ok(())
    }

    fn send_joints(&mut self, velocities: Vec<f64>) -> Result<(), Error> {
        if let Some(Running::Joints(handle)) = &self.running {
            return handle.send(velocities);
        }
        let handle = self.arm.jog_joints().speed(self.speed).now().begin()?;
        handle.send(velocities)?;
        self.running = Some(Running::Joints(handle));
        Ok(())
    }

    /// Brakes, if it moves; the net goes on.
    pub(super) fn release(&mut self) -> Result<(), Error> {
        let was_moving = std::mem::take(&mut self.is_moving);
        let Some(running) = self.running.as_ref().filter(|_| was_moving) else {
            return Ok(());
        };
        match running {
            Running::Flange(handle) => handle.send(Twist::default()),
            Running::Joints(handle) => handle.send(vec![0.0; self.arm.description().joints.len()]),
        }
        .inspect_err(|_| self.running = None)
    }

    /// The error with which the jog ended, if it did.
    pub(super) fn failure(&mut self) -> Option<Error> {
        let ended = self.running.as_ref()?.ended()?;
        self.running = None;
        ended.err()
    }

    /// Moves in one direction for a time; false if that was interrupted.
    pub(super) fn hold(
        &mut self,
        direction: Direction,
        time: Duration,
        stop: &Stop,
    ) -> anyhow::Result<bool> {
        self.send(direction).map_err(hinted)?;
        let begin = Instant::now();
        while begin.elapsed() < time && !stop.is_requested() {
            std::thread::sleep(TICK.min(time.saturating_sub(begin.elapsed())));
            self.send(direction).map_err(hinted)?;
        }
        Ok(!stop.is_requested())
    }

    /// Brakes and waits until the arm is at rest.
    pub(super) fn end(&mut self) -> Result<(), Error> {
        self.arm.cancel();
        self.arm.finish()?;
        self.failure().map_or(Ok(()), Err)
    }
}

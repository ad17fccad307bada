//! Checks commands and moves the arm. Timing is checked once per command period, elsewhere.

use super::{Added, Cabinet, Received};
use crate::emulator::Pose;
use crate::sunrise::AXES;
use crate::sunrise::emulator::{Control, ExitReason, MissingValue};
use crate::sunrise::wire::{
    CommandData, CommandMode, Drive, OperationMode, Placement, SessionState,
};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Speed of the flange in T1, m/s; ISO 10218-1.
const T1_SPEED: f64 = 0.25;
/// Largest deviation of the first commanded pose from the interpolator, m and rad; *assumption*.
const POSE_TOLERANCE: f64 = 0.002;

impl Cabinet {
    pub(super) fn move_joints(&mut self) {
        let received = self.inbox.take();
        match self.state {
            SessionState::CommandingWait => self.synchronise(received),
            SessionState::CommandingActive => self.execute(received),
            SessionState::Idle
            | SessionState::MonitoringWait
            | SessionState::MonitoringReady
            | SessionState::Other(_) => {}
        }
        if !self.is_commanding() {
            return self.stop();
        }
        let law = self.law();
        self.arm.settle(&law, self.grid.period().as_secs_f64());
        self.check_t1();
    }

    /// Waits for the first command that agrees with the interpolator.
    fn synchronise(&mut self, received: Option<Received>) {
        let answers = received.filter(|it| it.sent.is_some_and(|sent| sent.in_command));
        let verdict = answers.map(|it| self.agrees(it.command.data.as_ref()));
        match verdict {
            Some(Ok(())) if self.grid.time() < self.waiting.0 + self.config.commanding_wait => {
                return;
            }
            Some(Ok(())) => {
                self.state = SessionState::CommandingActive;
                self.last = (self.grid.index().saturating_sub(1), self.ipo);
                return;
            }
            Some(Err(why)) => self.waiting.1 = why,
            None => {}
        }
        let (since, why) = self.waiting;
        if self.grid.time() >= since + self.config.synchronisation_timeout {
            self.leave(why);
        }
    }

    fn agrees(&self, data: Option<&CommandData>) -> Result<(), ExitReason> {
        let target = self.target(data, &self.ipo)?;
        let tolerance = match self.overlay.command {
            CommandMode::CartesianPose => POSE_TOLERANCE,
            CommandMode::Position
            | CommandMode::Wrench
            | CommandMode::Torque
            | CommandMode::None
            | CommandMode::Other(_) => self.config.synchronisation_tolerance_rad,
        };
        for (joint, (commanded, expected)) in target.iter().zip(self.ipo).enumerate() {
            if (commanded - expected).abs() > tolerance {
                let commanded = *commanded;
                return Err(ExitReason::NotSynchronised {
                    joint,
                    commanded,
                    expected,
                });
            }
        }
        Ok(())
    }

    /// Executes a command, or continues without one.
    fn execute(&mut self, received: Option<Received>) {
        let Some(received) = received else {
            return self.arm.extrapolate(&self.config.limits.position_rad);
        };
        if received.sent.is_some_and(|sent| !sent.following) {
            // The answer to a COMMANDING_WAIT message: it agrees with the interpolator, so there is nothing to follow.
            return self.arm.hold();
        }
        match self.check(&received) {
            Ok(target) => self.follow(&received, &target),
            Err(reason) => self.leave(reason),
        }
    }

    fn check(&self, received: &Received) -> Result<[f64; AXES], ExitReason> {
        let target = self.target(received.command.data.as_ref(), &self.last.1)?;
        let limits = &self.config.limits;
        for (joint, position) in target.iter().enumerate() {
            let (position, limit) = (*position, limits.position_rad[joint]);
            if position.abs() > limit {
                return Err(ExitReason::Position {
                    joint,
                    position,
                    limit,
                });
            }
        }
        if self.overlay.command == CommandMode::Torque {
            self.check_delta(&target)?;
        } else {
            self.check_speed(received, &target)?;
        }
        Ok(target)
    }

    fn check_speed(&self, received: &Received, target: &[f64; AXES]) -> Result<(), ExitReason> {
        let span_s = self.cycles_since_last(received) * self.grid.period().as_secs_f64();
        for (joint, position) in target.iter().enumerate() {
            let speed = (position - self.last.1[joint]) / span_s;
            let limit = self.config.limits.speed_rad_per_s[joint];
            if speed.abs() > limit * (1.0 + 1e-9) {
                return Err(ExitReason::Speed {
                    joint,
                    speed,
                    limit,
                });
            }
        }
        Ok(())
    }

    fn check_delta(&self, target: &[f64; AXES]) -> Result<(), ExitReason> {
        let limit = self.config.axis_delta_max_rad;
        for (joint, (position, measured)) in target.iter().zip(self.joints()).enumerate() {
            let delta = position - measured;
            if delta.abs() > limit {
                return Err(ExitReason::AxisDelta {
                    joint,
                    delta,
                    limit,
                });
            }
        }
        Ok(())
    }

    fn check_t1(&mut self) {
        let speed = self.arm.body.flange_speed();
        let is_t1 = self.config.operation_mode == OperationMode::T1;
        if is_t1 && speed > T1_SPEED {
            let limit = T1_SPEED;
            self.leave(ExitReason::T1Speed { speed, limit });
        }
    }

    /// Joint positions of a command that has all values the overlay expects, all finite.
    fn target(
        &self,
        data: Option<&CommandData>,
        near: &[f64; AXES],
    ) -> Result<[f64; AXES], ExitReason> {
        let data = data.copied().unwrap_or_default();
        let lacks = |value| ExitReason::Missing { value };
        match self.overlay.command {
            CommandMode::Wrench => {
                finite(&data.wrench.ok_or_else(|| lacks(MissingValue::Wrench))?)?;
            }
            CommandMode::Torque => {
                finite(&data.torque.ok_or_else(|| lacks(MissingValue::Torque))?)?;
            }
            CommandMode::CartesianPose => {
                let placement = data.pose.and_then(|pose| pose.placement);
                return self.reach(placement.ok_or_else(|| lacks(MissingValue::Pose))?, near);
            }
            CommandMode::Position | CommandMode::None | CommandMode::Other(_) => {}
        }
        let joints = data.joints.ok_or_else(|| lacks(MissingValue::Joints))?;
        finite(&joints)?;
        Ok(joints)
    }

    fn reach(&self, placement: Placement, near: &[f64; AXES]) -> Result<[f64; AXES], ExitReason> {
        let Placement::Quaternion(pose) = placement else {
            return Err(ExitReason::Missing {
                value: MissingValue::Pose,
            });
        };
        finite(&pose)?;
        let [x, y, z, w, i, j, k] = pose;
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
        let goal = Pose {
            rotation: *rotation.to_rotation_matrix().matrix(),
            position: Vector3::new(x, y, z) / 1e3,
        };
        let joints = self.arm.body.reach(near, &goal);
        joints.ok_or(ExitReason::OutOfReach)
    }

    fn follow(&mut self, received: &Received, target: &[f64; AXES]) {
        let (cycles, over) = (self.cycles_since_last(received), self.multiplier());
        self.arm.follow(target, &self.last.1, cycles, over);
        self.last = (self.cycle_of(received), *target);
        let data = received.command.data.unwrap_or_default();
        self.added = Added {
            torque: data.torque.unwrap_or_default(),
            wrench: data.wrench.unwrap_or_default(),
        };
    }

    /// The cycle whose message a command reflects; if unknown, the one after the last command.
    fn cycle_of(&self, received: &Received) -> u64 {
        let unknown = self.last.0 + 1;
        let sent = received.sent.map_or(unknown, |sent| sent.index);
        sent.max(self.last.0)
    }

    fn cycles_since_last(&self, received: &Received) -> f64 {
        let cycles = self.cycle_of(received) - self.last.0;
        f64::from(u32::try_from(cycles).unwrap_or(u32::MAX)).max(1.0)
    }

    pub(super) fn drive(&self) -> Drive {
        if self.has_power() {
            Drive::Active
        } else {
            Drive::Off
        }
    }

    pub(super) fn control(&self) -> Option<Control> {
        self.is_commanding().then_some(self.overlay.control)
    }
}

fn finite(values: &[f64]) -> Result<(), ExitReason> {
    let bad = values.iter().position(|value| !value.is_finite());
    bad.map_or(Ok(()), |joint| Err(ExitReason::NotFinite { joint }))
}

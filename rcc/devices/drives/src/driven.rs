//! A joint that a drive axis moves: its target in each cycle, and the state of its motor. Whether the arm may move is
//! decided elsewhere.

use std::time::Duration;

use takt_cia402::{Monitor, Power, Runaway, RunawayLimits, Standstill};
use takt_net::device::JointError;
use takt_rt::Nanos;

use crate::check::limits_of;
use crate::config::DriveJoint;
use crate::{Feedback, JointEvent};
use takt_core::device::setpoint::Joint;
use takt_core::device::{DeviceStatus, JointSetPoints};

/// A motor that moved no more than this, rad at its joint, within [`Standstill::TIME`] is at standstill: slower than
/// 0.01 rad/s.
const STANDSTILL_RAD: f64 = 5e-4;

/// Largest motor speed as a share of the joint's limit before the motor counts as a runaway; overshoot is allowed.
const SPEED_SHARE: f64 = 1.5;
/// A joint is out of range beyond this distance from the end, and back within half of it, rad.
const OUT_OF_RANGE_RAD: f64 = 2e-3;
/// A drive that was offline this long is assumed to have been power-cycled.
const POWER_CYCLED: Duration = Duration::from_secs(1);

/// A joint and the known state of its axis.
#[derive(Debug)]
pub(crate) struct Driven {
    axis: Option<Feedback>,
    pub(crate) joint: Joint,
    increments_per_rad: f64,
    zero: f64,
    /// The last 607Ah.
    target: Option<i32>,
    /// Whether set-points that began while it could not follow are refused; cleared when they end.
    refused: bool,
    /// Measured position and velocity, rad and rad/s.
    pub(crate) measured: Option<[f64; 2]>,
    standstill: Standstill,
    monitor: Monitor,
    /// Runaway, until its drive was offline for [`POWER_CYCLED`].
    runaway: Option<Runaway>,
    away_since: Option<Nanos>,
    /// Whether the joint is out of its range.
    outside: bool,
    event: Option<JointEvent>,
}

impl Driven {
    pub(crate) fn new<D>(joint: &DriveJoint<D>) -> Self {
        let increments_per_rad = joint.increments_per_turn / std::f64::consts::TAU;
        Self {
            axis: None,
            joint: Joint::new(limits_of(joint)),
            increments_per_rad,
            zero: joint.zero,
            target: None,
            refused: false,
            measured: None,
            standstill: Standstill::new(STANDSTILL_RAD * increments_per_rad),
            monitor: Monitor::new(runaway_limits(joint)),
            runaway: None,
            away_since: None,
            outside: false,
            event: None,
        }
    }

    /// Whether the motor did not follow its target and must not get power.
    pub(crate) const fn has_run_away(&self) -> bool {
        self.runaway.is_some()
    }

    /// The next event; each is returned once.
    pub(crate) const fn poll_event(&mut self) -> Option<JointEvent> {
        self.event.take()
    }

    /// Checks that the motor follows its target: each cycle, with the target of this cycle and the position of the
    /// last.
    fn supervise(&mut self, target: Option<i32>, now: Nanos) {
        let Some(axis) = self.axis.filter(|axis| axis.online) else {
            self.monitor.step(None, 0, Duration::ZERO);
            let since = *self.away_since.get_or_insert(now);
            if now - since >= Nanos::from(POWER_CYCLED) {
                self.runaway = None;
            }
            return;
        };
        self.away_since = None;
        let target = target.filter(|_| axis.follows && !axis.is_homing && self.runaway.is_none());
        if let Some(runaway) = self.monitor.step(target, axis.increments, time_of(now)) {
            self.runaway = Some(runaway);
            self.event = Some(JointEvent::Runaway(runaway));
        }
    }

    /// Detects that the joint is out of its range.
    fn mark_range(&mut self) {
        let Some([position, _]) = self.measured else {
            return;
        };
        let limits = self.joint.limits();
        let out = (limits.position_min - position).max(position - limits.position_max);
        let before = self.outside;
        let play = if before { 0.5 } else { 1.0 };
        // Before its zero is known, its position says nothing.
        self.outside = out > OUT_OF_RANGE_RAD * play && !self.is_homing();
        if self.outside && !before {
            self.event.get_or_insert_with(|| JointEvent::OutOfRange {
                position: position.to_degrees(),
                range: [limits.position_min, limits.position_max].map(f64::to_degrees),
            });
        }
    }

    fn position(&self, increments: i32) -> f64 {
        (f64::from(increments) - self.zero) / self.increments_per_rad
    }

    /// 607Ah for a position; `None` if it is not finite.
    pub(crate) fn increments(&self, position: f64) -> Option<i32> {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "saturates, which a range that fits the drive never does"
        )]
        let increments = (position * self.increments_per_rad + self.zero).round() as i32;
        position.is_finite().then_some(increments)
    }

    pub(crate) fn follows(&self) -> bool {
        self.axis.is_some_and(|axis| axis.online && axis.follows)
    }

    /// Whether its axis heeds no targets.
    fn is_homing(&self) -> bool {
        self.axis.is_some_and(|axis| axis.is_homing)
    }

    pub(crate) fn is_online(&self) -> bool {
        self.axis.is_some_and(|axis| axis.online)
    }

    pub(crate) fn power(&self) -> Power {
        let axis = self.axis.filter(|axis| axis.online);
        axis.and_then(|axis| axis.state)
            .map_or(Power::Off, Power::from)
    }

    /// The statusword of its drive, and the state that it shows, by its number in the profile's order; null while it is silent.
    pub(crate) fn words(&self) -> [Option<f64>; 2] {
        let axis = self.axis.filter(|axis| axis.online);
        let status = axis.and_then(|axis| axis.status);
        let state = axis.and_then(|axis| axis.state);
        [
            status.map(|status| f64::from(status.raw())),
            state.map(|state| f64::from(state as u8)),
        ]
    }

    /// Whether its motor is at standstill, or has no power to move.
    pub(crate) fn is_at_rest(&self, now: Nanos) -> bool {
        let (_, velocity, _) = self.joint.motion();
        let still = velocity == 0.0 && self.standstill.is_reached(time_of(now));
        still || self.power() != Power::Drives
    }

    /// The target of this cycle. A joint that may not move brakes and then holds its position.
    pub(crate) fn aim(
        &mut self,
        set_points: &JointSetPoints,
        may_move: bool,
        when: &When,
    ) -> Option<i32> {
        let may_move = may_move && !self.is_homing();
        self.refused = set_points.active && (self.refused || !may_move);
        if self.refused && may_move {
            let (position, ..) = self.joint.motion();
            self.joint.reject_resumed(set_points, position);
        }
        if !self.follows() || self.is_homing() {
            return None;
        }
        let none = JointSetPoints::default();
        let followed = if self.refused { &none } else { set_points };
        let play = when.now - self.joint.delay(followed);
        let position = self.joint.sample(followed, when.fresh, play, when.dt_s);
        self.target = self.increments(position).or(self.target);
        self.target
    }

    /// Handles the feedback of its axis. Without a target, the joint rests where its drive holds it.
    pub(crate) fn take(&mut self, axis: Option<Feedback>, target: Option<i32>, when: &When) {
        self.axis = axis;
        let online = axis.filter(|axis| axis.online);
        self.measured = online.map(|axis| {
            let position = self.position(axis.increments);
            let before = self.measured.filter(|_| when.elapsed_s > 0.0);
            let velocity = before.map_or(0.0, |[before, _]| (position - before) / when.elapsed_s);
            [position, velocity]
        });
        if let Some(axis) = online {
            self.standstill.note(axis.increments, time_of(when.now));
        }
        self.supervise(target, when.now);
        self.mark_range();
        if target.is_none() {
            let (commanded, ..) = self.joint.motion();
            let position = self.measured.map_or(commanded, |[position, _]| position);
            self.joint.rest_at(position, &JointSetPoints::default());
            self.target = online.map(|axis| axis.increments);
        }
    }

    pub(crate) fn error(&self, status: DeviceStatus) -> JointError {
        match status {
            DeviceStatus::Offline => JointError::Offline,
            _ if self.runaway.is_some() => JointError::Runaway,
            _ if self.axis.is_some_and(|axis| axis.refused) => JointError::NotProven,
            DeviceStatus::SafeOperational => JointError::NotEnabled,
            DeviceStatus::Operational if self.refused => JointError::Refused,
            DeviceStatus::Operational if self.outside => JointError::OutOfRange,
            DeviceStatus::Operational => self.joint.error(),
        }
    }
}

fn runaway_limits<D>(joint: &DriveJoint<D>) -> RunawayLimits {
    let per_degree = (joint.increments_per_turn / 360.0).abs();
    RunawayLimits {
        following: joint.following_error() * per_degree,
        speed: joint.velocity_max * SPEED_SHARE * per_degree,
    }
}

/// The time as the drive profile counts it.
pub(super) const fn time_of(now: Nanos) -> Duration {
    Duration::from_nanos(now.0.unsigned_abs())
}

/// Timing of the current cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct When {
    pub(crate) now: Nanos,
    /// Since the last one, s.
    pub(crate) elapsed_s: f64,
    /// Duration for which the target is valid, s: one cycle of the drive, regardless of stalls and phase of this
    /// host.
    pub(crate) dt_s: f64,
    /// Whether set-points are fresh.
    pub(crate) fresh: bool,
}

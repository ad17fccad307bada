//! A joint that an axis of a drive moves: its target in each cycle, and what is known of its motor. Whether the arm
//! may move is not decided here.

use std::time::Duration;

use takt_can::cia402::{Monitor, Runaway, RunawayLimits, State};
use takt_net::device::JointError;
use takt_rt::Nanos;

use super::check::limits_of;
use super::{Feedback, JointNews};
use crate::device::config::DriveJoint;
use crate::device::setpoint::Joint;
use crate::device::{DeviceStatus, JointSetPoints};

/// A motor that moved by no more than this, rad at its joint, for [`STANDS_FOR`] stands: slower than 0.01 rad/s.
const STANDS_WITHIN_RAD: f64 = 5e-4;
const STANDS_FOR: Duration = Duration::from_millis(50);

/// A motor is faster than its joint can be commanded from this share of its largest speed on: it may overshoot.
const SPEED_SHARE: f64 = 1.5;
/// A joint is out of its range from here on, and in it again half of that before its end, rad.
const OUT_OF_RANGE_RAD: f64 = 2e-3;
/// A drive that was away for so long had its power cycled, as far as can be told.
const POWER_CYCLED: Duration = Duration::from_secs(1);

/// What the power stage of a drive does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Power {
    /// It has no voltage, as far as is known.
    Off,
    /// It has voltage, the motor gets none.
    On,
    /// It moves or stops the motor.
    Drives,
}

impl Power {
    const fn of(state: State) -> Self {
        match state {
            State::NotReadyToSwitchOn
            | State::SwitchOnDisabled
            | State::ReadyToSwitchOn
            | State::Fault => Self::Off,
            State::SwitchedOn => Self::On,
            State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive => {
                Self::Drives
            }
        }
    }
}

/// A joint and what is known of the axis that moves it.
#[derive(Debug)]
pub(super) struct Driven {
    axis: Option<Feedback>,
    pub(super) joint: Joint,
    increments_per_rad: f64,
    zero: f64,
    /// 607Ah as it was last given.
    target: Option<i32>,
    /// Set-points that came while it could not follow them are refused until they end.
    refused: bool,
    /// Measured position and velocity, rad and rad/s.
    pub(super) measured: Option<[f64; 2]>,
    /// Where the motor last came from, 6064h, and when it was seen away from there.
    stood: (i32, Nanos),
    monitor: Monitor,
    /// It ran away, until its drive was away for [`POWER_CYCLED`].
    runaway: Option<Runaway>,
    away_since: Option<Nanos>,
    /// It stands out of its range.
    outside: bool,
    news: Option<JointNews>,
}

impl Driven {
    pub(super) fn new<D>(joint: &DriveJoint<D>) -> Self {
        Self {
            axis: None,
            joint: Joint::new(limits_of(joint)),
            increments_per_rad: joint.increments_per_turn / std::f64::consts::TAU,
            zero: joint.zero,
            target: None,
            refused: false,
            measured: None,
            stood: (0, Nanos(0)),
            monitor: Monitor::new(runaway_limits(joint)),
            runaway: None,
            away_since: None,
            outside: false,
            news: None,
        }
    }

    /// Whether it went where it was not told to go, and must not have power.
    pub(super) const fn has_run_away(&self) -> bool {
        self.runaway.is_some()
    }

    /// What is to be reported of it, once.
    pub(super) const fn poll_news(&mut self) -> Option<JointNews> {
        self.news.take()
    }

    /// Whether its motor goes where it is told: each cycle, with the target of this one and the position of the last.
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
        let target = target.filter(|_| axis.follows && self.runaway.is_none());
        let time = Duration::from_nanos(now.0.unsigned_abs());
        if let Some(runaway) = self.monitor.step(target, axis.increments, time) {
            self.runaway = Some(runaway);
            self.news = Some(JointNews::Runaway(runaway));
        }
    }

    /// Notes whether it stands out of its range.
    fn mark_range(&mut self) {
        let Some([position, _]) = self.measured else {
            return;
        };
        let limits = self.joint.limits();
        let out = (limits.position_min - position).max(position - limits.position_max);
        let before = self.outside;
        let play = if before { 0.5 } else { 1.0 };
        self.outside = out > OUT_OF_RANGE_RAD * play;
        if self.outside && !before {
            self.news.get_or_insert_with(|| JointNews::OutOfRange {
                position: position.to_degrees(),
                range: [limits.position_min, limits.position_max].map(f64::to_degrees),
            });
        }
    }

    fn position(&self, increments: i32) -> f64 {
        (f64::from(increments) - self.zero) / self.increments_per_rad
    }

    /// 607Ah for a position; `None` if that is no number.
    pub(super) fn increments(&self, position: f64) -> Option<i32> {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "saturates, which a range that fits the drive never does"
        )]
        let increments = (position * self.increments_per_rad + self.zero).round() as i32;
        position.is_finite().then_some(increments)
    }

    pub(super) fn follows(&self) -> bool {
        self.axis.is_some_and(|axis| axis.online && axis.follows)
    }

    pub(super) fn is_online(&self) -> bool {
        self.axis.is_some_and(|axis| axis.online)
    }

    pub(super) fn power(&self) -> Power {
        let axis = self.axis.filter(|axis| axis.online);
        axis.and_then(|axis| axis.state)
            .map_or(Power::Off, Power::of)
    }

    /// Whether its motor stands, or has no power that could move it.
    pub(super) fn stands(&self, now: Nanos) -> bool {
        let (_, velocity, _) = self.joint.motion();
        let still = velocity == 0.0 && now - self.stood.1 >= Nanos::from(STANDS_FOR);
        still || self.power() != Power::Drives
    }

    /// The target of this cycle. One that may not move brakes, and stays where it then is.
    pub(super) fn aim(
        &mut self,
        set_points: &JointSetPoints,
        may_move: bool,
        when: &When,
    ) -> Option<i32> {
        self.refused = set_points.active && (self.refused || !may_move);
        if !self.follows() {
            return None;
        }
        let none = JointSetPoints::default();
        let followed = if self.refused { &none } else { set_points };
        let play = when.now - self.joint.delay(followed);
        let position = self.joint.sample(followed, when.fresh, play, when.dt_s);
        self.target = self.increments(position).or(self.target);
        self.target
    }

    /// What its axis says to an order. One without a target rests where its drive holds it.
    pub(super) fn take(&mut self, axis: Option<Feedback>, target: Option<i32>, when: &When) {
        self.axis = axis;
        let online = axis.filter(|axis| axis.online);
        self.measured = online.map(|axis| {
            let position = self.position(axis.increments);
            let before = self.measured.filter(|_| when.elapsed_s > 0.0);
            let velocity = before.map_or(0.0, |[before, _]| (position - before) / when.elapsed_s);
            [position, velocity]
        });
        if let Some(axis) = online {
            self.watch(axis.increments, when.now);
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

    /// Notes when the motor was last seen to move.
    fn watch(&mut self, increments: i32, now: Nanos) {
        let moved = f64::from(increments) - f64::from(self.stood.0);
        // The encoder may stand on an edge.
        let play = (STANDS_WITHIN_RAD * self.increments_per_rad).abs().max(2.0);
        if moved.abs() > play {
            self.stood = (increments, now);
        }
    }

    pub(super) fn error(&self, status: DeviceStatus) -> JointError {
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

/// The cycle that joints are led through.
#[derive(Clone, Copy, Debug)]
pub(super) struct When {
    pub(super) now: Nanos,
    /// Since the last one, s.
    pub(super) elapsed_s: f64,
    /// For how long the target is, s: a drive takes one for a cycle of its own, however long the host was away before
    /// and whatever phase the host's cycles are on the way to.
    pub(super) dt_s: f64,
    /// Whether set-points still come.
    pub(super) fresh: bool,
}

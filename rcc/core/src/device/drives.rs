//! An arm whose joints are axes of CiA 402 drives, on whatever bus. All of them follow or none is commanded by nets:
//! then those that still follow brake within their limits and keep their places, by targets that never give way to
//! a load. How an axis is reached is its bus's business.
//!
//! Drives get power as soon as nothing commands the arm, and again after a fault when nothing has commanded it
//! for a second: what a net wanted before does not go on after. They lose it when their motors stand:
//!
//! ```text
//! told to stop: targets brake ──▶ motors stand ──▶ disable operation ──▶ disable voltage
//!                     └─ not in time ──▶ quick stop ──┴─ not in time ───────────▲
//! ```

use std::time::Duration;

use takt_can::cia402::{Goal, State};
use takt_net::device::JointError;
use takt_net::{JointLimits, JointState};
use takt_rt::Nanos;
use takt_rt::cycle::Tick;
use takt_rt::latest::{LatestReader, LatestWriter};

use crate::cell::{DriveArm, DriveJoint};
use crate::device::driver::DeviceEnd;
use crate::device::setpoint::Joint;
use crate::device::{
    ARM_JOINTS_MAX, DeviceCommand, DeviceDescription, DeviceState, DeviceStatus, JointSetPoints,
};

/// Set-points older than this many cycles of the segment are no longer followed.
const STALE_AFTER: i64 = 10;
/// Without a command for so long, drives that have a fault are reset.
const REST: Duration = Duration::from_secs(1);
/// A motor that moved by no more than this, rad at its joint, for [`STANDS_FOR`] stands: slower than 0.01 rad/s.
const STANDS_WITHIN_RAD: f64 = 5e-4;
const STANDS_FOR: Duration = Duration::from_millis(50);
/// How long motors get to stand by their targets, before they are stopped by quick stop.
const BRAKE_WITHIN: Duration = Duration::from_secs(2);
/// How long a quick stop may take, before power goes off all the same.
const QUICK_STOP_WITHIN: Duration = Duration::from_millis(500);
/// How long a drive may take to close its brake and disable operation.
const DISABLE_WITHIN: Duration = Duration::from_millis(500);

/// What an axis said last.
#[derive(Clone, Copy, Debug)]
pub(super) struct Feedback {
    /// It answers.
    pub(super) online: bool,
    /// Where it is told to be is where it goes.
    pub(super) follows: bool,
    /// 6041h; `None` if that shows no state.
    pub(super) state: Option<State>,
    /// 6064h.
    pub(super) increments: i32,
}

/// What an axis is to do in this cycle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Order {
    /// A new goal, if it changed.
    pub(super) goal: Option<Goal>,
    /// Reset a fault.
    pub(super) reset: bool,
    /// 607Ah; `None` while the axis does not follow: its target is where it is.
    pub(super) target: Option<i32>,
}

/// What the power stage of a drive does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Power {
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
struct Driven {
    axis: Option<Feedback>,
    joint: Joint,
    increments_per_rad: f64,
    zero: f64,
    /// 607Ah as it was last given.
    target: Option<i32>,
    /// Set-points that came while it could not follow them are refused until they end.
    refused: bool,
    /// Measured position and velocity, rad and rad/s.
    measured: Option<[f64; 2]>,
    /// Where the motor last came from, 6064h, and when it was seen away from there.
    stood: (i32, Nanos),
}

impl Driven {
    fn new<D>(joint: &DriveJoint<D>) -> Self {
        Self {
            axis: None,
            joint: Joint::new(limits_of(joint)),
            increments_per_rad: joint.increments_per_turn / std::f64::consts::TAU,
            zero: joint.zero,
            target: None,
            refused: false,
            measured: None,
            stood: (0, Nanos(0)),
        }
    }

    fn position(&self, increments: i32) -> f64 {
        (f64::from(increments) - self.zero) / self.increments_per_rad
    }

    /// 607Ah for a position; `None` if that is no number.
    fn increments(&self, position: f64) -> Option<i32> {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "saturates, which a range that fits the drive never does"
        )]
        let increments = (position * self.increments_per_rad + self.zero).round() as i32;
        position.is_finite().then_some(increments)
    }

    fn follows(&self) -> bool {
        self.axis.is_some_and(|axis| axis.online && axis.follows)
    }

    fn is_online(&self) -> bool {
        self.axis.is_some_and(|axis| axis.online)
    }

    fn power(&self) -> Power {
        let axis = self.axis.filter(|axis| axis.online);
        axis.and_then(|axis| axis.state)
            .map_or(Power::Off, Power::of)
    }

    /// Whether its motor stands, or has no power that could move it.
    fn stands(&self, now: Nanos) -> bool {
        let (_, velocity, _) = self.joint.motion();
        let still = velocity == 0.0 && now - self.stood.1 >= Nanos::from(STANDS_FOR);
        still || self.power() != Power::Drives
    }

    /// The target of this cycle. One that may not move brakes, and stays where it then is.
    fn aim(&mut self, set_points: &JointSetPoints, may_move: bool, when: &When) -> Option<i32> {
        self.refused = set_points.active && (self.refused || !may_move);
        if !self.follows() {
            return None;
        }
        let none = JointSetPoints::default();
        let followed = if self.refused { &none } else { set_points };
        // Half a period more than one, so that the two around that instant are there even if the net
        // is half of it late.
        let play = when.now - Nanos(followed.period.0 * 3 / 2);
        let position = self.joint.sample(followed, when.fresh, play, when.dt_s);
        self.target = self.increments(position).or(self.target);
        self.target
    }

    /// What its axis says to an order. One without a target rests where its drive holds it.
    fn take(&mut self, axis: Option<Feedback>, aimed: bool, when: &When) {
        self.axis = axis;
        let online = axis.filter(|axis| axis.online);
        self.measured = online.map(|axis| {
            let position = self.position(axis.increments);
            let before = self.measured.filter(|_| when.dt_s > 0.0);
            let velocity = before.map_or(0.0, |[before, _]| (position - before) / when.dt_s);
            [position, velocity]
        });
        if let Some(axis) = online {
            self.watch(axis.increments, when.now);
        }
        if !aimed {
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

    fn error(&self, status: DeviceStatus) -> JointError {
        match status {
            DeviceStatus::Offline => JointError::Offline,
            DeviceStatus::SafeOperational => JointError::NotEnabled,
            DeviceStatus::Operational if self.refused => JointError::Refused,
            DeviceStatus::Operational => self.joint.error(),
        }
    }
}

/// The cycle that joints are led through.
#[derive(Clone, Copy, Debug)]
struct When {
    now: Nanos,
    /// Since the last one, s.
    dt_s: f64,
    /// Whether set-points still come.
    fresh: bool,
}

fn limits_of<D>(joint: &DriveJoint<D>) -> JointLimits {
    JointLimits {
        position_min: joint.range[0].to_radians(),
        position_max: joint.range[1].to_radians(),
        velocity_max: joint.velocity_max.to_radians(),
        acceleration_max: joint.acceleration_max.to_radians(),
    }
}

/// The arm as a device of that type.
pub(super) fn describe<D>(arm: &DriveArm<D>, kind: &'static str) -> DeviceDescription {
    DeviceDescription {
        name: arm.name.clone(),
        kind,
        limits: arm.joints.iter().map(limits_of).collect(),
        model: arm.model.clone().into(),
        parts: Vec::new(),
    }
}

/// What is wrong with an arm; `drive` says what is wrong with the drive of a joint.
pub(super) fn check<D>(
    arm: &DriveArm<D>,
    drive: impl Fn(&DriveJoint<D>) -> Result<(), String>,
) -> Result<(), String> {
    let wrong = |what: String| Err(format!("arm {}: {what}", arm.name));
    let joints = arm.joints.len();
    if !(1..=ARM_JOINTS_MAX).contains(&joints) {
        return wrong(format!("{joints} joints; an arm has 1 to {ARM_JOINTS_MAX}"));
    }
    let limits: Vec<_> = arm.joints.iter().map(limits_of).collect();
    let model = takt_motion::kinematics::limited(&arm.model, &limits);
    if !arm.model.is_empty() && model.is_none() {
        return wrong(format!(
            "there is no model `{}` of {joints} joints",
            arm.model
        ));
    }
    for (number, joint) in arm.joints.iter().enumerate() {
        if let Err(what) = check_joint(joint).and_then(|()| drive(joint)) {
            return wrong(format!("joint {number}: {what}"));
        }
    }
    Ok(())
}

fn check_joint<D>(joint: &DriveJoint<D>) -> Result<(), String> {
    let DriveJoint {
        increments_per_turn,
        zero,
        range: [low, high],
        velocity_max,
        acceleration_max,
        ..
    } = joint;
    // Beyond these, products with the cycle would be zero or infinite.
    let above_zero = |value: &f64| (1e-6..=1e9).contains(value);
    let sound = increments_per_turn.is_normal()
        && [zero, low, high].iter().all(|value| value.is_finite())
        && low < high
        && above_zero(velocity_max)
        && above_zero(acceleration_max);
    if !sound {
        return Err(
            "increments_per_turn must not be 0, range must go up, velocity_max and acceleration_max must be \
             from 1e-6 to 1e9, and all of them and zero must be finite"
                .to_owned(),
        );
    }
    for end in [low, high] {
        let increments = end / 360.0 * increments_per_turn + zero;
        if increments.abs() > f64::from(i32::MAX) {
            return Err(format!(
                "{end} degrees are {increments:.0} increments, which do not fit the 32 bits of 607Ah"
            ));
        }
    }
    Ok(())
}

/// The arm.
#[derive(Debug)]
pub(super) struct Arm {
    joints: Vec<Driven>,
    period: Nanos,
    net_period: Nanos,
    told: DeviceState,
    taken: DeviceCommand,
    state: LatestWriter<DeviceState>,
    command: LatestReader<DeviceCommand>,
    /// The last cycle in which something commanded it.
    commanded: Nanos,
    last: Option<Nanos>,
    powered: bool,
    /// When it was told to stop, and when its motors then stood.
    stopping: Option<Nanos>,
    stood: Option<Nanos>,
}

impl Arm {
    /// An arm on a bus of that cycle.
    pub(super) fn new<D>(arm: &DriveArm<D>, cycle: Duration, end: DeviceEnd) -> Self {
        Self {
            joints: arm.joints.iter().map(Driven::new).collect(),
            period: cycle.into(),
            net_period: end.net_period.into(),
            told: DeviceState::default(),
            taken: DeviceCommand::default(),
            state: end.state,
            command: end.command,
            commanded: Nanos(0),
            last: None,
            powered: false,
            stopping: None,
            stood: None,
        }
    }

    /// Whether no drive of it has power. Within [`super::driver::FAREWELL`] after it is told to stop, unless a
    /// drive refuses.
    pub(super) fn is_off(&self) -> bool {
        let mut joints = self.joints.iter();
        joints.all(|joint| joint.power() == Power::Off)
    }

    fn follows(&self) -> bool {
        self.joints.iter().all(Driven::follows)
    }

    /// Leads its drives through one cycle: `axis` gives an order to the axis of a joint and says how that is.
    pub(super) fn cycle(
        &mut self,
        tick: &Tick,
        stopping: bool,
        mut axis: impl FnMut(usize, Order) -> Option<Feedback>,
    ) {
        let now = tick.scheduled;
        let taken = &mut self.taken;
        self.command.read_with(|command| taken.copy_from(command));
        let (goal, reset) = if stopping {
            (self.farewell(now), false)
        } else {
            self.choose_goal(now)
        };
        let may_move = self.follows() && !stopping;
        let elapsed = self.last.replace(now);
        let when = When {
            now,
            dt_s: elapsed.map_or(0.0, |last| seconds(now - last)),
            fresh: now - self.taken.time <= Nanos(self.period.0 * STALE_AFTER) + self.net_period,
        };
        let joints = self.joints.iter_mut().zip(&self.taken.joints);
        for (number, (driven, set_points)) in joints.enumerate() {
            let target = driven.aim(set_points, may_move, &when);
            let order = Order {
                goal,
                reset,
                target,
            };
            driven.take(axis(number, order), target.is_some(), &when);
        }
        self.tell(tick);
    }

    /// The goal of all drives if it changes, and whether their faults are to be reset.
    fn choose_goal(&mut self, now: Nanos) -> (Option<Goal>, bool) {
        let commanded = self.taken.joints.iter().any(|joint| joint.active);
        if commanded {
            self.commanded = now;
        }
        let online = self.joints.iter().all(Driven::is_online);
        // What comes back does not move by itself.
        self.powered &= online;
        let rested = now - self.commanded >= Nanos::from(REST);
        if online && !self.powered && !commanded {
            self.powered = true;
            return (Some(Goal::OperationEnabled), false);
        }
        if rested && !self.follows() {
            self.commanded = now;
            self.powered = false;
            return (None, true);
        }
        (None, false)
    }

    /// The goal of all drives on the way to no power.
    fn farewell(&mut self, now: Nanos) -> Option<Goal> {
        let began = *self.stopping.get_or_insert(now);
        if self.stood.is_none() && self.joints.iter().all(|joint| joint.stands(now)) {
            self.stood = Some(now);
        }
        let Some(stood) = self.stood else {
            let waited = now - began;
            let brakes = Nanos::from(BRAKE_WITHIN);
            return if waited <= brakes {
                None
            } else if waited <= brakes + Nanos::from(QUICK_STOP_WITHIN) {
                Some(Goal::QuickStop)
            } else {
                Some(Goal::SwitchOnDisabled)
            };
        };
        // Disable operation comes first: on that arrow drives close their brakes under torque (605Ch).
        let drives = |joint: &Driven| joint.power() == Power::Drives;
        let in_time = now - stood <= Nanos::from(DISABLE_WITHIN);
        Some(if in_time && self.joints.iter().any(drives) {
            Goal::SwitchedOn
        } else {
            Goal::SwitchOnDisabled
        })
    }

    fn tell(&mut self, tick: &Tick) {
        let status = if self.follows() {
            DeviceStatus::Operational
        } else if self.joints.iter().all(Driven::is_online) {
            DeviceStatus::SafeOperational
        } else {
            DeviceStatus::Offline
        };
        self.told.enter(status, tick.scheduled);
        for (told, driven) in self.told.joints.iter_mut().zip(&self.joints) {
            let (position, velocity, acceleration) = driven.joint.motion();
            *told = JointState {
                commanded_position: Some(position),
                commanded_velocity: Some(velocity),
                commanded_acceleration: Some(acceleration),
                measured_position: driven.measured.map(|[position, _]| position),
                measured_velocity: driven.measured.map(|[_, velocity]| velocity),
                measured_acceleration: None,
                error: driven.error(status) as i32,
            };
        }
        let told = &self.told;
        self.state.write_with(|state| state.copy_from(told));
    }
}

#[expect(
    clippy::cast_precision_loss,
    reason = "spans of milliseconds are exact"
)]
const fn seconds(span: Nanos) -> f64 {
    span.0 as f64 * 1e-9
}

#[cfg(test)]
mod tests;

//! An arm whose joints are axes of CiA 402 drives, on any bus. Nets command the arm only while all axes follow;
//! otherwise, those that still follow brake within their limits and hold their positions against any load. Access to
//! an axis is up to its bus.
//!
//! Drives are enabled as soon as no net commands the arm, and re-enabled after a fault once no net has commanded it
//! for a second: motion from before a fault does not continue. With `recovery = "on_restart"` a fault shuts the arm
//! down. A shutdown removes power when the motors are at standstill ([`Shutdown`]).

mod check;
mod driven;

use std::fmt;
use std::time::Duration;

use takt_can::cia402::proof::Objects;
use takt_can::cia402::{Goal, Power, Runaway, Shutdown, State, axis_goal};
use takt_net::JointState;
use takt_rt::Nanos;
use takt_rt::cycle::Tick;
use takt_rt::latest::{LatestReader, LatestWriter};

use crate::device::config::{DriveArm, Recovery};
use crate::device::continuity::Continuity;
use crate::device::driver::DeviceEnd;
use crate::device::{DeviceCommand, DeviceState, DeviceStatus};
pub(super) use check::{check, describe};
use driven::{Driven, When, time_of};

/// Set-points older than this many cycles of the segment are ignored.
const STALE_AFTER: i64 = 10;
/// Faults of drives are reset after this time without a command.
const REST: Duration = Duration::from_secs(1);
/// The latest state of an axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Feedback {
    /// Whether it answers.
    pub(super) online: bool,
    /// Whether it follows its targets.
    pub(super) follows: bool,
    /// State in 6041h; `None` if the statusword shows none.
    pub(super) state: Option<State>,
    /// 6064h.
    pub(super) increments: i32,
    /// Whether it gets no power because its process data are not proven.
    pub(super) refused: bool,
}

/// An event of a joint, reported once per occurrence.
#[derive(Clone, Copy, Debug)]
pub(super) enum JointEvent {
    /// The motor did not follow its target.
    Runaway(Runaway),
    /// The joint is out of its range.
    OutOfRange {
        /// Position, degrees.
        position: f64,
        /// Range, degrees.
        range: [f64; 2],
    },
}

impl fmt::Display for JointEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Runaway(runaway) => runaway.fmt(f),
            Self::OutOfRange {
                position,
                range: [low, high],
            } => write!(
                f,
                "position {position:.2} degrees is out of range {low:.2} to {high:.2}\nhint: move it back by set-points \
                 that begin at its position, which it follows slowly, or correct `zero` and `range`"
            ),
        }
    }
}

/// Commands to an axis for one cycle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Order {
    /// The new goal, if it changed.
    pub(super) goal: Option<Goal>,
    /// Whether to reset a fault.
    pub(super) reset: bool,
    /// 607Ah; `None` while the axis does not follow: its target is its position.
    pub(super) target: Option<i32>,
}

/// The arm.
#[derive(Debug)]
pub(super) struct Arm {
    recovery: Recovery,
    joints: Vec<Driven>,
    period: Nanos,
    net_period: Nanos,
    reported: DeviceState,
    taken: DeviceCommand,
    state: LatestWriter<DeviceState>,
    command: LatestReader<DeviceCommand>,
    /// The last cycle in which a net commanded it.
    commanded: Nanos,
    last: Option<Nanos>,
    powered: bool,
    /// The shutdown, once requested.
    shutdown: Option<Shutdown>,
    held: bool,
    continuity: Continuity,
}

impl Arm {
    /// An arm on a bus with that cycle time.
    pub(super) fn new<D>(arm: &DriveArm<D>, cycle: Duration, end: DeviceEnd) -> Self {
        Self {
            recovery: arm.recovery,
            joints: arm.joints.iter().map(Driven::new).collect(),
            period: cycle.into(),
            net_period: end.net_period.into(),
            reported: DeviceState::default(),
            taken: DeviceCommand::default(),
            state: end.state,
            command: end.command,
            commanded: Nanos(0),
            last: None,
            powered: false,
            shutdown: None,
            held: false,
            continuity: Continuity::default(),
        }
    }

    /// Whether all drives are without power; at most [`super::driver::SHUTDOWN_MAX`] after a shutdown request, unless
    /// a drive refuses.
    pub(super) fn is_off(&self) -> bool {
        let mut joints = self.joints.iter();
        joints.all(|joint| joint.power() == Power::Off)
    }

    /// Starts or ends a hold: joints brake and hold their positions, and commands are ignored.
    pub(super) const fn hold(&mut self, held: bool) {
        self.held = held;
    }

    /// The next event of a joint.
    pub(super) fn poll_event(&mut self) -> Option<(usize, JointEvent)> {
        let mut joints = self.joints.iter_mut().enumerate();
        joints.find_map(|(number, joint)| Some((number, joint.poll_event()?)))
    }

    fn follows(&self) -> bool {
        self.joints.iter().all(Driven::follows)
    }

    /// Steps its drives by one cycle: `axis` commands the axis of a joint and returns its feedback.
    pub(super) fn cycle(
        &mut self,
        tick: &Tick,
        stopping: bool,
        mut axis: impl FnMut(usize, Order) -> Option<Feedback>,
    ) {
        let now = tick.scheduled;
        let taken = &mut self.taken;
        self.command.read_with(|command| taken.copy_from(command));
        let stopping =
            stopping || (self.recovery == Recovery::OnRestart && self.reported.faults > 0);
        let (goal, reset) = if stopping {
            (self.shutdown_goal(now), false)
        } else {
            self.shutdown = None;
            self.choose_goal(now)
        };
        let may_move = self.follows() && !stopping && !self.held;
        let elapsed = self.last.replace(now).map_or(Nanos(0), |last| now - last);
        let when = When {
            now,
            elapsed_s: seconds(elapsed),
            dt_s: if elapsed > Nanos(0) {
                seconds(self.period)
            } else {
                0.0
            },
            fresh: now - self.taken.time <= Nanos(self.period.0 * STALE_AFTER) + self.net_period,
        };
        let joints = self.joints.iter_mut().zip(&self.taken.joints);
        for (number, (driven, set_points)) in joints.enumerate() {
            let target = driven.aim(set_points, may_move, &when);
            let goal = axis_goal(goal, driven.power(), driven.has_run_away());
            let order = Order {
                goal,
                reset,
                target,
            };
            driven.take(axis(number, order), target, &when);
        }
        self.publish(tick);
    }

    /// The new goal of all drives, if it changes, and whether to reset their faults.
    fn choose_goal(&mut self, now: Nanos) -> (Option<Goal>, bool) {
        let commanded = self.taken.joints.iter().any(|joint| joint.active);
        if commanded {
            self.commanded = now;
        }
        let online = self.joints.iter().all(Driven::is_online);
        // Drives that recover do not move by themselves.
        self.powered &= online;
        let rested = now - self.commanded >= Nanos::from(REST);
        if self.joints.iter().any(Driven::has_run_away) {
            return (None, false);
        }
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

    /// The goal of all drives during shutdown.
    fn shutdown_goal(&mut self, now: Nanos) -> Option<Goal> {
        let is_at_rest = self.joints.iter().all(|joint| joint.is_at_rest(now));
        let has_torque = |joint: &Driven| joint.power() == Power::Drives;
        let has_torque = self.joints.iter().any(has_torque);
        let now = time_of(now);
        let shutdown = self.shutdown.get_or_insert_with(|| Shutdown::new(now));
        shutdown.step(is_at_rest, has_torque, now)
    }

    fn publish(&mut self, tick: &Tick) {
        let status = if self.follows() && !self.held {
            DeviceStatus::Operational
        } else if self.joints.iter().all(Driven::is_online) {
            DeviceStatus::SafeOperational
        } else {
            DeviceStatus::Offline
        };
        self.reported.enter(status, tick.scheduled);
        for (reported, driven) in self.reported.joints.iter_mut().zip(&self.joints) {
            let (position, velocity, acceleration) = driven.joint.motion();
            *reported = JointState {
                commanded_position: Some(position),
                commanded_velocity: Some(velocity),
                commanded_acceleration: Some(acceleration),
                measured_position: driven.measured.map(|[position, _]| position),
                measured_velocity: driven.measured.map(|[_, velocity]| velocity),
                measured_acceleration: None,
                error: driven.error(status) as i32,
            };
        }
        for (limited, driven) in self.reported.limited.iter_mut().zip(&self.joints) {
            *limited = *driven.joint.limited();
        }
        let joints = &self.joints;
        self.continuity.check(&mut self.reported, |number| {
            Some(joints.get(number)?.joint.limits().velocity_max)
        });
        let reported = &self.reported;
        self.state.write_with(|state| state.copy_from(reported));
    }
}

/// Logs the quirks that the cell configures for the drives of a bus.
pub(super) fn report_quirks<D>(driver: &str, arms: &[DriveArm<D>]) {
    for arm in arms {
        for (joint, of_joint) in arm.joints.iter().enumerate() {
            for quirk in &of_joint.quirks {
                let (arm, quirk) = (&arm.name, quirk.name());
                tracing::info!(driver, arm, joint, quirk, "drive quirk applied");
            }
        }
    }
}

/// The event text of an axis whose process data are proven.
pub(super) fn proven(took: Duration, trusted: Objects) -> String {
    let took = took.as_millis();
    if trusted.is_empty() {
        format!("its process data are proven, in {took} ms")
    } else {
        format!(
            "its process data are proven, in {took} ms, but for {trusted}, taken on trust (`not_mirrored`)"
        )
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

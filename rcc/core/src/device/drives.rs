//! An arm whose joints are axes of CiA 402 drives, on whatever bus. All of them follow or none is commanded by nets:
//! then those that still follow brake within their limits and keep their places, by targets that never give way to
//! a load. How an axis is reached is its bus's business.
//!
//! Drives get power as soon as nothing commands the arm, and again after a fault when nothing has commanded it
//! for a second: what a net wanted before does not go on after. With `recovery = "on_restart"` a fault takes it from all of
//! them, as when the arm is told to stop. They lose it when their motors stand:
//!
//! ```text
//! told to stop: targets brake ──▶ motors stand ──▶ disable operation ──▶ disable voltage
//!                     └─ not in time ──▶ quick stop ──┴─ not in time ───────────▲
//! ```

mod check;
mod driven;

use std::fmt;
use std::time::Duration;

use takt_can::cia402::proof::Objects;
use takt_can::cia402::{Goal, Runaway, State};
use takt_net::JointState;
use takt_rt::Nanos;
use takt_rt::cycle::Tick;
use takt_rt::latest::{LatestReader, LatestWriter};

use crate::device::config::{DriveArm, Recovery};
use crate::device::continuity::Continuity;
use crate::device::driver::DeviceEnd;
use crate::device::{DeviceCommand, DeviceState, DeviceStatus};
pub(super) use check::{check, describe};
use driven::{Driven, Power, When};

/// Set-points older than this many cycles of the segment are no longer followed.
const STALE_AFTER: i64 = 10;
/// Without a command for so long, drives that have a fault are reset.
const REST: Duration = Duration::from_secs(1);
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
    /// It gets no power, for its process data are not proven.
    pub(super) refused: bool,
}

/// What is reported of a joint, once each time that it comes to be so.
#[derive(Clone, Copy, Debug)]
pub(super) enum JointNews {
    /// It went where it was not told to go.
    Runaway(Runaway),
    /// It stands out of its range.
    OutOfRange {
        /// Where, degrees.
        position: f64,
        /// Its range, degrees.
        range: [f64; 2],
    },
}

impl fmt::Display for JointNews {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Runaway(runaway) => runaway.fmt(f),
            Self::OutOfRange {
                position,
                range: [low, high],
            } => write!(
                f,
                "it stands at {position:.2} degrees, out of its range {low:.2} to {high:.2}\nhint: move it back by set-points \
                 that begin where it stands, which it follows slowly, or correct `zero` and `range`"
            ),
        }
    }
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

/// The arm.
#[derive(Debug)]
pub(super) struct Arm {
    recovery: Recovery,
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
    held: bool,
    continuity: Continuity,
}

impl Arm {
    /// An arm on a bus of that cycle.
    pub(super) fn new<D>(arm: &DriveArm<D>, cycle: Duration, end: DeviceEnd) -> Self {
        Self {
            recovery: arm.recovery,
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
            held: false,
            continuity: Continuity::default(),
        }
    }

    /// Whether no drive of it has power. Within [`super::driver::FAREWELL`] after it is told to stop, unless a
    /// drive refuses.
    pub(super) fn is_off(&self) -> bool {
        let mut joints = self.joints.iter();
        joints.all(|joint| joint.power() == Power::Off)
    }

    /// From now on nothing moves it, or something may again: its joints brake and keep their places.
    pub(super) const fn hold(&mut self, held: bool) {
        self.held = held;
    }

    /// A joint and what is to be reported of it; each once.
    pub(super) fn poll_news(&mut self) -> Option<(usize, JointNews)> {
        let mut joints = self.joints.iter_mut().enumerate();
        joints.find_map(|(number, joint)| Some((number, joint.poll_news()?)))
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
        let stopping = stopping || (self.recovery == Recovery::OnRestart && self.told.faults > 0);
        let (goal, reset) = if stopping {
            (self.farewell(now), false)
        } else {
            (self.stopping, self.stood) = (None, None);
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
            let goal = match goal {
                // A drive without power holds no motor whose brake were to close: it gets none now.
                Some(Goal::SwitchedOn) if driven.power() != Power::Drives => {
                    Some(Goal::SwitchOnDisabled)
                }
                // One that runs away has no targets to brake by.
                _ if driven.has_run_away() => Some(Goal::SwitchOnDisabled),
                goal => goal,
            };
            let order = Order {
                goal,
                reset,
                target,
            };
            driven.take(axis(number, order), target, &when);
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
        let status = if self.follows() && !self.held {
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
        for (limited, driven) in self.told.limited.iter_mut().zip(&self.joints) {
            *limited = *driven.joint.limited();
        }
        let joints = &self.joints;
        self.continuity.check(&mut self.told, |number| {
            Some(joints.get(number)?.joint.limits().velocity_max)
        });
        let told = &self.told;
        self.state.write_with(|state| state.copy_from(told));
    }
}

/// Writes to the log which quirks the drives of a bus get by their cell.
pub(super) fn report_quirks<D>(driver: &str, arms: &[DriveArm<D>]) {
    for arm in arms {
        for (joint, of_joint) in arm.joints.iter().enumerate() {
            for quirk in &of_joint.quirks {
                let (arm, quirk) = (&arm.name, quirk.name());
                tracing::info!(driver, arm, joint, quirk, "a quirk of a drive is applied");
            }
        }
    }
}

/// What is reported of an axis whose process data are proven.
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

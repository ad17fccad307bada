//! An arm whose joints are axes of CiA 402 drives, on whatever bus. All of them have power or none is commanded:
//! a drive that does not follow holds the others. How an axis is reached is its bus's business.
//!
//! Drives get power as soon as nothing commands the arm, and again after a fault when nothing has commanded it
//! for a second: what a net wanted before does not go on after.

use std::time::Duration;

use takt_can::cia402::Goal;
use takt_net::device::JointError;
use takt_net::{JointLimits, JointState};
use takt_rt::Nanos;
use takt_rt::cycle::Tick;
use takt_rt::latest::{LatestReader, LatestWriter};

use crate::cell::{DriveArm, DriveJoint};
use crate::device::driver::DeviceEnd;
use crate::device::setpoint::Joint;
use crate::device::{ARM_JOINTS_MAX, DeviceCommand, DeviceDescription, DeviceState, DeviceStatus};

/// Set-points older than this many cycles of the segment are no longer followed.
const STALE_AFTER: i64 = 10;
/// Without a command for so long, drives that have a fault are reset.
const REST: Duration = Duration::from_secs(1);

/// What an axis said last.
#[derive(Clone, Copy, Debug)]
pub(super) struct Feedback {
    /// It answers.
    pub(super) online: bool,
    /// Where it is told to be is where it goes.
    pub(super) follows: bool,
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
    /// 607Ah; `None` to hold.
    pub(super) target: Option<i32>,
}

/// A joint and what is known of the axis that moves it.
#[derive(Debug)]
struct Driven {
    axis: Option<Feedback>,
    joint: Joint,
    increments_per_rad: f64,
    zero: f64,
    /// Measured position and velocity, rad and rad/s.
    measured: Option<[f64; 2]>,
}

impl Driven {
    fn new<D>(joint: &DriveJoint<D>) -> Self {
        Self {
            axis: None,
            joint: Joint::new(limits_of(joint)),
            increments_per_rad: joint.increments_per_turn / std::f64::consts::TAU,
            zero: joint.zero,
            measured: None,
        }
    }

    fn position(&self, increments: i32) -> f64 {
        (f64::from(increments) - self.zero) / self.increments_per_rad
    }

    fn increments(&self, position: f64) -> i32 {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "saturates, which a range that fits the drive never does"
        )]
        let increments = (position * self.increments_per_rad + self.zero).round() as i32;
        increments
    }

    fn follows(&self) -> bool {
        self.axis.is_some_and(|axis| axis.online && axis.follows)
    }

    fn is_online(&self) -> bool {
        self.axis.is_some_and(|axis| axis.online)
    }

    fn take(&mut self, axis: Option<Feedback>, dt_s: f64) {
        let position = axis
            .filter(|axis| axis.online)
            .map(|axis| self.position(axis.increments));
        self.measured = position.map(|position| {
            let before = self.measured.filter(|_| dt_s > 0.0);
            let velocity = before.map_or(0.0, |[before, _]| (position - before) / dt_s);
            [position, velocity]
        });
        self.axis = axis;
    }
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
        let sound = joint.increments_per_turn.is_normal()
            && joint.zero.is_finite()
            && joint.range[0] < joint.range[1]
            && joint.velocity_max > 0.0
            && joint.acceleration_max > 0.0;
        if !sound {
            return wrong(format!(
                "joint {number}: increments_per_turn must not be 0, range must go up, and velocity_max and \
                 acceleration_max must be above 0"
            ));
        }
        if let Err(what) = drive(joint) {
            return wrong(format!("joint {number}: {what}"));
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
        }
    }

    /// Whether no drive of it has power.
    pub(super) fn is_off(&self) -> bool {
        !self.joints.iter().any(Driven::follows)
    }

    /// Leads its drives through one cycle: `axis` gives an order to the axis of a joint and says how that is.
    pub(super) fn cycle(
        &mut self,
        tick: &Tick,
        stopping: bool,
        mut axis: impl FnMut(usize, Order) -> Option<Feedback>,
    ) {
        let taken = &mut self.taken;
        self.command.read_with(|command| taken.copy_from(command));
        let (goal, reset) = self.choose_goal(tick, stopping);
        let follows = self.joints.iter().all(Driven::follows);
        let fresh = tick.scheduled - self.taken.time
            <= Nanos(self.period.0 * STALE_AFTER) + self.net_period;
        let elapsed = self.last.replace(tick.scheduled);
        let dt_s = elapsed.map_or(0.0, |last| seconds(tick.scheduled - last));
        let joints = self.joints.iter_mut().zip(&self.taken.joints);
        for (number, (driven, set_points)) in joints.enumerate() {
            let target = if follows && !stopping {
                // Half a period more than one, so that the two around that instant are there even if the net
                // is half of it late.
                let play = tick.scheduled - Nanos(set_points.period.0 * 3 / 2);
                let position = driven.joint.sample(set_points, fresh, play, dt_s);
                Some(driven.increments(position))
            } else {
                if let Some([position, _]) = driven.measured {
                    driven.joint.rest_at(position, set_points);
                }
                None
            };
            let order = Order {
                goal,
                reset,
                target,
            };
            driven.take(axis(number, order), dt_s);
        }
        self.tell(tick);
    }

    /// The goal of all drives if it changes, and whether their faults are to be reset.
    fn choose_goal(&mut self, tick: &Tick, stopping: bool) -> (Option<Goal>, bool) {
        let commanded = self.taken.joints.iter().any(|joint| joint.active);
        if commanded {
            self.commanded = tick.scheduled;
        }
        if stopping {
            return (Some(Goal::SwitchOnDisabled), false);
        }
        let online = self.joints.iter().all(Driven::is_online);
        // What comes back does not move by itself.
        self.powered &= online;
        let rested = tick.scheduled - self.commanded >= Nanos::from(REST);
        if online && !self.powered && !commanded {
            self.powered = true;
            return (Some(Goal::OperationEnabled), false);
        }
        if rested && !self.joints.iter().all(Driven::follows) {
            self.commanded = tick.scheduled;
            self.powered = false;
            return (None, true);
        }
        (None, false)
    }

    fn tell(&mut self, tick: &Tick) {
        let status = if self.joints.iter().all(Driven::follows) {
            DeviceStatus::Operational
        } else if self.joints.iter().all(Driven::is_online) {
            DeviceStatus::SafeOperational
        } else {
            DeviceStatus::Offline
        };
        self.told.enter(status, tick.scheduled);
        for (told, driven) in self.told.joints.iter_mut().zip(&self.joints) {
            let (position, velocity, acceleration) = driven.joint.motion();
            let error = match status {
                DeviceStatus::Offline => JointError::Offline,
                DeviceStatus::SafeOperational => JointError::NotEnabled,
                DeviceStatus::Operational => driven.joint.error(),
            };
            *told = JointState {
                commanded_position: Some(position),
                commanded_velocity: Some(velocity),
                commanded_acceleration: Some(acceleration),
                measured_position: driven.measured.map(|[position, _]| position),
                measured_velocity: driven.measured.map(|[_, velocity]| velocity),
                measured_acceleration: None,
                error: error as i32,
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

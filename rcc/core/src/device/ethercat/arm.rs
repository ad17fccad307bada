//! An arm whose joints are axes of CiA 402 drives. All of them have power or none is commanded: a drive that
//! does not follow holds the others.
//!
//! Drives get power as soon as nothing commands the arm, and again after a fault when nothing has commanded it
//! for a second: what a net wanted before does not go on after.

use std::time::Duration;

use takt_cia402::{Goal, Patience};
use takt_ethercat::axis::{Axis, AxisState, Target};
use takt_ethercat::master::Master;
use takt_net::JointState;
use takt_net::device::JointError;
use takt_rt::Nanos;
use takt_rt::cycle::Tick;
use takt_rt::latest::{LatestReader, LatestWriter};

use super::describe::{limits, slave};
use crate::cell::{EthercatArm, EthercatConfig};
use crate::device::driver::DeviceEnd;
use crate::device::setpoint::Joint;
use crate::device::{DeviceCommand, DeviceState, DeviceStatus};

/// Set-points older than this many cycles of the segment are no longer followed.
const STALE_AFTER: i64 = 10;
/// Without a command for so long, drives that have a fault are reset.
const REST: Duration = Duration::from_secs(1);

/// A joint and the axis that moves it.
#[derive(Debug)]
struct Driven {
    slave: usize,
    number: u8,
    axis: Option<Axis>,
    state: Option<AxisState>,
    joint: Joint,
    increments_per_rad: f64,
    zero: f64,
    /// Measured position and velocity, rad and rad/s.
    measured: Option<[f64; 2]>,
}

impl Driven {
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
        self.state
            .is_some_and(|state| state.online && state.follows)
    }

    fn is_online(&self) -> bool {
        self.state.is_some_and(|state| state.online)
    }
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
    pub(super) fn new(config: &EthercatConfig, arm: &EthercatArm, end: DeviceEnd) -> Self {
        let joints = arm
            .joints
            .iter()
            .zip(limits(arm))
            .map(|(joint, limits)| Driven {
                slave: slave(config, &joint.slave).unwrap_or_default(),
                number: joint.axis,
                axis: None,
                state: None,
                joint: Joint::new(limits),
                increments_per_rad: joint.increments_per_turn / std::f64::consts::TAU,
                zero: joint.zero,
                measured: None,
            });
        Self {
            joints: joints.collect(),
            period: config.cycle.into(),
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

    /// Leads its drives through one cycle.
    pub(super) fn cycle(&mut self, master: &mut Master, tick: &Tick, stopping: bool) {
        let taken = &mut self.taken;
        self.command.read_with(|command| taken.copy_from(command));
        self.bind(master);
        self.choose_goal(tick, stopping);
        let follows = self.joints.iter().all(Driven::follows);
        let fresh = tick.scheduled - self.taken.time
            <= Nanos(self.period.0 * STALE_AFTER) + self.net_period;
        let now = Duration::from_nanos(tick.scheduled.0.unsigned_abs());
        let elapsed = self.last.replace(tick.scheduled);
        let dt_s = elapsed.map_or(0.0, |last| seconds(tick.scheduled - last));
        for (driven, set_points) in self.joints.iter_mut().zip(&self.taken.joints) {
            let target = if follows && !stopping {
                // Half a period more than one, so that the two around that instant are there even if the net
                // is half of it late.
                let play = tick.scheduled - Nanos(set_points.period.0 * 3 / 2);
                let position = driven.joint.sample(set_points, fresh, play, dt_s);
                Target::Position(driven.increments(position))
            } else if let Some([position, _]) = driven.measured {
                driven.joint.rest_at(position, set_points);
                Target::Hold
            } else {
                Target::Hold
            };
            let Some(axis) = &mut driven.axis else {
                continue;
            };
            let state = axis.cycle(master, target, now);
            let position = driven.position(state.position);
            let velocity = driven
                .measured
                .filter(|_| dt_s > 0.0)
                .map_or(0.0, |[before, _]| (position - before) / dt_s);
            driven.state = Some(state);
            driven.measured = state.online.then_some([position, velocity]);
        }
        self.tell(tick);
    }

    /// Finds the axes in the process data as soon as that is known.
    fn bind(&mut self, master: &Master) {
        if !master.is_exchanging() {
            return;
        }
        for driven in &mut self.joints {
            if driven.axis.is_none()
                && let Some(slave) = master.slave(driven.slave)
            {
                let process = slave.process();
                let axis = Axis::new(driven.slave, process, driven.number, Patience::default());
                driven.axis = axis.ok();
            }
        }
    }

    fn choose_goal(&mut self, tick: &Tick, stopping: bool) {
        let commanded = self.taken.joints.iter().any(|joint| joint.active);
        if commanded {
            self.commanded = tick.scheduled;
        }
        if stopping {
            self.set_goal(Goal::SwitchOnDisabled);
            return;
        }
        if self.powered && !self.joints.iter().all(Driven::is_online) {
            // What comes back does not move by itself.
            self.powered = false;
        }
        let rested = tick.scheduled - self.commanded >= Nanos::from(REST);
        let first = !self.powered && self.joints.iter().all(Driven::is_online);
        if first && !commanded {
            self.powered = true;
            self.set_goal(Goal::OperationEnabled);
        } else if rested && !self.joints.iter().all(Driven::follows) {
            self.commanded = tick.scheduled;
            for axis in self
                .joints
                .iter_mut()
                .filter_map(|driven| driven.axis.as_mut())
            {
                axis.reset_fault();
            }
            self.powered = false;
        }
    }

    fn set_goal(&mut self, goal: Goal) {
        for axis in self
            .joints
            .iter_mut()
            .filter_map(|driven| driven.axis.as_mut())
        {
            axis.set_goal(goal);
        }
    }

    fn tell(&mut self, tick: &Tick) {
        let status = if self.joints.iter().all(Driven::follows) {
            DeviceStatus::Operational
        } else if self.joints.iter().all(Driven::is_online) {
            DeviceStatus::SafeOperational
        } else {
            DeviceStatus::Offline
        };
        let left = self.told.status == DeviceStatus::Operational && status != self.told.status;
        self.told.faults += u64::from(left);
        self.told.status = status;
        self.told.stamp = tick.scheduled;
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

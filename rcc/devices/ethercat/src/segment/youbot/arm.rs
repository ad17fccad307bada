//! The arm of a youBot: five joints that are homed first, if that is allowed, and then follow nets by the drives'
//! position or velocity loop, or as springs. Nets command all joints or none.

use std::time::Duration;

use takt_ethercat::master::Master;
use takt_ethercat::youbot::{
    ARM, Command, Drive, DriveConfig, DriveState, HOMING, Homing, HomingConfig, HomingState,
};
use takt_motion::kinematics::YouBot;
use takt_rt::Nanos;
use takt_rt::cycle::Tick;

use super::describe::{ARM_PARTS, limits};
use super::gripper::Gripper;
use super::springs::Springs;
use super::tool::Motions;
use super::{Wait, Waiting, now};
use crate::config::{YouBotArm, YouBotControl, YouBotZero};
use crate::segment::wire::{WireValues, wire_figures};
use takt_core::device::DeviceStatus;
use takt_core::device::driver::DeviceEnd;
use takt_core::device::endpoint::Endpoint;
use takt_core::device::last_stage::LastStage;
use takt_core::device::parts::with_figures;
use takt_core::device::setpoint::Joint;
use takt_device_drives::Recovery;

/// Proportional gain of the position correction in velocity mode, 1/s.
const CORRECTION: f64 = 10.0;
/// The strategy changes only within this position error, rad.
const SWITCH_DISTANCE: f64 = 0.1;
/// A joint above this speed is not at rest, rad/s: some motor revolutions per minute.
const RESTING: f64 = 0.05;

/// The arm.
#[derive(Debug)]
pub(super) struct Arm {
    pub(super) drives: [Drive; 5],
    homing: [Homing; 5],
    joints: [Joint; 5],
    /// Last stages of the velocities for drives in velocity mode.
    speeds: [LastStage; 5],
    /// Where nets see zero, rad from the stops.
    zero: [f64; 5],
    /// Lower and upper end of each range, rad.
    ends: [(f64, f64); 5],
    control: YouBotControl,
    may_home: bool,
    recovery: Recovery,
    springs: Springs,
    gripper: Option<Gripper>,
    cycle: Nanos,
    last: Option<Nanos>,
    end: Endpoint,
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "checked to be some amperes"
)]
const fn milliamperes(amperes: f64) -> i32 {
    (amperes * 1000.0) as i32
}

impl Arm {
    pub(super) fn new(
        arm: &YouBotArm,
        slaves: [usize; 5],
        cycle: Duration,
        end: DeviceEnd,
        gripper: Option<DeviceEnd>,
    ) -> Self {
        let drive = |n: usize| {
            let config = DriveConfig::joint(n, milliamperes(arm.current_max[n]));
            Drive::new(slaves[n], config)
        };
        let homing = |n: usize| {
            Homing::new(HomingConfig {
                current_ma: milliamperes(arm.homing_current[n]),
                ..HOMING[n]
            })
        };
        Self {
            drives: std::array::from_fn(drive),
            homing: std::array::from_fn(homing),
            joints: limits(arm).map(Joint::new),
            speeds: limits(arm).map(LastStage::new),
            zero: arm.zero.offsets(),
            ends: limits(arm).map(|limits| (limits.position_min, limits.position_max)),
            control: arm.control,
            may_home: arm.homing,
            recovery: arm.recovery,
            springs: Springs::of(
                match arm.zero {
                    YouBotZero::Upright => YouBot::upright(YouBot::UPRIGHT_RANGES),
                    YouBotZero::Folded => YouBot::default(),
                },
                cycle,
            ),
            gripper: gripper.map(Gripper::new),
            cycle: cycle.into(),
            last: None,
            end: Endpoint::new(end, &with_figures(&ARM_PARTS, wire_figures()), ARM.len()),
        }
    }

    fn follows(&self) -> bool {
        self.drives.iter().all(Drive::follows)
    }

    /// Whether a fault disabled all commands until the driver restarts.
    fn is_held(&self) -> bool {
        self.recovery == Recovery::OnRestart && self.end.reported.faults > 0
    }

    /// Whether joints can be commanded.
    fn is_ready(&self) -> bool {
        !self.is_held() && self.follows() && self.homing.iter().all(Homing::is_done)
    }

    /// Reports the figures of the wire with the next cycle.
    pub(super) fn report_wire(&mut self, values: &WireValues) {
        self.end.report_figures(0, values.iter().copied());
        if let Some(gripper) = &mut self.gripper {
            gripper.report_wire(values);
        }
    }

    pub(super) fn rests(&self) -> bool {
        let homing = self.homing.iter().any(Homing::is_active);
        !homing
            && self
                .joints
                .iter()
                .all(|joint| joint.motion().1.abs() < 1e-9)
    }

    /// The first joint that is not homed, or the fault of the gripper.
    pub(super) fn waits_for(&self) -> Option<Waiting> {
        let joints = self.homing.iter().zip(&self.drives);
        let why = |homing: &Homing| match homing.state() {
            HomingState::Done => None,
            HomingState::Failed(error) => Some(Wait::Failed(error)),
            HomingState::Idle | HomingState::Query | HomingState::Cancelled if !self.may_home => {
                Some(Wait::NotHomed)
            }
            HomingState::Idle
            | HomingState::Query
            | HomingState::Cancelled
            | HomingState::Approach(..)
            | HomingState::Rest(_)
            | HomingState::Preset
            | HomingState::Mark => Some(Wait::Homing),
        };
        let of_joints = joints.into_iter().find_map(|(homing, drive)| {
            let (slave, why) = (drive.slave(), why(homing)?);
            Some(Waiting { slave, why })
        });
        of_joints.or_else(|| {
            let why = self.gripper.as_ref()?.waits_for(self.may_home)?;
            let slave = self.drives[4].slave();
            Some(Waiting { slave, why })
        })
    }

    /// Position (rad, as nets count it) and speed (rad/s) of a joint, if its position is known.
    fn measured(&self, n: usize) -> Option<[f64; 2]> {
        let feedback = self.drives[n].feedback()?;
        let geometry = ARM[n];
        let motion = [
            geometry.angle(feedback.position) - self.zero[n],
            geometry.speed(feedback.velocity_rpm),
        ];
        self.homing[n].is_done().then_some(motion)
    }

    /// Whether all joints rest near their commanded positions.
    fn is_still(&self) -> bool {
        (0..ARM.len()).all(|n| {
            self.measured(n).is_some_and(|[position, velocity]| {
                let away = (position - self.joints[n].motion().0).abs();
                velocity.abs() < RESTING && away < SWITCH_DISTANCE
            })
        })
    }

    pub(super) fn cycle(&mut self, master: &mut Master, tick: &Tick, stopping: bool) {
        self.end.take();
        // A drive executes a command for one cycle, no matter how long the host stalled before.
        let is_later = |last| tick.scheduled > last;
        let passed = self.last.replace(tick.scheduled).is_some_and(is_later);
        let dt = if passed {
            self.cycle.as_secs_f64()
        } else {
            0.0
        };
        let commanded = self.end.is_commanded();
        let stopping = stopping || self.is_held();
        let may_move = self.may_home && !commanded && !stopping;
        let ready = self.is_ready();
        let rests = ready.then(|| self.is_still());
        let fresh = self.end.is_fresh(tick.scheduled, self.cycle);
        self.springs
            .apply(&self.end.interfaces, &self.end.taken, fresh, rests);
        let follows = self.follows();
        let orders = ready.then(|| self.set_points(tick, dt, fresh && !stopping));
        for n in 0..ARM.len() {
            let order = if let Some(orders) = &orders {
                Some(orders[n])
            } else {
                let drive = &mut self.drives[n];
                let order = self.homing[n].lead(drive, follows, may_move, stopping, now(tick));
                // After homing: a joint that was just homed rests at its position before it follows.
                if let Some([position, _]) = self.measured(n) {
                    self.joints[n].rest_at(position, &self.end.taken.joints[n]);
                    self.speeds[n].rest_at(position);
                }
                order
            };
            self.drives[n].exchange(master, order, may_move, now(tick));
        }
        if let (Some(gripper), [.., last]) = (&mut self.gripper, &mut self.drives) {
            gripper.cycle(last, self.may_home && !stopping, fresh && !stopping, tick);
        }
        self.publish(tick);
    }

    /// Commands of ready joints. Without fresh set-points they brake; compliant joints stay compliant, because one
    /// that was pushed aside would jump to its commanded position.
    fn set_points(&mut self, tick: &Tick, dt: f64, fresh: bool) -> [Command; 5] {
        let mut commanded = [[0.0; 2]; 5];
        for (n, commanded) in commanded.iter_mut().enumerate() {
            let set_points = &self.end.taken.joints[n];
            let play = tick.scheduled - self.joints[n].delay(set_points);
            let position = self.joints[n].sample(set_points, fresh, play, dt);
            *commanded = [position, self.joints[n].motion().1];
        }
        let measured: Motions = std::array::from_fn(|n| self.measured(n).unwrap_or(commanded[n]));
        let torques = self.springs.torques(&commanded, &measured, &self.ends);
        std::array::from_fn(|n| {
            let (geometry, [position, velocity]) = (ARM[n], commanded[n]);
            let ([at, _], stage) = (measured[n], &mut self.speeds[n]);
            match (torques, self.control) {
                (Some(torques), _) => {
                    stage.rest_at(at);
                    Command::current(geometry.current_ma(torques[n]))
                }
                (None, YouBotControl::Position) => {
                    Command::position(geometry.ticks(position + self.zero[n]))
                }
                (None, YouBotControl::Velocity) => {
                    let correction = CORRECTION * (position - at);
                    let speed = stage.steer(at, velocity + correction, dt);
                    Command::velocity(geometry.rpm(speed))
                }
            }
        })
    }

    fn publish(&mut self, tick: &Tick) {
        let absent = |drive: &Drive| drive.state() == DriveState::Absent;
        let status = if self.is_ready() {
            DeviceStatus::Operational
        } else if self.drives.iter().any(absent) {
            DeviceStatus::Offline
        } else {
            DeviceStatus::SafeOperational
        };
        self.end.reported.enter(status, tick.scheduled);
        let measured: [_; 5] = std::array::from_fn(|n| self.measured(n));
        let measured = measured.map(|it| [it.map(|[at, _]| at), it.map(|[_, speed]| speed), None]);
        self.end.report_joints(self.joints.iter().zip(measured));
        let signals = &mut self.end.reported.signals;
        self.springs.report(&self.end.interfaces, signals);
        let flags = self
            .end
            .interfaces
            .drives
            .iter()
            .flat_map(|drives| drives.iter());
        for (place, drive) in flags.zip(&self.drives) {
            let flags = drive
                .feedback()
                .map(|feedback| feedback.flags.0.cast_signed());
            place.report(signals, flags);
        }
        // From motor currents: gear friction is included and cannot be distinguished from external torques.
        let torques = self
            .end
            .interfaces
            .torques
            .iter()
            .flat_map(|torques| torques.iter());
        for ((place, drive), geometry) in torques.zip(&self.drives).zip(ARM) {
            let torque = drive
                .feedback()
                .map(|feedback| geometry.torque(feedback.current_ma));
            place.measured.report(signals, torque);
        }
        self.end.publish();
    }
}

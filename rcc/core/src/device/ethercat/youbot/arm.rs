//! The arm of a youBot: five joints that are homed first, if that is allowed, and then go where nets say, by the
//! drives' own position or velocity loop or as springs. All joints follow or none is commanded.

use std::time::Duration;

use takt_ethercat::master::Master;
use takt_ethercat::youbot::{
    ARM, Command, Drive, DriveConfig, DriveState, Flags, HOMING, Homing, HomingConfig, HomingState,
};
use takt_net::JointState;
use takt_net::device::{Interfaces, JointError, Layout};
use takt_rt::Nanos;
use takt_rt::cycle::Tick;
use takt_rt::latest::{LatestReader, LatestWriter};

use super::describe::{ARM_PARTS, limits};
use super::gripper::Gripper;
use super::springs::Springs;
use super::tool::Motions;
use super::{Wait, Waiting, is_fresh, lead, now, seconds};
use crate::device::config::{Recovery, YouBotArm, YouBotControl};
use crate::device::continuity::Continuity;
use crate::device::driver::DeviceEnd;
use crate::device::last_stage::LastStage;
use crate::device::setpoint::Joint;
use crate::device::{DeviceCommand, DeviceState, DeviceStatus, parts};

/// Correction of a joint by its velocity, 1/s.
const CORRECTION: f64 = 10.0;
/// Farther from where it is commanded, an arm does not change its strategy, rad.
const SWITCH_DISTANCE: f64 = 0.1;
/// Faster than this a joint does not rest, rad/s: some revolutions of its motor per minute.
const RESTING: f64 = 0.05;

/// The arm.
#[derive(Debug)]
pub(super) struct Arm {
    pub(super) drives: [Drive; 5],
    homing: [Homing; 5],
    joints: [Joint; 5],
    /// What bounds the velocities that leave for drives that are moved by those.
    speeds: [LastStage; 5],
    /// Smallest and largest position of each, rad.
    ends: [(f64, f64); 5],
    control: YouBotControl,
    may_home: bool,
    recovery: Recovery,
    springs: Springs,
    gripper: Option<Gripper>,
    cycle: Nanos,
    net_period: Nanos,
    last: Option<Nanos>,
    continuity: Continuity,
    interfaces: Interfaces,
    told: DeviceState,
    taken: DeviceCommand,
    state: LatestWriter<DeviceState>,
    command: LatestReader<DeviceCommand>,
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
            let config = DriveConfig {
                current_max_ma: milliamperes(arm.current_max[n]),
                // Away from the stop of all but the third, as the vendor's driver does it.
                direction: if n == 2 { 1 } else { -1 },
            };
            Drive::new(slaves[n], config)
        };
        let homing = |n: usize| {
            Homing::new(HomingConfig {
                current_ma: milliamperes(arm.homing_current[n]),
                ..HOMING[n]
            })
        };
        let mut layout = Layout::default();
        let interfaces = parts::lay(&ARM_PARTS, ARM.len(), &mut layout);
        Self {
            drives: std::array::from_fn(drive),
            homing: std::array::from_fn(homing),
            joints: limits(arm).map(Joint::new),
            speeds: limits(arm).map(LastStage::new),
            ends: limits(arm).map(|limits| (limits.position_min, limits.position_max)),
            control: arm.control,
            may_home: arm.homing,
            recovery: arm.recovery,
            springs: Springs::default(),
            gripper: gripper.map(Gripper::new),
            cycle: cycle.into(),
            net_period: end.net_period.into(),
            last: None,
            continuity: Continuity::default(),
            interfaces,
            told: DeviceState::new(layout.signals),
            taken: DeviceCommand::new(layout.commands),
            state: end.state,
            command: end.command,
        }
    }

    fn follows(&self) -> bool {
        self.drives.iter().all(Drive::follows)
    }

    /// Whether a fault took all commands from it until its driver starts again.
    fn is_held(&self) -> bool {
        self.recovery == Recovery::OnRestart && self.told.faults > 0
    }

    /// Whether joints can be commanded.
    fn is_ready(&self) -> bool {
        !self.is_held() && self.follows() && self.homing.iter().all(Homing::is_done)
    }

    pub(super) fn rests(&self) -> bool {
        let homing = self.homing.iter().any(Homing::is_active);
        !homing
            && self
                .joints
                .iter()
                .all(|joint| joint.motion().1.abs() < 1e-9)
    }

    /// The first joint whose stop is not known, or what the gripper waits for.
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

    /// Position (rad) and speed (rad/s) of a joint, if it is known where it is.
    fn measured(&self, n: usize) -> Option<[f64; 2]> {
        let told = self.drives[n].feedback()?;
        let geometry = ARM[n];
        let motion = [
            geometry.angle(told.position),
            geometry.speed(told.velocity_rpm),
        ];
        self.homing[n].is_done().then_some(motion)
    }

    /// Whether joints rest about where they are commanded.
    fn is_still(&self) -> bool {
        (0..ARM.len()).all(|n| {
            self.measured(n).is_some_and(|[position, velocity]| {
                let away = (position - self.joints[n].motion().0).abs();
                velocity.abs() < RESTING && away < SWITCH_DISTANCE
            })
        })
    }

    pub(super) fn cycle(&mut self, master: &mut Master, tick: &Tick, stopping: bool) {
        let taken = &mut self.taken;
        self.command.read_with(|command| taken.copy_from(command));
        // A drive takes a command for a cycle, however long the host was away before.
        let is_later = |last| tick.scheduled > last;
        let passed = self.last.replace(tick.scheduled).is_some_and(is_later);
        let dt = if passed { seconds(self.cycle) } else { 0.0 };
        let commanded = self.taken.joints.iter().any(|joint| joint.active);
        let stopping = stopping || self.is_held();
        let may_move = self.may_home && !commanded && !stopping;
        let ready = self.is_ready();
        let rests = ready.then(|| self.is_still());
        let fresh = is_fresh(self.taken.time, tick, self.cycle, self.net_period);
        self.springs
            .obey(&self.interfaces, &self.taken, fresh, rests);
        let follows = self.follows();
        let orders = ready.then(|| self.set_points(tick, dt, fresh && !stopping));
        for n in 0..ARM.len() {
            let order = if let Some(orders) = &orders {
                Some(orders[n])
            } else {
                let order = self.home(n, follows, may_move, stopping, tick);
                // Behind homing: a joint whose stop is known since just now rests where it is before it follows.
                if let Some([position, _]) = self.measured(n) {
                    self.joints[n].rest_at(position, &self.taken.joints[n]);
                    self.speeds[n].rest_at(position);
                }
                order
            };
            lead(&mut self.drives[n], master, order, may_move, tick);
        }
        if let (Some(gripper), [.., last]) = (&mut self.gripper, &mut self.drives) {
            gripper.cycle(last, self.may_home && !stopping, fresh && !stopping, tick);
        }
        self.tell(tick);
    }

    /// Homing of a joint, as far as it goes in this cycle.
    fn home(
        &mut self,
        n: usize,
        follows: bool,
        may_move: bool,
        stopping: bool,
        tick: &Tick,
    ) -> Option<Command> {
        let (homing, drive) = (&mut self.homing[n], &mut self.drives[n]);
        let told = drive.feedback().copied();
        // What lost its power does not know where it is; what was only gone says so when it is asked.
        let knows = told.is_some_and(|told| told.flags.any(Flags::INITIALIZED));
        if !knows || (homing.is_active() && !follows) {
            homing.forget();
        }
        if stopping {
            homing.cancel();
        }
        if !follows || stopping {
            return None;
        }
        if homing.state() == HomingState::Idle {
            homing.start();
        }
        homing.cycle(&told?, drive.mailbox(), may_move, now(tick))
    }

    /// What joints that are ready are to do. Without fresh set-points they brake; soft ones stay soft, as one that was
    /// pushed aside would jump to where it is commanded.
    fn set_points(&mut self, tick: &Tick, dt: f64, fresh: bool) -> [Command; 5] {
        let mut commanded = [[0.0; 2]; 5];
        for (n, commanded) in commanded.iter_mut().enumerate() {
            let set_points = &self.taken.joints[n];
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
                (None, YouBotControl::Position) => Command::position(geometry.ticks(position)),
                (None, YouBotControl::Velocity) => {
                    let correction = CORRECTION * (position - at);
                    let speed = stage.steer(at, velocity + correction, dt);
                    Command::velocity(geometry.rpm(speed))
                }
            }
        })
    }

    fn tell(&mut self, tick: &Tick) {
        let absent = |drive: &Drive| drive.state() == DriveState::Absent;
        let status = if self.is_ready() {
            DeviceStatus::Operational
        } else if self.drives.iter().any(absent) {
            DeviceStatus::Offline
        } else {
            DeviceStatus::SafeOperational
        };
        self.told.enter(status, tick.scheduled);
        for n in 0..ARM.len() {
            let measured = self.measured(n);
            let joint = &self.joints[n];
            let (position, velocity, acceleration) = joint.motion();
            self.told.limited[n] = *joint.limited();
            let error = match status {
                DeviceStatus::Offline => JointError::Offline,
                DeviceStatus::SafeOperational => JointError::NotEnabled,
                DeviceStatus::Operational => joint.error(),
            };
            self.told.joints[n] = JointState {
                commanded_position: Some(position),
                commanded_velocity: Some(velocity),
                commanded_acceleration: Some(acceleration),
                measured_position: measured.map(|[position, _]| position),
                measured_velocity: measured.map(|[_, velocity]| velocity),
                measured_acceleration: None,
                error: error as i32,
            };
        }
        let joints = &self.joints;
        self.continuity.check(&mut self.told, |number| {
            Some(joints.get(number)?.limits().velocity_max)
        });
        let signals = &mut self.told.signals;
        self.springs.tell(&self.interfaces, signals);
        let flags = self
            .interfaces
            .drives
            .iter()
            .flat_map(|drives| drives.iter());
        for (place, drive) in flags.zip(&self.drives) {
            let flags = drive.feedback().map(|told| told.flags.0.cast_signed());
            place.report(signals, flags);
        }
        // By the motors' currents: what gears lose is in it, what acts from outside cannot be told apart.
        let torques = self
            .interfaces
            .torques
            .iter()
            .flat_map(|torques| torques.iter());
        for ((place, drive), geometry) in torques.zip(&self.drives).zip(ARM) {
            let torque = drive
                .feedback()
                .map(|told| geometry.torque(told.current_ma));
            place.measured.report(signals, torque);
        }
        let told = &self.told;
        self.state.write_with(|state| state.copy_from(told));
    }
}

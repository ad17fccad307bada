//! The base of a youBot: velocities, or velocities towards poses, that nets command, ramped and distributed to four
//! wheels, and its odometry. When commands end, it brakes to rest at its acceleration limit.

use std::time::Duration;

use takt_ethercat::master::Master;
use takt_ethercat::youbot::{Command, Drive, DriveConfig, DriveState, Mecanum, Odometry};
use takt_net::device::{Given, JointError};
use takt_net::value::{Frame, Rotation, Twist, Vector};
use takt_rt::Nanos;
use takt_rt::cycle::Tick;

use super::course::{Course, Planar, within};
use super::describe::base_parts;
use super::now;
use crate::config::YouBotBase;
use crate::segment::wire::{WireValues, wire_figures};
use takt_core::device::DeviceStatus;
use takt_core::device::continuity::JumpPart;
use takt_core::device::driver::DeviceEnd;
use takt_core::device::endpoint::{Endpoint, joint_error};
use takt_core::device::last_stage::{PlanarLimits, PlanarStage};
use takt_core::device::parts::with_figures;
use takt_device_drives::Recovery;

/// The base.
#[derive(Debug)]
pub(super) struct Base {
    pub(super) drives: [Drive; 4],
    mecanum: Mecanum,
    stage: PlanarStage,
    odometry: Odometry,
    course: Course,
    /// Largest speed (m/s) and rotational speed (rad/s) towards a pose.
    speed_max: (f64, f64),
    may_commutate: bool,
    recovery: Recovery,
    /// Commands that began while it did not follow are refused until they end.
    refused: bool,
    cycle: Nanos,
    last: Option<Nanos>,
    /// Age of the oldest inputs, cycles.
    age: u32,
    end: Endpoint,
}

impl Base {
    pub(super) fn new(
        base: &YouBotBase,
        slaves: [usize; 4],
        cycle: Duration,
        end: DeviceEnd,
    ) -> Self {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "checked to be some amperes"
        )]
        let current_max_ma = (base.current_max * 1000.0) as i32;
        let config = DriveConfig {
            current_max_ma,
            direction: 1,
        };
        Self {
            drives: slaves.map(|slave| Drive::new(slave, config)),
            mecanum: Mecanum::default(),
            stage: PlanarStage::new(PlanarLimits {
                velocity: [base.velocity_max, base.rotation_max],
                acceleration: [base.acceleration_max, base.rotation_acceleration_max],
            }),
            odometry: Odometry::default(),
            course: Course::default(),
            speed_max: (base.velocity_max, base.rotation_max),
            may_commutate: base.commutation,
            recovery: base.recovery,
            refused: false,
            cycle: cycle.into(),
            last: None,
            age: 0,
            end: Endpoint::new(end, &with_figures(&base_parts(base), wire_figures()), 0),
        }
    }

    /// Reports the figures of the wire with the next cycle.
    pub(super) fn report_wire(&mut self, values: &WireValues) {
        self.end.report_figures(0, values.iter().copied());
    }

    pub(super) fn rests(&self) -> bool {
        self.stage.rests()
    }

    /// Whether a fault disabled all commands until the driver restarts.
    fn is_held(&self) -> bool {
        self.recovery == Recovery::OnRestart && self.end.reported.faults > 0
    }

    fn follows(&self) -> bool {
        !self.is_held() && self.drives.iter().all(Drive::follows)
    }

    pub(super) fn cycle(&mut self, master: &mut Master, tick: &Tick, stopping: bool) {
        self.end.take();
        // Drives execute a command for one cycle, no matter how long the host stalled before.
        let elapsed = self
            .last
            .replace(tick.scheduled)
            .map(|last| tick.scheduled - last);
        let passed = elapsed.is_some_and(|elapsed| elapsed > Nanos(0));
        let dt = if passed {
            self.cycle.as_secs_f64()
        } else {
            0.0
        };
        let fresh = self.end.is_fresh(tick.scheduled, self.cycle);
        let (velocity, pose) = (self.velocity(fresh), self.pose(fresh));
        let commanded = velocity.is_some() || pose.is_some();
        let stopping = stopping || self.is_held();
        let follows = self.follows();
        self.refused = commanded && (self.refused || !follows);
        let pose = pose.filter(|_| velocity.is_none() && !self.refused && !stopping);
        let period = self.end.net_period().as_secs_f64();
        let at = self.odometry.pose();
        let led = self.course.follow(pose.as_ref(), at, period);
        let velocity = velocity.filter(|_| !self.refused && !stopping);
        let (speed_max, rotation_max) = self.speed_max;
        let wanted = velocity.or_else(|| Some(within(led?, speed_max, rotation_max)));
        if follows {
            let mecanum = &self.mecanum;
            self.stage.step(wanted, |twist| mecanum.reach(twist), dt);
        } else {
            self.stage.rest();
        }
        let rpm = self.mecanum.rpm(self.stage.velocity());
        let may_move = self.may_commutate && !commanded && !stopping;
        for (drive, rpm) in self.drives.iter_mut().zip(rpm) {
            // All wheels turn or none: a base on three wheels leaves its path.
            let order = follows.then_some(Command::velocity(rpm));
            drive.exchange(master, order, may_move, now(tick));
        }
        let elapsed = elapsed.map_or(f64::INFINITY, |elapsed| self.since_inputs(master, elapsed));
        self.measure(elapsed);
        self.publish(tick, wanted);
    }

    /// The pose that a net commands.
    fn pose(&self, fresh: bool) -> Option<Given<Frame>> {
        let cartesian = self.end.interfaces.cartesian.as_ref()?;
        let given = cartesian.command.read(&self.end.taken.words)?;
        (fresh && given.is_in_force(self.end.taken.cycle)).then_some(given)
    }

    /// The velocity that a net commands.
    fn velocity(&self, fresh: bool) -> Option<Planar> {
        let base = self.end.interfaces.base.as_ref()?;
        let given = base.command.read(&self.end.taken.words)?;
        let Twist { vel, rot } = given.value;
        let in_force = fresh && given.is_in_force(self.end.taken.cycle);
        let finite = [vel.x, vel.y, rot.z].iter().all(|v| v.is_finite());
        (in_force && finite).then_some([vel.x, vel.y, rot.z])
    }

    /// Age of the previous cycle's inputs when this cycle's arrived, s.
    fn since_inputs(&mut self, master: &Master, elapsed: Nanos) -> f64 {
        let ages = self
            .drives
            .iter()
            .map(|drive| master.inputs(drive.slave()).1);
        let age = ages.max().unwrap_or(0);
        let before = std::mem::replace(&mut self.age, age);
        elapsed.as_secs_f64() + f64::from(before) * self.cycle.as_secs_f64()
    }

    fn measure(&mut self, elapsed_s: f64) {
        let feedback = self.drives.each_ref().map(Drive::feedback);
        if let [Some(a), Some(b), Some(c), Some(d)] = feedback {
            let ticks = [a, b, c, d].map(|feedback| feedback.position);
            let jumps = self.odometry.jumps();
            self.odometry
                .advance_within(&self.mecanum, ticks, elapsed_s);
            let follows = self.follows() && self.end.reported.status == DeviceStatus::Operational;
            if follows
                && self.odometry.jumps() > jumps
                && let Some([by, most]) = self.odometry.jump(&self.mecanum)
            {
                self.end.reported.jumped.add(JumpPart::Floor, by, most);
            }
        } else {
            self.odometry.forget();
        }
    }

    fn publish(&mut self, tick: &Tick, wanted: Option<Planar>) {
        let absent = |drive: &Drive| drive.state() == DriveState::Absent;
        let status = if self.follows() {
            DeviceStatus::Operational
        } else if self.drives.iter().any(absent) {
            DeviceStatus::Offline
        } else {
            DeviceStatus::SafeOperational
        };
        self.end.reported.enter(status, tick.scheduled);
        for (limited, held_back) in self
            .end
            .reported
            .limited
            .iter_mut()
            .zip(self.stage.limited())
        {
            *limited = *held_back;
        }
        self.end.reported.rejected[0] = *self.course.rejected();
        self.report_base(status, wanted);
        let signals = &mut self.end.reported.signals;
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
        self.end.publish();
    }

    fn report_base(&mut self, status: DeviceStatus, wanted: Option<Planar>) {
        let Some(base) = &self.end.interfaces.base else {
            return;
        };
        let error = if self.refused {
            JointError::Refused
        } else {
            JointError::None
        };
        let error = joint_error(status, error);
        let rates = self.drives.each_ref().map(|drive| {
            drive
                .feedback()
                .map(|feedback| self.mecanum.rate(feedback.velocity_rpm))
        });
        let velocity = if let [Some(a), Some(b), Some(c), Some(d)] = rates {
            Some(self.mecanum.velocity([a, b, c, d]))
        } else {
            None
        };
        let pose = frame(self.odometry.pose());
        let signals = &mut self.end.reported.signals;
        base.error.report(signals, Some(error as i32));
        base.commanded
            .report(signals, wanted.map(|_| twist(self.stage.velocity())));
        base.velocity.report(signals, velocity.map(twist));
        base.pose.report(signals, velocity.map(|_| pose));
        let wheels = base.wheels.iter().zip(rates).zip(self.odometry.wheels());
        for ((wheel, rate), angle) in wheels {
            wheel.position.report(signals, rate.map(|_| angle));
            wheel.velocity.report(signals, rate);
        }
        if let Some(cartesian) = &self.end.interfaces.cartesian {
            let heading = self.odometry.pose()[2];
            let refused = self.course.is_refused() && error == JointError::None;
            let error = if refused { JointError::Refused } else { error };
            let goal = self.course.goal().unwrap_or_else(|| self.odometry.pose());
            let known = velocity.map(|velocity| twist(in_place(velocity, heading)));
            let ramped = twist(in_place(self.stage.velocity(), heading));
            cartesian.error.report(signals, Some(error as i32));
            cartesian
                .commanded_position
                .report(signals, Some(frame(goal)));
            cartesian.commanded_velocity.report(signals, Some(ramped));
            cartesian
                .measured_position
                .report(signals, known.map(|_| pose));
            cartesian.measured_velocity.report(signals, known);
        }
    }
}

/// Rotates a velocity from the base's frame to the frame of its start.
fn in_place([x, y, turn]: Planar, heading: f64) -> Planar {
    let (sin, cos) = heading.sin_cos();
    [cos * x - sin * y, sin * x + cos * y, turn]
}

fn frame([x, y, heading]: Planar) -> Frame {
    let rotation = Rotation::from_axis_angle(&Vector::z_axis(), heading);
    Frame::from_parts([x, y, 0.0].into(), rotation)
}

fn twist([x, y, turn]: Planar) -> Twist {
    Twist {
        vel: Vector::new(x, y, 0.0),
        rot: Vector::new(0.0, 0.0, turn),
    }
}

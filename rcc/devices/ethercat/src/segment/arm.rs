//! The axes of an arm on the segment: located in the process data once the mapping is known, and controlled by the
//! drive profile. The arm's own logic is in `takt_device_drives`.

use std::time::Duration;

use std::mem::{Discriminant, discriminant};

use takt_cia402::proof::Objects;
use takt_cia402::{DriveFault, MasterOptions};
use takt_ethercat::axis::{Axis, NotMapped, Target};
use takt_ethercat::master::{Master, Reply};
use takt_rt::cycle::Tick;

use super::describe::{servo, slave};
use super::servo::ServoAxis;
use super::wire::{WireValues, wire_figures};
use crate::config::{EthercatConfig, LostPolicy};
use takt_core::device::driver::DeviceEnd;
use takt_device_drives::DriveArm;
use takt_device_drives::{self as drives, Feedback, JointEvent};

/// An axis of a slave.
#[derive(Debug)]
struct Place {
    slave: usize,
    number: u8,
    axis: Option<Axis>,
    /// Why the axis cannot be controlled as its slave is configured, and whether that is still to be reported.
    lack: Option<(NotMapped, bool)>,
    /// Objects that are taken on trust.
    not_mirrored: Objects,
    /// Timeouts, with the quirks of its drive.
    options: MasterOptions,
    /// The fault reported last, and the one still to be reported.
    hindered: Option<Discriminant<DriveFault>>,
    drive_fault: Option<DriveFault>,
    /// Duration of the proof of its process data, and whether it is still to be reported.
    proven: Option<(Duration, bool)>,
}

/// An event of an axis, reported once per occurrence.
#[derive(Debug)]
pub(super) enum AxisEvent {
    /// The axis cannot be controlled.
    Lack(NotMapped),
    /// The drive is not in the requested state.
    DriveFault(DriveFault),
    /// Its process data are proven, except these objects.
    Proven(Duration, Objects),
}

/// What moves a joint.
#[derive(Debug)]
enum Mover {
    Axis(Box<Place>),
    /// A servo axis of terminals.
    Servo(usize),
}

impl Mover {
    fn place(&self) -> Option<&Place> {
        match self {
            Self::Axis(place) => Some(place),
            Self::Servo(_) => None,
        }
    }

    fn place_mut(&mut self) -> Option<&mut Place> {
        match self {
            Self::Axis(place) => Some(place),
            Self::Servo(_) => None,
        }
    }
}

/// An arm and its axes, by joint.
#[derive(Debug)]
pub(super) struct Arm {
    arm: drives::Arm,
    movers: Vec<Mover>,
    lost: LostPolicy,
}

impl Arm {
    pub(super) fn new(config: &EthercatConfig, arm: &DriveArm<String>, end: DeviceEnd) -> Self {
        let place = |joint: &takt_device_drives::DriveJoint<String>| Place {
            slave: slave(config, &joint.drive).unwrap_or_default(),
            number: joint.axis,
            axis: None,
            lack: None,
            not_mirrored: Objects::of(&joint.not_mirrored).unwrap_or_default(),
            options: joint.master_options(),
            hindered: None,
            drive_fault: None,
            proven: None,
        };
        let mover =
            |joint: &takt_device_drives::DriveJoint<String>| match servo(config, &joint.drive) {
                Some(servo) => Mover::Servo(servo),
                None => Mover::Axis(Box::new(place(joint))),
            };
        Self {
            arm: drives::Arm::new(arm, config.cycle, end, wire_figures()),
            movers: arm.joints.iter().map(mover).collect(),
            lost: config.clocks.lost,
        }
    }

    /// The next event of an axis: slave, axis, event.
    pub(super) fn poll_event(&mut self) -> Option<(usize, u8, AxisEvent)> {
        let mut places = self.movers.iter_mut().filter_map(Mover::place_mut);
        places.find_map(|place| Some((place.slave, place.number, place.poll_event()?)))
    }

    /// Reports the figures of the wire with the next cycle.
    pub(super) fn report_wire(&mut self, values: &WireValues) {
        self.arm.report_bus(values.iter().copied());
    }

    /// The next event of a joint.
    pub(super) fn poll_joint(&mut self) -> Option<(usize, JointEvent)> {
        self.arm.poll_event()
    }

    /// Handles the reply to an upload of its axes; returns replies that are not its own.
    pub(super) fn handle_reply(&mut self, reply: Reply, tick: &Tick) -> Result<(), Reply> {
        let now = time(tick);
        let axes = self.movers.iter_mut().filter_map(Mover::place_mut);
        let mut axes = axes.filter_map(|place| place.axis.as_mut());
        match axes.try_fold(reply, |reply, axis| axis.handle_reply(reply, now).err()) {
            Some(reply) => Err(reply),
            None => Ok(()),
        }
    }

    /// Number of axes whose process data are not proven.
    pub(super) fn unproven(&self) -> u64 {
        let proven = |place: &&Place| {
            let axis = place.axis.as_ref();
            axis.is_some_and(|axis| axis.proof().is_proven())
        };
        let places = || self.movers.iter().filter_map(Mover::place);
        let count = places().count() - places().filter(proven).count();
        count as u64
    }

    /// Whether no drive has power.
    pub(super) fn is_off(&self) -> bool {
        self.arm.is_off()
    }

    /// Whether the clock of a running SYNC0 drive left its window.
    fn has_lost_clock(&self, master: &Master) -> bool {
        let mut places = self.movers.iter().filter_map(Mover::place);
        places.any(|place| {
            let slave = master.slave(place.slave);
            slave.is_some_and(|slave| slave.spec().sync.is_some() && slave.clock_is_lost())
        })
    }

    /// Steps its drives by one cycle.
    pub(super) fn cycle(
        &mut self,
        master: &mut Master,
        servos: &mut [ServoAxis],
        tick: &Tick,
        stopping: bool,
    ) {
        let now = time(tick);
        let (hold, stop) = match self.lost {
            LostPolicy::Ignore => (false, false),
            LostPolicy::Hold => (self.has_lost_clock(master), false),
            LostPolicy::Stop => (self.has_lost_clock(master), self.has_lost_clock(master)),
        };
        let is_withheld = self.movers.iter().any(|mover| match mover {
            Mover::Servo(servo) => servos.get(*servo).is_some_and(ServoAxis::is_withheld),
            Mover::Axis(_) => false,
        });
        self.arm.hold(hold);
        self.arm.withhold(is_withheld);
        let stopping = stopping || stop;
        let movers = &mut self.movers;
        self.arm.cycle(tick, stopping, |joint, order| {
            let place = match movers.get_mut(joint)? {
                Mover::Servo(servo) => {
                    return servos.get_mut(*servo)?.cycle(master, order, now);
                }
                Mover::Axis(place) => place,
            };
            place.find(master);
            let axis = place.axis.as_mut()?;
            if let Some(goal) = order.goal {
                axis.set_goal(goal);
            }
            if order.reset {
                axis.reset_fault();
            }
            axis.set_torque_offset(order.torque_offset);
            let target = order.target.map_or(Target::Hold, Target::Position);
            let state = axis.cycle(master, target, now);
            let (took, refused) = (axis.proof().took(), axis.proof().fault().is_some());
            place.note(state.drive_fault, took);
            Some(Feedback {
                refused,
                is_homing: false,
                online: state.online,
                follows: state.follows,
                state: state.state,
                status: Some(state.status),
                increments: state.position,
                torque: state.torque,
            })
        });
    }
}

fn time(tick: &Tick) -> Duration {
    Duration::from_nanos(tick.scheduled.0.unsigned_abs())
}

impl Place {
    fn note(&mut self, drive_fault: Option<DriveFault>, took: Option<Duration>) {
        let kind = drive_fault.as_ref().map(discriminant);
        if kind != std::mem::replace(&mut self.hindered, kind) {
            self.drive_fault = drive_fault;
        }
        self.proven = match (self.proven, took) {
            (Some((before, due)), Some(took)) if before == took => Some((before, due)),
            (_, took) => took.map(|took| (took, true)),
        };
    }

    fn poll_event(&mut self) -> Option<AxisEvent> {
        if let Some((lack, due)) = &mut self.lack
            && std::mem::take(due)
        {
            return Some(AxisEvent::Lack(*lack));
        }
        if let Some(drive_fault) = self.drive_fault.take() {
            return Some(AxisEvent::DriveFault(drive_fault));
        }
        let (took, due) = self.proven.as_mut()?;
        let trusted = self.axis.as_ref()?.proof().taken_on_trust();
        std::mem::take(due).then_some(AxisEvent::Proven(*took, trusted))
    }

    fn find(&mut self, master: &Master) {
        if !master.is_exchanging() {
            // The slave may be configured differently when it runs again.
            self.lack = None;
        } else if self.axis.is_none()
            && self.lack.is_none()
            && let Some(slave) = master.slave(self.slave)
        {
            match Axis::new(self.slave, slave.process(), self.number, self.options) {
                Ok(axis) => self.axis = Some(axis.not_mirrored(self.not_mirrored)),
                Err(lack) => self.lack = Some((lack, true)),
            }
        }
    }
}

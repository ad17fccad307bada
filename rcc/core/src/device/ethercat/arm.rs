//! The axes of an arm on the segment: found in the process data as soon as that is known, and led by the
//! profile. What the arm does with them is in `device::drives`.

use std::time::Duration;

use takt_can::cia402::Patience;
use takt_ethercat::axis::{Axis, NotMapped, Target};
use takt_ethercat::master::Master;
use takt_rt::cycle::Tick;

use super::describe::slave;
use crate::device::config::{DriveArm, EthercatConfig, LostPolicy};
use crate::device::driver::DeviceEnd;
use crate::device::drives::{self, Feedback};

/// An axis of a slave.
#[derive(Debug)]
struct Place {
    slave: usize,
    number: u8,
    axis: Option<Axis>,
    /// Why it cannot be led, as its slave is set up, and whether that is still to be told.
    lack: Option<(NotMapped, bool)>,
}

/// An arm and its axes, by joint.
#[derive(Debug)]
pub(super) struct Arm {
    arm: drives::Arm,
    places: Vec<Place>,
    lost: LostPolicy,
}

impl Arm {
    pub(super) fn new(config: &EthercatConfig, arm: &DriveArm<String>, end: DeviceEnd) -> Self {
        let place = |joint: &crate::device::config::DriveJoint<String>| Place {
            slave: slave(config, &joint.drive).unwrap_or_default(),
            number: joint.axis,
            axis: None,
            lack: None,
        };
        Self {
            arm: drives::Arm::new(arm, config.cycle, end),
            places: arm.joints.iter().map(place).collect(),
            lost: config.clocks.lost,
        }
    }

    /// A slave and an axis of it that cannot be led, and why; each once.
    pub(super) fn poll_lack(&mut self) -> Option<(usize, u8, NotMapped)> {
        self.places.iter_mut().find_map(|place| {
            let (lack, news) = place.lack.as_mut()?;
            std::mem::take(news).then_some((place.slave, place.number, *lack))
        })
    }

    /// Whether no drive of it has power.
    pub(super) fn is_off(&self) -> bool {
        self.arm.is_off()
    }

    /// Whether the clock of a drive that runs by SYNC0 does not follow any more.
    fn has_lost_clock(&self, master: &Master) -> bool {
        self.places.iter().any(|place| {
            let slave = master.slave(place.slave);
            slave.is_some_and(|slave| slave.spec().sync.is_some() && slave.clock_is_lost())
        })
    }

    /// Leads its drives through one cycle.
    pub(super) fn cycle(&mut self, master: &mut Master, tick: &Tick, stopping: bool) {
        let now = Duration::from_nanos(tick.scheduled.0.unsigned_abs());
        let (hold, stop) = match self.lost {
            LostPolicy::Ignore => (false, false),
            LostPolicy::Hold => (self.has_lost_clock(master), false),
            LostPolicy::Stop => (self.has_lost_clock(master), self.has_lost_clock(master)),
        };
        self.arm.hold(hold);
        let stopping = stopping || stop;
        let places = &mut self.places;
        self.arm.cycle(tick, stopping, |joint, order| {
            let place = places.get_mut(joint)?;
            place.find(master);
            let axis = place.axis.as_mut()?;
            if let Some(goal) = order.goal {
                axis.set_goal(goal);
            }
            if order.reset {
                axis.reset_fault();
            }
            let target = order.target.map_or(Target::Hold, Target::Position);
            let state = axis.cycle(master, target, now);
            Some(Feedback {
                online: state.online,
                follows: state.follows,
                state: state.state,
                increments: state.position,
            })
        });
    }
}

impl Place {
    fn find(&mut self, master: &Master) {
        if !master.is_exchanging() {
            // It may be set up in another way when it runs again.
            self.lack = None;
        } else if self.axis.is_none()
            && self.lack.is_none()
            && let Some(slave) = master.slave(self.slave)
        {
            let patience = Patience::default();
            match Axis::new(self.slave, slave.process(), self.number, patience) {
                Ok(axis) => self.axis = Some(axis),
                Err(lack) => self.lack = Some((lack, true)),
            }
        }
    }
}

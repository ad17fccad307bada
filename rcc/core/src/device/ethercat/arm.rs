//! The axes of an arm on the segment: found in the process data as soon as that is known, and led by the
//! profile. What the arm does with them is in `device::drives`.

use std::time::Duration;

use takt_can::cia402::Patience;
use takt_ethercat::axis::{Axis, Target};
use takt_ethercat::master::Master;
use takt_rt::cycle::Tick;

use super::describe::slave;
use crate::device::config::{DriveArm, EthercatConfig};
use crate::device::driver::DeviceEnd;
use crate::device::drives::{self, Feedback};

/// An axis of a slave.
#[derive(Debug)]
struct Place {
    slave: usize,
    number: u8,
    axis: Option<Axis>,
}

/// An arm and its axes, by joint.
#[derive(Debug)]
pub(super) struct Arm {
    arm: drives::Arm,
    places: Vec<Place>,
}

impl Arm {
    pub(super) fn new(config: &EthercatConfig, arm: &DriveArm<String>, end: DeviceEnd) -> Self {
        let place = |joint: &crate::device::config::DriveJoint<String>| Place {
            slave: slave(config, &joint.drive).unwrap_or_default(),
            number: joint.axis,
            axis: None,
        };
        Self {
            arm: drives::Arm::new(arm, config.cycle, end),
            places: arm.joints.iter().map(place).collect(),
        }
    }

    /// Whether no drive of it has power.
    pub(super) fn is_off(&self) -> bool {
        self.arm.is_off()
    }

    /// Leads its drives through one cycle.
    pub(super) fn cycle(&mut self, master: &mut Master, tick: &Tick, stopping: bool) {
        let now = Duration::from_nanos(tick.scheduled.0.unsigned_abs());
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
        if self.axis.is_none()
            && master.is_exchanging()
            && let Some(slave) = master.slave(self.slave)
        {
            let patience = Patience::default();
            self.axis = Axis::new(self.slave, slave.process(), self.number, patience).ok();
        }
    }
}

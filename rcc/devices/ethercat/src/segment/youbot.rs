//! youBots on the segment: arms with their grippers, and bases. Their slaves follow from the positions of their power
//! boards; drives, homing and grippers are in `takt_ethercat::youbot`.

mod arm;
mod base;
mod course;
mod describe;
mod gripper;
mod springs;
mod time;
mod tool;
mod wait;

use takt_ethercat::master::{Master, Reply};
use takt_ethercat::youbot::Drive;
use takt_rt::cycle::Tick;

use super::wire::WireValues;
use crate::config::EthercatConfig;
use arm::Arm;
use base::Base;
pub(super) use describe::{check, describe, specs};
use takt_core::device::driver::DeviceEnd;
use time::now;
pub use wait::Wait;
pub(super) use wait::Waiting;

/// Fault counters of all youBot drives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct YouBotFigures {
    /// EtherCAT timeouts of drives, each cleared.
    pub timeouts: u64,
    /// I2t faults of drives, each cleared unless there were too many.
    pub i2t: u64,
    /// Cycles in which a current was clamped to the maximum.
    pub clamped: u64,
    /// TMCL requests that were repeated.
    pub repeats: u64,
}

impl YouBotFigures {
    fn add(&mut self, drive: &Drive) {
        let counters = drive.counters();
        self.timeouts += counters.timeouts;
        self.i2t += counters.i2t;
        self.clamped += counters.clamped;
        self.repeats += drive.repeats();
    }
}

/// All youBots of a segment.
#[derive(Debug)]
pub(super) struct YouBots {
    bases: Vec<Base>,
    arms: Vec<Arm>,
}

impl YouBots {
    /// Takes the endpoints of its devices, in the order of [`describe`].
    pub(super) fn new(config: &EthercatConfig, ends: &mut impl Iterator<Item = DeviceEnd>) -> Self {
        let places = describe::Places::new(config);
        let bases = config.youbot_bases.iter().zip(&places.bases);
        let bases = bases.filter_map(|(base, slaves)| {
            Some(Base::new(base, *slaves, config.cycle, ends.next()?))
        });
        let bases = bases.collect();
        let mut arms = Vec::new();
        for (arm, slaves) in config.youbot_arms.iter().zip(&places.arms) {
            let Some(end) = ends.next() else {
                break;
            };
            let gripper = arm.gripper.as_ref().and_then(|_| ends.next());
            arms.push(Arm::new(arm, *slaves, config.cycle, end, gripper));
        }
        Self { bases, arms }
    }

    /// Handles a reply of the master to one of their jobs.
    pub(super) fn handle_reply(&mut self, reply: Reply, tick: &Tick) {
        let bases = self.bases.iter_mut().flat_map(|base| &mut base.drives);
        let arms = self.arms.iter_mut().flat_map(|arm| &mut arm.drives);
        let slave = reply.job.slave;
        if let Some(drive) = bases.chain(arms).find(|drive| drive.slave() == slave) {
            drive.mailbox().handle_reply(reply, now(tick));
        }
    }

    /// Reports the figures of the wire with the next cycle.
    pub(super) fn report_wire(&mut self, values: &WireValues) {
        self.bases
            .iter_mut()
            .for_each(|base| base.report_wire(values));
        self.arms.iter_mut().for_each(|arm| arm.report_wire(values));
    }

    /// Steps all of them by one cycle.
    pub(super) fn cycle(&mut self, master: &mut Master, tick: &Tick, stopping: bool) {
        for base in &mut self.bases {
            base.cycle(master, tick, stopping);
        }
        for arm in &mut self.arms {
            arm.cycle(master, tick, stopping);
        }
    }

    /// Whether all are at rest.
    pub(super) fn rest(&self) -> bool {
        self.bases.iter().all(Base::rests) && self.arms.iter().all(Arm::rests)
    }

    /// The first drive that is waited for.
    pub(super) fn waits_for(&self) -> Option<Waiting> {
        let bases = self.bases.iter().flat_map(|base| &base.drives);
        let arms = self.arms.iter().flat_map(|arm| &arm.drives);
        let blocked = |drive: &Drive| {
            let why = Wait::Drive(drive.drive_fault()?);
            let slave = drive.slave();
            Some(Waiting { slave, why })
        };
        let of_drives = bases.chain(arms).find_map(blocked);
        of_drives.or_else(|| self.arms.iter().find_map(Arm::waits_for))
    }

    /// Their fault counters.
    pub(super) fn figures(&self) -> YouBotFigures {
        let mut figures = YouBotFigures::default();
        let bases = self.bases.iter().flat_map(|base| &base.drives);
        let arms = self.arms.iter().flat_map(|arm| &arm.drives);
        for drive in bases.chain(arms) {
            figures.add(drive);
        }
        figures
    }
}

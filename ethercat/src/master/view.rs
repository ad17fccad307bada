//! Read access to the state of a master and its slaves.

use super::unit::{EthernetCounters, Unit};
use super::{
    Difference, FrameCounters, Group, Master, Phase, PortCounters, ProcessData, SlaveInfo,
};
use crate::config::{MasterConfig, SlaveSpec};
use crate::topology::Topology;
use crate::{AlStatus, AlStatusCode};

use super::event::Fault;

/// A slave as its master sees it.
#[derive(Clone, Copy, Debug)]
pub struct SlaveView<'a> {
    unit: &'a Unit,
}

impl<'a> SlaveView<'a> {
    /// Its number in the configuration or, without one, in the ring.
    pub const fn number(&self) -> usize {
        self.unit.number
    }

    /// Its configuration.
    pub const fn spec(&self) -> &'a SlaveSpec {
        &self.unit.spec
    }

    /// Its information, as reported by the slave.
    pub const fn info(&self) -> &'a SlaveInfo {
        &self.unit.info
    }

    /// Its process data.
    pub const fn process(&self) -> &'a ProcessData {
        &self.unit.process
    }

    /// Its position in the ring, from 0; `None` while it is offline.
    pub const fn position(&self) -> Option<u16> {
        self.unit.position
    }

    /// Its station address.
    pub const fn station(&self) -> u16 {
        self.unit.station
    }

    /// Its state as last read, and the code of an error.
    pub const fn al(&self) -> (AlStatus, AlStatusCode) {
        (self.unit.status.al, self.unit.status.code)
    }

    /// Whether it has reached its goal.
    pub const fn is_running(&self) -> bool {
        self.unit.is_running()
    }

    /// Why it has not reached its goal.
    pub const fn fault(&self) -> Option<Fault> {
        self.unit.recovery.fault
    }

    /// Errors of its ports since the start.
    pub const fn counters(&self) -> &'a PortCounters {
        self.unit.counters()
    }

    /// Difference of its clock to the reference as last read (092Ch), ns; positive is ahead. `None` if never read.
    pub const fn clock_difference_ns(&self) -> Option<i32> {
        self.unit.clock.difference_ns
    }

    /// Whether its locked clock was outside of the window in at least the last three readings.
    pub const fn clock_is_lost(&self) -> bool {
        self.unit.clock.is_lost()
    }

    /// Propagation delay from the reference clock, ns.
    pub const fn delay_ns(&self) -> u32 {
        self.unit.clock.delay_ns
    }

    /// Number of readings outside of the window since its clock was locked.
    pub const fn clock_violations(&self) -> u64 {
        self.unit.clock.violations
    }

    /// First SYNC0, system time, ns; `None` without.
    pub const fn sync_start_ns(&self) -> Option<u64> {
        self.unit.clock.start_ns
    }

    /// Bytes of the object or file that is transferred at present; `None` without a transfer.
    pub fn transferred(&self) -> Option<usize> {
        self.unit.transferred()
    }

    /// Counters of its Ethernet frames (EoE); `None` if its configuration does not use them.
    pub fn ethernet(&self) -> Option<EthernetCounters> {
        self.unit.ethernet_counters()
    }

    /// Unsolicited messages of its mailbox, and repeat requests.
    pub const fn mailbox_counters(&self) -> (u32, u32) {
        self.unit.mailbox_counters()
    }
}

impl Master {
    /// Phase of the start.
    pub const fn phase(&self) -> Phase {
        self.scan.phase
    }

    /// Whether all slaves have reached their goals; optional ones may be missing.
    pub fn is_operational(&self) -> bool {
        let good = |unit: &Unit| unit.is_running() || (unit.spec.optional && !unit.is_present());
        self.scan.phase == Phase::Running && self.units.iter().all(good)
    }

    /// The configuration.
    pub const fn config(&self) -> &MasterConfig {
        &self.config
    }

    /// Differences between configuration and segment, slave by slave.
    pub fn differences(&self) -> &[Difference] {
        &self.differences
    }

    /// Bytes of a process image that does not fit one frame; `None` if it fits. Remedies are fewer PDOs or several
    /// segments.
    pub const fn image_too_large(&self) -> Option<usize> {
        self.too_large
    }

    /// Number of known slaves, online or not.
    pub fn len(&self) -> usize {
        self.units.len()
    }

    /// Whether no slave is known.
    pub fn is_empty(&self) -> bool {
        self.units.is_empty()
    }

    /// A slave.
    pub fn slave(&self, number: usize) -> Option<SlaveView<'_>> {
        self.units.get(number).map(|unit| SlaveView { unit })
    }

    /// The number of the slave of that name.
    pub fn find(&self, name: &str) -> Option<usize> {
        self.units.iter().position(|unit| unit.spec.name == name)
    }

    /// The tree, by positions in the ring.
    pub const fn topology(&self) -> &Topology {
        &self.topology
    }

    /// The slave at each position of the ring, as it was at start.
    pub fn ring(&self) -> &[usize] {
        &self.ring
    }

    /// The slave whose clock is the reference.
    pub const fn reference(&self) -> Option<usize> {
        self.clock.slave
    }

    /// Frame counters.
    pub const fn frames(&self) -> FrameCounters {
        self.exchange.counters()
    }

    /// The groups and their working counters.
    pub fn groups(&self) -> &[Group] {
        self.image.groups()
    }

    /// Frames of the running segment.
    pub const fn cycles(&self) -> u64 {
        self.cycles
    }

    /// Events and emergencies that were dropped because they were not fetched in time.
    pub const fn dropped(&self) -> u64 {
        self.out.dropped
    }
}

//! Cell file configuration of CANopen networks.

use std::time::Duration;

use serde::Deserialize;
use takt_core::Error;
use takt_core::device::DeviceDescription;
use takt_core::device::driver::{DeviceDriver, DriverConfig, DriverEnds};
use takt_core::span;
use takt_device_drives::DriveArm;

use crate::network::{self, Canopen};

/// A CANopen network.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CanopenConfig {
    /// Its name.
    pub name: String,
    /// CAN interface.
    pub interface: String,
    /// Time from one SYNC to the next, 1 ms to 100 ms.
    #[serde(
        default = "CanopenConfig::default_cycle",
        deserialize_with = "span::text::deserialize"
    )]
    pub cycle: Duration,
    /// `SCHED_FIFO` priority of its driver thread, 1 to 98; `None` for an ordinary thread.
    #[serde(default = "CanopenConfig::default_priority")]
    pub priority: Option<u8>,
    /// Processors of its driver thread; empty for any.
    #[serde(default)]
    pub cpus: Vec<usize>,
    /// Period of the net thread that commands its devices; `None` for the first.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub thread: Option<Duration>,
    /// Node number of the master, 1 to 127; no node may have it.
    #[serde(default = "CanopenConfig::default_master")]
    pub master: u8,
    /// Heartbeat period of the master, two cycles to 20 s; nodes without a heartbeat for two and a half periods
    /// consider it lost. `None` for five cycles, but not less than 20 ms; zero for no heartbeat.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub heartbeat: Option<Duration>,
    /// Reaction of drives to the loss of the master (6007h).
    #[serde(default)]
    pub on_link_loss: LinkLoss,
    /// Robot arms made of drives.
    #[serde(default, rename = "arm")]
    pub arms: Vec<DriveArm<u8>>,
}

impl CanopenConfig {
    const fn default_cycle() -> Duration {
        Duration::from_millis(2)
    }

    const fn default_master() -> u8 {
        127
    }

    #[expect(
        clippy::unnecessary_wraps,
        reason = "the type of the field it is the default of"
    )]
    const fn default_priority() -> Option<u8> {
        Some(85)
    }
}

/// Reaction of a CANopen drive to the loss of its master: abort connection option code, 6007h. Drives without that
/// object keep their own reaction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LinkLoss {
    /// Stop by the quick stop option code (605Ah).
    #[default]
    QuickStop,
    /// Disable voltage: the motor coasts unless there is a brake.
    DisableVoltage,
    /// Fault, by the fault reaction option code (605Eh).
    Fault,
    /// No reaction.
    Nothing,
    /// The setting stored in the drive is not changed.
    AsSet,
}

impl DriverConfig for CanopenConfig {
    fn name(&self) -> &str {
        &self.name
    }

    fn thread(&self) -> Option<Duration> {
        self.thread
    }

    fn priority(&self) -> Option<u8> {
        self.priority
    }

    fn check(&self) -> Result<(), String> {
        network::check(self)
    }

    fn devices(&self) -> Vec<DeviceDescription> {
        network::describe(self)
    }

    fn start(&self, ends: DriverEnds) -> Result<Box<dyn DeviceDriver>, Error> {
        Ok(Box::new(Canopen::start(self, network::open(self)?, ends)?))
    }
}

//! Cell file configuration of a WSG gripper.

use std::net::SocketAddr;
use std::time::Duration;

use serde::Deserialize;
use takt_core::Error;
use takt_core::device::DeviceDescription;
use takt_core::device::driver::{DeviceDriver, DriverConfig, DriverEnds};
use takt_core::span;

use crate::driver::{Wsg, describe};

/// A Schunk WSG gripper.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WsgConfig {
    /// Name by which nets find it.
    pub name: String,
    /// Address of its command interface, such as `192.168.1.20:1000`.
    pub address: SocketAddr,
    /// `SCHED_FIFO` priority of its driver thread, 1 to 98; `None` for an ordinary thread.
    #[serde(default)]
    pub priority: Option<u8>,
    /// Processors of its driver thread; empty for any.
    #[serde(default)]
    pub cpus: Vec<usize>,
    /// Period of the net thread that commands it; `None` for the first.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub thread: Option<Duration>,
}

impl WsgConfig {
    /// A gripper at that address with default settings.
    #[must_use]
    pub fn new(name: impl Into<String>, address: SocketAddr) -> Self {
        Self {
            name: name.into(),
            address,
            priority: None,
            cpus: Vec::new(),
            thread: None,
        }
    }
}

impl DriverConfig for WsgConfig {
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
        if self.address.port() == 0 || self.address.ip().is_unspecified() {
            return Err(format!(
                "{}: address is {}; the gripper's own is expected, such as 192.168.1.20:1000",
                self.name, self.address
            ));
        }
        Ok(())
    }

    fn devices(&self) -> Vec<DeviceDescription> {
        vec![describe(self)]
    }

    fn start(&self, ends: DriverEnds) -> Result<Box<dyn DeviceDriver>, Error> {
        Ok(Box::new(Wsg::start(self, ends)?))
    }
}

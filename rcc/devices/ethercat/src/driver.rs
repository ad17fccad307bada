//! What the controller needs of a configured segment: its check, its descriptions and its start. The configuration
//! itself knows no driver.

use std::time::Duration;

use takt_core::Error;
use takt_core::device::DeviceDescription;
use takt_core::device::driver::{DeviceDriver, DriverConfig, DriverEnds};
use takt_motion::dynamics::Body;

use crate::config::EthercatConfig;
use crate::segment::{self, Ethercat};

impl DriverConfig for EthercatConfig {
    fn name(&self) -> &str {
        &self.name
    }

    fn thread(&self) -> Option<Duration> {
        self.thread
    }

    fn priority(&self) -> Option<u8> {
        self.priority
    }

    fn carry(&mut self, device: &str, tool: &Body) {
        for arm in &mut self.arms {
            arm.carry(device, tool);
        }
    }

    fn check(&self) -> Result<(), String> {
        segment::check(self)
    }

    fn devices(&self) -> Vec<DeviceDescription> {
        segment::describe(self)
    }

    fn start(&self, ends: DriverEnds) -> Result<Box<dyn DeviceDriver>, Error> {
        Ok(Box::new(Ethercat::start(self, segment::open(self)?, ends)?))
    }
}

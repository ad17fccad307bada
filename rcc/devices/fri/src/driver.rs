//! What the controller needs of a configured arm: its check, its description and its start. The configurations
//! themselves know no driver.

use std::time::Duration;

use takt_core::Error;
use takt_core::device::DeviceDescription;
use takt_core::device::driver::{DeviceDriver, DriverConfig, DriverEnds};

use crate::config::{IiwaConfig, LwrConfig};
use crate::iiwa::{self, Iiwa};
use crate::lwr::{self, Lwr};

impl DriverConfig for LwrConfig {
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
        lwr::check(self)
    }

    fn devices(&self) -> Vec<DeviceDescription> {
        vec![lwr::describe_config(self).with(&lwr::parts())]
    }

    fn start(&self, ends: DriverEnds) -> Result<Box<dyn DeviceDriver>, Error> {
        Ok(Box::new(Lwr::start(self, lwr::listen(self)?, ends)?))
    }
}

impl DriverConfig for IiwaConfig {
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
        iiwa::check(self)
    }

    fn devices(&self) -> Vec<DeviceDescription> {
        vec![iiwa::describe_config(self).with(&iiwa::parts(&self.io))]
    }

    fn start(&self, ends: DriverEnds) -> Result<Box<dyn DeviceDriver>, Error> {
        Ok(Box::new(Iiwa::start(self, iiwa::listen(self)?, ends)?))
    }
}

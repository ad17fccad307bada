//! Devices of a running controller: those of its cell, and simulated ones that programs make and
//! remove.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::cell::LwrConfig;
use crate::controller::desk::Desk;
use crate::controller::{Controller, NetState};
use crate::device::lwr::{self, Lwr};
use crate::device::sim::{SimArm, Simulation};
use crate::device::{ARM_JOINTS_MAX, ArmDescription, ArmPorts, JointSetPoints};
use crate::error::Error;
use crate::executor::thread::{ArmDriver, ArmEnd, Command};

impl Controller {
    /// Makes a simulated device of one of `device::sim::kinds` with parameters as text.
    ///
    /// # Errors
    /// If the name is taken, there is no such type, or a parameter is wrong or missing.
    pub fn add_device(
        &self,
        name: &str,
        kind: &str,
        parameters: &BTreeMap<String, String>,
    ) -> Result<(), Error> {
        let arm = SimArm::read(name, kind, parameters)?;
        let mut desk = self.inner.lock();
        desk.add_simulated(&arm)?;
        self.inner.announce(&desk);
        Ok(())
    }

    /// Removes a device that [`Self::add_device`] made.
    ///
    /// # Errors
    /// If there is no such device, it is one of the cell, or a loaded net uses it.
    pub fn remove_device(&self, name: &str) -> Result<(), Error> {
        let mut desk = self.inner.lock();
        desk.remove_simulated(name)?;
        self.inner.announce(&desk);
        Ok(())
    }
}

impl Desk {
    /// Starts the driver of an LWR.
    pub(super) fn add_lwr(&mut self, config: &LwrConfig, period: Duration) -> Result<(), Error> {
        let (number, ports) = self.add_description(lwr::describe(&config.name))?;
        let ArmPorts {
            state,
            command,
            driver_state,
            driver_command,
        } = ports;
        self.arms
            .push(Lwr::start(config, period, driver_state, driver_command)?);
        self.serve(number, ArmDriver::Cells { state, command })
    }

    fn add_simulated(&mut self, arm: &SimArm) -> Result<(), Error> {
        let (number, ports) = self.add_description(arm.description.clone())?;
        let simulation = Simulation::new(arm, ports.driver_state);
        self.serve(number, ArmDriver::Simulated(Box::new(simulation)))
    }

    fn add_description(&mut self, description: ArmDescription) -> Result<(usize, ArmPorts), Error> {
        let (number, ports) = self.devices.add_arm(description.clone())?;
        if let (Some(recorder), Some(arm)) = (&self.recorder, self.devices.get(number)) {
            recorder.arm(&description, arm.first_joint);
        }
        Ok((number, ports))
    }

    fn serve(&mut self, number: usize, driver: ArmDriver) -> Result<(), Error> {
        let Some(arm) = self.devices.get(number) else {
            return Ok(());
        };
        let (first_joint, joints) = (arm.first_joint, arm.limits.len());
        let set_points = [JointSetPoints::default(); ARM_JOINTS_MAX];
        let end = Box::new(ArmEnd {
            number,
            first_joint,
            joints,
            driver,
            set_points,
        });
        self.command(Command::AddArm(end))
    }

    fn remove_simulated(&mut self, name: &str) -> Result<(), Error> {
        if self.devices.find(name).is_none() {
            return Err(Error::NoSuchDevice(name.to_owned()));
        }
        if self.arms.iter().any(|arm| arm.name() == name) {
            let what = "it belongs to the cell; take it out of its configuration".to_owned();
            return Err(Error::DeviceParameter {
                name: name.to_owned(),
                what,
            });
        }
        let over = |state| matches!(state, NetState::Terminated | NetState::Rejected);
        let user = self
            .nets
            .iter()
            .find(|(_, net)| !over(net.state()) && net.uses(name));
        if let Some((net, _)) = user {
            return Err(Error::DeviceInUse {
                name: name.to_owned(),
                net: *net,
            });
        }
        match self.devices.remove(name) {
            Some(number) => self.command(Command::RemoveArm(number)),
            None => Ok(()),
        }
    }
}

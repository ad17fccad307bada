//! Devices of a running controller: those of its cell, and simulated ones that programs make and
//! remove.

use std::collections::BTreeMap;

use crate::cell::LwrConfig;
use crate::controller::Controller;
use crate::controller::clock::FollowedClock;
use crate::controller::desk::Desk;
use crate::device::lwr::{self, Lwr};
use crate::device::sim::{self, Simulated};
use crate::device::{DeviceDescription, DevicePorts};
use crate::error::Error;
use crate::executor::serve::{DeviceEnd, Driver};
use crate::executor::thread::Command;
use crate::span;

impl Controller {
    /// Makes a simulated device of one of `device::sim::kinds` with parameters as text. It is commanded
    /// by the net thread whose period `thread` tells, such as `4ms`; without that, by the first.
    ///
    /// # Errors
    /// If the name is taken, there is no such type, or a parameter is wrong or missing.
    pub fn add_device(
        &self,
        name: &str,
        kind: &str,
        parameters: &BTreeMap<String, String>,
    ) -> Result<(), Error> {
        let (description, device) = sim::make(name, kind, parameters)?;
        let wrong = |what| Error::DeviceParameter {
            name: name.to_owned(),
            what,
        };
        let period = parameters.get("thread").map(|text| span::parse(text));
        let period = period.transpose();
        let period = period.map_err(|e| wrong(format!("thread: {e}")))?;
        let mut desk = self.inner.lock();
        let thread = desk.thread_of_period(period).map_err(wrong)?;
        desk.add_simulated(description, device, thread)?;
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
    pub(super) fn add_lwr(&mut self, config: &LwrConfig) -> Result<(), Error> {
        let thread = self.thread_of_period(config.thread).map_err(Error::Cell)?;
        let period = self.threads[thread].period;
        let (number, ports) = self.add_description(lwr::describe(&config.name).with(lwr::PARTS))?;
        let DevicePorts {
            state,
            command,
            driver_state,
            driver_command,
        } = ports;
        let link = lwr::listen(config)?;
        let clock = FollowedClock::writer_for(&mut self.clock, &config.name);
        let arm = Lwr::start(config, link, period, driver_state, driver_command, clock)?;
        self.arms.push(arm);
        self.serve(number, Driver::Cells { state, command }, thread)
    }

    fn add_simulated(
        &mut self,
        description: DeviceDescription,
        device: Box<dyn Simulated>,
        thread: usize,
    ) -> Result<(), Error> {
        let (number, ports) = self.add_description(description)?;
        let mut told = ports.driver_state;
        told.write_with(|state| state.copy_from(device.state()));
        self.serve(number, Driver::Simulated { device, told }, thread)
    }

    fn add_description(
        &mut self,
        description: DeviceDescription,
    ) -> Result<(usize, DevicePorts), Error> {
        let (number, ports) = self.devices.add(description.clone())?;
        if let (Some(recorder), Some(device)) = (&self.recorder, self.devices.get(number)) {
            recorder.device(number, &device.place, &description);
        }
        Ok((number, ports))
    }

    fn serve(&mut self, number: usize, driver: Driver, thread: usize) -> Result<(), Error> {
        let Some(device) = self.devices.get(number).cloned() else {
            return Ok(());
        };
        self.serve_in(&device.name, thread);
        let end = Box::new(DeviceEnd::new(number, device.place.clone(), driver));
        self.command(Command::AddDevice(end))
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
        self.refuse_if_used(name)?;
        if let Some(recorder) = &self.recorder {
            recorder.device_gone(name);
        }
        match self.devices.remove(name) {
            Some(number) => self.command(Command::RemoveDevice(number)),
            None => Ok(()),
        }
    }
}

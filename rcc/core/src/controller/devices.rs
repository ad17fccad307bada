//! Devices of a running controller: those of its cell, and simulated devices that programs create and
//! remove.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::controller::Controller;
use crate::controller::clock::FollowedClock;
use crate::controller::registry::Registry;
use crate::device::driver::{self, DeviceDriver, DriverConfig, DriverEnds};
use crate::device::sim::{self, Simulated};
use crate::device::{DeviceDescription, DevicePorts};
use crate::error::Error;
use crate::executor::serve::Driver;
use crate::span;

impl Controller {
    /// Creates a simulated device of one of `device::sim::kinds` with parameters as text. It is commanded
    /// by the net thread whose period is given by `thread`, such as `4ms`, by default the first.
    ///
    /// # Errors
    /// If the name is taken, there is no such type, or a parameter is wrong or missing.
    pub fn add_device(
        &self,
        name: &str,
        kind: &str,
        parameters: &BTreeMap<String, String>,
    ) -> Result<(), Error> {
        let (mut description, device) = sim::make(name, kind, parameters)?;
        // Clients give chains, too: they must not name files of this host, which the page would show.
        description.model = description.model.without_solids();
        let wrong = |what| Error::DeviceParameter {
            name: name.to_owned(),
            what,
        };
        let period = parameters.get("thread").map(|text| span::parse(text));
        let period = period.transpose();
        let period = period.map_err(|e| wrong(format!("thread: {e}")))?;
        let mut registry = self.inner.lock();
        let thread = registry.threads.of_period(period).map_err(wrong)?;
        registry.add_simulated(description, device, thread)?;
        self.inner.announce(&registry);
        Ok(())
    }

    /// Adds devices whose driver the caller starts, for example a driver of its own, or one over a link inside
    /// of this process. `name` is the driver's; `thread` is the period of the net thread that commands the
    /// devices; `None` selects the first.
    ///
    /// # Errors
    /// If a name is taken, capacity is exhausted, there is no such thread, or `start` fails.
    pub fn add_driver(
        &self,
        name: &str,
        devices: Vec<DeviceDescription>,
        thread: Option<Duration>,
        start: impl FnOnce(DriverEnds) -> Result<Box<dyn DeviceDriver>, Error>,
    ) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        let added = registry.add_driver(name, devices, thread, start);
        self.inner.announce(&registry);
        added
    }

    /// Removes a device that [`Self::add_device`] made.
    ///
    /// # Errors
    /// If there is no such device, it is one of the cell, or a loaded net uses it.
    pub fn remove_device(&self, name: &str) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        registry.remove_simulated(name)?;
        self.inner.announce(&registry);
        Ok(())
    }
}

impl Registry {
    /// Starts a driver of the cell.
    pub(super) fn add_of_cell(&mut self, config: &dyn DriverConfig) -> Result<(), Error> {
        if let Some((description, device)) = config.simulated()? {
            let thread = self.threads.of_period(config.thread());
            return self.add_simulated(description, device, thread.map_err(Error::Cell)?);
        }
        self.add_driver(config.name(), config.devices(), config.thread(), |ends| {
            config.start(ends)
        })
    }

    /// Adds devices, starts the driver of all of them, and serves them in a net thread.
    fn add_driver(
        &mut self,
        name: &str,
        descriptions: Vec<DeviceDescription>,
        thread: Option<Duration>,
        start: impl FnOnce(DriverEnds) -> Result<Box<dyn DeviceDriver>, Error>,
    ) -> Result<(), Error> {
        let thread = self.threads.of_period(thread).map_err(Error::Cell)?;
        let net_period = self.threads.period(thread).unwrap_or_default();
        let names: Vec<_> = descriptions.iter().map(|d| d.name.clone()).collect();
        let mut added = Vec::new();
        let mut devices = Vec::new();
        let mut result = Ok(());
        for description in descriptions {
            match self.add_description(description) {
                Ok((number, ports)) => {
                    let (state, command) = (ports.driver_state, ports.driver_command);
                    devices.push(driver::DeviceEnd {
                        state,
                        command,
                        net_period,
                    });
                    let (state, command) = (ports.state, ports.command);
                    added.push((number, Driver::Cells { state, command }));
                }
                Err(error) => {
                    result = Err(error);
                    break;
                }
            }
        }
        let clock = FollowedClock::writer_for(&mut self.devices.clock, name);
        let started = result.and_then(|()| start(DriverEnds { devices, clock }));
        match started {
            Ok(driver) => self.devices.drivers.push(driver),
            Err(error) => {
                // They were added before the driver failed to start.
                for name in names.iter().take(added.len()) {
                    self.devices.table.remove(name);
                }
                return Err(error);
            }
        }
        added
            .into_iter()
            .try_for_each(|(number, driver)| self.serve(number, driver, thread))
    }

    fn add_simulated(
        &mut self,
        description: DeviceDescription,
        device: Box<dyn Simulated>,
        thread: usize,
    ) -> Result<(), Error> {
        let (number, ports) = self.add_description(description)?;
        let mut published = ports.driver_state;
        published.write_with(|state| state.copy_from(device.state()));
        self.serve(number, Driver::Simulated { device, published }, thread)
    }

    fn add_description(
        &mut self,
        description: DeviceDescription,
    ) -> Result<(usize, DevicePorts), Error> {
        let (number, ports) = self.devices.table.add(description.clone())?;
        if let (Some(recorder), Some(device)) = (&self.recorder, self.devices.table.get(number)) {
            recorder.device(number, &device.place, &description);
        }
        Ok((number, ports))
    }

    fn serve(&mut self, number: usize, driver: Driver, thread: usize) -> Result<(), Error> {
        let Some(device) = self.devices.table.get(number) else {
            return Ok(());
        };
        self.threads.serve_in(&device.name, thread);
        self.threads.add_device(number, device, driver)
    }

    pub(super) fn remove_simulated(&mut self, name: &str) -> Result<(), Error> {
        if self.devices.table.find(name).is_none() {
            return Err(Error::NoSuchDevice(name.to_owned()));
        }
        if self.devices.driver_of(name).is_some() {
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
        match self.devices.table.remove(name) {
            Some(number) => self.threads.remove_device(number),
            None => Ok(()),
        }
    }
}

//! Devices of the cell that are added and removed at run time, when its file is reloaded. The
//! caller, which reads the file, selects them; nets are not affected.

use crate::controller::Controller;
use crate::controller::clock::FollowedClock;
use crate::controller::nets::Net;
use crate::controller::registry::Registry;
use crate::device::driver::DriverConfig;
use crate::error::Error;
use crate::ids::NetState;

impl Controller {
    /// Adds a device of the cell and starts its driver.
    ///
    /// # Errors
    /// If its name is taken, capacity is exhausted, or it cannot be opened.
    pub fn add_cell_device(&self, device: &dyn DriverConfig) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        let added = registry.add_of_cell(device);
        self.inner.announce(&registry);
        added
    }

    /// Removes a device of the cell and stops its driver.
    ///
    /// # Errors
    /// If there is no such device in the cell, a loaded net uses it, or it still moves.
    pub fn remove_cell_device(&self, name: &str) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        let of_cell = registry
            .devices
            .drivers
            .iter()
            .position(|driver| driver.name() == name);
        registry.refuse_if_used(name)?;
        if registry
            .devices
            .table
            .find(name)
            .is_some_and(|device| !device.is_at_rest())
        {
            return Err(Error::DeviceParameter {
                name: name.to_owned(),
                what: "it still moves; wait until it is at rest".to_owned(),
            });
        }
        let Some(at) = of_cell else {
            let removed = registry.remove_simulated(name);
            self.inner.announce(&registry);
            return removed;
        };
        if let Some(number) = registry.devices.table.remove(name) {
            registry.threads.remove_device(number)?;
        }
        let driver = registry.devices.drivers.remove(at);
        self.inner.announce(&registry);
        drop(registry);
        // Its thread takes a moment to end; wait without the lock.
        if let Some(clock) = driver.stop() {
            FollowedClock::give_back(&mut self.inner.lock().devices.clock, name, clock);
        }
        Ok(())
    }
}

impl Registry {
    /// An error if a net that has not ended reads or commands the device, or one is being loaded: which devices
    /// it will use is not known yet.
    pub(super) fn refuse_if_used(&self, name: &str) -> Result<(), Error> {
        let may_use = |net: &Net| net.state() == NetState::Loading || net.uses(name);
        let mut nets = self.nets.iter();
        match nets.find(|(_, net)| !net.is_over() && may_use(net)) {
            None => Ok(()),
            Some((net, _)) => Err(Error::DeviceInUse {
                name: name.to_owned(),
                net,
            }),
        }
    }
}

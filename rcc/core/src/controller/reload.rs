//! Devices of the cell that come and go while the controller runs, as its file is read anew. Which
//! those are is decided by whoever reads the file; nets are never touched.

use crate::cell::DeviceConfig;
use crate::controller::clock::FollowedClock;
use crate::controller::desk::Desk;
use crate::controller::net::Net;
use crate::controller::{Controller, NetState};
use crate::error::Error;
use crate::executor::thread::Command;

impl Controller {
    /// Starts the driver of another device of the cell.
    ///
    /// # Errors
    /// If its name is taken, there is no room for it, or it cannot be opened.
    pub fn add_cell_device(&self, device: &DeviceConfig) -> Result<(), Error> {
        let mut desk = self.inner.lock();
        let added = desk.add_of_cell(device);
        self.inner.announce(&desk);
        added
    }

    /// Ends the driver of a device of the cell.
    ///
    /// # Errors
    /// If there is no such device in the cell, a loaded net uses it, or it still moves.
    pub fn remove_cell_device(&self, name: &str) -> Result<(), Error> {
        let mut desk = self.inner.lock();
        let of_cell = desk.drivers.iter().position(|driver| driver.name() == name);
        let at = of_cell.ok_or_else(|| Error::NoSuchDevice(name.to_owned()))?;
        desk.refuse_if_used(name)?;
        if desk
            .devices
            .find(name)
            .is_some_and(|device| !device.is_at_rest())
        {
            return Err(Error::DeviceParameter {
                name: name.to_owned(),
                what: "it still moves; wait until it is at rest".to_owned(),
            });
        }
        if let Some(number) = desk.devices.remove(name) {
            desk.command(Command::RemoveDevice(number))?;
        }
        let driver = desk.drivers.remove(at);
        self.inner.announce(&desk);
        drop(desk);
        // Its thread takes a moment to end; nobody else need wait for that.
        if let Some(clock) = driver.stop() {
            FollowedClock::give_back(&mut self.inner.lock().clock, name, clock);
        }
        Ok(())
    }
}

impl Desk {
    /// An error if a net that is not over reads or commands the device, or one is being loaded: which devices
    /// that will use is not known yet.
    pub(super) fn refuse_if_used(&self, name: &str) -> Result<(), Error> {
        let over = |state| matches!(state, NetState::Terminated | NetState::Rejected);
        let mut nets = self.nets.iter();
        let may_use = |net: &Net| net.state() == NetState::Loading || net.uses(name);
        match nets.find(|(_, net)| !over(net.state()) && may_use(net)) {
            None => Ok(()),
            Some((net, _)) => Err(Error::DeviceInUse {
                name: name.to_owned(),
                net: *net,
            }),
        }
    }
}

//! The devices of a controller and the drivers that move them. It starts no driver and watches none.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use takt_net::JointLimits;

use crate::controller::clock::FollowedClock;
use crate::device::driver::DeviceDriver;
use crate::device::{Device, DeviceStatus, DeviceTable};

/// A device as programs see it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceInfo {
    /// Its name.
    pub name: String,
    /// Its type.
    pub kind: String,
    /// Its interfaces with their parameters.
    pub interfaces: BTreeMap<String, BTreeMap<String, String>>,
    /// Whether it can be used.
    pub status: DeviceStatus,
}

/// A device with what a program needs to plan motions.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceDetails {
    /// Name, type, interfaces and state.
    pub info: DeviceInfo,
    /// Limits of each joint; none if it is no arm.
    pub joints: Arc<[JointLimits]>,
    /// Model of its kinematics, as `takt_motion::kinematics` names it; empty for none.
    pub model: String,
    /// Period of the nets that command it.
    pub period: Duration,
}

/// The devices and their drivers.
pub(super) struct DeviceSet {
    pub(super) table: DeviceTable,
    pub(super) drivers: Vec<Box<dyn DeviceDriver>>,
    /// The device clock that net threads follow.
    pub(super) clock: Option<FollowedClock>,
}

impl DeviceSet {
    pub(super) fn new(clock: Option<FollowedClock>) -> Self {
        Self {
            table: DeviceTable::default(),
            drivers: Vec::new(),
            clock,
        }
    }

    /// The driver of a device.
    pub(super) fn driver_of(&self, device: &str) -> Option<&dyn DeviceDriver> {
        let mut drivers = self.drivers.iter();
        let driver = drivers.find(|driver| driver.drives(device))?;
        Some(driver.as_ref())
    }

    /// The figures of a device's driver in one line.
    pub(super) fn figures_of(&self, device: &str) -> Option<String> {
        let figures = self.driver_of(device)?.figures();
        let pairs = figures
            .iter()
            .map(|(name, value)| format!("{name} {value}"));
        Some(pairs.collect::<Vec<_>>().join(", "))
    }

    /// The name of a device; its number if it was removed.
    pub(super) fn name(&self, number: usize) -> String {
        let device = self.table.get(number);
        device.map_or_else(|| format!("device {number}"), |device| device.name.clone())
    }

    /// Whether it can be used; offline if it was removed.
    pub(super) fn status(&self, number: usize) -> DeviceStatus {
        let device = self.table.get(number);
        device.map_or(DeviceStatus::Offline, |device| device.status())
    }

    /// The devices that move, as far as they are in contact.
    pub(super) fn moving(&self) -> impl Iterator<Item = &Device> {
        let devices = self.table.all().map(|(_, device)| device.as_ref());
        devices.filter(|device| !device.is_at_rest())
    }

    /// The statuses by device name; under a stop no device is operational.
    pub(super) fn statuses(&self, is_stopped: bool) -> BTreeMap<String, DeviceStatus> {
        let devices = self.table.all();
        devices
            .map(|(_, device)| (device.name.clone(), device.status().under(is_stopped)))
            .collect()
    }

    /// The devices as programs see them; under a stop none is operational.
    pub(super) fn infos(&self, is_stopped: bool) -> Vec<DeviceInfo> {
        let info = |device: &Device| DeviceInfo {
            name: device.name.clone(),
            kind: device.kind.to_owned(),
            interfaces: device.properties(),
            status: device.status().under(is_stopped),
        };
        self.table.all().map(|(_, device)| info(device)).collect()
    }

    /// Limits of the joints of a device.
    pub(super) fn joints(&self, name: &str) -> Arc<[JointLimits]> {
        let device = self.table.all().find(|(_, device)| device.name == name);
        device.map_or_else(Arc::default, |(_, device)| Arc::clone(&device.limits))
    }

    /// Model of the kinematics of a device.
    pub(super) fn model(&self, name: &str) -> String {
        let device = self.table.all().find(|(_, device)| device.name == name);
        device.map_or_else(String::new, |(_, device)| device.model.to_string())
    }

    /// Ends all drivers and waits for that.
    pub(super) fn stop(&mut self) {
        self.drivers.iter().for_each(|driver| driver.ask_to_stop());
        for driver in self.drivers.drain(..) {
            drop(driver.stop());
        }
    }
}

//! The devices of a controller and the drivers that move them. It starts no driver and watches none.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use takt_motion::Model;
use takt_motion::kinematics::Chain;
use takt_net::JointLimits;

use crate::cell::{BaseConfig, CellFrames, HomeConfig, ToolConfig};

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
    /// All its interfaces with their parameters; `info` has those of the client protocol only.
    pub abilities: BTreeMap<String, BTreeMap<String, String>>,
    /// Limits of each joint; none if it is no arm.
    pub joints: Arc<[JointLimits]>,
    /// Model of its kinematics; empty for none.
    pub model: Model,
    /// Its kinematics as rotation axes; `None` if it has no model.
    pub chain: Option<Chain>,
    /// Where the cell places its base; `None` if it does not.
    pub base: Option<BaseConfig>,
    /// The tools that the cell gives it.
    pub tools: Vec<ToolConfig>,
    /// The home position that the cell gives it; `None` if it gives none.
    pub home: Option<HomeConfig>,
    /// Period of the nets that command it.
    pub period: Duration,
}

/// The devices and their drivers.
pub(super) struct DeviceSet {
    pub(super) table: DeviceTable,
    pub(super) drivers: Vec<Box<dyn DeviceDriver>>,
    /// The device clock that net threads follow.
    pub(super) clock: Option<FollowedClock>,
    /// Where they are.
    pub(super) frames: CellFrames,
}

impl DeviceSet {
    pub(super) fn new(clock: Option<FollowedClock>) -> Self {
        Self {
            table: DeviceTable::default(),
            drivers: Vec::new(),
            clock,
            frames: CellFrames::default(),
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

    /// A device with what a program needs to plan motions; `period` is that of the nets that command it.
    pub(super) fn details(&self, info: DeviceInfo, period: Duration) -> DeviceDetails {
        let device = self.table.all().map(|(_, device)| device.as_ref());
        let device = device.into_iter().find(|device| device.name == info.name);
        let arm = device.and_then(|device| device.kinematics.as_deref());
        DeviceDetails {
            abilities: device.map(Device::abilities).unwrap_or_default(),
            joints: device.map_or_else(Arc::default, |device| Arc::clone(&device.limits)),
            model: device
                .map(|device| device.model.clone())
                .unwrap_or_default(),
            chain: arm.map(Chain::of),
            base: self.frames.base(&info.name).cloned(),
            tools: self.frames.tools(&info.name).cloned().collect(),
            home: self.frames.home(&info.name).cloned(),
            period,
            info,
        }
    }

    /// Logs which devices of frames do not exist, since clients may create them later or their names are misspelled, and
    /// which arms cannot be at home.
    pub(super) fn report_unknown_frames(&self) {
        for device in self.frames.devices() {
            if self.table.find(device).is_none() {
                tracing::warn!(
                    "device `{device}` of [[base]], [[tool]] or [[home]] does not exist yet\nhint: unless a client \
                     creates it, correct its name in the cell file"
                );
            }
        }
        for (_, device) in self.table.all() {
            let home = self.frames.home(&device.name);
            if let Some(why) = home.and_then(|home| unfit(home, &device.limits)) {
                tracing::warn!(
                    "{}: the arm cannot be at home: {why}\nhint: correct [[home]] in the cell file",
                    device.name
                );
            }
        }
    }

    /// Ends all drivers and waits for that.
    pub(super) fn stop(&mut self) {
        self.drivers.iter().for_each(|driver| driver.ask_to_stop());
        for driver in self.drivers.drain(..) {
            drop(driver.stop());
        }
    }
}

/// Why an arm with these limits cannot be at a home position, if so.
fn unfit(home: &HomeConfig, limits: &[JointLimits]) -> Option<String> {
    let (count, joints) = (home.joints.len(), limits.len());
    if count != joints {
        return Some(format!("it has {joints} joints, not {count}"));
    }
    let mut joints = home.joints.iter().zip(limits).enumerate();
    joints.find_map(|(number, (joint, limits))| {
        let [min, max] = [limits.position_min, limits.position_max].map(f64::to_degrees);
        let is_inside = (min..=max).contains(joint);
        (!is_inside).then(|| {
            format!("joint {number}: {joint} deg is out of its range, {min:.1} to {max:.1} deg")
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn home_out_of_range_names_joint() {
        let limits = JointLimits {
            position_min: -1.0,
            position_max: 1.0,
            velocity_max: 1.0,
            acceleration_max: 1.0,
        };
        let why = |joints: &[f64]| {
            let (device, joints) = ("left".to_owned(), joints.to_vec());
            unfit(&HomeConfig { device, joints }, &[limits; 2])
        };
        assert_eq!(why(&[0.0, -57.0]), None);
        assert_eq!(why(&[0.0]).unwrap(), "it has 2 joints, not 1");
        assert_eq!(
            why(&[0.0, 58.0]).unwrap(),
            "joint 1: 58 deg is out of its range, -57.3 to 57.3 deg"
        );
    }
}

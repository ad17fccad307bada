//! Devices and nets of a controller, as the text of another net may refer to them.

use takt_net::device::{ArmBinding, Devices, Interfaces};
use takt_net::netcomm::NetBoxes;

use crate::controller::shared::Shared;
use crate::device::DeviceTable;
use crate::ids::NetId;

/// Devices and nets, as a net that is loaded may refer to them.
pub(super) struct Surroundings<'a> {
    pub(super) devices: &'a DeviceTable,
    pub(super) inner: &'a Shared,
}

impl Devices for Surroundings<'_> {
    fn arm(&self, name: &str) -> Option<ArmBinding> {
        self.devices.arm(name)
    }

    fn interfaces(&self, name: &str) -> Option<Interfaces> {
        self.devices.interfaces(name)
    }

    fn names(&self) -> Vec<String> {
        self.devices.names()
    }

    fn net(&self, name: &str) -> Option<NetBoxes> {
        let id: NetId = name.parse().ok()?;
        self.inner.lock().nets.get(id)?.boxes()
    }
}

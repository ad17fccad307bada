//! Devices and nets, as the text of another net may refer to them: those of a running controller, or of a recording.

use takt_net::device::{ArmBinding, Devices, Interfaces};
use takt_net::netcomm::NetBoxes;

use crate::device::DeviceTable;
use crate::ids::NetId;

/// Devices and nets, as a net that is loaded may refer to them.
pub(crate) struct Surroundings<'a, F> {
    pub(crate) devices: &'a DeviceTable,
    /// The in and out values of a net; `None` if there is no such net.
    pub(crate) boxes: F,
}

impl<F: Fn(NetId) -> Option<NetBoxes>> Devices for Surroundings<'_, F> {
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
        (self.boxes)(name.parse().ok()?)
    }
}

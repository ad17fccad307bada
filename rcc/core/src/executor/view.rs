//! What the life of nets depends on of a device. The rest of its state is in the image.

use crate::device::DeviceStatus;

/// The state of a device on which the life of nets depends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceView {
    /// Whether it follows commands.
    pub status: DeviceStatus,
    /// How often it stopped following commands.
    pub faults: u64,
    /// Number of position jumps while it followed: running nets continue, waiting ones do not start.
    pub jumps: u64,
}

impl DeviceView {
    /// Whether nets can command it.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.status == DeviceStatus::Operational
    }
}

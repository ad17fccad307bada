//! The context in which a net is loaded, for all steps of loading.

use std::time::Duration;

use crate::device::Devices;
use crate::limits::Limits;
use crate::registry::Registry;

/// The context in which a net is loaded.
#[derive(Clone, Copy)]
pub struct LoadContext<'c> {
    /// The available primitives.
    pub registry: &'c Registry,
    /// The available devices.
    pub devices: &'c dyn Devices,
    /// Time from one cycle of the net to the next.
    pub period: Duration,
    /// Bounds on the net.
    pub limits: Limits,
}

impl std::fmt::Debug for LoadContext<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LoadContext")
            .field("period", &self.period)
            .finish_non_exhaustive()
    }
}

//! What a stream of live messages needs of the controller: its devices, nets and rings. It sends nothing.

use std::sync::Arc;

use crate::controller::Controller;
use crate::controller::nets::LiveNet;
use crate::device::Device;
use crate::executor::flight::FlightReader;

impl Controller {
    /// The devices by number, with the number of the thread that serves each.
    pub(crate) fn live_devices(&self) -> Vec<(usize, Arc<Device>, usize)> {
        let registry = self.inner.lock();
        let threads = &registry.threads;
        let live = |(number, device): (usize, &Arc<Device>)| {
            let thread = threads.serving_thread(&device.name);
            (number, Arc::clone(device), thread)
        };
        registry.devices.table.all().map(live).collect()
    }

    /// The nets with their states and values.
    pub(crate) fn live_nets(&self) -> Vec<LiveNet> {
        let registry = self.inner.lock();
        registry.nets.iter().map(|(id, net)| net.live(id)).collect()
    }

    /// The rings of out values, by thread.
    pub(crate) fn live_values(&self) -> Vec<FlightReader> {
        let registry = self.inner.lock();
        registry
            .threads
            .iter()
            .map(|it| it.flight.clone())
            .collect()
    }
}

//! What a stream of live messages needs of the controller: its devices, nets and rings. It sends nothing.

use std::sync::Arc;

use takt_machine::Program;

use crate::controller::Controller;
use crate::controller::nets::LiveNet;
use crate::device::Device;
use crate::executor::thread::NetThread;
use crate::record::Recorder;
use crate::record::flight::ThreadRings;

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

    /// The rings of net threads.
    pub(crate) fn live_threads(&self) -> Vec<ThreadRings> {
        let registry = self.inner.lock();
        registry.threads.iter().map(NetThread::rings).collect()
    }

    /// The machines by number.
    pub(crate) fn live_machines(&self) -> Vec<(u32, Arc<Program>)> {
        let registry = self.inner.lock();
        let machines = registry.machines.that_ran();
        machines
            .map(|(id, program, _)| (id, Arc::clone(program)))
            .collect()
    }

    /// The Unix time to which a recording refers its messages, if there is one.
    pub(crate) fn recording_epoch(&self) -> Option<u64> {
        self.inner.lock().recorder.as_ref().map(Recorder::epoch)
    }
}

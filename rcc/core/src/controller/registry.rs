//! The controller's registry: its parts, composed under one lock that real-time threads never take. Each part has its own
//! state and works on values; what concerns several parts is in the modules of the calls, such as [`start`](super::start).

use std::collections::BTreeMap;
use std::fmt;

use crate::controller::admission::Admission;
use crate::controller::changed::Changed;
use crate::controller::device_set::DeviceSet;
use crate::controller::flight_recorder::FlightRecorder;
use crate::controller::machines::Machines;
use crate::controller::monitor::Monitor;
use crate::controller::nets::Nets;
use crate::controller::permission::Permission;
use crate::controller::rejections::Rejections;
use crate::controller::rules::Rules;
use crate::controller::sessions::Sessions;
use crate::controller::threads::NetThreads;
use crate::error::Error;
use crate::executor::thread::Command;
use crate::record::Recorder;

type Wake = Box<dyn Fn(Changed) + Send + Sync>;

/// What is called after changes.
#[derive(Default)]
pub(super) struct Watches {
    wakes: BTreeMap<u64, Wake>,
    last: u64,
}

impl Watches {
    pub(super) fn add(&mut self, wake: Wake) -> u64 {
        self.last += 1;
        self.wakes.insert(self.last, wake);
        self.last
    }

    pub(super) fn remove(&mut self, number: u64) {
        self.wakes.remove(&number);
    }

    pub(super) fn wake(&self, changed: Changed) {
        self.wakes.values().for_each(|wake| wake(changed));
    }
}

/// Everything behind the lock.
pub(super) struct Registry {
    pub(super) nets: Nets,
    pub(super) sessions: Sessions,
    pub(super) rules: Rules,
    pub(super) machines: Machines,
    pub(super) devices: DeviceSet,
    pub(super) monitor: Monitor,
    pub(super) rejections: Rejections,
    pub(super) threads: NetThreads,
    pub(super) admission: Admission,
    pub(super) permission: Permission,
    pub(super) recorder: Option<Recorder>,
    pub(super) flights: Option<FlightRecorder>,
    pub(super) watches: Watches,
    /// Whether events were applied and watchers not yet notified.
    pub(super) unannounced: bool,
}

impl fmt::Debug for Registry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Registry")
            .field("nets", &self.nets.len())
            .finish_non_exhaustive()
    }
}

impl Registry {
    pub(super) fn new(
        threads: NetThreads,
        devices: DeviceSet,
        permission: Permission,
        recorder: Option<Recorder>,
        admission: Admission,
    ) -> Self {
        Self {
            nets: Nets::default(),
            sessions: Sessions::default(),
            rules: Rules::default(),
            machines: Machines::default(),
            devices,
            monitor: Monitor::default(),
            rejections: Rejections::default(),
            threads,
            admission,
            permission,
            recorder,
            flights: None,
            watches: Watches::default(),
            unannounced: false,
        }
    }

    /// Sends a command to the thread of the net that it is about.
    ///
    /// # Errors
    /// If the queue of that thread is full.
    pub(super) fn command(&mut self, command: Command) -> Result<(), Error> {
        let thread = command.net().map_or(0, |net| self.nets.thread_of(net));
        self.threads.send(thread, command)
    }
}

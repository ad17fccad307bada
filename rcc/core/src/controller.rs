//! The controller: its programming interface, and the registry between programs and the net threads. All
//! calls may block for one or two cycles; real-time threads make none of them.

mod access;
mod admission;
mod changed;
mod clock;
mod device_set;
mod devices;
mod driver_log;
mod end;
mod eval;
mod events;
mod faults;
mod figures;
mod flight_recorder;
mod flights;
mod holders;
mod last_values;
mod limited;
mod live;
mod load;
mod machines;
mod monitor;
mod nets;
mod permission;
mod prepared;
mod probes;
mod registry;
mod rejections;
mod reload;
mod rules;
mod schedule;
mod sessions;
mod shared;
mod shutdown;
mod start;
mod supervisor;
mod threads;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use crate::cell::CellConfig;
use crate::error::Error;
use crate::executor::report::Notifier;
use crate::executor::stop::EmergencyStop;
use crate::record::{Recorder, Tap};
use crate::stop_channel::StopSwitch;
use clock::FollowedClock;
use permission::Permission;
use registry::Registry;
use rejections::Rejections;
use shared::Shared;
use supervisor::supervise;
use threads::NetThreads;

use admission::Admission;
use device_set::DeviceSet;

pub use crate::executor::{
    figures::NetCounts,
    rules::{Begun, RuleState},
};
pub use crate::ids::{NetId, NetState, SessionId};
pub use admission::limits_for;
pub use changed::Changed;
pub use clock::ClockInfo;
pub use device_set::{DeviceDetails, DeviceInfo};
pub use driver_log::{DriverReport, EventCounts};
pub use end::STOPPED_BY_RULE;
pub use eval::{EVAL_COST_MAX, EVAL_PRIMITIVES_MAX};
pub use faults::{DeviceFault, FaultCounts, StallCause, StallFigures};
pub use figures::{NetFigures, ThreadInfo};
pub use flight_recorder::{BURST, FlightCounts, FlightInfo, FlightSettings};
pub use holders::Holder;
pub use last_values::LastValues;
pub use limited::LimitedInfo;
pub use load::LoadRequest;
pub use machines::{MachineCost, MachineInfo, MachineRequest};
pub(crate) use nets::LiveNet;
pub use nets::{
    NETS_MAX, NetInfo, RECORDED_NETS_MAX, RetainedNet, TAPS_RECORDED_FOR, TapRecord, Taps,
};
pub use prepared::{PreparedStart, PreparedState};
pub use rejections::{RejectReason, RejectedCounts, RejectedInfo};
pub use rules::{RuleId, RuleInfo, RuleRequest};
pub use sessions::SESSIONS_MAX;
pub use takt_motion::kinematics::{Axis, Chain};
pub use takt_motion::urdf::{ArmModel, Shape as VisualShape};

/// Ends a watch when dropped.
#[derive(Debug)]
#[must_use = "the watch ends when this is dropped"]
pub struct Watch {
    inner: Arc<Shared>,
    number: u64,
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.inner.lock().watches.remove(self.number);
    }
}

/// A running controller. Clones are handles of the same controller; dropping the last one stops it.
#[derive(Clone, Debug)]
pub struct Controller {
    inner: Arc<Shared>,
    _life: Arc<Life>,
}

/// Stops the threads when the last handle is dropped.
#[derive(Debug)]
struct Life {
    inner: Arc<Shared>,
    threads: Mutex<Vec<std::thread::JoinHandle<()>>>,
}

impl Life {
    /// Starts a thread of the controller, which is joined when the last handle is dropped.
    fn spawn(&self, name: &str, work: impl FnOnce() + Send + 'static) -> Result<(), Error> {
        let name = name.to_owned();
        let thread = std::thread::Builder::new()
            .name(name.clone())
            .spawn(work)
            .map_err(|source| Error::Thread { name, source })?;
        let mut threads = self.threads.lock().unwrap_or_else(PoisonError::into_inner);
        threads.push(thread);
        Ok(())
    }
}

impl Drop for Life {
    fn drop(&mut self) {
        self.inner.stop.store(true, Ordering::Relaxed);
        if let Some(flights) = self.inner.lock().flights.take() {
            flights.stop();
        }
        self.inner.changed.notify_all();
        let mut threads = self.threads.lock().unwrap_or_else(PoisonError::into_inner);
        for thread in threads.drain(..) {
            let name = thread.thread().name().unwrap_or("a thread").to_owned();
            if thread.join().is_err() {
                tracing::error!("{name} panicked");
            }
        }
        self.inner.lock().stop();
    }
}

impl Controller {
    /// Starts the threads of a cell.
    ///
    /// # Errors
    /// If the cell is invalid, or a device or a thread cannot be started.
    pub fn start(cell: &CellConfig) -> Result<Self, Error> {
        Self::start_recording(cell, None)
    }

    /// Starts the threads of a cell and records the first net thread.
    ///
    /// # Errors
    /// If the cell is invalid, or a device or a thread cannot be started.
    pub fn start_recording(
        cell: &CellConfig,
        recording: Option<(Recorder, Tap)>,
    ) -> Result<Self, Error> {
        Self::start_under(cell, recording, StopSwitch::default())
    }

    /// As [`Self::start_recording`], under an existing switch, which a stop channel serves independently.
    ///
    /// # Errors
    /// If the cell is invalid, or a device or a thread cannot be started.
    pub fn start_under(
        cell: &CellConfig,
        recording: Option<(Recorder, Tap)>,
        switch: StopSwitch,
    ) -> Result<Self, Error> {
        cell.check().map_err(Error::Cell)?;
        let (recorder, tap) = recording.unzip();
        let clock = FollowedClock::of(cell);
        let stop = Arc::new(EmergencyStop::under(cell.controller.need_estop, switch));
        let notifier = Arc::new(Notifier::default());
        let threads = NetThreads::start(cell, clock.as_ref(), &stop, &notifier, tap)?;
        let admission = Admission::of_mib(cell.controller.nets_memory_mib);
        let (devices, permission) = (DeviceSet::new(clock), Permission::new(stop));
        let mut registry = Registry::new(threads, devices, permission, recorder, admission);
        registry.rejections = Rejections::ending_after(cell.controller.rejected_ends_after);
        for config in cell.drivers() {
            registry.add_of_cell(&**config)?;
        }
        registry.devices.frames = cell.frames.clone();
        if let Some(recorder) = &registry.recorder {
            recorder.frames(&cell.frames);
        }
        registry.devices.report_unknown_frames();
        let inner = Arc::new(Shared {
            registry: Mutex::new(registry),
            changed: Condvar::new(),
            stop: AtomicBool::new(false),
            primitives: crate::costs::registry(cell.controller.costs.as_deref())?,
            period: cell.controller.period,
        });
        let life = Life {
            inner: Arc::clone(&inner),
            threads: Mutex::default(),
        };
        let handle = Arc::clone(&inner);
        let shared = Arc::clone(&inner);
        life.spawn("takt-supervisor", move || supervise(&shared, &notifier))?;
        life.spawn("takt-machines", move || machines::work::work(&inner))?;
        Ok(Self {
            inner: handle,
            _life: Arc::new(life),
        })
    }

    /// Calls `wake` after each change of nets, sessions, devices or Boolean out values, from a thread of the
    /// controller; `wake` must not call the controller. Changes of other out values do not call it.
    pub fn on_change(&self, wake: impl Fn(Changed) + Send + Sync + 'static) -> Watch {
        let mut registry = self.inner.lock();
        let number = registry.watches.add(Box::new(wake));
        Watch {
            inner: Arc::clone(&self.inner),
            number,
        }
    }

    /// The switch that stops and releases the whole controller.
    #[must_use]
    pub fn stop_switch(&self) -> StopSwitch {
        self.inner.lock().permission.switch().clone()
    }

    /// Period of the first net thread.
    #[must_use]
    pub fn period(&self) -> Duration {
        self.inner.period
    }

    /// Ends the recording; returns how many cycles it holds, or `None` if there was none.
    ///
    /// # Errors
    /// If the file could not be written or cycles were lost.
    pub fn finish_recording(&self) -> Result<Option<u64>, Error> {
        let recorder = self.inner.lock().recorder.take();
        recorder.map(Recorder::finish).transpose()
    }
}

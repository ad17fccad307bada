//! What a controller needs of a driver that runs, whatever it drives. How drivers exchange values with
//! nets is in `DeviceState` and `DeviceCommand`; starting one is the matter of its module.

use std::any::Any;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use takt_rt::Grant;
use takt_rt::latest::{LatestReader, LatestWriter};
use takt_rt::servo::Estimate;
use takt_rt::stats::StallReader;
use takt_rt::thread::{Thread, ThreadConfig};

use crate::device::{DeviceCommand, DeviceState};
use crate::error::Error;

/// How long a driver that is told to end may take to bring its devices to rest and to take their power away: it
/// brakes them as when set-points cease, and cuts no power while they move.
pub const FAREWELL: Duration = Duration::from_secs(4);

/// What a driver gets for each of its devices.
#[derive(Debug)]
pub struct DeviceEnd {
    /// Where it tells of the device.
    pub state: LatestWriter<DeviceState>,
    /// Where it is told what the device is to do.
    pub command: LatestReader<DeviceCommand>,
    /// Time between two commands.
    pub net_period: Duration,
}

/// What a driver gets when it is started.
#[derive(Debug)]
pub struct DriverEnds {
    /// One for each of its devices, in their order.
    pub devices: Vec<DeviceEnd>,
    /// Where it tells the clock of its device or bus, which net threads may follow.
    pub clock: LatestWriter<Estimate>,
}

impl DriverEnds {
    /// The end of the only device, and where the driver tells its clock.
    ///
    /// # Errors
    /// If there is not one device.
    pub fn only(self, name: &str) -> Result<(DeviceEnd, LatestWriter<Estimate>), Error> {
        let Ok([end]) = <[DeviceEnd; 1]>::try_from(self.devices) else {
            return Err(Error::DeviceParameter {
                name: name.to_owned(),
                what: "its driver drives one device".to_owned(),
            });
        };
        Ok((end, self.clock))
    }
}

/// How much something matters that a driver reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// Something came, works again, or is as it should be.
    Info,
    /// Something is not as it should be; the device may do its work all the same.
    Warning,
    /// The device cannot do its work.
    Error,
}

/// Something that happened on the wire of a driver.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    /// How much it matters.
    pub severity: Severity,
    /// The cause, and where there is one the remedy.
    pub text: String,
}

impl Notice {
    /// Good to know.
    #[must_use]
    pub const fn info(text: String) -> Self {
        Self {
            severity: Severity::Info,
            text,
        }
    }

    /// Not as it should be.
    #[must_use]
    pub const fn warning(text: String) -> Self {
        Self {
            severity: Severity::Warning,
            text,
        }
    }

    /// The device cannot do its work.
    #[must_use]
    pub const fn error(text: String) -> Self {
        Self {
            severity: Severity::Error,
            text,
        }
    }
}

/// The thread of a driver.
#[derive(Debug)]
pub struct DriverThread {
    name: String,
    thread: Thread<LatestWriter<Estimate>>,
    stop: Arc<AtomicBool>,
}

impl DriverThread {
    /// Starts it. `body` ends within [`FAREWELL`] after the flag that it is given is set, and then gives back where
    /// it told the clock of its device. `priority` is that of `SCHED_FIFO`; no `cpus` are any.
    ///
    /// # Errors
    /// If the system has no thread to give.
    pub fn start(
        name: &str,
        priority: Option<u8>,
        cpus: &[usize],
        body: impl FnOnce(&AtomicBool) -> LatestWriter<Estimate> + Send + 'static,
    ) -> Result<Self, Error> {
        let stop = Arc::new(AtomicBool::new(false));
        let stopping = Arc::clone(&stop);
        let config = ThreadConfig {
            priority,
            cpus: cpus.to_vec(),
            ..ThreadConfig::new(format!("takt-{name}"))
        };
        let thread = takt_rt::thread::spawn(config, move || {
            let mut clock = body(&stopping);
            // Nobody measures it any more.
            clock.write(Estimate::default());
            clock
        });
        let name = name.to_owned();
        match thread {
            Ok(thread) => Ok(Self { name, thread, stop }),
            Err(source) => Err(Error::Thread { name, source }),
        }
    }

    fn stop(self) -> Option<LatestWriter<Estimate>> {
        self.stop.store(true, Ordering::Relaxed);
        let clock = self.thread.join().ok();
        if clock.is_none() {
            tracing::error!(driver = self.name, "the driver thread had ended by a panic");
        }
        clock
    }
}

/// A driver with a thread of its own, for one device or for all devices of a bus.
pub trait DeviceDriver: Any + fmt::Debug + Send {
    /// Its thread.
    fn thread(&self) -> &DriverThread;

    /// Its thread, and nothing of it remains.
    fn into_thread(self: Box<Self>) -> DriverThread;

    /// What people want to know of it when one of its devices changes its status: name and value.
    fn figures(&self) -> Vec<(&'static str, String)>;

    /// The next thing that happened on its wire and that people want to know, oldest first; `None` if they know all.
    fn news(&self) -> Option<Notice> {
        None
    }

    /// Whether a device of it is given no command after a fault until this driver starts again.
    fn is_held_after_faults(&self, device: &str) -> bool {
        let _ = device;
        false
    }

    /// When its thread stood still; `None` if nothing measures that.
    fn stalls(&self) -> Option<&StallReader> {
        None
    }

    /// Name of its device, or of its bus.
    fn name(&self) -> &str {
        &self.thread().name
    }

    /// Whether it drives the device of that name.
    fn drives(&self, device: &str) -> bool {
        self.name() == device
    }

    /// How the host granted what its thread asked for.
    fn grants(&self) -> &[Grant] {
        self.thread().thread.grants()
    }

    /// Tells its thread to bring its devices to rest and to end, without waiting for that.
    fn ask_to_stop(&self) {
        self.thread().stop.store(true, Ordering::Relaxed);
    }

    /// Ends its thread, waits for that, and gives back where it told the clock of its device; nothing
    /// if the thread had ended by a panic.
    fn stop(self: Box<Self>) -> Option<LatestWriter<Estimate>> {
        self.into_thread().stop()
    }
}

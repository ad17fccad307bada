//! Interface between the controller and running drivers. Drivers exchange values with nets by `DeviceState` and
//! `DeviceCommand`; each driver module has its own start function.

use std::any::Any;
use std::fmt;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use takt_motion::dynamics::Body;
use takt_rt::Grant;
use takt_rt::latest::{LatestReader, LatestWriter};
use takt_rt::servo::Estimate;
use takt_rt::stats::StallReader;
use takt_rt::thread::{Thread, ThreadConfig};

use crate::device::bus::BusAccess;
use crate::device::sim::Made;
use crate::device::{DeviceCommand, DeviceDescription, DeviceState};
use crate::error::Error;

/// Shutdown time limit of a driver: its devices brake as when set-points end, then lose power. Power is not cut while
/// they move.
pub const SHUTDOWN_MAX: Duration = Duration::from_secs(4);

/// Endpoints of a driver for one device.
#[derive(Debug)]
pub struct DeviceEnd {
    /// Publishes the state of the device.
    pub state: LatestWriter<DeviceState>,
    /// Receives the commands for the device.
    pub command: LatestReader<DeviceCommand>,
    /// Time between two commands.
    pub net_period: Duration,
}

/// Endpoints of a driver, given to it at start.
#[derive(Debug)]
pub struct DriverEnds {
    /// One per device, in their order.
    pub devices: Vec<DeviceEnd>,
    /// Publishes the clock of its device or bus, which net threads can follow.
    pub clock: LatestWriter<Estimate>,
}

impl DriverEnds {
    /// The endpoint of the only device, and that of the clock.
    ///
    /// # Errors
    /// If the number of devices is not one.
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

/// Severity of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Something appeared, recovered, or is as expected.
    Info,
    /// Something is not as expected, but the device may work.
    Warning,
    /// The device cannot do its work.
    Error,
}

impl Severity {
    /// All severities, in ascending order.
    pub const ALL: [Self; 3] = [Self::Info, Self::Warning, Self::Error];

    /// Its name in reports and metrics.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

/// Separates the cause from the remedy in the text of an event.
const HINT: &str = "\nhint: ";

/// An event of a driver, reported once per onset: the controller logs it, counts it by severity, and shows it with the
/// device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DriverEvent {
    /// Severity.
    pub severity: Severity,
    /// The cause, and the remedy if there is one.
    pub text: String,
}

impl DriverEvent {
    /// An event of that severity.
    #[must_use]
    pub const fn new(severity: Severity, text: String) -> Self {
        Self { severity, text }
    }

    /// This event with a remedy, on its own line.
    #[must_use]
    pub fn with_hint(mut self, hint: &str) -> Self {
        self.text.push_str(HINT);
        self.text.push_str(hint);
        self
    }

    /// The cause, without the remedy.
    #[must_use]
    pub fn cause(&self) -> &str {
        self.text
            .split_once(HINT)
            .map_or(self.text.as_str(), |(cause, _)| cause)
    }

    /// The remedy; `None` if there is none.
    #[must_use]
    pub fn hint(&self) -> Option<&str> {
        self.text.split_once(HINT).map(|(_, hint)| hint)
    }

    /// An informational event.
    #[must_use]
    pub const fn info(text: String) -> Self {
        Self {
            severity: Severity::Info,
            text,
        }
    }

    /// A warning.
    #[must_use]
    pub const fn warning(text: String) -> Self {
        Self {
            severity: Severity::Warning,
            text,
        }
    }

    /// An error.
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
    /// Starts it. `body` returns within [`SHUTDOWN_MAX`] after its flag is set, and returns the clock endpoint.
    /// `priority` is that of `SCHED_FIFO`; empty `cpus` allow any.
    ///
    /// # Errors
    /// If the thread cannot be created.
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
            // The clock is no longer measured.
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
            tracing::error!(driver = self.name, "driver thread panicked");
        }
        clock
    }
}

/// A driver without figures and events of its own.
impl DeviceDriver for DriverThread {
    fn thread(&self) -> &DriverThread {
        self
    }

    fn into_thread(self: Box<Self>) -> DriverThread {
        *self
    }
}

/// Configuration of a driver, as a table of a cell file gives it; starts the driver.
pub trait DriverConfig: Compare + fmt::Debug + Send + Sync {
    /// Name of its device, or of its bus.
    fn name(&self) -> &str;

    /// Period of the net thread that commands its devices; `None` for the first.
    fn thread(&self) -> Option<Duration> {
        None
    }

    /// `SCHED_FIFO` priority of its thread, 1 to 98; `None` for an ordinary thread.
    fn priority(&self) -> Option<u8>;

    /// Adds what an arm of its devices carries: a tool, in the frame of the flange. Called before [`Self::check`]; drivers that compute
    /// no torques ignore it.
    fn carry(&mut self, _device: &str, _tool: &Body) {}

    /// Checks what is not a matter of one value.
    ///
    /// # Errors
    /// With a text that names the finding.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }

    /// What is known of its devices before contact.
    fn devices(&self) -> Vec<DeviceDescription>;

    /// The simulated device that a net thread steps instead of a driver; `None` if it has a driver.
    ///
    /// # Errors
    /// If its parameters make no device.
    fn simulated(&self) -> Result<Option<Made>, Error> {
        Ok(None)
    }

    /// Opens its link and starts the driver. The endpoints are those of its devices, in their order.
    ///
    /// # Errors
    /// If the link cannot be opened or the thread cannot be created.
    fn start(&self, ends: DriverEnds) -> Result<Box<dyn DeviceDriver>, Error>;
}

/// Comparison of values whose type is not known; every type with `==` has it.
pub trait Compare: Any {
    /// Whether both are of the same type and equal.
    fn equals(&self, other: &dyn Any) -> bool;
}

impl<T: PartialEq + Any> Compare for T {
    fn equals(&self, other: &dyn Any) -> bool {
        other.downcast_ref() == Some(self)
    }
}

impl PartialEq for dyn DriverConfig {
    fn eq(&self, other: &Self) -> bool {
        self.equals(other as &dyn Any)
    }
}

/// How busy a bus is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BusLoad {
    /// Its network interface, or the driver's name if it has none.
    pub bus: String,
    /// Bit rate, bit/s; `None` if it is not known, as of a virtual interface.
    pub bit_rate: Option<u32>,
    /// Bits of frames within the last second, bit/s.
    pub bits_per_s: u32,
    /// Bits of frames within the fullest second since the driver started, bit/s.
    pub bits_per_s_max: u32,
}

impl BusLoad {
    /// Part of the last second in which frames were on the bus, 0 to 1; `None` without a bit rate.
    #[must_use]
    pub fn load(&self) -> Option<f64> {
        self.part(self.bits_per_s)
    }

    /// The same of the fullest second.
    #[must_use]
    pub fn load_max(&self) -> Option<f64> {
        self.part(self.bits_per_s_max)
    }

    fn part(&self, bits: u32) -> Option<f64> {
        let rate = self.bit_rate.filter(|rate| *rate > 0)?;
        // Bits are counted when their frames are read, so a second can seem slightly overfull.
        Some((f64::from(bits) / f64::from(rate)).min(1.0))
    }
}

/// A driver with a thread of its own, for one device or for all devices of a bus.
pub trait DeviceDriver: Any + fmt::Debug + Send {
    /// Its thread.
    fn thread(&self) -> &DriverThread;

    /// Consumes the driver and returns its thread.
    fn into_thread(self: Box<Self>) -> DriverThread;

    /// Figures for the log when one of its devices changes its status: name and value.
    fn figures(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }

    /// The loads of its buses; empty if they are not measured, or not yet.
    fn bus_loads(&self) -> Vec<BusLoad> {
        Vec::new()
    }

    /// The oldest event on its wire that was not read yet; `None` if all were read.
    fn poll_event(&self) -> Option<DriverEvent> {
        None
    }

    /// Access to its bus for diagnosis; `None` if it offers none.
    fn bus(&self) -> Option<Arc<dyn BusAccess>> {
        None
    }

    /// Whether this device gets no commands after a fault until the driver restarts.
    fn is_held_after_faults(&self, device: &str) -> bool {
        let _ = device;
        false
    }

    /// Stalls of its thread; `None` if they are not measured.
    fn stalls(&self) -> Option<&StallReader> {
        None
    }

    /// Name of its device, or of its bus.
    fn name(&self) -> &str {
        &self.thread().name
    }

    /// The local UDP address at which it waits for its robot, if it does.
    fn waits_at(&self) -> Option<SocketAddr> {
        None
    }

    /// Whether it drives the device of that name.
    fn drives(&self, device: &str) -> bool {
        self.name() == device
    }

    /// The real-time settings that the host granted or refused to its thread.
    fn grants(&self) -> &[Grant] {
        self.thread().thread.grants()
    }

    /// Requests its thread to stop its devices and end; does not wait.
    fn ask_to_stop(&self) {
        self.thread().stop.store(true, Ordering::Relaxed);
    }

    /// Ends its thread, waits for that, and returns the clock endpoint; `None` if the thread panicked.
    fn stop(self: Box<Self>) -> Option<LatestWriter<Estimate>> {
        self.into_thread().stop()
    }
}

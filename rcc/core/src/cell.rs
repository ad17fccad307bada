//! `cell.toml`: the configuration of a controller. It starts nothing.
//!
//! ```toml
//! [controller]
//! period = "1ms"           # time from one cycle of nets to the next
//! priority = 80            # SCHED_FIFO, 1 to 98; leave out for an ordinary thread
//! cpus = [1]               # processors of the net thread; leave out for any
//! websocket = "127.0.0.1:8080"
//! tcp = "127.0.0.1:8081"
//! stop = "127.0.0.1:8082"  # the port of the stop channel; two above that of websocket if left out
//! stop_socket = "/run/takt/stop-left.sock" # its Unix socket; one that `takt stop` finds if left out
//! socket = "/run/takt/takt.sock" # Unix socket of the tools; "" for none
//! socket_group = "takt"    # accounts admitted there beside the controller's own and root
//! token_file = "/etc/takt/token" # clients must give what is in it; needed beyond loopback
//! loopback = "open"        # clients of this host need no token; "token": they do
//! hosts = ["robot"]        # names of this host that pages may be opened by without a token
//! origins = ["http://localhost:3000"] # pages of other servers that may reach this one
//! follow = "left"          # net threads keep phase with this device's clock; leave out for the host's
//! phase = "300us"          # cycles begin so long after the device's own; leave out for at once
//! need_estop = false       # true: devices stop unless a net with an EStop primitive runs
//! on_loss = "end"          # nets of a lost client are cancelled, then aborted; "keep": they run on
//! rejected_ends_after = "5s" # a net whose set-points are rejected for so long ends; "0s": it runs on
//! log = "info"             # or debug, warn, error; also by part: "warn,takt_core=debug"
//! costs = "costs.toml"     # what primitives cost here, by `takt net calibrate`; beside this file
//! flight_recorder = "/var/lib/takt/flights" # the last 10 s before each fault; in the state directory if left out, "" for none
//! flight_recorder_mib = 512 # of all its files together; the oldest are deleted first
//!
//! [[controller.thread]]    # one more net thread, for nets of its period
//! period = "4ms"
//! priority = 79
//! cpus = [1]
//! phase = "500us"          # leave out for that of the controller
//!
//! [live]                   # data for other tools; leave out for none
//! foxglove = "127.0.0.1:8765" # for Foxglove, Lichtblick and PlotJuggler
//! services = false         # true: they may start, cancel and abort nets and stop the controller
//! origins = ["https://app.foxglove.dev"] # web pages that may connect; "file://" for desktop programs
//! every = 1                # only each n-th cycle is sent
//!
//! [fleet]                  # other controllers on the network; leave out for none. Its keys are those of docs/fleet.md
//! cell = "weld3"
//!
//! [[device]]
//! name = "left"
//! type = "kuka_lwr_fri"
//! listen = "0.0.0.0:49938" # where the KRC sends its datagrams
//! priority = 85
//! thread = "4ms"           # the net thread that commands it; leave out for the first
//!
//! [[base]]                 # where a device is
//! device = "left"
//! position = [0, 0.5, 0.8] # m, in the frame `world`
//! ```

mod access;
mod drivers;
mod frames;
mod live;
mod location;
mod models;
mod objects;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;
use toml::de::DeTable;

use crate::device::driver::DriverConfig;
pub use crate::device::on_end::{OnEnd, OutputsOnEnd};
use crate::error::Error;
use crate::ids::check_device_name;
use crate::{files, span};
pub use access::{Loopback, OnLoss};
pub use drivers::{DriverKind, Section};
pub use frames::{
    BaseConfig, CellFrames, FRAMES_MAX, FrameConfig, HomeConfig, Placement, ToolConfig, WORLD,
};
pub use live::LiveSettings;
pub use location::located;
pub use objects::{ObjectConfig, ObjectShape};

/// Net threads that a controller may have.
pub const THREADS_MAX: usize = 8;
/// Shortest period of a net thread.
pub const PERIOD_MIN: Duration = Duration::from_micros(100);
/// Longest period of a net thread.
pub const PERIOD_MAX: Duration = Duration::from_millis(100);

/// A controller and its drivers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellConfig {
    /// The controller itself.
    pub controller: ControllerConfig,
    /// What is sent to other tools while it runs.
    pub live: LiveSettings,
    /// The table `[fleet]` as it is written; programs that join a fleet read and check it, others leave it alone.
    pub fleet: Option<toml::Table>,
    /// Its devices with drivers of their own.
    pub devices: Vec<Arc<dyn DriverConfig>>,
    /// Its buses, each with devices of its own.
    pub buses: Vec<Arc<dyn DriverConfig>>,
    /// Its named frames, bases, tools, home positions and objects.
    pub frames: CellFrames,
}

/// What of a cell file is not read by drivers.
#[derive(Deserialize)]
struct Rest {
    #[serde(default)]
    controller: ControllerConfig,
    #[serde(default)]
    live: LiveSettings,
    fleet: Option<toml::Table>,
    #[serde(default)]
    frame: Vec<FrameConfig>,
    #[serde(default)]
    base: Vec<BaseConfig>,
    #[serde(default)]
    tool: Vec<ToolConfig>,
    #[serde(default)]
    home: Vec<HomeConfig>,
    #[serde(default)]
    object: Vec<ObjectConfig>,
}

/// Settings of the controller itself.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControllerConfig {
    /// Time from one cycle to the next, 100 us to 100 ms.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub period: Duration,
    /// `SCHED_FIFO` priority of the net thread, 1 to 98; `None` for an ordinary thread.
    pub priority: Option<u8>,
    /// Processors of the net thread; empty for any.
    pub cpus: Vec<usize>,
    /// Where DirectIO over WebSocket listens.
    pub websocket: Option<SocketAddr>,
    /// Where DirectIO over plain TCP listens.
    pub tcp: Option<SocketAddr>,
    /// Where the stop channel takes TCP connections; `None` for two ports above that of `websocket`.
    pub stop: Option<SocketAddr>,
    /// Its Unix socket; `None` for one that `takt stop` finds.
    pub stop_socket: Option<PathBuf>,
    /// Unix socket for tools of this host, empty for none; `None` for `takt/takt.sock` in the runtime
    /// directory.
    pub socket: Option<PathBuf>,
    /// Group whose accounts are admitted at the Unix socket, beside the controller's own account and root.
    pub socket_group: Option<String>,
    /// File with the token that clients must give; needed beyond loopback.
    pub token_file: Option<PathBuf>,
    /// Requirement for clients on loopback; `None`: the token if `token_file` is set, else nothing.
    pub loopback: Option<Loopback>,
    /// Names of this host, with or without a port, that requests without a token may be addressed to, beside
    /// `localhost` and addresses of loopback.
    pub hosts: Vec<String>,
    /// Origins of web pages of other servers that may send requests, such as `http://localhost:3000`.
    pub origins: Vec<String>,
    /// Device whose clock the net threads follow; `None` for the host's own clock.
    pub follow: Option<String>,
    /// Phase of a cycle relative to that clock, less than its period; `None` for 0.
    /// For an LWR these instants are those of its measurements.
    #[serde(deserialize_with = "span::text::deserialize_some")]
    pub phase: Option<Duration>,
    /// Whether all devices stop while no `EStop` primitive was evaluated for 20 ms.
    pub need_estop: bool,
    /// How long the set-points of a net may be rejected without a pause before it is ended; zero for ever.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub rejected_ends_after: Duration,
    /// What happens to the nets of a session whose client is lost, unless the session sets it. `None`:
    /// they end, except for clients whose WebSocket handshake has no version, which rely on keeping them.
    pub on_loss: Option<OnLoss>,
    /// Net threads beside the first, each with a period of its own.
    #[serde(rename = "thread")]
    pub threads: Vec<NetThreadSettings>,
    /// Log filter, such as `info` or `warn,takt_core=debug`; `None` for `info`.
    pub log: Option<String>,
    /// Cost table of this host, relative to the directory of the cell file; `None`
    /// for declared costs.
    pub costs: Option<PathBuf>,
    /// Memory quota of all nets together, MiB, 1 to 65536; their texts may take another sixteenth.
    pub nets_memory_mib: u32,
    /// Directory of flight files, relative to the directory of the cell file, empty for none; `None` for `flights` in the state
    /// directory.
    pub flight_recorder: Option<PathBuf>,
    /// Maximum size of all flight files together, MiB, 16 to 1048576; the oldest are deleted first.
    pub flight_recorder_mib: u32,
}

/// Default distance of the stop channel's port above that of HTTP.
const STOP_PORTS_ABOVE: u16 = 2;

impl ControllerConfig {
    /// Where the stop channel takes TCP connections; `None` if neither it nor HTTP is configured.
    #[must_use]
    pub fn stop_address(&self) -> Option<SocketAddr> {
        if self.stop.is_some() {
            return self.stop;
        }
        let mut address = self.websocket?;
        if address.port() != 0 {
            let taken = self.tcp.map(|tcp| tcp.port());
            let ports = (STOP_PORTS_ABOVE..).map_while(|above| address.port().checked_add(above));
            address.set_port(ports.into_iter().find(|port| Some(*port) != taken)?);
        }
        Some(address)
    }
}

impl Default for ControllerConfig {
    fn default() -> Self {
        Self {
            period: Duration::from_millis(1),
            priority: Some(80),
            cpus: Vec::new(),
            websocket: Some(SocketAddr::from(([127, 0, 0, 1], 8080))),
            tcp: Some(SocketAddr::from(([127, 0, 0, 1], 8081))),
            stop: None,
            stop_socket: None,
            socket: None,
            socket_group: None,
            token_file: None,
            loopback: None,
            hosts: Vec::new(),
            origins: Vec::new(),
            follow: None,
            phase: None,
            need_estop: false,
            rejected_ends_after: Duration::from_secs(5),
            on_loss: None,
            threads: Vec::new(),
            log: None,
            costs: None,
            nets_memory_mib: 1024,
            flight_recorder: None,
            flight_recorder_mib: 512,
        }
    }
}

/// A net thread beside the first.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetThreadSettings {
    /// Time from one cycle to the next, 100 us to 100 ms; no two threads have the same.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub period: Duration,
    /// `SCHED_FIFO` priority, 1 to 98; `None` for an ordinary thread.
    #[serde(default = "NetThreadSettings::default_priority")]
    pub priority: Option<u8>,
    /// Processors of the thread; empty for any.
    #[serde(default)]
    pub cpus: Vec<usize>,
    /// Its phase to the clock that is followed, less than its period; `None` for the controller's.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub phase: Option<Duration>,
}

impl NetThreadSettings {
    /// A thread of that period with default settings.
    #[must_use]
    pub const fn new(period: Duration) -> Self {
        Self {
            period,
            priority: Self::default_priority(),
            cpus: Vec::new(),
            phase: None,
        }
    }

    #[expect(
        clippy::unnecessary_wraps,
        reason = "the type of the field it is the default of"
    )]
    const fn default_priority() -> Option<u8> {
        Some(79)
    }
}

impl CellConfig {
    /// Reads a file for a program with these drivers.
    ///
    /// # Errors
    /// If it cannot be read, is not TOML, has unknown names, or a value is out of range.
    pub fn read(path: &Path, kinds: &[DriverKind]) -> Result<Self, Error> {
        let text = files::read_text(path, files::TEXT_BYTES_MAX).map_err(|source| Error::File {
            path: path.to_owned(),
            source,
        })?;
        let folder = path.parent().unwrap_or_else(|| Path::new(""));
        let mut cell = Self::of_text(&text, kinds, folder).map_err(|why| Error::Config {
            path: path.to_owned(),
            why,
        })?;
        let paths = [
            &mut cell.controller.costs,
            &mut cell.controller.flight_recorder,
        ];
        for relative in paths.into_iter().flatten() {
            // An empty one means none.
            if !relative.as_os_str().is_empty() {
                *relative = folder.join(&*relative);
            }
        }
        Ok(cell)
    }

    /// Parses the text of such a file; the files that it names are relative to the working directory.
    ///
    /// # Errors
    /// If it is not TOML, has unknown names, or a value is out of range.
    pub fn parse(text: &str, kinds: &[DriverKind]) -> Result<Self, Error> {
        Self::of_text(text, kinds, Path::new("")).map_err(Error::Cell)
    }

    fn of_text(text: &str, kinds: &[DriverKind], folder: &Path) -> Result<Self, String> {
        let config = Self::deserialize(text, kinds, folder).map_err(|mut error| {
            error.set_input(Some(text));
            error.to_string()
        })?;
        config.check().map_err(|why| located(text, why))?;
        Ok(config)
    }

    fn deserialize(
        text: &str,
        kinds: &[DriverKind],
        folder: &Path,
    ) -> Result<Self, toml::de::Error> {
        let mut table = DeTable::parse(text)?;
        models::resolve(table.get_mut(), folder)?;
        let drivers::Configured {
            mut devices,
            mut buses,
        } = drivers::take(table.get_mut(), kinds)?;
        let rest = Rest::deserialize(toml::Deserializer::from(table))?;
        for driver in devices.iter_mut().chain(&mut buses) {
            let tools = rest.tool.iter().filter(|tool| tool.mass > 0.0);
            for tool in tools {
                // It is not shared yet.
                if let Some(driver) = Arc::get_mut(driver) {
                    driver.carry(&tool.device, &tool.body());
                }
            }
        }
        Ok(Self {
            controller: rest.controller,
            live: rest.live,
            fleet: rest.fleet,
            devices,
            buses,
            frames: CellFrames {
                frames: rest.frame,
                bases: rest.base,
                tools: rest.tool,
                homes: rest.home,
                objects: rest.object,
            },
        })
    }

    /// All drivers, in the order in which they start.
    pub fn drivers(&self) -> impl Iterator<Item = &Arc<dyn DriverConfig>> {
        self.devices.iter().chain(&self.buses)
    }

    /// The configurations of one kind of driver.
    pub fn of_kind<C: DriverConfig>(&self) -> impl Iterator<Item = &C> {
        let drivers = self.drivers().map(|config| &**config as &dyn std::any::Any);
        drivers.filter_map(|config| config.downcast_ref())
    }

    /// Periods of the net threads, the first one first.
    pub(crate) fn periods(&self) -> impl Iterator<Item = Duration> {
        let others = self.controller.threads.iter().map(|thread| thread.period);
        [self.controller.period].into_iter().chain(others)
    }

    /// Phases of the net threads to the clock that is followed, the first one first.
    pub(crate) fn phases(&self) -> impl Iterator<Item = Duration> {
        let first = self.controller.phase.unwrap_or_default();
        let others = self.controller.threads.iter();
        let others = others.map(move |thread| thread.phase.unwrap_or(first));
        [first].into_iter().chain(others)
    }

    /// Checks that the followed clock exists and that phases are below the periods.
    fn check_clock(&self) -> Result<(), String> {
        let threads = &self.controller.threads;
        let Some(device) = &self.controller.follow else {
            let phases = threads.iter().map(|thread| thread.phase);
            return match phases.chain([self.controller.phase]).flatten().next() {
                Some(phase) => Err(format!(
                    "phase is {phase:?}, but nothing is followed; name the device whose clock it \
                     refers to: controller.follow"
                )),
                None => Ok(()),
            };
        };
        if !self.clocks().any(|name| name == device) {
            return Err(format!(
                "controller.follow is `{device}`, but the cell has no device of that name"
            ));
        }
        let mut threads = self.periods().zip(self.phases());
        match threads.find(|(period, phase)| phase >= period) {
            Some((period, phase)) => Err(format!(
                "phase is {phase:?}; it must be less than the net thread's period of {period:?}"
            )),
            None => Ok(()),
        }
    }

    /// Names of devices and buses whose clock can be followed: simulated ones have none.
    fn clocks(&self) -> impl Iterator<Item = &str> {
        let drivers = self.drivers();
        let drivers = drivers.filter(|config| matches!(config.simulated(), Ok(None)));
        drivers.map(|config| config.name())
    }

    fn check_threads(&self) -> Result<(), String> {
        let periods: Vec<_> = self.periods().collect();
        if periods.len() > THREADS_MAX {
            let (found, bound) = (periods.len(), THREADS_MAX);
            return Err(format!("{found} net threads; at most {bound} are possible"));
        }
        let memory = self.controller.nets_memory_mib;
        if !(1..=65536).contains(&memory) {
            return Err(format!(
                "controller.nets_memory_mib is {memory}; it must be 1 to 65536"
            ));
        }
        let flights = self.controller.flight_recorder_mib;
        if !(16..=1 << 20).contains(&flights) {
            return Err(format!(
                "controller.flight_recorder_mib is {flights}; it must be 16 to 1048576"
            ));
        }
        for (i, period) in periods.iter().enumerate() {
            let key = if i == 0 {
                "controller.period"
            } else {
                "controller.thread: period"
            };
            if !(PERIOD_MIN..=PERIOD_MAX).contains(period) {
                return Err(format!("{key} is {period:?}; it must be 100us to 100ms"));
            }
            if periods[..i].contains(period) {
                return Err(format!(
                    "{key} {period:?} is given twice; nets of one period share a thread"
                ));
            }
        }
        for config in self.drivers() {
            let (name, thread) = (config.name(), config.thread());
            if let Some(thread) = thread.filter(|thread| !periods.contains(thread)) {
                let periods = listed(&periods);
                return Err(format!(
                    "{name}: thread = {thread:?}, but the net threads are those of {periods}"
                ));
            }
        }
        Ok(())
    }

    /// Checks the configuration; returns the first fault.
    pub(crate) fn check(&self) -> Result<(), String> {
        access::check(&self.controller)?;
        self.live.check()?;
        self.check_threads()?;
        self.check_clock()?;
        self.drivers().try_for_each(|config| config.check())?;
        let drivers = self.drivers();
        let drivers = drivers.map(|config| (config.name(), config.priority()));
        let threads = self.controller.threads.iter();
        let threads = threads.map(|thread| ("controller.thread", thread.priority));
        let first = ("controller", self.controller.priority);
        for (name, priority) in drivers.chain(threads).chain([first]) {
            if priority.is_some_and(|p| !(1..=98).contains(&p)) {
                return Err(format!("{name}: priority must be 1 to 98, or be left out"));
            }
        }
        let of_buses = self.buses.iter().flat_map(|bus| bus.devices());
        let of_buses = of_buses.map(|device| device.name);
        let drivers = self.drivers().map(|config| config.name().to_owned());
        let mut names: Vec<_> = drivers.chain(of_buses).collect();
        names.sort_unstable();
        names.iter().try_for_each(|name| check_device_name(name))?;
        match names.windows(2).find(|w| w[0] == w[1]) {
            Some(twice) => Err(format!("device name `{}` is given twice", twice[0])),
            None => self.frames.check(&names),
        }
    }
}

/// Periods as people list them.
pub(crate) fn listed(periods: &[Duration]) -> String {
    let texts: Vec<_> = periods.iter().map(|p| format!("{p:?}")).collect();
    match texts.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} and {last}", rest.join(", ")),
        _ => texts.concat(),
    }
}

#[cfg(test)]
mod tests;

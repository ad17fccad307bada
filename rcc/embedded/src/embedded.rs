//! A controller with its server inside of a program, with or without emulated robots. Only this program can reach it.

use std::fmt::Write as _;
use std::io::Read as _;
use std::net::SocketAddr;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use takt_client::Token;
use takt_core::device::driver::DeviceDriver as _;
use takt_core::{CellConfig, Controller};
use takt_devices::ethercat::Ethercat;
use takt_rt::simulated::{FACTORS, begin, waited};
use takt_server::{Loopback, Server, ServerConfig, ServerThreads};

use crate::cell::{ANY_PORT, EmulatedCell};
use crate::error::Error;
use crate::machines::Machines;

/// How long emulated devices get to become operational; a youBot searches its stops first.
const READY_WITHIN: Duration = Duration::from_mins(1);
/// How often that is polled.
const POLL_EVERY: Duration = Duration::from_millis(5);
/// How long running nets get to end, and robots to rest, at shutdown.
const REST_WITHIN: Duration = Duration::from_secs(5);
/// Random bytes of a token.
const TOKEN_BYTES: usize = 32;

/// A running controller with its server. Dropping it ends all nets, waits until its robots are at rest, at most five
/// seconds, and stops all of its threads.
#[derive(Debug)]
pub struct Embedded {
    /// `None` once it was stopped.
    parts: Option<Parts>,
    token: Option<Token>,
    address: SocketAddr,
}

#[derive(Debug)]
struct Parts {
    server: ServerThreads,
    controller: Controller,
    machines: Machines,
}

/// Whether this program has started the controller of a cell file: then its time is that of its devices.
static HAS_CELL_FILE: Mutex<bool> = Mutex::new(false);

/// Lets emulated cells of this program run in simulated time from now on and to its end: the time waits for threads that the
/// host runs late, so robots and controller miss no cycle on a host that is busy or stalls. For tests and demonstrations; not
/// beside real robots. Where the host keeps up, the time runs `real_time_factor` times as fast as the host's, 0.1 to 10; above
/// 1, the program is that much later for its robots. Further calls change nothing.
///
/// # Errors
/// [`Error::RealTimeFactor`] if the factor is out of its range, [`Error::RealDevices`] if this program has started a cell file.
pub fn simulate_time(real_time_factor: f64) -> Result<(), Error> {
    let [least, most] = FACTORS;
    if !(least..=most).contains(&real_time_factor) {
        return Err(Error::RealTimeFactor {
            factor: real_time_factor,
        });
    }
    let has_cell_file = HAS_CELL_FILE.lock().unwrap_or_else(PoisonError::into_inner);
    if *has_cell_file {
        return Err(Error::RealDevices);
    }
    begin(real_time_factor);
    Ok(())
}

impl Embedded {
    /// Starts an emulated cell; see [`NAMES`](crate::NAMES). Returns when all of its devices are operational.
    ///
    /// # Errors
    /// If there is no cell of that name, the system refuses threads or sockets, or a device does not become operational
    /// within a minute.
    pub fn emulated(name: &str) -> Result<Self, Error> {
        Self::emulate(EmulatedCell::named(name)?)
    }

    /// The same for a cell that the program may have changed, such as its world.
    ///
    /// # Errors
    /// As [`Self::emulated`].
    pub fn emulate(cell: EmulatedCell) -> Result<Self, Error> {
        let controller = Controller::start(&cell.config)?;
        let machines = Machines::start(&controller, cell, 0.0)?;
        let embedded = Self::serve(controller, machines, None)?;
        embedded.wait_until_ready()?;
        Ok(embedded)
    }

    /// Starts the controller of a cell. Devices that are not there are offline, as with `takt run`. It listens in a free
    /// port of loopback, for clients that know its token; addresses, tokens and sockets of the cell are not used.
    ///
    /// # Errors
    /// If the cell is invalid, or a device, thread or socket cannot be opened; [`Error::RealDevices`] in simulated time.
    pub fn start(cell: &CellConfig) -> Result<Self, Error> {
        let mut has_cell_file = HAS_CELL_FILE.lock().unwrap_or_else(PoisonError::into_inner);
        if waited().is_some() {
            return Err(Error::RealDevices);
        }
        *has_cell_file = true;
        drop(has_cell_file);
        let token = random_token()?;
        Self::serve(Controller::start(cell)?, Machines::default(), Some(token))
    }

    fn serve(
        controller: Controller,
        machines: Machines,
        token: Option<Token>,
    ) -> Result<Self, Error> {
        let config = ServerConfig {
            tcp: Some(ANY_PORT),
            loopback: token.is_some().then_some(Loopback::Token),
            token: token.clone(),
            ..ServerConfig::default()
        };
        let server = ServerThreads::start(Server::bind(config), &controller)?;
        let address = server.tcp_address().unwrap_or(ANY_PORT);
        let parts = Parts {
            server,
            controller,
            machines,
        };
        Ok(Self {
            parts: Some(parts),
            token,
            address,
        })
    }

    /// Where its server listens.
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// What clients give, if it requires a token.
    pub const fn token(&self) -> Option<&Token> {
        self.token.as_ref()
    }

    /// The controller; `None` once it was stopped.
    pub fn controller(&self) -> Option<&Controller> {
        self.parts.as_ref().map(|parts| &parts.controller)
    }

    /// The emulated machines; `None` once it was stopped.
    pub fn machines(&self) -> Option<&Machines> {
        self.parts.as_ref().map(|parts| &parts.machines)
    }

    fn wait_until_ready(&self) -> Result<(), Error> {
        let Some(Parts {
            controller,
            machines,
            ..
        }) = &self.parts
        else {
            return Ok(());
        };
        let until = Instant::now() + READY_WITHIN;
        loop {
            let devices = controller.devices();
            let mut late = devices
                .into_iter()
                .filter(|device| !machines.is_ready(&device.name, device.status));
            let Some(device) = late.next() else {
                return Ok(());
            };
            if Instant::now() > until {
                let waits = |segment: &Ethercat| {
                    segment.waits_for().filter(|_| segment.drives(&device.name))
                };
                let why = controller.with_drivers(waits).into_iter().flatten().next();
                return Err(Error::NotReady {
                    why: why.unwrap_or_else(|| "its answers are late or lost".to_owned()),
                    device: device.name,
                    status: device.status.to_string(),
                    after: READY_WITHIN,
                });
            }
            std::thread::sleep(POLL_EVERY);
        }
    }

    /// Ends all nets, waits until its robots are at rest, and stops its threads, as dropping it does.
    ///
    /// # Errors
    /// If an emulated machine had failed.
    pub fn stop(mut self) -> Result<(), Error> {
        self.stop_parts()
    }

    fn stop_parts(&mut self) -> Result<(), Error> {
        let Some(parts) = self.parts.take() else {
            return Ok(());
        };
        let Parts {
            server,
            controller,
            machines,
        } = parts;
        controller.close();
        let within = REST_WITHIN.max(controller.machines_end_within() + POLL_EVERY);
        let until = Instant::now() + within;
        while !(controller.wind_down(&controller.nets()) && controller.is_at_rest()) {
            if Instant::now() > until {
                break;
            }
            std::thread::sleep(POLL_EVERY);
        }
        if !server.stop() {
            tracing::error!("the server had ended by a fault of its own");
        }
        // Before its robots, so that their end is no fault.
        drop(controller);
        machines.stop()
    }
}

impl Drop for Embedded {
    fn drop(&mut self) {
        if let Err(error) = self.stop_parts() {
            tracing::error!("{error}");
        }
    }
}

/// A token that only this program knows.
fn random_token() -> Result<Token, Error> {
    let mut bytes = [0; TOKEN_BYTES];
    let mut file =
        std::fs::File::open("/dev/urandom").map_err(|error| Error::Token(error.to_string()))?;
    file.read_exact(&mut bytes)
        .map_err(|error| Error::Token(error.to_string()))?;
    let text = bytes.iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    });
    Token::new(&text).map_err(|error| Error::Token(error.to_string()))
}

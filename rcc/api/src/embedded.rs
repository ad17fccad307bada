//! Cells whose controller runs in this program: with emulated robots, for first programs and tests, or with the robots of
//! a cell file.

use std::net::SocketAddr;
use std::path::Path;

use takt_client::Client;
use takt_embedded::Embedded;

use crate::cell::Cell;
use crate::error::{Error, ErrorKind};
use crate::session::Session;

/// Lets the emulated cells of this program run in simulated time from now on and to its end: the time waits for threads that
/// the host runs late, so robots and controller miss no cycle on a host that is busy or stalls. For tests and demonstrations;
/// not beside real robots ([`Cell::embedded`]). Where the host keeps up, the time runs `real_time_factor` times as fast as the
/// host's, 0.1 to 10; above 1, the program is that much later for its robots. Further calls change nothing.
///
/// # Errors
/// [`ErrorKind::Invalid`] if the factor is out of its range, or this program has started the controller of a cell file.
#[track_caller]
pub fn simulate_time(real_time_factor: f64) -> Result<(), Error> {
    Ok(takt_embedded::simulate_time(real_time_factor).map_err(ErrorKind::from)?)
}

impl Cell {
    /// Starts a controller with emulated robots in this program and connects to it. It needs neither hardware nor root, and
    /// ends when the last [`Cell`], [`Arm`](crate::Arm) and [`Handle`](crate::Handle) is dropped. Any number of cells,
    /// in one program or in several, run at once.
    ///
    /// The cells are `two_lwr` (KUKA LWRs `left` and `right`), `iiwa` (`arm`), `factory` (`left` and `right`, Stäubli
    /// `tx90`, KUKA youBot `arm`, `hand` and `base`; it takes seconds to start, since the youBot searches its stops),
    /// `lwr_wsg` (`arm` with Schunk WSG `gripper`), `lwr_table` (`arm` above the table at the frame `table`, which
    /// vanishes while the digital output 0 of `arm` is true), `assembly` (LWRs `left` and `right`, grippers `left_hand` and
    /// `right_hand`, a screwdriver at the inputs and outputs of `right`, youBot `base`) and `lola` (`arm` of three servo axes without power).
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if there is no cell of that name; it lists those that exist. [`ErrorKind::Connection`] if the system
    /// refuses threads or sockets, or a robot is not operational after one minute.
    #[track_caller]
    pub fn emulated(name: &str) -> Result<Self, Error> {
        Ok(Self::around(
            Embedded::emulated(name).map_err(ErrorKind::from)?,
        )?)
    }

    /// Starts the controller of a cell file in this program and connects to it. It waits for no device.
    ///
    /// Only this program can command it: addresses and tokens under `[controller]` are not used, and there is no stop
    /// channel. A controller that people rely on is a service: `takt run`.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if the file cannot be read or is no valid cell, or in simulated time ([`simulate_time`]); [`ErrorKind::Connection`] if the system refuses threads,
    /// sockets or devices.
    #[track_caller]
    pub fn embedded(path: impl AsRef<Path>) -> Result<Self, Error> {
        let config = takt_devices::read_cell(path.as_ref());
        Self::embedded_config(&config.map_err(|error| ErrorKind::Invalid(chain(&error)))?)
    }

    /// The same for a configuration that the program made.
    ///
    /// # Errors
    /// As [`Self::embedded`].
    #[track_caller]
    pub fn embedded_config(config: &takt_embedded::CellConfig) -> Result<Self, Error> {
        Ok(Self::around(
            Embedded::start(config).map_err(ErrorKind::from)?,
        )?)
    }

    /// Where other programs and tools reach the controller in this program; `None` if it runs elsewhere.
    pub fn embedded_address(&self) -> Option<SocketAddr> {
        self.session().embedded().map(Embedded::address)
    }

    fn around(embedded: Embedded) -> Result<Self, ErrorKind> {
        let address = embedded.address().to_string();
        let client = Client::connect_with(&address, embedded.token())?;
        Ok(Self::of_session(Session::begin_embedded(client, embedded)?))
    }
}

/// An error with its causes.
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        let cause_text = cause.to_string();
        if !text.contains(&cause_text) {
            text = format!("{text}: {cause_text}");
        }
        source = cause.source();
    }
    text
}

impl From<takt_embedded::Error> for ErrorKind {
    fn from(error: takt_embedded::Error) -> Self {
        let is_of_the_caller = matches!(
            error,
            takt_embedded::Error::UnknownCell { .. }
                | takt_embedded::Error::RealTimeFactor { .. }
                | takt_embedded::Error::RealDevices
        );
        let text = chain(&error);
        if is_of_the_caller {
            Self::Invalid(text)
        } else {
            Self::Connection(text)
        }
    }
}

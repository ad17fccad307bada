//! The cells of a fleet: controllers that a program finds by their names, over zenoh, and commands as that of its own host.

use takt_fleet::command::LossPolicy;
use takt_fleet::config::{Observer, TlsFiles};
use takt_fleet::keys::CellName;
use takt_fleet::session::observer;
use takt_fleet::session::remote::RemoteError;
use takt_fleet::session::tunnel::{self, TunnelError};

use std::time::Duration;

use crate::cell::Cell;
use crate::error::{Error, ErrorKind};
use crate::program;

/// How long cells may take to say that they are alive.
const ALIVE_TIMEOUT: Duration = Duration::from_secs(2);

/// A connection to a fleet. Cells that were found through it stay connected when it is dropped.
#[derive(Debug)]
pub struct Fleet {
    fleet: observer::Fleet,
}

impl Fleet {
    /// Connects to cells or routers at endpoints such as `tcp/127.0.0.1:7447`.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if an endpoint is none, or is beyond loopback: it needs certificates. [`ErrorKind::Connection`] if none
    /// answers.
    #[track_caller]
    pub fn connect<'a>(endpoints: impl IntoIterator<Item = &'a str>) -> Result<Self, Error> {
        Self::with(endpoints, None)
    }

    /// The same with the certificates of mutual TLS, for endpoints such as `tls/line2.local:7447`.
    ///
    /// # Errors
    /// As [`Self::connect`].
    #[track_caller]
    pub fn connect_with<'a>(
        endpoints: impl IntoIterator<Item = &'a str>,
        tls: TlsFiles,
    ) -> Result<Self, Error> {
        Self::with(endpoints, Some(tls))
    }

    #[track_caller]
    fn with<'a>(
        endpoints: impl IntoIterator<Item = &'a str>,
        tls: Option<TlsFiles>,
    ) -> Result<Self, Error> {
        let connect = endpoints.into_iter().map(str::to_owned).collect();
        let fleet = observer::Fleet::connect(&Observer { connect, tls });
        let fleet = fleet.map_err(|why| {
            let text = why.to_string();
            if matches!(why, observer::FleetError::Observer(_)) {
                ErrorKind::Invalid(text)
            } else {
                ErrorKind::Connection(text)
            }
        })?;
        Ok(Self { fleet })
    }

    /// Names of the cells that are alive and can be reached.
    ///
    /// # Errors
    /// If the connection is lost.
    #[track_caller]
    pub fn cells(&self) -> Result<Vec<String>, Error> {
        Ok(self.alive()?)
    }

    /// Connects to a cell by its name. When the program, or the last link to the cell, is lost, the controller cancels what the program
    /// began, and aborts what does not end.
    ///
    /// Commands travel one after the other: one that another thread sends while a net is loaded waits for it.
    ///
    /// # Errors
    /// [`ErrorKind::NoDevice`] if no cell of that name is alive; it lists those that are. [`ErrorKind::Connection`] if the cell gives this
    /// program no right to command.
    #[track_caller]
    pub fn cell(&self, name: &str) -> Result<Cell, Error> {
        let cell = CellName::new(name).map_err(|why| ErrorKind::Invalid(why.to_string()))?;
        let client = tunnel::connect(&self.fleet, &cell, &program::name(), LossPolicy::Cancel);
        let client = client.or_else(|why| Err(self.explain(name, why)?));
        Ok(Cell::begin(client?)?)
    }

    fn alive(&self) -> Result<Vec<String>, ErrorKind> {
        let alive = self.fleet.alive(ALIVE_TIMEOUT);
        let alive = alive.map_err(|why| ErrorKind::Connection(why.to_string()))?;
        Ok(alive.into_iter().collect())
    }

    /// Why a cell cannot be commanded.
    fn explain(&self, name: &str, why: TunnelError) -> Result<ErrorKind, ErrorKind> {
        if matches!(why, TunnelError::Remote(RemoteError::NoAnswer { .. })) {
            let alive = self.alive()?;
            if !alive.iter().any(|cell| cell == name) {
                return Ok(ErrorKind::no_device("cell", name, alive));
            }
        }
        if let TunnelError::Client(why) = why {
            return Ok(why.into());
        }
        Ok(ErrorKind::Connection(why.to_string()))
    }
}

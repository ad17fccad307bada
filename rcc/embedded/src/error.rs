//! What can go wrong while a cell starts inside of a program.

use std::error::Error as StdError;
use std::time::Duration;

/// Why a cell did not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(clippy::error_impl_error, reason = "the one error type of the crate")]
pub enum Error {
    /// No emulated cell has this name.
    #[error("there is no emulated cell `{name}`\nhint: the emulated cells are {known}")]
    UnknownCell {
        /// The name.
        name: String,
        /// The names that exist.
        known: String,
    },
    /// Simulated time cannot run as fast or slow as that.
    #[error(
        "simulated time at {factor} times that of the host\nhint: 0.1 to 10 times is possible, and 1 is usual"
    )]
    RealTimeFactor {
        /// The factor.
        factor: f64,
    },
    /// A process has either emulated robots in simulated time, or the devices of a cell file.
    #[error(
        "a cell file and simulated time in one program: real devices do not wait for it\nhint: emulate in another program, or without simulated time"
    )]
    RealDevices,
    /// The controller did not start.
    #[error(transparent)]
    Controller(#[from] takt_core::Error),
    /// The server did not start.
    #[error(transparent)]
    Server(#[from] takt_server::Error),
    /// No token could be made.
    #[error("cannot make a token: {0}")]
    Token(String),
    /// An emulated device did not start, or failed.
    #[error("the emulated {name} failed: {source}")]
    Emulator {
        /// Its name.
        name: String,
        /// The cause.
        source: Box<dyn StdError + Send + Sync>,
    },
    /// The world of a cell cannot be built.
    #[error(transparent)]
    World(#[from] takt_world::BuildError),
    /// A device did not become operational.
    #[error(
        "{device} is still {status} after {after:?}: {why}\nhint: check how busy this host is; emulated robots need it to answer in time"
    )]
    NotReady {
        /// The device.
        device: String,
        /// Its state.
        status: String,
        /// How long it was waited for.
        after: Duration,
        /// What it waits for.
        why: String,
    },
}

impl Error {
    pub(crate) fn emulator(
        name: impl Into<String>,
        source: impl Into<Box<dyn StdError + Send + Sync>>,
    ) -> Self {
        let (name, source) = (name.into(), source.into());
        Self::Emulator { name, source }
    }
}

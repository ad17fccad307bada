//! Access to a bus for diagnosis while its driver runs. It changes nothing on the bus: state requests, writes and updates
//! need the controller to be stopped first.

use std::fmt;

use serde_json::Value;

/// Why a bus gave no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BusError {
    /// There is no such station.
    #[error("{0}")]
    NoSuch(String),
    /// The station or the driver did not answer, or refused.
    #[error("{0}")]
    Failed(String),
}

/// What is read from a station.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusRead {
    /// An object of its dictionary (SDO upload).
    Object {
        /// Its index.
        index: u16,
        /// Its sub-index.
        sub: u8,
    },
    /// Registers of its controller.
    Register {
        /// The first address.
        at: u16,
        /// Number of bytes, 1 to 128.
        len: u16,
    },
}

/// A bus whose driver answers questions of other threads. Calls block their thread for a bounded time, and never the
/// driver's.
pub trait BusAccess: fmt::Debug + Send + Sync {
    /// Kind of the bus, as its table in a cell: `ethercat`.
    fn kind(&self) -> &'static str;

    /// Its name in the cell.
    fn name(&self) -> &str;

    /// Whether it is at a network interface of that name.
    fn is_at(&self, interface: &str) -> bool;

    /// Its state, figures and history.
    ///
    /// # Errors
    /// If its driver does not answer in time.
    fn report(&self) -> Result<Value, BusError>;

    /// Reads from a station, given by number or name.
    ///
    /// # Errors
    /// If there is no such station, or it refuses or does not answer.
    fn read(&self, station: &str, what: BusRead) -> Result<Vec<u8>, BusError>;
}

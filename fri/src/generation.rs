//! Identifies a datagram: generation, direction and framing. It reads identifiers only, no content.

mod kind;

pub use kind::Kind;

use crate::error::DecodeError;
use crate::lwr::wire::{Cmd, Msr};
use crate::sunrise::wire::{Command, Monitoring, unframe};

impl Kind {
    /// Identifies `datagram`.
    pub fn of(datagram: &[u8]) -> Self {
        Self::lwr(datagram)
            .or_else(|| Self::sunrise(datagram))
            .unwrap_or(Self::Unknown)
    }

    fn lwr(datagram: &[u8]) -> Option<Self> {
        let (head, _) = datagram.split_first_chunk::<8>()?;
        let [.., size_low, size_high, id_low, id_high] = *head;
        let size = u16::from_le_bytes([size_low, size_high]);
        match (u16::from_le_bytes([id_low, id_high]), usize::from(size)) {
            (Msr::ID, Msr::LEN) => Some(Self::LwrMeasurement),
            (Cmd::ID, Cmd::LEN) => Some(Self::LwrCommand),
            _ => None,
        }
    }

    fn sunrise(datagram: &[u8]) -> Option<Self> {
        let (is_framed, message) = unframe(datagram).ok()?;
        if Monitoring::decode(message).is_ok() {
            Some(Self::SunriseMonitoring { is_framed })
        } else {
            Command::decode(message).ok()?;
            Some(Self::SunriseCommand { is_framed })
        }
    }

    /// Error for `datagram` where `expected` was due: `error`, unless the datagram is of another kind.
    pub(crate) fn explain(expected: Self, datagram: &[u8], error: DecodeError) -> DecodeError {
        let found = Self::of(datagram);
        if found == Self::Unknown || found == expected {
            return error;
        }
        DecodeError::Foreign { expected, found }
    }
}

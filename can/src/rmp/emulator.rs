//! Emulated power bases: one, and the pair of the omnidirectional base, each with its true pose and with faults
//! reported by users of real ones. No threads and no clock; time is an argument.

mod pair;
mod powerbase;

use std::time::Duration;

use crate::link::{Link, LinkError};

pub use pair::Pair;
pub use powerbase::{Faults, Powerbase, PowerbaseConfig};

/// Serves a power base on a link once, both boards as one: receives for 1 ms, then sends due frames.
///
/// # Errors
/// Errors of the link; frames that do not fit the queue are lost, as on a bus.
pub fn serve<L: Link + ?Sized>(
    powerbase: &mut Powerbase,
    link: &mut L,
    now: impl Fn() -> Duration,
) -> Result<(), LinkError> {
    const TIMEOUT: Duration = Duration::from_millis(1);
    if let Some(received) = link.receive(TIMEOUT)?
        && let Some(frame) = received.frame.classic()
    {
        powerbase.handle_frame(frame, now());
    }
    while let Some((_, frame)) = powerbase.poll_transmit(now()) {
        match link.send(&frame.into()) {
            Ok(()) | Err(LinkError::QueueFull) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;

//! Power bases that speak from the other end: one, and the pair of the omnidirectional base, each with
//! the truth of where it is and the faults of which users of real ones tell. They hold no thread and no
//! clock; the owner says what time it is.

mod pair;
mod powerbase;

use std::time::Duration;

use crate::link::{Link, LinkError};

pub use pair::Pair;
pub use powerbase::{Faults, Powerbase, PowerbaseConfig};

/// One turn of serving a power base on a link, in which both its boards are one: hears for a moment, then
/// sends what is due.
///
/// # Errors
/// What the link says; frames for which there is no room are lost, as on a bus.
pub fn serve<L: Link + ?Sized>(
    powerbase: &mut Powerbase,
    link: &mut L,
    now: impl Fn() -> Duration,
) -> Result<(), LinkError> {
    const PATIENCE: Duration = Duration::from_millis(1);
    if let Some(received) = link.receive(PATIENCE)?
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

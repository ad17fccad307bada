//! Runs an emulated controller on a link in real time. It makes no thread and asks for no priority: its caller does.

use super::krc::Krc;
use super::status::KrcStatus;
use crate::link::Link;
use crate::linux::monotonic;
use crate::lwr::wire::{Cmd, Msr};
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Answers taken between two measurements at most; the rest waits in the socket.
const ANSWERS_MAX: usize = 64;
/// Longest wait, so that `stop` is seen soon.
const WAIT_MAX: Duration = Duration::from_millis(50);

/// Serves `krc` on `link` until `stop`; the clock is [`monotonic`], which must also have given the start of `krc`.
///
/// Answers are awaited until the next deadline of the grid: the wait ends on the same high-resolution timer as an absolute
/// sleep, and its length is computed anew from the grid each time, so nothing accumulates. Whoever is late skips to the
/// grid, see [`Krc`]. After the first cycle nothing is allocated.
pub fn serve<L: Link>(
    krc: &mut Krc,
    link: &mut L,
    status: &KrcStatus,
    stop: &AtomicBool,
) -> io::Result<()> {
    while !stop.load(Ordering::Relaxed) {
        // What lies in the socket came before this moment: it must count for the cycle that ends now.
        for _ in 0..ANSWERS_MAX {
            if !receive(krc, link, Duration::ZERO)? {
                break;
            }
        }
        let now = monotonic()?;
        if now >= krc.poll_timeout() {
            status.apply(krc);
            transmit(krc, link, now)?;
            status.publish(krc);
        }
        let wait = krc.poll_timeout().saturating_sub(monotonic()?);
        if !wait.is_zero() {
            receive(krc, link, wait.min(WAIT_MAX))?;
        }
    }
    Ok(())
}

fn transmit<L: Link>(krc: &mut Krc, link: &mut L, now: Duration) -> io::Result<()> {
    let mut buf = [0; Msr::LEN];
    while let Some(len) = krc.poll_transmit(now, &mut buf) {
        link.send(&buf[..len])?;
    }
    Ok(())
}

fn receive<L: Link>(krc: &mut Krc, link: &mut L, timeout: Duration) -> io::Result<bool> {
    // One byte longer than an answer, so that a longer datagram shows.
    let mut buf = [0; Cmd::LEN + 1];
    let Some((len, at)) = link.receive(&mut buf, timeout)? else {
        return Ok(false);
    };
    // A malformed answer is counted by the controller and means nothing else to it.
    let _malformed = krc.handle_datagram(&buf[..len], at);
    Ok(true)
}

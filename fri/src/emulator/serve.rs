//! Runs an emulated controller on a link in real time. It makes no thread and asks for no priority: its caller does.

use super::{Served, Status};
use crate::link::Link;
use crate::linux::monotonic;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Answers taken between two measurements at most; the rest waits in the socket.
const ANSWERS_MAX: usize = 64;
/// Longest wait, so that `stop` is seen soon.
const WAIT_MAX: Duration = Duration::from_millis(50);
/// Room for any datagram, and one byte more so that a longer one shows.
const ROOM: usize = 1501;

/// Serves `controller` on `link` until `stop`; the clock is [`monotonic`], which must also have given its start. Whoever is
/// late skips to the grid. After the first cycle nothing is allocated.
///
/// Answers are awaited until the next deadline of the grid: the wait ends on the same high-resolution timer as an absolute
/// sleep, and its length is computed anew from the grid each time, so nothing accumulates.
pub fn serve<C: Served, L: Link>(
    controller: &mut C,
    link: &mut L,
    status: &Status<C>,
    stop: &AtomicBool,
) -> io::Result<()> {
    while !stop.load(Ordering::Relaxed) {
        // What lies in the socket came before this moment: it must count for the cycle that ends now.
        for _ in 0..ANSWERS_MAX {
            if !receive(controller, link, Duration::ZERO)? {
                break;
            }
        }
        let now = monotonic()?;
        if now >= controller.due() {
            status.apply(controller);
            transmit(controller, link, now)?;
            status.publish(controller);
        }
        let wait = controller.due().saturating_sub(monotonic()?);
        if !wait.is_zero() {
            receive(controller, link, wait.min(WAIT_MAX))?;
        }
    }
    Ok(())
}

fn transmit<C: Served, L: Link>(controller: &mut C, link: &mut L, now: Duration) -> io::Result<()> {
    let mut buf = [0; ROOM];
    while let Some(len) = controller.transmit(now, &mut buf) {
        link.send(&buf[..len])?;
    }
    Ok(())
}

fn receive<C: Served, L: Link>(
    controller: &mut C,
    link: &mut L,
    timeout: Duration,
) -> io::Result<bool> {
    let mut buf = [0; ROOM];
    let Some((len, at)) = link.receive(&mut buf, timeout)? else {
        return Ok(false);
    };
    controller.take(&buf[..len], at);
    Ok(true)
}

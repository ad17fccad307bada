//! Runs an emulated controller on a link in real time. It starts no thread and requests no priority: the caller does.

use super::{Served, Status};
use crate::link::Link;
use crate::linux::monotonic;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Maximum number of answers read between two measurements; the rest waits in the socket.
const ANSWERS_MAX: usize = 64;
/// Longest wait, so that `stop` is seen soon.
const WAIT_MAX: Duration = Duration::from_millis(50);
/// Size for any datagram, and one byte more to detect longer ones.
const BUFFER_LEN: usize = 1501;

/// Serves `controller` on `link` until `stop`, on the clock [`monotonic`], which must also have given its start. A late
/// host skips to the grid. After the first cycle nothing is allocated. At the end a cabinet closes
/// its session and sends IDLE.
///
/// The wait for answers ends at the next deadline of the grid: it uses the same high-resolution timer as an absolute
/// sleep, and its length is computed from the grid each time, so nothing accumulates.
pub fn serve<C: Served, L: Link>(
    controller: &mut C,
    link: &mut L,
    status: &Status<C>,
    stop: &AtomicBool,
) -> io::Result<()> {
    while !stop.load(Ordering::Relaxed) {
        // Datagrams already in the socket arrived before this moment: they count for the cycle that ends now.
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
    controller.close();
    // The last datagram is due with the next cycle, at most 100 ms from now.
    loop {
        let wait = controller.due().saturating_sub(monotonic()?);
        if wait.is_zero() {
            break;
        }
        receive(controller, link, wait)?;
    }
    transmit(controller, link, monotonic()?)?;
    status.publish(controller);
    Ok(())
}

fn transmit<C: Served, L: Link>(controller: &mut C, link: &mut L, now: Duration) -> io::Result<()> {
    let mut buf = [0; BUFFER_LEN];
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
    let mut buf = [0; BUFFER_LEN];
    let Some((len, at)) = link.receive(&mut buf, timeout)? else {
        return Ok(false);
    };
    controller.take(&buf[..len], at);
    Ok(true)
}

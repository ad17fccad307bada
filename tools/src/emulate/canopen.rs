//! An emulated CANopen node on a CAN interface: frames in both directions, and its faults in time.

use std::time::Duration;

use anyhow::Context as _;
use takt_can::canopen::node::{Application, Node};
use takt_can::link::{Link as _, LinkError};
use takt_can::linux::{Options, SocketCan, monotonic};

use super::faults::{Ailing, Fault, Schedule};
use super::service::Service;
use crate::output::say;
use crate::run::until_stopped;

/// Longest wait for a frame: the step of motors and signals.
const WAIT: Duration = Duration::from_millis(1);

/// Opens a CAN interface.
pub(super) fn open(interface: &str) -> anyhow::Result<SocketCan> {
    SocketCan::open(interface, &Options::default())
        .with_context(|| format!("cannot open {interface}; is it a CAN interface?"))
}

/// Serves a node until Ctrl-C or for that time, and says how it ended.
pub(super) fn serve<A>(
    name: &str,
    node: Node<A>,
    mut socket: SocketCan,
    faults: &[Fault],
    duration: Option<Duration>,
) -> anyhow::Result<()>
where
    A: Application + Send + 'static,
    Node<A>: Ailing,
{
    let mut schedule = Schedule::new(faults, monotonic());
    let service = Service::start(name, node, move |node| {
        schedule.step(node, monotonic());
        turn(node, &mut socket).context("the interface failed")
    })?;
    until_stopped(duration, || service.check())?;
    let node = service.stop()?;
    say(&format!("ended {:?}", node.state()))
}

fn turn<A: Application>(node: &mut Node<A>, socket: &mut SocketCan) -> Result<(), LinkError> {
    if let Some(received) = socket.receive(WAIT)?
        && let Some(frame) = received.frame.classic()
    {
        node.handle_frame(frame, monotonic());
    }
    while let Some(frame) = node.poll_transmit(monotonic()) {
        match socket.send(&frame.into()) {
            Ok(()) | Err(LinkError::QueueFull) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

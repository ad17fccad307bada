//! Emulated FRI controllers on the command line: their socket, and changes of their state as lines. Their threads are in
//! `takt_devices::fri::emulator`.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::time::Duration;

use anyhow::Context as _;
use takt_devices::fri::emulator::Robot;
use takt_fri::linux::UdpLink;
use takt_fri::lwr::emulator::{Served, Status};

use crate::Verdict;
use crate::output::{complain, say};
use crate::run::until_stopped;

/// Prints changes of state until the end, then the counts of datagrams.
pub(super) fn watch<C: Served + 'static>(
    robot: Robot<C>,
    duration: Option<Duration>,
) -> anyhow::Result<Verdict> {
    let mut printed = Printed::default();
    until_stopped(duration, || {
        printed
            .next(robot.status())
            .map_or(Ok(()), |line| say(&line))
    })?;
    let status = robot.stop().context("the emulated controller failed")?;
    if let Some(line) = printed.next(&status) {
        say(&line)?;
    }
    say(&format!(
        "sent {}, answers {}, missed {}, own stalls {}",
        status.sent(),
        status.answers(),
        status.missed(),
        status.stalls()
    ))?;
    Ok(Verdict::Good)
}

/// What was printed of a controller.
#[derive(Debug, Default)]
struct Printed {
    state: Option<String>,
    exits: u64,
}

impl Printed {
    /// The line for a change: the state in the controller's own terms, and, once, why command mode was left.
    fn next<C: Served>(&mut self, status: &Status<C>) -> Option<String> {
        let power = if status.has_power() { "on" } else { "off" };
        let (state, quality) = (status.state(), status.quality());
        let now = format!("{state}, quality {quality}, drives {power}");
        let exits = status.exits();
        let why = status.last_exit().filter(|_| exits != self.exits);
        self.exits = exits;
        if why.is_none() && self.state.as_ref() == Some(&now) {
            return None;
        }
        let line = why.map_or_else(
            || now.clone(),
            |why| format!("{now}; left command mode: {why}"),
        );
        self.state = Some(now);
        Some(line)
    }
}

/// The socket of a controller at `bind`, by default at `port` of every interface (on the loopback at any port, since the
/// client may have that one); its datagrams go to `target`.
pub(super) fn connect(
    bind: Option<SocketAddr>,
    target: SocketAddr,
    port: u16,
) -> anyhow::Result<UdpLink> {
    let context = || format!("cannot open a socket to {target}");
    if let Some(bind) = bind {
        return UdpLink::connect(bind, target).with_context(context);
    }
    let local = |port| match target {
        SocketAddr::V4(v4) if v4.ip().is_loopback() => SocketAddr::from((Ipv4Addr::LOCALHOST, 0)),
        SocketAddr::V4(_) => SocketAddr::from((Ipv4Addr::UNSPECIFIED, port)),
        SocketAddr::V6(_) => SocketAddr::from((Ipv6Addr::UNSPECIFIED, port)),
    };
    match UdpLink::connect(local(port), target) {
        Err(error) if error.kind() == std::io::ErrorKind::AddrInUse => {
            complain(&format!(
                "warning: {error}\nhint: datagrams leave from another port; a client that connects to the robot's address needs \
                 --bind with an address of its own"
            ));
            UdpLink::connect(local(0), target).with_context(context)
        }
        opened => opened.with_context(context),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use takt_fri::lwr::emulator::serve;
    use takt_fri::sunrise::emulator::{Cabinet, CabinetConfig, CabinetStatus};

    #[test]
    fn emulated_controller_reason_is_printed_once() {
        let (mut here, _there) = takt_fri::link::pair();
        let status = CabinetStatus::new();
        let stop = AtomicBool::new(true);
        let mut printed = Printed::default();
        let first = printed.next(&status).unwrap();
        assert_eq!(first, "IDLE, quality POOR, drives off");
        let mut cabinet = Cabinet::new(CabinetConfig::default(), Duration::ZERO);
        serve(&mut cabinet, &mut here, &status, &stop).unwrap();
        assert_eq!(
            printed.next(&status),
            Some("IDLE, quality POOR, drives on".to_owned())
        );
        assert_eq!(printed.next(&status), None);
    }

    #[test]
    fn emulated_controller_sends_from_its_address() {
        let target = SocketAddr::from(([127, 0, 0, 1], 9));
        let bind = SocketAddr::from(([127, 0, 0, 2], 0));
        let local = connect(Some(bind), target, 30_200)
            .unwrap()
            .local_addr()
            .unwrap();
        assert_eq!(local.ip(), bind.ip());
        let free = connect(None, target, 30_200).unwrap().local_addr().unwrap();
        assert_ne!(free.port(), 30_200);
        let taken = connect(Some(local), target, 0);
        let held = connect(Some(SocketAddr::from(([127, 0, 0, 3], 0))), target, 0).unwrap();
        let again = connect(Some(held.local_addr().unwrap()), target, 0).unwrap_err();
        assert!(
            format!("{again:#}").contains("is taken by this process"),
            "{again:#}"
        );
        drop(taken);
    }
}

//! `takt emulate tx90`: an EtherCAT segment at a network interface, for Takt or any other
//! master at the other end of its cable.

use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use takt_ethercat::emulator::{
    Coupler, Io, Segment, Server, ServoConfig, ServoDrive, SharedSegment,
};
use takt_ethercat::link::Link;
use takt_ethercat::linux::{PacketLink, TapLink, monotonic};
use takt_rt::interface::Medium;

use super::service::Service;
use crate::Verdict;
use crate::output::{positive_span, say};
use crate::run::until_stopped;

/// Longest wait for a frame, which bounds the delay of a stop.
const WAIT: Duration = Duration::from_millis(5);

/// A Stäubli TX90: coupler, digital terminal, and one drive of six axes.
#[derive(Debug, Args)]
pub(crate) struct Tx90 {
    /// Network interface; the master is at the other end of its cable (`ip link add near type veth peer name far`). Or
    /// `tap:NAME`: an interface of that name is made, and the master works on it.
    #[arg(long, value_name = "IFACE")]
    interface: String,
    /// Axes fault after three cycles without a set-point, as real ones do; for masters on real-time hosts.
    #[arg(long)]
    strict: bool,
    /// End after this time; without it, at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    duration: Option<Duration>,
}

impl Tx90 {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let segment = SharedSegment::new(tx90(self.strict)?);
        let ends = Ends::line(&self.interface);
        serve(&segment, ends, self.duration, || {}, || Ok(()))
    }
}

/// Its slaves; with `strict` its axes fault after three cycles without a set-point.
pub(crate) fn tx90(strict: bool) -> anyhow::Result<Segment> {
    let mut tx90 = ServoConfig::tx90();
    if !strict {
        for axis in &mut tx90.axes {
            axis.quirks.missing_set_points = None;
        }
    }
    let (terminal, _) = Io::digital(8, 8);
    let (drives, _) =
        ServoDrive::slave(tx90).context("the configuration of the drive is invalid")?;
    Ok(Segment::line([Coupler::slave(), terminal, drives]))
}

/// The interfaces at which a segment is served.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ends<'a> {
    /// Before the first slave.
    pub(crate) first: &'a str,
    /// Behind the last slave of a ring.
    pub(crate) second: Option<&'a str>,
}

impl<'a> Ends<'a> {
    /// One interface.
    pub(crate) const fn line(first: &'a str) -> Self {
        Self {
            first,
            second: None,
        }
    }

    /// What the user is shown.
    fn text(self, slaves: usize) -> String {
        let shown = |interface: &'a str| interface.strip_prefix("tap:").unwrap_or(interface);
        match (self.second, self.first.strip_prefix("tap:")) {
            (Some(second), _) => format!(
                "{slaves} slaves in a ring between {} and {}",
                shown(self.first),
                shown(second)
            ),
            (None, Some(name)) => format!(
                "{slaves} slaves behind {name}; bring it up (`ip link set {name} up`), their master works on it"
            ),
            (None, None) => format!("{slaves} slaves at {}", self.first),
        }
    }
}

/// Opens an interface, or makes one (`tap:NAME`).
fn open(interface: &str) -> anyhow::Result<Box<dyn Link + Send>> {
    Ok(match interface.strip_prefix("tap:") {
        Some(name) => Box::new(TapLink::open(name)?),
        None => Box::new(PacketLink::open_locked(interface)?),
    })
}

/// Serves a segment at its interfaces, until it is to end. `between` is called after each frame by the thread that serves,
/// `poll` ten times a second by this one.
pub(crate) fn serve(
    segment: &SharedSegment,
    ends: Ends<'_>,
    duration: Option<Duration>,
    mut between: impl FnMut() + Send + 'static,
    mut poll: impl FnMut() -> anyhow::Result<()>,
) -> anyhow::Result<Verdict> {
    let slaves = segment.lock().len();
    let mut server = Server::new(segment.clone(), open(ends.first)?);
    if let Some(second) = ends.second {
        anyhow::ensure!(
            second != ends.first,
            "{second} is given as both ends of the ring
hint: a ring ends at two interfaces"
        );
        server = server.with_second(open(second)?);
    }
    say(&ends.text(slaves))?;
    let name = ends.first.to_owned();
    let service = Service::start("segment", server, move |server| {
        let turn = server.turn(WAIT, &mut monotonic);
        between();
        turn.map(|_| ())
            .map_err(|error| crate::link::failed(&name, Medium::Ethernet, error))
    })?;
    until_stopped(duration, || {
        service.check()?;
        poll()
    })?;
    service.stop()?;
    Ok(Verdict::Good)
}

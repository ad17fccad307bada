//! `takt emulate tx90`: an EtherCAT segment at a network interface, for Takt or any other
//! master at the other end of its cable.

use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use takt_ethercat::emulator::{
    Coupler, Io, Segment, Server, ServoConfig, ServoDrive, SharedSegment,
};
use takt_ethercat::linux::{PacketLink, monotonic};

use super::service::Service;
use crate::Verdict;
use crate::output::{say, span};
use crate::run::until_stopped;

/// Longest wait for a frame, so that a stop is seen soon.
const WAIT: Duration = Duration::from_millis(5);

/// A Stäubli TX90: coupler, digital terminal, and one drive of six axes.
#[derive(Debug, Args)]
pub(crate) struct Tx90 {
    /// Network interface; the master is at the other end of its cable (`ip link add near type veth peer name far`).
    #[arg(long, value_name = "IFACE")]
    interface: String,
    /// Axes fault after three cycles without a set-point, as real ones do; for masters on real-time hosts.
    #[arg(long)]
    strict: bool,
    /// End after this time; without it, at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = span)]
    duration: Option<Duration>,
}

impl Tx90 {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut tx90 = ServoConfig::tx90();
        if !self.strict {
            for axis in &mut tx90.axes {
                axis.quirks.missing_set_points = None;
            }
        }
        let (terminal, _) = Io::digital(8, 8);
        let (drives, _) = ServoDrive::slave(tx90).context("the drive makes no sense")?;
        let segment = Segment::line([Coupler::slave(), terminal, drives]);
        serve(segment, &self.interface, self.duration)
    }
}

fn serve(segment: Segment, interface: &str, duration: Option<Duration>) -> anyhow::Result<Verdict> {
    let link = PacketLink::open(interface)?;
    let slaves = segment.len();
    let server = Server::new(SharedSegment::new(segment), link);
    say(&format!("{slaves} slaves at {interface}"))?;
    let service = Service::start("segment", server, |server| {
        let turn = server.turn(WAIT, &mut monotonic);
        turn.map(|_| ()).context("the interface failed")
    })?;
    until_stopped(duration, || service.check())?;
    service.stop()?;
    Ok(Verdict::Good)
}

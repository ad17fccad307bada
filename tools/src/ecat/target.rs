//! The segment that a command works on: its options, and how it is opened.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use takt_ethercat::AlState;
use takt_ethercat::config::MasterConfig;
use takt_ethercat::linux::PacketLink;
use takt_rt::interface::Medium;

use super::session::Session;
use super::{cell, ring};
use crate::output::span;

/// A segment and the timeout of its start.
#[derive(Clone, Debug, Args)]
pub(super) struct Target {
    /// The network interface, as `ip link` lists it.
    #[arg(value_name = "IFACE")]
    pub(super) interface: String,
    /// The interface at the other end of a ring.
    #[arg(long, value_name = "IFACE")]
    pub(super) second: Option<String>,
    /// How long slaves may take to reach their state.
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = span)]
    pub(super) timeout: Duration,
}

/// A segment that is measured, or a recording of one.
#[derive(Clone, Debug, Args)]
pub(super) struct Source {
    /// The network interface, as `ip link` lists it; with `--config` that of the cell.
    #[arg(value_name = "IFACE", required_unless_present_any = ["from", "config", "controller"])]
    pub(super) interface: Option<String>,
    /// The interface at the other end of a ring; with `--config` that of the cell, if it has a link.
    #[arg(long, value_name = "IFACE", conflicts_with = "from")]
    pub(super) second: Option<String>,
    /// Evaluate this recording (pcap, pcapng, ERF) instead, as far as its master read the slaves.
    #[arg(long, value_name = "FILE", conflicts_with = "interface")]
    pub(super) from: Option<PathBuf>,
    /// Expect the slaves that a segment of this cell expects, with their PDOs and SYNC0.
    #[arg(long, value_name = "FILE", conflicts_with = "from")]
    pub(super) config: Option<PathBuf>,
    /// Which segment of the cell; needed if it has several.
    #[arg(long, value_name = "NAME", requires = "config")]
    pub(super) segment: Option<String>,
    /// How long slaves may take to reach their state.
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = span)]
    pub(super) timeout: Duration,
}

impl Source {
    /// Opens the segment and brings it to a state. The default cycle is that of the cell, or else 1 ms.
    pub(super) fn bring_up(
        &self,
        goal: AlState,
        cycle: Option<Duration>,
    ) -> anyhow::Result<Session<PacketLink>> {
        let mut config = MasterConfig {
            goal,
            cycle: cycle.unwrap_or(Duration::from_millis(1)),
            ..MasterConfig::default()
        };
        let (mut interface, mut second) = (self.interface.clone(), self.second.clone());
        if let Some(path) = &self.config {
            let cell = takt_devices::read_cell(path)?;
            let segment = cell::segment(&cell, self.segment.as_deref())?;
            config = cell::master(segment, cycle.unwrap_or(segment.cycle), goal);
            (interface, second) = cell::ends(segment, interface, second);
        }
        let target = Target {
            interface: interface.unwrap_or_default(),
            second,
            timeout: self.timeout,
        };
        target.open(config)
    }
}

impl Target {
    /// Opens the segment and brings it to a state.
    pub(super) fn bring_up(
        &self,
        goal: AlState,
        cycle: Duration,
    ) -> anyhow::Result<Session<PacketLink>> {
        self.open(MasterConfig {
            goal,
            cycle,
            ..MasterConfig::default()
        })
    }

    fn open(&self, config: MasterConfig) -> anyhow::Result<Session<PacketLink>> {
        let link = PacketLink::open_locked(&self.interface)?;
        let mac = link.mac();
        let has_sync = config.slaves.iter().any(|slave| slave.sync.is_some());
        let config = MasterConfig {
            redundant: self.second.is_some(),
            ..config
        };
        let mut session = Session::new(&self.interface, link, mac, config)?;
        if let Some(second) = &self.second {
            anyhow::ensure!(
                *second != self.interface,
                "{second} is given as both ends of the ring\nhint: a ring ends at two interfaces"
            );
            let link = PacketLink::open_locked(second)?;
            let mac = link.mac();
            session = session.with_second(link, mac);
        }
        if has_sync {
            session.follow_sync0();
        }
        let ends = std::iter::once(self.interface.as_str()).chain(self.second.as_deref());
        crate::link::ready(ends, Medium::Ethernet)?;
        session.listen()?;
        match session.bring_up(self.timeout) {
            Ok(()) => {
                if let Some(second) = self.second.as_ref().filter(|_| session.is_reversed()) {
                    return Err(ring::reversed(&self.interface, second));
                }
                Ok(session)
            }
            // A segment that ends at another interface of this host is a ring.
            Err(error) => match self.second.is_none().then(|| ring::other_end(&mut session)) {
                Some(Some(other)) => Err(ring::one_end_of(&self.interface, &other)),
                Some(None) | None => Err(error),
            },
        }
    }
}

/// Cycle of commands that only read and write objects.
pub(super) const REQUEST_CYCLE: Duration = Duration::from_millis(1);

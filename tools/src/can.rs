//! `takt can`: inspect a CAN bus, live or from a recording, send to it, set up interfaces, and bring nodes up.
//! `takt-can` decodes the protocols; `takt doctor` checks the host.

mod arguments;
mod confirm;
mod dbc;
mod drive;
mod dump;
pub(crate) mod feed;
mod filter;
#[cfg(test)]
mod lab;
mod nmt;
mod replay;
mod rmp;
mod scan;
mod sdo;
mod sdo_client;
mod send;
pub(crate) mod sheet;
mod stat;
mod up;
mod wire;

use clap::Subcommand;

use crate::Verdict;
use arguments::{bitrate, node};

/// Inspect CAN buses, send to them, set up interfaces.
#[derive(Debug, Subcommand)]
pub(crate) enum Can {
    Dump(dump::Dump),
    Stat(stat::Stat),
    Send(send::Send),
    Replay(replay::Replay),
    Up(up::Up),
    Scan(scan::Scan),
    Nmt(nmt::Nmt),
    Sdo(sdo::Sdo),
    Drive(drive::Drive),
    Rmp(rmp::Rmp),
}

impl Can {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            Self::Dump(dump) => dump.run(),
            Self::Stat(stat) => stat.run(),
            Self::Send(send) => send.run(),
            Self::Replay(replay) => replay.run(),
            Self::Up(up) => up.run(),
            Self::Scan(scan) => scan.run(),
            Self::Nmt(nmt) => nmt.run(),
            Self::Sdo(sdo) => sdo.run(),
            Self::Drive(drive) => drive.run(),
            Self::Rmp(rmp) => rmp.run(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::bitrate;

    #[test]
    fn bit_rate_with_unit_is_parsed() {
        assert_eq!(bitrate("500k"), Ok(500_000));
        assert_eq!(bitrate("1M"), Ok(1_000_000));
        assert_eq!(bitrate("125000"), Ok(125_000));
        for wrong in ["", "k", "125", "1G", "-5k", "99M", "5000000k"] {
            assert!(bitrate(wrong).is_err(), "{wrong}");
        }
    }
}

//! `takt can`: inspect a CAN bus, live or from a recording, send to it, set up interfaces, and bring nodes up.
//! `takt-can` decodes the protocols; `takt doctor` checks the host.

mod confirm;
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
mod sheet;
mod stat;
mod up;
mod wire;

use clap::Subcommand;

use takt_can::canopen::NodeId;

use crate::Verdict;

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

/// Reads a node number of the command line.
fn node(text: &str) -> Result<NodeId, String> {
    let raw = text.parse::<u8>().ok();
    raw.and_then(|raw| NodeId::new(raw).ok())
        .ok_or_else(|| format!("`{text}` is not a node number; they are 1 to 127"))
}

/// Reads a bit rate of the command line: `500k`, `1M`, or bit/s.
fn bitrate(text: &str) -> Result<u32, String> {
    let (digits, unit) = match text.strip_suffix(['k', 'K']) {
        Some(digits) => (digits, 1_000),
        None => match text.strip_suffix('M') {
            Some(digits) => (digits, 1_000_000),
            None => (text, 1),
        },
    };
    let rate = digits
        .parse::<u32>()
        .ok()
        .and_then(|rate| rate.checked_mul(unit));
    rate.filter(|rate| (1_000..=20_000_000).contains(rate))
        .ok_or_else(|| format!("`{text}` is not a bit rate\nhint: write 500k, 1M, or bit/s"))
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

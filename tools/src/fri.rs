//! `takt fri`: FRI connections of KUKA arms, live as FRI client, or in recordings. Datagrams are decoded and
//! judged in `takt-fri`; the drivers of a cell are in `takt-core`.

mod live;
mod monitor;
mod motion;
mod recording;
mod report;
mod shift;
mod stat;
mod view;
mod watch;

use clap::Subcommand;

use crate::Verdict;

/// Inspect FRI connections of KUKA arms: which side is late, what was sent; move one joint a little.
#[derive(Debug, Subcommand)]
pub(crate) enum Fri {
    Monitor(monitor::Monitor),
    Stat(stat::Stat),
    Move(shift::Shift),
}

impl Fri {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            Self::Monitor(monitor) => monitor.run(),
            Self::Stat(stat) => stat.run(),
            Self::Move(shift) => shift.run(),
        }
    }
}

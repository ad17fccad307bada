//! `takt fri`: look at FRI connections of KUKA arms in recordings. Datagrams are decoded and judged in `takt-fri`;
//! nothing is captured from a network here.

mod monitor;
mod recording;
mod stat;

use clap::Subcommand;

use crate::Verdict;

/// Look at FRI connections of KUKA arms: who is late, what was said.
#[derive(Debug, Subcommand)]
pub(crate) enum Fri {
    Monitor(monitor::Monitor),
    Stat(stat::Stat),
}

impl Fri {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            Self::Monitor(monitor) => monitor.run(),
            Self::Stat(stat) => stat.run(),
        }
    }
}

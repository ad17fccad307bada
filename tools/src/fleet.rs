//! `takt fleet`: the cells of a fleet, over zenoh. It knows no controller of this host: all it shows was published or answered by
//! cells that run with `[fleet]`.

mod call;
mod doctor;
mod link;
mod list;
pub(crate) mod reading;
mod start;
mod top;
mod watch;

use clap::Subcommand;

use crate::Verdict;

/// See and command the cells of a fleet: controllers that run with `[fleet]` in their cell files.
#[derive(Debug, Subcommand)]
pub(crate) enum Fleet {
    List(list::List),
    Top(top::Top),
    Call(call::Call),
    Watch(watch::Watch),
    Start(start::Start),
    Doctor(doctor::Doctor),
}

impl Fleet {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            Self::List(list) => list.run(),
            Self::Top(top) => top.run(),
            Self::Call(call) => call.run(),
            Self::Watch(watch) => watch.run(),
            Self::Start(start) => start.run(),
            Self::Doctor(doctor) => doctor.run(),
        }
    }
}

//! `takt ecat`: inspects an EtherCAT segment with a master of its own, and recordings of segments. `takt-ethercat` is
//! the protocol; `takt doctor` checks the host.

mod cell;
mod cell_file;
mod controller;
mod dc;
mod difference;
mod directions;
mod drive;
mod dump;
mod eoe;
mod esi;
mod finding;
mod foe;
mod frames;
mod graph;
mod pdos;
mod recording;
mod reg;
mod ring;
mod scan;
mod sdo;
mod session;
mod sii;
mod sim;
mod stat;
mod state;
mod target;
#[cfg(test)]
mod tests;
mod trips;
mod youbot;

use clap::Subcommand;

use crate::Verdict;
use target::{REQUEST_CYCLE, Source, Target};

/// Inspect an EtherCAT segment, read and write objects of its slaves, decode recordings.
///
/// Commands that send are masters: stop the controller that owns the segment first (`systemctl stop takt`), or ask it by
/// `--controller`. Where frames of another master are received, nothing is sent.
#[derive(Debug, Subcommand)]
pub(crate) enum Ecat {
    Scan(scan::Scan),
    Cell(cell_file::Cell),
    Graph(graph::Graph),
    Sdo(sdo::Sdo),
    Sii(sii::Sii),
    Reg(reg::Reg),
    State(state::State),
    Foe(foe::Foe),
    Eoe(eoe::Eoe),
    Sim(sim::Sim),
    Drive(drive::Drive),
    Youbot(youbot::YouBot),
    Stat(stat::Stat),
    Pdos(pdos::Pdos),
    Dc(dc::Dc),
    Dump(dump::Dump),
    Esi(esi::Esi),
}

impl Ecat {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            Self::Scan(scan) => scan.run(),
            Self::Cell(cell) => cell.run(),
            Self::Graph(graph) => graph.run(),
            Self::Sdo(sdo) => sdo.run(),
            Self::Sii(sii) => sii.run(),
            Self::Reg(reg) => reg.run(),
            Self::State(state) => state.run(),
            Self::Foe(foe) => foe.run(),
            Self::Eoe(eoe) => eoe.run(),
            Self::Sim(sim) => sim.run(),
            Self::Drive(drive) => drive.run(),
            Self::Youbot(youbot) => youbot.run(),
            Self::Stat(stat) => stat.run(),
            Self::Pdos(pdos) => pdos.run(),
            Self::Dc(dc) => dc.run(),
            Self::Dump(dump) => dump.run(),
            Self::Esi(esi) => esi.run(),
        }
    }
}

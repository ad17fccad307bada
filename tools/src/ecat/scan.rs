//! `takt ecat scan`: the slaves of a segment, their topology and their states. It exchanges no process data, and nothing
//! moves.

use std::fmt::Write as _;

use clap::Args;
use serde_json::{Value, json};
use takt_ethercat::AlState;
use takt_ethercat::master::{Event, Master, SlaveView};
use takt_ethercat::topology::Topology;

use super::controller::{self, Remote};
use super::session::{Session, Wire};
use super::{REQUEST_CYCLE, Target};
use crate::Verdict;
use crate::output::say;

/// Find the slaves of a segment: tree, names, identities, states, ports.
///
/// Brings all slaves to PRE-OP, where outputs are inactive. Exit status: 0 all slaves reach it; 1 one does not; 2 no slave
/// answers, or it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat scan enp2s0
  takt ecat scan enp2s0 --json
  takt ecat scan enp2s0 --controller localhost:8080    while the controller runs

Ports: the number of a port in use, - without a link, ! with a link while the port is closed.")]
pub(crate) struct Scan {
    #[command(flatten)]
    target: Target,
    #[command(flatten)]
    remote: Remote,
    /// Print one JSON object instead of the tree.
    #[arg(long)]
    json: bool,
}

impl Scan {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        if self.remote.is_given() {
            let report = self.remote.report(Some(&self.target.interface))?;
            let (findings, verdict) = controller::verdict(&report);
            let table = || format!("{}{findings}", controller::scan(&report));
            let shown = if self.json {
                report.to_string()
            } else {
                table()
            };
            say(shown.trim_end())?;
            return Ok(verdict);
        }
        let session = self.target.bring_up(AlState::PreOp, REQUEST_CYCLE)?;
        if self.json {
            say(&object(&session).to_string())?;
        } else {
            say(text(&session).trim_end())?;
        }
        Ok(verdict(session.master()))
    }
}

/// Whether all slaves are in the requested state.
pub(super) fn verdict(master: &Master) -> Verdict {
    if master.is_operational() && master.differences().is_empty() && master.ring_gap().is_none() {
        Verdict::Good
    } else {
        Verdict::Failed
    }
}

const HEADER: &str =
    " pos  slave                           at   state       ports  vendor    product   revision";

/// The tree, one line per slave, with its notes below.
pub(super) fn text<W: Wire>(session: &Session<W>) -> String {
    let master = session.master();
    let mut text = format!(
        "{}: {} slaves\n{HEADER}\n",
        session.interface(),
        master.len()
    );
    let depths = depths(master.topology());
    for (position, slave) in ring(master) {
        let depth = depths.get(position).copied().unwrap_or(0);
        let _ = writeln!(text, "{}", line(master, position, depth, slave).trim_end());
        for note in notes(slave) {
            let note = note.replace('\n', "\n          ");
            let _ = writeln!(text, "        ! {note}");
        }
    }
    for difference in master.differences() {
        let _ = writeln!(text, "! {difference}");
    }
    if master.config().redundant {
        let ring = master.ring_gap().map(|cable| Event::RingOpen { cable });
        let ring = ring.map_or_else(
            || "the ring is whole".to_owned(),
            |open| format!("! {open}"),
        );
        let _ = writeln!(text, "{ring}");
    }
    text
}

/// Slaves in the order of the ring.
fn ring(master: &Master) -> impl Iterator<Item = (usize, SlaveView<'_>)> {
    let mut all: Vec<_> = (0..master.len())
        .filter_map(|number| master.slave(number))
        .map(|slave| (slave.position().map_or(usize::MAX, usize::from), slave))
        .collect();
    all.sort_by_key(|(position, _)| *position);
    all.into_iter()
}

/// The number of branches between each slave and the trunk line. The last cable of a slave continues its line, so that a
/// long line is not indented.
fn depths(topology: &Topology) -> Vec<usize> {
    let last = |number: usize| {
        let following = number + 1..topology.len();
        let parent = topology.parent(number).map(|(parent, _)| parent);
        let is_child = |other: usize| topology.parent(other).map(|(parent, _)| parent) == parent;
        !following.into_iter().any(is_child)
    };
    let mut depths: Vec<usize> = Vec::new();
    for number in 0..topology.len() {
        let above = topology
            .parent(number)
            .and_then(|(parent, _)| depths.get(parent).copied());
        depths.push(above.map_or(0, |depth| depth + usize::from(!last(number))));
    }
    depths
}

fn line(master: &Master, position: usize, depth: usize, slave: SlaveView<'_>) -> String {
    let info = slave.info();
    let name = format!("{}o {}", "| ".repeat(depth), title(slave));
    let at = master.topology().parent(position);
    let at = at.map_or_else(
        || "-".to_owned(),
        |(parent, port)| format!("{parent}:{port}"),
    );
    let id = info.identity;
    format!(
        "{position:>4}  {:<30}  {at:<5}{:<12}{}   {:08X}  {:08X}  {:08X}",
        truncated(&name, 30),
        state(slave),
        ports(slave),
        id.vendor,
        id.product,
        id.revision
    )
}

/// The state, such as `SAFE-OP+ERR`.
pub(super) fn state(slave: SlaveView<'_>) -> String {
    let (al, _) = slave.al();
    format!("{}{}", al.state, if al.error { "+ERR" } else { "" })
}

/// The name of a slave, or else its order code.
pub(super) fn title(slave: SlaveView<'_>) -> &str {
    let info = slave.info();
    match (info.name.as_str(), info.order.as_str()) {
        ("", "") => "(no name)",
        ("", order) => order,
        (name, _) => name,
    }
}

/// The text, truncated to a number of characters.
fn truncated(text: &str, max: usize) -> String {
    if text.chars().count() <= max {
        return text.to_owned();
    }
    let begin: String = text.chars().take(max - 2).collect();
    format!("{begin}..")
}

fn ports(slave: SlaveView<'_>) -> String {
    let ports = slave.info().ports();
    ('0'..)
        .zip(ports)
        .map(|(number, port)| match (port.link, port.open) {
            (_, true) => number,
            (true, false) => '!',
            (false, false) => '-',
        })
        .collect()
}

/// Faults and errors of a slave.
fn notes(slave: SlaveView<'_>) -> Vec<String> {
    let (al, code) = slave.al();
    let mut notes = Vec::new();
    if let Some(fault) = slave.fault() {
        notes.push(fault.to_string());
    } else if al.error {
        notes.push(format!("{al}: {code}"));
    }
    if slave.position().is_some() && !slave.info().sii_checked {
        notes.push("the checksum of its SII is wrong; its EEPROM may be partly written".to_owned());
    }
    notes
}

/// The scan as JSON.
pub(super) fn object<W: Wire>(session: &Session<W>) -> Value {
    let master = session.master();
    let slaves: Vec<Value> = ring(master)
        .map(|(position, slave)| slave_object(master, position, slave))
        .collect();
    let differences: Vec<String> = master
        .differences()
        .iter()
        .map(ToString::to_string)
        .collect();
    json!({
        "version": 1,
        "interface": session.interface(),
        "good": verdict(master) == Verdict::Good,
        "slaves": slaves,
        "differences": differences,
        "ring_open": master.ring_gap().map(|cable| cable.to_string()),
    })
}

fn slave_object(master: &Master, position: usize, slave: SlaveView<'_>) -> Value {
    let info = slave.info();
    let parent = master.topology().parent(position);
    let ports = info
        .ports()
        .map(|port| json!({ "link": port.link, "open": port.open }));
    json!({
        "position": slave.position(),
        "station": slave.station(),
        "alias": info.alias,
        "name": info.name,
        "order": info.order,
        "vendor": info.identity.vendor,
        "product": info.identity.product,
        "revision": info.identity.revision,
        "serial": info.identity.serial,
        "state": slave.al().0.to_string(),
        "al_code": slave.al().1.0,
        "parent": parent.map(|(parent, port)| json!({ "position": parent, "port": port })),
        "ports": ports,
        "clock": info.has_clock(),
        "notes": notes(slave),
    })
}

//! `takt ecat pdos`: the process data of each slave: SyncManagers, PDOs and entries as they are assigned. It changes no
//! assignment.

use std::fmt::Write as _;

use clap::Args;
use serde_json::{Value, json};
use takt_ethercat::AlState;
use takt_ethercat::master::{Channel, Pdo, SlaveView};

use super::session::{Session, Wire};
use super::{REQUEST_CYCLE, Target, scan};
use crate::Verdict;
use crate::output::say;

/// Print the process data of the slaves: SyncManagers, PDOs, and the position of each entry.
///
/// Read in PRE-OP: from 1C1xh if a slave has CoE, else from its SII. Exit status: 0 all slaves were read; 1 a slave does
/// not reach PRE-OP; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat pdos enp2s0
  takt ecat pdos enp2s0 --slave 2 --json

Positions are byte.bit from the start of a slave's outputs or inputs.")]
pub(crate) struct Pdos {
    #[command(flatten)]
    target: Target,
    /// Only this slave: its position from 0, or its name or order code.
    #[arg(long, value_name = "SLAVE")]
    slave: Option<String>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

impl Pdos {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let session = self.target.bring_up(AlState::PreOp, REQUEST_CYCLE)?;
        let only = self.slave.map(|slave| session.find(&slave)).transpose()?;
        if self.json {
            say(&object(&session, only).to_string())?;
        } else {
            say(text(&session, only).trim_end())?;
        }
        Ok(scan::verdict(session.master()))
    }
}

fn slaves<W: Wire>(
    session: &Session<W>,
    only: Option<usize>,
) -> impl Iterator<Item = SlaveView<'_>> {
    let master = session.master();
    (0..master.len())
        .filter(move |number| only.is_none_or(|only| only == *number))
        .filter_map(|number| master.slave(number))
}

/// The process data as text, one line per entry.
pub(super) fn text<W: Wire>(session: &Session<W>, only: Option<usize>) -> String {
    let mut text = String::new();
    for slave in slaves(session, only) {
        let process = slave.process();
        let _ = writeln!(
            text,
            "slave {} {}: {} bytes out, {} bytes in",
            slave.number(),
            scan::title(slave),
            process.outputs_len(),
            process.inputs_len()
        );
        if let Some(fault) = slave.fault() {
            let _ = writeln!(text, "  ! {fault}");
        }
        let (mut out, mut back) = (0, 0);
        for channel in &process.channels {
            let begin = if channel.outputs { &mut out } else { &mut back };
            channel_text(&mut text, channel, *begin);
            *begin += 8 * channel.len();
        }
    }
    text
}

fn direction(channel: &Channel) -> &'static str {
    if channel.outputs { "outputs" } else { "inputs" }
}

fn channel_text(text: &mut String, channel: &Channel, begin: usize) {
    let _ = writeln!(
        text,
        "  SyncManager {} {} at {:04X}h, {} bytes",
        channel.number,
        direction(channel),
        channel.start,
        channel.len()
    );
    let mut bit = begin;
    for pdo in &channel.pdos {
        let _ = writeln!(text, "    PDO {:04X}h, {} bits", pdo.index, pdo.bits());
        for (position, entry) in positions(pdo, &mut bit) {
            let (byte, rest) = (position / 8, position % 8);
            let object = if entry.address.index == 0 {
                "gap".to_owned()
            } else {
                entry.address.to_string()
            };
            let _ = writeln!(
                text,
                "      {byte:>4}.{rest}  {object:<9} {:>3} bits",
                entry.bits
            );
        }
    }
    if channel.pdos.is_empty() && !channel.is_empty() {
        text.push_str("    no PDOs are assigned\n");
    }
}

/// The entries of a PDO with their first bits; advances `bit` behind the last.
fn positions<'a>(
    pdo: &'a Pdo,
    bit: &mut usize,
) -> Vec<(usize, &'a takt_cia402::dictionary::Mapped)> {
    let mut all = Vec::new();
    for entry in &pdo.entries {
        all.push((*bit, entry));
        *bit += usize::from(entry.bits);
    }
    all
}

/// The process data as JSON.
pub(super) fn object<W: Wire>(session: &Session<W>, only: Option<usize>) -> Value {
    let slaves: Vec<Value> = slaves(session, only).map(slave_object).collect();
    json!({ "version": 1, "interface": session.interface(), "slaves": slaves })
}

fn slave_object(slave: SlaveView<'_>) -> Value {
    let (mut out, mut back) = (0, 0);
    let mut channels = Vec::new();
    for channel in &slave.process().channels {
        let begin = if channel.outputs { &mut out } else { &mut back };
        let mut bit = *begin;
        *begin += 8 * channel.len();
        let pdos: Vec<Value> = channel
            .pdos
            .iter()
            .map(|pdo| pdo_object(pdo, &mut bit))
            .collect();
        channels.push(json!({
            "sync_manager": channel.number,
            "direction": direction(channel),
            "start": channel.start,
            "bits": channel.bits(),
            "pdos": pdos,
        }));
    }
    json!({
        "slave": slave.number(),
        "name": scan::title(slave),
        "fault": slave.fault().map(|fault| fault.to_string()),
        "channels": channels,
    })
}

fn pdo_object(pdo: &Pdo, bit: &mut usize) -> Value {
    let entries: Vec<Value> = positions(pdo, bit)
        .into_iter()
        .map(|(position, entry)| {
            json!({
                "index": entry.address.index,
                "sub": entry.address.sub,
                "bits": entry.bits,
                "bit": position,
            })
        })
        .collect();
    json!({ "index": pdo.index, "entries": entries })
}

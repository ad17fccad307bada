//! `takt ecat cell`: a segment as a cell file has it, from a scan: slaves, axes, SYNC0, inputs and outputs; with ESI files
//! also start-up commands, PDOs and names. What the slaves do not report (limits, gear ratios) is left to the user, in a
//! commented table.

mod arm;
mod pdos;

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::{Context as _, ensure};
use clap::Args;
use takt_cia402::dictionary::Mapped;
use takt_ethercat::AlState;
use takt_ethercat::master::{Master, SlaveView};

use super::esi::{self, Device};
use super::session::{Session, Wire};
use super::{REQUEST_CYCLE, Target, scan};
use crate::Verdict;
use crate::output::{complain, save, say};
use pdos::Assigned;

/// Write the segment of a cell file from a scan.
///
/// Brings all slaves to PRE-OP, where outputs are inactive. Exit status: 0 written; 1 a slave does not reach PRE-OP, and what is
/// written of it may be incomplete; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat cell enp2s0 > cell.toml
  takt ecat cell enp2s0 --name line --esi drive.xml --esi terminals.xml --to cell.toml")]
pub(crate) struct Cell {
    #[command(flatten)]
    target: Target,
    /// Name of the segment.
    #[arg(long, default_value = "segment")]
    name: String,
    /// An ESI file with start-up commands, DC modes and names; may be repeated.
    #[arg(long, value_name = "FILE")]
    esi: Vec<PathBuf>,
    /// Write to this new file instead of standard output.
    #[arg(long, value_name = "FILE")]
    to: Option<PathBuf>,
}

impl Cell {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        if let Some(to) = &self.to {
            ensure!(
                !to.exists(),
                "{} exists\nhint: name a new file",
                to.display()
            );
        }
        let mut devices = Vec::new();
        for path in &self.esi {
            devices.extend(esi::devices(path)?);
        }
        let session = self.target.bring_up(AlState::PreOp, REQUEST_CYCLE)?;
        let second = self.target.second.as_deref();
        let text = text(&session, &self.name, second, &devices)?;
        for warning in warnings(session.master(), &devices) {
            complain(&warning);
        }
        match &self.to {
            Some(to) => {
                save(to, &text)?;
                say(&format!(
                    "{} slaves written to {}",
                    session.master().len(),
                    to.display()
                ))?;
            }
            None => say(text.trim_end())?,
        }
        let verdict = scan::verdict(session.master());
        if verdict != Verdict::Good {
            complain("takt: not all slaves are in PRE-OP; see `takt ecat scan`");
        }
        Ok(verdict)
    }
}

/// Most channels of the inputs and outputs that are written.
const CHANNELS_MAX: usize = 256;

/// The cell file.
pub(super) fn text<W: Wire>(
    session: &Session<W>,
    name: &str,
    second: Option<&str>,
    devices: &[Device],
) -> anyhow::Result<String> {
    let master = session.master();
    let quoted = |text: &str| toml::Value::String(text.to_owned()).to_string();
    let mut out = format!(
        "[[ethercat]]\nname = {}\ninterface = {}\n",
        quoted(name),
        quoted(session.interface())
    );
    if let Some(second) = second {
        let _ = writeln!(out, "second = {}", quoted(second));
    }
    out.push_str("cycle = '1ms'\n");
    let slaves = || (0..master.len()).filter_map(|number| master.slave(number));
    let mut channels = Channels::default();
    for slave in slaves() {
        let same_alias = slaves()
            .filter(|it| it.info().alias == slave.info().alias)
            .count();
        let assigned = pdos::assigned(slave, device_of(slave, devices));
        slave_text(&mut out, slave, same_alias == 1, devices, &assigned);
        channels.add(slave, &assigned);
    }
    channels.write(&mut out);
    let axes = slaves().map(|slave| (name_of(slave), axes(slave, device_of(slave, devices))));
    arm::write(&mut out, &axes.collect::<Vec<_>>());
    takt_devices::parse_cell(&out).context("the scan makes no valid cell")?;
    Ok(out)
}

fn device_of<'a>(slave: SlaveView<'_>, devices: &'a [Device]) -> Option<&'a Device> {
    let id = slave.info().identity;
    esi::find(devices, id.vendor, id.product, id.revision)
}

/// What the ESI files say of the detected slaves and the cell lacks, once per device.
fn warnings(master: &Master, devices: &[Device]) -> Vec<String> {
    let slaves = (0..master.len()).filter_map(|number| master.slave(number));
    let mut all = Vec::new();
    for (slave, device) in slaves.filter_map(|it| Some((it, device_of(it, devices)?))) {
        let left_out = device.left_out.iter().map(|it| {
            let Device { file, order, .. } = device;
            let (line, what, remedy) = (it.line, &it.what, it.remedy);
            format!("takt: {file}, line {line}: {order}: left out: {what}\nhint: {remedy}")
        });
        all.extend(left_out);
        let name = name_of(slave);
        let notes = pdos::assigned(slave, Some(device)).notes;
        all.extend(
            notes
                .into_iter()
                .map(|note| format!("takt: {name}: {note}")),
        );
    }
    let mut seen = std::collections::BTreeSet::new();
    all.retain(|it| seen.insert(it.clone()));
    all
}

/// The name of a slave in the cell: its order code and number.
fn name_of(slave: SlaveView<'_>) -> String {
    let info = slave.info();
    let base = if info.order.is_empty() {
        &info.name
    } else {
        &info.order
    };
    let base: String = base
        .chars()
        .map(|c| {
            if c.is_ascii_alphanumeric() {
                c.to_ascii_lowercase()
            } else {
                '_'
            }
        })
        .take(32)
        .collect();
    let base = if base.is_empty() { "slave" } else { &base };
    format!("{base}_{}", slave.number())
}

/// The text on one line, as a comment of a cell file.
fn comment(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).collect()
}

fn entries(slave: SlaveView<'_>, outputs: bool, assigned: &Assigned) -> Vec<Mapped> {
    let channels = slave.process().channels.iter();
    let channels = channels.filter(|channel| channel.outputs == outputs);
    let pdos = channels.flat_map(|channel| &channel.pdos);
    let pdos = pdos.filter(|pdo| !assigned.is_excluded(pdo.index));
    pdos.flat_map(|pdo| pdo.entries.iter().copied()).collect()
}

/// Most axes of a slave.
const AXES_MAX: u16 = 8;
/// From an object of one axis to that of the next.
const AXIS: u16 = 0x800;

/// Number of CiA 402 axes: control words of 16 bits among the outputs, or among the PDOs of the ESI file, from 6040h on.
fn axes(slave: SlaveView<'_>, device: Option<&Device>) -> usize {
    let mapped = entries(slave, true, &Assigned::default()).into_iter();
    let mapped = mapped.map(|it| (it.address.index, it.address.sub, u16::from(it.bits)));
    let listed = device.into_iter().flat_map(|it| &it.rx_pdos);
    let listed = listed.flat_map(|pdo| pdo.entries.iter().map(|it| (it.0, it.1, it.2)));
    let all: Vec<(u16, u8, u16)> = mapped.chain(listed).collect();
    let has = |axis: &u16| all.contains(&(0x6040 + AXIS * axis, 0, 16));
    (0..AXES_MAX).take_while(has).count()
}

fn slave_text(
    out: &mut String,
    slave: SlaveView<'_>,
    has_own_alias: bool,
    devices: &[Device],
    assigned: &Assigned,
) {
    let info = slave.info();
    let id = info.identity;
    let device = device_of(slave, devices);
    let title = device.map_or_else(|| scan::title(slave), |device| device.name.as_str());
    let _ = writeln!(
        out,
        "\n# {}, revision {:08X}h, serial {}",
        comment(title),
        id.revision,
        id.serial
    );
    if let Some(fault) = slave.fault() {
        let _ = writeln!(
            out,
            "# It does not reach PRE-OP: {}",
            comment(&fault.to_string())
        );
    }
    let _ = writeln!(out, "[[ethercat.slave]]\nname = '{}'", name_of(slave));
    let _ = match info.alias {
        alias if alias > 0 && has_own_alias => writeln!(out, "alias = {alias}"),
        _ => writeln!(out, "position = {}", slave.position().unwrap_or_default()),
    };
    let _ = writeln!(
        out,
        "vendor = 0x{:08X}\nproduct = 0x{:08X}",
        id.vendor, id.product
    );
    let axes = axes(slave, device);
    if axes > 0 {
        let _ = writeln!(out, "axes = {axes}");
    }
    let clocks = device.map(|device| &device.clocks[..]).unwrap_or_default();
    let mode = clocks
        .iter()
        .find(|mode| matches!(mode.assign_activate, 0x0300 | 0x0700));
    if info.has_clock() && info.clock_bits() == 64 && (mode.is_some() || axes > 0) {
        out.push_str("sync0 = true\n");
        match mode {
            Some(mode) if mode.assign_activate == 0x0700 && mode.shift1_ns > 0 => {
                let _ = writeln!(out, "sync1 = '{}ns'", mode.shift1_ns);
            }
            Some(mode) if mode.assign_activate == 0x0700 => {
                out.push_str("# Its DC mode has SYNC1 too: give `sync1` as its manual demands.\n");
            }
            Some(_) | None => {}
        }
        if let Some(mode) = mode.filter(|mode| mode.shift0_ns != 0) {
            let _ = writeln!(out, "shift = '{}ns'", mode.shift0_ns);
        }
    }
    assigned.write(out, device);
    let startup = device.map(|device| &device.startup[..]).unwrap_or_default();
    for it in startup {
        let what = comment(&it.comment);
        if !it.is_for_pre_op() || it.data.is_empty() {
            let (index, sub) = (it.index, it.sub);
            let _ = writeln!(
                out,
                "# Not taken: {index:04X}h:{sub:02X} at {}: {what}",
                comment(&it.transition)
            );
            continue;
        }
        let _ = writeln!(
            out,
            "[[ethercat.slave.startup]] # {what}\nindex = 0x{:04X}\nsub = {}\nvalue = {{ bytes = {:?} }}\ncomplete = {}",
            it.index, it.sub, it.data, it.complete
        );
    }
}

/// Inputs and outputs of slaves without axes.
#[derive(Debug, Default)]
struct Channels {
    /// Slave and bits, of inputs and outputs.
    digital: [Vec<String>; 2],
    analogue: [Vec<String>; 2],
}

impl Channels {
    fn add(&mut self, slave: SlaveView<'_>, assigned: &Assigned) {
        if axes(slave, None) > 0 {
            return;
        }
        let name = name_of(slave);
        for (side, outputs) in [false, true].into_iter().enumerate() {
            let all = entries(slave, outputs, assigned);
            let bits = all.len();
            if bits > 0 && all.iter().all(|it| it.bits == 1) {
                self.digital[side].push(format!("['{name}', {bits}]"));
                continue;
            }
            let numbers = all
                .iter()
                .filter(|it| it.address.index != 0 && (8..=32).contains(&it.bits));
            let room = CHANNELS_MAX.saturating_sub(self.analogue[side].len());
            self.analogue[side].extend(numbers.take(room).map(|it| {
                format!(
                    "{{ slave = '{name}', object = [0x{:04X}, {}] }}",
                    it.address.index, it.address.sub
                )
            }));
        }
    }

    fn write(&self, out: &mut String) {
        let all = [
            ("digital_in", &self.digital[0]),
            ("digital_out", &self.digital[1]),
            ("analogue_in", &self.analogue[0]),
            ("analogue_out", &self.analogue[1]),
        ];
        if all.iter().all(|(_, list)| list.is_empty()) {
            return;
        }
        out.push_str("\n[[ethercat.io]]\nname = 'io'\n");
        for (key, list) in all.into_iter().filter(|(_, list)| !list.is_empty()) {
            let _ = writeln!(out, "{key} = [{}]", list.join(", "));
        }
    }
}

#[cfg(test)]
mod tests;

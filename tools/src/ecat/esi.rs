//! ESI files (EtherCAT Slave Information, ETG.2000): names, PDOs, start-up commands, modes of the distributed clock and the
//! objects of a device, for `takt ecat cell`, and as a list. What is left out (modules, for instance) is named with its line.

mod choice;
mod left_out;
mod xml;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;

pub(super) use choice::{Choice, choose};
pub(super) use left_out::LeftOut;
use xml::{Node, number, tree};

use crate::Verdict;
use crate::output::say;

/// Print the devices of an ESI file: PDOs, start-up commands, DC modes, objects.
///
/// Exit status: 0 read; 2 it could not be read.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat esi --from drive.xml
  takt ecat esi --from drive.xml --objects")]
pub(crate) struct Esi {
    /// The file.
    #[arg(long, value_name = "FILE")]
    from: PathBuf,
    /// List the object dictionaries too.
    #[arg(long)]
    objects: bool,
}

impl Esi {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        for device in devices(&self.from)? {
            say(device.text(self.objects).trim_end())?;
        }
        Ok(Verdict::Good)
    }
}

/// Longest file, bytes: those of large vendors have some 50 MB.
const FILE_MAX: u64 = 128 << 20;
/// A device of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Device {
    /// The file.
    pub(super) file: String,
    pub(super) vendor: u32,
    pub(super) product: u32,
    pub(super) revision: u32,
    /// Order code.
    pub(super) order: String,
    pub(super) name: String,
    pub(super) rx_pdos: Vec<Pdo>,
    pub(super) tx_pdos: Vec<Pdo>,
    pub(super) startup: Vec<Command>,
    pub(super) clocks: Vec<Clock>,
    pub(super) has_coe: bool,
    /// Whether the slave describes its objects itself (SDO information).
    pub(super) has_information: bool,
    /// Whether the master may choose the PDOs (PDO assignment).
    pub(super) has_assignment: bool,
    pub(super) objects: Vec<Object>,
    /// What the file says of the device and is not read.
    pub(super) left_out: Vec<LeftOut>,
}

/// A PDO.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Pdo {
    pub(super) index: u16,
    pub(super) name: String,
    /// `None` if it is not assigned by default.
    pub(super) sync_manager: Option<u8>,
    pub(super) is_fixed: bool,
    /// Whether it must be assigned.
    pub(super) is_mandatory: bool,
    /// PDOs that cannot be assigned together with it.
    pub(super) excludes: Vec<u16>,
    /// Index, sub-index, bits and name; index 0 is a gap.
    pub(super) entries: Vec<(u16, u8, u16, String)>,
}

/// A start-up command (CoE).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Command {
    /// The state changes at which it is written, such as IP, PS, SO, in between blanks.
    pub(super) transition: String,
    pub(super) index: u16,
    pub(super) sub: u8,
    pub(super) data: Vec<u8>,
    pub(super) complete: bool,
    pub(super) comment: String,
}

/// A mode of the distributed clock.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Clock {
    pub(super) name: String,
    pub(super) assign_activate: u16,
    /// Shift of SYNC0 and SYNC1, ns.
    pub(super) shift0_ns: i64,
    pub(super) shift1_ns: i64,
}

/// An object.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Object {
    pub(super) index: u16,
    pub(super) name: String,
    pub(super) data_type: String,
    pub(super) bits: u32,
}

/// Reads the devices of a file.
pub(super) fn devices(path: &Path) -> anyhow::Result<Vec<Device>> {
    let name = path.display();
    let bytes =
        takt_core::files::read(path, FILE_MAX).with_context(|| format!("cannot read {name}"))?;
    // Files of some vendors are not UTF-8 in their German names.
    let text = String::from_utf8_lossy(&bytes);
    let devices = parse(text.trim_start_matches('\u{feff}'));
    let mut devices = devices.with_context(|| name.to_string())?;
    for device in &mut devices {
        device.file = name.to_string();
    }
    Ok(devices)
}

/// The devices of the text of a file.
pub(super) fn parse(text: &str) -> anyhow::Result<Vec<Device>> {
    let root = tree(text)?;
    let info = root
        .child("EtherCATInfo")
        .context("no ESI file: the element EtherCATInfo is missing")?;
    let vendor = info.child("Vendor");
    let vendor = vendor.map_or(Ok(0), |vendor| vendor.number_of("Id"))?;
    let devices = info.path(&["Descriptions", "Devices", "Device"]);
    devices
        .into_iter()
        .map(|node| {
            Ok(Device {
                left_out: left_out::of(node, info),
                ..device(node, vendor)?
            })
        })
        .collect()
}

fn device(node: &Node, vendor: u32) -> anyhow::Result<Device> {
    let kind = node.child("Type");
    let attribute = |name: &str| {
        let Some(text) = kind.and_then(|kind| kind.attribute(name)) else {
            return Ok(0);
        };
        let value = number(text).and_then(|it| u32::try_from(it).ok());
        value.with_context(|| format!("{name} of a device: `{text}` is no number of 4 bytes"))
    };
    let coe = node.path(&["Mailbox", "CoE"]);
    let shift = |mode: &Node, name: &str| match mode.text_of(name).as_str() {
        "" => Ok(0),
        text => text
            .parse()
            .with_context(|| format!("{name}: `{text}` is no number of ns")),
    };
    let clock = |mode: &Node| -> anyhow::Result<Clock> {
        Ok(Clock {
            name: mode.text_of("Name"),
            assign_activate: mode.number_of("AssignActivate")?,
            shift0_ns: shift(mode, "ShiftTimeSync0")?,
            shift1_ns: shift(mode, "ShiftTimeSync1")?,
        })
    };
    let coe_is_set = |name: &str| coe.iter().any(|coe| coe.is_set(name));
    let object = |object: &Node| -> anyhow::Result<Object> {
        Ok(Object {
            index: object.number_of("Index")?,
            name: object.english("Name"),
            data_type: object.text_of("Type"),
            bits: object.number_of("BitSize")?,
        })
    };
    let objects = node.path(&["Profile", "Dictionary", "Objects", "Object"]);
    let commands = node.path(&["Mailbox", "CoE", "InitCmd"]);
    Ok(Device {
        vendor,
        product: attribute("ProductCode")?,
        revision: attribute("RevisionNo")?,
        order: kind.map_or_else(String::new, |kind| kind.text.trim().to_owned()),
        name: node.english("Name"),
        rx_pdos: node.all("RxPdo").map(pdo).collect::<Result<_, _>>()?,
        tx_pdos: node.all("TxPdo").map(pdo).collect::<Result<_, _>>()?,
        startup: commands
            .into_iter()
            .map(command)
            .collect::<Result<_, _>>()?,
        clocks: node
            .path(&["Dc", "OpMode"])
            .into_iter()
            .map(clock)
            .collect::<Result<_, _>>()?,
        has_coe: !coe.is_empty(),
        has_information: coe_is_set("SdoInfo"),
        has_assignment: coe_is_set("PdoAssign"),
        objects: objects.into_iter().map(object).collect::<Result<_, _>>()?,
        ..Device::default()
    })
}

fn pdo(node: &Node) -> anyhow::Result<Pdo> {
    let entry = |entry: &Node| -> anyhow::Result<_> {
        Ok((
            entry.number_of("Index")?,
            entry.number_of("SubIndex")?,
            entry.number_of("BitLen")?,
            entry.english("Name"),
        ))
    };
    let sync_manager = node.attribute("Sm").and_then(number);
    Ok(Pdo {
        index: node.number_of("Index")?,
        name: node.english("Name"),
        sync_manager: sync_manager.and_then(|it| u8::try_from(it).ok()),
        is_fixed: node.is_set("Fixed"),
        is_mandatory: node.is_set("Mandatory"),
        excludes: node
            .all("Exclude")
            .map(excluded)
            .collect::<Result<_, _>>()?,
        entries: node.all("Entry").map(entry).collect::<Result<_, _>>()?,
    })
}

fn excluded(node: &Node) -> anyhow::Result<u16> {
    let (text, line) = (node.text.trim(), node.line);
    let index = number(text).and_then(|it| u16::try_from(it).ok());
    index.with_context(|| format!("line {line}: Exclude: `{text}` is no index of a PDO"))
}

fn command(node: &Node) -> anyhow::Result<Command> {
    let text = node.text_of("Data");
    let data = bytes(&text)
        .with_context(|| format!("Data of an InitCmd: `{text}` is no sequence of bytes"))?;
    Ok(Command {
        transition: transitions(node),
        index: node.number_of("Index")?,
        sub: node.number_of("SubIndex")?,
        data,
        complete: node.is_set("CompleteAccess"),
        comment: node.english("Comment"),
    })
}

/// The state changes of a command, in between blanks.
fn transitions(node: &Node) -> String {
    let all = node.all("Transition").map(|it| it.text.trim());
    all.collect::<Vec<_>>().join(" ")
}

impl Command {
    /// Whether it is written in PRE-OP, where start-up objects of a cell are.
    pub(super) fn is_for_pre_op(&self) -> bool {
        let mut all = self.transition.split_whitespace();
        all.any(|it| matches!(it, "IP" | "PS"))
    }
}

/// Bytes as pairs of hexadecimal digits, with white space anywhere between digits.
fn bytes(text: &str) -> Option<Vec<u8>> {
    let digits = text.chars().filter(|it| !it.is_whitespace());
    let digits: Option<Vec<u8>> = digits
        .map(|it| it.to_digit(16).and_then(|it| u8::try_from(it).ok()))
        .collect();
    let pairs = digits?;
    let pairs = pairs.chunks(2).map(|pair| match pair {
        [high, low] => Some(high * 16 + low),
        _ => None,
    });
    pairs.collect()
}

/// The device of an identity: of equal revision, else the newest that is not newer, else the oldest.
pub(super) fn find(
    devices: &[Device],
    vendor: u32,
    product: u32,
    revision: u32,
) -> Option<&Device> {
    let of_product = || {
        let devices = devices.iter();
        devices.filter(move |it| it.vendor == vendor && it.product == product)
    };
    let not_newer = of_product().filter(|it| it.revision <= revision);
    let best = not_newer.max_by_key(|it| it.revision);
    best.or_else(|| of_product().min_by_key(|it| it.revision))
}

impl Pdo {
    /// What restricts its choice.
    fn notes(&self) -> String {
        let mut out = String::new();
        for (is_set, word) in [
            (self.is_fixed, ", fixed"),
            (self.is_mandatory, ", mandatory"),
        ] {
            out.push_str(if is_set { word } else { "" });
        }
        let excluded = self.excludes.iter().map(|it| format!("{it:04X}h"));
        let excluded = excluded.collect::<Vec<_>>().join(" ");
        if !excluded.is_empty() {
            let _ = write!(out, ", excludes {excluded}");
        }
        out
    }
}

impl Device {
    fn text(&self, objects: bool) -> String {
        let mut out = format!(
            "{} \"{}\": vendor {:08X}h product {:08X}h revision {:08X}h\n",
            self.order, self.name, self.vendor, self.product, self.revision
        );
        let coe = match (self.has_coe, self.has_information) {
            (true, true) => "with SDO information",
            (true, false) => "without SDO information: its objects are below",
            (false, _) => "none",
        };
        let _ = writeln!(out, "  CoE         {coe}");
        for (kind, pdos) in [("RxPDO", &self.rx_pdos), ("TxPDO", &self.tx_pdos)] {
            for pdo in pdos {
                let at = pdo.sync_manager.map_or_else(
                    || "not assigned".to_owned(),
                    |sm| format!("SyncManager {sm}"),
                );
                let _ = writeln!(
                    out,
                    "  {kind} {:04X}h \"{}\", {at}{}",
                    pdo.index,
                    pdo.name,
                    pdo.notes()
                );
                for (index, sub, bits, name) in &pdo.entries {
                    let entry = format!("    {index:04X}h:{sub:02X} {bits:>4} bits  {name}");
                    let _ = writeln!(out, "{}", entry.trim_end());
                }
            }
        }
        for it in &self.startup {
            let _ = writeln!(
                out,
                "  start-up {} {:04X}h:{:02X} <- {:02X?}  {}",
                it.transition, it.index, it.sub, it.data, it.comment
            );
        }
        for it in &self.clocks {
            let _ = writeln!(
                out,
                "  DC \"{}\": AssignActivate {:04X}h, shift {} ns, SYNC1 {} ns",
                it.name, it.assign_activate, it.shift0_ns, it.shift1_ns
            );
        }
        for it in &self.left_out {
            let _ = writeln!(
                out,
                "  left out, line {}: {}; {}",
                it.line, it.what, it.remedy
            );
        }
        for it in self
            .objects
            .iter()
            .filter(|_| objects || !self.has_information)
        {
            let _ = writeln!(
                out,
                "  {:04X}h {:>5} bits {:<12} {}",
                it.index, it.bits, it.data_type, it.name
            );
        }
        out
    }
}

#[cfg(test)]
pub(super) mod tests;

//! ESI files (EtherCAT Slave Information, ETG.2000): names, PDOs, start-up commands, modes of the distributed clock and the
//! objects of a device, for `takt ecat cell`, and as a list. Pictures, modules and what vendors add are left out.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail, ensure};
use clap::Args;
use quick_xml::escape::resolve_xml_entity;
use quick_xml::events::Event;
use quick_xml::{Reader, XmlVersion};

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
/// Most elements of a file, and deepest nesting.
const NODES_MAX: usize = 4_000_000;
const DEPTH_MAX: usize = 64;

/// A device of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Device {
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
    pub(super) objects: Vec<Object>,
}

/// A PDO.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Pdo {
    pub(super) index: u16,
    pub(super) name: String,
    /// `None` if it is not assigned by default.
    pub(super) sync_manager: Option<u8>,
    pub(super) is_fixed: bool,
    /// Index, sub-index, bits and name; index 0 is a gap.
    pub(super) entries: Vec<(u16, u8, u16, String)>,
}

/// A start-up command (CoE).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Command {
    /// The state change at which it is written: IP, PS, SO.
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

/// An element with what is inside.
#[derive(Debug, Default)]
struct Node {
    name: String,
    attributes: Vec<(String, String)>,
    text: String,
    children: Vec<Node>,
}

impl Node {
    fn child(&self, name: &str) -> Option<&Self> {
        self.children.iter().find(|child| child.name == name)
    }

    fn all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Self> {
        self.children.iter().filter(move |child| child.name == name)
    }

    /// The elements at the end of a path.
    fn path(&self, path: &[&str]) -> Vec<&Self> {
        let Some((first, rest)) = path.split_first() else {
            return vec![self];
        };
        let inside = self.children.iter().filter(|child| child.name == *first);
        inside.flat_map(|child| child.path(rest)).collect()
    }

    fn attribute(&self, name: &str) -> Option<&str> {
        let found = self.attributes.iter().find(|(key, _)| key == name);
        found.map(|(_, value)| value.as_str())
    }

    fn is_set(&self, name: &str) -> bool {
        matches!(self.attribute(name), Some("1" | "true"))
    }

    fn text_of(&self, name: &str) -> String {
        let child = self.child(name);
        child.map_or_else(String::new, |child| child.text.trim().to_owned())
    }

    /// The English one of several texts, or the first.
    fn english(&self, name: &str) -> String {
        let english = self
            .all(name)
            .find(|it| it.attribute("LcId") == Some("1033"));
        let found = english.or_else(|| self.child(name));
        found.map_or_else(String::new, |it| it.text.trim().to_owned())
    }

    /// The number in an element; 0 without the element.
    fn number_of<T: TryFrom<u64> + Default>(&self, name: &str) -> anyhow::Result<T> {
        let Some(child) = self.child(name) else {
            return Ok(T::default());
        };
        let (text, bytes) = (child.text.trim(), size_of::<T>());
        let value = number(text).and_then(|value| T::try_from(value).ok());
        value.with_context(|| {
            format!(
                "{name} in {}: `{text}` is no number of {bytes} bytes",
                self.name
            )
        })
    }
}

/// A number of an ESI file: `#x1A00` or decimal.
fn number(text: &str) -> Option<u64> {
    let text = text.trim();
    let prefixes = ["#x", "#X", "0x", "0X"];
    let hex = prefixes.iter().find_map(|it| text.strip_prefix(it));
    hex.map_or_else(
        || text.parse().ok(),
        |hex| u64::from_str_radix(hex, 16).ok(),
    )
}

/// Reads the devices of a file.
pub(super) fn devices(path: &Path) -> anyhow::Result<Vec<Device>> {
    let name = path.display();
    let bytes =
        takt_core::files::read(path, FILE_MAX).with_context(|| format!("cannot read {name}"))?;
    // Files of some vendors are not UTF-8 in their German names.
    let text = String::from_utf8_lossy(&bytes);
    parse(text.trim_start_matches('\u{feff}')).with_context(|| name.to_string())
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
        .map(|node| device(node, vendor))
        .collect()
}

fn tree(text: &str) -> anyhow::Result<Node> {
    let mut reader = Reader::from_str(text);
    let mut stack = vec![Node::default()];
    let mut nodes = 0;
    loop {
        let event = reader
            .read_event()
            .with_context(|| format!("at byte {}", reader.error_position()))?;
        match event {
            Event::Start(start) | Event::Empty(start) if stack.len() > DEPTH_MAX => {
                let name = start.name();
                bail!("{} is nested too deeply", name.as_ref())
            }
            Event::Start(start) => {
                nodes += 1;
                stack.push(node(&start)?);
            }
            Event::Empty(start) => {
                nodes += 1;
                if let Some(parent) = stack.last_mut() {
                    parent.children.push(node(&start)?);
                }
            }
            Event::End(_) => {
                let done = stack.pop().unwrap_or_default();
                let parent = stack
                    .last_mut()
                    .context("an element ends that never began")?;
                parent.children.push(done);
            }
            Event::Text(text) => {
                if let Some(node) = stack.last_mut() {
                    node.text.push_str(&text);
                }
            }
            Event::CData(text) => {
                if let Some(node) = stack.last_mut() {
                    node.text.push_str(&text);
                }
            }
            Event::Eof => break,
            Event::GeneralRef(entity) => {
                let named = || resolve_xml_entity(&entity).map(str::to_owned);
                let text = entity.resolve_char_ref()?.map(String::from).or_else(named);
                let text = text.with_context(|| format!("unknown entity &{};", &*entity))?;
                if let Some(node) = stack.last_mut() {
                    node.text.push_str(&text);
                }
            }
            Event::Comment(_) | Event::Decl(_) | Event::PI(_) | Event::DocType(_) => {}
        }
        ensure!(nodes <= NODES_MAX, "more than {NODES_MAX} elements");
    }
    ensure!(stack.len() == 1, "the file ends within an element");
    Ok(stack.pop().unwrap_or_default())
}

fn node(start: &quick_xml::events::BytesStart<'_>) -> anyhow::Result<Node> {
    let mut attributes = Vec::new();
    for attribute in start.attributes().take(64) {
        let attribute = attribute?;
        let key = attribute.key.as_ref().to_owned();
        let value = attribute.normalized_value(XmlVersion::Implicit1_0)?;
        attributes.push((key, value.into_owned()));
    }
    Ok(Node {
        name: start.name().as_ref().to_owned(),
        attributes,
        ..Node::default()
    })
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
        has_information: coe.iter().any(|coe| coe.is_set("SdoInfo")),
        objects: objects.into_iter().map(object).collect::<Result<_, _>>()?,
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
        entries: node.all("Entry").map(entry).collect::<Result<_, _>>()?,
    })
}

fn command(node: &Node) -> anyhow::Result<Command> {
    let text = node.text_of("Data");
    let data = bytes(&text)
        .with_context(|| format!("Data of an InitCmd: `{text}` is no sequence of bytes"))?;
    Ok(Command {
        transition: node.text_of("Transition"),
        index: node.number_of("Index")?,
        sub: node.number_of("SubIndex")?,
        data,
        complete: node.is_set("CompleteAccess"),
        comment: node.english("Comment"),
    })
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
                let fixed = if pdo.is_fixed { ", fixed" } else { "" };
                let _ = writeln!(
                    out,
                    "  {kind} {:04X}h \"{}\", {at}{fixed}",
                    pdo.index, pdo.name
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
pub(super) mod tests {
    use super::*;

    /// A file as vendors write them, in the words of the emulated drive.
    pub(in crate::ecat) const DRIVE: &str = r##"<?xml version="1.0"?>
<EtherCATInfo Version="1.6"><Vendor><Id>#x7A87</Id><Name>Takt</Name></Vendor><Descriptions><Devices>
<Device Physics="YY"><Type ProductCode="#x4021" RevisionNo="#x10000">TK4021</Type>
<Name LcId="1031"><![CDATA[Antrieb]]></Name><Name LcId="1033"><![CDATA[Servo drive]]></Name>
<Profile><ProfileNo>402</ProfileNo><Dictionary><Objects>
<Object><Index>#x6041</Index><Name>Status word</Name><Type>UINT</Type><BitSize>16</BitSize></Object>
</Objects></Dictionary></Profile>
<RxPdo Fixed="1" Sm="2"><Index>#x1600</Index><Name>out</Name>
<Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen><Name>Control word</Name><DataType>UINT</DataType></Entry>
<Entry><Index>#x607A</Index><SubIndex>0</SubIndex><BitLen>32</BitLen><Name>Target</Name></Entry></RxPdo>
<TxPdo Sm="3"><Index>#x1A00</Index><Name>in</Name>
<Entry><Index>#x6041</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>
<Entry><Index>0</Index><BitLen>8</BitLen></Entry>
<Entry><Index>#x6064</Index><SubIndex>0</SubIndex><BitLen>32</BitLen></Entry></TxPdo>
<Mailbox><CoE SdoInfo="0" CompleteAccess="1"><InitCmd><Transition>PS</Transition><Index>#x6060</Index>
<SubIndex>0</SubIndex><Data>08</Data><Comment>CSP</Comment></InitCmd></CoE></Mailbox>
<Dc><OpMode><Name>SM</Name><AssignActivate>#x0</AssignActivate></OpMode>
<OpMode><Name>DC</Name><AssignActivate>#x300</AssignActivate><ShiftTimeSync0>-250000</ShiftTimeSync0></OpMode></Dc>
</Device></Devices></Descriptions></EtherCATInfo>"##;

    #[test]
    fn esi_device_has_pdos_commands_clocks_and_objects() {
        let devices = parse(DRIVE).unwrap();
        let device = &devices[0];
        assert_eq!(
            (device.vendor, device.product, device.revision),
            (0x7A87, 0x4021, 0x1_0000)
        );
        assert_eq!(
            (device.order.as_str(), device.name.as_str()),
            ("TK4021", "Servo drive")
        );
        let pdo = &device.rx_pdos[0];
        assert_eq!(
            (pdo.index, pdo.sync_manager, pdo.is_fixed),
            (0x1600, Some(2), true)
        );
        assert_eq!(pdo.entries[1], (0x607A, 0, 32, "Target".to_owned()));
        assert_eq!(device.tx_pdos[0].entries[1], (0, 0, 8, String::new()));
        assert_eq!(
            (device.startup[0].index, &device.startup[0].data[..]),
            (0x6060, &[8][..])
        );
        assert_eq!(
            (device.clocks[1].assign_activate, device.clocks[1].shift0_ns),
            (0x300, -250_000)
        );
        assert!(device.has_coe && !device.has_information);
        let text = device.text(false);
        assert!(
            text.contains("6041h    16 bits UINT         Status word"),
            "{text}"
        );
    }

    #[test]
    fn esi_vendor_spellings_are_read() {
        let text = DRIVE
            .replace("#x4021", "#X4021")
            .replace("<Data>08<", "<Data>08 01\n 0A<")
            .replace("<BitLen>8<", "<BitLen>1024<")
            .replace("<Name>Target<", "<Name>Target &amp; &#956;<");
        let device = &parse(&text).unwrap()[0];
        assert_eq!(device.product, 0x4021);
        assert_eq!(device.startup[0].data, [8, 1, 10]);
        assert_eq!(device.tx_pdos[0].entries[1].2, 1024);
        assert_eq!(device.rx_pdos[0].entries[1].3, "Target & \u{3bc}");
    }

    #[test]
    fn esi_revision_is_matched_by_age() {
        let of = |revision| Device {
            product: 1,
            revision,
            ..Device::default()
        };
        let devices = [of(1), of(5), of(9)];
        let found = |revision| find(&devices, 0, 1, revision).map(|it| it.revision);
        assert_eq!(
            [found(5), found(7), found(0), found(99)],
            [Some(5), Some(5), Some(1), Some(9)]
        );
        assert!(find(&devices, 0, 2, 1).is_none());
    }

    #[test]
    fn esi_broken_file_is_rejected_with_cause() {
        for (text, cause) in [
            ("<a/>", "EtherCATInfo is missing"),
            ("<EtherCATInfo><Vendor>", "ends within an element"),
            ("<EtherCATInfo></Vendor>", "at byte"),
            (
                "<EtherCATInfo><Vendor><Id>&eacute;</Id>",
                "unknown entity &eacute;",
            ),
            (
                &DRIVE.replace("<Data>08<", "<Data>081<"),
                "`081` is no sequence of bytes",
            ),
            (
                &DRIVE.replace("<Data>08<", "<Data>0g<"),
                "`0g` is no sequence of bytes",
            ),
            (
                &DRIVE.replace("#x4021", "4021h"),
                "ProductCode of a device: `4021h` is no number",
            ),
            (
                &DRIVE.replace("#x6041", "#x16041"),
                "`#x16041` is no number of 2 bytes",
            ),
        ] {
            let error = format!("{:#}", parse(text).unwrap_err());
            assert!(error.contains(cause), "{error}");
        }
        let deep = "<a>".repeat(100);
        assert!(parse(&deep).unwrap_err().to_string().contains("too deeply"));
    }
}

//! An SII image as text: the fixed words, then the categories. It checks only the checksum and the end.

use std::fmt::Write as _;

use takt_cia402::dictionary::DataType;
use takt_ethercat::sii::{self, Category, MailboxAreas, SiiPdo, word};

/// The whole image, under a title.
pub(crate) fn text(title: &str, bytes: &[u8]) -> String {
    let image = sii::Sii::new(bytes);
    let mut text = format!("{title}: SII, {} bytes", bytes.len());
    let _ = match image.used() {
        Some(used) => writeln!(text, ", {used} used"),
        None => writeln!(
            text,
            "\n! the end category is missing; the image is truncated"
        ),
    };
    fixed(&mut text, &image, bytes);
    for (category, data) in image.categories() {
        let _ = writeln!(
            text,
            "category {} {}, {} bytes",
            category.raw(),
            name(category),
            data.len()
        );
        match category {
            Category::Strings => strings(&mut text, &image, data),
            Category::General => general(&mut text, &image),
            Category::Fmmu => fmmus(&mut text, data),
            Category::SyncManager => sync_managers(&mut text, &image),
            Category::TxPdo | Category::RxPdo => {
                for pdo in image.pdos(category) {
                    pdo_text(&mut text, &image, &pdo);
                }
            }
            Category::Dc => clocks(&mut text, &image),
            Category::Other(_) => bytes_text(&mut text, data),
        }
    }
    text
}

/// The name of a category (ETG.2010).
const fn name(category: Category) -> &'static str {
    match category {
        Category::Strings => "strings",
        Category::General => "general",
        Category::Fmmu => "FMMU",
        Category::SyncManager => "SyncManagers",
        Category::TxPdo => "TxPDOs",
        Category::RxPdo => "RxPDOs",
        Category::Dc => "DC",
        Category::Other(0) => "nothing",
        Category::Other(20) => "data types",
        Category::Other(42) => "FMMU extension",
        Category::Other(43) => "SYNC units",
        Category::Other(0x0800..=0x0FFF | 0x2000..=0xFFFE) => "of the vendor",
        Category::Other(_) => "unknown",
    }
}

fn fixed(text: &mut String, image: &sii::Sii<'_>, bytes: &[u8]) {
    let at = |word| image.word(word).unwrap_or(0);
    if let Some(identity) = image.identity() {
        let _ = writeln!(text, "  identity    {identity}");
    }
    let _ = writeln!(text, "  alias       {}", at(word::ALIAS));
    let expected = bytes.get(..14).map_or(0, sii::checksum);
    let stored = bytes.get(14).copied().unwrap_or(0);
    let _ = if image.is_checked() {
        writeln!(text, "  checksum    {stored:02X}h, correct")
    } else {
        writeln!(
            text,
            "! checksum    {stored:02X}h instead of {expected:02X}h: the slave controller does not load words 0 to 6"
        )
    };
    let [control, controller] = at(0).to_le_bytes();
    let _ = writeln!(
        text,
        "  PDI         control {control:02X}h ({}), configuration {:04X}h\n  controller  {}, SYNC pulse {} ns",
        pdi(control),
        at(1),
        named(controller.into(), &CONTROLLER),
        u32::from(at(2)) * 10
    );
    mailbox(text, "mailbox", image.mailbox(word::MAILBOX));
    mailbox(text, "in BOOT", image.mailbox(word::BOOT_MAILBOX));
    let protocols = ["AoE", "EoE", "CoE", "FoE", "SoE", "VoE"];
    let protocols = named(image.protocols().unwrap_or(0).into(), &protocols);
    let _ = writeln!(text, "  protocols   {protocols}");
    let _ = writeln!(
        text,
        "  EEPROM      {} bytes, version {}",
        image
            .size()
            .map_or_else(|| "?".to_owned(), |size| size.to_string()),
        at(word::SIZE + 1)
    );
}

/// Bits of the configuration of the slave controller (register 0141h).
const CONTROLLER: [&str; 8] = [
    "states by the controller itself",
    "enhanced link detection",
    "DC SYNC unit",
    "DC latch unit",
    "enhanced link port 0",
    "enhanced link port 1",
    "enhanced link port 2",
    "enhanced link port 3",
];

/// The process data interface (register 0140h).
const fn pdi(control: u8) -> &'static str {
    match control {
        0x00 => "none",
        0x04 => "digital I/O",
        0x05 => "SPI",
        0x07 => "EtherCAT bridge",
        0x08 => "16 bit microcontroller, asynchronous",
        0x09 => "8 bit microcontroller, asynchronous",
        0x0A => "16 bit microcontroller, synchronous",
        0x0B => "8 bit microcontroller, synchronous",
        0x10 => "32 digital inputs",
        0x11 => "24 digital inputs, 8 outputs",
        0x12 => "16 digital inputs, 16 outputs",
        0x13 => "8 digital inputs, 24 outputs",
        0x14 => "32 digital outputs",
        0x80 => "on-chip bus",
        _ => "unknown",
    }
}

fn mailbox(text: &mut String, label: &str, areas: Option<MailboxAreas>) {
    let Some(areas) = areas.filter(|areas| areas.receive_len > 0 || areas.send_len > 0) else {
        return;
    };
    let _ = writeln!(
        text,
        "  {label:<10}  receives at {:04X}h {} bytes, sends at {:04X}h {} bytes",
        areas.receive, areas.receive_len, areas.send, areas.send_len
    );
}

/// Names of the bits that are set, from bit 0; bits without a name by number.
fn named(bits: u32, names: &[&str]) -> String {
    let mut all: Vec<String> = Vec::new();
    for bit in 0..32 {
        if bits >> bit & 1 != 0 {
            all.push(
                names
                    .get(bit)
                    .map_or_else(|| format!("bit {bit}"), |name| (*name).to_owned()),
            );
        }
    }
    if all.is_empty() {
        "none".to_owned()
    } else {
        all.join(", ")
    }
}

/// A string by its number, in quotes.
fn quoted(image: &sii::Sii<'_>, number: u8) -> String {
    match (number, image.string(number)) {
        (0, _) => "-".to_owned(),
        (_, Some(text)) => format!("{text:?}"),
        (_, None) => format!("string {number}, which does not exist"),
    }
}

fn strings(text: &mut String, image: &sii::Sii<'_>, data: &[u8]) {
    for number in 1..=data.first().copied().unwrap_or(0) {
        let _ = writeln!(text, "  {number:>3}  {}", quoted(image, number));
    }
}

fn general(text: &mut String, image: &sii::Sii<'_>) {
    let Some(general) = image.general() else {
        text.push_str("! the category is too short\n");
        return;
    };
    let coe = [
        "SDO",
        "information",
        "PDO assignment",
        "PDO configuration",
        "upload at start",
        "complete access",
    ];
    let flags = [
        "SAFE-OP",
        "no LRW",
        "mailbox repeated by the data link layer",
        "identification in AL status code",
        "identification in memory",
    ];
    let kinds = general.ports;
    let ports: Vec<&str> = (0..4)
        .map(|port| match kinds >> (4 * port) & 0xF {
            0 => "-",
            1 => "MII",
            3 => "E-bus",
            4 => "fast hot connect",
            _ => "?",
        })
        .collect();
    let yes = |on: u8| if on == 0 { "no" } else { "yes" };
    let _ = writeln!(
        text,
        "  name        {}, order {}, group {}, picture {}",
        quoted(image, general.name),
        quoted(image, general.order),
        quoted(image, general.group),
        quoted(image, general.image)
    );
    let _ = writeln!(text, "  CoE         {}", named(general.coe.into(), &coe));
    let _ = writeln!(
        text,
        "  FoE         {}, EoE {}",
        yes(general.foe),
        yes(general.eoe)
    );
    let _ = writeln!(
        text,
        "  flags       {}",
        named(general.flags.into(), &flags)
    );
    let _ = writeln!(text, "  ports       {}", ports.join(", "));
    let _ = writeln!(text, "  E-bus       {} mA", general.ebus_ma);
}

fn fmmus(text: &mut String, data: &[u8]) {
    for (number, kind) in data.iter().enumerate() {
        let kind = match kind {
            0 | 0xFF => continue,
            1 => "outputs",
            2 => "inputs",
            3 => "mailbox state",
            _ => "unknown",
        };
        let _ = writeln!(text, "  FMMU {number}  {kind}");
    }
}

fn sync_managers(text: &mut String, image: &sii::Sii<'_>) {
    for (number, sm) in image.sync_managers().enumerate() {
        let kind = match sm.kind {
            0 => "unused",
            1 => "mailbox out",
            2 => "mailbox in",
            3 => "outputs",
            4 => "inputs",
            _ => "unknown",
        };
        let on = if sm.enable & 1 == 0 { ", off" } else { "" };
        let _ = writeln!(
            text,
            "  SyncManager {number}  {kind:<11} at {:04X}h, {} bytes, control {:02X}h{on}",
            sm.start, sm.len, sm.control
        );
    }
}

fn pdo_text(text: &mut String, image: &sii::Sii<'_>, pdo: &SiiPdo<'_>) {
    let at = match pdo.sync_manager {
        0xFF => "not assigned".to_owned(),
        number => format!("SyncManager {number}"),
    };
    let _ = writeln!(
        text,
        "  PDO {:04X}h {}, {} bits, {at}",
        pdo.index,
        quoted(image, pdo.name),
        pdo.bits()
    );
    for entry in pdo.entries() {
        let _ = if entry.index == 0 {
            writeln!(text, "    gap       {:>3} bits", entry.bits)
        } else {
            let kind = DataType::from_raw(entry.data_type.into()).to_string();
            let name = match entry.name {
                0 => String::new(),
                name => quoted(image, name),
            };
            let line = format!(
                "    {:04X}h:{:02X}  {:>3} bits  {kind:<12} {name}",
                entry.index, entry.sub, entry.bits
            );
            writeln!(text, "{}", line.trim_end())
        };
    }
}

fn clocks(text: &mut String, image: &sii::Sii<'_>) {
    for clock in image.clocks() {
        let period = match clock.cycle_ns {
            0 => "the master's cycle".to_owned(),
            ns => format!("{ns} ns"),
        };
        let _ = writeln!(
            text,
            "  {}: AssignActivate {:04X}h, SYNC0 each {period} (factor {}), shift {} ns; SYNC1 factor {}, shift {} ns",
            quoted(image, clock.name),
            clock.assign_activate,
            clock.sync0_factor,
            clock.shift_ns,
            clock.sync1_factor,
            clock.shift1_ns
        );
    }
}

fn bytes_text(text: &mut String, data: &[u8]) {
    for chunk in data.chunks(16) {
        let _ = writeln!(text, "  {}", DataType::OctetString.show(chunk));
    }
}

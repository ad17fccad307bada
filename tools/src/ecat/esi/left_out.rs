//! What an ESI file says of a device and Takt does not read: each with its line and what to do instead. Elements that no
//! table here knows are named too, so that nothing of a vendor is dropped silently.

use super::transitions;
use super::xml::{Node, number};

/// A part of a device that is not read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::ecat) struct LeftOut {
    /// Line in the file.
    pub(in crate::ecat) line: u32,
    pub(in crate::ecat) what: String,
    pub(in crate::ecat) remedy: &'static str,
}

/// Elements of a device that are read, or that say nothing that a master needs.
const KNOWN: [&str; 26] = [
    "Type",
    "HideType",
    "AlternativeType",
    "Name",
    "Comment",
    "URL",
    "Info",
    "GroupType",
    "Profile",
    "Fmmu",
    "Sm",
    "Su",
    "RxPdo",
    "TxPdo",
    "Mailbox",
    "Dc",
    "Slots",
    "ESC",
    "Eeprom",
    "Image16x14",
    "ImageFile16x14",
    "ImageData16x14",
    "SubDevice",
    "VendorSpecific",
    "DeviceFeature",
    "UnitType",
];
/// Paths below a device, what they mean, and the remedy.
const PATHS: [(&[&str], &str, &str); 8] = [
    (
        &["Mailbox", "SoE"],
        "SoE (servo drive profile over the mailbox)",
        "control the device over CoE if it has CiA 402 objects; `takt` does not speak SoE",
    ),
    (
        &["Mailbox", "AoE"],
        "AoE (ADS over the mailbox)",
        "reach devices behind this slave by its CoE objects, if it has some; `takt` does not speak AoE",
    ),
    (
        &["Mailbox", "VoE"],
        "VoE (a protocol of the vendor over the mailbox)",
        "use the tool of the vendor for what it sets",
    ),
    (
        &["Mailbox", "EoE", "InitCmd"],
        "a start-up command of EoE",
        "set addresses by `takt ecat eoe`",
    ),
    (
        &["Dc", "OpMode", "Sm", "Pdo"],
        "the PDO assignment of a DC mode",
        "give the slave the `outputs` and `inputs` that the mode demands",
    ),
    (
        &["Profile", "DictionaryFile"],
        "the object dictionary, which is in another file",
        "list the objects of the device by `takt ecat sdo`",
    ),
    (
        &["SubDevice"],
        "a sub-device, which is a slave of its own on the wire",
        "give the ESI file that describes it, if it is another one",
    ),
    (
        &["VendorSpecific"],
        "data of the vendor",
        "see the manual of the device for settings that they stand for",
    ),
];
const ASSIGN: &str = "give the slave the `outputs` and `inputs` that `takt ecat pdos` shows";

/// What is not read of a device; `info` is the root, with the modules.
pub(super) fn of(device: &Node, info: &Node) -> Vec<LeftOut> {
    let mut all = Vec::new();
    let mut add = |line, what: String, remedy| all.push(LeftOut { line, what, remedy });
    if let Some(slots) = device.child("Slots") {
        let count = slots.all("Slot").count();
        let modules = info.path(&["Descriptions", "Modules", "Module"]).len();
        let what = format!(
            "modules in {count} slots (the file has {modules} modules): their PDOs, objects and start-up commands"
        );
        add(
            slots.line,
            what,
            "plug the modules before the scan, which reads their PDOs; add their start-up commands as `startup`",
        );
    }
    for (path, what, remedy) in PATHS {
        for node in device.path(path).into_iter().take(1) {
            add(node.line, what.to_owned(), remedy);
        }
    }
    for node in &device.children {
        if !KNOWN.contains(&node.name.as_str()) {
            let what = format!("the element {}", comment_free(&node.name));
            add(
                node.line,
                what,
                "see the manual of the device for what it means",
            );
        }
    }
    commands_and_modes(device, &mut add);
    pdos(device, &mut add);
    all.sort_by_key(|it| it.line);
    all
}

/// Receives a line, what is left out there, and the remedy.
type Add<'a> = &'a mut dyn FnMut(u32, String, &'static str);

fn commands_and_modes(device: &Node, add: Add<'_>) {
    for node in device.path(&["Mailbox", "CoE", "InitCmd"]) {
        let at = transitions(node);
        if !at.split_whitespace().any(|it| matches!(it, "IP" | "PS")) {
            let index = node.text_of("Index");
            let what = format!("the start-up command of {index} at `{at}`");
            add(
                node.line,
                what,
                "write the object by `takt ecat sdo` or from a program once the slave runs",
            );
        }
    }
    for mode in device.path(&["Dc", "OpMode"]) {
        for name in ["CycleTimeSync0", "CycleTimeSync1"] {
            if let Some(node) = mode.child(name).filter(|it| differs_from_cycle(it)) {
                let what = format!(
                    "{name} of DC mode `{}`, which differs from the cycle",
                    mode.text_of("Name")
                );
                add(
                    node.line,
                    what,
                    "choose `cycle` and `sync1` as the manual of the device demands",
                );
            }
        }
    }
}

fn pdos(device: &Node, add: Add<'_>) {
    for pdo in device.all("RxPdo").chain(device.all("TxPdo")) {
        let index = pdo.text_of("Index");
        let oversampled = pdo.attributes.iter().any(|(key, _)| key.starts_with("OS"));
        if oversampled {
            add(pdo.line, format!("oversampling of PDO {index}"), ASSIGN);
        }
        let by_slot = |node: &Node| {
            node.child("Index")
                .is_some_and(|it| it.is_set("DependOnSlot"))
        };
        if by_slot(pdo) || pdo.all("Entry").any(by_slot) {
            add(
                pdo.line,
                format!("the slot on which PDO {index} depends"),
                ASSIGN,
            );
        }
    }
}

/// Whether a cycle time of a DC mode is neither absent nor that of the master.
fn differs_from_cycle(node: &Node) -> bool {
    let factor = node.attribute("Factor").unwrap_or("1").trim();
    !matches!(factor, "0" | "1") || number(&node.text).is_some_and(|ns| ns != 0)
}

fn comment_free(text: &str) -> String {
    text.chars()
        .filter(|it| !it.is_control())
        .take(64)
        .collect()
}

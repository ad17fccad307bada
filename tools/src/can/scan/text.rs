//! The result of a scan as a table and as JSON. It sends no requests.

use std::fmt::Write as _;

use serde_json::{Value, json};
use takt_can::canopen::NodeId;
use takt_can::canopen::eds::Eds;

use super::survey::{Found, Report};
use crate::can::sheet::{identity as identity_of, name_of};

/// Frequent vendors by their CiA number; data sheets name the others.
const VENDORS: [(u32, &str); 8] = [
    (0x002, "Beckhoff"),
    (0x03B, "Lenze"),
    (0x06A, "Kollmorgen"),
    (0x09A, "Elmo"),
    (0x0AB, "Copley"),
    (0x0FB, "maxon"),
    (0x147, "Faulhaber"),
    (0x1DD, "Delta"),
];

/// Profiles by the low word of 1000h (CiA 301, clause 7.5.2.1).
const PROFILES: [(u16, &str); 10] = [
    (0, "no profile"),
    (401, "I/O module"),
    (402, "drive"),
    (404, "measuring device"),
    (405, "controller"),
    (406, "encoder"),
    (408, "hydraulic drive"),
    (410, "inclinometer"),
    (418, "battery"),
    (419, "battery charger"),
];

fn profile(device_type: u32) -> String {
    let [low, high, ..] = device_type.to_le_bytes();
    let number = u16::from_le_bytes([low, high]);
    match PROFILES.iter().find(|(known, _)| *known == number) {
        Some((0, name)) => (*name).to_owned(),
        Some((_, name)) => format!("{name} (CiA {number})"),
        None => format!("CiA {number}"),
    }
}

/// The names of the vendor and the product, from the data sheet of this product or vendor, or the table.
fn names(found: &Found, sheets: &[Eds]) -> (Option<String>, Option<String>) {
    let [vendor, product, ..] = found.identity;
    let of = |sheet: &Eds, key| name_of(sheet, key);
    let same_vendor = |sheet: &&Eds| vendor.is_some() && of(sheet, "VendorNumber") == vendor;
    let same = |sheet: &&Eds| same_vendor(sheet) && of(sheet, "ProductNumber") == product;
    let text = |sheet: Option<&Eds>, key| {
        let value = sheet.and_then(|sheet| sheet.info("DeviceInfo", key));
        value.filter(|text| !text.is_empty()).map(str::to_owned)
    };
    let known = VENDORS.iter().find(|(number, _)| Some(*number) == vendor);
    let vendor_name = text(sheets.iter().find(same_vendor), "VendorName")
        .or_else(|| known.map(|(_, name)| (*name).to_owned()));
    let product_name = text(sheets.iter().find(same), "ProductName");
    (vendor_name, product_name.or_else(|| found.name.clone()))
}

/// The data sheets that are of none of the nodes.
fn strangers(report: &Report, sheets: &[Eds]) -> Vec<String> {
    let is_same = |sheet: &Eds, found: &Found| {
        let shown = found.identity.iter().take(2);
        let differs = |(wanted, shown): (Option<u32>, &Option<u32>)| {
            wanted.is_some_and(|wanted| *shown != Some(wanted))
        };
        !identity_of(sheet).into_iter().zip(shown).any(differs)
    };
    let of_none = |sheet: &&Eds| !report.nodes.values().any(|found| is_same(sheet, found));
    let strangers = sheets.iter().filter(of_none);
    let named = strangers.map(|sheet| {
        let name = sheet
            .info("DeviceInfo", "ProductName")
            .unwrap_or("a device");
        let [vendor, product] = identity_of(sheet);
        format!(
            "the data sheet of {name} (vendor {}, product {}) is that of none of the nodes",
            hexadecimal(vendor),
            hexadecimal(product)
        )
    });
    named.collect()
}

fn hexadecimal(number: Option<u32>) -> String {
    number.map_or_else(|| "-".to_owned(), |number| format!("{number:X}h"))
}

pub(super) fn table(interface: &str, report: &Report, sheets: &[Eds]) -> String {
    let count = report.nodes.len();
    let plural = if count == 1 { "" } else { "s" };
    let mut text = format!("{interface}: {count} node{plural}\n");
    if !report.nodes.is_empty() {
        text.push_str("\nnode  state            heartbeat ms  device type            name\n");
    }
    for (node, found) in &report.nodes {
        rows(&mut text, *node, found, sheets);
    }
    if !report.unconfigured.is_empty() {
        let _ = writeln!(
            text,
            "\nwithout a number: {} devices (LSS)",
            report.unconfigured.len()
        );
    }
    for found in &report.unconfigured {
        let numbers = found.numbers().map(Some);
        let _ = writeln!(text, "      {}", identity(numbers, None));
    }
    for stranger in strangers(report, sheets) {
        let _ = writeln!(text, "WARN  {stranger}");
    }
    for finding in report.findings() {
        let finding = finding.to_string().replace('\n', "\n      ");
        let _ = writeln!(text, "FAIL  {finding}");
    }
    text
}

fn rows(text: &mut String, node: NodeId, found: &Found, sheets: &[Eds]) {
    let (vendor, product) = names(found, sheets);
    let state = found
        .state
        .map_or_else(|| "unknown".to_owned(), |state| state.to_string());
    let beat = found
        .heartbeat
        .map_or_else(|| "-".to_owned(), |beat| beat.as_millis().to_string());
    let kind = found.device_type.map_or_else(|| "-".to_owned(), profile);
    let _ = writeln!(
        text,
        "{:>4}  {state:<15}  {beat:>12}  {kind:<21}  {}",
        node.raw(),
        product.as_deref().unwrap_or("-"),
    );
    if found.identity[0].is_some() {
        let _ = writeln!(
            text,
            "      {}",
            identity(found.identity, vendor.as_deref())
        );
    }
}

fn identity(numbers: [Option<u32>; 4], vendor: Option<&str>) -> String {
    let [number, product, revision, serial] = numbers;
    let vendor = vendor.map_or_else(String::new, |name| format!(" {name}"));
    let serial = serial.map_or_else(|| "-".to_owned(), |serial| serial.to_string());
    format!(
        "vendor {}{vendor}, product {}, revision {}, serial {serial}",
        hexadecimal(number),
        hexadecimal(product),
        hexadecimal(revision),
    )
}

pub(super) fn json(interface: &str, report: &Report, sheets: &[Eds]) -> Value {
    let nodes = report.nodes.iter().map(|(node, found)| {
        let (vendor, product) = names(found, sheets);
        let [vendor_id, product_code, revision, serial] = found.identity;
        json!({
            "node": node.raw(), "state": found.state.map(|state| state.to_string()),
            "heartbeat_ms": found.heartbeat.map(|beat| beat.as_secs_f64() * 1e3), "boots": found.boots,
            "device_type": found.device_type, "profile": found.device_type.map(profile),
            "vendor": vendor_id, "vendor_name": vendor, "product": product_code, "product_name": product,
            "revision": revision, "serial": serial, "error_register": found.errors,
        })
    });
    let unconfigured = report.unconfigured.iter().map(|found| {
        json!({
            "vendor": found.vendor, "product": found.product, "revision": found.revision, "serial": found.serial,
        })
    });
    let findings = report.findings();
    let findings = findings
        .iter()
        .map(|finding| json!({"name": finding.name(), "cause": finding.to_string()}));
    json!({
        "version": 1, "interface": interface, "nodes": nodes.collect::<Vec<_>>(),
        "unconfigured": unconfigured.collect::<Vec<_>>(), "findings": findings.collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_can::canopen::NmtState;

    fn report() -> Report {
        let drive = Found {
            state: Some(NmtState::Operational),
            heartbeat: Some(std::time::Duration::from_millis(100)),
            device_type: Some(0x0002_0192),
            identity: [Some(0xFB), Some(0x6050_0000), Some(1), Some(4711)],
            name: Some("EPOS4".to_owned()),
            answers: 1,
            ..Found::default()
        };
        Report {
            nodes: [(NodeId::new(5).unwrap(), drive)].into(),
            unconfigured: vec![],
        }
    }

    #[test]
    fn scan_table_fits_80_columns() {
        let text = table("can0", &report(), &[]);
        assert!(text.lines().all(|line| line.len() <= 80), "{text}");
        for words in [
            "can0: 1 node",
            "   5  operational               100  drive (CiA 402)        EPOS4",
            "vendor FBh maxon, product 60500000h, revision 1h, serial 4711",
        ] {
            assert!(text.contains(words), "{words}\n{text}");
        }
    }

    #[test]
    fn scan_prefers_names_of_data_sheets() {
        let sheet = "[DeviceInfo]\nVendorName=maxon motor ag\nVendorNumber=0xFB\nProductName=EPOS4 50/15\n\
                     ProductNumber=0x60500000\n[1000]\nParameterName=Device type\nDataType=0x0007\nAccessType=ro\n";
        let sheet = Eds::parse(sheet).unwrap();
        let value = json("can0", &report(), std::slice::from_ref(&sheet));
        assert_eq!(value["nodes"][0]["vendor_name"], "maxon motor ag");
        assert_eq!(value["nodes"][0]["product_name"], "EPOS4 50/15");
        assert_eq!(value["nodes"][0]["serial"], 4711);
        assert_eq!(value["nodes"][0]["profile"], "drive (CiA 402)");
    }

    #[test]
    fn scan_names_data_sheets_of_other_devices() {
        let sheet = |product: &str| {
            let text = format!(
                "[DeviceInfo]\nVendorNumber=0xFB\nProductName=EPOS2\nProductNumber={product}\n[1000]\n\
                 ParameterName=Device type\nDataType=0x0007\nAccessType=ro\n"
            );
            Eds::parse(&text).unwrap()
        };
        let text = table("can0", &report(), &[sheet("0x60500000")]);
        assert!(!text.contains("WARN"), "{text}");
        let text = table("can0", &report(), &[sheet("0x60500001")]);
        assert!(
            text.contains(
                "WARN  the data sheet of EPOS2 (vendor FBh, product 60500001h) is that of none"
            ),
            "{text}"
        );
    }
}

//! All objects of a node at once: read into a configuration, or compared with one. Each entry is one transfer, so
//! a machine that runs is disturbed as little as by one.

use std::fmt::Write as _;

use serde_json::{Value, json};
use takt_can::canopen::NodeId;
use takt_can::canopen::eds::Eds;
use takt_can::canopen::network::Download;
use takt_cia402::dictionary::{AbortCode, Access, Address, DataType, Dictionary, Entry};

use super::line;
use crate::can::ask::{Answer, Asker, Refusal};
use crate::can::sheet::Sheet;
use crate::can::wire::Wire;

/// Bit rate of a configuration if the interface has none, kbit/s.
const KBIT: u32 = 1000;

/// What was read.
#[derive(Clone, Debug, Default)]
pub(super) struct Dump {
    values: Vec<(Address, Vec<u8>)>,
    refused: Vec<Refusal>,
}

fn entries(eds: &Eds) -> impl Iterator<Item = (Address, &Entry)> {
    eds.objects.iter().flat_map(|object| {
        let entries = object.entries.iter();
        entries.map(|(sub, entry)| (Address::new(object.index, *sub), entry))
    })
}

/// Reads all that can be read. A node that falls silent ends it.
pub(super) fn dump<W: Wire>(
    wire: &mut W,
    asker: &mut Asker,
    sheet: &Sheet,
    domains: bool,
) -> Answer<Dump> {
    let mut dump = Dump::default();
    let wanted = |entry: &Entry| {
        entry.access.is_readable() && (domains || entry.data_type != DataType::Domain)
    };
    for (address, _) in entries(&sheet.eds).filter(|(_, entry)| wanted(entry)) {
        match asker.read(wire, address, false)? {
            Ok(bytes) => dump.values.push((address, bytes)),
            Err(refusal) if refusal.is_silence() => return Ok(Err(refusal)),
            // An error history without errors is no fault of anybody.
            Err(refusal) if refusal.code() == Some(AbortCode::NoData) => {}
            Err(refusal) => dump.refused.push(refusal),
        }
    }
    Ok(Ok(dump))
}

impl Dump {
    /// The text of a DCF.
    pub(super) fn configuration(&self, eds: &mut Eds, node: NodeId, kbit: Option<u32>) -> String {
        (eds.node, eds.kbit) = (Some(node), Some(kbit.unwrap_or(KBIT)));
        eds.values.clone_from(&self.values);
        eds.print()
    }

    pub(super) fn summary(&self, node: NodeId) -> String {
        let (read, refused) = (self.values.len(), self.refused.len());
        format!("node {node}: {read} entries read, {refused} refused")
    }

    pub(super) fn text(&self, sheet: &Sheet, node: NodeId) -> String {
        let mut text = String::new();
        for (address, bytes) in &self.values {
            let shown = sheet.show(*address, None, bytes);
            let _ = writeln!(text, "{}", line(*address, &sheet.name(*address), &shown));
        }
        for refusal in &self.refused {
            let _ = writeln!(text, "{refusal}");
        }
        text + &self.summary(node)
    }

    pub(super) fn json(&self, sheet: &Sheet, node: NodeId) -> Value {
        let entries = self.values.iter().map(|(address, bytes)| {
            json!({
                "address": address.to_string(), "name": sheet.name(*address), "bytes": bytes,
                "value": sheet.show(*address, None, bytes),
            })
        });
        let refused = self.refused.iter().map(ToString::to_string);
        json!({
            "version": 1, "node": node.raw(), "entries": entries.collect::<Vec<_>>(),
            "refused": refused.collect::<Vec<_>>(),
        })
    }
}

/// How one entry compares.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Difference {
    address: Address,
    expected: Vec<u8>,
    actual: Result<Vec<u8>, Refusal>,
}

/// What was compared.
#[derive(Clone, Debug, Default)]
pub(super) struct Compared {
    count: usize,
    differences: Vec<Difference>,
}

/// What a file wants an entry to be. Of a data sheet that is its default, if it has one.
fn expected(
    eds: &Eds,
    defaults: &Dictionary,
    address: Address,
    entry: &Entry,
    all: bool,
) -> Option<Vec<u8>> {
    let setting = matches!(entry.access, Access::ReadWrite | Access::Const);
    let compared = setting || all && entry.access.is_readable();
    if !compared || entry.data_type == DataType::Domain {
        return None;
    }
    let told = eds.values.iter().find(|(at, _)| *at == address);
    let default = || defaults.bytes(address).filter(|bytes| !bytes.is_empty());
    let told = told.map(|(_, value)| value.as_slice());
    told.or_else(default).map(<[u8]>::to_vec)
}

/// Compares entry by entry. A node that falls silent ends it.
pub(super) fn compare<W: Wire>(
    wire: &mut W,
    asker: &mut Asker,
    sheet: &Sheet,
    all: bool,
) -> Answer<Compared> {
    let eds = &sheet.eds;
    let defaults = eds.dictionary(asker.node())?;
    let mut compared = Compared::default();
    for (address, entry) in entries(eds) {
        let Some(expected) = expected(eds, &defaults, address, entry, all) else {
            continue;
        };
        compared.count += 1;
        let actual = asker.read(wire, address, false)?;
        if let Err(refusal) = actual
            && refusal.is_silence()
        {
            return Ok(Err(refusal));
        }
        let wanted = Download::new(address.index, address.sub, &expected);
        if !actual.as_ref().is_ok_and(|bytes| wanted.is_taken(bytes)) {
            compared.differences.push(Difference {
                address,
                expected,
                actual,
            });
        }
    }
    Ok(Ok(compared))
}

impl Compared {
    pub(super) const fn is_equal(&self) -> bool {
        self.differences.is_empty()
    }

    pub(super) fn text(&self, sheet: &Sheet, node: NodeId) -> String {
        let mut text = String::new();
        for difference in &self.differences {
            let address = difference.address;
            let expected = sheet.show(address, None, &difference.expected);
            let actual = match &difference.actual {
                Ok(bytes) => format!("node {}", sheet.show(address, None, bytes)),
                Err(refusal) => refusal.to_string(),
            };
            let name = sheet.name(address);
            let _ = writeln!(text, "{address} {name}: file {expected}, {actual}");
        }
        let (count, differ) = (self.count, self.differences.len());
        text + &format!("node {node}: {count} entries compared, {differ} differ")
    }

    pub(super) fn json(&self, sheet: &Sheet, node: NodeId) -> Value {
        let differences = self.differences.iter().map(|difference| {
            let refusal = difference.actual.as_ref().err().map(ToString::to_string);
            json!({
                "address": difference.address.to_string(), "name": sheet.name(difference.address),
                "file": difference.expected, "node": difference.actual.as_ref().ok(), "refusal": refusal,
            })
        });
        json!({
            "version": 1, "node": node.raw(), "compared": self.count, "equal": self.is_equal(),
            "differences": differences.collect::<Vec<_>>(),
        })
    }
}

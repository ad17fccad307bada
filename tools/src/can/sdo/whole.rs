//! All objects of a node: read into a configuration, or compared with one. Each entry is a transfer of its own.

use std::fmt::Write as _;

use serde_json::{Value, json};
use takt_can::canopen::NodeId;
use takt_can::canopen::eds::Eds;
use takt_can::canopen::network::Download;
use takt_cia402::dictionary::{AbortCode, Access, Address, DataType, Dictionary, Entry};

use super::line;
use crate::can::sdo_client::{Answer, SdoClient, SdoError};
use crate::can::sheet::Sheet;
use crate::can::wire::Wire;
use crate::objects;

/// Bit rate of a configuration if that of the interface is unknown, kbit/s.
const KBIT: u32 = 1000;

/// Values and errors of a dump.
#[derive(Clone, Debug, Default)]
pub(super) struct Dump {
    values: Vec<(Address, Vec<u8>)>,
    refused: Vec<SdoError>,
}

fn entries(eds: &Eds) -> impl Iterator<Item = (Address, &Entry)> {
    eds.objects.iter().flat_map(|object| {
        let entries = object.entries.iter();
        entries.map(|(sub, entry)| (Address::new(object.index, *sub), entry))
    })
}

/// Reads all readable entries. A timeout ends the dump.
pub(super) fn dump<W: Wire>(
    wire: &mut W,
    client: &mut SdoClient,
    sheet: &Sheet,
    domains: bool,
) -> Answer<Dump> {
    let mut dump = Dump::default();
    let wanted = |entry: &Entry| {
        entry.access.is_readable() && (domains || entry.data_type != DataType::Domain)
    };
    for (address, _) in entries(&sheet.eds).filter(|(_, entry)| wanted(entry)) {
        match client.read(wire, address, false)? {
            Ok(bytes) => dump.values.push((address, bytes)),
            Err(error) if error.is_timeout() => return Ok(Err(error)),
            // An empty error history is not a fault.
            Err(error) if error.code() == Some(AbortCode::NoData) => {}
            Err(error) => dump.refused.push(error),
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
        for error in &self.refused {
            let _ = writeln!(text, "{error}");
        }
        text + &self.summary(node)
    }

    pub(super) fn json(&self, sheet: &Sheet, node: NodeId) -> Value {
        let entries = self.values.iter().map(|(address, bytes)| {
            json!({
                "address": address.to_string(), "name": sheet.name(*address), "bytes": bytes,
                "value": objects::json(sheet.data_type(*address), bytes, sheet.show(*address, None, bytes)),
            })
        });
        let refused = self.refused.iter().map(ToString::to_string);
        json!({
            "version": 1, "node": node.raw(), "entries": entries.collect::<Vec<_>>(),
            "refused": refused.collect::<Vec<_>>(),
        })
    }
}

/// An entry whose values differ.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Difference {
    address: Address,
    expected: Vec<u8>,
    actual: Result<Vec<u8>, SdoError>,
}

/// Result of a comparison.
#[derive(Clone, Debug, Default)]
pub(super) struct Compared {
    count: usize,
    differences: Vec<Difference>,
}

/// The value of an entry in a file: that of a configuration, else the default of the data sheet, if there is one.
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
    let configured = eds.values.iter().find(|(at, _)| *at == address);
    let default = || defaults.bytes(address).filter(|bytes| !bytes.is_empty());
    let configured = configured.map(|(_, value)| value.as_slice());
    configured.or_else(default).map(<[u8]>::to_vec)
}

/// Compares entry by entry. A timeout ends the comparison.
pub(super) fn compare<W: Wire>(
    wire: &mut W,
    client: &mut SdoClient,
    sheet: &Sheet,
    all: bool,
) -> Answer<Compared> {
    let eds = &sheet.eds;
    let defaults = eds.dictionary(client.node())?;
    let mut compared = Compared::default();
    for (address, entry) in entries(eds) {
        let Some(expected) = expected(eds, &defaults, address, entry, all) else {
            continue;
        };
        compared.count += 1;
        let actual = client.read(wire, address, false)?;
        if let Err(error) = actual
            && error.is_timeout()
        {
            return Ok(Err(error));
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
                Err(error) => error.to_string(),
            };
            let name = sheet.name(address);
            let _ = writeln!(text, "{address} {name}: file {expected}, {actual}");
        }
        let (count, differ) = (self.count, self.differences.len());
        text + &format!("node {node}: {count} entries compared, {differ} differ")
    }

    pub(super) fn json(&self, sheet: &Sheet, node: NodeId, stranger: Option<&str>) -> Value {
        let differences = self.differences.iter().map(|difference| {
            let error = difference.actual.as_ref().err().map(ToString::to_string);
            json!({
                "address": difference.address.to_string(), "name": sheet.name(difference.address),
                "file": difference.expected, "node": difference.actual.as_ref().ok(), "refusal": error,
            })
        });
        json!({
            "version": 1, "node": node.raw(), "compared": self.count, "equal": self.is_equal(),
            "stranger": stranger,
            "differences": differences.collect::<Vec<_>>(),
        })
    }
}

//! Reads the data sheet stored in a node (1021h, CiA 306) into a file for `--eds`. Manufacturer-specific formats (1022h
//! from 128 on) are not decoded; they are rejected by number.

use std::path::Path;

use takt_can::canopen::eds::Eds;
use takt_cia402::dictionary::{AbortCode, Address};

use super::Report;
use crate::can::sdo_client::{Answer, SdoClient, SdoError, number};
use crate::can::sheet::name_of;
use crate::can::wire::Wire;
use crate::output::save;

const SHEET: Address = Address::new(0x1021, 0);
const FORMAT: Address = Address::new(0x1022, 0);
/// 1022h of plain text.
const TEXT: u32 = 0;

/// Reads the data sheet into a file.
pub(super) fn fetch<W: Wire>(wire: &mut W, client: &mut SdoClient, out: &Path) -> Answer<Report> {
    let format = match client.read(wire, FORMAT, false)? {
        Ok(bytes) => number(&bytes),
        // A node without 1022h stores plain text.
        Err(SdoError::Aborted(_, _, AbortCode::NoObject)) => Some(TEXT),
        Err(error) => return Ok(Err(error)),
    };
    let node = client.node();
    if format != Some(TEXT) {
        let format = format.map_or_else(|| "not a number".to_owned(), |format| format.to_string());
        let text = format!(
            "node {node}: the format of its data sheet is manufacturer-specific (1022h is {format})\nhint: ask the \
             manufacturer for the data sheet"
        );
        return Ok(Ok(Report { text, good: false }));
    }
    let bytes = match read(wire, client)? {
        Ok(bytes) => bytes,
        Err(error) => return Ok(Err(error)),
    };
    save(out, &bytes)?;
    let (len, out) = (bytes.len(), out.display());
    let report = match Eds::parse(&String::from_utf8_lossy(&bytes)) {
        Ok(eds) => Report {
            text: format!(
                "node {node}: data sheet written to {out}: {len} bytes, {} objects, vendor {:08X}h, product {:08X}h",
                eds.objects.len(),
                name_of(&eds, "VendorNumber").unwrap_or_default(),
                name_of(&eds, "ProductNumber").unwrap_or_default(),
            ),
            good: true,
        },
        Err(error) => Report {
            text: format!(
                "node {node}: {len} bytes written to {out}, but they are not a data sheet: {error}"
            ),
            good: false,
        },
    };
    Ok(Ok(report))
}

/// Reads by block transfer; from a node that does not support it, by segments.
fn read<W: Wire>(wire: &mut W, client: &mut SdoClient) -> Answer<Vec<u8>> {
    match client.read(wire, SHEET, true)? {
        Err(SdoError::Aborted(_, _, AbortCode::CommandSpecifier)) => {
            client.read(wire, SHEET, false)
        }
        answer => Ok(answer),
    }
}

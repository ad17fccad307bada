//! The data sheet that a node holds itself (1021h, CiA 306): read out of it into a file, which is then one for `--eds`.
//! Nothing is unpacked: the formats that makers may choose for themselves (1022h from 128 on) are refused by number.

use std::path::Path;

use takt_can::canopen::eds::Eds;
use takt_cia402::dictionary::{AbortCode, Address};

use super::Told;
use crate::can::ask::{Answer, Asker, Refusal, number};
use crate::can::sheet::name_of;
use crate::can::wire::Wire;
use crate::output::save;

const SHEET: Address = Address::new(0x1021, 0);
const FORMAT: Address = Address::new(0x1022, 0);
/// 1022h of a text that is not packed.
const TEXT: u32 = 0;

/// Reads the sheet into a file.
pub(super) fn fetch<W: Wire>(wire: &mut W, asker: &mut Asker, out: &Path) -> Answer<Told> {
    let format = match asker.read(wire, FORMAT, false)? {
        Ok(bytes) => number(&bytes),
        // Whoever has no format has none to choose.
        Err(Refusal::Node(_, _, AbortCode::NoObject)) => Some(TEXT),
        Err(refusal) => return Ok(Err(refusal)),
    };
    let node = asker.node();
    if format != Some(TEXT) {
        let format = format.map_or_else(|| "no number".to_owned(), |format| format.to_string());
        let text = format!(
            "node {node}: its data sheet is packed in a way of its maker's (1022h is {format}); ask the maker for it"
        );
        return Ok(Ok(Told { text, good: false }));
    }
    let bytes = match read(wire, asker)? {
        Ok(bytes) => bytes,
        Err(refusal) => return Ok(Err(refusal)),
    };
    save(out, &bytes)?;
    let (len, out) = (bytes.len(), out.display());
    let told = match Eds::parse(&String::from_utf8_lossy(&bytes)) {
        Ok(eds) => Told {
            text: format!(
                "node {node}: its data sheet is in {out}: {len} bytes, {} objects, vendor {:08X}h, product {:08X}h",
                eds.objects.len(),
                name_of(&eds, "VendorNumber").unwrap_or_default(),
                name_of(&eds, "ProductNumber").unwrap_or_default(),
            ),
            good: true,
        },
        Err(error) => Told {
            text: format!(
                "node {node}: {len} bytes are in {out}, but they are no data sheet: {error}"
            ),
            good: false,
        },
    };
    Ok(Ok(told))
}

/// In blocks, which a sheet is worth; from a node that knows none, in segments.
fn read<W: Wire>(wire: &mut W, asker: &mut Asker) -> Answer<Vec<u8>> {
    match asker.read(wire, SHEET, true)? {
        Err(Refusal::Node(_, _, AbortCode::CommandSpecifier)) => asker.read(wire, SHEET, false),
        answer => Ok(answer),
    }
}

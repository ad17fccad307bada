//! Names and types of objects: from a data sheet, or, for the objects of CiA 301 and CiA 402, from Takt's own. It reads
//! no node.

use std::path::Path;

use anyhow::{Context as _, bail};
use takt_can::canopen::NodeId;
use takt_can::canopen::eds::Eds;
use takt_can::canopen::emulator::{AXES_MAX, DriveNodeConfig};
use takt_cia402::dictionary::{Address, DataType, Entry};
use takt_cia402::emulator::DriveConfig;
use takt_cia402::{ControlWord, StatusWord};

use super::sdo_client::{Answer, SdoClient, number};
use super::wire::Wire;
use crate::output::complain;

/// Remarks on a data sheet that are printed one by one.
const REMARKS: usize = 5;

/// Reads a data sheet or a configuration; what it does not understand is printed.
pub(crate) fn read(path: &Path) -> anyhow::Result<Eds> {
    let bytes = takt_core::files::read(path, takt_core::files::TEXT_BYTES_MAX)
        .with_context(|| format!("cannot read {}", path.display()))?;
    let text = String::from_utf8_lossy(&bytes);
    let eds = Eds::parse(&text).with_context(|| path.display().to_string())?;
    for remark in eds.remarks.iter().take(REMARKS) {
        complain(&format!("{}: {remark}", path.display()));
    }
    let more = eds.remarks.len().saturating_sub(REMARKS);
    if more > 0 {
        complain(&format!("{}: {more} more remarks", path.display()));
    }
    Ok(eds)
}

/// A number of `[DeviceInfo]`.
pub(super) fn name_of(eds: &Eds, key: &str) -> Option<u32> {
    let text = eds.info("DeviceInfo", key)?.trim();
    let digits = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
    match digits {
        Some(digits) => u32::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    }
}

/// Vendor and product of a data sheet, as far as it has them.
pub(super) fn identity(eds: &Eds) -> [Option<u32>; 2] {
    let of = |key| name_of(eds, key).filter(|number| *number != 0);
    [of("VendorNumber"), of("ProductNumber")]
}

/// Names and types of objects.
#[derive(Debug)]
pub(super) struct Sheet {
    pub(super) eds: Eds,
    /// Whether it is that of the device.
    own: bool,
}

impl Sheet {
    /// From a file, or Takt's own of the standard objects.
    pub(super) fn open(path: Option<&Path>) -> anyhow::Result<Self> {
        let Some(path) = path else {
            return Ok(Self::standard());
        };
        Ok(Self {
            eds: read(path)?,
            own: true,
        })
    }

    /// The objects of CiA 301 and of CiA 402 with all axes, as the emulated drive has them.
    pub(super) fn standard() -> Self {
        let config = DriveNodeConfig {
            axes: vec![DriveConfig::default(); AXES_MAX],
            ..DriveNodeConfig::new(NodeId::LAST)
        };
        Self {
            eds: config.eds(),
            own: false,
        }
    }

    /// Why it is not the data sheet of a node: another vendor or product; `None` if it is, or if it does not say.
    pub(super) fn stranger<W: Wire>(
        &self,
        wire: &mut W,
        client: &mut SdoClient,
    ) -> Answer<Option<String>> {
        if !self.own {
            return Ok(Ok(None));
        }
        let [vendor, product] = identity(&self.eds);
        for (sub, key, expected) in [(1, "vendor", vendor), (2, "product", product)] {
            let Some(expected) = expected else {
                continue;
            };
            let shown = match client.read(wire, Address::new(0x1018, sub), false)? {
                Ok(bytes) => number(&bytes),
                Err(error) if error.is_timeout() => return Ok(Err(error)),
                // It does not say either.
                Err(_) => None,
            };
            if let Some(shown) = shown.filter(|shown| *shown != expected) {
                let node = client.node();
                return Ok(Ok(Some(format!(
                    "the data sheet is not that of node {node}: its {key} is {expected:X}h, 1018h:0{sub} of the node is \
                     {shown:X}h"
                ))));
            }
        }
        Ok(Ok(None))
    }

    fn entry(&self, address: Address) -> Option<&Entry> {
        let object = self.eds.objects.iter().find(|o| o.index == address.index)?;
        let found = object.entries.iter().find(|(sub, _)| *sub == address.sub);
        found.map(|(_, entry)| entry)
    }

    /// The type of an entry, if it is known.
    pub(super) fn data_type(&self, address: Address) -> Option<DataType> {
        self.entry(address).map(|entry| entry.data_type)
    }

    /// Its name, or nothing.
    pub(super) fn name(&self, address: Address) -> String {
        self.eds.name(address).unwrap_or_default()
    }

    /// What a text of the command line names: index and sub-index, or the name of an entry.
    pub(super) fn find(&self, text: &str) -> anyhow::Result<Address> {
        let Err(error) = text.parse::<Address>() else {
            return Ok(text.parse()?);
        };
        if let Some(address) = self.eds.find(text) {
            return Ok(address);
        }
        let whose = if self.own {
            "the data sheet"
        } else {
            "CiA 301 and 402 (name the device's data sheet by --eds)"
        };
        bail!("{error}; nor is it the name of one object of {whose}")
    }

    /// A value as its type shows it; the words of drives with the names of their bits.
    pub(super) fn show(
        &self,
        address: Address,
        data_type: Option<DataType>,
        bytes: &[u8],
    ) -> String {
        let kind = data_type.or_else(|| self.data_type(address));
        let shown = kind.unwrap_or(DataType::OctetString).show(bytes);
        let word = bytes.first_chunk().filter(|_| bytes.len() == 2);
        let word = word.map(|two| u16::from_le_bytes(*two));
        let of_axis = (0x6000..0xA000).contains(&address.index);
        let standard = 0x6000 + address.index % Address::AXIS;
        match (word, standard) {
            (Some(word), 0x6040) if of_axis => format!("{shown}  {}", ControlWord::new(word)),
            (Some(word), 0x6041) if of_axis => {
                let word = StatusWord::new(word);
                let state = word
                    .state()
                    .map_or_else(|_| "no state".to_owned(), |s| s.to_string());
                format!("{shown}  {word}: {state}")
            }
            _ => shown,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_are_found_by_number_and_by_name() {
        let sheet = Sheet::standard();
        let status = Address::new(0x6041, 0);
        assert_eq!(sheet.find("6041").unwrap(), status);
        assert_eq!(sheet.find("1018:04").unwrap(), Address::new(0x1018, 4));
        let name = sheet.name(status);
        assert!(!name.is_empty());
        assert_eq!(sheet.data_type(status), Some(DataType::Unsigned16));
        assert_eq!(
            sheet.find("serial number").unwrap(),
            Address::new(0x1018, 4)
        );
        let error = sheet.find("no such thing").unwrap_err().to_string();
        assert!(error.contains("--eds"), "{error}");
    }

    #[test]
    fn words_of_every_axis_have_their_bits_named() {
        let sheet = Sheet::standard();
        let shown = sheet.show(Address::new(0x6841, 0), None, &[0x37, 0x02]);
        assert!(
            shown.contains("567 (0237h)") && shown.contains("operation enabled"),
            "{shown}"
        );
        let shown = sheet.show(Address::new(0x6040, 0), None, &[0x0F, 0]);
        assert!(shown.contains("enable-operation"), "{shown}");
        assert_eq!(sheet.show(Address::new(0x2ABC, 0), None, &[1, 2]), "01 02");
    }
}

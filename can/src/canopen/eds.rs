//! Electronic data sheets (EDS) and device configuration files (DCF, CiA 306-1): the objects of a device with name,
//! type and default, and in a DCF the configured values of one device. Invalid content is skipped and reported in a
//! remark, never guessed.

mod ini;
mod read;
#[cfg(test)]
mod tests;
mod value;
mod write;

use std::fmt;
use std::time::Duration;

use takt_cia402::dictionary::{Address, Dictionary, DictionaryError, Object};

use super::network::{Download, NodePlan, Supervision};
use super::node::{NodeConfig, NodeQuirks};
use super::pdo::{Direction, PDOS_MAX, Parameters};
use super::{NodeId, NodeIdError};

/// Maximum file size, bytes.
pub(crate) const FILE_MAX: usize = 16 << 20;

/// Why a file is not a data sheet.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EdsError {
    /// The file is too long.
    #[error("the file has {0} bytes; at most {FILE_MAX} are supported")]
    TooLong(usize),
    /// A line is neither a section, nor `key=value`, nor a comment.
    #[error("line {line}: `{text}` is neither [section] nor key=value")]
    Line {
        /// Line number, from 1.
        line: usize,
        /// Start of the line.
        text: String,
    },
    /// The file has no objects.
    #[error("the file contains no object; is it an EDS or a DCF?")]
    Empty,
    /// The node number of a DCF is invalid.
    #[error("[DeviceComissioning] NodeID: {0}")]
    Node(NodeIdError),
    /// The objects do not form a valid dictionary.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
}

/// A remark about content that was skipped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remark {
    /// The section.
    pub section: String,
    /// The remark.
    pub text: String,
}

impl fmt::Display for Remark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "[{}] {}", self.section, self.text)
    }
}

/// A data sheet, or a device configuration.
#[derive(Clone, Debug, Default)]
pub struct Eds {
    /// Keys and values of `[FileInfo]`, `[DeviceInfo]` and other sections that are not objects,
    /// verbatim.
    pub sections: Vec<(String, Vec<(String, String)>)>,
    /// The objects; default values exclude the node number.
    pub objects: Vec<Object>,
    /// The entries whose default is relative to the node number (`$NODEID`).
    pub relative: Vec<Address>,
    /// DCF: configured values, little-endian, including the node number.
    pub values: Vec<(Address, Vec<u8>)>,
    /// DCF: the node number.
    pub node: Option<NodeId>,
    /// DCF: the bit rate, kbit/s.
    pub kbit: Option<u32>,
    /// Remarks about skipped content.
    pub remarks: Vec<Remark>,
}

impl Eds {
    /// The value of a key outside of objects: `info("DeviceInfo", "ProductName")`.
    /// Case-insensitive.
    pub fn info(&self, section: &str, key: &str) -> Option<&str> {
        let (_, keys) = self
            .sections
            .iter()
            .find(|(name, _)| name.eq_ignore_ascii_case(section))?;
        let found = keys.iter().find(|(k, _)| k.eq_ignore_ascii_case(key));
        found.map(|(_, value)| value.as_str())
    }

    /// The name of an entry: the name of its object, a slash, and its own name.
    pub fn name(&self, address: Address) -> Option<String> {
        let object = self.objects.iter().find(|o| o.index == address.index)?;
        let (_, entry) = object.entries.iter().find(|(sub, _)| *sub == address.sub)?;
        Some(if object.entries.len() == 1 && address.sub == 0 {
            object.name.to_string()
        } else {
            format!("{}/{}", object.name, entry.name)
        })
    }

    /// Finds an entry by name, as [`Self::name`] writes it, or by its own name if that is unique.
    /// Case-insensitive.
    pub fn find(&self, name: &str) -> Option<Address> {
        let all = || {
            self.objects.iter().flat_map(|object| {
                let entries = object.entries.iter();
                entries.map(|(sub, entry)| (Address::new(object.index, *sub), entry))
            })
        };
        let whole = |(address, _): &(Address, _)| {
            self.name(*address)
                .is_some_and(|n| n.eq_ignore_ascii_case(name))
        };
        let mut short = all().filter(|(_, entry)| entry.name.eq_ignore_ascii_case(name));
        let only = short.next().filter(|_| short.next().is_none());
        all().find(whole).or(only).map(|(address, _)| address)
    }

    /// The dictionary of a device with that node number: defaults, overridden by the values of the
    /// DCF.
    pub fn dictionary(&self, node: NodeId) -> Result<Dictionary, EdsError> {
        let mut dictionary = Dictionary::new(self.objects.clone())?;
        super::node::add_node_id(&mut dictionary, &self.relative, node);
        for (address, value) in &self.values {
            // Values that do not fit were reported by the parser.
            let _ = dictionary.store(*address, value);
        }
        Ok(dictionary)
    }

    /// Configuration of a node with this data sheet.
    pub(crate) fn node_config(&self, id: Option<NodeId>) -> Result<NodeConfig, EdsError> {
        Ok(NodeConfig {
            id,
            dictionary: Dictionary::new(self.objects.clone())?,
            relative: self.relative.clone(),
            sdo_len_max: 4096,
            sdo_timeout: Duration::from_secs(1),
            quirks: NodeQuirks::default(),
        })
    }

    /// The plan by which a master starts this device: type and identity as far as given, existing
    /// PDOs, heartbeat, and all other values of the DCF.
    pub fn plan(&self, node: NodeId) -> Result<NodePlan, EdsError> {
        let dictionary = self.dictionary(node)?;
        let number = |index, sub| {
            let bytes: [u8; 4] = dictionary
                .bytes(Address::new(index, sub))?
                .try_into()
                .ok()?;
            Some(u32::from_le_bytes(bytes)).filter(|number| *number != 0)
        };
        let mut plan = NodePlan::new(node);
        plan.device_type = number(0x1000, 0);
        // Serial numbers differ from device to device, revisions from firmware to firmware.
        plan.identity = [number(0x1018, 1), number(0x1018, 2), None, None];
        let heartbeat = dictionary.bytes(Address::new(0x1017, 0));
        let ms = heartbeat
            .and_then(|bytes| bytes.first_chunk())
            .map(|b| u16::from_le_bytes(*b));
        plan.supervision = match ms {
            Some(ms) if ms > 0 => Supervision::Heartbeat(Duration::from_millis(ms.into())),
            Some(_) => plan.supervision,
            None => Supervision::None,
        };
        for number in 0..PDOS_MAX {
            let exists = |pdo: &Parameters| pdo.cob.id().is_some();
            let rpdo = Parameters::read(&dictionary, Direction::Receive, number);
            plan.rpdos
                .extend(rpdo.filter(exists).map(|pdo| (number, pdo)));
            let tpdo = Parameters::read(&dictionary, Direction::Transmit, number);
            plan.tpdos
                .extend(tpdo.filter(exists).map(|pdo| (number, pdo)));
        }
        let own = |address: &Address| {
            Direction::of(address.index).is_none() && !matches!(address.index, 0x1016 | 0x1017)
        };
        plan.downloads = self
            .values
            .iter()
            .filter(|(address, _)| own(address) && self.is_writable(*address))
            .map(|(address, value)| Download::new(address.index, address.sub, value))
            .collect();
        Ok(plan)
    }

    fn is_writable(&self, address: Address) -> bool {
        let object = self.objects.iter().find(|o| o.index == address.index);
        let entries = object.map_or(&[][..], |object| &object.entries);
        let found = entries.iter().find(|(sub, _)| *sub == address.sub);
        found.is_some_and(|(_, entry)| entry.access.is_writable())
    }
}

//! Converts sections to objects.

use takt_cia402::dictionary::{
    Access, Address, DataType, Entry, Object, ObjectCode, PdoUse, VALUE_MAX,
};

use super::ini::{self, Section};
use super::value;
use super::{Eds, EdsError, FILE_MAX, NodeId, Remark};

/// Maximum length of a writable string without default, bytes.
const STRING_LEN_DEFAULT: usize = 256;
/// Maximum length of a writable domain without default, bytes.
const DOMAIN_LEN_DEFAULT: usize = 4096;

/// Kind of a section.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum About {
    Object(u16),
    Sub(u16, u8),
    /// Names of the entries of a compact object.
    Names(u16),
    /// Values of the entries of a compact object.
    Values(u16),
    Other,
}

fn about(name: &str) -> About {
    let Some((digits, rest)) = name.split_at_checked(4) else {
        return About::Other;
    };
    let hexadecimal = digits.bytes().all(|b| b.is_ascii_hexdigit());
    let Some(index) = u16::from_str_radix(digits, 16).ok().filter(|_| hexadecimal) else {
        return About::Other;
    };
    let rest = rest.to_ascii_lowercase();
    match (rest.as_str(), rest.strip_prefix("sub")) {
        ("", _) => About::Object(index),
        ("name", _) => About::Names(index),
        ("value", _) => About::Values(index),
        (_, Some(sub)) => {
            u8::from_str_radix(sub, 16).map_or(About::Other, |s| About::Sub(index, s))
        }
        _ => About::Other,
    }
}

impl Eds {
    /// Reads a data sheet or a configuration.
    ///
    /// # Errors
    /// If the text has no sections and keys, or no object. Other errors become remarks.
    pub fn parse(text: &str) -> Result<Self, EdsError> {
        if text.len() > FILE_MAX {
            return Err(EdsError::TooLong(text.len()));
        }
        let sections = ini::parse(text)?;
        let mut eds = Self::default();
        // Values may depend on the node number, which can be anywhere in the file.
        for section in sections.iter().filter(|s| about(&s.name) == About::Other) {
            let (name, keys) = (section.name.clone(), section.keys.clone());
            eds.sections.push((name, keys));
        }
        eds.commission()?;
        for section in &sections {
            if let About::Object(index) = about(&section.name) {
                eds.object(index, section);
            }
        }
        for section in &sections {
            match about(&section.name) {
                About::Sub(index, sub) => eds.sub(index, sub, section),
                About::Names(index) => eds.names(index, section),
                About::Values(index) => eds.compact_values(index, section),
                About::Object(_) | About::Other => {}
            }
        }
        eds.complete();
        if eds.objects.is_empty() {
            return Err(EdsError::Empty);
        }
        eds.objects.sort_by_key(|object| object.index);
        Ok(eds)
    }

    fn remark(&mut self, section: &str, text: impl Into<String>) {
        self.remarks.push(Remark {
            section: section.to_owned(),
            text: text.into(),
        });
    }

    /// Node number and bit rate of a DCF. Files and the standard spell the section name with one m.
    fn commission(&mut self) -> Result<(), EdsError> {
        let get = |key| {
            let spellings = ["DeviceComissioning", "DeviceCommissioning"];
            let found = spellings.iter().find_map(|section| self.info(section, key));
            found.and_then(value::number::<u32>)
        };
        let (node, kbit) = (get("NodeID"), get("Baudrate"));
        if let Some(raw) = node {
            let raw = u8::try_from(raw).unwrap_or(u8::MAX);
            self.node = Some(NodeId::new(raw).map_err(EdsError::Node)?);
        }
        self.kbit = kbit;
        Ok(())
    }

    fn object(&mut self, index: u16, section: &Section) {
        if self.objects.iter().any(|object| object.index == index) {
            self.remark(&section.name, "is duplicate; the first one counts");
            return;
        }
        let code = section.get("ObjectType").and_then(value::number::<u8>);
        let code = ObjectCode::from_raw(code.unwrap_or(7));
        let name = section.get("ParameterName").unwrap_or("").to_owned();
        let object = Object {
            index,
            name: name.into(),
            code,
            entries: Vec::new(),
        };
        match code {
            ObjectCode::Var | ObjectCode::Domain => {
                self.objects.push(object);
                self.sub(index, 0, section);
            }
            ObjectCode::Array | ObjectCode::Record => {
                self.objects.push(object);
                let compact = section.get("CompactSubObj").and_then(value::number::<u8>);
                if let Some(count) = compact.filter(|count| *count > 0) {
                    self.compact(index, count, section);
                }
            }
            // Data type definitions have no values.
            ObjectCode::Other(5 | 6) => {}
            ObjectCode::Other(raw) => {
                self.remark(
                    &section.name,
                    format!("object type {raw} is unknown; skipped"),
                );
            }
        }
    }

    /// A compact array: one section describes all entries.
    fn compact(&mut self, index: u16, count: u8, section: &Section) {
        let highest = Entry::number("highest sub-index supported", Access::ReadOnly, count);
        self.push(index, 0, highest, &section.name);
        for sub in 1..=count {
            self.sub(index, sub, section);
            let name = format!("{}{sub}", section.get("ParameterName").unwrap_or(""));
            self.rename(index, sub, name);
        }
    }

    fn rename(&mut self, index: u16, sub: u8, name: String) {
        let object = self.objects.iter_mut().find(|object| object.index == index);
        let entries = object.map(|object| object.entries.iter_mut());
        let found = entries.and_then(|mut entries| entries.find(|(s, _)| *s == sub));
        if let Some((_, entry)) = found {
            entry.name = name.into();
        }
    }

    fn names(&mut self, index: u16, section: &Section) {
        for (key, name) in &section.keys {
            if let Ok(sub) = key.parse() {
                self.rename(index, sub, name.clone());
            }
        }
    }

    fn compact_values(&mut self, index: u16, section: &Section) {
        for (key, text) in &section.keys {
            if let Ok(sub) = key.parse() {
                self.value(Address::new(index, sub), text, &section.name);
            }
        }
    }

    fn push(&mut self, index: u16, sub: u8, entry: Entry, section: &str) {
        let found = self.objects.iter_mut().find(|object| object.index == index);
        let Some(object) = found else {
            self.remark(section, "has no object section; skipped");
            return;
        };
        if object.entries.iter().any(|(known, _)| *known == sub) {
            self.remark(section, "is duplicate; the first one counts");
            return;
        }
        object.entries.push((sub, entry));
    }

    fn sub(&mut self, index: u16, sub: u8, section: &Section) {
        let address = Address::new(index, sub);
        let kind = section.get("DataType").and_then(value::number::<u16>);
        let domain = section.get("ObjectType").and_then(value::number::<u8>) == Some(2);
        let kind = match kind {
            Some(raw) => DataType::from_raw(raw),
            None if domain => DataType::Domain,
            None => {
                self.remark(&section.name, "has no DataType; skipped");
                return;
            }
        };
        let access = section
            .get("AccessType")
            .unwrap_or("rw")
            .to_ascii_lowercase();
        let Some((access, through)) = self::access(&access) else {
            self.remark(
                &section.name,
                format!("AccessType `{access}` is unknown; skipped"),
            );
            return;
        };
        let mappable = section.get("PDOMapping").and_then(value::number::<u8>);
        let default = self.default_of(address, kind, section);
        let name = section.get("ParameterName").unwrap_or("").to_owned();
        let mut entry = Entry::of(name, kind, access, default);
        if mappable.unwrap_or(0) != 0 {
            entry.pdo = through;
        }
        entry.low = section
            .get("LowLimit")
            .and_then(|text| value::limit(kind, text));
        entry.high = section
            .get("HighLimit")
            .and_then(|text| value::limit(kind, text));
        if kind.size().is_none() && access.is_writable() {
            let domain = kind == DataType::Domain;
            let len = if domain {
                DOMAIN_LEN_DEFAULT
            } else {
                STRING_LEN_DEFAULT
            };
            entry.max_len = entry.max_len.max(len).min(VALUE_MAX);
        }
        self.push(index, sub, entry, &section.name);
        if let Some(text) = section.get("ParameterValue") {
            self.value(address, text, &section.name);
        }
    }

    fn default_of(&mut self, address: Address, kind: DataType, section: &Section) -> Vec<u8> {
        let none = || vec![0; kind.size().unwrap_or(0)];
        let Some(text) = section.get("DefaultValue") else {
            return none();
        };
        match value::parse(kind, text) {
            Some((bytes, relative)) => {
                if relative {
                    self.relative.push(address);
                }
                bytes
            }
            None => {
                let remark = format!("DefaultValue `{text}` is not a valid {kind}; 0 is used");
                self.remark(&section.name, remark);
                none()
            }
        }
    }

    /// A value of a DCF; `$NODEID` is replaced by the node number of the DCF.
    fn value(&mut self, address: Address, text: &str, section: &str) {
        let object = self.objects.iter().find(|o| o.index == address.index);
        let entries = object.map_or(&[][..], |object| &object.entries);
        let Some((_, entry)) = entries.iter().find(|(sub, _)| *sub == address.sub) else {
            return;
        };
        let kind = entry.data_type;
        let Some((mut bytes, relative)) = value::parse(kind, text) else {
            self.remark(
                section,
                format!("ParameterValue `{text}` is not a valid {kind}; skipped"),
            );
            return;
        };
        if relative {
            let mut eight = [0; 8];
            eight
                .iter_mut()
                .zip(&bytes)
                .for_each(|(to, from)| *to = *from);
            let node = self.node.map_or(0, NodeId::raw);
            let sum = u64::from_le_bytes(eight)
                .wrapping_add(node.into())
                .to_le_bytes();
            bytes.iter_mut().zip(sum).for_each(|(to, from)| *to = from);
        }
        self.values.push((address, bytes));
    }

    /// Removes objects without entries and sorts the entries.
    fn complete(&mut self) {
        let empty: Vec<_> = self
            .objects
            .iter()
            .filter(|o| o.entries.is_empty())
            .collect();
        let empty: Vec<_> = empty.iter().map(|o| format!("{:04X}", o.index)).collect();
        for name in empty {
            self.remark(&name, "has no entries; skipped");
        }
        self.objects.retain(|object| !object.entries.is_empty());
        for object in &mut self.objects {
            object.entries.sort_by_key(|(sub, _)| *sub);
        }
    }
}

/// Access type, and the PDO direction of a mappable entry.
fn access(text: &str) -> Option<(Access, PdoUse)> {
    Some(match text {
        "const" => (Access::Const, PdoUse::Transmit),
        "ro" => (Access::ReadOnly, PdoUse::Transmit),
        "wo" => (Access::WriteOnly, PdoUse::Receive),
        "rw" => (Access::ReadWrite, PdoUse::Both),
        "rwr" => (Access::ReadWrite, PdoUse::Transmit),
        "rww" => (Access::ReadWrite, PdoUse::Receive),
        _ => return None,
    })
}

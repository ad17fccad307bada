//! Storing and restoring of parameters (CiA 301, clauses 7.5.2.13 and 7.5.2.14; objects 1010h and 1011h): commands of
//! the master and stored values of the node. The owner provides non-volatile memory.

use std::str::FromStr;

use takt_cia402::dictionary::{Access, Address, Dictionary, Entry};

/// Signature of the store command, `save`.
pub(crate) const SAVE: u32 = u32::from_le_bytes(*b"save");
/// Signature of the restore command, `load`.
pub const LOAD: u32 = u32::from_le_bytes(*b"load");

/// Maximum length of a stored value, bytes; domains are not stored.
const LEN_MAX: usize = 255;

/// Group of parameters to store or restore.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// All parameters.
    All,
    /// 1000h to 1FFFh.
    Communication,
    /// 6000h to 9FFFh.
    Application,
    /// 2000h to 5FFFh.
    Manufacturer,
}

/// Groups by sub-index.
const GROUPS: [(Group, u8, &str); 4] = [
    (Group::All, 1, "all"),
    (Group::Communication, 2, "communication"),
    (Group::Application, 3, "application"),
    (Group::Manufacturer, 4, "manufacturer"),
];

impl Group {
    /// The group by sub-index of 1010h and 1011h.
    pub(crate) fn from_sub(sub: u8) -> Option<Self> {
        let found = GROUPS.iter().find(|(_, known, _)| *known == sub);
        found.map(|(group, ..)| *group)
    }

    /// Its sub-index in 1010h and 1011h.
    pub fn sub(self) -> u8 {
        let found = GROUPS.iter().find(|(group, ..)| *group == self);
        found.map_or(1, |(_, sub, _)| *sub)
    }

    /// Object and bytes to write so that a node stores the group.
    pub fn store(self) -> (Address, [u8; 4]) {
        (Address::new(0x1010, self.sub()), SAVE.to_le_bytes())
    }

    /// Object and bytes to write so that a node restores the defaults at its next reset.
    pub fn restore(self) -> (Address, [u8; 4]) {
        (Address::new(0x1011, self.sub()), LOAD.to_le_bytes())
    }

    const fn contains(self, index: u16) -> bool {
        match self {
            Self::All => true,
            Self::Communication => index >= 0x1000 && index <= 0x1FFF,
            Self::Application => index >= 0x6000 && index <= 0x9FFF,
            Self::Manufacturer => index >= 0x2000 && index <= 0x5FFF,
        }
    }
}

impl FromStr for Group {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = GROUPS.iter().find(|(.., name)| *name == text);
        found.map(|(group, ..)| *group).ok_or_else(|| {
            format!("unknown group `{text}`; use all, communication, application or manufacturer")
        })
    }
}

/// Stored parameters of a node.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Store {
    values: Vec<(Address, Vec<u8>)>,
}

/// Command objects of a drive, by offset within its axis. They are not stored: the drive would move at power-on.
const COMMANDS: [u16; 10] = [
    0x040, 0x042, 0x071, 0x07A, 0x0B0, 0x0B1, 0x0B2, 0x0C1, 0x0FE, 0x0FF,
];

fn is_setting(address: Address, entry: &Entry) -> bool {
    let command = (0x6000..0xA000).contains(&address.index)
        && COMMANDS.contains(&(address.index % Address::AXIS));
    let history = matches!(address.index, 0x1003 | 0x1010 | 0x1011);
    entry.access == Access::ReadWrite && !command && !history
}

impl Store {
    /// Stores the current parameters of a group.
    pub(super) fn save(&mut self, d: &Dictionary, group: Group) {
        self.forget(group);
        for object in d.objects().iter().filter(|o| group.contains(o.index)) {
            for (sub, entry) in &object.entries {
                let address = Address::new(object.index, *sub);
                let value = d.bytes(address).filter(|value| value.len() <= LEN_MAX);
                if let Some(value) = value.filter(|_| is_setting(address, entry)) {
                    self.values.push((address, value.to_vec()));
                }
            }
        }
    }

    /// Deletes the stored parameters of a group.
    pub(super) fn forget(&mut self, group: Group) {
        self.values
            .retain(|(address, _)| !group.contains(address.index));
    }

    /// Restores the stored parameters of a group.
    pub(super) fn apply(&self, d: &mut Dictionary, group: Group) {
        let kept = self.values.iter();
        for (address, value) in kept.filter(|(address, _)| group.contains(address.index)) {
            // The object exists with this length.
            let _ = d.store(*address, value);
        }
    }
}

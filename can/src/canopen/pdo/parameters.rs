//! The objects 1400h to 1BFFh: PDO parameters and the rules for writing them. Enforces the
//! procedure of CiA 301 (clause 7.5.2.36): disable the PDO, set the number of mapped entries to 0,
//! write the entries, write their number, enable the PDO.

use takt_cia402::dictionary::{
    AbortCode, Access, Address, Dictionary, Entry, Mapped, Mapping, Object,
};

use super::{PdoCob, Transmission};

/// Maximum PDOs per direction.
pub const PDOS_MAX: u16 = 512;
/// Maximum mapped entries of a PDO on CAN: one for each bit.
pub const ENTRIES_MAX: u8 = 64;
/// Maximum bits of a PDO on CAN.
pub(super) const BITS_MAX: usize = 64;

/// Direction of a PDO, seen from the device with these objects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// RPDO.
    Receive,
    /// TPDO.
    Transmit,
}

impl Direction {
    /// Index of the communication parameters of its first PDO.
    pub const fn communication(self) -> u16 {
        match self {
            Self::Receive => 0x1400,
            Self::Transmit => 0x1800,
        }
    }

    /// Index of the mapping parameters of its first PDO.
    pub const fn mapping(self) -> u16 {
        self.communication() + 0x200
    }

    /// Direction and number (from 0) of the PDO that an index describes, and whether it is the
    /// mapping parameter.
    pub const fn of(index: u16) -> Option<(Self, u16, bool)> {
        let direction = match index {
            0x1400..=0x17FF => Self::Receive,
            0x1800..=0x1BFF => Self::Transmit,
            _ => return None,
        };
        let mapping = index & 0x200 != 0;
        Some((direction, index & 0x1FF, mapping))
    }
}

/// Communication and mapping parameters of a PDO.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parameters {
    /// Sub-index 1.
    pub cob: PdoCob,
    /// Sub-index 2.
    pub transmission: Transmission,
    /// Sub-index 3: inhibit time of event-driven PDOs, in 100 us.
    pub inhibit: u16,
    /// Sub-index 5, ms: event timer; maximum interval of a TPDO, deadline of an RPDO; 0: off.
    pub event: u16,
    /// Sub-index 6 of a TPDO: SYNC start value; 0: any.
    pub sync_start: u8,
    /// Mapped entries, in order.
    pub mapping: Vec<Mapped>,
}

impl Parameters {
    /// A PDO with that identifier and type, without times.
    pub const fn new(cob: PdoCob, transmission: Transmission, mapping: Vec<Mapped>) -> Self {
        Self {
            cob,
            transmission,
            inhibit: 0,
            event: 0,
            sync_start: 0,
            mapping,
        }
    }

    /// The two objects of the PDO with that number (from 0), with this capacity of mapped entries.
    /// [`check_download`] checks writes to them.
    pub fn objects(&self, direction: Direction, number: u16, entries: u8) -> [Object; 2] {
        let number = number.min(PDOS_MAX - 1);
        let rw = Access::ReadWrite;
        let transmit = direction == Direction::Transmit;
        let mut communication = Object::record(
            direction.communication() + number,
            if transmit {
                "TPDO communication parameter"
            } else {
                "RPDO communication parameter"
            },
            vec![
                Entry::number("COB-ID used by PDO", rw, self.cob.raw()),
                Entry::number("transmission type", rw, self.transmission.raw()),
                Entry::number("inhibit time", rw, self.inhibit),
            ],
        );
        let event = Entry::number("event timer", rw, self.event);
        communication.entries.push((5, event));
        if transmit {
            let start = Entry::number("SYNC start value", rw, self.sync_start).within(0, 240);
            communication.entries.push((6, start));
        }
        let highest = if transmit { 6_u8 } else { 5 };
        communication.entries[0].1 =
            Entry::number("highest sub-index supported", Access::Const, highest);
        let entries = entries.clamp(1, ENTRIES_MAX);
        let mapped = (0..entries).map(|at| {
            let mapped = self
                .mapping
                .get(usize::from(at))
                .copied()
                .unwrap_or_default();
            Entry::number("mapped object", rw, mapped.raw())
        });
        let mut mapping = Object::record(
            direction.mapping() + number,
            if transmit {
                "TPDO mapping parameter"
            } else {
                "RPDO mapping parameter"
            },
            mapped.collect(),
        );
        let count = u8::try_from(self.mapping.len())
            .unwrap_or(entries)
            .min(entries);
        mapping.entries[0].1 = Entry::number("number of mapped objects", rw, count);
        [communication, mapping]
    }

    /// The parameters of a PDO in a dictionary; `None` if it does not exist.
    pub fn read(dictionary: &Dictionary, direction: Direction, number: u16) -> Option<Self> {
        let (entries, count) = mapped(dictionary, direction.mapping() + number, None);
        let mapping = entries.get(..count).unwrap_or_default().to_vec();
        let communication = Self::communication(dictionary, direction, number)?;
        Some(Self {
            mapping,
            ..communication
        })
    }

    /// The same without the mapping; does not allocate.
    pub(super) fn communication(
        dictionary: &Dictionary,
        direction: Direction,
        number: u16,
    ) -> Option<Self> {
        let index = direction.communication() + number;
        let sub = |sub| number_at(dictionary, Address::new(index, sub));
        Some(Self {
            cob: PdoCob::from_raw(sub(1)?),
            transmission: Transmission::from_raw(low8(sub(2)?)),
            inhibit: low16(sub(3).unwrap_or(0)),
            event: low16(sub(5).unwrap_or(0)),
            sync_start: low8(sub(6).unwrap_or(0)),
            mapping: Vec::new(),
        })
    }
}

/// The entries of a mapping object: this number, or as in its sub-index 0. Missing ones are gaps.
fn mapped(dictionary: &Dictionary, index: u16, count: Option<u8>) -> ([Mapped; 64], usize) {
    let mapped = number_at(dictionary, Address::new(index, 0)).map_or(0, low8);
    let count = count.unwrap_or(mapped).min(ENTRIES_MAX);
    let mut entries = [Mapped::default(); ENTRIES_MAX as usize];
    for (sub, entry) in (1..=count).zip(&mut entries) {
        let raw = number_at(dictionary, Address::new(index, sub)).unwrap_or(0);
        *entry = Mapped::from_raw(raw);
    }
    (entries, count.into())
}

/// The mapping of a PDO of a dictionary.
pub(super) fn mapping(
    dictionary: &Dictionary,
    direction: Direction,
    number: u16,
) -> Result<Mapping, AbortCode> {
    mapping_of(dictionary, direction, direction.mapping() + number, None)
}

fn mapping_of(
    dictionary: &Dictionary,
    direction: Direction,
    index: u16,
    count: Option<u8>,
) -> Result<Mapping, AbortCode> {
    let (entries, count) = mapped(dictionary, index, count);
    let entries = entries.get(..count).unwrap_or_default();
    let received = direction == Direction::Receive;
    Mapping::new(dictionary, entries, received, BITS_MAX)
}

/// An unsigned number of up to 32 bits.
pub(in crate::canopen) fn number_at(dictionary: &Dictionary, address: Address) -> Option<u32> {
    dictionary.bytes(address).map(number)
}

fn number(bytes: &[u8]) -> u32 {
    let mut four = [0; 4];
    four.iter_mut()
        .zip(bytes)
        .for_each(|(to, from)| *to = *from);
    u32::from_le_bytes(four)
}

const fn low8(number: u32) -> u8 {
    number.to_le_bytes()[0]
}

const fn low16(number: u32) -> u16 {
    let [low, high, ..] = number.to_le_bytes();
    u16::from_le_bytes([low, high])
}

/// Checks whether a write to PDO parameters is allowed now; accepts other objects.
///
/// # Errors
/// As in CiA 301: reserved values, changes while the PDO exists, entries that cannot be mapped.
pub fn check_download(
    dictionary: &Dictionary,
    address: Address,
    data: &[u8],
) -> Result<(), AbortCode> {
    let Some((direction, at, mapping)) = Direction::of(address.index) else {
        return Ok(());
    };
    let cob = number_at(dictionary, Address::new(direction.communication() + at, 1));
    let cob = PdoCob::from_raw(cob.unwrap_or(PdoCob::INVALID));
    let value = number(data);
    if mapping {
        check_mapping(dictionary, direction, address, cob, value)
    } else {
        check_communication(direction, address.sub, cob, value)
    }
}

fn check_communication(
    direction: Direction,
    sub: u8,
    cob: PdoCob,
    value: u32,
) -> Result<(), AbortCode> {
    let allowed = match sub {
        1 => {
            let new = PdoCob::from_raw(value);
            let same = (value ^ cob.raw()) & !PdoCob::INVALID == 0;
            // Bits 0 to 30 must not change while the PDO stays enabled.
            let kept = same || !(cob.is_valid() && new.is_valid());
            kept && value & 1 << 29 == 0 && (!new.is_valid() || new.identifier().is_some())
        }
        2 => match (Transmission::from_raw(low8(value)), direction) {
            (Transmission::Reserved(_), _)
            | (Transmission::RemoteSync | Transmission::Remote, Direction::Receive) => false,
            (
                Transmission::SyncAcyclic
                | Transmission::Sync(_)
                | Transmission::RemoteSync
                | Transmission::Remote
                | Transmission::EventManufacturer
                | Transmission::EventProfile,
                _,
            ) => true,
        },
        // Inhibit time and SYNC start value must not change while the PDO exists.
        3 | 6 if cob.is_valid() => return Err(AbortCode::DeviceState),
        _ => true,
    };
    if allowed {
        Ok(())
    } else {
        Err(AbortCode::Value)
    }
}

fn check_mapping(
    dictionary: &Dictionary,
    direction: Direction,
    address: Address,
    cob: PdoCob,
    value: u32,
) -> Result<(), AbortCode> {
    if cob.is_valid() {
        return Err(AbortCode::UnsupportedAccess);
    }
    let received = direction == Direction::Receive;
    if address.sub > 0 {
        let count = number_at(dictionary, Address::new(address.index, 0));
        if count != Some(0) {
            return Err(AbortCode::UnsupportedAccess);
        }
        let one = [Mapped::from_raw(value)];
        // Entries may be cleared.
        if value == 0 {
            return Ok(());
        }
        return Mapping::new(dictionary, &one, received, BITS_MAX).map(drop);
    }
    let capacity = dictionary
        .object(address.index)
        .map_or(0, |object| object.entries.len() - 1);
    if usize::try_from(value).unwrap_or(usize::MAX) > capacity {
        return Err(AbortCode::PdoTooLong);
    }
    mapping_of(dictionary, direction, address.index, Some(low8(value))).map(drop)
}

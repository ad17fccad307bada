//! The slave information interface: the content of a slave's EEPROM (ETG.2010). A decoder of an image that was read;
//! reading the words is not here.

use std::fmt;

/// A word address in the SII.
pub type Word = u16;

/// Word addresses of the fixed part; 16-bit words.
pub mod word {
    use super::Word;

    /// Station alias.
    pub const ALIAS: Word = 0x04;
    /// Checksum over the preceding words, in the low byte.
    pub const CHECKSUM: Word = 0x07;
    /// Vendor, product, revision, serial number: two words each.
    pub const IDENTITY: Word = 0x08;
    /// Mailbox in BOOT: receive offset and size, send offset and size.
    pub const BOOT_MAILBOX: Word = 0x14;
    /// Mailbox: receive offset and size, send offset and size, then the protocols.
    pub const MAILBOX: Word = 0x18;
    /// Size of the EEPROM in Kibit, minus one.
    pub const SIZE: Word = 0x3E;
    /// First category.
    pub(crate) const CATEGORIES: Word = 0x40;
}

/// Identity of a slave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Identity {
    /// Vendor, as object 1018h:01.
    pub vendor: u32,
    /// Product code, as object 1018h:02.
    pub product: u32,
    /// Revision, as object 1018h:03.
    pub revision: u32,
    /// Serial number, as object 1018h:04.
    pub serial: u32,
}

impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            vendor,
            product,
            revision,
            serial,
        } = self;
        write!(
            f,
            "vendor {vendor:08X}h product {product:08X}h revision {revision:08X}h"
        )?;
        write!(f, " serial {serial}")
    }
}

/// A kind of category.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Category {
    /// Strings.
    Strings,
    /// General.
    General,
    /// Usage of FMMUs.
    Fmmu,
    /// SyncManagers.
    SyncManager,
    /// PDOs that the slave sends.
    TxPdo,
    /// PDOs that the slave receives.
    RxPdo,
    /// Distributed clock settings.
    Dc,
    /// Any other, as received.
    Other(u16),
}

impl Category {
    /// The number in the SII.
    pub const fn raw(self) -> u16 {
        match self {
            Self::Strings => 10,
            Self::General => 30,
            Self::Fmmu => 40,
            Self::SyncManager => 41,
            Self::TxPdo => 50,
            Self::RxPdo => 51,
            Self::Dc => 60,
            Self::Other(raw) => raw,
        }
    }

    /// From the number in the SII.
    pub const fn from_raw(raw: u16) -> Self {
        match raw {
            10 => Self::Strings,
            30 => Self::General,
            40 => Self::Fmmu,
            41 => Self::SyncManager,
            50 => Self::TxPdo,
            51 => Self::RxPdo,
            60 => Self::Dc,
            other => Self::Other(other),
        }
    }
}

/// An SII image, or the part of it that was read.
#[derive(Clone, Copy, Debug)]
pub struct Sii<'a> {
    bytes: &'a [u8],
}

/// Mailbox areas of the fixed part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MailboxAreas {
    /// Address that the master writes.
    pub receive: u16,
    /// Its length, bytes.
    pub receive_len: u16,
    /// Address that the master reads.
    pub send: u16,
    /// Its length, bytes.
    pub send_len: u16,
}

/// The category General (ETG.2010, table 7).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct General {
    /// Number of the string with the group's name; 0 for none.
    pub group: u8,
    /// Number of the string with the name of its picture; 0 for none.
    pub image: u8,
    /// Number of the string with the order code; 0 for none.
    pub order: u8,
    /// Number of the string with the name; 0 for none.
    pub name: u8,
    /// CoE: bit 0 SDO, 1 information, 2 PDO assignment, 3 PDO configuration, 5 complete access.
    pub coe: u8,
    /// FoE, if not 0.
    pub foe: u8,
    /// EoE, if not 0.
    pub eoe: u8,
    /// Bit 0: SAFE-OP may be requested; 1: LRW not supported; 2: the data link layer repeats mailboxes; 3, 4: type of
    /// explicit identification.
    pub flags: u8,
    /// Current taken from the E-bus; negative is given, mA.
    pub ebus_ma: i16,
    /// Types of ports 0 to 3, four bits each: 0 none, 1 MII, 3 E-bus, 4 fast hot connect.
    pub ports: u16,
}

/// An operation mode of the category DC (ETG.2010, table 16), 24 bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SiiClock {
    /// Period of SYNC0, ns; 0 for that of the master's cycle.
    pub cycle_ns: u32,
    /// Shift of SYNC0 after the start of the cycle, ns.
    pub shift_ns: u32,
    /// Delay of SYNC1 after SYNC0, ns.
    pub shift1_ns: u32,
    /// Period of SYNC1 as a multiple of that of SYNC0; 0 without SYNC1.
    pub sync1_factor: i16,
    /// AssignActivate: 0300h SYNC0, 0700h SYNC0 and SYNC1, 0 for no distributed clock.
    pub assign_activate: u16,
    /// Period of SYNC0 as a multiple of the master's cycle; negative for its inverse.
    pub sync0_factor: i16,
    /// Number of the string with its name; 0 for none.
    pub name: u8,
    /// Number of the string with its description; 0 for none.
    pub description: u8,
}

impl SiiClock {
    /// Length in the SII, bytes.
    pub const LEN: usize = 24;

    fn decode(bytes: &[u8]) -> Option<Self> {
        let double = |at: usize| {
            let four = bytes.get(at..)?.first_chunk()?;
            Some(u32::from_le_bytes(*four))
        };
        Some(Self {
            cycle_ns: double(0)?,
            shift_ns: double(4)?,
            shift1_ns: double(8)?,
            sync1_factor: u16_at(bytes, 12)?.cast_signed(),
            assign_activate: u16_at(bytes, 14)?,
            sync0_factor: u16_at(bytes, 16)?.cast_signed(),
            name: *bytes.get(18)?,
            description: *bytes.get(19)?,
        })
    }

    /// From the SII.
    pub fn encode(&self) -> [u8; Self::LEN] {
        let mut bytes = [0; Self::LEN];
        let doubles = [self.cycle_ns, self.shift_ns, self.shift1_ns];
        for (to, from) in bytes.chunks_exact_mut(4).zip(doubles) {
            to.copy_from_slice(&from.to_le_bytes());
        }
        bytes[12..14].copy_from_slice(&self.sync1_factor.to_le_bytes());
        bytes[14..16].copy_from_slice(&self.assign_activate.to_le_bytes());
        bytes[16..18].copy_from_slice(&self.sync0_factor.to_le_bytes());
        (bytes[18], bytes[19]) = (self.name, self.description);
        bytes
    }
}

/// A SyncManager of the category SyncManager.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SiiSyncManager {
    /// Physical start address.
    pub start: u16,
    /// Length, bytes.
    pub len: u16,
    /// Control register.
    pub control: u8,
    /// Bit 0: enabled.
    pub enable: u8,
    /// 1 mailbox out, 2 mailbox in, 3 outputs, 4 inputs; 0 unused.
    pub kind: u8,
}

/// A PDO of the categories TxPDO and RxPDO.
#[derive(Clone, Copy, Debug)]
pub struct SiiPdo<'a> {
    /// Index, 1600h or 1A00h and following.
    pub index: u16,
    /// SyncManager; FFh for none.
    pub sync_manager: u8,
    /// SYNC unit that it belongs to.
    pub sync: u8,
    /// Number of the string with its name; 0 for none.
    pub name: u8,
    /// Bit 0: it must be assigned; 4: its content is fixed.
    pub flags: u16,
    entries: &'a [u8],
}

/// An entry of a PDO category.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SiiEntry {
    /// Index of the object; 0 is a gap.
    pub index: u16,
    /// Its sub-index.
    pub sub: u8,
    /// Number of the string with its name; 0 for none.
    pub name: u8,
    /// Its data type, as CiA 301 numbers them.
    pub data_type: u8,
    /// Its length, bits.
    pub bits: u8,
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes
        .get(at..)?
        .first_chunk()
        .map(|two| u16::from_le_bytes(*two))
}

impl<'a> Sii<'a> {
    /// A decoder of the bytes of the EEPROM from its start.
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    /// The 16 bits at a word address.
    pub fn word(&self, at: Word) -> Option<u16> {
        u16_at(self.bytes, 2 * usize::from(at))
    }

    fn double(&self, at: Word) -> Option<u32> {
        let (low, high) = (self.word(at)?, self.word(at + 1)?);
        Some(u32::from(low) | u32::from(high) << 16)
    }

    /// Vendor, product, revision and serial number.
    pub fn identity(&self) -> Option<Identity> {
        Some(Identity {
            vendor: self.double(word::IDENTITY)?,
            product: self.double(word::IDENTITY + 2)?,
            revision: self.double(word::IDENTITY + 4)?,
            serial: self.double(word::IDENTITY + 6)?,
        })
    }

    /// Mailbox areas: at [`word::MAILBOX`] or [`word::BOOT_MAILBOX`].
    pub fn mailbox(&self, at: Word) -> Option<MailboxAreas> {
        Some(MailboxAreas {
            receive: self.word(at)?,
            receive_len: self.word(at + 1)?,
            send: self.word(at + 2)?,
            send_len: self.word(at + 3)?,
        })
    }

    /// Protocols of the mailbox: bit 0 AoE, 1 EoE, 2 CoE, 3 FoE, 4 SoE, 5 VoE.
    pub fn protocols(&self) -> Option<u16> {
        self.word(word::MAILBOX + 4)
    }

    /// Whether the checksum over the first seven words is right.
    pub fn is_checked(&self) -> bool {
        let stored = self.bytes.get(14).copied();
        self.bytes.get(..14).map(checksum) == stored
    }

    /// The categories with their data, as far as they were read.
    pub fn categories(&self) -> impl Iterator<Item = (Category, &'a [u8])> + use<'a> {
        let bytes = self.bytes;
        let mut at = 2 * usize::from(word::CATEGORIES);
        std::iter::from_fn(move || {
            let kind = u16_at(bytes, at).filter(|kind| *kind != 0xFFFF)?;
            let len = 2 * usize::from(u16_at(bytes, at + 2)?);
            let data = bytes.get(at + 4..at + 4 + len)?;
            at += 4 + len;
            Some((Category::from_raw(kind), data))
        })
    }

    fn category(&self, kind: Category) -> Option<&'a [u8]> {
        self.categories()
            .find(|(found, _)| *found == kind)
            .map(|(_, data)| data)
    }

    /// The string with a number, from 1; `None` if there is none or it is not text.
    pub fn string(&self, number: u8) -> Option<&'a str> {
        let (count, mut rest) = self.category(Category::Strings)?.split_first()?;
        if number == 0 || number > *count {
            return None;
        }
        for left in (0..number).rev() {
            let (len, after) = rest.split_first()?;
            let (text, after) = after.split_at_checked(usize::from(*len))?;
            if left == 0 {
                return std::str::from_utf8(text).ok();
            }
            rest = after;
        }
        None
    }

    /// The category General.
    pub fn general(&self) -> Option<General> {
        let data = self.category(Category::General)?;
        let [group, image, order, name, _, coe, foe, eoe, _, _, _, flags] = *data.first_chunk()?;
        let ebus = u16_at(data, 12)?;
        Some(General {
            group,
            image,
            order,
            name,
            coe,
            foe,
            eoe,
            flags,
            ebus_ma: ebus.cast_signed(),
            // Older images lack them.
            ports: u16_at(data, 16).unwrap_or(0),
        })
    }

    /// The operation modes of the distributed clock.
    pub fn clocks(&self) -> impl Iterator<Item = SiiClock> + use<'a> {
        let data = self.category(Category::Dc).unwrap_or_default();
        data.chunks_exact(SiiClock::LEN)
            .filter_map(SiiClock::decode)
    }

    /// Size of the EEPROM, bytes, from word 3Eh; `None` if that word was not read or is invalid.
    pub fn size(&self) -> Option<usize> {
        let kibit = usize::from(self.word(word::SIZE)?) + 1;
        (kibit <= 512).then_some(128 * kibit)
    }

    /// Length up to and including the end mark of the categories, bytes; `None` if there is none.
    pub fn used(&self) -> Option<usize> {
        let categories = self.categories().map(|(_, data)| 4 + data.len());
        let end = 2 * usize::from(word::CATEGORIES) + categories.sum::<usize>();
        (u16_at(self.bytes, end)? == 0xFFFF).then_some(end + 2)
    }

    /// The usage of each FMMU: 1 outputs, 2 inputs, 3 state of the mailbox.
    pub fn fmmus(&self) -> &'a [u8] {
        self.category(Category::Fmmu).unwrap_or_default()
    }

    /// The SyncManagers.
    pub fn sync_managers(&self) -> impl Iterator<Item = SiiSyncManager> + use<'a> {
        let data = self.category(Category::SyncManager).unwrap_or_default();
        data.chunks_exact(8).filter_map(|chunk| {
            let [a, b, c, d, control, _, enable, kind] = *chunk.first_chunk()?;
            Some(SiiSyncManager {
                start: u16::from_le_bytes([a, b]),
                len: u16::from_le_bytes([c, d]),
                control,
                enable,
                kind,
            })
        })
    }

    /// The PDOs of a category: [`Category::RxPdo`] or [`Category::TxPdo`].
    pub fn pdos(&self, kind: Category) -> impl Iterator<Item = SiiPdo<'a>> + use<'a> {
        let mut data = self.category(kind).unwrap_or_default();
        std::iter::from_fn(move || {
            let ([low, high, count, sync_manager, sync, name, flags, more], rest) =
                data.split_first_chunk()?;
            let (entries, rest) = rest.split_at_checked(8 * usize::from(*count))?;
            data = rest;
            Some(SiiPdo {
                index: u16::from_le_bytes([*low, *high]),
                sync_manager: *sync_manager,
                sync: *sync,
                name: *name,
                flags: u16::from_le_bytes([*flags, *more]),
                entries,
            })
        })
    }
}

impl SiiPdo<'_> {
    /// Its entries.
    pub fn entries(&self) -> impl Iterator<Item = SiiEntry> + '_ {
        self.entries.chunks_exact(8).filter_map(|chunk| {
            let [low, high, sub, name, data_type, bits, _, _] = *chunk.first_chunk()?;
            Some(SiiEntry {
                index: u16::from_le_bytes([low, high]),
                sub,
                name,
                data_type,
                bits,
            })
        })
    }

    /// Length, bits.
    pub fn bits(&self) -> usize {
        self.entries().map(|entry| usize::from(entry.bits)).sum()
    }
}

/// The checksum of the first seven words: CRC-8 with polynomial 07h, initial value FFh.
pub fn checksum(bytes: &[u8]) -> u8 {
    let bit = |crc: u8| crc << 1 ^ if crc & 0x80 == 0 { 0 } else { 0x07 };
    bytes
        .iter()
        .fold(0xFF, |crc, byte| (0..8).fold(crc ^ byte, |crc, _| bit(crc)))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const CLOCK: SiiClock = SiiClock {
        cycle_ns: 1_000_000,
        shift_ns: 7,
        shift1_ns: 8,
        sync1_factor: 1,
        assign_activate: 0x0700,
        sync0_factor: -2,
        name: 2,
        description: 1,
    };

    fn image() -> Vec<u8> {
        let mut image = vec![0_u8; 0x80];
        image[8] = 0x34;
        image[14] = checksum(&image[..14]);
        image[16..20].copy_from_slice(&0x0000_0ABC_u32.to_le_bytes());
        image[28..32].copy_from_slice(&42_u32.to_le_bytes());
        image[0x30..0x3A].copy_from_slice(&[0, 0x10, 0x80, 0, 0x80, 0x10, 0x80, 0, 4, 0]);
        let category = |kind: u16, data: &[u8]| {
            let mut bytes = kind.to_le_bytes().to_vec();
            let words = u16::try_from(data.len() / 2).unwrap();
            bytes.extend(words.to_le_bytes());
            bytes.extend(data);
            bytes
        };
        image.extend(category(
            10,
            &[2, 4, b'a', b'x', b'i', b's', 2, b'i', b'n', 0],
        ));
        let mut general = [0; 32];
        (general[2], general[3], general[5], general[11]) = (1, 2, 0x2D, 2);
        general[12..14].copy_from_slice(&(-100_i16).to_le_bytes());
        image.extend(category(30, &general));
        image.extend(category(40, &[1, 2, 3, 0]));
        image.extend(category(41, &[0, 0x11, 6, 0, 0x64, 0, 1, 3]));
        let pdo = [
            0, 0x16, 2, 2, 0, 1, 0, 0, 0x40, 0x60, 0, 0, 6, 16, 0, 0, 0x7A, 0x60, 0, 0, 4, 32, 0, 0,
        ];
        image.extend(category(51, &pdo));
        image.extend(category(60, &CLOCK.encode()));
        image.extend([0xFF, 0xFF]);
        image
    }

    #[test]
    fn sii_image_is_decoded() {
        let image = image();
        let sii = Sii::new(&image);
        assert!(sii.is_checked());
        let identity = sii.identity().unwrap();
        assert_eq!((identity.vendor, identity.serial), (0xABC, 42));
        assert_eq!(sii.word(word::ALIAS), Some(0x34));
        assert_eq!(sii.protocols(), Some(4));
        let areas = sii.mailbox(word::MAILBOX).unwrap();
        assert_eq!(
            (areas.receive, areas.send, areas.send_len),
            (0x1000, 0x1080, 128)
        );
        assert_eq!((sii.string(1), sii.string(2)), (Some("axis"), Some("in")));
        assert_eq!((sii.string(0), sii.string(3)), (None, None));
        let general = sii.general().unwrap();
        assert_eq!((general.order, general.name, general.coe), (1, 2, 0x2D));
        assert_eq!((general.flags, general.ebus_ma), (2, -100));
        assert_eq!(sii.fmmus(), [1, 2, 3, 0]);
        let sm: Vec<_> = sii.sync_managers().collect();
        assert_eq!((sm.len(), sm[0].start, sm[0].kind), (1, 0x1100, 3));
        let pdos: Vec<_> = sii.pdos(Category::RxPdo).collect();
        assert_eq!((pdos.len(), pdos[0].index, pdos[0].bits()), (1, 0x1600, 48));
        let second = pdos[0].entries().nth(1).unwrap();
        assert_eq!((second.index, second.bits), (0x607A, 32));
        assert_eq!(sii.pdos(Category::TxPdo).count(), 0);
        assert_eq!(sii.clocks().collect::<Vec<_>>(), [CLOCK]);
        assert_eq!((sii.size(), sii.used()), (Some(128), Some(image.len())));
        assert_eq!(Sii::new(&image[..image.len() - 2]).used(), None);
    }

    #[test]
    fn sii_image_truncated_gives_its_rest() {
        let image = image();
        for len in 0..image.len() {
            let sii = Sii::new(&image[..len]);
            let _ = (
                sii.identity(),
                sii.general(),
                sii.string(2),
                sii.is_checked(),
            );
            let categories = sii.categories().count();
            assert!(categories <= 6 && sii.used().is_none());
            let _ = sii
                .pdos(Category::RxPdo)
                .map(|pdo| pdo.bits())
                .sum::<usize>();
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_answered(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
            let sii = Sii::new(&bytes);
            let _ = sii.categories().count();
            let _ = (0..=u8::MAX).filter_map(|n| sii.string(n)).count();
            let _ = sii.sync_managers().count();
            let _ = sii.pdos(Category::TxPdo).map(|pdo| pdo.entries().count()).sum::<usize>();
        }
    }
}

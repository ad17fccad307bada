//! The PDOs of a drive, their assignment to SyncManagers (1C12h, 1C13h) and their mapping. As in the standard, they can
//! be changed in PRE-OP only, with their count at zero.

use takt_cia402::dictionary::{AbortCode, Address, Dictionary, Mapped, Mapping};
use takt_cia402::emulator::Drive;

use super::PdoSet;
use crate::emulator::image::PdoImage;
use crate::{AlState, AlStatusCode};

/// Maximum number of entries of one PDO.
pub(super) const ENTRIES: u8 = 16;
/// Maximum number of PDOs of one SyncManager.
pub(super) const ASSIGNED: u8 = 8;
/// Longest process data per direction, bits.
const BITS_MAX: usize = 8 * 512;
/// Index distance between the PDOs of two axes (ETG.6010).
pub(super) const PDO_STEP: u16 = 0x10;

/// Default RxPDO of an axis: index, bits, CoE data type.
const RECEIVED: [(u16, u8, u8); 6] = [
    (0x6040, 16, 6),
    (0x6060, 8, 2),
    (0, 8, 0),
    (0x607A, 32, 4),
    (0x60FF, 32, 4),
    (0x6071, 16, 3),
];
/// Default TxPDO of an axis.
const TRANSMITTED: [(u16, u8, u8); 7] = [
    (0x6041, 16, 6),
    (0x6061, 8, 2),
    (0, 8, 0),
    (0x6064, 32, 4),
    (0x606C, 32, 4),
    (0x6077, 16, 3),
    (0x603F, 16, 6),
];

/// The default PDO of an axis, as listed in the SII.
pub(super) fn image(axis: usize, received: bool) -> PdoImage {
    let axis = u16::try_from(axis).unwrap_or(0);
    let entry = |(index, bits, data_type): &(u16, u8, u8)| {
        let index = match index {
            0 => 0,
            index => index + Address::AXIS * axis,
        };
        (index, 0, *bits, *data_type)
    };
    let (first, name, rows): (u16, _, &[_]) = if received {
        (0x1600, "outputs", &RECEIVED)
    } else {
        (0x1A00, "inputs", &TRANSMITTED)
    };
    PdoImage {
        index: first + PDO_STEP * axis,
        sync_manager: if received { 2 } else { 3 },
        name: format!("axis {} {name}", axis + 1),
        entries: rows.iter().map(entry).collect(),
    }
}

/// All default PDOs of a drive in one direction.
pub(super) fn images(set: PdoSet, axes: usize, received: bool) -> Vec<PdoImage> {
    match set {
        PdoSet::One => (0..axes).map(|axis| image(axis, received)).collect(),
        PdoSet::Four => four(received),
    }
}

/// Four PDOs of one axis, together 17 bytes: the last maps objects of the first again.
pub(in crate::emulator) fn four(received: bool) -> Vec<PdoImage> {
    let PdoImage {
        index,
        sync_manager,
        entries,
        ..
    } = image(0, received);
    let [word, mode, gap, position, velocity, torque, ..] = entries[..] else {
        return Vec::new();
    };
    let parts = [
        vec![word, mode, gap],
        vec![position],
        vec![velocity],
        vec![torque, word, mode],
    ];
    (index..)
        .zip(parts)
        .map(|(index, entries)| PdoImage {
            index,
            sync_manager,
            name: format!("PDO {}", index & 0x0F),
            entries,
        })
        .collect()
}

/// Whether an object is mapped twice in the assigned PDOs.
pub(super) fn check_twice(d: &Dictionary) -> Result<(), AlStatusCode> {
    for (list_at, code) in [(0x1C12, 0x001D), (0x1C13, 0x001E)] {
        let pdos = list(d, list_at).unwrap_or_default();
        let pdos = pdos.into_iter().map(u16::from_le_bytes);
        let all: Vec<Mapped> = pdos.filter_map(|pdo| mapped(d, pdo)).flatten().collect();
        let twice = |(n, entry): (usize, &Mapped)| {
            let before = all.iter().take(n);
            !entry.is_gap() && before.clone().any(|other| other.address == entry.address)
        };
        if all.iter().enumerate().any(twice) {
            return Err(AlStatusCode(code));
        }
    }
    Ok(())
}

/// The values of an object whose sub-index 0 is their number.
fn list<const N: usize>(d: &Dictionary, index: u16) -> Option<Vec<[u8; N]>> {
    let count = *d.bytes(Address::new(index, 0))?.first()?;
    (1..=count)
        .map(|sub| d.bytes(Address::new(index, sub))?.first_chunk().copied())
        .collect()
}

/// The mapped entries of a PDO.
fn mapped(d: &Dictionary, pdo: u16) -> Option<Vec<Mapped>> {
    let raw = list(d, pdo)?.into_iter().map(u32::from_le_bytes);
    Some(raw.map(Mapped::from_raw).collect())
}

/// A PDO of whole bytes.
fn mapping(d: &Dictionary, pdo: u16, received: bool) -> Result<Mapping, AbortCode> {
    let entries = mapped(d, pdo).ok_or(AbortCode::NoObject)?;
    let mapping = Mapping::new(d, &entries, received, BITS_MAX)?;
    if mapping.bits().is_multiple_of(8) {
        Ok(mapping)
    } else {
        Err(AbortCode::NotMappable)
    }
}

/// Whether a write from the bus may change PDOs.
pub(in crate::emulator) fn check_download(
    d: &Dictionary,
    at: Address,
    data: &[u8],
    state: AlState,
) -> Result<(), AbortCode> {
    let assigns = matches!(at.index, 0x1C12 | 0x1C13);
    let maps = matches!(at.index, 0x1600..=0x17FF | 0x1A00..=0x1BFF);
    let sync = matches!(at.index, 0x1C32 | 0x1C33) && at.sub <= 2;
    if (assigns || maps || sync) && state != AlState::PreOp {
        return Err(AbortCode::DeviceState);
    }
    if sync || !(assigns || maps) {
        return Ok(());
    }
    let count = d.bytes(Address::new(at.index, 0)).unwrap_or_default();
    if at.sub > 0 {
        if count != [0] {
            return Err(AbortCode::UnsupportedAccess);
        }
        // An object that cannot be mapped is refused here (CiA 301, clause 7.5.2.36).
        return match data.first_chunk().filter(|_| maps) {
            Some(raw) => {
                let entry = Mapped::from_raw(u32::from_le_bytes(*raw));
                Mapping::new(d, &[entry], at.index < 0x1A00, BITS_MAX).map(|_| ())
            }
            None => Ok(()),
        };
    }
    check_count(d, at.index, data.first().copied().unwrap_or(0))
}

/// Whether this number of written entries is valid.
fn check_count(d: &Dictionary, index: u16, count: u8) -> Result<(), AbortCode> {
    let received = index < 0x1A00 || index == 0x1C12;
    let first = if received { 0x1600 } else { 0x1A00 };
    let mut entries = Vec::new();
    for sub in 1..=count {
        let bytes = d
            .bytes(Address::new(index, sub))
            .ok_or(AbortCode::TooHigh)?;
        if let [a, b] = *bytes {
            let pdo = u16::from_le_bytes([a, b]);
            if !(first..first + 0x200).contains(&pdo) || d.object(pdo).is_none() {
                return Err(AbortCode::ParameterIncompatible);
            }
        } else if let Some(raw) = bytes.first_chunk() {
            entries.push(Mapped::from_raw(u32::from_le_bytes(*raw)));
        }
    }
    Mapping::new(d, &entries, received, BITS_MAX).map(|_| ())
}

/// The process data of a drive as assigned and mapped.
#[derive(Clone, Debug, Default)]
pub(super) struct Pdos {
    received: Vec<Pdo>,
    transmitted: Vec<Pdo>,
}

/// A PDO and its axis.
#[derive(Clone, Debug)]
struct Pdo {
    axis: usize,
    mapping: Mapping,
    /// Lengths of its entries, bytes.
    lens: Vec<usize>,
}

impl Pdo {
    fn new(d: &Dictionary, pdo: u16, received: bool) -> Result<Self, AbortCode> {
        let mapping = mapping(d, pdo, received)?;
        let first = if received { 0x1600 } else { 0x1A00 };
        let axis = pdo.saturating_sub(first) / PDO_STEP;
        let bytes = |entry: Mapped| usize::from(entry.bits.div_ceil(8));
        Ok(Self {
            axis: axis.into(),
            lens: mapping.entries().map(bytes).collect(),
            mapping,
        })
    }
}

impl Pdos {
    pub(super) fn new(d: &Dictionary) -> Result<Self, AlStatusCode> {
        let all = |assignment, received, code| {
            let pdos = list(d, assignment).unwrap_or_default();
            pdos.into_iter()
                .map(|pdo| Pdo::new(d, u16::from_le_bytes(pdo), received))
                .collect::<Result<Vec<_>, _>>()
                .map_err(|_| AlStatusCode(code))
        };
        Ok(Self {
            received: all(0x1C12, true, 0x0025)?,
            transmitted: all(0x1C13, false, 0x0024)?,
        })
    }

    /// Length of the outputs, bytes.
    pub(super) fn outputs(&self) -> usize {
        self.received.iter().map(|pdo| pdo.mapping.len()).sum()
    }

    /// Length of the inputs, bytes.
    pub(super) fn inputs(&self) -> usize {
        self.transmitted.iter().map(|pdo| pdo.mapping.len()).sum()
    }

    pub(super) fn unpack(&self, d: &mut Dictionary, axes: &mut [Drive], mut outputs: &[u8]) {
        for Pdo {
            axis,
            mapping,
            lens,
        } in &self.received
        {
            let Some((pdo, rest)) = outputs.split_at_checked(mapping.len()) else {
                return;
            };
            let faults = axes
                .get_mut(*axis)
                .map(|axis| &mut axis.process_data.outputs);
            if let Some(faults) = faults.filter(|faults| !faults.is_none()) {
                let mut own = pdo.to_vec();
                faults.receive(lens, &mut own);
                mapping.unpack(d, &own);
            } else {
                mapping.unpack(d, pdo);
            }
            outputs = rest;
        }
    }

    pub(super) fn pack(&self, d: &Dictionary, axes: &mut [Drive], mut inputs: &mut [u8]) {
        for Pdo {
            axis,
            mapping,
            lens,
        } in &self.transmitted
        {
            let Some((pdo, rest)) = inputs.split_at_mut_checked(mapping.len()) else {
                return;
            };
            mapping.pack(d, pdo);
            if let Some(axis) = axes.get_mut(*axis) {
                let faults = &mut axis.process_data.inputs;
                if !faults.is_none() {
                    faults.transmit(lens, pdo);
                }
            }
            inputs = rest;
        }
    }
}

//! The process data of a slave: which SyncManager carries which PDOs, the writes that configure it, and the location of
//! an object. The region of the slave in the process image is managed by the image.

use takt_cia402::dictionary::{Address, Mapped};

use super::event::Fault;
use crate::config::{PdoSpec, SlaveSpec};
use crate::sii::{Category, Sii, SiiSyncManager};
use crate::{Fmmu, SyncManager};

/// A PDO as it is set up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pdo {
    /// 1600h or 1A00h and following.
    pub index: u16,
    /// Its entries; empty if only its length is known.
    pub entries: Vec<Mapped>,
}

impl Pdo {
    /// Length, bits.
    pub fn bits(&self) -> usize {
        self.entries
            .iter()
            .map(|entry| usize::from(entry.bits))
            .sum()
    }
}

/// A SyncManager with process data.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Its number.
    pub number: u8,
    /// Written by the master.
    pub outputs: bool,
    /// Physical start address.
    pub start: u16,
    /// Control register.
    pub control: u8,
    /// Its PDOs, in order.
    pub pdos: Vec<Pdo>,
    /// To be enabled in OP only.
    op_only: bool,
    /// Bits of a slave that names no PDOs.
    unnamed: usize,
}

/// Bit of a SyncManager's enable byte in the SII: on in OP only.
const OP_ONLY: u8 = 0x08;

impl Channel {
    fn new(sm: &SiiSyncManager, number: u8) -> Self {
        Self {
            number,
            outputs: sm.kind == 3,
            start: sm.start,
            control: sm.control,
            pdos: Vec::new(),
            op_only: sm.enable & OP_ONLY != 0,
            unnamed: 8 * usize::from(sm.len),
        }
    }

    /// Length of its data, bits.
    pub fn bits(&self) -> usize {
        if self.pdos.is_empty() {
            self.unnamed
        } else {
            self.pdos.iter().map(Pdo::bits).sum()
        }
    }

    /// Length, bytes.
    pub fn len(&self) -> usize {
        self.bits().div_ceil(8)
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.bits() == 0
    }

    /// The PDO assignment object.
    pub(super) const fn assignment(&self) -> u16 {
        0x1C10 + self.number as u16
    }

    /// Replaces its PDOs.
    pub(super) fn set_pdos(&mut self, pdos: Vec<Pdo>) {
        self.pdos = pdos;
        self.unnamed = 0;
    }

    /// The difference between actual and wanted PDOs: another PDO, another entry where entries are given, or else
    /// another length than known before.
    pub(super) fn difference(&self, wanted: &[PdoSpec], found: &[Pdo]) -> Option<Fault> {
        let lengths = Fault::Assignment {
            sync_manager: self.number,
            wanted: self.bits(),
            found: found.iter().map(Pdo::bits).sum(),
        };
        let indices = |pdos: &[Pdo]| pdos.iter().map(|pdo| pdo.index).collect::<Vec<_>>();
        if indices(&self.pdos) != indices(found) {
            return Some(lengths);
        }
        let mut pairs = wanted.iter().zip(found);
        if let Some(fault) = pairs.find_map(|(wanted, found)| mapping_difference(wanted, found)) {
            return Some(fault);
        }
        let known = self.pdos.iter().all(|pdo| !pdo.entries.is_empty());
        (known && self.bits() != found.iter().map(Pdo::bits).sum()).then_some(lengths)
    }

    /// The register block that sets it up.
    pub(super) fn sync_manager(&self) -> SyncManager {
        SyncManager {
            start: self.start,
            len: u16::try_from(self.len()).unwrap_or(u16::MAX),
            control: self.control,
            activate: u8::from(!self.is_empty() && !self.op_only),
            ..SyncManager::default()
        }
    }

    /// Whether it is enabled immediately before OP.
    pub(super) fn waits_for_op(&self) -> bool {
        self.op_only && !self.is_empty()
    }

    /// The FMMU that maps it to a logical address.
    pub(super) fn fmmu(&self, logical: u32) -> Fmmu {
        Fmmu {
            logical,
            len: u16::try_from(self.len()).unwrap_or(u16::MAX),
            start_bit: 0,
            stop_bit: 7,
            physical: self.start,
            physical_bit: 0,
            reads: !self.outputs,
            writes: self.outputs,
            active: true,
        }
    }
}

/// Location of an object in a slave's outputs or inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Located {
    /// In the outputs, or else in the inputs.
    pub outputs: bool,
    /// First bit, from the start of the slave's outputs or inputs.
    pub bit: usize,
    /// Length, bits.
    pub bits: u8,
}

/// One write of the PDO set-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Assignment {
    pub(super) address: Address,
    value: u32,
    len: u8,
}

impl Assignment {
    /// The object that this write maps into a PDO; `None` for a count or an assignment.
    pub(super) const fn entry(&self) -> Option<Mapped> {
        if self.len == 4 && self.address.sub > 0 {
            Some(Mapped::from_raw(self.value))
        } else {
            None
        }
    }

    pub(super) fn bytes(&self, to: &mut Vec<u8>) {
        to.extend(self.value.to_le_bytes().into_iter().take(self.len.into()));
    }
}

/// The process data of a slave.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ProcessData {
    /// SyncManagers with process data, in their order.
    pub channels: Vec<Channel>,
}

impl ProcessData {
    /// The default process data according to the SII.
    pub(super) fn from_sii(sii: &Sii<'_>) -> Self {
        let mut data = Self::default();
        for (number, sm) in (0..).zip(sii.sync_managers()).take(16) {
            if !matches!(sm.kind, 3 | 4) {
                continue;
            }
            let mut channel = Channel::new(&sm, number);
            let pdos = sii_pdos(sii, channel.outputs).filter(|(_, sm)| *sm == number);
            let pdos: Vec<Pdo> = pdos.map(|(pdo, _)| pdo).collect();
            if !pdos.is_empty() {
                channel.set_pdos(pdos);
            }
            data.channels.push(channel);
        }
        data
    }

    /// Replaces it by the configured PDOs: entries as given, or from the SII for that index.
    pub(super) fn want(&mut self, spec: &SlaveSpec, sii: &Sii<'_>) -> Result<(), Fault> {
        for (outputs, wanted) in [(true, &spec.outputs), (false, &spec.inputs)] {
            let Some(wanted) = wanted else {
                continue;
            };
            let mut channels: Vec<&mut Channel> = self
                .channels
                .iter_mut()
                .filter(|channel| channel.outputs == outputs)
                .collect();
            if channels.is_empty() && !wanted.is_empty() {
                return Err(Fault::NoChannel { outputs });
            }
            // With several SyncManagers, each PDO goes to that of the SII, all others go to the first.
            let numbers: Vec<u8> = channels.iter().map(|channel| channel.number).collect();
            let sync_manager_of = |pdo: &PdoSpec| {
                let mut listed = sii_pdos(sii, outputs);
                let listed = listed.find(|(listed, _)| listed.index == pdo.index);
                let listed = listed.map(|(_, number)| number);
                listed
                    .filter(|number| numbers.contains(number))
                    .or_else(|| numbers.first().copied())
            };
            for channel in &mut channels {
                let here = wanted
                    .iter()
                    .filter(|pdo| sync_manager_of(pdo) == Some(channel.number));
                channel.set_pdos(here.map(|pdo| known(pdo, sii, outputs)).collect());
            }
        }
        self.check()
    }

    /// The process data of a slave that is not present yet, from its configuration alone; `None` if that is incomplete.
    pub(super) fn from_spec(spec: &SlaveSpec) -> Option<Self> {
        let (outputs, inputs) = (spec.outputs.as_ref()?, spec.inputs.as_ref()?);
        let empty = |pdo: &PdoSpec| pdo.entries.is_empty();
        if outputs.iter().chain(inputs).any(empty) {
            return None;
        }
        let channel = |outputs, pdos: &[PdoSpec]| Channel {
            number: if outputs { 2 } else { 3 },
            outputs,
            start: 0,
            control: 0,
            pdos: pdos
                .iter()
                .map(|pdo| Pdo {
                    index: pdo.index,
                    entries: pdo.entries.clone(),
                })
                .collect(),
            op_only: false,
            unnamed: 0,
        };
        Some(Self {
            channels: vec![channel(true, outputs), channel(false, inputs)],
        })
    }

    /// Three buffers of each SyncManager must fit before the next one begins. The output registers of digital terminals
    /// (0F00h to 0F03h) are no buffered memory: there bytes are adjacent.
    pub(super) fn check(&self) -> Result<(), Fault> {
        let buffered = |channel: &&Channel| channel.start >= crate::register::PROCESS_DATA;
        for channel in self.channels.iter().filter(buffered) {
            let after = self
                .channels
                .iter()
                .map(|other| other.start)
                .filter(|start| *start > channel.start);
            let Some(next) = after.min() else {
                continue;
            };
            let capacity = usize::from(next - channel.start) / 3;
            if channel.len() > capacity && channel.control & 3 == 0 {
                return Err(Fault::Mapping {
                    sync_manager: channel.number,
                    bytes: channel.len(),
                    capacity,
                });
            }
        }
        Ok(())
    }

    /// Length of the outputs, bytes.
    pub fn outputs_len(&self) -> usize {
        self.len_of(true)
    }

    /// Length of the inputs, bytes.
    pub fn inputs_len(&self) -> usize {
        self.len_of(false)
    }

    fn len_of(&self, outputs: bool) -> usize {
        let channels = self
            .channels
            .iter()
            .filter(|channel| channel.outputs == outputs);
        channels.map(Channel::len).sum()
    }

    /// The location of an object; `None` if no PDO carries it.
    pub fn locate(&self, address: Address, outputs: bool) -> Option<Located> {
        let mut bytes = 0;
        for channel in self
            .channels
            .iter()
            .filter(|channel| channel.outputs == outputs)
        {
            let mut bit = 8 * bytes;
            for entry in channel.pdos.iter().flat_map(|pdo| &pdo.entries) {
                if entry.address == address && !entry.is_gap() {
                    return Some(Located {
                        outputs,
                        bit,
                        bits: entry.bits,
                    });
                }
                bit += usize::from(entry.bits);
            }
            bytes += channel.len();
        }
        None
    }

    /// The writes that configure the wanted PDOs of a CoE slave.
    pub(super) fn assignments(&self, spec: &SlaveSpec) -> Vec<Assignment> {
        let mut all = Vec::new();
        for (outputs, wanted) in [(true, &spec.outputs), (false, &spec.inputs)] {
            let Some(wanted) = wanted else {
                continue;
            };
            let channels = self
                .channels
                .iter()
                .filter(|channel| channel.outputs == outputs);
            for channel in channels {
                let has = |pdo: &&PdoSpec| channel.pdos.iter().any(|had| had.index == pdo.index);
                let pdos: Vec<&PdoSpec> = wanted.iter().filter(has).collect();
                assign(channel.assignment(), &pdos, &mut all);
            }
        }
        all
    }
}

/// The first entry of a PDO that differs from the written one.
fn mapping_difference(wanted: &PdoSpec, found: &Pdo) -> Option<Fault> {
    let longest = wanted.entries.len().max(found.entries.len());
    let written = !wanted.entries.is_empty();
    let at = (0..longest)
        .filter(|_| written)
        .find(|at| wanted.entries.get(*at) != found.entries.get(*at))?;
    Some(Fault::Mapped {
        address: Address::new(wanted.index, u8::try_from(at + 1).unwrap_or(u8::MAX)),
        wanted: wanted.entries.get(at).copied(),
        found: found.entries.get(at).copied(),
    })
}

/// The assignment is cleared, each PDO is cleared and written, then the assignment is written: the order that slaves
/// require.
fn assign(list: u16, pdos: &[&PdoSpec], all: &mut Vec<Assignment>) {
    let mut write = |index: u16, sub: usize, value: u32, len: u8| {
        let sub = u8::try_from(sub).unwrap_or(u8::MAX);
        all.push(Assignment {
            address: Address::new(index, sub),
            value,
            len,
        });
    };
    let count = |len: usize| u32::try_from(len).unwrap_or(u32::MAX);
    write(list, 0, 0, 1);
    for pdo in pdos.iter().filter(|pdo| !pdo.entries.is_empty()) {
        write(pdo.index, 0, 0, 1);
        for (number, entry) in pdo.entries.iter().enumerate() {
            write(pdo.index, number + 1, entry.raw(), 4);
        }
        write(pdo.index, 0, count(pdo.entries.len()), 1);
    }
    for (number, pdo) in pdos.iter().enumerate() {
        write(list, number + 1, pdo.index.into(), 2);
    }
    write(list, 0, count(pdos.len()), 1);
}

fn sii_pdos(sii: &Sii<'_>, outputs: bool) -> impl Iterator<Item = (Pdo, u8)> {
    let kind = if outputs {
        Category::RxPdo
    } else {
        Category::TxPdo
    };
    sii.pdos(kind).map(|pdo| {
        let entries = pdo.entries().map(|entry| Mapped {
            address: Address::new(entry.index, entry.sub),
            bits: entry.bits,
        });
        let index = pdo.index;
        (
            Pdo {
                index,
                entries: entries.collect(),
            },
            pdo.sync_manager,
        )
    })
}

/// A wanted PDO with its entries, from the SII if none are given.
fn known(wanted: &PdoSpec, sii: &Sii<'_>, outputs: bool) -> Pdo {
    let index = wanted.index;
    if !wanted.entries.is_empty() {
        return Pdo {
            index,
            entries: wanted.entries.clone(),
        };
    }
    let found = sii_pdos(sii, outputs).find(|(pdo, _)| pdo.index == index);
    found.map_or(
        Pdo {
            index,
            entries: Vec::new(),
        },
        |(pdo, _)| pdo,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Location;

    fn mapped(index: u16, bits: u8) -> Mapped {
        Mapped {
            address: Address::new(index, 0),
            bits,
        }
    }

    fn spec() -> SlaveSpec {
        SlaveSpec {
            outputs: Some(vec![PdoSpec {
                index: 0x1600,
                entries: vec![mapped(0x6040, 16), mapped(0x607A, 32)],
            }]),
            inputs: Some(vec![PdoSpec {
                index: 0x1A01,
                entries: vec![],
            }]),
            ..SlaveSpec::new("axis", Location::Position(0))
        }
    }

    fn channel(number: u8, start: u16) -> Channel {
        let sm = SiiSyncManager {
            start,
            len: 6,
            control: 0x64,
            enable: 1,
            kind: if number == 2 { 3 } else { 4 },
        };
        Channel::new(&sm, number)
    }

    #[test]
    fn pdo_lists_are_cleared_before_they_are_written() {
        let mut data = ProcessData {
            channels: vec![channel(2, 0x1100), channel(3, 0x1200)],
        };
        data.want(&spec(), &Sii::new(&[])).unwrap();
        let writes: Vec<_> = data
            .assignments(&spec())
            .iter()
            .map(|a| {
                let mut bytes = vec![];
                a.bytes(&mut bytes);
                (a.address.to_string(), bytes)
            })
            .collect();
        let expected: [(&str, &[u8]); 10] = [
            ("1C12h:00", &[0]),
            ("1600h:00", &[0]),
            ("1600h:01", &[16, 0, 0x40, 0x60]),
            ("1600h:02", &[32, 0, 0x7A, 0x60]),
            ("1600h:00", &[2]),
            ("1C12h:01", &[0, 0x16]),
            ("1C12h:00", &[1]),
            ("1C13h:00", &[0]),
            ("1C13h:01", &[1, 0x1A]),
            ("1C13h:00", &[1]),
        ];
        let expected: Vec<_> = expected
            .iter()
            .map(|(a, b)| ((*a).to_owned(), b.to_vec()))
            .collect();
        assert_eq!(writes, expected);
    }

    #[test]
    fn objects_are_found_and_three_buffers_must_fit() {
        let mut data = ProcessData {
            channels: vec![channel(2, 0x1100), channel(3, 0x1112)],
        };
        let sii = Sii::new(&[]);
        data.want(&spec(), &sii).unwrap();
        assert_eq!((data.outputs_len(), data.inputs_len()), (6, 0));
        let found = data.locate(Address::new(0x607A, 0), true).unwrap();
        assert_eq!((found.bit, found.bits), (16, 32));
        assert_eq!(data.locate(Address::new(0x607A, 0), false), None);
        data.channels[1].start = 0x1111;
        let fault = Fault::Mapping {
            sync_manager: 2,
            bytes: 6,
            capacity: 5,
        };
        assert_eq!(data.check(), Err(fault));
        data.channels.remove(0);
        let fault = Fault::NoChannel { outputs: true };
        assert_eq!(data.want(&spec(), &sii), Err(fault));
        assert_eq!(ProcessData::from_spec(&spec()), None);
    }
}

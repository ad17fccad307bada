//! Firmware of terminals with a mailbox: an object dictionary with identity and PDOs, whose assignment determines the
//! length of their process data. The channels belong to an [`Io`].

use takt_cia402::dictionary::{
    AbortCode, Access, Address, Dictionary, DictionaryError, Entry, Hooks, Mapped, Object,
    ObjectCode,
};

use crate::emulator::application::{Application, Cycle, Setup};
use crate::emulator::coe::CoeServer;
use crate::emulator::drive::{assignable, counted};
use crate::emulator::image::{PdoImage, SiiImage};
use crate::emulator::terminal::Io;
use crate::{AlState, AlStatusCode};

/// Maximum number of assigned PDOs.
const ASSIGNED: u8 = 8;
/// CoE details: PDO assignment; complete access.
const ASSIGNS: u8 = 0x04;
const COMPLETE: u8 = 0x20;

/// The firmware.
#[derive(Debug)]
pub(super) struct Firmware {
    dictionary: Dictionary,
    coe: CoeServer,
    io: Io,
    /// The PDOs per direction: receive, transmit.
    pdos: [Vec<PdoImage>; 2],
    state: AlState,
}

/// Checks before a write.
struct Rules(AlState);

impl Hooks for Rules {
    fn before_download(
        &mut self,
        d: &Dictionary,
        at: Address,
        data: &[u8],
    ) -> Result<(), AbortCode> {
        assignable(d, at, data, self.0)
    }
}

impl Firmware {
    pub(super) fn new(sii: &SiiImage, io: Io) -> Result<Self, DictionaryError> {
        Ok(Self {
            dictionary: Dictionary::new(objects(sii))?,
            coe: CoeServer::new(sii.mailbox_len, sii.coe & COMPLETE != 0),
            io,
            pdos: [sii.rx_pdos.clone(), sii.tx_pdos.clone()],
            state: AlState::Init,
        })
    }

    /// Length of the assigned PDOs of one direction, bytes.
    fn assigned(&self, received: bool) -> u16 {
        let (list, pdos) = if received {
            (0x1C12, &self.pdos[0])
        } else {
            (0x1C13, &self.pdos[1])
        };
        let count = self.dictionary.bytes(Address::new(list, 0));
        let count = count.and_then(|bytes| bytes.first().copied()).unwrap_or(0);
        let bits = |sub| {
            let index = self.dictionary.bytes(Address::new(list, sub))?;
            let index = u16::from_le_bytes(*index.first_chunk()?);
            let pdo = pdos.iter().find(|pdo| pdo.index == index)?;
            Some(pdo.bits())
        };
        let bits: usize = (1..=count).filter_map(bits).sum();
        u16::try_from(bits.div_ceil(8)).unwrap_or(u16::MAX)
    }
}

impl Application for Firmware {
    fn enter(&mut self, state: AlState, setup: &Setup) -> Result<(), AlStatusCode> {
        if state != AlState::SafeOp {
            return Ok(());
        }
        if setup.outputs != self.assigned(true) {
            return Err(AlStatusCode(0x001D));
        }
        if setup.inputs != self.assigned(false) {
            return Err(AlStatusCode(0x001E));
        }
        Ok(())
    }

    fn leave(&mut self, _: AlState, to: AlState) {
        self.state = to;
        if to == AlState::Init {
            self.coe.reset();
        }
    }

    fn mailbox(&mut self, request: &[u8], reply: &mut Vec<u8>) -> bool {
        let mut rules = Rules(self.state);
        self.coe
            .answer(request, reply, &mut self.dictionary, &mut rules)
    }

    fn unasked(&mut self, message: &mut Vec<u8>) -> bool {
        self.coe.unasked(message)
    }

    fn cycle(&mut self, cycle: &Cycle<'_>, inputs: &mut [u8]) {
        self.io.cycle(cycle, inputs);
    }

    fn reset(&mut self) {
        self.dictionary.restore_defaults();
        self.coe.reset();
    }
}

fn objects(sii: &SiiImage) -> Vec<Object> {
    let number = |name, value: u32| Entry::number(name, Access::Const, value);
    let kind = |value: u8| Entry::number("SyncManager", Access::ReadOnly, value);
    let mut all = vec![
        Object::var(0x1000, number("device type", 0x0000_1389)),
        // The order code alone, so that it is longer than an expedited answer.
        Object::var(0x1008, Entry::text("device name", &sii.order)),
        Object::record(
            0x1018,
            "identity",
            vec![
                number("vendor", sii.identity.vendor),
                number("product code", sii.identity.product),
                number("revision", sii.identity.revision),
                number("serial number", sii.identity.serial),
            ],
        ),
        Object::array(0x1C00, "sync manager type", (1..=4).map(kind).collect()),
    ];
    let access = if sii.coe & ASSIGNS == 0 {
        Access::ReadOnly
    } else {
        Access::ReadWrite
    };
    for (list, name, pdos) in [
        (0x1C12, "RxPDO assign", &sii.rx_pdos),
        (0x1C13, "TxPDO assign", &sii.tx_pdos),
    ] {
        let assigned = pdos.iter().filter(|pdo| pdo.sync_manager != 0xFF);
        let indices: Vec<u16> = assigned.map(|pdo| pdo.index).collect();
        all.push(counted(list, name, &indices, ASSIGNED, 0, access));
        all.extend(pdos.iter().map(mapping));
    }
    all
}

/// A PDO whose mapping is fixed.
fn mapping(pdo: &PdoImage) -> Object {
    let count = u8::try_from(pdo.entries.len()).unwrap_or(u8::MAX);
    let count = Entry::number("number of entries", Access::ReadOnly, count);
    let entries = (1..).zip(&pdo.entries).map(|(sub, entry)| {
        let (index, entry_sub, bits, _) = *entry;
        let address = Address::new(index, entry_sub);
        let raw = Mapped { address, bits }.raw();
        (sub, Entry::number("entry", Access::ReadOnly, raw))
    });
    Object {
        index: pdo.index,
        name: pdo.name.clone().into(),
        code: ObjectCode::Record,
        entries: std::iter::once((0, count)).chain(entries).collect(),
    }
}

//! Checks of writes to the communication objects, before the application's checks.

use takt_cia402::dictionary::{AbortCode, Address, Dictionary, Hooks};

use super::Application;
use crate::canopen::pdo::{self, PdoCob, number_at};
use crate::canopen::store::{LOAD, SAVE};

const OFF: u32 = 1 << 31;

/// Hooks of the SDO server; they record the written object.
pub(super) struct NodeHooks<'a, A> {
    application: &'a mut A,
    written: Option<Address>,
}

impl<'a, A> NodeHooks<'a, A> {
    pub(super) const fn new(application: &'a mut A) -> Self {
        Self {
            application,
            written: None,
        }
    }

    pub(super) const fn written(&self) -> Option<Address> {
        self.written
    }
}

impl<A: Application> Hooks for NodeHooks<'_, A> {
    fn before_upload(&mut self, d: &mut Dictionary, at: Address) -> Result<(), AbortCode> {
        // Entries beyond the count of the history do not exist.
        if at.index == 0x1003 && at.sub > 0 {
            let count = d.bytes(Address::new(0x1003, 0)).and_then(<[u8]>::first);
            if count.is_none_or(|count| at.sub > *count) {
                return Err(AbortCode::NoData);
            }
        }
        self.application.before_upload(d, at)
    }

    fn before_download(
        &mut self,
        d: &Dictionary,
        at: Address,
        data: &[u8],
    ) -> Result<(), AbortCode> {
        check(d, at, data)?;
        pdo::check_download(d, at, data)?;
        self.application.check_download(d, at, data)
    }

    fn after_download(&mut self, d: &mut Dictionary, at: Address) {
        self.written = Some(at);
        self.application.after_download(d, at);
    }
}

/// The rules of CiA 301 (clause 7.5.2) for the communication objects beside those of PDOs.
pub(super) fn check(d: &Dictionary, at: Address, data: &[u8]) -> Result<(), AbortCode> {
    let value = number_of(data);
    let now = number_at(d, at).unwrap_or(0);
    let allowed = match (at.index, at.sub) {
        (0x1003, 0) => value == 0,
        // Bits 0 to 29 must not change while SYNC or TIME is produced, or while EMCY exists.
        (0x1005, 0) => changes(value, now, now & 1 << 30 != 0),
        (0x1012, 0) => changes(value, now, now & 3 << 30 != 0),
        (0x1014, 0) => {
            let id = PdoCob::from_raw(value & 0x3FFF_FFFF).identifier();
            // EMCY may use the identifiers 081h to 0FFh, PDOs may not.
            let own = (0x081..=0x0FF).contains(&(value & 0x3FFF_FFFF));
            changes(value, now, now & OFF == 0) && (id.is_some() || own)
        }
        (0x1010, 1..) if value != SAVE => return Err(AbortCode::CannotStore),
        (0x1011, 1..) if value != LOAD => return Err(AbortCode::CannotStore),
        (0x1016, 1..) => return check_consumer(d, at, value),
        (0x1019, 0) if number_at(d, Address::new(0x1006, 0)).unwrap_or(0) != 0 => {
            return Err(AbortCode::DeviceState);
        }
        (0x1019, 0) => value == 0 || (2..=240).contains(&value),
        (0x1029, 1..) => value <= 2,
        _ => true,
    };
    if allowed {
        Ok(())
    } else {
        Err(AbortCode::Value)
    }
}

/// Whether an identifier may change to this one: 11 bits, and only while it is not in use.
const fn changes(new: u32, old: u32, in_use: bool) -> bool {
    let same = (new ^ old) & 0x3FFF_FFFF == 0;
    new & 1 << 29 == 0 && new & 0x1FFF_FFFF <= 0x7FF && (same || !in_use)
}

/// Only one entry of 1016h may monitor a node.
fn check_consumer(d: &Dictionary, at: Address, value: u32) -> Result<(), AbortCode> {
    let (node, time) = (value >> 16 & 0xFF, value & 0xFFFF);
    if value >> 24 != 0 || node > 127 {
        return Err(AbortCode::Value);
    }
    if node == 0 || time == 0 {
        return Ok(());
    }
    let entries = d.object(at.index).map(|object| object.entries.as_slice());
    let twice = entries.unwrap_or_default().iter().any(|(sub, _)| {
        let other = number_at(d, Address::new(at.index, *sub)).unwrap_or(0);
        *sub > 0 && *sub != at.sub && other >> 16 & 0xFF == node && other & 0xFFFF != 0
    });
    if twice {
        Err(AbortCode::ParameterIncompatible)
    } else {
        Ok(())
    }
}

fn number_of(data: &[u8]) -> u32 {
    let mut four = [0; 4];
    four.iter_mut().zip(data).for_each(|(to, from)| *to = *from);
    u32::from_le_bytes(four)
}

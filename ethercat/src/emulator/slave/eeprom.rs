//! The SII interface of a slave (ETG.1000.4, clause 8.5; registers 0500h to 050Fh) over its EEPROM. The content of the
//! EEPROM is made by the image builder.

use crate::register;
use crate::sii;

use super::Slave;

/// Bits of SII control and status.
mod bit {
    pub(super) const WRITE_ENABLE: u16 = 0x0001;
    /// Eight bytes are read at once, rather than four.
    pub(super) const EIGHT_BYTES: u16 = 0x0040;
    /// Constant bits: the type of the interface.
    pub(super) const KIND: u16 = 0x00F0;
    pub(super) const CHECKSUM: u16 = 0x0800;
    pub(super) const COMMAND_ERROR: u16 = 0x2000;
    pub(super) const WRITE_ERROR: u16 = 0x4000;
    pub(super) const BUSY: u16 = 0x8000;
}

/// The EEPROM and the pending command.
#[derive(Clone, Debug)]
pub(super) struct Eeprom {
    bytes: Vec<u8>,
    /// SII control as written, and the completion time of the command, ns.
    pending: Option<(u16, u64)>,
    /// End of the storing time, until which it acknowledges no command, ns.
    stores: u64,
}

impl Eeprom {
    pub(super) const fn new(bytes: Vec<u8>) -> Self {
        Self {
            bytes,
            pending: None,
            stores: 0,
        }
    }

    pub(super) const fn reset(&mut self) {
        (self.pending, self.stores) = (None, 0);
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    pub(super) const fn bytes_mut(&mut self) -> &mut Vec<u8> {
        &mut self.bytes
    }

    fn word(&self, at: u16) -> [u8; 2] {
        let at = 2 * usize::from(at);
        let word = self.bytes.get(at..at + 2).and_then(|two| two.first_chunk());
        word.copied().unwrap_or([0xFF; 2])
    }

    /// Whether the configuration area fits its checksum.
    fn is_sound(&self) -> bool {
        let area = self.bytes.get(..14).unwrap_or_default();
        self.bytes.get(14).copied() == Some(sii::checksum(area))
    }
}

impl Slave {
    /// Loads the configuration area: at power-on and by command.
    pub(super) fn load_configuration(&mut self) {
        let status = self.sii_kind()
            | if self.eeprom.is_sound() {
                0
            } else {
                bit::CHECKSUM
            };
        self.memory
            .set(register::SII_CONTROL, &status.to_le_bytes());
        if !self.eeprom.is_sound() {
            return;
        }
        self.memory.set(register::PDI_CONTROL, &self.eeprom.word(0));
        self.memory.set(0x0150, &self.eeprom.word(1));
        self.memory
            .set(register::STATION_ALIAS, &self.eeprom.word(sii::word::ALIAS));
        if self.config.clock.is_some() {
            self.memory.set(0x0982, &self.eeprom.word(2));
        }
    }

    /// A command was written.
    pub(super) fn begin_sii(&mut self, now: u64) {
        if self.eeprom.pending.is_some() {
            return;
        }
        let control = self.memory.word(register::SII_CONTROL);
        let command = control >> 8 & 0x07;
        let [access, _] = self.memory.get(register::SII_ACCESS);
        let held = self.faults.sii_held && access & 0x02 == 0;
        self.memory.set(register::SII_ACCESS + 1, &[u8::from(held)]);
        if command != 0 && (held || access & 0x01 != 0) {
            self.set_sii_status(bit::COMMAND_ERROR);
            return;
        }
        if matches!(command, 1 | 2) && now < self.eeprom.stores {
            self.set_sii_status(control & 0x0700 | bit::COMMAND_ERROR);
            return;
        }
        if command == 2 && self.faults.refuses_sii_write() {
            self.set_sii_status(control & 0x0700 | bit::COMMAND_ERROR);
            return;
        }
        let times = self.config.times;
        let busy = match command {
            2 => times.sii_write.draw(&mut self.random),
            _ => times.sii_read.draw(&mut self.random),
        };
        if command == 2 {
            self.eeprom.stores = now + busy + times.sii_store.draw(&mut self.random);
        }
        let status = control & 0x0700 | self.sii_kind() | bit::BUSY;
        self.memory
            .set(register::SII_CONTROL, &status.to_le_bytes());
        self.eeprom.pending = Some((control, now + busy));
        if command == 0 {
            self.poll_sii(u64::MAX);
        }
    }

    /// Completes a command when its time has passed.
    pub(super) fn poll_sii(&mut self, now: u64) {
        if let Some((control, _)) = self.eeprom.pending.filter(|(_, due)| now >= *due) {
            self.eeprom.pending = None;
            self.finish_sii(control);
        }
    }

    const fn sii_kind(&self) -> u16 {
        self.config.chip.sii_status & bit::KIND
    }

    fn set_sii_status(&mut self, errors: u16) {
        let status = errors | self.sii_kind();
        self.memory
            .set(register::SII_CONTROL, &status.to_le_bytes());
    }

    fn finish_sii(&mut self, control: u16) {
        let address = u32::from_le_bytes(self.memory.get(register::SII_ADDRESS));
        let at = usize::try_from(address)
            .unwrap_or(usize::MAX)
            .saturating_mul(2);
        let mut errors = 0;
        match control >> 8 & 0x07 {
            0 => {}
            1 => {
                let bytes = self.eeprom.bytes.get(at..).unwrap_or_default();
                let mut data = [0xFF; 8];
                for (to, from) in data.iter_mut().zip(bytes) {
                    *to = *from;
                }
                let eight = self.sii_kind() & bit::EIGHT_BYTES != 0;
                let len = if eight { 8 } else { 4 };
                self.memory
                    .set(register::SII_DATA, data.get(..len).unwrap_or_default());
            }
            2 if control & bit::WRITE_ENABLE == 0 => errors = bit::WRITE_ERROR,
            2 => {
                let word: [u8; 2] = self.memory.get(register::SII_DATA);
                match self.eeprom.bytes.get_mut(at..at.saturating_add(2)) {
                    Some(to) => to.copy_from_slice(&word),
                    None => errors = bit::COMMAND_ERROR,
                }
            }
            4 => {
                self.load_configuration();
                return;
            }
            _ => errors = bit::COMMAND_ERROR,
        }
        self.set_sii_status(errors);
    }
}

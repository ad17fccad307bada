//! The slave controller chip: constant registers, number of FMMUs and SyncManagers, memory and clock. Firmware is not
//! here.

use crate::register;

/// Distributed clock unit of a chip. Register 0008h is not sufficient: chips announce a clock (bit 2) even if the unit
/// is disabled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ClockUnit {
    /// Nothing answers from 0900h to 09FFh.
    Absent,
    /// Receive times alone (0900h to 090Fh); from 0910h on nothing answers.
    ReceiveTimes,
    /// A system time of 32 bits; 0914h to 0917h read zero.
    Bits32,
    /// A system time of 64 bits.
    #[default]
    Bits64,
}

impl ClockUnit {
    /// Whether the clock unit answers an access of this address and length.
    pub(in crate::emulator) fn answers(self, at: usize, len: usize) -> bool {
        let first = match self {
            Self::Absent => usize::from(register::DC_RECEIVE_TIMES),
            Self::ReceiveTimes => usize::from(register::DC_SYSTEM_TIME),
            Self::Bits32 | Self::Bits64 => return true,
        };
        at >= 0x0A00 || at + len <= first
    }

    /// The bits of a time that it implements.
    pub(in crate::emulator) const fn mask(self) -> u64 {
        match self {
            Self::Bits32 => u32::MAX as u64,
            Self::Absent | Self::ReceiveTimes | Self::Bits64 => u64::MAX,
        }
    }
}

/// Properties of a slave controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chip {
    /// Type (0000h).
    pub kind: u8,
    /// Revision (0001h).
    pub revision: u8,
    /// Build (0002h).
    pub build: u16,
    /// FMMUs, 1 to 8.
    pub fmmus: u8,
    /// SyncManagers, 1 to 8.
    pub sync_managers: u8,
    /// Process data memory, KiB, 1 to 8; addresses beyond do not answer.
    pub ram_kib: u8,
    /// Port types (0007h), two bits each; `None` for MII ports as wired.
    pub ports: Option<u8>,
    /// Features (0008h) except bit 9; `None` for those of its clock.
    pub features: Option<u16>,
    /// Its clock.
    pub clock: ClockUnit,
    /// Bits 0 to 2 of DL status: EEPROM loaded, application watchdog, enhanced link detection.
    pub dl_status: u8,
    /// SII status at rest, bits 4 to 7: 6 reads eight bytes rather than four, 7 has two address bytes, 5 an EEPROM
    /// that firmware emulates.
    pub sii_status: u16,
    /// Receive times of ports without a link.
    pub unused_times: [u8; 4],
}

impl Default for Chip {
    /// 8 FMMUs, 8 SyncManagers, 8 KiB, a clock of 64 bits.
    fn default() -> Self {
        Self {
            kind: 0x11,
            revision: 0,
            build: 1,
            fmmus: 8,
            sync_managers: 8,
            ram_kib: 8,
            ports: None,
            features: None,
            clock: ClockUnit::Bits64,
            dl_status: 0x03,
            sii_status: 0x0040,
            unused_times: [0; 4],
        }
    }
}

impl Chip {
    /// Register 0008h; `lrw` is false for a slave that cannot do LRW (bit 9).
    pub(super) fn feature_bits(&self, lrw: bool) -> u16 {
        let own = self.features.unwrap_or(match self.clock {
            ClockUnit::Absent => 0x0040,
            ClockUnit::ReceiveTimes | ClockUnit::Bits64 => 0x01CC,
            ClockUnit::Bits32 => 0x01C4,
        });
        own & !0x0200 | u16::from(!lrw) << 9
    }

    /// First address after its memory.
    pub(in crate::emulator) fn end(&self) -> usize {
        usize::from(register::PROCESS_DATA) + 1024 * usize::from(self.ram_kib.clamp(1, 8))
    }
}

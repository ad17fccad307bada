//! Register addresses of a slave controller, and its two register structures: FMMU and SyncManager (ETG.1000.4, clauses
//! 8 and 9). The behaviour of registers is in the emulator.

/// A register address.
pub type Register = u16;

/// Type, revision, build, features: 10 bytes.
pub const INFORMATION: Register = 0x0000;
/// Station address, 2 bytes.
pub const STATION_ADDRESS: Register = 0x0010;
/// Station alias, 2 bytes.
pub const STATION_ALIAS: Register = 0x0012;
/// DL control, 4 bytes.
pub const DL_CONTROL: Register = 0x0100;
/// Loop control alone, 1 byte: two bits a port, 0 automatic, 1 automatic close, 2 open, 3 closed.
pub(crate) const LOOP_CONTROL: Register = 0x0101;
/// DL status, 2 bytes.
pub const DL_STATUS: Register = 0x0110;
/// AL control, 2 bytes.
pub const AL_CONTROL: Register = 0x0120;
/// AL status, 2 bytes; its code follows at [`AL_STATUS_CODE`].
pub const AL_STATUS: Register = 0x0130;
/// AL status code, 2 bytes.
pub const AL_STATUS_CODE: Register = 0x0134;
/// PDI control, 1 byte: type of the process data interface.
pub const PDI_CONTROL: Register = 0x0140;
/// ESC configuration, 1 byte, from SII word 0: bit 0 AL status is AL control (device emulation), 2 SYNC outputs,
/// 3 latch inputs of the clock.
pub(crate) const ESC_CONFIGURATION: Register = 0x0141;
/// ECAT event mask, 2 bytes.
pub const ECAT_EVENT_MASK: Register = 0x0200;
/// ECAT event request, 2 bytes.
pub const ECAT_EVENT: Register = 0x0210;
/// Error counters of the ports: 4 x (invalid frames, receive errors), 4 forwarded, 2 of the
/// processing unit, 2 unused, 4 lost links: 20 bytes.
pub const ERROR_COUNTERS: Register = 0x0300;
/// Lost link counters of the ports, 4 bytes.
pub const LOST_LINKS: Register = 0x0310;
/// Watchdog divider, 2 bytes, of (n + 2) x 40 ns.
pub const WATCHDOG_DIVIDER: Register = 0x0400;
/// Process data watchdog, 2 bytes, in units of the divider.
pub const WATCHDOG_PROCESS_DATA: Register = 0x0420;
/// Process data watchdog status, 2 bytes; its expiry counter is at 0442h.
pub const WATCHDOG_STATUS: Register = 0x0440;
/// SII access: owner of the SII, 2 bytes.
pub const SII_ACCESS: Register = 0x0500;
/// SII control and status, 2 bytes; the address follows.
pub const SII_CONTROL: Register = 0x0502;
/// SII word address, 4 bytes.
pub const SII_ADDRESS: Register = 0x0504;
/// SII data, 4 or 8 bytes.
pub const SII_DATA: Register = 0x0508;
/// FMMU 0; the others follow every 16 bytes.
pub const FMMU: Register = 0x0600;
/// SyncManager 0; the others follow every 8 bytes.
pub const SYNC_MANAGER: Register = 0x0800;
/// Receive times of the ports, 4 x 4 bytes; a write latches them.
pub const DC_RECEIVE_TIMES: Register = 0x0900;
/// System time, 8 bytes.
pub const DC_SYSTEM_TIME: Register = 0x0910;
/// Receive time at the processing unit, 8 bytes.
pub const DC_RECEIVE_TIME_ECAT: Register = 0x0918;
/// System time offset, 8 bytes.
pub const DC_OFFSET: Register = 0x0920;
/// Propagation delay, 4 bytes.
pub const DC_DELAY: Register = 0x0928;
/// System time difference, 4 bytes: bit 31 is the sign, set when the slave is ahead.
pub const DC_DIFFERENCE: Register = 0x092C;
/// Speed counter start, 2 bytes.
pub const DC_SPEED_START: Register = 0x0930;
/// Filter depths, 2 bytes.
pub const DC_FILTERS: Register = 0x0934;
/// Cyclic unit control and activation, 2 bytes.
pub const DC_CONTROL: Register = 0x0980;
/// Activation alone, 1 byte.
pub(crate) const DC_ACTIVATION: Register = 0x0981;
/// Start time of SYNC0, 8 bytes; read, the next one.
pub const DC_START_TIME: Register = 0x0990;
/// SYNC0 cycle time, 4 bytes, ns.
pub const DC_SYNC0_CYCLE: Register = 0x09A0;
/// SYNC1 cycle time, 4 bytes, ns.
pub const DC_SYNC1_CYCLE: Register = 0x09A4;
/// Output registers of digital terminals, 4 bytes; SyncManagers may lie over them.
pub(crate) const OUTPUT_REGISTERS: Register = 0x0F00;
/// Start of the process data memory.
pub const PROCESS_DATA: Register = 0x1000;

/// A fieldbus memory management unit: maps logical bits to physical bits.
///
/// | bytes | what |
/// |---|---|
/// | 0 to 3 | logical start address |
/// | 4, 5 | length, bytes touched |
/// | 6, 7 | logical start bit, stop bit |
/// | 8, 9 | physical start address |
/// | 10 | physical start bit |
/// | 11 | bit 0 read (slave to master), bit 1 write |
/// | 12 | bit 0 active |
/// | 13 to 15 | zero |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Fmmu {
    /// Logical start address.
    pub logical: u32,
    /// Length in logical bytes.
    pub len: u16,
    /// First bit in the first logical byte, 0 to 7.
    pub start_bit: u8,
    /// Last bit in the last logical byte, 0 to 7.
    pub stop_bit: u8,
    /// Physical start address.
    pub physical: u16,
    /// First bit in the first physical byte, 0 to 7.
    pub physical_bit: u8,
    /// Read access of the master.
    pub reads: bool,
    /// Write access of the master.
    pub writes: bool,
    /// Active.
    pub active: bool,
}

impl Fmmu {
    /// Bytes on the wire.
    pub const LEN: usize = 16;

    /// From the bytes of a register block.
    pub const fn decode(bytes: &[u8; Self::LEN]) -> Self {
        let [a, b, c, d, e, f, start, stop, g, h, bit, kind, active, ..] = *bytes;
        Self {
            logical: u32::from_le_bytes([a, b, c, d]),
            len: u16::from_le_bytes([e, f]),
            start_bit: start & 7,
            stop_bit: stop & 7,
            physical: u16::from_le_bytes([g, h]),
            physical_bit: bit & 7,
            reads: kind & 1 != 0,
            writes: kind & 2 != 0,
            active: active & 1 != 0,
        }
    }

    /// The bytes of the register block.
    pub fn encode(&self) -> [u8; Self::LEN] {
        let [a, b, c, d] = self.logical.to_le_bytes();
        let [e, f] = self.len.to_le_bytes();
        let [g, h] = self.physical.to_le_bytes();
        let kind = u8::from(self.reads) | u8::from(self.writes) << 1;
        let (start, stop) = (self.start_bit & 7, self.stop_bit & 7);
        let (bit, active) = (self.physical_bit & 7, self.active.into());
        [
            a, b, c, d, e, f, start, stop, g, h, bit, kind, active, 0, 0, 0,
        ]
    }

    /// Number of mapped bits.
    pub fn bits(&self) -> usize {
        let whole = usize::from(self.len).saturating_sub(1) * 8;
        (whole + usize::from(self.stop_bit) + 1).saturating_sub(self.start_bit.into())
    }
}

/// A SyncManager channel: a guarded area of process data memory.
///
/// | bytes | what |
/// |---|---|
/// | 0, 1 | physical start address |
/// | 2, 3 | length |
/// | 4 | control: bits 0, 1 mode (0 three buffers, 2 mailbox), 2, 3 direction (0 read, 1 write), 6 watchdog |
/// | 5 | status: bit 0 written, 1 read, 3 mailbox full, 4, 5 last buffer |
/// | 6 | activate: bit 0 enabled, 1 repeat request |
/// | 7 | PDI control:  bit 0 disabled, 1 repeat acknowledge |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SyncManager {
    /// Physical start address.
    pub start: u16,
    /// Length, bytes.
    pub len: u16,
    /// Mode, direction, events.
    pub control: u8,
    /// Status of the buffer.
    pub status: u8,
    /// Activation by the master.
    pub activate: u8,
    /// Control by the slave.
    pub pdi: u8,
}

impl SyncManager {
    /// Bytes on the wire.
    pub const LEN: usize = 8;
    /// Control of a mailbox that the master writes.
    pub(crate) const MAILBOX_OUT: u8 = 0x26;
    /// Control of a mailbox that the master reads.
    pub(crate) const MAILBOX_IN: u8 = 0x22;
    /// Control of process data that the master writes, with watchdog.
    pub const OUTPUTS: u8 = 0x64;
    /// Control of process data that the master reads.
    pub const INPUTS: u8 = 0x20;

    /// From the bytes of a register block.
    pub const fn decode(bytes: &[u8; Self::LEN]) -> Self {
        let [a, b, c, d, control, status, activate, pdi] = *bytes;
        Self {
            start: u16::from_le_bytes([a, b]),
            len: u16::from_le_bytes([c, d]),
            control,
            status,
            activate,
            pdi,
        }
    }

    /// The bytes of the register block.
    pub const fn encode(&self) -> [u8; Self::LEN] {
        let [a, b] = self.start.to_le_bytes();
        let [c, d] = self.len.to_le_bytes();
        [
            a,
            b,
            c,
            d,
            self.control,
            self.status,
            self.activate,
            self.pdi,
        ]
    }

    /// Whether it is enabled.
    pub const fn is_enabled(&self) -> bool {
        self.activate & 1 != 0 && self.pdi & 1 == 0 && self.len > 0
    }

    /// Whether it is a mailbox rather than three buffers.
    pub const fn is_mailbox(&self) -> bool {
        self.control & 3 == 2
    }

    /// Whether the master writes it.
    pub(crate) const fn is_written_by_master(&self) -> bool {
        self.control >> 2 & 3 == 1
    }

    /// Whether its mailbox holds a message.
    pub const fn is_full(&self) -> bool {
        self.status & 0x08 != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_read_back() {
        let fmmu = Fmmu {
            logical: 0x0001_0002,
            len: 3,
            start_bit: 2,
            stop_bit: 5,
            physical: 0x1100,
            physical_bit: 1,
            reads: true,
            writes: false,
            active: true,
        };
        let bytes = [2, 0, 1, 0, 3, 0, 2, 5, 0, 0x11, 1, 1, 1, 0, 0, 0];
        assert_eq!(fmmu.encode(), bytes);
        assert_eq!(Fmmu::decode(&bytes), fmmu);
        assert_eq!(fmmu.bits(), 20);
        let sm = SyncManager {
            start: 0x1000,
            len: 128,
            control: SyncManager::MAILBOX_OUT,
            status: 0x08,
            activate: 1,
            pdi: 0,
        };
        let bytes = [0, 0x10, 128, 0, 0x26, 8, 1, 0];
        assert_eq!(sm.encode(), bytes);
        assert_eq!(SyncManager::decode(&bytes), sm);
        assert!(sm.is_enabled() && sm.is_mailbox() && sm.is_written_by_master() && sm.is_full());
    }

    #[test]
    fn any_fmmu_counts_its_bits() {
        for start_bit in 0..8 {
            for stop_bit in 0..8 {
                for len in 0..4 {
                    let fmmu = Fmmu {
                        len,
                        start_bit,
                        stop_bit,
                        ..Fmmu::default()
                    };
                    assert!(fmmu.bits() <= 32);
                }
            }
        }
    }
}

//! The memory of a slave controller as both sides see it: registers with their access rules, event requests, and the
//! process data memory (ETG.1000.4, clauses 8 and 9). SyncManagers are in [`buffers`]; the application handles events.

mod buffers;

use crate::SyncManager;
use crate::register;
use crate::register::Register;

use super::slave::Chip;
use buffers::Channel;

/// Maximum number of SyncManagers of an emulated controller.
pub(super) const SYNC_MANAGERS: usize = 8;
/// Bytes of registers and process data memory.
const SIZE: usize = 0x1000 + 0x2000;
/// Registers of the distributed clock.
const CLOCK: std::ops::Range<u16> = 0x0900..0x0A00;

/// Bits of the ECAT event request (0210h) that are latched until the master reads their cause.
pub(super) mod ecat_event {
    /// DL status changed; reading it clears this.
    pub(in super::super) const DL_STATUS: u16 = 1 << 2;
    /// AL status changed; reading it clears this.
    pub(in super::super) const AL_STATUS: u16 = 1 << 3;
}

/// Bits of the AL event request (0220h) that are latched until the firmware handles them.
pub(super) mod al_event {
    /// AL control was written.
    pub(in super::super) const AL_CONTROL: u32 = 1 << 0;
    /// SYNC0 occurred.
    pub(in super::super) const SYNC0: u32 = 1 << 2;
    /// SYNC1 occurred.
    pub(in super::super) const SYNC1: u32 = 1 << 3;
    /// A SyncManager was switched on or off.
    pub(in super::super) const ACTIVATION: u32 = 1 << 4;
    /// The watchdog of the process data expired.
    pub(in super::super) const WATCHDOG: u32 = 1 << 6;
}

/// Actions of the master since the last check of the application.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Events {
    /// It wrote AL control.
    pub(super) al_control: bool,
    /// It wrote an SII command.
    pub(super) sii: bool,
    /// It wrote outputs.
    pub(super) outputs: bool,
    /// It requests a repeat of the last mailbox message.
    pub(super) repeat: bool,
    /// It wrote to the receive times: latch them.
    pub(super) latch: bool,
    /// Number of bytes of the system time written, 0 for none.
    pub(super) system_time: usize,
    /// It wrote the settings of the loop.
    pub(super) filters: bool,
    /// It wrote the activation of SYNC0.
    pub(super) activation: bool,
}

/// The memory.
#[derive(Clone, Debug)]
pub(super) struct Memory {
    bytes: Vec<u8>,
    channels: [Channel; SYNC_MANAGERS],
    /// The last sent mailbox message, for a repeat.
    last_sent: Vec<u8>,
    chip: Chip,
    /// AL control cannot be written again before the firmware has read it.
    locks: bool,
    /// The firmware has not read AL control yet.
    pub(super) al_locked: bool,
    /// Stale bytes follow a message in a mailbox.
    dirty: bool,
    ecat_events: u16,
    al_events: u32,
    pub(super) events: Events,
}

/// Registers that a master cannot write: first and last byte.
const READ_ONLY: [(Register, Register); 13] = [
    (0x0000, 0x000F),
    (0x0012, 0x0013),
    (0x0110, 0x0113),
    (0x0130, 0x0137),
    (0x0140, 0x01FF),
    (0x0204, 0x02FF),
    (0x0440, 0x0441),
    (0x0501, 0x0501),
    (0x0918, 0x091F),
    (0x092C, 0x092F),
    (0x0932, 0x0933),
    (0x0982, 0x098F),
    (0x0998, 0x099F),
];

/// Whether a write is one to the system time difference alone, which does not increment the working counter.
const fn is_read_only(at: usize, end: usize) -> bool {
    let register = register::DC_DIFFERENCE as usize;
    at >= register && end <= register + 4
}

impl Memory {
    pub(super) fn new(chip: Chip, locks: bool, dirty: bool) -> Self {
        Self {
            bytes: vec![0; SIZE],
            channels: std::array::from_fn(|_| Channel::default()),
            last_sent: Vec::new(),
            chip,
            locks,
            al_locked: false,
            dirty,
            ecat_events: 0,
            al_events: 0,
            events: Events::default(),
        }
    }

    /// The bytes of a register, without access checks.
    pub(super) fn get<const N: usize>(&self, at: Register) -> [u8; N] {
        let at = usize::from(at);
        let bytes = self.bytes.get(at..at + N).and_then(|b| b.first_chunk());
        bytes.copied().unwrap_or([0; N])
    }

    /// Sets the bytes of a register, without access checks and side effects.
    pub(super) fn set(&mut self, at: Register, bytes: &[u8]) {
        let at = usize::from(at);
        if let Some(to) = self.bytes.get_mut(at..at + bytes.len()) {
            to.copy_from_slice(bytes);
        }
    }

    pub(super) fn word(&self, at: Register) -> u16 {
        u16::from_le_bytes(self.get(at))
    }

    /// Increments a counter that saturates at 255.
    pub(super) fn count(&mut self, at: Register) {
        let [counter] = self.get(at);
        self.set(at, &[counter.saturating_add(1)]);
    }

    /// Sets a register (DL status, AL status) and raises an event if it changed.
    pub(super) fn set_with_event(&mut self, at: Register, value: u16, event: u16) {
        if self.word(at) != value {
            self.ecat_events |= event;
        }
        self.set(at, &value.to_le_bytes());
    }

    /// Raises events that the firmware sees.
    pub(super) const fn raise(&mut self, al_event: u32) {
        self.al_events |= al_event;
    }

    /// The firmware has handled these events.
    pub(super) const fn acknowledge(&mut self, al_event: u32) {
        self.al_events &= !al_event;
    }

    /// ECAT event request as register 0210h shows it.
    pub(super) fn ecat_event(&self) -> u16 {
        self.ecat_events | self.channel_events(0x10, false) << 4
    }

    /// The events that this slave adds to the interrupt field of a datagram.
    pub(super) fn irq(&self) -> u16 {
        let mask = self.word(register::ECAT_EVENT_MASK);
        if mask == 0 {
            0
        } else {
            self.ecat_event() & mask
        }
    }

    /// AL event request as register 0220h shows it.
    pub(super) fn al_event(&self) -> u32 {
        self.al_events | u32::from(self.channel_events(0x20, true)) << 8
    }

    /// Whether these addresses answer.
    fn is_there(&self, at: u16, len: usize) -> bool {
        let at = usize::from(at);
        let clock = usize::from(CLOCK.start)..usize::from(CLOCK.end);
        let answers = !clock.contains(&at) || self.chip.clock.answers(at, len);
        answers && at + len <= self.chip.end()
    }

    /// The master reads. Returns whether the access took place; otherwise `to` is unchanged.
    pub(super) fn read(&mut self, at: u16, to: &mut [u8]) -> bool {
        if !self.is_there(at, to.len()) {
            return false;
        }
        let mut done = false;
        let mut first = 0;
        while first < to.len() {
            let here = usize::from(at) + first;
            let (guard, len) = self.piece(here, to.len() - first);
            let part = to.get_mut(first..first + len).unwrap_or_default();
            done |= match guard {
                Some(number) => self.read_guarded(number, here, part),
                None => self.read_plain(here, part),
            };
            first += len;
        }
        done
    }

    fn read_plain(&mut self, at: usize, to: &mut [u8]) -> bool {
        let touches = |register: Register, size: usize| {
            at < usize::from(register) + size && at + to.len() > usize::from(register)
        };
        let (dl, al) = (
            touches(register::DL_STATUS, 2),
            touches(register::AL_STATUS, 2),
        );
        if touches(register::ECAT_EVENT, 2) || touches(0x0220, 4) {
            let (ecat, al) = (self.ecat_event(), self.al_event());
            self.set(register::ECAT_EVENT, &ecat.to_le_bytes());
            self.set(0x0220, &al.to_le_bytes());
        }
        for (i, byte) in to.iter_mut().enumerate() {
            *byte = self.bytes.get(at + i).copied().unwrap_or(0);
        }
        if dl {
            self.ecat_events &= !ecat_event::DL_STATUS;
        }
        if al {
            self.ecat_events &= !ecat_event::AL_STATUS;
        }
        true
    }

    /// The master writes. Returns whether the access took place.
    pub(super) fn write(&mut self, at: u16, from: &[u8]) -> bool {
        let end = usize::from(at) + from.len();
        let al_control = usize::from(register::AL_CONTROL)..usize::from(register::AL_CONTROL) + 2;
        let locked = self.al_locked && al_control.contains(&usize::from(at));
        if locked || !self.is_there(at, from.len()) || is_read_only(usize::from(at), end) {
            return false;
        }
        let mut done = false;
        let mut first = 0;
        while first < from.len() {
            let here = usize::from(at) + first;
            let (guard, len) = self.piece(here, from.len() - first);
            let part = from.get(first..first + len).unwrap_or_default();
            done |= match guard {
                Some(number) => self.write_guarded(number, here, part),
                None => self.write_plain(here, part),
            };
            first += len;
        }
        done
    }

    fn write_plain(&mut self, at: usize, from: &[u8]) -> bool {
        let active: [bool; SYNC_MANAGERS] =
            std::array::from_fn(|number| self.sync_manager(number).activate & 1 != 0);
        for (i, byte) in from.iter().enumerate() {
            if let Ok(at) = u16::try_from(at + i) {
                self.write_byte(at, *byte, &active);
            }
        }
        self.note(at, from.len(), &active);
        true
    }

    fn write_byte(&mut self, at: u16, byte: u8, active: &[bool; SYNC_MANAGERS]) {
        let read_only = |(first, last): &(u16, u16)| (*first..=*last).contains(&at);
        if READ_ONLY.iter().any(read_only) {
            return;
        }
        if let Some(offset) = at.checked_sub(register::SYNC_MANAGER).filter(|o| *o < 64) {
            // Status and the slave's own byte cannot be written; the rest only while it is off.
            let is_active = active[usize::from(offset / 8)];
            if matches!(offset % 8, 5 | 7) || (is_active && offset % 8 < 5) {
                return;
            }
        }
        let missing = |first: Register, size: u16, count: u8| {
            let offset = at.checked_sub(first).filter(|offset| *offset < 16 * size);
            offset.is_some_and(|offset| offset / size >= count.into())
        };
        if missing(register::FMMU, 16, self.chip.fmmus)
            || missing(register::SYNC_MANAGER, 8, self.chip.sync_managers)
        {
            return;
        }
        if let Some(to) = self.bytes.get_mut(usize::from(at)) {
            *to = byte;
        }
    }

    /// Side effects of a write to registers.
    fn note(&mut self, at: usize, len: usize, active: &[bool; SYNC_MANAGERS]) {
        let end = at + len;
        let touched = |register: Register, size: usize| {
            let register = usize::from(register);
            end.min(register + size).saturating_sub(at.max(register))
        };
        let touches = |register: Register, size: usize| touched(register, size) > 0;
        for (first, size) in [(register::ERROR_COUNTERS, 14), (register::LOST_LINKS, 4)] {
            if touches(first, size) {
                self.bytes[usize::from(first)..usize::from(first) + size].fill(0);
            }
        }
        if touches(0x0442, 2) {
            self.set(0x0442, &[0, 0]);
        }
        for (number, was) in active.iter().enumerate() {
            let first = Self::sm_at(number);
            if touches(first, SyncManager::LEN) {
                self.sm_written(number, *was, touches(first + 6, 1));
            }
        }
        if touches(register::AL_CONTROL, 2) {
            self.raise(al_event::AL_CONTROL);
            self.al_locked = self.locks;
        }
        let events = &mut self.events;
        events.al_control |= touches(register::AL_CONTROL, 2);
        events.sii |= touches(register::SII_CONTROL + 1, 1);
        events.latch |= touches(register::DC_RECEIVE_TIMES, 1);
        events.system_time = events.system_time.max(touched(register::DC_SYSTEM_TIME, 8));
        events.filters |= touches(register::DC_SPEED_START, 6);
        events.activation |= touches(register::DC_ACTIVATION, 1);
    }
}

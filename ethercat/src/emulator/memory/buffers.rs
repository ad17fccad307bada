//! SyncManagers over the process data memory (ETG.1000.4, clause 8.4): mailboxes that are full or empty, and three
//! buffers of which the newest complete one is read. Registers are not here.

use crate::SyncManager;
use crate::register;
use crate::register::Register;

use super::{Memory, SYNC_MANAGERS, al_event};

/// Status bits of a SyncManager.
mod status {
    /// The buffer was written completely.
    pub(super) const WRITTEN: u8 = 0x01;
    /// The buffer was read completely.
    pub(super) const READ: u8 = 0x02;
    /// The mailbox is full.
    pub(super) const FULL: u8 = 0x08;
    /// Which of three buffers was written last; 3 for none.
    pub(super) const LAST: u8 = 0x30;
}

/// State of a SyncManager in process data mode, and progress of the master's access.
#[derive(Clone, Debug, Default)]
pub(super) struct Channel {
    /// The newest complete one.
    newest: Vec<u8>,
    /// The one that is being written.
    next: Vec<u8>,
    /// The one that is being read: it does not change until its last byte was read.
    reading: Vec<u8>,
    /// A buffer was written completely.
    ready: bool,
    /// Number of the last written buffer, 0 to 2.
    last: u8,
    /// The master accessed the first byte, but not yet the last.
    open: bool,
}

/// Whether a part of an area may be accessed: it starts at the first byte, or continues.
const fn opens(channel: &mut Channel, offset: usize) -> bool {
    if offset == 0 {
        channel.open = true;
    }
    channel.open
}

impl Memory {
    pub(in super::super) fn sync_manager(&self, number: usize) -> SyncManager {
        SyncManager::decode(&self.get(Self::sm_at(number)))
    }

    pub(super) const fn sm_at(number: usize) -> Register {
        #[expect(clippy::cast_possible_truncation, reason = "below eight")]
        let number = number as u16;
        register::SYNC_MANAGER + 8 * number
    }

    fn set_sm_status(&mut self, number: usize, set: u8, clear: u8) {
        let at = Self::sm_at(number) + 5;
        let [status] = self.get(at);
        self.set(at, &[status & !clear | set]);
    }

    /// Events of the SyncManagers, a bit each: seen by the master, or by the slave. `enable` is the control bit that
    /// enables them.
    pub(super) fn channel_events(&self, enable: u8, to_slave: bool) -> u16 {
        let mut events = 0;
        for number in 0..SYNC_MANAGERS {
            let sm = self.sync_manager(number);
            let written = sm.is_written_by_master() == to_slave;
            let bit = if written {
                status::WRITTEN
            } else {
                status::READ
            };
            let some = sm.is_enabled() && sm.control & enable != 0 && sm.status & bit != 0;
            events |= u16::from(some) << number;
        }
        events
    }

    /// The enabled SyncManager of an address, and how many of `len` bytes from there belong to it.
    pub(super) fn piece(&self, at: usize, len: usize) -> (Option<usize>, usize) {
        if at + len <= usize::from(register::OUTPUT_REGISTERS) {
            return (None, len);
        }
        let mut limit = len;
        for number in 0..SYNC_MANAGERS {
            let sm = self.sync_manager(number);
            let start = usize::from(sm.start);
            let end = start + usize::from(sm.len);
            if sm.activate & 1 == 0 || sm.len == 0 || end <= at {
                continue;
            }
            if start <= at {
                return (Some(number), len.min(end - at));
            }
            limit = limit.min(start - at);
        }
        (None, limit)
    }

    /// The master reads within the area of a SyncManager.
    pub(super) fn read_guarded(&mut self, number: usize, at: usize, to: &mut [u8]) -> bool {
        let sm = self.sync_manager(number);
        let offset = at - usize::from(sm.start);
        let ends = offset + to.len() == usize::from(sm.len);
        let channel = &mut self.channels[number];
        // Disabled by the slave, it locks its area.
        if !sm.is_enabled() || sm.is_written_by_master() {
            return false;
        }
        if sm.is_mailbox() {
            if !sm.is_full() || !opens(channel, offset) {
                return false;
            }
            copy(to, self.bytes.get(at..).unwrap_or_default());
        } else {
            if !channel.ready {
                return false;
            }
            if offset == 0 {
                channel.reading.clone_from(&channel.newest);
            }
            if !opens(channel, offset) {
                return false;
            }
            copy(to, channel.reading.get(offset..).unwrap_or_default());
        }
        if ends {
            self.channels[number].open = false;
            let full = if sm.is_mailbox() { status::FULL } else { 0 };
            self.set_sm_status(number, status::READ, status::WRITTEN | full);
        }
        true
    }

    /// The master writes within the area of a SyncManager.
    pub(super) fn write_guarded(&mut self, number: usize, at: usize, from: &[u8]) -> bool {
        let sm = self.sync_manager(number);
        let offset = at - usize::from(sm.start);
        let ends = offset + from.len() == usize::from(sm.len);
        let channel = &mut self.channels[number];
        let refused = !sm.is_enabled() || !sm.is_written_by_master();
        if refused || (sm.is_mailbox() && sm.is_full()) || !opens(channel, offset) {
            return false;
        }
        if ends {
            channel.open = false;
        }
        if sm.is_mailbox() {
            if let Some(to) = self.bytes.get_mut(at..at + from.len()) {
                to.copy_from_slice(from);
            }
            if ends {
                let set = status::FULL | status::WRITTEN;
                self.set_sm_status(number, set, status::READ);
            }
            return true;
        }
        channel.next.resize(sm.len.into(), 0);
        if let Some(to) = channel.next.get_mut(offset..offset + from.len()) {
            to.copy_from_slice(from);
        }
        if ends {
            channel.newest.clone_from(&channel.next);
            self.written(number);
            self.events.outputs = true;
        }
        true
    }

    /// A buffer was written completely: it is the newest.
    fn written(&mut self, number: usize) {
        let channel = &mut self.channels[number];
        channel.ready = true;
        channel.last = (channel.last + 1) % 3;
        let last = channel.last << 4;
        let clear = status::READ | status::LAST;
        self.set_sm_status(number, status::WRITTEN | last, clear);
    }

    /// The master wrote to the registers of a SyncManager , enabled or not.
    pub(super) fn sm_written(&mut self, number: usize, was_active: bool, activation: bool) {
        let sm = self.sync_manager(number);
        let active = sm.activate & 1 != 0;
        if active != was_active {
            self.empty(number);
            self.raise(al_event::ACTIVATION);
        }
        let repeat_requested = sm.activate & 0x02 != sm.pdi & 0x02;
        self.events.repeat |= activation && repeat_requested && sm.is_enabled() && sm.is_mailbox();
    }

    /// Its buffers are cleared.
    fn empty(&mut self, number: usize) {
        self.channels[number] = Channel::default();
        let all = status::WRITTEN | status::READ | status::FULL | status::LAST;
        // A mailbox has no buffers to number.
        let mailbox = self.sync_manager(number).is_mailbox();
        let set = if mailbox { 0 } else { status::LAST };
        self.set_sm_status(number, set, all);
    }

    /// The byte that a bit-wise write to an address changes.
    pub(in super::super) fn pending(&self, at: u16) -> u8 {
        let (guard, _) = self.piece(at.into(), 1);
        let buffered = guard.map(|number| (number, self.sync_manager(number)));
        match buffered.filter(|(_, sm)| !sm.is_mailbox()) {
            Some((number, sm)) => {
                let next = &self.channels[number].next;
                next.get(usize::from(at - sm.start)).copied().unwrap_or(0)
            }
            None => self.bytes.get(usize::from(at)).copied().unwrap_or(0),
        }
    }

    /// The application reads a mailbox written by the master.
    pub(in super::super) fn take_mailbox(&mut self, number: usize, to: &mut Vec<u8>) -> bool {
        let sm = self.sync_manager(number);
        if !sm.is_enabled() || !sm.is_full() {
            return false;
        }
        let start = usize::from(sm.start);
        to.clear();
        let bytes = self.bytes.get(start..start + usize::from(sm.len));
        to.extend_from_slice(bytes.unwrap_or_default());
        let clear = status::FULL | status::WRITTEN;
        self.set_sm_status(number, status::READ, clear);
        true
    }

    /// The application puts a message into a mailbox; returns whether the mailbox was free.
    pub(in super::super) fn put_mailbox(&mut self, number: usize, message: &[u8]) -> bool {
        let sm = self.sync_manager(number);
        if !sm.is_enabled() || sm.is_full() || message.len() > usize::from(sm.len) {
            return false;
        }
        self.last_sent.clear();
        self.last_sent.extend_from_slice(message);
        self.fill_mailbox(number, &sm);
        true
    }

    fn fill_mailbox(&mut self, number: usize, sm: &SyncManager) {
        let start = usize::from(sm.start);
        if let Some(area) = self.bytes.get_mut(start..start + usize::from(sm.len)) {
            if !self.dirty {
                area.fill(0);
            }
            copy(area, &self.last_sent);
        }
        self.channels[number].open = false;
        let set = status::FULL | status::WRITTEN;
        self.set_sm_status(number, set, status::READ);
    }

    /// The application answers a repeat request: the last message is available again.
    pub(in super::super) fn repeat(&mut self, number: usize) {
        let sm = self.sync_manager(number);
        if !self.last_sent.is_empty() {
            self.fill_mailbox(number, &sm);
        }
        let at = Self::sm_at(number) + 7;
        self.set(at, &[sm.pdi & !0x02 | sm.activate & 0x02]);
    }

    /// The newest outputs, if any.
    pub(in super::super) fn outputs(&self, number: usize) -> Option<&[u8]> {
        let channel = &self.channels[number];
        let enabled = self.sync_manager(number).is_enabled();
        (channel.ready && enabled).then_some(&channel.newest)
    }

    /// The firmware has read its outputs.
    pub(in super::super) fn outputs_read(&mut self, number: usize) {
        self.set_sm_status(number, status::READ, status::WRITTEN);
    }

    /// The application gives inputs.
    pub(in super::super) fn set_inputs(&mut self, number: usize, inputs: &[u8]) {
        if !self.sync_manager(number).is_enabled() {
            return;
        }
        let newest = &mut self.channels[number].newest;
        newest.clear();
        newest.extend_from_slice(inputs);
        self.written(number);
    }

    /// The slave switches a SyncManager off or on from its side.
    pub(in super::super) fn disable(&mut self, number: usize, off: bool) {
        let at = Self::sm_at(number) + 7;
        let [pdi] = self.get(at);
        self.set(at, &[pdi & !0x01 | u8::from(off)]);
        if off {
            self.empty(number);
        }
    }
}

/// Copies the available bytes; the rest is unchanged.
fn copy(to: &mut [u8], from: &[u8]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}

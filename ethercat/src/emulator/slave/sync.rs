//! Triggers of a slave's application: SYNC0, new outputs, or time; and causes that stop it: watchdog, outputs that miss
//! SYNC0, loss of SYNC0. The clock itself is in [`crate::emulator::Clock`].

use crate::register;
use crate::{AlState, AlStatusCode};

use super::super::application::Cycle;
use super::super::memory::{Events, al_event};
use super::{Arrival, ClockUnit, Slave};

/// Period of the application without SYNC0 and outputs, ns.
const IDLE: u64 = 1_000_000;
/// The next system time whose lower 32 bits are those of a start: one in the past occurs with the next wrap.
const fn next_like(start: u64, system: u64) -> u64 {
    let ahead = (start.wrapping_sub(system)) & u32::MAX as u64;
    system.wrapping_add(if ahead == 0 { 1 << 32 } else { ahead })
}

/// Maximum number of missed SYNC0 pulses that are simulated at once.
const PULSES_MAX: u64 = 64;

impl Slave {
    pub(super) fn offset(&self) -> u64 {
        u64::from_le_bytes(self.memory.get(register::DC_OFFSET))
    }

    /// Updates the clock's registers before a read.
    pub(super) fn refresh(&mut self, at: u16, len: usize, arrival: &Arrival) {
        let (first, end) = (usize::from(at), usize::from(at) + len);
        let Some(clock) = &self.clock else {
            return;
        };
        if end <= 0x0910 || first >= 0x09A0 {
            return;
        }
        let mask = self.config.chip.clock.mask();
        let system = clock.local(arrival.at).wrapping_add(self.offset()) & mask;
        let (sync0, sync1) = (clock.next_sync0(), clock.next_sync1());
        let (sync0, sync1) = (sync0.map(|at| at & mask), sync1.map(|at| at & mask));
        let speed = clock.speed_difference();
        let set = |memory: &mut super::Memory, at, value: u64| memory.set(at, &value.to_le_bytes());
        set(&mut self.memory, register::DC_SYSTEM_TIME, system);
        if let Some(next) = sync0 {
            set(&mut self.memory, register::DC_START_TIME, next);
        }
        set(&mut self.memory, 0x0998, sync1.unwrap_or(0));
        self.memory.set(0x0932, &speed.to_le_bytes());
        let pending = u8::from(sync0.is_some()) | u8::from(sync1.is_some()) << 1;
        let implausible = self.activation & 0x03 == 0x03 && sync0.is_none();
        self.memory
            .set(0x0984, &[pending | u8::from(implausible) << 2]);
    }

    pub(super) fn clock_written(&mut self, events: &Events, arrival: &Arrival) {
        let offset = self.offset();
        let Some(clock) = &mut self.clock else {
            return;
        };
        if events.latch {
            for (port, at) in (0..).zip(arrival.ports) {
                if let Some(at) = at {
                    let [a, b, c, d, ..] = clock.local(at).to_le_bytes();
                    let address = register::DC_RECEIVE_TIMES + 4 * port;
                    self.memory.set(address, &[a, b, c, d]);
                }
            }
            let local = clock.local(arrival.at) & self.config.chip.clock.mask();
            self.memory
                .set(register::DC_RECEIVE_TIME_ECAT, &local.to_le_bytes());
        }
        if events.filters {
            clock.reset_loop();
            self.memory.set(register::DC_DIFFERENCE, &[0; 4]);
        }
        if events.system_time > 0 {
            self.follow(events.system_time, offset, arrival.at);
        }
        if events.activation {
            self.activate(arrival.at);
        }
    }

    /// The system time was written, as 4 bytes or 8.
    fn follow(&mut self, len: usize, offset: u64, now: u64) {
        let Some(clock) = &mut self.clock else {
            return;
        };
        let received = u64::from_le_bytes(self.memory.get(register::DC_SYSTEM_TIME));
        let delay = u32::from_le_bytes(self.memory.get(register::DC_DELAY));
        let [depth, _] = self.memory.get(register::DC_FILTERS);
        let copy = clock.local(now).wrapping_add(offset);
        let copy = copy.wrapping_sub(delay.into());
        let difference = if len < 8 || self.config.chip.clock == ClockUnit::Bits32 {
            // Only the low half is compared.
            let [low, _] = [copy.wrapping_sub(received), 0];
            let [a, b, c, d, ..] = low.to_le_bytes();
            i64::from(i32::from_le_bytes([a, b, c, d]))
        } else {
            copy.wrapping_sub(received).cast_signed()
        };
        let filtered = clock.follow(difference, depth, now);
        let size = u32::try_from(filtered.unsigned_abs()).unwrap_or(u32::MAX >> 1);
        let written = size.min(u32::MAX >> 1) | u32::from(filtered >= 0) << 31;
        self.memory
            .set(register::DC_DIFFERENCE, &written.to_le_bytes());
    }

    /// The activation of SYNC0 and SYNC1 was written: a rising edge of the cyclic operation bit arms them.
    fn activate(&mut self, now: u64) {
        let offset = self.offset();
        let [activation] = self.memory.get(register::DC_ACTIVATION);
        let before = std::mem::replace(&mut self.activation, activation);
        let Some(clock) = &mut self.clock else {
            return;
        };
        if activation & 0x03 != 0x03 {
            clock.disarm();
        } else if before & 0x01 == 0 || clock.next_sync0().is_none() {
            let start = u64::from_le_bytes(self.memory.get(register::DC_START_TIME));
            let period = u32::from_le_bytes(self.memory.get(register::DC_SYNC0_CYCLE));
            let sync1 = u32::from_le_bytes(self.memory.get(register::DC_SYNC1_CYCLE));
            let sync1 = (activation & 0x04 != 0).then_some(sync1.into());
            let system = clock.local(now).wrapping_add(offset);
            let start = match self.config.chip.clock {
                ClockUnit::Bits32 => next_like(start, system),
                ClockUnit::Absent | ClockUnit::ReceiveTimes | ClockUnit::Bits64 => start,
            };
            clock.arm(start, period.into(), sync1, system);
        }
    }

    pub(super) fn poll_process_data(&mut self, now: u64) {
        if self.faults.hung {
            return;
        }
        if !self.watch(now) {
            return;
        }
        let clock = self.clock.as_ref();
        if clock.is_none_or(|clock| clock.next_sync0().is_none()) {
            let lost = self.config.needs_sync0 && self.state == AlState::Op;
            if lost {
                self.fall(AlState::SafeOp, AlStatusCode(0x002C));
            } else if self.fresh {
                self.run(self.outputs_at.unwrap_or(now).max(self.ran), false);
            } else {
                self.idle(now);
            }
            return;
        }
        self.poll_sync0(now);
    }

    /// Firmware runs without process data too.
    pub(super) fn idle(&mut self, now: u64) {
        if !self.faults.hung && now >= self.ran + IDLE {
            self.run(now, false);
        }
    }

    /// The pulses of SYNC0 up to now, each a cycle of the application.
    fn poll_sync0(&mut self, now: u64) {
        let offset = self.offset();
        for _ in 0..PULSES_MAX {
            let Some(clock) = &mut self.clock else {
                return;
            };
            let system = clock.local(now).wrapping_add(offset);
            if clock.take_sync1(system) {
                self.memory.raise(al_event::SYNC1);
            }
            let Some(pulse) = clock.take_sync0(system) else {
                return;
            };
            self.memory.raise(al_event::SYNC0);
            let ago = system.wrapping_sub(pulse);
            if self.state == AlState::Op {
                self.missed = if self.fresh { 0 } else { self.missed + 1 };
                let limit = self.application.sync_errors();
                if self.missed > limit.unwrap_or(self.config.sync_errors) {
                    self.fall(AlState::SafeOp, AlStatusCode(0x001A));
                    return;
                }
            }
            self.run(now.saturating_sub(ago).max(self.ran), true);
        }
        if let Some(clock) = &mut self.clock {
            let system = clock.local(now).wrapping_add(offset);
            clock.skip(system);
        }
    }

    /// The watchdog of the process data; returns whether the slave goes on in its state.
    fn watch(&mut self, now: u64) -> bool {
        let triggers = |channel: usize| {
            let output = self.memory.sync_manager(channel);
            output.is_enabled() && output.control & 0x40 != 0
        };
        let divider = u64::from(self.memory.word(register::WATCHDOG_DIVIDER)) + 2;
        let time = u64::from(self.memory.word(register::WATCHDOG_PROCESS_DATA));
        let limit = divider * 40 * time;
        let watched = limit > 0 && self.channels.outputs().any(triggers);
        let late = self
            .outputs_at
            .is_some_and(|outputs_at| now > outputs_at + limit);
        let expired = watched && late;
        let [was_well] = self.memory.get(register::WATCHDOG_STATUS);
        self.memory
            .set(register::WATCHDOG_STATUS, &[u8::from(!expired)]);
        self.expired = expired;
        if !expired {
            return true;
        }
        if was_well & 1 != 0 {
            self.memory.count(0x0442);
            self.memory.raise(al_event::WATCHDOG);
        }
        // Without firmware the state is kept: the controller itself sets its outputs to zero.
        if self.state == AlState::Op && !self.mirrors() {
            self.fall(AlState::SafeOp, AlStatusCode(0x001B));
            return false;
        }
        true
    }

    /// One cycle of the application.
    fn run(&mut self, now: u64, synchronous: bool) {
        self.outputs.clear();
        let mut whole = true;
        for channel in self.channels.outputs() {
            let outputs = self.memory.outputs(channel);
            // A disabled SyncManager has no outputs to wait for.
            whole &= outputs.is_some() || !self.memory.sync_manager(channel).is_enabled();
            self.outputs.extend_from_slice(outputs.unwrap_or_default());
            self.memory.outputs_read(channel);
        }
        let some = whole && !self.outputs.is_empty();
        let some = some && self.state == AlState::Op && !self.expired;
        self.memory.acknowledge(al_event::SYNC0 | al_event::SYNC1);
        let memory = &self.memory;
        let len = |channel: usize| {
            let input = memory.sync_manager(channel);
            if input.is_enabled() {
                usize::from(input.len)
            } else {
                0
            }
        };
        self.inputs.clear();
        self.inputs.resize(self.channels.inputs().map(len).sum(), 0);
        let cycle = Cycle {
            outputs: some.then_some(&self.outputs),
            fresh: std::mem::take(&mut self.fresh),
            dt: now.saturating_sub(std::mem::replace(&mut self.ran, now)),
            state: self.state,
            synchronous,
        };
        self.application.cycle(&cycle, &mut self.inputs);
        let mut rest = &self.inputs[..];
        for channel in self.channels.inputs() {
            let len = usize::from(self.memory.sync_manager(channel).len);
            let (part, after) = rest.split_at(len.min(rest.len()));
            self.memory.set_inputs(channel, part);
            rest = after;
        }
    }
}

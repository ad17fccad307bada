//! An encoder terminal: a counter of 32 bits, a latch that the first C pulse fills after it is armed, and a counter that can be
//! set. Arming acts by level, setting by the rising edge.

use crate::AlState;
use crate::emulator::application::{Application, Cycle};
use crate::emulator::image::PdoImage;
use crate::emulator::slave::Slave;

use super::Station;

/// Bits of the outputs (7000h), by sub-index - 1.
const ENABLE_C: u16 = 1 << 0;
const SET: u16 = 1 << 2;
/// Bits of the inputs (6000h), by sub-index - 1.
const LATCHED_C: u16 = 1 << 0;
const SET_DONE: u16 = 1 << 2;
const OPEN_CIRCUIT: u16 = 1 << 6;
const LEVEL_A: u16 = 1 << 8;
const TOGGLE: u16 = 1 << 15;

/// The firmware.
#[derive(Debug)]
pub(super) struct EncoderTerminal {
    station: Station,
    axis: usize,
    /// The motor's count at the last cycle.
    seen: Option<i64>,
    /// Counter minus count of the motor.
    base: i64,
    /// The standing counter of an open circuit.
    counter: u32,
    latch: Option<u32>,
    set: bool,
    toggle: bool,
}

impl EncoderTerminal {
    pub(super) fn slave(station: Station, axis: usize) -> Slave {
        let bits = |object: u16, subs: &[u8]| {
            let bit = |sub: u8| {
                let index = if subs.contains(&sub) { object } else { 0 };
                (
                    index,
                    if index == 0 { 0 } else { sub },
                    1,
                    u8::from(index != 0),
                )
            };
            (1..=16).map(bit).collect::<Vec<_>>()
        };
        let pdo = |index, sync_manager, name: &str, entries| PdoImage {
            index,
            sync_manager,
            name: name.to_owned(),
            entries,
        };
        let mut rx = bits(0x7000, &[1, 2, 3, 4]);
        rx.push((0x7000, 0x11, 32, 7));
        let mut tx = bits(0x6000, &[1, 2, 3, 4, 5, 7, 9, 10, 11, 13, 16]);
        tx.extend([(0x6000, 0x11, 32, 7), (0x6000, 0x12, 32, 7)]);
        let terminal = Self {
            station,
            axis,
            seen: None,
            base: 0,
            counter: 0,
            latch: None,
            set: false,
            toggle: false,
        };
        let rx = vec![pdo(0x1600, 0, "ENC outputs", rx)];
        let tx = vec![pdo(0x1A00, 1, "ENC inputs", tx)];
        super::slave("TK5151 encoder", 0x5151, [rx, tx], Box::new(terminal))
    }
}

/// The low 32 bits, as the counter wraps.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the counter wraps"
)]
const fn wrapped(count: i64) -> u32 {
    count as u32
}

impl Application for EncoderTerminal {
    fn cycle(&mut self, cycle: &Cycle<'_>, inputs: &mut [u8]) {
        let station = self.station.clone();
        let mut motors = station.lock();
        let Some(motor) = motors.get_mut(self.axis) else {
            return;
        };
        #[expect(clippy::cast_precision_loss, reason = "spans of a cycle")]
        motor.run(cycle.dt as f64 * 1e-9);
        let outputs = cycle.outputs.filter(|_| cycle.state == AlState::Op);
        let outputs = outputs.unwrap_or_default();
        let word = outputs
            .first_chunk()
            .map_or(0, |it| u16::from_le_bytes(*it));
        let value = outputs.get(2..).and_then(|rest| rest.first_chunk());
        let value = value.map_or(0, |it| u32::from_le_bytes(*it));
        let count = motor.count();
        // The counter is zero at power-on, wherever the motor is.
        let seen = *self.seen.get_or_insert_with(|| {
            self.base = -count;
            count
        });
        let is_open = motor.faults.open_circuit;
        if word & ENABLE_C == 0 {
            self.latch = None;
        } else if self.latch.is_none() && !is_open {
            let pulse = motor.index_between(seen, count);
            self.latch = pulse.map(|at| wrapped(at + self.base));
        }
        self.seen = Some(count);
        let set = word & SET != 0;
        if set && !self.set {
            self.base = i64::from(value) - count;
        }
        self.set = set;
        if !is_open {
            self.counter = wrapped(count + self.base);
        }
        self.toggle = !self.toggle;
        let mut status = if self.latch.is_some() { LATCHED_C } else { 0 };
        for (is_on, bit) in [
            (self.set, SET_DONE),
            (is_open, OPEN_CIRCUIT),
            (!is_open && count & 2 != 0, LEVEL_A),
            (self.toggle, TOGGLE),
        ] {
            status |= if is_on { bit } else { 0 };
        }
        let latch = self.latch.unwrap_or_default();
        let bytes = status.to_le_bytes().into_iter();
        let bytes = bytes
            .chain(self.counter.to_le_bytes())
            .chain(latch.to_le_bytes());
        for (to, from) in inputs.iter_mut().zip(bytes) {
            *to = from;
        }
    }

    fn reset(&mut self) {
        (self.seen, self.latch, self.set) = (None, None, false);
    }
}

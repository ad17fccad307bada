//! Digital and analogue inputs and outputs: bits and numbers in the process data of slaves. When a net ends, outputs
//! keep its values or take those that the cell configures; when the segment stops, the slaves' watchdogs switch them
//! off.

use std::fmt;

use takt_cia402::dictionary::Address;
use takt_ethercat::master::Master;
use takt_rt::cycle::Tick;

use super::describe::{part, slave};
use super::wire::{WireValues, wire_figures};
use crate::config::{AnalogueChannel, EthercatConfig, EthercatIo};
use takt_core::device::DeviceStatus;
use takt_core::device::driver::DeviceEnd;
use takt_core::device::endpoint::Endpoint;
use takt_core::device::on_end::OutputsOnEnd;
use takt_core::device::parts::with_figures;

/// A bit of a slave's process data.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bit {
    pub(super) slave: usize,
    pub(super) bit: usize,
}

impl Bit {
    /// Its input; `None` while its slave is lost or has no such bit.
    pub(super) fn read(self, master: &Master) -> Option<bool> {
        let (bytes, age) = master.inputs(self.slave);
        let byte = bytes.get(self.bit / 8).filter(|_| master.is_online(age))?;
        Some(byte >> (self.bit % 8) & 1 != 0)
    }

    /// Sets its output; returns whether the slave has it.
    pub(super) fn write(self, master: &mut Master, value: bool) -> bool {
        let mask = 1 << (self.bit % 8);
        let byte = master.outputs_mut(self.slave).get_mut(self.bit / 8);
        let has_it = byte.is_some();
        if let Some(byte) = byte {
            *byte = if value { *byte | mask } else { *byte & !mask };
        }
        has_it
    }
}

/// A number in a slave's process data.
#[derive(Clone, Copy, Debug)]
pub(super) struct Number {
    pub(super) slave: usize,
    object: Option<Address>,
    /// First bit and number of bits; `None` until the mapping is known.
    place: Option<(usize, u32)>,
    signed: bool,
    scale: f64,
    offset: f64,
}

impl Number {
    pub(super) fn new(config: &EthercatConfig, channel: &AnalogueChannel) -> Self {
        let object = channel.object.map(|(index, sub)| Address::new(index, sub));
        Self {
            slave: slave(config, &channel.slave).unwrap_or_default(),
            object,
            place: channel.bit.map(|bit| (bit, channel.bits.into())),
            signed: channel.signed,
            scale: channel.scale,
            offset: channel.offset,
        }
    }

    pub(super) fn find(&mut self, master: &Master, outputs: bool) -> Option<Lack> {
        let process = master.slave(self.slave)?.process();
        if let Some(object) = self.object {
            let found = process.locate(object, outputs);
            let wrong = found.filter(|place| !(1..=32).contains(&place.bits));
            let right = found.filter(|_| wrong.is_none());
            self.place = right.map(|place| (place.bit, place.bits.into()));
            if let Some(wrong) = wrong {
                return Some(Lack::Width {
                    slave: self.slave,
                    object,
                    bits: wrong.bits,
                });
            }
        }
        let len = if outputs {
            process.outputs_len()
        } else {
            process.inputs_len()
        };
        let inside = self
            .place
            .is_some_and(|(bit, count)| bit + count as usize <= 8 * len);
        (!inside).then_some(Lack::Number {
            slave: self.slave,
            object: self.object,
            outputs,
        })
    }

    fn read(&self, bytes: &[u8]) -> Option<f64> {
        let (first, count) = self.place?;
        let mut raw = 0_i64;
        for n in 0..count as usize {
            let at = first + n;
            let bit = bytes.get(at / 8)? >> (at % 8) & 1;
            raw |= i64::from(bit) << n;
        }
        if self.signed && raw >> (count - 1) & 1 != 0 {
            raw -= 1 << count;
        }
        #[expect(clippy::cast_precision_loss, reason = "at most 32 bits")]
        let raw = raw as f64;
        Some(raw * self.scale + self.offset)
    }

    /// Writes a value, clamped to the range of the number; returns whether it lies in the data.
    pub(super) fn write(&self, bytes: &mut [u8], value: f64) -> bool {
        let Some((first, count)) = self.place else {
            return false;
        };
        // A number beyond the end of the slave's bytes is not written in part: those bytes belong to other values.
        if first + count as usize > 8 * bytes.len() {
            return false;
        }
        let (least, most) = if self.signed {
            (-(1_i64 << (count - 1)), (1_i64 << (count - 1)) - 1)
        } else {
            (0, (1_i64 << count) - 1)
        };
        #[expect(
            clippy::cast_possible_truncation,
            reason = "it saturates, no number is zero, and then it is cut"
        )]
        let raw = (((value - self.offset) / self.scale).round() as i64).clamp(least, most);
        for n in 0..count as usize {
            let at = first + n;
            let Some(byte) = bytes.get_mut(at / 8) else {
                return false;
            };
            let mask = 1 << (at % 8);
            *byte = if raw >> n & 1 == 0 {
                *byte & !mask
            } else {
                *byte | mask
            };
        }
        true
    }
}

/// An input or output that the cell names and the slave's process data lack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lack {
    /// More bits are named than exist.
    Bits {
        slave: usize,
        outputs: bool,
        has: usize,
        named: usize,
    },
    /// A number lies beyond the data.
    Number {
        slave: usize,
        object: Option<Address>,
        outputs: bool,
    },
    /// An object is no number of a supported size.
    Width {
        slave: usize,
        object: Address,
        bits: u8,
    },
}

impl fmt::Display for Lack {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = |outputs: bool| if outputs { "outputs" } else { "inputs" };
        match *self {
            Self::Bits {
                slave,
                outputs,
                has,
                named,
            } => write!(
                f,
                "slave {slave}: it has {has} bits of {}, {named} are named in the cell",
                kind(outputs)
            ),
            Self::Number {
                slave,
                object: Some(object),
                outputs,
            } => write!(
                f,
                "slave {slave}: an analogue channel is {object}, which is not among its {}; `takt ecat pdos` lists \
                 what is",
                kind(outputs)
            ),
            Self::Width {
                slave,
                object,
                bits,
            } => write!(
                f,
                "slave {slave}: an analogue channel is {object}, which has {bits} bits; channels have 1 to 32"
            ),
            Self::Number {
                slave,
                object: None,
                outputs,
            } => write!(
                f,
                "slave {slave}: an analogue channel lies beyond the end of its {}",
                kind(outputs)
            ),
        }
    }
}

/// The device.
#[derive(Debug)]
pub(super) struct InOut {
    inputs: Vec<Bit>,
    outputs: Vec<Bit>,
    analogue_in: Vec<Number>,
    analogue_out: Vec<Number>,
    on_end: OutputsOnEnd,
    end: Endpoint,
}

impl InOut {
    pub(super) fn new(config: &EthercatConfig, io: &EthercatIo, end: DeviceEnd) -> Self {
        let bits = |of: &[(String, usize)]| -> Vec<Bit> {
            let slaves = of.iter().map(|(name, bits)| (slave(config, name), *bits));
            let known = slaves.filter_map(|(slave, bits)| Some((slave?, bits)));
            known
                .flat_map(|(slave, bits)| (0..bits).map(move |bit| Bit { slave, bit }))
                .collect()
        };
        let numbers = |of: &[AnalogueChannel]| -> Vec<Number> {
            of.iter()
                .map(|channel| Number::new(config, channel))
                .collect()
        };
        Self {
            inputs: bits(&io.digital_in),
            outputs: bits(&io.digital_out),
            analogue_in: numbers(&io.analogue_in),
            analogue_out: numbers(&io.analogue_out),
            on_end: io.on_end.clone(),
            end: Endpoint::new(end, &with_figures(&[part(io)], wire_figures()), 0),
        }
    }

    /// Locates its numbers in the process data, once that is known; returns those that are missing.
    pub(super) fn find(&mut self, master: &Master) -> Vec<Lack> {
        let mut lacks = Vec::new();
        for (outputs, bits) in [(false, &self.inputs), (true, &self.outputs)] {
            for slave in 0..master.len() {
                let last = bits.iter().filter(|bit| bit.slave == slave);
                let named = last.map(|bit| bit.bit + 1).max().unwrap_or(0);
                let process = master.slave(slave).map(|slave| slave.process());
                let len = process.map_or(0, |process| {
                    if outputs {
                        process.outputs_len()
                    } else {
                        process.inputs_len()
                    }
                });
                if named > 8 * len {
                    lacks.push(Lack::Bits {
                        slave,
                        outputs,
                        has: 8 * len,
                        named,
                    });
                }
            }
        }
        let inputs = self.analogue_in.iter_mut();
        lacks.extend(inputs.filter_map(|number| number.find(master, false)));
        let outputs = self.analogue_out.iter_mut();
        lacks.extend(outputs.filter_map(|number| number.find(master, true)));
        lacks
    }

    /// Reports the figures of the wire with the next cycle.
    pub(super) fn report_wire(&mut self, values: &WireValues) {
        self.end.report_figures(0, values.iter().copied());
    }

    /// Reads inputs of the last frame and writes outputs of the next.
    pub(super) fn cycle(&mut self, master: &mut Master, tick: &Tick) {
        self.end.take();
        let mut offline = !master.is_exchanging();
        offline |= self.digital(master);
        offline |= self.analogue(master);
        let status = if offline {
            DeviceStatus::Offline
        } else {
            DeviceStatus::Operational
        };
        self.end.reported.enter(status, tick.scheduled);
        self.end.publish();
    }

    /// The digital part; returns whether a slave is lost.
    fn digital(&mut self, master: &mut Master) -> bool {
        let Some(io) = &self.end.interfaces.io else {
            return true;
        };
        let mut offline = false;
        for (place, bit) in io.bool_in.iter().zip(&self.inputs) {
            let (bytes, age) = master.inputs(bit.slave);
            let value = bytes
                .get(bit.bit / 8)
                .map(|byte| byte >> (bit.bit % 8) & 1 != 0);
            offline |= !master.is_online(age);
            place.report(
                &mut self.end.reported.signals,
                value.filter(|_| master.is_online(age)),
            );
        }
        for (port, (place, bit)) in io.bool_out.iter().zip(&self.outputs).enumerate() {
            let given = place.command.read(&self.end.taken.words);
            let wanted = self.on_end.truth(port, given);
            let bytes = master.outputs_mut(bit.slave);
            let Some(byte) = bytes.get_mut(bit.bit / 8) else {
                offline = true;
                continue;
            };
            let mask = 1 << (bit.bit % 8);
            match wanted {
                Some(true) => *byte |= mask,
                Some(false) => *byte &= !mask,
                None => {}
            }
            let value = *byte & mask != 0;
            place
                .state
                .report(&mut self.end.reported.signals, Some(value));
        }
        offline
    }

    /// The analogue part. Outputs are reported as clamped and rounded.
    fn analogue(&mut self, master: &mut Master) -> bool {
        let Some(io) = &self.end.interfaces.io else {
            return true;
        };
        let mut offline = false;
        for (place, number) in io.real_in.iter().zip(&self.analogue_in) {
            let (bytes, age) = master.inputs(number.slave);
            let value = number.read(bytes).filter(|_| master.is_online(age));
            offline |= value.is_none();
            place.report(&mut self.end.reported.signals, value);
        }
        for (port, (place, number)) in io.real_out.iter().zip(&self.analogue_out).enumerate() {
            let given = place.command.read(&self.end.taken.words);
            let wanted = self.on_end.number(port, given);
            let bytes = master.outputs_mut(number.slave);
            if let Some(wanted) = wanted.filter(|wanted| wanted.is_finite()) {
                offline |= !number.write(bytes, wanted);
            }
            let value = number.read(bytes);
            offline |= value.is_none();
            place.state.report(&mut self.end.reported.signals, value);
        }
        offline
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(bit: usize, bits: u32, signed: bool) -> Number {
        Number {
            slave: 0,
            object: None,
            place: Some((bit, bits)),
            signed,
            scale: 0.5,
            offset: 10.0,
        }
    }

    #[test]
    fn analogue_channel_reads_back_clamped_to_range() {
        let mut bytes = [0xFF; 6];
        for (of, value, read) in [
            (number(3, 16, true), -20.0, -20.0),
            (number(0, 16, true), 1e9, 16_393.5),
            (number(0, 16, true), -1e9, -16_374.0),
            (number(5, 12, false), -1.0, 10.0),
            (number(5, 12, false), 1e300, 2057.5),
            (number(16, 32, true), f64::MAX, 1_073_741_833.5),
            (number(16, 32, false), 1e12, 2_147_483_657.5),
            (number(7, 1, false), 10.5, 10.5),
        ] {
            assert!(of.write(&mut bytes, value));
            assert_eq!(of.read(&bytes), Some(read), "{of:?}");
        }
        let (before, beyond) = (bytes, number(40, 16, true));
        assert_eq!(beyond.read(&bytes), None);
        assert!(!beyond.write(&mut bytes, 10.0));
        assert_eq!(bytes, before, "nothing of it");
        let mut bytes = [0; 3];
        number(4, 16, true).write(&mut bytes, 9.5);
        assert_eq!(bytes, [0xF0, 0xFF, 0x0F], "nothing beside it");
    }
}

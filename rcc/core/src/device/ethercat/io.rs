//! Digital inputs and outputs: bits of the process data of slaves. Outputs keep what nets wrote when those
//! end; when the segment stops, the slaves' watchdogs switch them off.

use takt_ethercat::master::Master;
use takt_net::device::{Interfaces, Layout};
use takt_rt::cycle::Tick;
use takt_rt::latest::{LatestReader, LatestWriter};

use super::describe::slave;
use crate::cell::{EthercatConfig, EthercatIo};
use crate::device::driver::DeviceEnd;
use crate::device::{DeviceCommand, DeviceState, DeviceStatus, Part, parts};

/// Cycles without inputs after which a slave counts as gone.
const GONE: u32 = 4;

/// A bit of a slave's process data.
#[derive(Clone, Copy, Debug)]
struct Bit {
    slave: usize,
    bit: usize,
}

/// The device.
#[derive(Debug)]
pub(super) struct InOut {
    inputs: Vec<Bit>,
    outputs: Vec<Bit>,
    interfaces: Interfaces,
    told: DeviceState,
    taken: DeviceCommand,
    state: LatestWriter<DeviceState>,
    command: LatestReader<DeviceCommand>,
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
        let (inputs, outputs) = (bits(&io.digital_in), bits(&io.digital_out));
        let part = Part::Io {
            bool_in: inputs.len(),
            bool_out: outputs.len(),
            real_in: 0,
            real_out: 0,
        };
        let mut layout = Layout::default();
        let interfaces = parts::lay(&[part], 0, &mut layout);
        Self {
            inputs,
            outputs,
            interfaces,
            told: DeviceState::new(layout.signals),
            taken: DeviceCommand::new(layout.commands),
            state: end.state,
            command: end.command,
        }
    }

    /// Takes inputs of the last frame and gives outputs of the next.
    pub(super) fn cycle(&mut self, master: &mut Master, tick: &Tick) {
        let taken = &mut self.taken;
        self.command.read_with(|command| taken.copy_from(command));
        let Some(io) = &self.interfaces.io else {
            return;
        };
        let mut gone = !master.is_exchanging();
        for (place, bit) in io.bool_in.iter().zip(&self.inputs) {
            let (bytes, age) = master.inputs(bit.slave);
            let value = bytes
                .get(bit.bit / 8)
                .map(|byte| byte >> (bit.bit % 8) & 1 != 0);
            gone |= age > GONE;
            place.tell(&mut self.told.signals, value.filter(|_| age <= GONE));
        }
        for (place, bit) in io.bool_out.iter().zip(&self.outputs) {
            let wanted = place
                .command
                .read(&self.taken.words)
                .map(|given| given.value);
            let bytes = master.outputs_mut(bit.slave);
            let Some(byte) = bytes.get_mut(bit.bit / 8) else {
                gone = true;
                continue;
            };
            let mask = 1 << (bit.bit % 8);
            match wanted {
                Some(true) => *byte |= mask,
                Some(false) => *byte &= !mask,
                None => {}
            }
            let value = *byte & mask != 0;
            place.state.tell(&mut self.told.signals, Some(value));
        }
        let status = if gone {
            DeviceStatus::Offline
        } else {
            DeviceStatus::Operational
        };
        self.told.enter(status, tick.scheduled);
        let told = &self.told;
        self.state.write_with(|state| state.copy_from(told));
    }
}

//! Logical addressing: which bits of a datagram are which bits of the slave's memory (ETG.1000.4, FMMU). SyncManagers
//! and buffers are in the memory.

use crate::register;
use crate::{AlState, Fmmu, register::Register};

use super::Slave;
use super::faults::happens;

/// The part of a datagram that an FMMU maps: its offset in the datagram, its offset in the FMMU, and its length in
/// bytes.
fn overlap(fmmu: &Fmmu, logical: u32, len: usize) -> Option<(usize, usize, usize)> {
    let (window, mapped) = (u64::from(logical), u64::from(fmmu.logical));
    let first = window.max(mapped);
    let end = (window + len as u64).min(mapped + u64::from(fmmu.len));
    let len = usize::try_from(end.checked_sub(first)?).ok()?;
    let in_data = usize::try_from(first - window).ok()?;
    let in_fmmu = usize::try_from(first - mapped).ok()?;
    (len > 0).then_some((in_data, in_fmmu, len))
}

impl Slave {
    fn fmmu(&self, number: usize) -> Fmmu {
        let offset = u16::try_from(16 * number).unwrap_or(0);
        let at: Register = register::FMMU + offset;
        Fmmu::decode(&self.memory.get(at))
    }

    /// Executes a logical datagram; returns the increment of its working counter: once per direction.
    pub(super) fn logical(&mut self, at: u32, data: &mut [u8], reads: bool, writes: bool) -> u16 {
        let (mut read, mut written) = (false, false);
        let writes =
            writes && !(self.state == AlState::Op && happens(&mut self.faults.late_outputs));
        // Outputs are taken from the received data, before any inputs are merged.
        for (direction, wanted) in [(false, writes), (true, reads)] {
            for number in 0..usize::from(self.config.chip.fmmus.min(8)) {
                let fmmu = self.fmmu(number);
                let matches = if direction { fmmu.reads } else { fmmu.writes };
                if !wanted || !fmmu.active || !matches {
                    continue;
                }
                let Some((in_data, in_fmmu, len)) = overlap(&fmmu, at, data.len()) else {
                    continue;
                };
                let Some(part) = data.get_mut(in_data..in_data + len) else {
                    continue;
                };
                if direction {
                    read |= self.merge_inputs(&fmmu, in_fmmu, part);
                } else {
                    written |= self.take_outputs(&fmmu, in_fmmu, part);
                }
            }
        }
        match (read, written, reads) {
            (true, true, _) => 3,
            (true, false, _) => 1,
            (false, true, true) => 2,
            (false, true, false) => 1,
            (false, false, _) => 0,
        }
    }

    const fn is_whole(fmmu: &Fmmu) -> bool {
        fmmu.start_bit == 0 && fmmu.stop_bit == 7 && fmmu.physical_bit == 0
    }

    /// The mapped bits of the part: bit in the part, bit in the slave's memory relative to the physical start.
    fn bits(fmmu: &Fmmu, in_fmmu: usize, len: usize) -> impl Iterator<Item = (usize, usize)> {
        let first = usize::from(fmmu.start_bit);
        let end = first + fmmu.bits();
        let from = 8 * in_fmmu;
        let physical = usize::from(fmmu.physical_bit);
        (from.max(first)..(from + 8 * len).min(end))
            .map(move |bit| (bit - from, bit - first + physical))
    }

    fn take_outputs(&mut self, fmmu: &Fmmu, in_fmmu: usize, part: &[u8]) -> bool {
        let start = |offset: usize| {
            u16::try_from(offset)
                .ok()
                .and_then(|offset| fmmu.physical.checked_add(offset))
        };
        if Self::is_whole(fmmu) {
            return start(in_fmmu).is_some_and(|at| self.memory.write(at, part));
        }
        let mut done = false;
        let mut byte: Option<(usize, u8)> = None;
        let bits: Vec<_> = Self::bits(fmmu, in_fmmu, part.len()).collect();
        for (i, (from, to)) in bits.iter().enumerate() {
            let (at, value) = byte.get_or_insert_with(|| {
                let at = start(to / 8).unwrap_or(0);
                (to / 8, self.memory.pending(at))
            });
            let bit = part[from / 8] >> (from % 8) & 1;
            *value = *value & !(1 << (to % 8)) | bit << (to % 8);
            let next = bits.get(i + 1).map(|(_, to)| to / 8);
            if next != Some(*at) {
                let (at, value) = (start(*at), *value);
                done |= at.is_some_and(|at| self.memory.write(at, &[value]));
                byte = None;
            }
        }
        done
    }

    fn merge_inputs(&mut self, fmmu: &Fmmu, in_fmmu: usize, part: &mut [u8]) -> bool {
        let whole = Self::is_whole(fmmu);
        let offset = if whole { in_fmmu } else { 0 };
        let len = if whole {
            part.len()
        } else {
            (usize::from(fmmu.physical_bit) + fmmu.bits()).div_ceil(8)
        };
        let at = u16::try_from(offset)
            .ok()
            .and_then(|o| fmmu.physical.checked_add(o));
        let mut found = vec![0; len];
        if !at.is_some_and(|at| self.memory.read(at, &mut found)) {
            return false;
        }
        if whole {
            part.copy_from_slice(&found);
            return true;
        }
        for (to, from) in Self::bits(fmmu, in_fmmu, part.len()) {
            let bit = found.get(from / 8).map_or(0, |byte| byte >> (from % 8) & 1);
            part[to / 8] = part[to / 8] & !(1 << (to % 8)) | bit << (to % 8);
        }
        true
    }
}

//! Process data that a drive uses differently than acknowledged: in another order, shifted, late, or not at all. It
//! does not know which message carries them.

use std::collections::VecDeque;

use crate::dictionary::{AbortCode, Address, Dictionary};

/// Distortion of the bytes of a PDO between wire and objects.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Distortion {
    /// The drive's order of the mapped entries, by their numbers in the acknowledged mapping; empty for the same order.
    pub order: Vec<usize>,
    /// Number of bytes by which all are rotated.
    pub shift: usize,
    /// Delay, cycles.
    pub delay: usize,
    /// The bytes are frozen from now on.
    pub frozen: bool,
    queue: VecDeque<Vec<u8>>,
    held: Option<Vec<u8>>,
}

impl Distortion {
    /// A distortion with the entries in this order.
    pub fn order(order: impl Into<Vec<usize>>) -> Self {
        Self {
            order: order.into(),
            ..Self::default()
        }
    }

    /// A distortion that rotates all bytes by `shift`.
    pub fn shifted(shift: usize) -> Self {
        Self {
            shift,
            ..Self::default()
        }
    }

    /// Delay, cycles.
    pub fn delayed(delay: usize) -> Self {
        Self {
            delay,
            ..Self::default()
        }
    }

    /// A distortion that freezes the bytes of the first cycle.
    pub fn frozen() -> Self {
        Self {
            frozen: true,
            ..Self::default()
        }
    }

    /// Whether there is no distortion.
    pub fn is_none(&self) -> bool {
        self.order.is_empty() && self.shift == 0 && self.delay == 0 && !self.frozen
    }

    /// From the wire to the acknowledged mapping, whose entries have these lengths (bytes).
    pub fn receive(&mut self, lens: &[usize], bytes: &mut [u8]) {
        let len = bytes.len();
        if len > 0 {
            bytes.rotate_right(self.shift % len);
        }
        self.permute(lens, bytes, true);
        self.hold(bytes);
    }

    /// From the acknowledged mapping to the wire.
    pub fn transmit(&mut self, lens: &[usize], bytes: &mut [u8]) {
        let len = bytes.len();
        self.permute(lens, bytes, false);
        if len > 0 {
            bytes.rotate_right(self.shift % len);
        }
        self.hold(bytes);
    }

    fn permute(&self, lens: &[usize], bytes: &mut [u8], receives: bool) {
        let from = bytes.to_vec();
        let mut own = 0;
        for entry in &self.order {
            let len = lens.get(*entry).copied().unwrap_or(0);
            let acknowledged = lens.iter().take(*entry).sum();
            let (to, at) = if receives {
                (acknowledged, own)
            } else {
                (own, acknowledged)
            };
            for n in 0..len {
                if let (Some(to), Some(from)) = (bytes.get_mut(to + n), from.get(at + n)) {
                    *to = *from;
                }
            }
            own += len;
        }
    }

    fn hold(&mut self, bytes: &mut [u8]) {
        if self.delay > 0 {
            self.queue.push_back(bytes.to_vec());
            while self.queue.len() > self.delay + 1 {
                self.queue.pop_front();
            }
            if let Some(late) = self.queue.front() {
                bytes.copy_from_slice(late);
            }
        }
        if !self.frozen {
            self.held = None;
            return;
        }
        let held = self.held.get_or_insert_with(|| bytes.to_vec());
        if held.len() == bytes.len() {
            bytes.copy_from_slice(held);
        }
    }
}

/// How a drive distorts its process data.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ProcessDataFaults {
    /// Distortion of received data.
    pub outputs: Distortion,
    /// Distortion of transmitted data.
    pub inputs: Distortion,
    /// Objects (of the first axis) that SDO cannot read.
    pub unreadable: Vec<u16>,
    /// Objects (of the first axis) that it sets to zero while it is not enabled.
    pub cleared: Vec<u16>,
}

impl ProcessDataFaults {
    /// Handles a read from the bus: objects that are not mirrored are refused or read as zero.
    pub(super) fn before_upload(
        &self,
        axis: u8,
        enabled: bool,
        dictionary: &mut Dictionary,
        address: Address,
    ) -> Result<(), AbortCode> {
        let offset = Address::AXIS * u16::from(axis);
        let Some(index) = address.index.checked_sub(offset) else {
            return Ok(());
        };
        if self.unreadable.contains(&index) {
            return Err(AbortCode::WriteOnly);
        }
        if self.cleared.contains(&index) && !enabled {
            let len = dictionary.bytes(address).map_or(0, <[u8]>::len).min(8);
            dictionary.store(address, &[0; 8][..len])?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distortion_of_order_is_undone_by_its_inverse() {
        let lens = [2, 1, 4];
        let bytes = [1, 2, 3, 4, 5, 6, 7];
        let mut wire = bytes;
        Distortion::order([2, 0, 1]).transmit(&lens, &mut wire);
        assert_eq!(wire, [4, 5, 6, 7, 1, 2, 3]);
        Distortion::order([2, 0, 1]).receive(&lens, &mut wire);
        assert_eq!(wire, bytes);
    }

    #[test]
    fn distortion_by_delay_and_freezing_repeats_stale_bytes() {
        let mut late = Distortion {
            delay: 2,
            ..Distortion::default()
        };
        let seen = [1, 2, 3, 4].map(|byte| {
            let mut bytes = [byte];
            late.receive(&[1], &mut bytes);
            bytes[0]
        });
        assert_eq!(seen, [1, 1, 1, 2]);
        late.frozen = true;
        let mut bytes = [5];
        late.receive(&[1], &mut bytes);
        let mut bytes = [6];
        late.receive(&[1], &mut bytes);
        assert_eq!(bytes, [3]);
    }
}

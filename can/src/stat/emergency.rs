//! Emergencies of one node: codes, counts, and whether they were cleared.

use std::time::Duration;

use crate::canopen::Emergency;

/// Maximum codes of a node with separate statistics; further ones are counted together.
pub const CODES_MAX: usize = 16;

/// One code of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EmergencyStat {
    /// Error code.
    pub code: u16,
    /// Error register of the last one.
    pub register: u8,
    /// Number of occurrences.
    pub times: u32,
    /// Times of the first and last occurrence.
    pub seen: (Duration, Duration),
    /// Active: not cleared by "no error" (0000h), and the node has not restarted since.
    pub is_present: bool,
}

/// Occurrences, and occurrences per second, from which an emergency is a storm. A drive reports each fault once.
const STORM_TIMES: u32 = 20;
const STORM_RATE: f64 = 5.0;

impl EmergencyStat {
    /// Occurrences per second, if they are a storm.
    pub fn storm(&self) -> Option<f64> {
        let (first, last) = self.seen;
        let span = last.saturating_sub(first).as_secs_f64().max(1e-3);
        let rate = f64::from(self.times.saturating_sub(1)) / span;
        (self.times >= STORM_TIMES && rate >= STORM_RATE).then_some(rate)
    }
}

/// Emergency statistics of a node.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Emergencies {
    codes: Vec<EmergencyStat>,
    /// Emergencies of codes beyond [`CODES_MAX`].
    pub others: u64,
    /// Total number of emergencies.
    pub frames: u64,
}

impl Emergencies {
    /// Statistics by code, in order of first occurrence.
    pub fn codes(&self) -> &[EmergencyStat] {
        &self.codes
    }

    pub(super) fn handle(&mut self, emergency: &Emergency, at: Duration) {
        let Emergency { code, register, .. } = *emergency;
        self.frames += 1;
        if code == 0 {
            return self.clear(register);
        }
        let may_add = self.codes.len() < CODES_MAX;
        let known = self.codes.iter_mut().find(|known| known.code == code);
        match known {
            Some(known) => {
                (known.register, known.is_present) = (register, true);
                known.seen.1 = at;
                known.times = known.times.saturating_add(1);
            }
            None if may_add => self.codes.push(EmergencyStat {
                code,
                register,
                times: 1,
                seen: (at, at),
                is_present: true,
            }),
            None => self.others += 1,
        }
    }

    /// Handles "no error": an empty register clears all; otherwise it clears the last one.
    fn clear(&mut self, register: u8) {
        if register == 0 {
            return self.clear_all();
        }
        let present = self.codes.iter_mut().filter(|code| code.is_present);
        if let Some(last) = present.max_by_key(|code| code.seen.1) {
            last.is_present = false;
        }
    }

    /// Clears all: the node has restarted.
    pub(super) fn clear_all(&mut self) {
        self.codes
            .iter_mut()
            .for_each(|code| code.is_present = false);
    }
}

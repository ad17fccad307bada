//! Emergencies of one node as they were seen: each code, how often, and whether it was withdrawn. It judges nothing.

use std::time::Duration;

use crate::canopen::Emergency;

/// Codes of a node that are kept apart, at most; further ones are counted together.
pub const CODES_MAX: usize = 16;

/// One code of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EmergencyStat {
    /// Error code.
    pub code: u16,
    /// Error register of the last one.
    pub register: u8,
    /// How often it came.
    pub times: u32,
    /// When it came first and last.
    pub seen: (Duration, Duration),
    /// It is present: not withdrawn by "no error" (0000h), and the node did not start again since.
    pub is_present: bool,
}

/// All emergencies of a node.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Emergencies {
    codes: Vec<EmergencyStat>,
    /// Emergencies of codes beyond [`CODES_MAX`].
    pub others: u64,
    /// All of its emergencies.
    pub frames: u64,
}

impl Emergencies {
    /// Each code, in the order in which they came first.
    #[must_use]
    pub fn codes(&self) -> &[EmergencyStat] {
        &self.codes
    }

    pub(super) fn handle(&mut self, emergency: &Emergency, at: Duration) {
        let Emergency { code, register, .. } = *emergency;
        self.frames += 1;
        if code == 0 {
            return self.withdraw(register);
        }
        let room = self.codes.len() < CODES_MAX;
        let known = self.codes.iter_mut().find(|known| known.code == code);
        match known {
            Some(known) => {
                (known.register, known.is_present) = (register, true);
                known.seen.1 = at;
                known.times = known.times.saturating_add(1);
            }
            None if room => self.codes.push(EmergencyStat {
                code,
                register,
                times: 1,
                seen: (at, at),
                is_present: true,
            }),
            None => self.others += 1,
        }
    }

    /// "No error": with an empty register none is left; else one is gone, and the last one is taken for it.
    fn withdraw(&mut self, register: u8) {
        if register == 0 {
            return self.forget();
        }
        let present = self.codes.iter_mut().filter(|code| code.is_present);
        if let Some(last) = present.max_by_key(|code| code.seen.1) {
            last.is_present = false;
        }
    }

    /// None is present: the node started again.
    pub(super) fn forget(&mut self) {
        self.codes
            .iter_mut()
            .for_each(|code| code.is_present = false);
    }
}

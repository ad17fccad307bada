//! What other threads see of a served cabinet, and the knobs they may turn. It holds no history.

use super::cabinet::Cabinet;
use super::leave::Leave;
use crate::sunrise::AXES;
use crate::sunrise::wire::{Quality, SessionState};
use std::array;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU32, AtomicU64, Ordering};

/// Live state of a cabinet in [`super::serve`], shared by an `Arc`. Each value is whole; two of them may belong to different
/// cycles.
#[derive(Debug, Default)]
pub struct CabinetStatus {
    state: AtomicI32,
    quality: AtomicI32,
    sent: AtomicU64,
    answers: AtomicU64,
    missed: AtomicU32,
    malformed: AtomicU64,
    stalls: AtomicU64,
    commanded: [AtomicU64; AXES],
    measured: [AtomicU64; AXES],
    force: [AtomicU64; 3],
    power: AtomicBool,
    falls: AtomicU64,
    reason: [AtomicU64; 3],
    power_off_wanted: AtomicBool,
    drop_ppm_wanted: AtomicU32,
    contact_gone_wanted: AtomicBool,
}

/// No drop probability was asked for: the configured one stays.
const UNTOUCHED: u32 = 0;

impl CabinetStatus {
    /// A status before the first cycle.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// State of the session; IDLE before the first cycle.
    #[must_use]
    pub fn state(&self) -> SessionState {
        self.state.load(Ordering::Relaxed).into()
    }

    /// Quality as reported.
    #[must_use]
    pub fn quality(&self) -> Quality {
        self.quality.load(Ordering::Relaxed).into()
    }

    /// Whether the drives have power.
    #[must_use]
    pub fn has_power(&self) -> bool {
        self.power.load(Ordering::Relaxed)
    }

    /// Messages sent.
    #[must_use]
    pub fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    /// New answers received.
    #[must_use]
    pub fn answers(&self) -> u64 {
        self.answers.load(Ordering::Relaxed)
    }

    /// Command periods without an answer in time.
    #[must_use]
    pub fn missed(&self) -> u32 {
        self.missed.load(Ordering::Relaxed)
    }

    /// Datagrams refused by the decoder.
    #[must_use]
    pub fn malformed(&self) -> u64 {
        self.malformed.load(Ordering::Relaxed)
    }

    /// Messages not sent because this host was late.
    #[must_use]
    pub fn stalls(&self) -> u64 {
        self.stalls.load(Ordering::Relaxed)
    }

    /// Joint set-point, rad.
    #[must_use]
    pub fn commanded(&self) -> [f64; AXES] {
        load(&self.commanded)
    }

    /// Measured joint positions, rad.
    #[must_use]
    pub fn measured(&self) -> [f64; AXES] {
        load(&self.measured)
    }

    /// Force of the contact on the flange in the base frame, N.
    #[must_use]
    pub fn force(&self) -> [f64; 3] {
        load(&self.force)
    }

    /// Overlays that ended, and times quality was awaited in vain.
    #[must_use]
    pub fn falls(&self) -> u64 {
        self.falls.load(Ordering::Acquire)
    }

    /// Why the last overlay ended. Should another one end while this is read, the numbers may be mixed.
    #[must_use]
    pub fn last_fall(&self) -> Option<Leave> {
        self.falls().checked_sub(1)?;
        Leave::from_words(array::from_fn(|i| self.reason[i].load(Ordering::Relaxed)))
    }

    /// Switches the drives' power from the next cycle on.
    pub fn set_power(&self, is_on: bool) {
        self.power_off_wanted.store(!is_on, Ordering::Relaxed);
    }

    /// Sets the probability, 0..=1, that a datagram is lost, in each direction, from the next cycle on.
    pub fn set_drop(&self, probability: f64) {
        #[expect(clippy::cast_possible_truncation, reason = "at most a million")]
        #[expect(clippy::cast_sign_loss, reason = "clamped at zero")]
        let ppm = (probability.clamp(0.0, 1.0) * 1e6) as u32;
        self.drop_ppm_wanted.store(ppm + 1, Ordering::Relaxed);
    }

    /// Takes away what the flange touches, from the next cycle on.
    pub fn remove_contact(&self) {
        self.contact_gone_wanted.store(true, Ordering::Relaxed);
    }

    /// Turns the knobs of `cabinet` as asked for.
    pub(super) fn apply(&self, cabinet: &mut Cabinet) {
        cabinet.set_power(!self.power_off_wanted.load(Ordering::Relaxed));
        let ppm = self.drop_ppm_wanted.load(Ordering::Relaxed);
        if ppm != UNTOUCHED {
            let probability = f64::from(ppm - 1) / 1e6;
            cabinet.faults_mut().to_client.drop = probability;
            cabinet.faults_mut().to_cabinet.drop = probability;
        }
        if self.contact_gone_wanted.load(Ordering::Relaxed) {
            *cabinet.contact_mut() = None;
        }
    }

    /// Shows what `cabinet` is doing.
    pub(super) fn publish(&self, cabinet: &Cabinet) {
        let counters = cabinet.counters();
        self.state.store(cabinet.state().code(), Ordering::Relaxed);
        let quality = cabinet.quality().code();
        self.quality.store(quality, Ordering::Relaxed);
        self.power.store(cabinet.has_power(), Ordering::Relaxed);
        self.sent.store(counters.sent, Ordering::Relaxed);
        self.answers.store(counters.answers, Ordering::Relaxed);
        self.missed.store(counters.missed, Ordering::Relaxed);
        self.malformed.store(counters.malformed, Ordering::Relaxed);
        self.stalls.store(counters.stalls, Ordering::Relaxed);
        store(&self.commanded, &cabinet.set_point());
        store(&self.measured, &cabinet.joints());
        store(&self.force, &cabinet.force());
        if cabinet.falls() != self.falls.load(Ordering::Relaxed) {
            if let Some(left) = cabinet.log().next_back() {
                for (to, word) in self.reason.iter().zip(left.reason.to_words()) {
                    to.store(word, Ordering::Relaxed);
                }
            }
            self.falls.store(cabinet.falls(), Ordering::Release);
        }
    }
}

fn load<const N: usize>(from: &[AtomicU64; N]) -> [f64; N] {
    array::from_fn(|i| f64::from_bits(from[i].load(Ordering::Relaxed)))
}

fn store<const N: usize>(to: &[AtomicU64; N], values: &[f64; N]) {
    for (to, value) in to.iter().zip(values) {
        to.store(value.to_bits(), Ordering::Relaxed);
    }
}

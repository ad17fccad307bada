//! What other threads see of a served controller, and the knobs they may turn. It holds no history.

use super::krc::Krc;
use super::leave::Leave;
use crate::lwr::AXES;
use crate::lwr::wire::{Quality, State};
use std::array;
use std::sync::atomic::{AtomicBool, AtomicU16, AtomicU32, AtomicU64, Ordering};

/// Live state of a controller in [`super::serve`], shared by an `Arc`. Each value is whole; two of them may belong to
/// different cycles.
#[derive(Debug, Default)]
pub struct KrcStatus {
    state: AtomicU16,
    quality: AtomicU16,
    sent: AtomicU64,
    answers: AtomicU64,
    missed: AtomicU32,
    old: AtomicU64,
    malformed: AtomicU64,
    stalls: AtomicU64,
    commanded: [AtomicU64; AXES],
    measured: [AtomicU64; AXES],
    power: AtomicBool,
    falls: AtomicU64,
    reason: [AtomicU64; 3],
    power_off_wanted: AtomicBool,
    drop_ppm_wanted: AtomicU32,
}

/// No drop probability was asked for: the configured one stays.
const UNTOUCHED: u32 = 0;

impl KrcStatus {
    /// A status before the first cycle.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Monitor or command mode; OFF before the first cycle.
    #[must_use]
    pub fn state(&self) -> State {
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

    /// Measurements sent.
    #[must_use]
    pub fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    /// New answers received.
    #[must_use]
    pub fn answers(&self) -> u64 {
        self.answers.load(Ordering::Relaxed)
    }

    /// Cycles without an answer in time.
    #[must_use]
    pub fn missed(&self) -> u32 {
        self.missed.load(Ordering::Relaxed)
    }

    /// Answers ignored as copies or as older than the newest.
    #[must_use]
    pub fn old(&self) -> u64 {
        self.old.load(Ordering::Relaxed)
    }

    /// Datagrams refused by the decoder.
    #[must_use]
    pub fn malformed(&self) -> u64 {
        self.malformed.load(Ordering::Relaxed)
    }

    /// Measurements not sent because this host was late.
    #[must_use]
    pub fn stalls(&self) -> u64 {
        self.stalls.load(Ordering::Relaxed)
    }

    /// Joint set-point, rad.
    #[must_use]
    pub fn commanded(&self) -> [f64; AXES] {
        array::from_fn(|joint| f64::from_bits(self.commanded[joint].load(Ordering::Relaxed)))
    }

    /// Measured joint positions, rad.
    #[must_use]
    pub fn measured(&self) -> [f64; AXES] {
        array::from_fn(|joint| f64::from_bits(self.measured[joint].load(Ordering::Relaxed)))
    }

    /// Times command mode was left, friStop included.
    #[must_use]
    pub fn falls(&self) -> u64 {
        self.falls.load(Ordering::Acquire)
    }

    /// Why command mode was left last. Should it be left again while this is read, the numbers may be mixed.
    #[must_use]
    pub fn last_fall(&self) -> Option<Leave> {
        self.falls().checked_sub(1)?;
        Leave::from_words(array::from_fn(|i| self.reason[i].load(Ordering::Relaxed)))
    }

    /// Switches the drives' power from the next cycle on.
    pub fn set_power(&self, power: bool) {
        self.power_off_wanted.store(!power, Ordering::Relaxed);
    }

    /// Sets the probability, 0..=1, that a datagram is lost, in each direction, from the next cycle on.
    pub fn set_drop(&self, probability: f64) {
        #[expect(clippy::cast_possible_truncation, reason = "at most a million")]
        #[expect(clippy::cast_sign_loss, reason = "clamped at zero")]
        let ppm = (probability.clamp(0.0, 1.0) * 1e6) as u32;
        self.drop_ppm_wanted.store(ppm + 1, Ordering::Relaxed);
    }

    /// Turns the knobs of `krc` as asked for.
    pub(super) fn apply(&self, krc: &mut Krc) {
        krc.set_power(!self.power_off_wanted.load(Ordering::Relaxed));
        let ppm = self.drop_ppm_wanted.load(Ordering::Relaxed);
        if ppm != UNTOUCHED {
            let probability = f64::from(ppm - 1) / 1e6;
            krc.faults_mut().to_client.drop = probability;
            krc.faults_mut().to_krc.drop = probability;
        }
    }

    /// Shows what `krc` is doing.
    pub(super) fn publish(&self, krc: &Krc) {
        let counters = krc.counters();
        self.state.store(krc.state().code(), Ordering::Relaxed);
        self.quality.store(krc.quality().code(), Ordering::Relaxed);
        self.power.store(krc.has_power(), Ordering::Relaxed);
        self.sent.store(counters.sent, Ordering::Relaxed);
        self.answers.store(counters.answers, Ordering::Relaxed);
        self.missed.store(counters.missed, Ordering::Relaxed);
        self.old.store(counters.old, Ordering::Relaxed);
        self.malformed.store(counters.malformed, Ordering::Relaxed);
        self.stalls.store(counters.stalls, Ordering::Relaxed);
        store_joints(&self.commanded, &krc.set_point());
        store_joints(&self.measured, &krc.joints());
        if krc.falls() != self.falls.load(Ordering::Relaxed) {
            if let Some(left) = krc.log().next_back() {
                for (to, word) in self.reason.iter().zip(left.reason.to_words()) {
                    to.store(word, Ordering::Relaxed);
                }
            }
            self.falls.store(krc.falls(), Ordering::Release);
        }
    }
}

fn store_joints(to: &[AtomicU64; AXES], joints: &[f64; AXES]) {
    for (to, joint) in to.iter().zip(joints) {
        to.store(joint.to_bits(), Ordering::Relaxed);
    }
}

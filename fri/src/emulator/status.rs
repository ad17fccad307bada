//! What other threads see of a served controller of either generation, and the knobs they may turn. It holds no history.

use super::{AXES, Contact, LineFaults};
use std::array;
use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU32, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// What a controller shows of itself in one cycle.
#[derive(Debug, Clone, Copy)]
pub struct Shown {
    pub(crate) state: i32,
    pub(crate) quality: i32,
    pub(crate) has_power: bool,
    pub(crate) sent: u64,
    pub(crate) answers: u64,
    pub(crate) missed: u32,
    pub(crate) old: u64,
    pub(crate) malformed: u64,
    pub(crate) stalls: u64,
    pub(crate) commanded: [f64; AXES],
    pub(crate) measured: [f64; AXES],
    pub(crate) force: [f64; 3],
    pub(crate) falls: u64,
}

/// What can be served and shown by a [`Status`]: the emulated controllers only.
pub trait Served {
    /// State, as the generation calls it.
    type State: fmt::Display;
    /// Quality, as the generation calls it.
    type Quality: fmt::Display;
    /// Why command mode was left.
    type Leave: Copy + fmt::Display + Send;

    /// The next datagram due, if one is.
    #[doc(hidden)]
    fn transmit(&mut self, now: Duration, buf: &mut [u8]) -> Option<usize>;
    /// Takes a datagram; a malformed one is counted by the controller and means nothing else to it.
    #[doc(hidden)]
    fn take(&mut self, bytes: &[u8], now: Duration);
    /// When the next cycle begins.
    #[doc(hidden)]
    fn due(&self) -> Duration;
    #[doc(hidden)]
    fn state_of(code: i32) -> Self::State;
    #[doc(hidden)]
    fn quality_of(code: i32) -> Self::Quality;
    #[doc(hidden)]
    fn shown(&self) -> Shown;
    /// The last reason.
    #[doc(hidden)]
    fn last_leave(&self) -> Option<Self::Leave>;
    #[doc(hidden)]
    fn switch(&mut self, power: bool);
    #[doc(hidden)]
    fn lines(&mut self) -> [&mut LineFaults; 2];
    #[doc(hidden)]
    fn contact(&mut self) -> &mut Option<Contact>;
}

/// Live state of a controller while it is served, shared by an `Arc`. Each value is whole; two of them may belong to
/// different cycles.
pub struct Status<C: Served> {
    state: AtomicI32,
    quality: AtomicI32,
    sent: AtomicU64,
    answers: AtomicU64,
    missed: AtomicU32,
    old: AtomicU64,
    malformed: AtomicU64,
    stalls: AtomicU64,
    commanded: [AtomicU64; AXES],
    measured: [AtomicU64; AXES],
    force: [AtomicU64; 3],
    power: AtomicBool,
    falls: AtomicU64,
    /// Written by the controller's thread only when nobody reads it: that thread never waits.
    reason: Mutex<Option<C::Leave>>,
    power_off_wanted: AtomicBool,
    drop_ppm_wanted: AtomicU32,
    contact_gone_wanted: AtomicBool,
}

/// No drop probability was asked for: the configured one stays.
const UNTOUCHED: u32 = 0;

impl<C: Served> Default for Status<C> {
    fn default() -> Self {
        Self {
            state: AtomicI32::default(),
            quality: AtomicI32::default(),
            sent: AtomicU64::default(),
            answers: AtomicU64::default(),
            missed: AtomicU32::default(),
            old: AtomicU64::default(),
            malformed: AtomicU64::default(),
            stalls: AtomicU64::default(),
            commanded: Default::default(),
            measured: Default::default(),
            force: Default::default(),
            power: AtomicBool::default(),
            falls: AtomicU64::default(),
            reason: Default::default(),
            power_off_wanted: AtomicBool::default(),
            drop_ppm_wanted: AtomicU32::new(UNTOUCHED),
            contact_gone_wanted: AtomicBool::default(),
        }
    }
}

impl<C: Served> fmt::Debug for Status<C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Status")
            .field("state", &self.state)
            .field("quality", &self.quality)
            .field("falls", &self.falls)
            .finish_non_exhaustive()
    }
}

impl<C: Served> Status<C> {
    /// A status before the first cycle.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// State as reported; OFF or IDLE before the first cycle.
    #[must_use]
    pub fn state(&self) -> C::State {
        C::state_of(self.state.load(Ordering::Relaxed))
    }

    /// Quality as reported.
    #[must_use]
    pub fn quality(&self) -> C::Quality {
        C::quality_of(self.quality.load(Ordering::Relaxed))
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

    /// Command periods without an answer in time.
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

    /// Times command mode was left or an overlay ended, on request too, and times quality was awaited in vain.
    #[must_use]
    pub fn falls(&self) -> u64 {
        self.falls.load(Ordering::Acquire)
    }

    /// Why that happened last.
    #[must_use]
    pub fn last_fall(&self) -> Option<C::Leave> {
        *self.reason.lock().unwrap_or_else(PoisonError::into_inner)
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

    /// Turns the knobs of `controller` as asked for.
    #[cfg(target_os = "linux")]
    pub(crate) fn apply(&self, controller: &mut C) {
        controller.switch(!self.power_off_wanted.load(Ordering::Relaxed));
        let ppm = self.drop_ppm_wanted.load(Ordering::Relaxed);
        if ppm != UNTOUCHED {
            let probability = f64::from(ppm - 1) / 1e6;
            for line in controller.lines() {
                line.drop = probability;
            }
        }
        if self.contact_gone_wanted.load(Ordering::Relaxed) {
            *controller.contact() = None;
        }
    }

    /// Shows what `controller` is doing.
    #[cfg(target_os = "linux")]
    pub(crate) fn publish(&self, controller: &C) {
        let shown = controller.shown();
        self.state.store(shown.state, Ordering::Relaxed);
        self.quality.store(shown.quality, Ordering::Relaxed);
        self.power.store(shown.has_power, Ordering::Relaxed);
        self.sent.store(shown.sent, Ordering::Relaxed);
        self.answers.store(shown.answers, Ordering::Relaxed);
        self.missed.store(shown.missed, Ordering::Relaxed);
        self.old.store(shown.old, Ordering::Relaxed);
        self.malformed.store(shown.malformed, Ordering::Relaxed);
        self.stalls.store(shown.stalls, Ordering::Relaxed);
        store(&self.commanded, &shown.commanded);
        store(&self.measured, &shown.measured);
        store(&self.force, &shown.force);
        if shown.falls != self.falls.load(Ordering::Relaxed)
            && let Ok(mut reason) = self.reason.try_lock()
        {
            *reason = controller.last_leave();
            self.falls.store(shown.falls, Ordering::Release);
        }
    }
}

fn load<const N: usize>(from: &[AtomicU64; N]) -> [f64; N] {
    array::from_fn(|i| f64::from_bits(from[i].load(Ordering::Relaxed)))
}

#[cfg(target_os = "linux")]
fn store<const N: usize>(to: &[AtomicU64; N], values: &[f64; N]) {
    for (to, value) in to.iter().zip(values) {
        to.store(value.to_bits(), Ordering::Relaxed);
    }
}

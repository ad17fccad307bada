//! State of a served controller for other threads, and its run-time settings. It holds no history.

use super::{AXES, LineFaults};
use std::array;
use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU32, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Values that a controller publishes in one cycle.
#[derive(Debug, Clone, Copy)]
pub struct Snapshot {
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
    pub(crate) exits: u64,
}

/// A controller that [`Status`] can publish: the emulated controllers only.
pub trait Served {
    /// State type of the generation.
    type State: fmt::Display;
    /// Quality type of the generation.
    type Quality: fmt::Display;
    /// Why command mode was left.
    type ExitReason: Copy + fmt::Display + Send;

    /// The next datagram due, if one is.
    #[doc(hidden)]
    fn transmit(&mut self, now: Duration, buf: &mut [u8]) -> Option<usize>;
    /// Handles a datagram; the controller counts malformed ones and ignores them otherwise.
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
    fn snapshot(&self) -> Snapshot;
    /// The last reason.
    #[doc(hidden)]
    fn last_exit(&self) -> Option<Self::ExitReason>;
    #[doc(hidden)]
    fn switch(&mut self, power: bool);
    /// Ends the connection, as the robot program does; the last datagram of a cabinet reports it.
    #[doc(hidden)]
    fn close(&mut self);
    #[doc(hidden)]
    fn lines(&mut self) -> [&mut LineFaults; 2];
}

/// Live state of a controller while it is served, shared by an `Arc`. Each value is consistent; two of them may belong
/// to different cycles.
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
    exits: AtomicU64,
    /// The controller's thread writes it only if no reader holds the lock: that thread never waits.
    reason: Mutex<Option<C::ExitReason>>,
    power_off_wanted: AtomicBool,
    drop_ppm_wanted: AtomicU32,
}

/// No drop probability was set: the configured one stays.
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
            exits: AtomicU64::default(),
            reason: Default::default(),
            power_off_wanted: AtomicBool::default(),
            drop_ppm_wanted: AtomicU32::new(UNTOUCHED),
        }
    }
}

impl<C: Served> fmt::Debug for Status<C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Status")
            .field("state", &self.state)
            .field("quality", &self.quality)
            .field("exits", &self.exits)
            .finish_non_exhaustive()
    }
}

impl<C: Served> Status<C> {
    /// A status before the first cycle.
    pub fn new() -> Self {
        Self::default()
    }

    /// State as reported; OFF or IDLE before the first cycle.
    pub fn state(&self) -> C::State {
        C::state_of(self.state.load(Ordering::Relaxed))
    }

    /// Quality as reported.
    pub fn quality(&self) -> C::Quality {
        C::quality_of(self.quality.load(Ordering::Relaxed))
    }

    /// Whether the drives have power.
    pub fn has_power(&self) -> bool {
        self.power.load(Ordering::Relaxed)
    }

    /// Measurements sent.
    pub fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    /// New answers received.
    pub fn answers(&self) -> u64 {
        self.answers.load(Ordering::Relaxed)
    }

    /// Command periods without an answer in time.
    pub fn missed(&self) -> u32 {
        self.missed.load(Ordering::Relaxed)
    }

    /// Answers ignored as copies or as older than the newest.
    pub fn old(&self) -> u64 {
        self.old.load(Ordering::Relaxed)
    }

    /// Datagrams refused by the decoder.
    pub fn malformed(&self) -> u64 {
        self.malformed.load(Ordering::Relaxed)
    }

    /// Measurements not sent because this host was late.
    pub fn stalls(&self) -> u64 {
        self.stalls.load(Ordering::Relaxed)
    }

    /// Joint set-point, rad.
    pub fn commanded(&self) -> [f64; AXES] {
        load(&self.commanded)
    }

    /// Measured joint positions, rad.
    pub fn measured(&self) -> [f64; AXES] {
        load(&self.measured)
    }

    /// Force of the contact on the flange in the base frame, N.
    pub fn force(&self) -> [f64; 3] {
        load(&self.force)
    }

    /// Number of exits from command mode, ends of an overlay (on request, too) and timeouts while waiting for quality.
    pub fn exits(&self) -> u64 {
        self.exits.load(Ordering::Acquire)
    }

    /// Reason of the last of these.
    pub fn last_exit(&self) -> Option<C::ExitReason> {
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

    /// Applies the requested settings to `controller`.
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
    }

    /// Publishes the state of `controller`.
    #[cfg(target_os = "linux")]
    pub(crate) fn publish(&self, controller: &C) {
        let snapshot = controller.snapshot();
        self.state.store(snapshot.state, Ordering::Relaxed);
        self.quality.store(snapshot.quality, Ordering::Relaxed);
        self.power.store(snapshot.has_power, Ordering::Relaxed);
        self.sent.store(snapshot.sent, Ordering::Relaxed);
        self.answers.store(snapshot.answers, Ordering::Relaxed);
        self.missed.store(snapshot.missed, Ordering::Relaxed);
        self.old.store(snapshot.old, Ordering::Relaxed);
        self.malformed.store(snapshot.malformed, Ordering::Relaxed);
        self.stalls.store(snapshot.stalls, Ordering::Relaxed);
        store(&self.commanded, &snapshot.commanded);
        store(&self.measured, &snapshot.measured);
        store(&self.force, &snapshot.force);
        if snapshot.exits != self.exits.load(Ordering::Relaxed)
            && let Ok(mut reason) = self.reason.try_lock()
        {
            *reason = controller.last_exit();
            self.exits.store(snapshot.exits, Ordering::Release);
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

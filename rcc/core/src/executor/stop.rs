//! The emergency stop of a controller, exchanged between its net threads by atomic words and
//! without waiting. It does not brake itself: while it is active, devices appear to nets as not enabled, so
//! that the nets that command them end and drivers see their set-points end. It is not a safety function.
//!
//! The last value of an `EStop` primitive is valid until another one, of any thread, sets another value.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU8, Ordering};

use takt_rt::Nanos;

use crate::cell::THREADS_MAX;
use crate::stop_channel::{Generation, StopSwitch};

/// A controller that needs to receive of the emergency stop is stopped when it has not for so long.
pub const SILENCE_MAX: Nanos = Nanos::from_millis(20);

/// Bit of a thread whose present cycle sets a value.
const SAID: u8 = 1;
/// Bit of a thread that demands a stop, as of its last value.
const STOP: u8 = 2;

/// State of one thread.
#[derive(Debug)]
struct Word {
    bits: AtomicU8,
    /// Time of the last value, ns.
    at: AtomicI64,
}

/// State of all net threads of a controller.
#[derive(Debug)]
pub struct EmergencyStop {
    is_needed: bool,
    words: [Word; THREADS_MAX],
    switch: StopSwitch,
}

impl EmergencyStop {
    /// Without values. `is_needed`: devices stop if no value is set within [`SILENCE_MAX`].
    #[must_use]
    pub fn new(is_needed: bool) -> Self {
        Self::under(is_needed, StopSwitch::default())
    }

    /// As [`Self::new`], under a switch that others can also operate.
    #[must_use]
    pub fn under(is_needed: bool, switch: StopSwitch) -> Self {
        let word = || Word {
            bits: AtomicU8::new(0),
            at: AtomicI64::new(i64::MIN),
        };
        Self {
            is_needed,
            words: std::array::from_fn(|_| word()),
            switch,
        }
    }

    /// The switch of the stop channel.
    #[must_use]
    pub const fn switch(&self) -> &StopSwitch {
        &self.switch
    }

    /// Whether all devices are to stop at `now`.
    #[must_use]
    pub fn is_on(&self, now: Nanos) -> bool {
        let bits = self.words.iter().fold([0; 4], |mut counts, word| {
            counts[usize::from(word.bits.load(Ordering::Acquire) & (SAID | STOP))] += 1;
            counts
        });
        let [_, go, left, stop] = bits;
        let is_silent = || {
            let spoken = self.words.iter().map(|w| w.at.load(Ordering::Relaxed));
            let last = Nanos(spoken.max().unwrap_or(i64::MIN));
            now.0.saturating_sub(last.0) > SILENCE_MAX.0
        };
        self.switch.is_stopped()
            || stop > 0
            || (left > 0 && go == 0)
            || (self.is_needed && is_silent())
    }
}

/// The part of one net thread.
#[derive(Debug)]
pub struct StopPart {
    shared: Arc<EmergencyStop>,
    thread: usize,
    is_on: bool,
    count: u64,
    /// Generation of the switch in the present cycle.
    generation: Generation,
    /// Whether all nets end in this cycle.
    ends_nets: bool,
    /// Whether the switch waits for an answer.
    is_asked: bool,
}

impl Default for StopPart {
    /// The part of a single thread.
    fn default() -> Self {
        Self::new(Arc::new(EmergencyStop::new(false)), 0)
    }
}

impl StopPart {
    /// The part of the thread of that number, below [`THREADS_MAX`].
    #[must_use]
    pub fn new(shared: Arc<EmergencyStop>, thread: usize) -> Self {
        Self {
            shared,
            thread,
            is_on: false,
            count: 0,
            generation: Generation::default(),
            ends_nets: false,
            is_asked: false,
        }
    }

    /// Before a cycle that begins at `now`: reads the values of others.
    pub fn poll(&mut self, now: Nanos) {
        let words = &self.shared.words;
        if let Some(own) = words.get(self.thread) {
            let says = |word: &Word| word.bits.load(Ordering::Acquire) & SAID != 0;
            // The value of this thread is stale once another thread sets one.
            if !says(own) && words.iter().any(says) {
                own.bits.store(0, Ordering::Release);
            }
        }
        let generation = self.shared.switch.generation();
        self.ends_nets = generation.stops() != self.generation.stops();
        self.is_asked |= generation != self.generation;
        self.generation = generation;
        let is_on = self.shared.is_on(now);
        // A stop that was released before this thread saw it counts too.
        self.count += u64::from((is_on && !self.is_on) || self.ends_nets);
        self.is_on = is_on;
    }

    /// Whether all nets end in this cycle, and no earlier request starts.
    #[must_use]
    pub const fn ends_nets(&self) -> bool {
        self.ends_nets
    }

    /// Whether a request under that generation may start.
    #[must_use]
    pub fn permits(&self, requested: Generation) -> bool {
        !self.generation.is_stopped() && requested == self.generation
    }

    /// After commands were sent to drivers: answers the switch, if it waits for that.
    pub fn answer(&mut self, ended: u32, now: impl FnOnce() -> Nanos) {
        if std::mem::take(&mut self.is_asked) {
            let switch = &self.shared.switch;
            switch.answer(self.thread, self.generation, ended, now());
        }
    }

    /// Whether all devices stop in this cycle.
    #[must_use]
    pub const fn is_on(&self) -> bool {
        self.is_on
    }

    /// Number of onsets.
    #[must_use]
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// After a cycle that began at `now`: publishes the value that its nets set, if any.
    pub fn say(&self, vote: Option<bool>, now: Nanos) {
        let Some(own) = self.shared.words.get(self.thread) else {
            return;
        };
        let bits = match vote {
            Some(true) => SAID | STOP,
            Some(false) => SAID,
            None => own.bits.load(Ordering::Relaxed) & STOP,
        };
        own.bits.store(bits, Ordering::Release);
        if vote.is_some() {
            own.at.store(now.0, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(ms: i64) -> Nanos {
        Nanos::from_millis(ms)
    }

    fn parts(is_needed: bool) -> [StopPart; 2] {
        let shared = Arc::new(EmergencyStop::new(is_needed));
        [0, 1].map(|thread| StopPart::new(Arc::clone(&shared), thread))
    }

    /// One cycle of both threads; returns whether each sees a stop.
    fn cycle(parts: &mut [StopPart; 2], votes: [Option<bool>; 2], now: Nanos) -> [bool; 2] {
        for (part, vote) in parts.iter_mut().zip(votes) {
            part.poll(now);
            part.say(vote, now);
        }
        parts.each_ref().map(|part| part.shared.is_on(now))
    }

    #[test]
    fn estop_of_one_thread_stops_all() {
        let mut parts = parts(false);
        assert_eq!(cycle(&mut parts, [None, None], ms(0)), [false; 2]);
        assert_eq!(
            cycle(&mut parts, [Some(false), Some(true)], ms(1)),
            [true; 2]
        );
        assert_eq!(
            cycle(&mut parts, [Some(false), Some(false)], ms(2)),
            [false; 2]
        );
        parts[0].poll(ms(3));
        assert_eq!((parts[0].is_on(), parts[0].count()), (false, 1));
    }

    #[test]
    fn estop_value_holds_until_overridden() {
        let mut parts = parts(false);
        cycle(&mut parts, [Some(true), None], ms(0));
        assert_eq!(cycle(&mut parts, [None, None], ms(1)), [true; 2]);
        assert_eq!(cycle(&mut parts, [None, None], ms(1000)), [true; 2]);
        assert_eq!(cycle(&mut parts, [None, Some(false)], ms(1001)), [false; 2]);
        // It has ended, not only been overridden.
        cycle(&mut parts, [None, Some(false)], ms(1002));
        assert_eq!(cycle(&mut parts, [None, None], ms(1003)), [false; 2]);
    }

    #[test]
    fn estop_missing_stops_if_needed() {
        let mut parts = parts(true);
        assert_eq!(cycle(&mut parts, [None, None], ms(0)), [true; 2]);
        assert_eq!(cycle(&mut parts, [None, Some(false)], ms(1)), [false; 2]);
        assert_eq!(cycle(&mut parts, [None, None], ms(21)), [false; 2]);
        assert_eq!(cycle(&mut parts, [None, None], ms(22)), [true; 2]);
    }
}

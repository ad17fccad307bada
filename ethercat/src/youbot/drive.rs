//! One drive of a youBot: brought from whatever it is in to where it does what it is told, and back there after
//! faults. What it is told is its owner's business; it moves by itself only to find its commutation, and only while
//! its owner allows that.
//!
//! ```text
//!          1 inputs         2 version         3 set up                  5 may move
//! Absent ----------> Identify -----> Prepare -----+----> Uncommutated ------------> Commutate
//!   ^                   |               |         |           ^    ^-- 6 blocked ---- |   | 7 flag 15
//!   | 4 no inputs,      | 8 unknown,    | 8       | 3 flag 15 | 10 flag 15 gone       |   v
//!   |   from any        v refused       v         +--> Ready -+<-- 9 200 ms ---------------- Settle
//!   +---------------- Refused(why) <---- 8 too long --|-------------------------------+
//!                                                     | 11 flag 16 or 17
//!                         13 a clearing is due again  v        12 flag gone
//!                     Exhausted ----------------> Clear ------------------> Ready
//!                         ^------ 14 none left ------+
//! ```
//! All in [`Drive::cycle`]: 1 and 4 at the top, 2 in `identify`, 3 in `prepare`, 5 to 7 in `commutate`, 9 to 14 in
//! `watch` and `clear`, 8 in each. What a mailbox lost is tried again 2 s later; other refusals stand until the drive
//! is gone and back.

use std::time::Duration;

use super::mailbox::{CallError, Mailbox};
use super::tmcl::{Answer, Request, Version};
use super::wire::{Command, Feedback, Flags, Mode};
use super::{Firmware, parameters};

/// Before a mailbox that failed is tried again.
const AGAIN: Duration = Duration::from_secs(2);
/// Longest search for the commutation.
const COMMUTATION_MAX: Duration = Duration::from_secs(5);
/// How long a motor comes to rest behind it.
const SETTLE: Duration = Duration::from_millis(200);
/// Speed at which firmware 2.00 finds it, rpm.
const COMMUTATION_RPM: i32 = 100;
/// Flags that may be cleared in a row.
const CLEARINGS: u8 = 5;
/// After so long one more may.
const CLEARING_EACH: Duration = Duration::from_secs(10);
/// How long a flag may stay behind its clearing.
const CLEAR_MAX: Duration = Duration::from_secs(1);

/// How a drive is led.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DriveConfig {
    /// Largest current, mA: written to the drive, which applies it to its own loops, and kept here for currents that it
    /// is told, which it does not limit.
    pub current_max_ma: i32,
    /// The commutation is found turning this way, 1 or -1.
    pub direction: i32,
}

/// Where a drive is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriveState {
    /// No inputs come.
    Absent,
    /// Its firmware is asked for.
    Identify,
    /// Parameters are written.
    Prepare(u8),
    /// Its commutation is not known, and it may not move.
    Uncommutated,
    /// It finds its commutation, since then.
    Commutate(Duration),
    /// It comes to rest, since then.
    Settle(Duration),
    /// It does what it is told.
    Ready,
    /// Its time-out or I2t flag is being cleared, since then.
    Clear(Duration),
    /// It set such flags too often.
    Exhausted,
    /// It cannot be used, since then.
    Refused(Obstacle, Duration),
}

/// Why a drive does not do what it is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Obstacle {
    /// It does not answer.
    #[error("no inputs come; look at its cable and power")]
    Absent,
    /// It is on its way.
    #[error("it is being set up")]
    Starting,
    /// It may not move to find its commutation.
    #[error("its commutation is not known; it has to turn a bit to find it")]
    Uncommutated,
    /// Its firmware is none of those known, or its inputs are those of another.
    #[error(
        "board {} has firmware {}.{:02} with {inputs} bytes of inputs; 1.48 (20) and 2.xx (32) are known",
        version.board, version.number / 100, version.number % 100
    )]
    Firmware {
        /// As it says.
        version: Version,
        /// Bytes of inputs.
        inputs: usize,
    },
    /// Turning did not show the commutation.
    #[error(
        "it found no commutation within 5 s; is the joint blocked, or the Hall sensor's cable loose?"
    )]
    Commutation,
    /// Its mailbox.
    #[error("{0}")]
    Call(CallError),
    /// A flag came back at once.
    #[error("it does not clear: {0}")]
    Stuck(Flags),
    /// Time-outs or I2t too often.
    #[error("time-out or I2t more than 5 times, one forgotten each 10 s: look for its cause")]
    TooOften,
    /// Flags that stop it.
    #[error("{0}")]
    Flags(Flags),
}

/// What happened to a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// EtherCAT time-outs (flag 16).
    pub timeouts: u64,
    /// I2t (flag 17).
    pub i2t: u64,
    /// Currents that were cut to the largest one.
    pub clamped: u64,
    /// Commutations.
    pub commutations: u64,
}

/// How many flags may still be cleared.
#[derive(Clone, Copy, Debug)]
struct Budget {
    left: u8,
    since: Duration,
}

impl Budget {
    fn take(&mut self, now: Duration) -> bool {
        self.refill(now);
        let has = self.left > 0;
        self.left = self.left.saturating_sub(1);
        has
    }

    fn refill(&mut self, now: Duration) {
        if self.left == CLEARINGS {
            self.since = now;
        }
        while self.left < CLEARINGS && now.saturating_sub(self.since) >= CLEARING_EACH {
            self.left += 1;
            self.since += CLEARING_EACH;
        }
    }
}

/// A drive.
#[derive(Debug)]
pub struct Drive {
    config: DriveConfig,
    mailbox: Mailbox,
    state: DriveState,
    feedback: Option<(Firmware, Feedback)>,
    inputs: usize,
    version: Option<Version>,
    counters: Counters,
    budget: Budget,
}

impl Drive {
    /// That of a slave, by its number with the master.
    #[must_use]
    pub fn new(slave: usize, config: DriveConfig) -> Self {
        Self {
            config,
            mailbox: Mailbox::new(slave),
            state: DriveState::Absent,
            feedback: None,
            inputs: 0,
            version: None,
            counters: Counters::default(),
            budget: Budget {
                left: CLEARINGS,
                since: Duration::ZERO,
            },
        }
    }

    /// Number of its slave.
    #[must_use]
    pub const fn slave(&self) -> usize {
        self.mailbox.slave()
    }

    /// Where it is.
    #[must_use]
    pub const fn state(&self) -> DriveState {
        self.state
    }

    /// What it told in this cycle.
    #[must_use]
    pub fn feedback(&self) -> Option<&Feedback> {
        self.feedback.as_ref().map(|(_, feedback)| feedback)
    }

    /// Its firmware, once it said.
    #[must_use]
    pub const fn version(&self) -> Option<Version> {
        self.version
    }

    /// What happened to it.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// How often a request of its mailbox was asked again.
    #[must_use]
    pub const fn repeats(&self) -> u64 {
        self.mailbox.repeats()
    }

    /// Its mailbox, for what else is to be asked.
    pub const fn mailbox(&mut self) -> &mut Mailbox {
        &mut self.mailbox
    }

    /// Puts it into a state, as if at that time.
    #[cfg(test)]
    pub(super) fn force(&mut self, state: DriveState, since: Duration) {
        self.state = state;
        if state == DriveState::Exhausted {
            self.budget = Budget { left: 0, since };
        }
    }

    fn flags(&self) -> Flags {
        self.feedback().map(|told| told.flags).unwrap_or_default()
    }

    /// Whether it does what it is told.
    #[must_use]
    pub fn follows(&self) -> bool {
        self.obstacle().is_none()
    }

    /// Why it does not; `None` if it does.
    #[must_use]
    pub fn obstacle(&self) -> Option<Obstacle> {
        let blocking = Flags::BLOCKING | Flags::TIMEOUT | Flags::I2T;
        match self.state {
            DriveState::Absent => Some(Obstacle::Absent),
            DriveState::Identify
            | DriveState::Prepare(_)
            | DriveState::Commutate(_)
            | DriveState::Settle(_) => Some(Obstacle::Starting),
            DriveState::Uncommutated if self.flags().any(Flags::BLOCKING) => {
                Some(Obstacle::Flags(self.flags()))
            }
            DriveState::Uncommutated => Some(Obstacle::Uncommutated),
            DriveState::Exhausted => Some(Obstacle::TooOften),
            DriveState::Refused(why, _) => Some(why),
            DriveState::Clear(_) => Some(Obstacle::Flags(self.flags())),
            DriveState::Ready if self.flags().any(blocking) => Some(Obstacle::Flags(self.flags())),
            DriveState::Ready if !self.flags().any(Flags::INITIALIZED) => {
                Some(Obstacle::Uncommutated)
            }
            DriveState::Ready => None,
        }
    }

    /// One cycle: takes the inputs, `None` if there are none of late, and gives the outputs. `wanted` is done if it
    /// [follows](Self::follows); else it holds. It turns to find its commutation only if it `may_move`.
    pub fn cycle(
        &mut self,
        inputs: Option<&[u8]>,
        wanted: Option<Command>,
        may_move: bool,
        now: Duration,
    ) -> Command {
        self.inputs = inputs.map_or(0, <[u8]>::len);
        self.feedback = inputs.and_then(|bytes| {
            let firmware = Firmware::of_inputs(bytes.len())?;
            Some((firmware, Feedback::decode(firmware, bytes)?))
        });
        if inputs.is_none() {
            self.state = DriveState::Absent;
        } else if self.state == DriveState::Absent {
            self.state = DriveState::Identify;
        }
        self.state = self.next(may_move, now);
        let follows = self.follows();
        match self.state {
            DriveState::Commutate(_) => self.commutation(),
            DriveState::Ready if follows => self.clamp(wanted.unwrap_or(Command::HOLD)),
            DriveState::Absent
            | DriveState::Identify
            | DriveState::Prepare(_)
            | DriveState::Uncommutated
            | DriveState::Settle(_)
            | DriveState::Ready
            | DriveState::Clear(_)
            | DriveState::Exhausted
            | DriveState::Refused(..) => self.rest(),
        }
    }

    fn next(&mut self, may_move: bool, now: Duration) -> DriveState {
        match self.state {
            DriveState::Absent => DriveState::Absent,
            DriveState::Identify => self.identify(now),
            DriveState::Prepare(step) => self.prepare(step, now),
            DriveState::Uncommutated | DriveState::Commutate(_) => self.commutate(may_move, now),
            DriveState::Settle(since) if now.saturating_sub(since) >= SETTLE => DriveState::Ready,
            DriveState::Settle(since) => DriveState::Settle(since),
            DriveState::Ready => self.watch(now),
            DriveState::Clear(since) => self.clear(since, now),
            DriveState::Exhausted => {
                self.budget.refill(now);
                if self.budget.left > 0 {
                    self.watch(now)
                } else {
                    DriveState::Exhausted
                }
            }
            DriveState::Refused(Obstacle::Call(_), since) if now.saturating_sub(since) >= AGAIN => {
                DriveState::Identify
            }
            DriveState::Refused(why, since) => DriveState::Refused(why, since),
        }
    }

    fn identify(&mut self, now: Duration) -> DriveState {
        let version = match self.mailbox.call(Request::firmware()) {
            None => return DriveState::Identify,
            Some(Ok(Answer::Version(version))) => version,
            Some(Ok(Answer::Value(_))) => return DriveState::Identify,
            Some(Err(error)) => return DriveState::Refused(Obstacle::Call(error), now),
        };
        self.version = Some(version);
        let of_inputs = self.feedback.map(|(firmware, _)| firmware);
        if of_inputs.is_some() && version.firmware() == of_inputs {
            return DriveState::Prepare(0);
        }
        let inputs = self.inputs;
        DriveState::Refused(Obstacle::Firmware { version, inputs }, now)
    }

    fn prepare(&mut self, step: u8, now: Duration) -> DriveState {
        let request = match step {
            0 => Request::set(parameters::MAX_CURRENT, self.config.current_max_ma),
            _ if self.flags().any(Flags::INITIALIZED) => return DriveState::Ready,
            _ => return DriveState::Uncommutated,
        };
        match self.mailbox.call(request) {
            None => DriveState::Prepare(step),
            Some(Ok(_)) => DriveState::Prepare(step + 1),
            Some(Err(error)) => DriveState::Refused(Obstacle::Call(error), now),
        }
    }

    fn commutate(&mut self, may_move: bool, now: Duration) -> DriveState {
        let flags = self.flags();
        if flags.any(Flags::INITIALIZED) {
            return DriveState::Settle(now);
        }
        if flags.any(Flags::TIMEOUT | Flags::I2T) {
            return self.trip(now);
        }
        let blocked = flags.any(Flags::BLOCKING) || !may_move;
        match self.state {
            _ if blocked => DriveState::Uncommutated,
            DriveState::Commutate(since) if now.saturating_sub(since) > COMMUTATION_MAX => {
                DriveState::Refused(Obstacle::Commutation, now)
            }
            DriveState::Commutate(since) => DriveState::Commutate(since),
            DriveState::Absent
            | DriveState::Identify
            | DriveState::Prepare(_)
            | DriveState::Uncommutated
            | DriveState::Settle(_)
            | DriveState::Ready
            | DriveState::Clear(_)
            | DriveState::Exhausted
            | DriveState::Refused(..) => {
                self.counters.commutations += 1;
                DriveState::Commutate(now)
            }
        }
    }

    fn watch(&mut self, now: Duration) -> DriveState {
        let flags = self.flags();
        if flags.any(Flags::TIMEOUT | Flags::I2T) {
            self.trip(now)
        } else if flags.any(Flags::INITIALIZED) {
            DriveState::Ready
        } else {
            DriveState::Uncommutated
        }
    }

    /// A flag came that is to be cleared.
    fn trip(&mut self, now: Duration) -> DriveState {
        let counts = self.state != DriveState::Exhausted;
        let flags = self.flags();
        self.counters.timeouts += u64::from(counts && flags.any(Flags::TIMEOUT));
        self.counters.i2t += u64::from(counts && flags.any(Flags::I2T));
        if self.budget.take(now) {
            DriveState::Clear(now)
        } else {
            DriveState::Exhausted
        }
    }

    fn clear(&mut self, since: Duration, now: Duration) -> DriveState {
        let flags = self.flags();
        let request = if flags.any(Flags::TIMEOUT) {
            Request::set(parameters::CLEAR_TIMEOUT, 1)
        } else if flags.any(Flags::I2T) {
            Request::set(parameters::CLEAR_I2T, 1)
        } else {
            return self.watch(now);
        };
        match self.mailbox.call(request) {
            Some(Err(error)) => DriveState::Refused(Obstacle::Call(error), now),
            // A drive that answers and keeps its flag; lost requests have a longer time-out of their own.
            Some(Ok(_)) if now.saturating_sub(since) > CLEAR_MAX => {
                DriveState::Refused(Obstacle::Stuck(flags), now)
            }
            None | Some(Ok(_)) => DriveState::Clear(since),
        }
    }

    const fn commutation(&self) -> Command {
        match self.feedback {
            Some((Firmware::V148, _)) => Command {
                value: 0,
                mode: Mode::Initialize,
            },
            Some((Firmware::V200, _)) | None => {
                Command::velocity(COMMUTATION_RPM * self.config.direction)
            }
        }
    }

    /// The vendor's driver leaves a joint without current here, and the arm sags.
    fn rest(&self) -> Command {
        if self.flags().any(Flags::INITIALIZED) {
            Command::HOLD
        } else {
            Command::default()
        }
    }

    fn clamp(&mut self, wanted: Command) -> Command {
        if wanted.mode != Mode::Current {
            return wanted;
        }
        let most = self.config.current_max_ma.max(0);
        let value = wanted.value.clamp(-most, most);
        self.counters.clamped += u64::from(value != wanted.value);
        Command::current(value)
    }
}

//! One drive of a youBot: brings it from any state to where it executes commands, and back there after faults. Its
//! owner chooses the commands; the drive moves by itself only to find its commutation, and only while its owner permits
//! that.
//!
//! ```text
//!          1 inputs         2 version         3 set up                  5 may move
//! Absent ----------> Identify -----> Prepare -----+----> Uncommutated ------------> Commutate
//!   ^                   |               |         |           ^    ^-- 6 blocked ---- |   | 7 flag 15
//!   | 4 no inputs,      | 8 unknown,    | 8       | 3 flag 15 | 10 flag 15 lost       |   v
//!   |   from any        v refused       v         +--> Ready -+<-- 9 200 ms ---------------- Settle
//!   +---------------- Refused(why) <---- 8 too long --|-------------------------------+
//!                                                     | 11 flag 16 or 17
//!                         13 a clearing is available  v        12 flag lost
//!                     Exhausted ----------------> Clear ------------------> Ready
//!                         ^------ 14 none left ------+
//! ```
//! All in [`Drive::cycle`]: 1 and 4 at the top, 2 in `identify`, 3 in `prepare`, 5 to 7 in `commutate`, 9 to 14 in
//! `watch` and `clear`, 8 in each. A request lost by the mailbox is retried 2 s later; other errors persist until the
//! drive was offline.

use std::time::Duration;

use super::mailbox::{CallError, Mailbox};
use super::tmcl::{Answer, Request, Version};
use super::wire::{Command, Feedback, Flags, Mode};
use super::{Firmware, parameters};
use crate::master::Master;

/// Retry delay after a mailbox error.
const AGAIN: Duration = Duration::from_secs(2);
/// Timeout of the commutation search.
const COMMUTATION_MAX: Duration = Duration::from_secs(5);
/// Settling time of the motor after it.
const SETTLE: Duration = Duration::from_millis(200);
/// Speed of the search with firmware 2.00, rpm.
const COMMUTATION_RPM: i32 = 100;
/// Number of flags that may be cleared in a row.
const CLEARINGS: u8 = 5;
/// Time after which one more may be cleared.
const CLEARING_EACH: Duration = Duration::from_secs(10);
/// Timeout until a cleared flag is reset.
const CLEAR_MAX: Duration = Duration::from_secs(1);

/// Configuration of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DriveConfig {
    /// Largest current, mA: written to the drive, which applies it to its own control loops, and applied here to
    /// commanded currents, which the drive does not limit.
    pub current_max_ma: i32,
    /// Direction of the commutation search, 1 or -1.
    pub direction: i32,
}

impl DriveConfig {
    /// That of joint `number` of the arm, from 0.
    #[must_use]
    pub const fn joint(number: usize, current_max_ma: i32) -> Self {
        Self {
            current_max_ma,
            // Homing moves all joints but the third off their stops, as the vendor's driver does.
            direction: if number == 2 { 1 } else { -1 },
        }
    }
}

/// State of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriveState {
    /// No inputs are received.
    Absent,
    /// Its firmware is requested.
    Identify,
    /// Parameters are written.
    Prepare(u8),
    /// Its commutation is unknown, and it may not move.
    Uncommutated,
    /// It searches its commutation, since this time.
    Commutate(Duration),
    /// It settles, since this time.
    Settle(Duration),
    /// It executes commands.
    Ready,
    /// Its timeout or I2t flag is being cleared, since this time.
    Clear(Duration),
    /// It set these flags too often.
    Exhausted,
    /// It cannot be used, since this time.
    Refused(DriveFault, Duration),
}

/// Why a drive does not execute commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DriveFault {
    /// It does not answer.
    #[error("no inputs are received; check its cable and power")]
    Absent,
    /// It is being set up.
    #[error("it is being set up")]
    Starting,
    /// It may not move to find its commutation.
    #[error("its commutation is unknown; it must turn slightly to find it")]
    Uncommutated,
    /// Its firmware is unknown, or its inputs do not match.
    #[error(
        "board {} has firmware {}.{:02} with {inputs} bytes of inputs; 1.48 (20) and 2.xx (32) are known",
        version.board, version.number / 100, version.number % 100
    )]
    Firmware {
        /// As reported.
        version: Version,
        /// Length of the inputs, bytes.
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
    /// A flag could not be cleared.
    #[error("it does not clear: {0}")]
    Stuck(Flags),
    /// Too many timeouts or I2t flags.
    #[error("more than 5 EtherCAT timeouts or I2t faults (one expires every 10 s): find the cause")]
    TooOften,
    /// Flags that stop it.
    #[error("{0}")]
    Flags(Flags),
}

/// Counters of a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// EtherCAT timeouts (flag 16).
    pub timeouts: u64,
    /// I2t (flag 17).
    pub i2t: u64,
    /// Commanded currents that were limited.
    pub clamped: u64,
    /// Commutation searches.
    pub commutations: u64,
}

/// Budget of flags that may be cleared.
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
    /// The drive of a slave, by its number at the master.
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
    pub const fn slave(&self) -> usize {
        self.mailbox.slave()
    }

    /// Its state.
    pub const fn state(&self) -> DriveState {
        self.state
    }

    /// Its inputs of this cycle.
    pub fn feedback(&self) -> Option<&Feedback> {
        self.feedback.as_ref().map(|(_, feedback)| feedback)
    }

    /// Its firmware, once reported.
    pub const fn version(&self) -> Option<Version> {
        self.version
    }

    /// Its counters.
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Number of repeated mailbox requests.
    pub const fn repeats(&self) -> u64 {
        self.mailbox.repeats()
    }

    /// Its mailbox, for other requests.
    pub const fn mailbox(&mut self) -> &mut Mailbox {
        &mut self.mailbox
    }

    /// Sets its state, as if entered at this time.
    #[cfg(test)]
    pub(super) fn force(&mut self, state: DriveState, since: Duration) {
        self.state = state;
        if state == DriveState::Exhausted {
            self.budget = Budget { left: 0, since };
        }
    }

    fn flags(&self) -> Flags {
        self.feedback()
            .map(|feedback| feedback.flags)
            .unwrap_or_default()
    }

    /// Whether it executes commands.
    pub fn follows(&self) -> bool {
        self.drive_fault().is_none()
    }

    /// Why it does not execute commands; `None` if it does.
    pub fn drive_fault(&self) -> Option<DriveFault> {
        let blocking = Flags::BLOCKING | Flags::TIMEOUT | Flags::I2T;
        match self.state {
            DriveState::Absent => Some(DriveFault::Absent),
            DriveState::Identify
            | DriveState::Prepare(_)
            | DriveState::Commutate(_)
            | DriveState::Settle(_) => Some(DriveFault::Starting),
            DriveState::Uncommutated if self.flags().any(Flags::BLOCKING) => {
                Some(DriveFault::Flags(self.flags()))
            }
            DriveState::Uncommutated => Some(DriveFault::Uncommutated),
            DriveState::Exhausted => Some(DriveFault::TooOften),
            DriveState::Refused(why, _) => Some(why),
            DriveState::Clear(_) => Some(DriveFault::Flags(self.flags())),
            DriveState::Ready if self.flags().any(blocking) => {
                Some(DriveFault::Flags(self.flags()))
            }
            DriveState::Ready if !self.flags().any(Flags::INITIALIZED) => {
                Some(DriveFault::Uncommutated)
            }
            DriveState::Ready => None,
        }
    }

    /// One cycle at its master: inputs of the last frame, outputs of the next, and its mailbox. The rest as in
    /// [`Self::cycle`].
    pub fn exchange(
        &mut self,
        master: &mut Master,
        wanted: Option<Command>,
        may_move: bool,
        now: Duration,
    ) {
        let slave = self.slave();
        let (bytes, age) = master.inputs(slave);
        let online = master.is_exchanging() && master.is_online(age) && !bytes.is_empty();
        let command = self.cycle(online.then_some(bytes), wanted, may_move, now);
        if let Some(outputs) = master.outputs_mut(slave).first_chunk_mut() {
            *outputs = command.encode();
        }
        self.mailbox.poll(master, now);
    }

    /// One cycle: takes the inputs, `None` if there are no recent ones, and returns the outputs. It executes `wanted`
    /// if it [follows](Self::follows); otherwise it holds. It turns to find its commutation only if it `may_move`.
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
            DriveState::Refused(DriveFault::Call(_), since)
                if now.saturating_sub(since) >= AGAIN =>
            {
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
            Some(Err(error)) => return DriveState::Refused(DriveFault::Call(error), now),
        };
        self.version = Some(version);
        let of_inputs = self.feedback.map(|(firmware, _)| firmware);
        if of_inputs.is_some() && version.firmware() == of_inputs {
            return DriveState::Prepare(0);
        }
        let inputs = self.inputs;
        DriveState::Refused(DriveFault::Firmware { version, inputs }, now)
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
            Some(Err(error)) => DriveState::Refused(DriveFault::Call(error), now),
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
                DriveState::Refused(DriveFault::Commutation, now)
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

    /// A flag that must be cleared is set.
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
            Some(Err(error)) => DriveState::Refused(DriveFault::Call(error), now),
            // The drive answers but keeps its flag; lost requests have their own longer timeout.
            Some(Ok(_)) if now.saturating_sub(since) > CLEAR_MAX => {
                DriveState::Refused(DriveFault::Stuck(flags), now)
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

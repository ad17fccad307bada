//! Homing of one joint to its stop: towards it until the motor presses, then the encoder is set to 0 there. It can be
//! cancelled in each of its states; whether a joint may move at all is decided before it is started.
//!
//! ```text
//!         1 start        2 not homed           3 presses        4 100 ms          5            6
//! Idle ----------> Ask -------------> Approach ---------> Rest ---------> Preset ---> Mark ---> Done
//!                   | 7 homed                                                                    ^
//!                   +----------------------------------------------------------------------------+
//! any of Ask to Mark --8 cancel--> Cancelled        --9 too long, refused--> Failed(why)
//! ```
//! 1 in [`Homing::start`], 8 in [`Homing::cancel`], the others in [`Homing::cycle`].

use std::time::Duration;

use super::mailbox::{CallError, Mailbox};
use super::parameters::{ACTUAL_POSITION, CALIBRATED};
use super::tmcl::Request;
use super::wire::{Command, Feedback};

/// The motor starts; its current says nothing yet.
const START: Duration = Duration::from_millis(200);
/// Cycles in a row that show the stop.
const PRESSED: u8 = 5;
/// Without current at the stop.
const REST: Duration = Duration::from_millis(100);
/// Longest way to the stop: at 1 rad/s the longest joint needs 6 s.
const APPROACH_MAX: Duration = Duration::from_secs(15);

/// How a joint is homed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HomingConfig {
    /// Speed of the motor towards the stop, rpm.
    pub rpm: i32,
    /// Current at which it presses, mA.
    pub current_ma: i32,
}

impl HomingConfig {
    /// At this speed of the motor (rpm), up to this current (mA).
    #[must_use]
    pub const fn new(rpm: i32, current_ma: i32) -> Self {
        Self { rpm, current_ma }
    }
}

/// Where homing is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomingState {
    /// Not asked for.
    Idle,
    /// The drive is asked whether it was homed since power came on.
    Ask,
    /// Towards the stop, since then; pressing for so many cycles.
    Approach(Duration, u8),
    /// Without current, since then.
    Rest(Duration),
    /// The encoder is set to 0.
    Preset,
    /// The drive is told that it was homed.
    Mark,
    /// It is known where the joint is.
    Done,
    /// It was cancelled.
    Cancelled,
    /// It failed.
    Failed(HomingError),
}

/// Why homing failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HomingError {
    /// The stop did not come.
    #[error("no stop within 15 s; does the joint turn at all, is its stop there?")]
    NoStop,
    /// The drive refused.
    #[error("{0}")]
    Call(CallError),
}

/// Homing of a joint.
#[derive(Clone, Copy, Debug)]
pub struct Homing {
    config: HomingConfig,
    state: HomingState,
}

impl Homing {
    /// Not begun.
    #[must_use]
    pub const fn new(config: HomingConfig) -> Self {
        Self {
            config,
            state: HomingState::Idle,
        }
    }

    /// Where it is.
    #[must_use]
    pub const fn state(&self) -> HomingState {
        self.state
    }

    /// Whether it is known where the joint is.
    #[must_use]
    pub const fn is_done(&self) -> bool {
        matches!(self.state, HomingState::Done)
    }

    /// Whether it is under way.
    #[must_use]
    pub const fn is_active(&self) -> bool {
        match self.state {
            HomingState::Ask
            | HomingState::Approach(..)
            | HomingState::Rest(_)
            | HomingState::Preset
            | HomingState::Mark => true,
            HomingState::Idle
            | HomingState::Done
            | HomingState::Cancelled
            | HomingState::Failed(_) => false,
        }
    }

    #[cfg(test)]
    pub(super) const fn force(&mut self, state: HomingState) {
        self.state = state;
    }

    /// Begins, unless it is under way.
    pub const fn start(&mut self) {
        if !self.is_active() {
            self.state = HomingState::Ask;
        }
    }

    /// Ends it wherever it is; the joint holds.
    pub const fn cancel(&mut self) {
        if self.is_active() {
            self.state = HomingState::Cancelled;
        }
    }

    /// The drive was gone or without power: nothing is known any more.
    pub const fn forget(&mut self) {
        self.state = HomingState::Idle;
    }

    /// One cycle while the drive follows; gives what it is to do. `may_move` is asked before it sets out and all the
    /// way: without, it stays where it asks, or is cancelled.
    pub fn cycle(
        &mut self,
        told: &Feedback,
        mailbox: &mut Mailbox,
        may_move: bool,
        now: Duration,
    ) -> Option<Command> {
        match self.state {
            HomingState::Idle
            | HomingState::Done
            | HomingState::Cancelled
            | HomingState::Failed(_) => None,
            HomingState::Ask => {
                if let Some(homed) =
                    self.call(mailbox, Request::get_global(CALIBRATED.0, CALIBRATED.1))
                {
                    self.state = match (homed, may_move) {
                        (1, _) => HomingState::Done,
                        (_, true) => HomingState::Approach(now, 0),
                        (_, false) => HomingState::Ask,
                    };
                }
                Some(Command::HOLD)
            }
            HomingState::Approach(..) if !may_move => {
                self.state = HomingState::Cancelled;
                Some(Command::HOLD)
            }
            HomingState::Approach(since, pressed) => Some(self.approach(told, since, pressed, now)),
            HomingState::Rest(since) => {
                if now.saturating_sub(since) >= REST {
                    self.state = HomingState::Preset;
                }
                Some(Command::current(0))
            }
            HomingState::Preset => {
                if self
                    .call(mailbox, Request::set(ACTUAL_POSITION, 0))
                    .is_some()
                {
                    self.state = HomingState::Mark;
                }
                Some(Command::current(0))
            }
            HomingState::Mark => {
                let (bank, number) = CALIBRATED;
                if self
                    .call(mailbox, Request::set_global(bank, number, 1))
                    .is_some()
                {
                    self.state = HomingState::Done;
                }
                Some(Command::HOLD)
            }
        }
    }

    fn approach(
        &mut self,
        told: &Feedback,
        since: Duration,
        pressed: u8,
        now: Duration,
    ) -> Command {
        let spent = now.saturating_sub(since);
        let HomingConfig { rpm, current_ma } = self.config;
        // A motor that speeds up draws current too.
        let stands = told.velocity_rpm.saturating_abs() < rpm.saturating_abs() / 4;
        let presses = spent >= START && stands && told.current_ma.saturating_abs() > current_ma;
        let pressed = if presses { pressed + 1 } else { 0 };
        self.state = if pressed >= PRESSED {
            HomingState::Rest(now)
        } else if spent > APPROACH_MAX {
            HomingState::Failed(HomingError::NoStop)
        } else {
            HomingState::Approach(since, pressed)
        };
        match self.state {
            HomingState::Approach(..) => Command::velocity(rpm),
            HomingState::Rest(_) => Command::current(0),
            HomingState::Idle
            | HomingState::Ask
            | HomingState::Preset
            | HomingState::Mark
            | HomingState::Done
            | HomingState::Cancelled
            | HomingState::Failed(_) => Command::HOLD,
        }
    }

    fn call(&mut self, mailbox: &mut Mailbox, request: Request) -> Option<i32> {
        match mailbox.call(request)? {
            Ok(answer) => answer.value(),
            Err(error) => {
                self.state = HomingState::Failed(HomingError::Call(error));
                None
            }
        }
    }
}

//! Homing of one joint to its stop: moves until the motor presses against it, then sets the encoder to 0 there. It can
//! be cancelled in any state; motion must be permitted before it starts.
//!
//! ```text
//!         1 start        2 not homed           3 presses        4 100 ms          5            6
//! Idle ----------> Query -----------> Approach ---------> Rest ---------> Preset ---> Mark ---> Done
//!                   | 7 homed                                                                    ^
//!                   +----------------------------------------------------------------------------+
//! any of Query to Mark --8 cancel--> Cancelled        --9 too long, runaway, refused--> Failed(why)
//! ```
//! 1 in [`Homing::start`], 8 in [`Homing::cancel`], the others in [`Homing::cycle`]. [`Homing::lead`] runs it with the
//! drive of its joint.

use std::time::Duration;

use super::drive::Drive;
use super::mailbox::{CallError, Mailbox};
use super::parameters::{ACTUAL_POSITION, CALIBRATED};
use super::tmcl::Request;
use super::wire::{Command, Feedback, Flags};

/// The motor accelerates; its current is not significant yet.
const START: Duration = Duration::from_millis(200);
/// Consecutive cycles that detect the stop.
const PRESSED: u8 = 5;
/// Time without current at the stop.
const REST: Duration = Duration::from_millis(100);
/// Timeout of the motion to the stop: at 1 rad/s the longest joint needs 6 s.
const APPROACH_MAX: Duration = Duration::from_secs(15);
/// A motor faster than its command by this factor and [`RUNAWAY_RPM`], or half as fast backwards, runs away; gravity
/// and overshoot are slower.
const RUNAWAY_FACTOR: i32 = 2;
/// Tolerated error of a measured speed, rpm.
const RUNAWAY_RPM: i32 = 50;
/// Consecutive cycles that detect a runaway.
const RUNAWAY_CYCLES: u8 = 5;
/// A motor that turned less than a tenth of a turn did not move, ticks: gears and stops yield so much.
const MOVED_FROM: u32 = 400;

/// Homing configuration of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HomingConfig {
    /// Speed of the motor towards the stop, rpm.
    pub rpm: i32,
    /// Current at which it presses, mA.
    pub current_ma: i32,
}

impl HomingConfig {
    /// With this motor speed (rpm), up to this current (mA).
    pub const fn new(rpm: i32, current_ma: i32) -> Self {
        Self { rpm, current_ma }
    }
}

/// State of homing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomingState {
    /// Not started.
    Idle,
    /// Queries whether the drive was homed since power-on.
    Query,
    /// Moving towards the stop, since this time; pressing for a number of cycles.
    Approach(Duration, u8),
    /// Without current, since this time.
    Rest(Duration),
    /// The encoder is set to 0.
    Preset,
    /// The drive is marked as homed.
    Mark,
    /// The position of the joint is known.
    Done,
    /// It was cancelled.
    Cancelled,
    /// It failed.
    Failed(HomingError),
}

/// Why homing failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HomingError {
    /// The stop was not reached.
    #[error("no stop within 15 s; does the joint turn at all, is its stop there?")]
    NoStop,
    /// The motor does not turn as commanded; it has no current.
    #[error(
        "its motor turns with {rpm} rpm, {commanded} rpm were commanded; its current was taken\nhint: check the encoder, \
         its direction and the commutation of the drive, then power-cycle it"
    )]
    Runaway {
        /// Measured speed, rpm.
        rpm: i32,
        /// Commanded speed, rpm.
        commanded: i32,
    },
    /// The drive refused.
    #[error("{0}")]
    Call(CallError),
}

/// Homing of a joint.
#[derive(Clone, Copy, Debug)]
pub struct Homing {
    config: HomingConfig,
    state: HomingState,
    /// Position at the start of the approach, ticks; `None` before it.
    start: Option<i32>,
    /// Largest distance from there, ticks.
    travel: u32,
    /// Consecutive cycles in which the motor did not turn as commanded.
    runaway: u8,
}

impl Homing {
    /// Not begun.
    pub const fn new(config: HomingConfig) -> Self {
        Self {
            config,
            state: HomingState::Idle,
            start: None,
            travel: 0,
            runaway: 0,
        }
    }

    /// Its state.
    pub const fn state(&self) -> HomingState {
        self.state
    }

    /// Whether the position of the joint is known.
    pub const fn is_done(&self) -> bool {
        matches!(self.state, HomingState::Done)
    }

    /// Whether it is running.
    pub const fn is_active(&self) -> bool {
        match self.state {
            HomingState::Query
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

    /// Whether the motor turned towards the stop; `None` if it was not commanded to, because the joint was homed before.
    #[must_use]
    pub fn has_moved(&self) -> Option<bool> {
        self.start.map(|_| self.travel >= MOVED_FROM)
    }

    #[cfg(test)]
    pub(super) const fn force(&mut self, state: HomingState) {
        self.state = state;
    }

    /// Starts, unless it is running.
    pub const fn start(&mut self) {
        if !self.is_active() {
            *self = Self::new(self.config);
            self.state = HomingState::Query;
        }
    }

    /// Cancels it in any state; the joint holds.
    pub const fn cancel(&mut self) {
        if self.is_active() {
            self.state = HomingState::Cancelled;
        }
    }

    /// The drive was offline or without power: its position is unknown.
    pub const fn forget(&mut self) {
        self.state = HomingState::Idle;
    }

    /// One cycle with the drive of its joint; returns the command for the drive, if any. It starts by itself once the
    /// joint `follows`, and again after the drive lost its position. `may_move` as in [`Self::cycle`]; `stopping`
    /// cancels it.
    pub fn lead(
        &mut self,
        drive: &mut Drive,
        follows: bool,
        may_move: bool,
        stopping: bool,
        now: Duration,
    ) -> Option<Command> {
        let feedback = drive.feedback().copied();
        // A drive that lost power lost its position; one that was only offline still reports it.
        let knows = feedback.is_some_and(|feedback| feedback.flags.any(Flags::INITIALIZED));
        if !knows || (self.is_active() && !follows) {
            self.forget();
        }
        if stopping {
            self.cancel();
        }
        if !follows || stopping {
            return None;
        }
        if self.state == HomingState::Idle {
            self.start();
        }
        self.cycle(&feedback?, drive.mailbox(), may_move, now)
    }

    /// One cycle while the drive follows; returns the command. `may_move` is required before and during motion: without
    /// it, homing stays in Query or is cancelled.
    pub fn cycle(
        &mut self,
        feedback: &Feedback,
        mailbox: &mut Mailbox,
        may_move: bool,
        now: Duration,
    ) -> Option<Command> {
        match self.state {
            // Without current: the motor does not even hold as commanded.
            HomingState::Failed(HomingError::Runaway { .. }) => Some(Command::current(0)),
            HomingState::Idle
            | HomingState::Done
            | HomingState::Cancelled
            | HomingState::Failed(HomingError::NoStop | HomingError::Call(_)) => None,
            HomingState::Query => {
                if let Some(homed) =
                    self.call(mailbox, Request::get_global(CALIBRATED.0, CALIBRATED.1))
                {
                    self.state = match (homed, may_move) {
                        (1, _) => HomingState::Done,
                        (_, true) => HomingState::Approach(now, 0),
                        (_, false) => HomingState::Query,
                    };
                }
                Some(Command::HOLD)
            }
            HomingState::Approach(..) if !may_move => {
                self.state = HomingState::Cancelled;
                Some(Command::HOLD)
            }
            HomingState::Approach(since, pressed) => {
                Some(self.approach(feedback, since, pressed, now))
            }
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
        feedback: &Feedback,
        since: Duration,
        pressed: u8,
        now: Duration,
    ) -> Command {
        let spent = now.saturating_sub(since);
        let HomingConfig { rpm, current_ma } = self.config;
        // An accelerating motor draws current too.
        let stopped = feedback.velocity_rpm.saturating_abs() < rpm.saturating_abs() / 4;
        let presses =
            spent >= START && stopped && feedback.current_ma.saturating_abs() > current_ma;
        let pressed = if presses { pressed + 1 } else { 0 };
        let start = *self.start.get_or_insert(feedback.position);
        self.travel = self.travel.max(feedback.position.abs_diff(start));
        let turned = feedback.velocity_rpm;
        let runs_away = spent >= START && runs_away(turned, rpm);
        self.runaway = if runs_away { self.runaway + 1 } else { 0 };
        self.state = if self.runaway >= RUNAWAY_CYCLES {
            HomingState::Failed(HomingError::Runaway {
                rpm: turned,
                commanded: rpm,
            })
        } else if pressed >= PRESSED {
            HomingState::Rest(now)
        } else if spent > APPROACH_MAX {
            HomingState::Failed(HomingError::NoStop)
        } else {
            HomingState::Approach(since, pressed)
        };
        match self.state {
            HomingState::Approach(..) => Command::velocity(rpm),
            HomingState::Rest(_) | HomingState::Failed(HomingError::Runaway { .. }) => {
                Command::current(0)
            }
            HomingState::Idle
            | HomingState::Query
            | HomingState::Preset
            | HomingState::Mark
            | HomingState::Done
            | HomingState::Cancelled
            | HomingState::Failed(HomingError::NoStop | HomingError::Call(_)) => Command::HOLD,
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

/// Whether a motor turns too fast, or backwards, for its command; all in rpm.
const fn runs_away(turned: i32, commanded: i32) -> bool {
    let along = turned.saturating_mul(commanded.signum());
    let most = commanded.saturating_abs() * RUNAWAY_FACTOR + RUNAWAY_RPM;
    along > most || along < -most / 4
}

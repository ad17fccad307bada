//! The PC's side of one FRI connection: handles measurements, builds answers. It moves no bytes and plans no motion: the
//! owner decides how commanded values change from cycle to cycle.

use super::wire::{Cmd, CmdFlags, Header, Krl, Msr, Quality, State};
use super::{AXES, AnswerError, JOINT_NAMES};
use crate::counters::Counters;
use crate::error::DecodeError;
use crate::generation::Kind;
use crate::guard::{Guard, Guarded, Violation};
use crate::sequence::{Order, Tracker};
use std::fmt;
use std::time::Duration;

mod fields;
#[cfg(test)]
mod tests;

pub use fields::{ChooseError, Fields};

/// Periods that friOpen accepts, seconds; a corrupt period on the wire must not distort the receive timeout.
const PERIOD_RANGE_S: std::ops::RangeInclusive<f32> = 0.001..=0.1;

/// Settings of a [`Session`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SessionConfig {
    /// Number of periods without a datagram after which the controller is offline, from 1. Counter jumps up to this
    /// width are loss or reordering, wider ones a restart of the controller.
    pub offline_after: u16,
    /// Counter of the first answer.
    pub first_sequence: u16,
    /// Limits of answers in command mode.
    pub guard: Guard,
}

impl Default for SessionConfig {
    fn default() -> Self {
        Self {
            offline_after: 50,
            first_sequence: 1,
            guard: Guard::open(JOINT_NAMES),
        }
    }
}

/// Phase of the connection, as the client sees it.
///
/// ```text
///            (1) new datagram, not commanding          (2) new datagram in CMD with power
///  Offline ────────────────────────────────▶ Monitor ─────────────────────────────▶ Command
///     ▲ ▲                                     │    ▲                                  │ │
///     │ └──(4) silence ───────────────────────┘    └──(3) MON, or power 0 ────────────┘ │
///     └────(4) silence ─────────────────────────────────────────────────────────────────┘
/// ```
/// [`Session::handle_datagram`] makes transitions 1 to 3 (Offline to Command directly if the first datagram reports so),
/// [`Session::handle_timeout`] makes transition 4. A controller that restarted in command mode is entered as one that
/// was offline.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// No datagram for [`SessionConfig::offline_after`] periods, or none yet.
    Offline,
    /// Measurements flow; the robot does not follow, answers mirror the controller's set-point.
    Monitor,
    /// The robot follows our answers.
    Command,
}

/// A change of [`Phase`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// The first datagram after silence, not in command mode.
    Online,
    /// The robot follows from now on; start from [`Session::mirror`].
    CommandEntered,
    /// The robot no longer follows: the controller left command mode, or its drives lost power.
    CommandLeft,
}

/// Result of one datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reception {
    /// Order in the controller's sequence; if not [`Order::is_new`], the datagram was ignored.
    pub order: Order,
    /// Reported state.
    pub state: State,
    /// Reported quality.
    pub quality: Quality,
    /// Drives with power, one bit each.
    pub power: u16,
    /// Number of measurements lost since the previous one.
    pub lost: u16,
    /// Resulting change of phase.
    pub event: Option<Event>,
}

/// One FRI connection, client side.
///
/// Per cycle: [`handle_datagram`](Self::handle_datagram), then [`answer`](Self::answer), then send the bytes. If several
/// datagrams wait in the socket, handle all and answer once: an answer to a stale measurement is late anyway, and a
/// client that answers each one stays behind for ever.
///
/// While the robot does not follow, every answer mirrors the controller's own set-point (`cmdJntPos +
/// cmdJntPosFriOffset`), whatever the caller passes: with another value the controller reports an interpolation error
/// and brakes. See [`Phase`] for the state machine.
#[derive(Debug, Clone)]
pub struct Session {
    config: SessionConfig,
    phase: Phase,
    tracker: Tracker,
    msr: Option<Msr>,
    received_at: Duration,
    pending: bool,
    next_sequence: u16,
    held: [f64; AXES],
    /// Number of the measurement answered last in this phase.
    answered: Option<u16>,
    chosen: CmdFlags,
    fields: Fields,
    violation: Option<Violation>,
    krl: Krl,
    counters: Counters,
}

impl Session {
    /// A session that has received nothing yet.
    pub fn new(config: SessionConfig) -> Self {
        Self {
            phase: Phase::Offline,
            tracker: Tracker::new(config.offline_after.max(1)),
            msr: None,
            received_at: Duration::ZERO,
            pending: false,
            next_sequence: config.first_sequence,
            held: [0.0; AXES],
            answered: None,
            chosen: CmdFlags::JNTPOS,
            fields: Fields::default(),
            violation: None,
            krl: Krl::default(),
            counters: Counters::default(),
            config,
        }
    }

    /// Handles a received datagram; `now` is its time of arrival. Duplicates and old ones are only counted.
    pub fn handle_datagram(
        &mut self,
        bytes: &[u8],
        now: Duration,
    ) -> Result<Reception, DecodeError> {
        let msr = Msr::decode(bytes)
            .map_err(|error| Kind::explain(Kind::LwrMeasurement, bytes, error))
            .inspect_err(|_| self.counters.refused += 1)?;
        self.handle_timeout(now);
        let order = self.tracker.accept(msr.header.sequence);
        let lost = self.count(order);
        if order == Order::Restart && msr.is_commanding() {
            // A restarted controller has lost all earlier commands: it is entered again.
            self.phase = Phase::Offline;
        }
        let event = if order.is_new() {
            self.accept(&msr, now)
        } else {
            None
        };
        Ok(Reception {
            order,
            state: msr.interface.state,
            quality: msr.interface.quality,
            power: msr.robot.power,
            lost,
            event,
        })
    }

    fn count(&mut self, order: Order) -> u16 {
        match order {
            Order::First => {}
            Order::Next { lost } => {
                self.counters.lost += u64::from(lost);
                self.counters.received += 1;
                return lost;
            }
            Order::Restart => self.counters.restarts += 1,
            Order::Duplicate | Order::Old => {
                self.counters.old += 1;
                return 0;
            }
        }
        self.counters.received += 1;
        0
    }

    fn accept(&mut self, msr: &Msr, now: Duration) -> Option<Event> {
        let before = self.phase;
        self.phase = if msr.is_commanding() {
            Phase::Command
        } else {
            Phase::Monitor
        };
        self.msr = Some(*msr);
        self.received_at = now;
        self.pending = true;
        let event = match (before, self.phase) {
            (Phase::Offline, Phase::Monitor) => Some(Event::Online),
            (Phase::Offline | Phase::Monitor, Phase::Command) => Some(Event::CommandEntered),
            (Phase::Command, Phase::Monitor) => Some(Event::CommandLeft),
            (_, Phase::Offline)
            | (Phase::Monitor, Phase::Monitor)
            | (Phase::Command, Phase::Command) => None,
        };
        if self.phase != Phase::Command || event.is_some() {
            self.held = msr.set_point();
            self.answered = None;
        }
        event
    }

    /// Builds the answer to the last measurement at the front of `buf` and returns its length.
    ///
    /// `joints` in rad are used in [`Phase::Command`] only; `None` repeats the last command there, which stops a moving
    /// robot at once, so brake first. Every measurement gets one answer: a second call before the next measurement
    /// returns [`AnswerError::NothingToAnswer`].
    /// If the guard rejects the command, the answer holds the robot, and [`violation`](Self::violation) gives the reason.
    pub fn answer(
        &mut self,
        joints: Option<&[f64; AXES]>,
        buf: &mut [u8],
    ) -> Result<usize, AnswerError> {
        let wanted = joints.filter(|_| self.phase == Phase::Command);
        if let Some(joint) = wanted.and_then(|it| it.iter().position(|value| !value.is_finite())) {
            return Err(AnswerError::NotFinite { joint });
        }
        let answer = self.answer_or_brake(joints, |_| None, buf)?;
        Ok(answer.len)
    }

    /// As [`answer`](Self::answer), but if the guard rejects the positions, `brake` is asked for others, which the guard
    /// checks in turn. The robot is held only if it rejects those too.
    pub fn answer_or_brake(
        &mut self,
        joints: Option<&[f64; AXES]>,
        brake: impl FnOnce(Violation) -> Option<[f64; AXES]>,
        buf: &mut [u8],
    ) -> Result<Guarded, AnswerError> {
        let msr = self
            .msr
            .as_ref()
            .filter(|_| self.pending)
            .ok_or(AnswerError::NothingToAnswer)?;
        let wanted = joints
            .filter(|_| self.phase == Phase::Command)
            .unwrap_or(&self.held);
        let refused = self.check_joints(wanted).err();
        let sent = match refused {
            None => Some(*wanted),
            Some(violation) => brake(violation).filter(|it| self.check_joints(it).is_ok()),
        };
        let is_held = sent.is_none();
        let sent = sent.unwrap_or(self.held);
        let mut cmd = Cmd {
            header: Header {
                sequence: self.next_sequence,
                reflected: msr.header.sequence,
            },
            krl: self.krl,
            joints: sent.map(to_f32),
            ..Cmd::default()
        };
        let added = self.fill(&mut cmd, msr);
        let violation = refused.filter(|_| is_held).or(added);
        let len = cmd.encode(buf)?;
        self.answered = Some(msr.header.sequence);
        self.held = sent;
        self.pending = false;
        self.next_sequence = self.next_sequence.wrapping_add(1);
        self.counters.answered += 1;
        self.counters.withheld += u64::from(violation.is_some());
        self.violation = violation;
        Ok(Guarded {
            len,
            refused,
            is_held,
        })
    }

    /// Checks positions, rad, against the guard. The reference is the last command and the controller's cycle count since.
    fn check_joints(&self, wanted: &[f64; AXES]) -> Result<(), Violation> {
        let commanding = self.msr.as_ref().filter(|_| self.phase == Phase::Command);
        let Some(msr) = commanding else {
            return Ok(());
        };
        let sequence = msr.header.sequence;
        let cycles = self.answered.map_or(1, |last| sequence.wrapping_sub(last));
        let cycles = cycles.clamp(1, self.config.offline_after.max(1));
        let span = self.period().unwrap_or_default() * u32::from(cycles);
        self.config.guard.check_joints(&self.held, wanted, span)
    }

    /// Why the last answer held the robot or added nothing; `None` if it carried the command.
    pub fn violation(&self) -> Option<Violation> {
        self.violation
    }

    /// Time at which the controller becomes offline if no datagram arrives; `None` while it is offline.
    pub fn poll_timeout(&self) -> Option<Duration> {
        if self.phase == Phase::Offline {
            return None;
        }
        Some(self.received_at + self.period()? * u32::from(self.config.offline_after.max(1)))
    }

    /// Checks the receive timeout at `now`; returns whether the controller has just become offline.
    pub fn handle_timeout(&mut self, now: Duration) -> bool {
        let is_lost = self.poll_timeout().is_some_and(|at| now >= at);
        if is_lost {
            self.phase = Phase::Offline;
            self.pending = false;
            self.tracker.forget();
            self.counters.silences += 1;
        }
        is_lost
    }

    /// The newest measurement; kept while the controller is offline.
    pub fn measurement(&self) -> Option<&Msr> {
        self.msr.as_ref()
    }

    /// Time of arrival of the newest measurement.
    pub fn arrival(&self) -> Option<Duration> {
        self.msr.as_ref().map(|_| self.received_at)
    }

    /// Period of measurements as the controller states it, 1 ms to 100 ms; `None` before the first one.
    pub fn period(&self) -> Option<Duration> {
        self.msr.as_ref().map(stated_period)
    }

    /// Phase of the connection.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Whether the robot follows: command mode, drives with power, and measurements flowing.
    pub fn is_commanding(&self) -> bool {
        self.phase == Phase::Command
    }

    /// Whether an answer is due.
    pub fn is_pending(&self) -> bool {
        self.pending
    }

    /// Joint positions, rad, that the next answer may carry without a jump: the last commanded ones in
    /// [`Phase::Command`], else the controller's set-point. Zeros before the first measurement.
    pub fn mirror(&self) -> [f64; AXES] {
        self.held
    }

    /// User data sent with every answer; it stays until changed. What the KRL program sends is in [`Msr::krl`].
    pub fn krl_mut(&mut self) -> &mut Krl {
        &mut self.krl
    }

    /// Counter of the last answer; before the first one, its predecessor.
    pub fn sent_sequence(&self) -> u16 {
        self.next_sequence.wrapping_sub(1)
    }

    /// Totals since the session was created.
    pub fn counters(&self) -> Counters {
        self.counters
    }
}

/// Measurement period that `msr` states, clamped to 1 ms to 100 ms.
pub(crate) fn stated_period(msr: &Msr) -> Duration {
    let (shortest, longest) = (*PERIOD_RANGE_S.start(), *PERIOD_RANGE_S.end());
    // `max` first: it also replaces NaN.
    let seconds = msr.interface.msr_period_s.max(shortest).min(longest);
    Duration::from_secs_f32(seconds)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "the wire has single precision: 1e-7 rad at pi"
)]
fn to_f32(value: f64) -> f32 {
    value as f32
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Offline => "offline",
            Self::Monitor => "monitor",
            Self::Command => "command",
        })
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Online => "measurements flow",
            Self::CommandEntered => "command mode entered",
            Self::CommandLeft => "command mode left",
        })
    }
}

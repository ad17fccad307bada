//! The client's side of one FRI connection to Sunrise: handles monitoring messages, builds answers. It moves no bytes
//! and plans no motion: the owner decides how commanded values change from cycle to cycle.

use super::wire::{
    Command, CommandData, CommandMode, Dialect, Header, IOS_MAX, IoValue, Joints, List, Monitoring,
    Quality, SessionState, TRANSFORMATIONS_MAX, Transformation, unframe,
};
use super::{AXES, JOINT_NAMES};
use crate::counters::Counters;
use crate::error::{AnswerError, DecodeError};
use crate::generation::Kind;
use crate::guard::{Guard, Violation};
use crate::sequence::{Order, Tracker};
use std::time::Duration;

mod demand;
mod exchange;
mod phase;
#[cfg(test)]
mod tests;

pub use demand::{Demand, Withheld};
pub use exchange::{FrameError, IoError, IoLevel};
pub use phase::{Event, Phase};

/// Allowed sendPeriod, ms; a corrupt one on the wire must not distort the receive timeout.
pub(crate) const PERIOD_MS: std::ops::RangeInclusive<u32> = 1..=100;

/// Settings of a [`Session`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SessionConfig {
    /// Dialect of the controller; `None` detects it.
    pub dialect: Option<Dialect>,
    /// Number of periods without a datagram after which the controller is offline, from 1. Counter jumps up to this
    /// width are loss or reordering, wider ones a restart of the controller.
    pub offline_after: u16,
    /// Limits of answers.
    pub guard: Guard,
    /// Share of the distance to the measured positions, 0..=1, by which the impedance centre follows per answer when
    /// torques are commanded without joint positions.
    ///
    /// Positions far from the measured ones are an illegal axis delta to the controller; the measured ones themselves
    /// disable its friction observer. A delayed copy is neither.
    pub torque_follow: f64,
}

impl Default for SessionConfig {
    fn default() -> Self {
        Self {
            dialect: None,
            offline_after: 50,
            guard: Guard::open(JOINT_NAMES),
            torque_follow: 0.1,
        }
    }
}

/// Result of one datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reception {
    /// Order in the controller's sequence; if not [`Order::is_new`], the datagram was ignored.
    pub order: Order,
    /// Reported state.
    pub state: SessionState,
    /// Reported quality.
    pub quality: Quality,
    /// Number of messages lost since the previous one.
    pub lost: u16,
    /// Whether an answer is due now.
    pub is_due: bool,
    /// Resulting change of phase.
    pub event: Option<Event>,
}

/// An answer that was built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// Bytes to send.
    pub len: usize,
    /// Why the guard rejected the positions that were asked for, if so.
    pub refused: Option<Violation>,
    /// Why the answer does not carry the demand, if so.
    pub withheld: Option<Withheld>,
}

/// One FRI connection to a Sunrise controller, client side.
///
/// Per cycle: [`handle_datagram`](Self::handle_datagram), then, if [`is_pending`](Self::is_pending),
/// [`answer`](Self::answer), then send the bytes. If several datagrams wait in the socket, handle all and answer once.
///
/// * Outside the COMMANDING states an answer commands nothing: commandedJointPosition mirrored (1.x), or empty (2.x).
/// * In COMMANDING_WAIT it mirrors the interpolator, with a zero wrench or torque where the overlay expects one.
/// * In COMMANDING_ACTIVE it carries the demand, after [`engage`](Self::engage); until then it mirrors the interpolator.
///   A motion that was interrupted by a return to monitoring therefore does not resume by itself.
/// * A demand that cannot be executed is [`Withheld`], and the answer holds the robot: a missing answer would cost quality.
///
/// See [`Phase`] for the state machine.
#[derive(Debug, Clone)]
pub struct Session {
    config: SessionConfig,
    phase: Phase,
    dialect: Option<Dialect>,
    tracker: Tracker,
    message: Monitoring,
    received_at: Option<Duration>,
    is_pending: bool,
    is_engaged: bool,
    /// Whether the overlay was already active in the first message.
    has_joined: bool,
    next_sequence: u32,
    /// Sequence number of the message answered last.
    answered: Option<u32>,
    held: Joints,
    outputs: List<IoValue, IOS_MAX>,
    frames: List<Transformation, TRANSFORMATIONS_MAX>,
    counters: Counters,
}

impl Session {
    /// A session that has received nothing yet.
    pub fn new(config: SessionConfig) -> Self {
        Self {
            phase: Phase::Offline,
            dialect: None,
            tracker: Tracker::wide(config.offline_after.max(1)),
            message: Monitoring::default(),
            received_at: None,
            is_pending: false,
            is_engaged: false,
            has_joined: false,
            next_sequence: 0,
            answered: None,
            held: [0.0; AXES],
            outputs: List::new(),
            frames: List::new(),
            counters: Counters::default(),
            config,
        }
    }

    /// Handles a received datagram; `now` is its time of arrival. Duplicates and old ones are only counted.
    pub fn handle_datagram(
        &mut self,
        datagram: &[u8],
        now: Duration,
    ) -> Result<Reception, DecodeError> {
        let (is_framed, message) = self
            .decode(datagram)
            .inspect_err(|_| self.counters.refused += 1)?;
        self.handle_timeout(now);
        let order = self.tracker.accept(message.header.sequence);
        let lost = self.count(order);
        if order == Order::Restart && Phase::from(message.state()).is_commanding() {
            // A restarted controller has lost all earlier commands: it is entered again.
            self.phase = Phase::Offline;
            self.is_engaged = false;
        }
        let event = if order.is_new() {
            self.note_dialect(order, is_framed, &message);
            self.accept(message, now)
        } else {
            None
        };
        Ok(Reception {
            order,
            state: message.state(),
            quality: message.quality(),
            lost,
            is_due: order.is_new() && self.is_pending,
            event,
        })
    }

    fn decode(&self, datagram: &[u8]) -> Result<(bool, Monitoring), DecodeError> {
        let decoded = unframe(datagram)
            .and_then(|(is_framed, message)| Ok((is_framed, Monitoring::decode(message)?)));
        let (is_framed, message) = decoded.map_err(|error| {
            let is_framed = self.config.dialect.is_some_and(Dialect::is_framed);
            Kind::explain(Kind::SunriseMonitoring { is_framed }, datagram, error)
        })?;
        let detected = Dialect::of(is_framed, &message);
        match (self.config.dialect, detected) {
            (Some(expected), Some(actual)) if expected != actual => {
                Err(DecodeError::Dialect { expected, actual })
            }
            _ => Ok((is_framed, message)),
        }
    }

    fn count(&mut self, order: Order) -> u16 {
        let lost = match order {
            Order::First => 0,
            Order::Next { lost } => lost,
            Order::Restart => {
                self.counters.restarts += 1;
                0
            }
            Order::Duplicate | Order::Old => {
                self.counters.old += 1;
                return 0;
            }
        };
        self.counters.lost += u64::from(lost);
        self.counters.received += 1;
        lost
    }

    fn note_dialect(&mut self, order: Order, is_framed: bool, message: &Monitoring) {
        if matches!(order, Order::First | Order::Restart) {
            // The software of a restarted controller may have another version.
            self.dialect = self.config.dialect;
            self.answered = None;
        }
        self.dialect = Dialect::of(is_framed, message).or(self.dialect);
    }

    fn accept(&mut self, message: Monitoring, now: Duration) -> Option<Event> {
        let from = self.phase;
        self.phase = message.state().into();
        if self.is_pending {
            self.counters.skipped += 1;
        }
        self.message = message;
        self.received_at = Some(now);
        self.is_pending = self.phase != Phase::Idle && self.is_due();
        let is_active = self.phase == Phase::CommandingActive;
        self.has_joined = is_active && (self.has_joined || from == Phase::Offline);
        self.is_engaged &= is_active;
        if !self.is_engaged {
            self.held = self.reference();
        }
        from.event(self.phase)
    }

    /// Every `receiveMultiplier`-th message is due for an answer, by the controller's counter, so that loss does not
    /// shift the phase.
    fn is_due(&self) -> bool {
        let connection = self.message.connection;
        let times = connection.and_then(|it| it.receive_multiplier).unwrap_or(1);
        let sequence = self.message.header.sequence;
        self.answered
            .is_none_or(|last| sequence.wrapping_sub(last) >= times)
    }

    /// The controller's own set-point: the interpolator's position, else the commanded (1.x), else the measured one. If
    /// the overlay was already active when this session began, another client may have moved the arm away from the
    /// interpolator's position, which then would be a jump.
    fn reference(&self) -> Joints {
        let ipo = self.message.ipo.and_then(|ipo| ipo.joints);
        let commanded = self.message.monitor.and_then(|data| data.commanded);
        let interpolated = ipo.filter(|_| self.phase.is_commanding() && !self.has_joined);
        interpolated
            .or(commanded)
            .or_else(|| self.message.measured())
            .unwrap_or(self.held)
    }

    /// Enables demands from now on; they start at [`mirror`](Self::mirror). Refused unless the overlay is active.
    pub fn engage(&mut self) -> Result<(), Withheld> {
        if self.phase != Phase::CommandingActive {
            return Err(Withheld::NotCommanding { phase: self.phase });
        }
        self.is_engaged = true;
        Ok(())
    }

    /// Mirrors the interpolator again until the next [`engage`](Self::engage). The robot moves there as fast as the
    /// controller allows, so bring it back first.
    pub fn disengage(&mut self) {
        self.is_engaged = false;
    }

    /// Builds the answer to the last message at the front of `buf`. Every message gets one answer: a second call before
    /// the next message returns [`AnswerError::NothingToAnswer`].
    pub fn answer(&mut self, demand: &Demand, buf: &mut [u8]) -> Result<Answer, AnswerError> {
        self.answer_or_brake(demand, |_| None, buf)
    }

    /// As [`answer`](Self::answer), but if the guard rejects the positions of the demand, `brake` is asked for others, which
    /// the guard checks in turn. The robot is held only if it rejects those too.
    pub fn answer_or_brake(
        &mut self,
        demand: &Demand,
        brake: impl FnOnce(Violation) -> Option<Joints>,
        buf: &mut [u8],
    ) -> Result<Answer, AnswerError> {
        if !self.is_pending {
            return Err(AnswerError::NothingToAnswer);
        }
        let mut checked = self.check_joints(demand);
        let refused = checked.err();
        let braked = refused.and_then(brake);
        let demand = &braked.map_or(*demand, |joints| demand.with_joints(joints));
        if braked.is_some() {
            checked = self.check_joints(demand);
        }
        let withheld = self.admit(demand, checked).err();
        let demand = if withheld.is_none() {
            demand
        } else {
            &Demand::Hold
        };
        let held = self.next_held(demand);
        let reflected = self.message.header.sequence;
        let command = Command {
            header: Header {
                sequence: self.next_sequence,
                reflected,
            },
            data: self.data(demand, held),
            end: None,
        };
        let dialect = self.dialect.unwrap_or(Dialect::V1);
        let len = dialect.frame(buf, |buf| command.encode(buf))?;
        self.held = held;
        self.is_pending = false;
        self.answered = Some(reflected);
        self.next_sequence = self.next_sequence.wrapping_add(1);
        self.counters.answered += 1;
        self.counters.withheld += u64::from(withheld.is_some());
        Ok(Answer {
            len,
            refused,
            withheld,
        })
    }

    fn next_held(&self, demand: &Demand) -> Joints {
        if let Some(joints) = demand.joints() {
            return *joints;
        }
        let measured = self.message.measured();
        let follows = self.is_engaged && self.command_mode() == CommandMode::Torque;
        let mut held = self.held;
        for (held, measured) in held
            .iter_mut()
            .zip(measured.filter(|_| follows).iter().flatten())
        {
            *held += (measured - *held) * self.config.torque_follow.clamp(0.0, 1.0);
        }
        held
    }

    fn data(&self, demand: &Demand, held: Joints) -> Option<CommandData> {
        let mut data = CommandData::default();
        self.exchange(&mut data);
        if self.phase.is_commanding() {
            self.command(demand, held, &mut data);
        } else if self.dialect == Some(Dialect::V1) {
            data.joints = Some(held);
        }
        (data != CommandData::default()).then_some(data)
    }

    fn command(&self, demand: &Demand, held: Joints, data: &mut CommandData) {
        match self.command_mode() {
            CommandMode::Position | CommandMode::None | CommandMode::Other(_) => {
                data.joints = Some(held);
            }
            CommandMode::Wrench => {
                data.joints = Some(held);
                data.wrench = Some([0.0; 6]);
            }
            CommandMode::Torque => {
                data.joints = Some(held);
                data.torque = Some([0.0; AXES]);
            }
            CommandMode::CartesianPose => self.mirror_pose(data),
        }
        match demand {
            Demand::Hold | Demand::Position(_) => {}
            Demand::Wrench { wrench, .. } => data.wrench = Some(*wrench),
            Demand::Torque { torque, .. } => data.torque = Some(*torque),
            Demand::Pose { pose, redundancy } => {
                let placement = Some(super::wire::Placement::Quaternion(*pose));
                data.pose = data.pose.map(|mirrored| Transformation {
                    placement,
                    stamp: None,
                    ..mirrored
                });
                data.redundancy = *redundancy;
            }
        }
    }

    fn mirror_pose(&self, data: &mut CommandData) {
        let measured = self.message.monitor.and_then(|data| data.pose);
        let ipo = self.message.ipo;
        let pose = ipo.and_then(|ipo| ipo.pose).or(measured);
        data.pose = Some(Transformation {
            stamp: None,
            ..pose.unwrap_or_default()
        });
        data.redundancy = ipo.and_then(|ipo| ipo.redundancy);
    }

    /// Time at which the controller becomes offline if no datagram arrives; `None` while it is offline.
    pub fn poll_timeout(&self) -> Option<Duration> {
        if self.phase == Phase::Offline {
            return None;
        }
        Some(self.received_at? + self.period()? * u32::from(self.config.offline_after.max(1)))
    }

    /// Checks the receive timeout at `now`; returns whether the controller has just become offline.
    pub fn handle_timeout(&mut self, now: Duration) -> bool {
        let is_lost = self.poll_timeout().is_some_and(|at| now >= at);
        if is_lost {
            self.phase = Phase::Offline;
            self.is_pending = false;
            self.is_engaged = false;
            self.answered = None;
            self.tracker.forget();
            self.counters.silences += 1;
        }
        is_lost
    }

    /// The newest message; kept while the controller is offline. `None` before the first one.
    pub fn message(&self) -> Option<&Monitoring> {
        self.received_at.map(|_| &self.message)
    }

    /// Time of arrival of the newest message.
    pub fn arrival(&self) -> Option<Duration> {
        self.received_at
    }

    /// Period of messages as the controller states it, 1 ms to 100 ms; `None` before the first one. Answers are due every
    /// `receiveMultiplier`-th time.
    pub fn period(&self) -> Option<Duration> {
        self.received_at?;
        let connection = self.message.connection;
        let stated = connection
            .and_then(|it| it.send_period_ms)
            .unwrap_or(*PERIOD_MS.end());
        let ms = stated.clamp(*PERIOD_MS.start(), *PERIOD_MS.end());
        Some(Duration::from_millis(ms.into()))
    }

    /// Dialect of the controller, once known.
    pub fn dialect(&self) -> Option<Dialect> {
        self.dialect
    }

    /// Phase of the connection.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Values that the overlay of the robot program expects.
    pub fn command_mode(&self) -> CommandMode {
        self.message.command_mode()
    }

    /// Whether the robot follows demands: COMMANDING_ACTIVE and engaged.
    pub fn is_engaged(&self) -> bool {
        self.is_engaged
    }

    /// Whether an answer is due.
    pub fn is_pending(&self) -> bool {
        self.is_pending
    }

    /// Joint positions, rad, that the next answer may carry without a jump: the last commanded ones when engaged, else the
    /// interpolator's. Zeros before the first message.
    pub fn mirror(&self) -> Joints {
        self.held
    }

    /// Counter of the last answer; before the first one, its predecessor.
    pub fn sent_sequence(&self) -> u32 {
        self.next_sequence.wrapping_sub(1)
    }

    /// Totals since the session was created.
    pub fn counters(&self) -> Counters {
        self.counters
    }
}

//! The emulated cabinet as a state machine without I/O: sends a monitoring message per period, checks the answers, moves
//! the arm.

use super::config::{CabinetConfig, Control, Faults, Overlay};
use super::exit::ExitReason;
use crate::emulator::{
    Arm, Body, Contact, ControllerCounters, Grid, History, Law, Line, Sensor, Sent, Surroundings,
    Window,
};
use crate::error::DecodeError;
use crate::generation::Kind;
use crate::sequence::{Order, Tracker};
use crate::sunrise::wire::{
    Command, CommandMode, Dialect, IOS_MAX, IoDirection, IoValue, List, MESSAGE_MAX, Placement,
    Quality, Safety, SessionState, TRANSFORMATIONS_MAX, Transformation, unframe,
};
use crate::sunrise::{AXES, IoLevel};
use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;
use takt_link::Random;

mod check;
mod message;
mod program;
#[cfg(test)]
mod tests;

/// Capacity of the log of exits.
const LOG_LEN: usize = 16;
/// Jumps of a client's counter up to this width are loss or reordering, wider ones a new client.
const COUNTER_WINDOW: u16 = 50;
/// Timeout of `session.await` for quality.
const AWAIT: Duration = Duration::from_secs(10);
/// Delay of a controller from closing a session to accepting the next one; reported by users.
const REOPEN: Duration = Duration::from_secs(5);

/// One end of an overlay, or of waiting for one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exit {
    /// Time since the cabinet's start.
    pub at: Duration,
    /// Reason.
    pub reason: ExitReason,
}

/// Why a motion or a session was refused; the state does not change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum StartError {
    /// The session state is not MONITORING_READY.
    #[error("session is {state}, not MONITORING_READY")]
    NotReady {
        /// State of the session.
        state: SessionState,
    },
    /// A drive has no power, or the safety controller requests a stop.
    #[error("drives are off, or the safety controller requests a stop")]
    Drives,
    /// The robot is braking.
    #[error("the robot still brakes")]
    Moving,
    /// The command mode does not fit control mode or dialect.
    #[error(
        "command mode {command} does not fit the control mode of the motion, or this version of FRI"
    )]
    Mismatch {
        /// Requested command mode.
        command: CommandMode,
    },
    /// A session is open, or the last one was closed too recently.
    #[error("the last session was closed less than 5 s ago, or is still open")]
    NotClosed,
}

struct Received {
    command: Command,
    /// The message that the answer reflects, if not too old.
    sent: Option<Sent>,
}

/// What the client adds to the control law.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Added {
    torque: [f64; AXES],
    wrench: [f64; 6],
}

/// An emulated Sunrise cabinet with a session that a robot program opened.
///
/// ```text
///  MONITORING_WAIT ⇄(1) MONITORING_READY ──(2)──▶ COMMANDING_WAIT ──(3)──▶ COMMANDING_ACTIVE
///        ▲                      ▲                        │                        │
///        └──────────────────────┴────────(4)─────────────┴────────────────────────┘
///  any ──(5)──▶ IDLE ──(6)──▶ MONITORING_WAIT
/// ```
/// 1 is evaluated once per period. 2 is [`Cabinet::start_overlay`], called by the program or the owner. 3 is the first
/// answer that agrees with the interpolator. 4 is [`Cabinet::cancel`] or any other [`ExitReason`]. 5 and 6 are
/// [`Cabinet::close_session`] and [`Cabinet::open_session`].
///
/// The owner calls [`poll_transmit`](Self::poll_transmit) at [`poll_timeout`](Self::poll_timeout) until it returns
/// `None`, and [`handle_datagram`](Self::handle_datagram) for each received datagram. Time and commands are handled as
/// in the emulated KRC, see [`crate::lwr::emulator::Krc`].
pub struct Cabinet {
    config: CabinetConfig,
    grid: Grid,
    state: SessionState,
    overlay: Overlay,
    is_switched_on: bool,
    safety: Safety,
    arm: Arm,
    sensor: Sensor,
    brake_step: [f64; AXES],
    /// Position of the interpolator during an overlay.
    ipo: [f64; AXES],
    added: Added,
    window: Window,
    quality: Quality,
    /// Since when quality has been GOOD; `None` while it is not.
    good_since: Option<Duration>,
    misses: u32,
    /// Messages since the last command period ended.
    in_period: u32,
    tracker: Tracker,
    sequence: u32,
    history: History,
    inbox: Option<Received>,
    latency: Option<Duration>,
    /// Cycle and position of the last command followed.
    last: (u64, [f64; AXES]),
    /// Start of COMMANDING_WAIT, and the reason of the wait.
    waiting: (Duration, ExitReason),
    /// Time of the program's next action; `None` when it has ended.
    program_at: Option<Duration>,
    closed_at: Option<Duration>,
    reports_close: bool,
    to_client: Line<MESSAGE_MAX>,
    to_cabinet: Line<MESSAGE_MAX>,
    random: Random,
    ios: List<IoValue, IOS_MAX>,
    frames: List<Transformation, TRANSFORMATIONS_MAX>,
    counters: ControllerCounters,
    log: VecDeque<Exit>,
    exits: u64,
}

impl Cabinet {
    /// A cabinet in MONITORING_WAIT that sends its first message at `start`. All memory is allocated here.
    pub fn new(config: CabinetConfig, start: Duration) -> Self {
        let grid = Grid::new(start, config.send_period, config.faults.drift_ppm);
        let period_s = grid.period().as_secs_f64();
        let mut body = Body::new(config.robot.chain(), config.joints, config.lag);
        body.contact = config.contact;
        body.tool = config.tool_m;
        body.load = config.load;
        let deceleration = config.limits.acceleration_rad_per_s2;
        Self {
            grid,
            state: SessionState::MonitoringWait,
            overlay: Overlay::default(),
            is_switched_on: true,
            safety: Safety::Normal,
            arm: Arm::new(body),
            sensor: Sensor::new(config.sensing, config.seed),
            brake_step: deceleration.map(|a| a * period_s * period_s),
            ipo: config.joints,
            added: Added::default(),
            window: Window::new(),
            quality: Quality::Poor,
            good_since: None,
            misses: 0,
            in_period: 0,
            tracker: Tracker::wide(COUNTER_WINDOW),
            sequence: 0,
            history: History::new(),
            inbox: None,
            latency: None,
            last: (0, config.joints),
            waiting: (Duration::ZERO, ExitReason::Cancelled),
            program_at: Some(Duration::ZERO),
            closed_at: None,
            reports_close: false,
            to_client: Line::new(),
            to_cabinet: Line::new(),
            random: Random::new(config.seed),
            ios: message::ios(&config.ios),
            frames: message::frames(&config.requested_frames),
            counters: ControllerCounters::default(),
            log: VecDeque::with_capacity(LOG_LEN),
            exits: 0,
            config,
        }
    }

    /// Writes the next datagram due by `now` to `buf` (at least [`MESSAGE_MAX`] bytes, else it may be lost).
    pub fn poll_transmit(&mut self, now: Duration, buf: &mut [u8]) -> Option<usize> {
        self.deliver(now);
        if now >= self.grid.next() {
            self.cycle(now);
        }
        let (_, bytes) = self.to_client.pop(now)?;
        buf.get_mut(..bytes.len())?.copy_from_slice(bytes);
        Some(bytes.len())
    }

    /// Handles an answer that the client sent at `now`; the line's faults apply on top.
    pub fn handle_datagram(&mut self, bytes: &[u8], now: Duration) -> Result<(), DecodeError> {
        decode(self.config.dialect, bytes).inspect_err(|_| self.counters.malformed += 1)?;
        let (behind, faults) = (self.behind(), &mut self.config.faults.to_cabinet);
        self.to_cabinet
            .push(bytes, now, behind, faults, &mut self.random);
        self.deliver(now);
        Ok(())
    }

    /// Time of the next action.
    pub fn poll_timeout(&self) -> Duration {
        [self.to_client.next_due(), self.to_cabinet.next_due()]
            .into_iter()
            .flatten()
            .fold(self.grid.next(), Duration::min)
    }

    /// Starts a motion with an overlay; the next message reports COMMANDING_WAIT.
    pub fn start_overlay(&mut self, overlay: Overlay) -> Result<(), StartError> {
        let state = self.state;
        if state != SessionState::MonitoringReady {
            return Err(StartError::NotReady { state });
        }
        if !self.can_move() {
            return Err(StartError::Drives);
        }
        if !self.arm.is_at_rest() {
            return Err(StartError::Moving);
        }
        if !self.fits(&overlay) {
            let command = overlay.command;
            return Err(StartError::Mismatch { command });
        }
        self.state = SessionState::CommandingWait;
        self.overlay = overlay;
        self.ipo = self.arm.set_point;
        let nothing = ExitReason::NotSynchronised {
            joint: 0,
            commanded: f64::NAN,
            expected: self.ipo[0],
        };
        self.waiting = (self.grid.time(), nothing);
        Ok(())
    }

    fn fits(&self, overlay: &Overlay) -> bool {
        match (overlay.command, overlay.control) {
            (CommandMode::Position, _)
            | (CommandMode::Wrench, Control::CartesianImpedance { .. })
            | (CommandMode::Torque, Control::JointImpedance { .. }) => true,
            (CommandMode::CartesianPose, _) => self.config.dialect != Dialect::V1,
            (CommandMode::Wrench, Control::Position | Control::JointImpedance { .. })
            | (CommandMode::Torque, Control::Position | Control::CartesianImpedance { .. })
            | (CommandMode::None | CommandMode::Other(_), _) => false,
        }
    }

    /// Cancels the motion; an automatic program ends with it.
    pub fn cancel(&mut self) {
        self.leave(ExitReason::Cancelled);
        self.program_at = None;
    }

    /// Closes the session; one more message reports it, then nothing is sent.
    pub fn close_session(&mut self) {
        if self.state == SessionState::Idle {
            return;
        }
        self.leave(ExitReason::Closed);
        self.state = SessionState::Idle;
        self.reports_close = true;
        self.closed_at = Some(self.grid.time());
        self.program_at = None;
    }

    /// Opens a session again, with counters from 0, like a restarted robot program.
    pub fn open_session(&mut self) -> Result<(), StartError> {
        let waited = self
            .closed_at
            .is_some_and(|at| self.grid.time() >= at + REOPEN);
        if !waited || self.state != SessionState::Idle {
            return Err(StartError::NotClosed);
        }
        self.state = SessionState::MonitoringWait;
        self.closed_at = None;
        self.sequence = 0;
        self.window = Window::new();
        self.good_since = None;
        self.misses = 0;
        self.history = History::new();
        self.tracker = Tracker::wide(COUNTER_WINDOW);
        self.program_at = Some(self.grid.time());
        Ok(())
    }

    /// Switches the drives' power.
    pub fn set_power(&mut self, is_on: bool) {
        self.is_switched_on = is_on;
    }

    /// Sets the request of the safety controller.
    pub fn set_safety(&mut self, safety: Safety) {
        self.safety = safety;
    }

    /// Whether the drives have power: switched on and not interrupted by a fault setting.
    pub fn has_power(&self) -> bool {
        let off = self.config.faults.power_off;
        self.is_switched_on && !off.is_some_and(|off| off.covers(self.grid.time()))
    }

    fn can_move(&self) -> bool {
        self.has_power() && self.safety == Safety::Normal
    }

    /// Fault settings.
    pub fn faults_mut(&mut self) -> &mut Faults {
        &mut self.config.faults
    }

    /// What the flange touches; may change at any time.
    pub fn contact_mut(&mut self) -> &mut Option<Contact> {
        &mut self.arm.body.contact
    }

    /// Puts something around the arm, beside the contact.
    pub fn set_surroundings(&mut self, surroundings: Box<dyn Surroundings>) {
        self.arm.body.surroundings = Some(surroundings);
    }

    /// State of the session.
    pub fn state(&self) -> SessionState {
        self.state
    }

    /// Quality as reported.
    pub fn quality(&self) -> Quality {
        self.quality
    }

    /// Measured joint positions, rad.
    pub fn joints(&self) -> [f64; AXES] {
        self.arm.body.joints()
    }

    /// Joint set-point, rad.
    pub fn set_point(&self) -> [f64; AXES] {
        self.arm.set_point
    }

    /// Flange position in the base frame, m.
    pub fn flange(&self) -> [f64; 3] {
        self.arm.body.pose().position.into()
    }

    /// Tip of the tool in the base frame, m.
    pub fn tip(&self) -> [f64; 3] {
        self.arm.body.tip()
    }

    /// Force of the contact on the flange in the base frame, N.
    pub fn force(&self) -> [f64; 3] {
        self.arm.body.force()
    }

    /// Value of an input or output.
    pub fn io(&self, name: &str) -> Option<IoLevel> {
        let io = self.ios.iter().find(|io| io.name.is(name))?;
        IoLevel::of(io)
    }

    /// Frame that the client sent for a request of the program.
    pub fn frame(&self, name: &str) -> Option<Placement> {
        let frame = self.frames.iter().find(|frame| frame.name.is(name))?;
        frame.placement
    }

    /// Totals since the start.
    pub fn counters(&self) -> ControllerCounters {
        ControllerCounters {
            missed: self.window.missed(),
            stalls: self.grid.stalls(),
            dropped: self.to_client.lost() + self.to_cabinet.lost(),
            ..self.counters
        }
    }

    /// The last ends of overlays, at most 16, oldest first.
    pub fn log(&self) -> impl DoubleEndedIterator<Item = &Exit> {
        self.log.iter()
    }

    /// Number of log entries ever made.
    pub fn exits(&self) -> u64 {
        self.exits
    }

    fn multiplier(&self) -> u32 {
        self.config.receive_multiplier.max(1)
    }

    fn misses_max(&self) -> u32 {
        self.config.timing.misses_max.max(1)
    }

    /// Delay of a reordered datagram.
    fn behind(&self) -> Duration {
        self.grid.period() * 3 / 2
    }

    fn is_commanding(&self) -> bool {
        matches!(
            self.state,
            SessionState::CommandingWait | SessionState::CommandingActive
        )
    }

    fn deliver(&mut self, now: Duration) {
        while let Some((due, bytes)) = self.to_cabinet.pop(now) {
            if let Ok(command) = decode(self.config.dialect, bytes) {
                self.accept(command, due);
            }
        }
    }

    fn accept(&mut self, command: Command, arrival: Duration) {
        match self.tracker.accept(command.header.sequence) {
            Order::Duplicate | Order::Old => {
                self.counters.old += 1;
                return;
            }
            Order::First | Order::Next { .. } | Order::Restart => self.counters.answers += 1,
        }
        let reflected = command.header.reflected;
        let sent = self.history.find(reflected).copied();
        let age = self.sequence.wrapping_sub(reflected);
        let age_max = u32::from(self.config.timing.reflected_age_max) + self.multiplier() - 1;
        if let Some(sent) = sent.filter(|_| age <= age_max) {
            self.latency
                .get_or_insert_with(|| arrival.saturating_sub(sent.at));
        }
        self.exchange(&command);
        self.inbox = Some(Received { command, sent });
    }

    /// Handles outputs and frames; they need no command mode.
    fn exchange(&mut self, command: &Command) {
        let Some(data) = &command.data else { return };
        for written in data.ios.iter() {
            let known = self.ios.iter_mut().find(|io| {
                io.name == written.name
                    && io.kind == written.kind
                    && io.direction == IoDirection::Output
            });
            match known {
                Some(io) => (io.digital, io.analog) = (written.digital, written.analog),
                None => self.counters.refused_ios += 1,
            }
        }
        for sent in data.transformations.iter() {
            let mut known = self.frames.iter_mut();
            if let Some(frame) = known.find(|frame| frame.name == sent.name) {
                *frame = *sent;
            }
        }
    }

    fn cycle(&mut self, now: Duration) {
        let began_late = self.grid.is_late();
        self.grid.advance(now);
        if self.state == SessionState::Idle {
            self.inbox = None;
            self.arm.body.now = self.grid.now();
            self.stop();
            if std::mem::take(&mut self.reports_close) {
                self.send(now);
            }
            return;
        }
        if self.in_period >= self.multiplier() {
            self.close_period(began_late || self.grid.is_late());
            self.in_period = 0;
        }
        self.in_period += 1;
        // The program first: it reacts to the last message.
        self.run_program();
        self.check_timing();
        self.check_drives();
        for due in self.grid.passed() {
            self.arm.body.now = due;
            self.move_joints();
        }
        self.send(now);
    }

    /// Brakes; without power the brakes are closed and the arm stops.
    fn stop(&mut self) {
        self.arm.brake(&self.brake_step);
        if self.has_power() || !self.arm.is_at_rest() {
            self.arm
                .settle(&Law::Position, self.grid.period().as_secs_f64());
        } else {
            self.arm.body.freeze();
            self.arm.sync_set_point();
        }
    }

    fn law(&self) -> Law {
        match self.overlay.control {
            _ if !self.is_commanding() => Law::Position,
            Control::Position => Law::Position,
            Control::JointImpedance { stiffness, damping } => Law::Joint {
                stiffness,
                damping,
                overlay: self.added.torque,
            },
            Control::CartesianImpedance { stiffness, damping } => Law::Cartesian {
                stiffness: about_xyz(&stiffness),
                damping: about_xyz(&damping),
                overlay: about_xyz(&self.added.wrench),
            },
        }
    }
}

/// From the order X, Y, Z, A, B, C, where A turns about z and C about x, to x, y, z and about x, y, z.
fn about_xyz(abc: &[f64; 6]) -> [f64; 6] {
    let [x, y, z, a, b, c] = *abc;
    [x, y, z, c, b, a]
}

fn decode(dialect: Dialect, datagram: &[u8]) -> Result<Command, DecodeError> {
    let is_framed = dialect.is_framed();
    let expected = Kind::SunriseCommand { is_framed };
    let decoded = unframe(datagram).and_then(|(is_framed, message)| {
        let command = Command::decode(message)?;
        Ok((is_framed, command))
    });
    match decoded {
        Ok((framed, command)) if framed == is_framed => Ok(command),
        Ok((is_framed, _)) => Err(DecodeError::Foreign {
            expected,
            found: Kind::SunriseCommand { is_framed },
        }),
        Err(error) => Err(Kind::explain(expected, datagram, error)),
    }
}

impl fmt::Debug for Cabinet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Cabinet")
            .field("state", &self.state)
            .field("quality", &self.quality)
            .field("counters", &self.counters())
            .finish_non_exhaustive()
    }
}

//! The emulated controller as a state machine without I/O: sends a measurement per period, checks the answers, runs a
//! KRL program.

use super::config::{Faults, KrcConfig, Script, Stiffness};
use super::exit::ExitReason;
use super::krl::{Call, Program};
use super::periphery::Periphery;
use crate::emulator::{
    Arm, Body, Chain, Contact, ControllerCounters, Grid, History, Line, Sensor, Sent, Surroundings,
    Window,
};
use crate::error::DecodeError;
use crate::generation::Kind;
use crate::lwr::AXES;
use crate::lwr::Load;
use crate::lwr::wire::{Cmd, CmdFlags, Control, Krl, Msr, Quality, State};
use crate::sequence::{Order, Tracker};
use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;
use takt_link::Random;

mod check;
mod message;
mod motion;
#[cfg(test)]
mod tests;

/// Capacity of the log of exits.
const LOG_LEN: usize = 16;
/// Jumps of a client's counter up to this width are loss or reordering, wider ones a new client.
const COUNTER_WINDOW: u16 = 50;
/// All seven drives have power.
const ALL_DRIVES: u16 = 0x7f;

/// One exit from command mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exit {
    /// Time since the controller's start.
    pub at: Duration,
    /// Reason.
    pub reason: ExitReason,
}

/// Why friStart was refused; the state does not change.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum StartError {
    /// Command mode is already active.
    #[error("already in command mode")]
    Commanding,
    /// Quality is UNACCEPTABLE.
    #[error("quality UNACCEPTABLE: {:.0} % of answers in time", answer_rate * 100.0)]
    Quality {
        /// Share of answers in time, 0..=1.
        answer_rate: f64,
    },
    /// No client answers.
    #[error("no answer for {cycles} cycles")]
    Misses {
        /// Number of cycles.
        cycles: u32,
    },
    /// The robot is braking.
    #[error("the robot still brakes")]
    Moving,
}

struct Received {
    cmd: Cmd,
    /// The measurement that the answer reflects, if not too old.
    sent: Option<Sent>,
}

/// An emulated KRC2 lr after friOpen.
///
/// ```text
///          (1) friStart, quality not UNACCEPTABLE, robot at rest
///   MON ─────────────────────────────────────────────────────────▶ CMD
///    ▲                                                              │
///    └──(2) friStop  (3) misses, quality  (4) a limit or rule ──────┘
/// ```
/// [`Krc::fri_start`] makes transition 1, called by the script or the owner, and [`Krc::fri_stop`] transition 2; 3 and 4
/// are checked once per cycle. After each of 2 to 4 the robot brakes, and [`Krc::log`] has the reason. A loss of drive
/// power brakes, too, but does not change the state: in CMD without power answers must mirror, as in MON.
///
/// The owner calls [`poll_transmit`](Self::poll_transmit) at [`poll_timeout`](Self::poll_timeout) until it returns
/// `None`, and [`handle_datagram`](Self::handle_datagram) for each received datagram.
///
/// **Time.** The controller has its own clock: its grid starts at the time given to [`Krc::new`] and never shifts. If
/// the owner calls a period or more too late, the missed measurements are skipped and counted as `stalls`; they are
/// neither sent later nor numbered, but the arm moves on through them, for at most 20 ms. A cycle that began or ended
/// more than a quarter period late and has no answer is excluded from the statistics: a real controller does not stall
/// with the PC's processor, so counting it would report a fault that the real pair does not have.
///
/// **Commands.** Each cycle uses the newest command received. A missing one is replaced by extrapolation at the last
/// speed. Speed is the change between two received commands over the time between the measurements they reflect, so late
/// and lost answers do not appear as jumps.
pub struct Krc {
    config: KrcConfig,
    grid: Grid,
    state: State,
    power: bool,
    scale: f64,
    /// Position of the KRL interpolator; FRI adds to it in command mode.
    base: [f64; AXES],
    arm: Arm,
    sensor: Sensor,
    brake_step: [f64; AXES],
    window: Window,
    quality: Quality,
    misses: u32,
    tracker: Tracker,
    sequence: u16,
    history: History,
    inbox: Option<Received>,
    latency: Option<Duration>,
    following: bool,
    /// Cycle and position of the last command followed.
    last: (u64, [f64; AXES]),
    flags: Option<CmdFlags>,
    may_start_at: Option<Duration>,
    to_client: Line<{ Msr::LEN }>,
    to_krc: Line<{ Cmd::LEN }>,
    random: Random,
    krl_out: Krl,
    krl_in: Krl,
    /// Angle of the screw, rad.
    screw_rad: f64,
    periphery: Vec<Box<dyn Periphery>>,
    program: Option<Program>,
    control: Control,
    /// Active parameters: `$STIFFNESS`, or the client's.
    stiffness: Stiffness,
    added_torque: [f64; AXES],
    added_wrench: [f64; 6],
    tool: [f32; 6],
    load: Load,
    counters: ControllerCounters,
    log: VecDeque<Exit>,
    exits: u64,
}

impl Krc {
    /// A controller in monitor mode that sends its first measurement at `start`. All memory is allocated here.
    pub fn new(config: KrcConfig, start: Duration) -> Self {
        let grid = Grid::new(start, config.period, config.faults.drift_ppm);
        let period_s = grid.period().as_secs_f64();
        let mut body = Body::new(Chain::LWR, config.joints, config.lag);
        body.contact = config.contact;
        body.tool = config.tool_m;
        Self {
            grid,
            state: State::Mon,
            power: true,
            scale: 1.0,
            base: config.joints,
            arm: Arm::new(body),
            sensor: Sensor::new(config.sensing, config.seed),
            brake_step: config
                .limits
                .acceleration_rad_per_s2
                .map(|a| a * period_s * period_s),
            window: Window::new(),
            quality: Quality::Unacceptable,
            misses: 0,
            tracker: Tracker::new(COUNTER_WINDOW),
            sequence: 0,
            history: History::new(),
            inbox: None,
            latency: None,
            following: false,
            last: (0, config.joints),
            flags: None,
            may_start_at: Some(Duration::ZERO),
            to_client: Line::new(),
            to_krc: Line::new(),
            random: Random::new(config.seed),
            krl_out: Krl::default(),
            krl_in: Krl::default(),
            screw_rad: 0.0,
            periphery: Vec::new(),
            program: match config.script {
                Script::Handshake(protocol) => Some(Program::new(protocol)),
                Script::Manual | Script::Auto { .. } => None,
            },
            control: config.control,
            stiffness: config.stiffness,
            added_torque: [0.0; AXES],
            added_wrench: [0.0; 6],
            tool: [0.0; 6],
            load: Load::default(),
            counters: ControllerCounters::default(),
            log: VecDeque::with_capacity(LOG_LEN),
            exits: 0,
            config,
        }
    }

    /// Writes the next datagram due by `now` to `buf` (at least [`Msr::LEN`] bytes, else the datagram is lost).
    pub fn poll_transmit(&mut self, now: Duration, buf: &mut [u8]) -> Option<usize> {
        self.deliver(now);
        if now >= self.grid.next() {
            self.cycle(now);
        }
        let (_, bytes) = self.to_client.pop(now)?;
        buf.get_mut(..Msr::LEN)?.copy_from_slice(bytes);
        Some(Msr::LEN)
    }

    /// Handles an answer that the client sent at `now`; the line's faults apply on top.
    pub fn handle_datagram(&mut self, bytes: &[u8], now: Duration) -> Result<(), DecodeError> {
        Cmd::decode(bytes)
            .map_err(|error| Kind::explain(Kind::LwrCommand, bytes, error))
            .inspect_err(|_| self.counters.malformed += 1)?;
        let (behind, faults) = (self.behind(), &mut self.config.faults.to_krc);
        self.to_krc
            .push(bytes, now, behind, faults, &mut self.random);
        self.deliver(now);
        Ok(())
    }

    /// Time of the next action.
    pub fn poll_timeout(&self) -> Duration {
        [self.to_client.next_due(), self.to_krc.next_due()]
            .into_iter()
            .flatten()
            .fold(self.grid.next(), Duration::min)
    }

    /// Enters command mode with limits scaled by `scale`, 0..=1; the next measurement reports it.
    pub fn fri_start(&mut self, scale: f64) -> Result<(), StartError> {
        if self.state == State::Cmd {
            return Err(StartError::Commanding);
        }
        if self.quality == Quality::Unacceptable {
            return Err(StartError::Quality {
                answer_rate: self.window.answer_rate(),
            });
        }
        if self.misses >= self.misses_max() {
            return Err(StartError::Misses {
                cycles: self.misses,
            });
        }
        if !self.arm.is_at_rest() {
            return Err(StartError::Moving);
        }
        self.state = State::Cmd;
        self.scale = scale.clamp(0.0, 1.0);
        self.following = false;
        self.flags = None;
        Ok(())
    }

    /// Leaves command mode; an automatic script does not start again by itself.
    pub fn fri_stop(&mut self) {
        self.leave(ExitReason::FriStop);
        self.may_start_at = None;
    }

    /// Sets the control strategy, as `$STIFFNESS.STRATEGY` with `$STIFFNESS.COMMIT` does.
    pub fn set_strategy(&mut self, control: Control) -> Result<(), StartError> {
        if self.state == State::Cmd {
            return Err(StartError::Commanding);
        }
        if !self.arm.is_at_rest() {
            return Err(StartError::Moving);
        }
        self.control = control;
        self.stiffness = self.config.stiffness;
        self.arm.sync_set_point();
        Ok(())
    }

    /// Active control strategy.
    pub fn control(&self) -> Control {
        self.control
    }

    /// `$TOOL` as set by the KRL program: X, Y, Z in mm, A, B, C in degrees. It does not move the emulated arm's end point.
    pub fn tool(&self) -> [f32; 6] {
        self.tool
    }

    /// `$LOAD` as set by the KRL program. Only an arm with surroundings weighs: there the drives carry this load, and the
    /// estimated forces are those beyond it.
    pub fn load(&self) -> Load {
        self.load
    }

    /// What the flange touches; may change at any time.
    pub fn contact_mut(&mut self) -> &mut Option<Contact> {
        &mut self.arm.body.contact
    }

    /// Puts something around the arm, beside the contact.
    pub fn set_surroundings(&mut self, surroundings: Box<dyn Surroundings>) {
        self.arm.body.surroundings = Some(surroundings);
    }

    /// Connects a device to the user variables, beside those that are connected.
    pub fn add_periphery(&mut self, device: Box<dyn Periphery>) {
        self.periphery.push(device);
    }

    /// Flange position in the base frame, m.
    pub fn flange(&self) -> [f64; 3] {
        self.arm.body.pose().position.into()
    }

    /// Tip of the tool in the base frame, m.
    pub fn tip(&self) -> [f64; 3] {
        self.arm.body.tip()
    }

    /// Force on the flange beyond the stated load in the base frame, without noise and delay, N.
    pub fn force(&self) -> [f64; 3] {
        self.arm.body.force()
    }

    /// Switches the drives' power.
    pub fn set_power(&mut self, power: bool) {
        self.power = power;
    }

    /// Whether the drives have power: switched on and not interrupted by a fault setting.
    pub fn has_power(&self) -> bool {
        let off = self.config.faults.power_off;
        self.power && !off.is_some_and(|off| off.covers(self.grid.time()))
    }

    /// Fault settings.
    pub fn faults_mut(&mut self) -> &mut Faults {
        &mut self.config.faults
    }

    /// Monitor or command mode.
    pub fn state(&self) -> State {
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

    /// User data of the last answer, `$FRI_FRM_…`.
    pub fn krl(&self) -> &Krl {
        &self.krl_in
    }

    /// User data sent with every measurement, `$FRI_TO_…`.
    pub fn krl_mut(&mut self) -> &mut Krl {
        &mut self.krl_out
    }

    /// Totals since the start.
    pub fn counters(&self) -> ControllerCounters {
        ControllerCounters {
            missed: self.window.missed(),
            stalls: self.grid.stalls(),
            dropped: self.to_client.lost() + self.to_krc.lost(),
            ..self.counters
        }
    }

    /// The last exits from command mode, at most 16, oldest first.
    pub fn log(&self) -> impl DoubleEndedIterator<Item = &Exit> {
        self.log.iter()
    }

    /// Number of exits from command mode since the start, friStop included.
    pub fn exits(&self) -> u64 {
        self.exits
    }

    fn misses_max(&self) -> u32 {
        self.config.timing.misses_max.max(1)
    }

    /// Delay of a reordered datagram.
    fn behind(&self) -> Duration {
        self.grid.period() * 3 / 2
    }

    fn deliver(&mut self, now: Duration) {
        while let Some((due, bytes)) = self.to_krc.pop(now) {
            if let Ok(cmd) = Cmd::decode(bytes) {
                self.accept(cmd, due);
            }
        }
    }

    fn accept(&mut self, cmd: Cmd, arrival: Duration) {
        match self.tracker.accept(cmd.header.sequence) {
            Order::Duplicate | Order::Old => {
                self.counters.old += 1;
                return;
            }
            Order::First | Order::Next { .. } | Order::Restart => self.counters.answers += 1,
        }
        let sent = self.history.find(cmd.header.reflected.into()).copied();
        let age = self.sequence.wrapping_sub(cmd.header.reflected);
        if let Some(sent) = sent.filter(|_| age <= self.config.timing.reflected_age_max) {
            self.latency
                .get_or_insert_with(|| arrival.saturating_sub(sent.at));
        }
        self.krl_in = cmd.krl;
        self.inbox = Some(Received { cmd, sent });
    }

    fn cycle(&mut self, now: Duration) {
        let began_late = self.grid.is_late();
        let first = self.grid.advance(now) == 1;
        if !first {
            self.close_cycle(began_late || self.grid.is_late());
        }
        self.check_timing();
        self.run_script();
        self.run_program();
        self.switch_contact();
        for due in self.grid.passed() {
            self.arm.body.now = due;
            self.move_joints();
            self.sensor.sense(&self.arm.body, self.grid.period());
            self.turn_screw();
            for device in &mut self.periphery {
                device.exchange(due, &self.krl_in, &mut self.krl_out);
            }
        }
        self.measure(now);
    }

    fn close_cycle(&mut self, is_void: bool) {
        let latency = self.latency.take();
        match latency {
            Some(_) => self.misses = 0,
            None if is_void => return,
            None => self.misses = self.misses.saturating_add(1),
        }
        self.window.record(latency);
        if self.misses >= self.misses_max() {
            // After such a silence another client may answer, with another counter.
            self.tracker.forget();
        }
    }

    fn check_timing(&mut self) {
        let forced = self.config.faults.quality;
        self.quality =
            forced.unwrap_or_else(|| u16::from(self.window.rank(&self.config.timing)).into());
        if self.misses >= self.misses_max() {
            let span_ms = self.grid.period().as_secs_f64() * 1e3 * f64::from(self.misses);
            self.leave(ExitReason::Misses {
                cycles: self.misses,
                span_ms,
            });
        } else if self.quality == Quality::Unacceptable {
            self.leave(ExitReason::Quality {
                answer_rate: self.window.answer_rate(),
            });
        }
    }

    fn run_program(&mut self) {
        let (time, state) = (self.grid.time(), self.state);
        let Some(program) = &mut self.program else {
            return;
        };
        let is_ok = self.quality.code() >= Quality::Ok.code();
        let calls = program.step(&self.krl_in, &mut self.krl_out, (state, is_ok), time);
        for call in calls.into_iter().flatten() {
            match call {
                // Refused while the robot brakes, without quality or power: the program tries again in the next cycle.
                Call::Start if self.has_power() => {
                    let _refused = self.fri_start(1.0);
                }
                Call::Start => {}
                Call::Stop => self.leave(ExitReason::FriStop),
                Call::Strategy(control) => {
                    let _refused = self.set_strategy(control);
                }
                Call::Tool(tool) => self.tool = tool,
                Call::Load(load) => self.set_load(load),
                Call::Reopen(period) => self.reopen(period),
            }
        }
    }

    /// Sets `$LOAD`, as the KRL program does.
    pub fn set_load(&mut self, load: Load) {
        self.load = load;
        let [x, y, z, ..] = load.centre.map(|millimetres| f64::from(millimetres) / 1e3);
        self.arm.body.load = (f64::from(load.mass_kg), [x, y, z]);
    }

    /// Takes the contact away while the client's signal for that is true.
    fn switch_contact(&mut self) {
        if let Some(signal) = self.config.contact_off {
            let is_off = self.krl_in.bool(signal);
            self.arm.body.contact = self.config.contact.filter(|_| !is_off);
        }
    }

    fn turn_screw(&mut self) {
        let (Some(driver), [speed, ..]) = (self.config.screwdriver, self.krl_in.real) else {
            return;
        };
        let [x, y, z] = self.force();
        let force = x.hypot(y).hypot(z);
        let (angle, torque) = driver.turn(self.screw_rad, speed.into(), force, self.grid.period());
        self.screw_rad = angle;
        if let Some(out) = self.krl_out.real.first_mut() {
            #[expect(clippy::cast_possible_truncation, reason = "user variables are f32")]
            let torque = torque as f32;
            *out = torque;
        }
    }

    /// friClose and friOpen with another period: quality starts from zero.
    fn reopen(&mut self, period: Duration) {
        self.grid.set_period(period);
        let period_s = self.grid.period().as_secs_f64();
        let deceleration = self.config.limits.acceleration_rad_per_s2;
        self.brake_step = deceleration.map(|a| a * period_s * period_s);
        self.arm.hold();
        self.window = Window::new();
        self.misses = 0;
    }

    fn run_script(&mut self) {
        let Script::Auto { quality, scale, .. } = self.config.script else {
            return;
        };
        let waits = self.may_start_at.is_none_or(|at| self.grid.time() < at);
        let is_good = self.quality.code() >= quality.code();
        if self.state == State::Mon && !waits && is_good && self.has_power() {
            // Refused while the robot brakes or no client answers: the script tries again in the next cycle.
            let _refused = self.fri_start(scale);
        }
    }

    fn leave(&mut self, reason: ExitReason) {
        if self.state != State::Cmd {
            return;
        }
        let at = self.grid.time();
        self.state = State::Mon;
        self.may_start_at = match self.config.script {
            Script::Manual | Script::Handshake(_) => None,
            Script::Auto { restart, .. } => restart.map(|pause| at + pause),
        };
        if self.log.len() == LOG_LEN {
            self.log.pop_front();
        }
        self.log.push_back(Exit { at, reason });
        self.exits += 1;
    }

    fn follows(&self) -> bool {
        self.state == State::Cmd && self.has_power()
    }
}

impl fmt::Debug for Krc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Krc")
            .field("state", &self.state)
            .field("quality", &self.quality)
            .field("counters", &self.counters())
            .finish_non_exhaustive()
    }
}

//! Driver of one power base on one link, in counts: waits for its messages, configures it, sends a command every
//! period, and reports why it does not move. [`super::Base`] and [`super::Omni`] convert counts to SI units.
//!
//! ```text
//!            UI only                         complete cycle
//!   Silent ----------> PoweredOff   Silent ----------------> Configuring
//!   Configuring -- all sent, mode as requested, motors enabled -> Ready
//!   Configuring -- mode refused, or a hindrance ---------------> Blocked
//!   Ready       -- a hindrance --------------------------------> Blocked
//!   Blocked     -- the hindrance is cleared -------------------> Configuring
//!   any         -- no complete cycle for `silence` ------------> Silent
//!                  (PoweredOff: no message of its user interface)
//! ```
//!
//! After each transition to Ready the power base stays at rest until the program has commanded rest once: a motion
//! commanded before a fault must not continue after it.

use std::fmt;
use std::time::Duration;

use super::command::{CURRENT_MAX, SCALE_MAX, TURN_MAX, VELOCITY_MAX};
use super::{
    Channel, Command, Config, Cycles, Gain, Integrators, Measurement, Message, Mode, Model,
    SHUTDOWN, StatusWord1, YawSign,
};
use crate::Frame;

/// Minimum time between two commands.
const PERIOD_MIN: Duration = Duration::from_millis(10);
/// Maximum time between two commands before a power base may stop by itself.
const PERIOD_MAX: Duration = Duration::from_millis(300);
/// Requests of a mode after which it counts as refused.
const MODE_REQUESTS_MAX: u8 = 20;

/// Configuration of a driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriverConfig {
    /// Model.
    pub model: Model,
    /// Which way the integrated yaw counts.
    pub yaw_integral: YawSign,
    /// Time between commands, 10 ms to 300 ms.
    pub period: Duration,
    /// Timeout for a complete cycle, after which the power base is silent.
    pub silence: Duration,
    /// Mode of operation.
    pub mode: Mode,
    /// Gain schedule, by payload.
    pub gain: Gain,
    /// Acceleration scale, sixteenths.
    pub acceleration: u8,
    /// Current limit, 1 to 256.
    pub current: u16,
}

impl Default for DriverConfig {
    fn default() -> Self {
        Self {
            model: Model::default(),
            yaw_integral: YawSign::default(),
            period: Duration::from_millis(50),
            silence: Duration::from_millis(200),
            mode: Mode::Tractor,
            gain: Gain::Light,
            acceleration: SCALE_MAX,
            current: CURRENT_MAX,
        }
    }
}

/// State of a driver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum State {
    /// No messages received.
    #[default]
    Silent,
    /// The user interface is on, the power base is off.
    PoweredOff,
    /// Being configured.
    Configuring,
    /// It follows commands.
    Ready,
    /// It cannot move.
    Blocked(Hindrance),
}

/// What keeps a power base from moving although it communicates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hindrance {
    /// An emergency stop switch is open.
    EmergencyStop,
    /// It reports a fault in status word 1.
    Fault(StatusWord1),
    /// Its motors are not enabled.
    MotorsDisabled,
    /// It refuses the requested mode and stays in this one.
    ModeRefused(Mode),
}

impl fmt::Display for Hindrance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::EmergencyStop => f.write_str(
                "its emergency stop is open; close it, the driver then continues by itself",
            ),
            Self::Fault(word) => {
                f.write_str("it reports")?;
                for (index, name) in word.faults().enumerate() {
                    write!(f, "{}{name}", if index == 0 { " " } else { ", " })?;
                }
                f.write_str("; switch the power base off and on")
            }
            Self::MotorsDisabled => f.write_str(
                "its motors are disabled; connect the host before switching the power base on, \
                 and switch it off and on",
            ),
            Self::ModeRefused(mode) => write!(
                f,
                "it stays in mode {mode}; switch the power base off and on, and check whether \
                 another host commands it"
            ),
        }
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Silent => {
                f.write_str("no messages received; check power, cable and bit rate (500 kbit/s)")
            }
            Self::PoweredOff => {
                f.write_str("its user interface is on, the power base is off; switch it on")
            }
            Self::Configuring => f.write_str("it is being configured"),
            Self::Ready => f.write_str("it follows commands"),
            Self::Blocked(hindrance) => hindrance.fmt(f),
        }
    }
}

/// The driver of one power base.
#[derive(Clone, Debug)]
pub struct Driver {
    config: DriverConfig,
    cycles: [Cycles; 2],
    /// The active channel and the time of its last measurement.
    channel: Channel,
    last: Option<Measurement>,
    state: State,
    /// Next configuration step.
    step: u8,
    mode_requests: u8,
    last_received: Option<Duration>,
    next: Duration,
    /// Whether rest was commanded since the power base became ready.
    armed: bool,
    motion: [i16; 2],
    shut_down: bool,
    lost: u64,
}

impl Driver {
    /// A driver before the first message. The period is clamped to its range.
    pub fn new(config: DriverConfig) -> Self {
        Self {
            config: DriverConfig {
                period: config.period.clamp(PERIOD_MIN, PERIOD_MAX),
                ..config
            },
            cycles: [Cycles::new(config.model); 2],
            channel: Channel::A,
            last: None,
            state: State::Silent,
            step: 0,
            mode_requests: 0,
            last_received: None,
            next: Duration::ZERO,
            armed: false,
            motion: [0; 2],
            shut_down: false,
            lost: 0,
        }
    }

    /// Its state.
    pub const fn state(&self) -> State {
        self.state
    }

    /// Number of transitions out of Ready.
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    /// Incomplete cycles of the active channel.
    pub const fn broken(&self) -> u64 {
        let [a, b] = &self.cycles;
        match self.channel {
            Channel::A => a.broken(),
            Channel::B => b.broken(),
        }
    }

    /// The last measurement.
    pub const fn measurement(&self) -> Option<&Measurement> {
        self.last.as_ref()
    }

    /// Whether it follows commands: it is ready, and rest was commanded since.
    pub fn follows(&self) -> bool {
        self.state == State::Ready && self.armed
    }

    /// Sets the command, counts at full scale: velocity, and turn clockwise; `None`: rest.
    pub fn drive(&mut self, motion: Option<[i16; 2]>) {
        self.armed |= motion.is_none() && self.state == State::Ready;
        self.motion = match motion {
            Some([velocity, turn]) if self.follows() => [
                velocity.clamp(-VELOCITY_MAX, VELOCITY_MAX),
                turn.clamp(-TURN_MAX, TURN_MAX),
            ],
            Some(_) | None => [0; 2],
        };
    }

    /// Switches the power base off with the next command.
    pub const fn shut_down(&mut self) {
        self.shut_down = true;
    }

    /// Handles a frame; returns the measurement that it completes. One of the two channels is
    /// active; the other takes over when it falls silent.
    pub fn handle_frame(
        &mut self,
        channel: Channel,
        frame: &Frame,
        now: Duration,
    ) -> Option<Measurement> {
        let message = Message::decode(frame)?;
        let is_off = matches!(message, Message::PowerbaseOff { .. });
        if is_off && matches!(self.state, State::Silent | State::PoweredOff) {
            (self.state, self.last_received) = (State::PoweredOff, Some(now));
        }
        let [a, b] = &mut self.cycles;
        let cycles = match channel {
            Channel::A => a,
            Channel::B => b,
        };
        let measured = cycles.handle(&message, now)?;
        let stale = self
            .last
            .is_none_or(|last| now.saturating_sub(last.stamp) > self.config.silence / 2);
        if channel != self.channel && !stale {
            return None;
        }
        self.channel = channel;
        self.last_received = Some(now);
        self.last = Some(measured);
        self.judge(&measured);
        Some(measured)
    }

    fn judge(&mut self, measured: &Measurement) {
        let hindrance = self.hindrance(measured);
        self.state = match (self.state, hindrance) {
            (State::Silent | State::PoweredOff, _) => {
                (self.step, self.mode_requests) = (0, 0);
                State::Configuring
            }
            (State::Configuring, _) if self.step < STEPS => State::Configuring,
            (State::Configuring, None) => {
                self.armed = false;
                State::Ready
            }
            (State::Configuring, Some(hindrance)) if self.mode_requests >= MODE_REQUESTS_MAX => {
                State::Blocked(hindrance)
            }
            (State::Configuring, Some(_)) => State::Configuring,
            (State::Ready, Some(hindrance)) => {
                self.leave();
                State::Blocked(hindrance)
            }
            (State::Ready, None) => State::Ready,
            (State::Blocked(Hindrance::ModeRefused(_)), Some(hindrance)) => {
                State::Blocked(hindrance)
            }
            (State::Blocked(_), Some(Hindrance::ModeRefused(_)) | None) => {
                (self.step, self.mode_requests) = (0, 0);
                State::Configuring
            }
            (State::Blocked(_), Some(hindrance)) => State::Blocked(hindrance),
        };
    }

    fn hindrance(&self, measured: &Measurement) -> Option<Hindrance> {
        let unit = &measured.unit;
        if unit.word2.emergency_stop() {
            Some(Hindrance::EmergencyStop)
        } else if unit.word1.faults().next().is_some() {
            Some(Hindrance::Fault(unit.word1))
        } else if measured.mode != self.config.mode {
            Some(Hindrance::ModeRefused(measured.mode))
        } else if !unit.word1.contains(StatusWord1::MOTORS_ENABLED) {
            Some(Hindrance::MotorsDisabled)
        } else {
            None
        }
    }

    fn leave(&mut self) {
        self.lost += 1;
        self.armed = false;
        self.motion = [0; 2];
    }

    /// Next time at which [`Self::poll_transmit`] has work.
    pub const fn poll_timeout(&self) -> Duration {
        self.next
    }

    /// The due command, for both channels. A silent power base also gets one, with rest: it may
    /// still receive frames.
    pub fn poll_transmit(&mut self, now: Duration) -> Option<Frame> {
        if now < self.next {
            return None;
        }
        let next = self.next + self.config.period;
        self.next = if next > now {
            next
        } else {
            now + self.config.period
        };
        if now.saturating_sub(self.last_received.unwrap_or_default()) > self.config.silence {
            self.fall_silent();
        }
        if std::mem::take(&mut self.shut_down) {
            return Some(SHUTDOWN);
        }
        let [velocity, turn] = self.motion;
        Some(match self.state {
            State::Configuring => self.configure(),
            State::Ready => Command {
                velocity,
                turn,
                config: Config::None,
            }
            .frame(),
            State::Silent | State::PoweredOff | State::Blocked(_) => Command::default().frame(),
        })
    }

    fn fall_silent(&mut self) {
        match self.state {
            State::Ready => self.leave(),
            State::Silent => return,
            State::PoweredOff | State::Configuring | State::Blocked(_) => {}
        }
        self.state = State::Silent;
        self.last_received = None;
    }

    /// The next configuration step. Only the mode can be read back, so it is requested until it is reported.
    /// Displacements need no reset, because odometry starts at any value.
    fn configure(&mut self) -> Frame {
        let config = match self.step {
            0 => Config::ResetIntegrators(Integrators::ALL),
            1 => Config::MaxVelocity(SCALE_MAX),
            2 => Config::MaxTurn(SCALE_MAX),
            3 => Config::MaxAcceleration(self.config.acceleration.min(SCALE_MAX)),
            4 => Config::Gain(self.config.gain),
            5 => Config::CurrentLimit(self.config.current.clamp(1, CURRENT_MAX)),
            6 => Config::BalanceLockout(self.config.mode != Mode::Balance),
            _ => {
                self.mode_requests = self.mode_requests.saturating_add(1);
                Config::Mode(self.config.mode)
            }
        };
        self.step = (self.step + 1).min(STEPS);
        Command {
            config,
            ..Command::default()
        }
        .frame()
    }
}

/// Configuration steps; the last one is repeated.
const STEPS: u8 = 8;

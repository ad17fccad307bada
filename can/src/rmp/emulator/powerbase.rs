//! An emulated power base: executes commands as the real one does, moves its wheels, and reports every 10 ms. It does
//! not balance; it is supported by casters or a second power base.

use std::time::Duration;

use super::super::command::{CURRENT_MAX, SCALE_MAX, TURN_MAX, VELOCITY_MAX, is_shutdown};
use super::super::model::COUNTS_PER_DEGREE;
use super::super::status::ControlUnit;
use super::super::{
    Channel, Command, Config, Gain, Integrators, Message, Mode, Model, Odometer, Pose, StatusWord1,
    StatusWord2, YawSign,
};
use crate::Frame;

/// Period of message bursts.
const CYCLE: Duration = Duration::from_millis(10);
/// Step of the motion model.
const STEP: Duration = Duration::from_millis(1);
/// Maximum age of a command in effect.
const COMMAND_AGE_MAX: Duration = Duration::from_millis(400);
/// Minimum time between two commands.
const COMMAND_SPACING_MIN: Duration = Duration::from_millis(9);
/// Acceleration at full scale, m/s².
const ACCELERATION: f64 = 3.0;

/// Configuration of a power base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PowerbaseConfig {
    /// Model.
    pub model: Model,
    /// Distance between its wheels, m.
    pub track: f64,
    /// Displacement counts per second of a wheel by a count of turn; by default from 7.8 counts per degree per second
    /// and the track.
    pub turn_gain: Option<f64>,
    /// Start time and phase of its cycles, on the owner's clock.
    pub start: Duration,
    /// Whether both channels send; else only A.
    pub both_channels: bool,
    /// Which way its integrated yaw counts.
    pub yaw_integral: YawSign,
}

impl Default for PowerbaseConfig {
    fn default() -> Self {
        Self {
            model: Model::default(),
            track: 0.54,
            turn_gain: None,
            start: Duration::ZERO,
            both_channels: false,
            yaw_integral: YawSign::default(),
        }
    }
}

/// Injected faults; none by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// It ignores commands to change the velocity scale.
    pub keeps_scale: bool,
    /// Integrators that do not clear.
    pub keeps: Integrators,
    /// Silent channels: A, B.
    pub silent: [bool; 2],
    /// Its emergency stop is open.
    pub emergency_stop: bool,
    /// It refuses mode changes.
    pub refuses_mode: bool,
    /// Further bits of status word 1.
    pub word1: u16,
    /// The message with this identifier is never sent.
    pub lacks: Option<u16>,
}

/// One power base.
#[derive(Clone, Debug)]
pub struct Powerbase {
    config: PowerbaseConfig,
    /// Injected faults.
    pub faults: Faults,
    powered: bool,
    mode: Mode,
    gain: Gain,
    scales: [u8; 3],
    current: u16,
    command: [i16; 2],
    commanded: Option<Duration>,
    hurried: u64,
    /// Rates of the wheels, counts/s.
    rates: [f64; 2],
    /// True displacement of the wheels, counts.
    turned: [f64; 2],
    /// Offsets from resets: right, left, yaw, fore and aft.
    offsets: [f64; 4],
    odometer: Odometer,
    now: Duration,
    burst: Duration,
    /// Remaining messages of the burst.
    pending: usize,
    frames: u16,
    counter: u16,
}

/// The identifiers in their order on the wire.
const ORDER: [u16; 10] = [
    0x400, 0x401, 0x688, 0x680, 0x402, 0x403, 0x404, 0x405, 0x406, 0x407,
];
const VELOCITY: usize = 0;
const ACCELERATE: usize = 1;
const TURN: usize = 2;

impl Powerbase {
    /// A power base, switched on and disabled, with a stored velocity scale of 12.
    pub fn new(config: PowerbaseConfig) -> Self {
        Self {
            config,
            faults: Faults::default(),
            powered: true,
            mode: Mode::Disabled,
            gain: Gain::Light,
            scales: [12, SCALE_MAX, SCALE_MAX],
            current: CURRENT_MAX,
            command: [0; 2],
            commanded: None,
            hurried: 0,
            rates: [0.0; 2],
            turned: [0.0; 2],
            offsets: [0.0; 4],
            odometer: Odometer::default(),
            now: config.start,
            burst: config.start,
            pending: 0,
            frames: 0,
            counter: 0,
        }
    }

    /// Stores a velocity scale, sixteenths, as a previous host may have done.
    pub fn store_scale(&mut self, scale: u8) {
        self.scales[VELOCITY] = scale.min(SCALE_MAX);
    }

    /// Switches it on or off. Counters are lost with power, the stored scale is not.
    pub fn power(&mut self, on: bool) {
        if on && !self.powered {
            self.offsets = self.raw_integrators();
        }
        (self.powered, self.mode, self.commanded) = (on, Mode::Disabled, None);
        self.command = [0; 2];
    }

    /// Its integrators of displacement go on from so many metres farther, as a disturbance makes them; nothing rolls.
    pub fn disturb_integrators(&mut self, by: f64) {
        let counts = by * self.config.model.scales().displacement;
        let [right, left, ..] = &mut self.offsets;
        *right -= counts;
        *left -= counts;
    }

    /// True pose.
    pub const fn truth(&self) -> Pose {
        self.odometer.pose()
    }

    /// True displacement of the left and right wheel, counts.
    pub const fn turned(&self) -> [f64; 2] {
        self.turned
    }

    /// Speed of the left and the right wheel, m/s on the wheels of its model.
    pub fn speed(&self) -> [f64; 2] {
        let scale = self.config.model.scales().displacement;
        self.rates.map(|rate| rate / scale)
    }

    /// Operational mode.
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// Stored scales of velocity, acceleration and turn, sixteenths.
    pub const fn scales(&self) -> [u8; 3] {
        self.scales
    }

    /// Number of commands that arrived too early.
    pub const fn hurried(&self) -> u64 {
        self.hurried
    }

    /// Handles a frame of the host.
    pub fn handle_frame(&mut self, frame: &Frame, now: Duration) {
        self.advance(now);
        if !self.powered {
            return;
        }
        if is_shutdown(frame) {
            self.power(false);
        } else if let Some(command) = Command::decode(frame) {
            self.apply(command, now);
        }
    }

    fn apply(&mut self, command: Command, now: Duration) {
        if self
            .commanded
            .is_some_and(|last| now.saturating_sub(last) < COMMAND_SPACING_MIN)
        {
            self.hurried += 1;
        }
        self.commanded = Some(now);
        self.command = [
            command.velocity.clamp(-VELOCITY_MAX, VELOCITY_MAX),
            command.turn.clamp(-TURN_MAX, TURN_MAX),
        ];
        match command.config {
            Config::MaxVelocity(_) if self.faults.keeps_scale => {}
            Config::MaxVelocity(scale) => self.scales[VELOCITY] = scale.min(SCALE_MAX),
            Config::MaxAcceleration(scale) => self.scales[ACCELERATE] = scale.min(SCALE_MAX),
            Config::MaxTurn(scale) => self.scales[TURN] = scale.min(SCALE_MAX),
            Config::Gain(gain) => self.gain = gain,
            Config::CurrentLimit(limit) => self.current = limit.min(CURRENT_MAX),
            Config::Mode(mode) if !self.faults.refuses_mode => self.set_mode(mode),
            Config::ResetIntegrators(which) => self.reset(which),
            Config::None | Config::Mode(_) | Config::BalanceLockout(_) | Config::Other { .. } => {}
        }
    }

    /// It does not balance, and switches off on command.
    fn set_mode(&mut self, mode: Mode) {
        match mode {
            Mode::Disabled | Mode::Tractor => self.mode = mode,
            Mode::PowerDown => self.power(false),
            Mode::Balance | Mode::Other(_) => {}
        }
    }

    fn reset(&mut self, which: Integrators) {
        let order = [
            Integrators::RIGHT,
            Integrators::LEFT,
            Integrators::YAW,
            Integrators::FORE_AFT,
        ];
        let raw = self.raw_integrators();
        for ((offset, raw), one) in self.offsets.iter_mut().zip(raw).zip(order) {
            if which.contains(one) && !self.faults.keeps.contains(one) {
                *offset = raw;
            }
        }
    }

    /// Right, left, yaw (clockwise), fore and aft, counts since power-on.
    fn raw_integrators(&self) -> [f64; 4] {
        let [left, right] = self.turned;
        let turns = self.odometer.pose().heading / std::f64::consts::TAU;
        let sign = match self.config.yaw_integral {
            YawSign::Clockwise => -1.0,
            YawSign::CounterClockwise => 1.0,
        };
        let yaw = sign * turns * self.config.model.scales().yaw;
        [right, left, yaw, f64::midpoint(left, right)]
    }

    /// Advances to a time.
    pub fn advance(&mut self, now: Duration) {
        while self.now + STEP <= now {
            self.now += STEP;
            self.step();
        }
    }

    fn moves(&self) -> bool {
        let fresh = |at: Duration| self.now.saturating_sub(at) <= COMMAND_AGE_MAX;
        self.powered
            && self.mode == Mode::Tractor
            && !self.faults.emergency_stop
            && self.commanded.is_some_and(fresh)
    }

    fn step(&mut self) {
        let scales = self.config.model.scales();
        let dt_s = STEP.as_secs_f64();
        let scale_factor = |which: usize| f64::from(self.scales[which]) / f64::from(SCALE_MAX);
        let turn_gain = self.config.turn_gain.unwrap_or_else(|| {
            (1.0 / COUNTS_PER_DEGREE).to_radians() * self.config.track / 2.0 * scales.displacement
        });
        let [velocity, turn] = if self.moves() {
            self.command.map(f64::from)
        } else {
            [0.0; 2]
        };
        let ahead = velocity * scale_factor(VELOCITY) * scales.displacement / scales.velocity;
        let around = turn * scale_factor(TURN) * turn_gain;
        let most = ACCELERATION * scale_factor(ACCELERATE).max(0.1) * scales.displacement * dt_s;
        for (rate, wanted) in self.rates.iter_mut().zip([ahead + around, ahead - around]) {
            *rate += (wanted - *rate).clamp(-most, most);
        }
        let steps = self.rates.map(|rate| rate * dt_s);
        for (turned, step) in self.turned.iter_mut().zip(steps) {
            *turned += step;
        }
        let [left, right] = steps.map(|step| step / scales.displacement);
        let rotation = (right - left) / self.config.track;
        self.odometer
            .add([f64::midpoint(left, right), 0.0, rotation]);
    }

    /// Next time at which [`Self::poll_transmit`] has work.
    pub const fn poll_timeout(&self) -> Duration {
        self.burst
    }

    /// The next due message and its channel.
    pub fn poll_transmit(&mut self, now: Duration) -> Option<(Channel, Frame)> {
        self.advance(now);
        loop {
            if self.pending == 0 {
                if now < self.burst {
                    return None;
                }
                self.begin();
            }
            let at = self.burst_len() - self.pending;
            self.pending -= 1;
            if let Some(sent) = self.message(at) {
                return Some(sent);
            }
        }
    }

    const fn burst_len(&self) -> usize {
        let both = if self.config.both_channels { 2 } else { 1 };
        ORDER.len() * both
    }

    fn begin(&mut self) {
        self.burst += CYCLE;
        self.pending = self.burst_len();
        if self.powered {
            self.frames = self.frames.wrapping_add(1);
            self.counter = self.counter.wrapping_add(2);
        }
    }

    fn message(&self, at: usize) -> Option<(Channel, Frame)> {
        let channel = if at < ORDER.len() {
            Channel::A
        } else {
            Channel::B
        };
        let id = *ORDER.get(at % ORDER.len())?;
        let [a, b] = self.faults.silent;
        let silent = match channel {
            Channel::A => a,
            Channel::B => b,
        };
        if silent || self.faults.lacks == Some(id) {
            return None;
        }
        let message = if self.powered {
            self.measurement(id)?
        } else if id == 0x400 {
            Message::PowerbaseOff {
                rest: [0; 3],
                ui_battery: 398,
            }
        } else {
            return None;
        };
        Some((channel, message.frame()))
    }

    fn measurement(&self, id: u16) -> Option<Message> {
        let scales = self.config.model.scales();
        let speeds = self.speed().map(|speed| small(speed * scales.speed));
        let [left_m_s, right_m_s] = self.speed();
        let clockwise = (left_m_s - right_m_s) / self.config.track;
        let mut integrators = self.raw_integrators();
        for (value, offset) in integrators.iter_mut().zip(&self.offsets) {
            *value -= offset;
        }
        let [right, left, yaw, forward] = integrators.map(wrapped);
        Some(match id {
            0x400 => Message::Build {
                build: 0x7F0,
                rest: [0; 2],
                counter: self.counter,
            },
            0x401 => Message::Attitude {
                pitch: 0,
                pitch_rate: 0,
                roll: 0,
                roll_rate: 0,
            },
            0x402 => Message::Speed {
                left: speeds[0],
                right: speeds[1],
                yaw_rate: small(clockwise.to_degrees() * COUNTS_PER_DEGREE),
                frames: self.frames,
            },
            0x403 => Message::Wheels { left, right },
            0x404 => Message::Travel { forward, yaw },
            0x405 => Message::Torque {
                left: 0,
                right: 0,
                rest: [0x80, 0],
            },
            0x406 => Message::Operation {
                mode: self.mode,
                gain: self.gain,
                ui_battery: 398,
                battery: 304,
            },
            0x407 => Message::Echo {
                velocity: self.command[0],
                turn: self.command[1],
                rest: [0; 2],
            },
            0x680 => Message::ControlUnit(self.unit()),
            0x688 => Message::Heartbeat {
                rest: [0; 2],
                ui_battery: 398,
                status: 0,
            },
            _ => return None,
        })
    }

    fn unit(&self) -> ControlUnit {
        let enabled = self.mode == Mode::Tractor && !self.faults.emergency_stop;
        let motors = if enabled {
            StatusWord1::MOTORS_ENABLED.0
        } else {
            0
        };
        let open = if self.faults.emergency_stop {
            StatusWord2::EMERGENCY_STOP_A.0 | StatusWord2::EMERGENCY_STOP_B.0
        } else {
            0
        };
        ControlUnit {
            mode: self.mode.raw(),
            word1: StatusWord1(motors | self.faults.word1),
            word2: StatusWord2(open),
            counter: self.counter,
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "saturates, as the device does"
)]
fn small(value: f64) -> i16 {
    value.round() as i16
}

/// A count in 32 bits, which wrap.
#[expect(
    clippy::cast_possible_truncation,
    reason = "wrapping is what the device does"
)]
fn wrapped(value: f64) -> i32 {
    value.floor() as i64 as i32
}

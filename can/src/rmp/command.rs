//! Commands of a host to a power base: frame 413h with velocity, turn and one configuration, and 412h for shutdown.
//!
//! | bytes | content |
//! |---|---|
//! | 0-1 | velocity, -1176 to 1176 counts |
//! | 2-3 | turn, -1024 to 1024 counts |
//! | 4-5 | configuration: item |
//! | 6-7 | configuration: value |
//!
//! Every value is big-endian.

use std::fmt;

use super::status::{slots, standard};
use crate::{Frame, Id};

/// Maximum velocity, counts.
pub(super) const VELOCITY_MAX: i16 = 1176;
/// Maximum turn, counts.
pub(super) const TURN_MAX: i16 = 1024;
/// Full scale; 8 halves the value of a count.
pub(super) const SCALE_MAX: u8 = 16;
/// Full current limit.
pub(super) const CURRENT_MAX: u16 = 256;

const COMMAND_ID: Id = standard(0x413);
const SHUTDOWN_ID: Id = standard(0x412);

/// Shutdown frame: only the power switch turns the power base on again.
pub const SHUTDOWN: Frame = Frame::full(SHUTDOWN_ID, [0; 8]);

/// Operational mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Motors off.
    #[default]
    Disabled,
    /// Statically stable on more than two wheels.
    Tractor,
    /// Balancing.
    Balance,
    /// Powering down.
    PowerDown,
    /// Unknown.
    Other(u16),
}

impl Mode {
    /// Decodes the mode.
    pub const fn from_raw(raw: u16) -> Self {
        match raw {
            0 => Self::Disabled,
            1 => Self::Tractor,
            2 => Self::Balance,
            3 => Self::PowerDown,
            raw => Self::Other(raw),
        }
    }

    /// Its code.
    pub const fn raw(self) -> u16 {
        match self {
            Self::Disabled => 0,
            Self::Tractor => 1,
            Self::Balance => 2,
            Self::PowerDown => 3,
            Self::Other(raw) => raw,
        }
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Disabled => f.write_str("disabled"),
            Self::Tractor => f.write_str("tractor"),
            Self::Balance => f.write_str("balance"),
            Self::PowerDown => f.write_str("power down"),
            Self::Other(raw) => write!(f, "mode {raw}"),
        }
    }
}

/// Gain schedule, by payload.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Gain {
    /// Light load.
    #[default]
    Light,
    /// Tall load.
    Tall,
    /// Heavy load.
    Heavy,
    /// Unknown.
    Other(u16),
}

impl Gain {
    /// Decodes the schedule.
    pub const fn from_raw(raw: u16) -> Self {
        match raw {
            0 => Self::Light,
            1 => Self::Tall,
            2 => Self::Heavy,
            raw => Self::Other(raw),
        }
    }

    /// Its code.
    pub const fn raw(self) -> u16 {
        match self {
            Self::Light => 0,
            Self::Tall => 1,
            Self::Heavy => 2,
            Self::Other(raw) => raw,
        }
    }
}

/// A set of the four displacement integrators.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Integrators(pub u8);

impl Integrators {
    /// Right wheel.
    pub const RIGHT: Self = Self(1);
    /// Left wheel.
    pub const LEFT: Self = Self(2);
    /// Yaw.
    pub(crate) const YAW: Self = Self(4);
    /// Fore and aft.
    pub(crate) const FORE_AFT: Self = Self(8);
    /// All of them.
    pub const ALL: Self = Self(15);

    /// Whether it contains all of `others`.
    pub const fn contains(self, others: Self) -> bool {
        self.0 & others.0 == others.0
    }
}

/// Configuration part of a command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Config {
    /// Nothing.
    #[default]
    None,
    /// Scale of velocities, sixteenths; stored in the device, also while it is off.
    MaxVelocity(u8),
    /// Scale of accelerations, sixteenths.
    MaxAcceleration(u8),
    /// Scale of turns, sixteenths.
    MaxTurn(u8),
    /// Gain schedule.
    Gain(Gain),
    /// Current limit, 0 to 256.
    CurrentLimit(u16),
    /// Balance lockout.
    BalanceLockout(bool),
    /// Operational mode.
    Mode(Mode),
    /// Reset displacement integrators.
    ResetIntegrators(Integrators),
    /// Unknown.
    Other {
        /// Item.
        code: u16,
        /// Value.
        value: u16,
    },
}

impl Config {
    /// Decodes the slots. Some hosts repeat 8-bit values in the upper byte, which is ignored.
    pub fn from_raw(code: u16, value: u16) -> Self {
        let low = value.to_be_bytes()[1];
        match code {
            0 if value == 0 => Self::None,
            10 => Self::MaxVelocity(low),
            11 => Self::MaxAcceleration(low),
            12 => Self::MaxTurn(low),
            13 => Self::Gain(Gain::from_raw(u16::from(low))),
            14 => Self::CurrentLimit(value),
            15 => Self::BalanceLockout(low != 0),
            16 => Self::Mode(Mode::from_raw(u16::from(low))),
            50 => Self::ResetIntegrators(Integrators(low)),
            code => Self::Other { code, value },
        }
    }

    /// Its slots.
    pub fn raw(self) -> (u16, u16) {
        match self {
            Self::None => (0, 0),
            Self::MaxVelocity(scale) => (10, scale.into()),
            Self::MaxAcceleration(scale) => (11, scale.into()),
            Self::MaxTurn(scale) => (12, scale.into()),
            Self::Gain(gain) => (13, gain.raw()),
            Self::CurrentLimit(limit) => (14, limit),
            Self::BalanceLockout(locked) => (15, locked.into()),
            Self::Mode(mode) => (16, mode.raw()),
            Self::ResetIntegrators(which) => (50, which.0.into()),
            Self::Other { code, value } => (code, value),
        }
    }
}

impl fmt::Display for Config {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.write_str("no configuration"),
            Self::MaxVelocity(scale) => write!(f, "velocity scale {scale}/16"),
            Self::MaxAcceleration(scale) => write!(f, "acceleration scale {scale}/16"),
            Self::MaxTurn(scale) => write!(f, "turn scale {scale}/16"),
            Self::Gain(gain) => write!(f, "gain schedule {}", gain.raw()),
            Self::CurrentLimit(limit) => write!(f, "current limit {limit}/256"),
            Self::BalanceLockout(locked) => write!(f, "balance lockout {locked}"),
            Self::Mode(mode) => write!(f, "request {mode}"),
            Self::ResetIntegrators(which) => write!(f, "reset integrators {:#06b}", which.0),
            Self::Other { code, value } => write!(f, "configuration {code} = {value}"),
        }
    }
}

/// Frame 413h. Motion and configuration both apply.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Command {
    /// Velocity, counts; forward is positive.
    pub velocity: i16,
    /// Turn, counts; clockwise is positive.
    pub turn: i16,
    /// Configuration.
    pub config: Config,
}

impl Command {
    /// Decodes a command; `None` for other frames.
    pub fn decode(frame: &Frame) -> Option<Self> {
        if frame.id() != COMMAND_ID {
            return None;
        }
        let [velocity, turn, code, value] = slots(frame)?;
        Some(Self {
            velocity: velocity.cast_signed(),
            turn: turn.cast_signed(),
            config: Config::from_raw(code, value),
        })
    }

    /// Encodes the command.
    pub fn frame(self) -> Frame {
        let (code, value) = self.config.raw();
        let [velocity, turn] = [self.velocity, self.turn].map(i16::cast_unsigned);
        super::status::frame(COMMAND_ID, [velocity, turn, code, value])
    }
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "command velocity {} turn {}", self.velocity, self.turn)?;
        if self.config == Config::None {
            return Ok(());
        }
        write!(f, ", {}", self.config)
    }
}

/// Whether a frame is the shutdown command. The user interface uses the same identifier while the power base is off,
/// but never with all zeros.
pub(super) fn is_shutdown(frame: &Frame) -> bool {
    *frame == SHUTDOWN
}

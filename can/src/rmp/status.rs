//! Messages of a power base, sent every 10 ms, one per identifier. Four big-endian slots of 16 bits; a 32-bit value has
//! its lower half in the first slot. Values are counts; their scale depends on the model ([`super::Scales`]).
//!
//! | identifier | slots |
//! |---|---|
//! | 400h | build, -, -, counter |
//! | 401h | pitch, pitch rate, roll, roll rate |
//! | 402h | left speed, right speed, yaw rate (clockwise positive), time in 10 ms |
//! | 403h | left displacement, right displacement |
//! | 404h | displacement forward, yaw displacement |
//! | 405h | left torque, right torque, -, - |
//! | 406h | operational mode, gain schedule, battery of the interface, battery of the base |
//! | 407h | velocity command, turn command in effect, -, - |
//! | 680h | controller mode, status word 1, status word 2, counter |
//! | 688h | heartbeat of the user interface: -, -, battery, status |
//! | 412h | while the power base is off: -, -, battery of the interface, - |
//! | 414h | a message of the user interface |

use std::fmt;

use super::command::{Command, Gain, Mode, is_shutdown};
use crate::{Frame, Id};

/// The 11-bit identifier in the lower bits of a number.
#[expect(clippy::unreachable, reason = "eleven bits always fit")]
pub(super) const fn standard(raw: u16) -> Id {
    match Id::standard(raw & 0x7FF) {
        Ok(id) => id,
        Err(_) => unreachable!(),
    }
}

/// The four slots of a frame of eight bytes.
pub(super) fn slots(frame: &Frame) -> Option<[u16; 4]> {
    let (pairs, rest) = frame.data().as_chunks::<2>();
    let [a, b, c, d] = pairs else { return None };
    rest.is_empty()
        .then(|| [a, b, c, d].map(|pair| u16::from_be_bytes(*pair)))
}

/// The frame of four slots.
pub(super) fn frame(id: Id, slots: [u16; 4]) -> Frame {
    let [[a, b], [c, d], [e, f], [g, h]] = slots.map(u16::to_be_bytes);
    Frame::full(id, [a, b, c, d, e, f, g, h])
}

fn wide(low: u16, high: u16) -> i32 {
    (u32::from(high) << 16 | u32::from(low)).cast_signed()
}

fn narrow(value: i32) -> [u16; 2] {
    let [a, b, c, d] = value.to_be_bytes();
    [u16::from_be_bytes([c, d]), u16::from_be_bytes([a, b])]
}

/// Status word 1 of 680h.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StatusWord1(pub u16);

impl StatusWord1 {
    /// Motors are enabled.
    pub(crate) const MOTORS_ENABLED: Self = Self(0x0080);
    /// It balances.
    pub const BALANCE: Self = Self(0x0100);

    const NAMES: [(u16, &'static str); 14] = [
        (0x0001, "safety shutdown 1"),
        (0x0004, "safety shutdown 2"),
        (0x0008, "disable response"),
        (0x0010, "limited to 4 mph"),
        (0x0020, "limited to standstill"),
        (0x0040, "integrity fault"),
        (0x0080, "motors enabled"),
        (0x0100, "balancing"),
        (0x0200, "yaw transient"),
        (0x0400, "empty battery hazard"),
        (0x1000, "wheel slip"),
        (0x2000, "motor feedback fault"),
        (0x4000, "low battery hazard"),
        (0x0002, "bit 1"),
    ];

    /// Whether all bits of `other` are set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Names of the bits that are set.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        Self::NAMES
            .into_iter()
            .filter(move |(bit, _)| self.0 & bit != 0)
            .map(|(_, name)| name)
    }

    /// Names of the set bits that prevent motion.
    pub fn faults(self) -> impl Iterator<Item = &'static str> {
        const HINDERING: u16 = 0x0001 | 0x0004 | 0x0008 | 0x0020 | 0x0040 | 0x2000;
        Self(self.0 & HINDERING).names()
    }
}

/// Status word 2 of 680h: control board A in the lower byte, B in the upper.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StatusWord2(pub u16);

impl StatusWord2 {
    /// Emergency stop open, seen by board A.
    pub(crate) const EMERGENCY_STOP_A: Self = Self(0x0002);
    /// Emergency stop open, seen by board B.
    pub(crate) const EMERGENCY_STOP_B: Self = Self(0x0200);

    const NAMES: [&'static str; 8] = [
        "pitch limit",
        "emergency stop open",
        "position error limit",
        "velocity limit",
        "battery empty",
        "battery temperature",
        "roll limit",
        "low bus voltage",
    ];

    /// Names of the bits that either board has set.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        let [b, a] = self.0.to_be_bytes();
        let either = a | b;
        Self::NAMES
            .into_iter()
            .enumerate()
            .filter(move |(bit, _)| either >> bit & 1 != 0)
            .map(|(_, name)| name)
    }

    /// Whether either board sees the emergency stop open.
    pub const fn emergency_stop(self) -> bool {
        self.0 & (Self::EMERGENCY_STOP_A.0 | Self::EMERGENCY_STOP_B.0) != 0
    }
}

/// Content of 680h.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ControlUnit {
    /// Mode of the controller; the lower two bits are the mode of the hardware.
    pub mode: u16,
    /// Status word 1.
    pub word1: StatusWord1,
    /// Status word 2.
    pub word2: StatusWord2,
    /// Free-running counter.
    pub counter: u16,
}

impl ControlUnit {
    /// The mode of the hardware.
    pub(crate) const fn hardware_mode(&self) -> Mode {
        Mode::from_raw(self.mode & 3)
    }
}

/// A message of a power base, in counts. `rest` keeps unknown slots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Message {
    /// 400h.
    Build {
        /// Firmware build number.
        build: u16,
        /// Unknown slots.
        rest: [u16; 2],
        /// Counts the cycles, mostly by two.
        counter: u16,
    },
    /// 401h.
    Attitude {
        /// 7.8 counts per degree.
        pitch: i16,
        /// 7.8 counts per degree per second.
        pitch_rate: i16,
        /// 7.8 counts per degree.
        roll: i16,
        /// 7.8 counts per degree per second.
        roll_rate: i16,
    },
    /// 402h.
    Speed {
        /// Left wheel, [`super::Scales::speed`].
        left: i16,
        /// Right wheel.
        right: i16,
        /// 7.8 counts per degree per second, clockwise.
        yaw_rate: i16,
        /// Time of the device in frames of 10 ms; wraps after 655.36 s.
        frames: u16,
    },
    /// 403h.
    Wheels {
        /// Left wheel, [`super::Scales::displacement`].
        left: i32,
        /// Right wheel.
        right: i32,
    },
    /// 404h.
    Travel {
        /// Forward, [`super::Scales::displacement`].
        forward: i32,
        /// Yaw, [`super::Scales::yaw`].
        yaw: i32,
    },
    /// 405h.
    Torque {
        /// Left motor, [`super::Scales::torque`].
        left: i16,
        /// Right motor.
        right: i16,
        /// Unknown slots.
        rest: [u16; 2],
    },
    /// 406h.
    Operation {
        /// Operational mode.
        mode: Mode,
        /// Gain schedule.
        gain: Gain,
        /// Battery of the user interface, 1.4 V and 12.5 mV per count.
        ui_battery: u16,
        /// Battery of the power base, 0.25 V per count.
        battery: u16,
    },
    /// 407h.
    Echo {
        /// Velocity command in effect.
        velocity: i16,
        /// Turn command in effect.
        turn: i16,
        /// Unknown slots.
        rest: [u16; 2],
    },
    /// 680h.
    ControlUnit(ControlUnit),
    /// 688h.
    Heartbeat {
        /// Unknown slots.
        rest: [u16; 2],
        /// Battery of the user interface.
        ui_battery: u16,
        /// Bit 7: battery weak; bit 6: empty.
        status: u16,
    },
    /// 412h from the user interface: it is on and the power base is off.
    PowerbaseOff {
        /// Unknown slots.
        rest: [u16; 3],
        /// Battery of the user interface.
        ui_battery: u16,
    },
    /// 414h.
    Interface([u16; 4]),
    /// 413h, from a host.
    Command(Command),
    /// 412h with nothing in it, from a host.
    Shutdown,
}

impl Message {
    /// Decodes a message; `None` if it is not from a power base or its host.
    pub fn decode(frame: &Frame) -> Option<Self> {
        if frame.id().is_extended() || frame.is_remote() {
            return None;
        }
        let raw = slots(frame)?;
        let [a, b, c, d] = raw;
        let signed = raw.map(u16::cast_signed);
        Some(match frame.id().raw() {
            0x400 => Self::Build {
                build: a,
                rest: [b, c],
                counter: d,
            },
            0x401 => Self::Attitude {
                pitch: signed[0],
                pitch_rate: signed[1],
                roll: signed[2],
                roll_rate: signed[3],
            },
            0x402 => Self::Speed {
                left: signed[0],
                right: signed[1],
                yaw_rate: signed[2],
                frames: d,
            },
            0x403 => Self::Wheels {
                left: wide(a, b),
                right: wide(c, d),
            },
            0x404 => Self::Travel {
                forward: wide(a, b),
                yaw: wide(c, d),
            },
            0x405 => Self::Torque {
                left: signed[0],
                right: signed[1],
                rest: [c, d],
            },
            0x406 => Self::Operation {
                mode: Mode::from_raw(a),
                gain: Gain::from_raw(b),
                ui_battery: c,
                battery: d,
            },
            0x407 => Self::Echo {
                velocity: signed[0],
                turn: signed[1],
                rest: [c, d],
            },
            0x680 => Self::ControlUnit(ControlUnit {
                mode: a,
                word1: StatusWord1(b),
                word2: StatusWord2(c),
                counter: d,
            }),
            0x688 => Self::Heartbeat {
                rest: [a, b],
                ui_battery: c,
                status: d,
            },
            0x412 if is_shutdown(frame) => Self::Shutdown,
            0x412 => Self::PowerbaseOff {
                rest: [a, b, d],
                ui_battery: c,
            },
            0x413 => Self::Command(Command::decode(frame)?),
            0x414 => Self::Interface(raw),
            _ => return None,
        })
    }

    /// Encodes the message.
    pub fn frame(&self) -> Frame {
        let i = i16::cast_unsigned;
        let (id, slots) = match *self {
            Self::Build {
                build,
                rest: [b, c],
                counter,
            } => (0x400, [build, b, c, counter]),
            Self::Attitude {
                pitch,
                pitch_rate,
                roll,
                roll_rate,
            } => (0x401, [i(pitch), i(pitch_rate), i(roll), i(roll_rate)]),
            Self::Speed {
                left,
                right,
                yaw_rate,
                frames,
            } => (0x402, [i(left), i(right), i(yaw_rate), frames]),
            Self::Wheels { left, right } => (0x403, pair(left, right)),
            Self::Travel { forward, yaw } => (0x404, pair(forward, yaw)),
            Self::Torque {
                left,
                right,
                rest: [c, d],
            } => (0x405, [i(left), i(right), c, d]),
            Self::Operation {
                mode,
                gain,
                ui_battery,
                battery,
            } => (0x406, [mode.raw(), gain.raw(), ui_battery, battery]),
            Self::Echo {
                velocity,
                turn,
                rest: [c, d],
            } => (0x407, [i(velocity), i(turn), c, d]),
            Self::ControlUnit(unit) => {
                (0x680, [unit.mode, unit.word1.0, unit.word2.0, unit.counter])
            }
            Self::Heartbeat {
                rest: [a, b],
                ui_battery,
                status,
            } => (0x688, [a, b, ui_battery, status]),
            Self::PowerbaseOff {
                rest: [a, b, d],
                ui_battery,
            } => (0x412, [a, b, ui_battery, d]),
            Self::Interface(slots) => (0x414, slots),
            Self::Command(command) => return command.frame(),
            Self::Shutdown => return super::SHUTDOWN,
        };
        frame(standard(id), slots)
    }
}

fn pair(first: i32, second: i32) -> [u16; 4] {
    let ([a, b], [c, d]) = (narrow(first), narrow(second));
    [a, b, c, d]
}

impl fmt::Display for Message {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const DEGREE: f64 = super::model::COUNTS_PER_DEGREE;
        let degrees = |counts: i16| f64::from(counts) / DEGREE;
        match self {
            Self::Build { build, counter, .. } => write!(f, "build {build} counter {counter}"),
            Self::Attitude { pitch, roll, .. } => {
                write!(
                    f,
                    "pitch {:.1} roll {:.1} deg",
                    degrees(*pitch),
                    degrees(*roll)
                )
            }
            Self::Speed {
                left,
                right,
                yaw_rate,
                frames,
            } => write!(
                f,
                "speed left {left} right {right} counts, yaw rate {:.1} deg/s, {:.2} s",
                degrees(*yaw_rate),
                f64::from(*frames) / 100.0
            ),
            Self::Wheels { left, right } => {
                write!(f, "displacement left {left} right {right} counts")
            }
            Self::Travel { forward, yaw } => {
                write!(f, "displacement forward {forward} yaw {yaw} counts")
            }
            Self::Torque { left, right, .. } => {
                write!(f, "torque left {left} right {right} counts")
            }
            Self::Operation { mode, battery, .. } => {
                write!(f, "{mode}, battery {:.2} V", f64::from(*battery) / 4.0)
            }
            Self::Echo { velocity, turn, .. } => {
                write!(f, "understood velocity {velocity} turn {turn}")
            }
            Self::ControlUnit(unit) => {
                write!(f, "control unit {}", unit.hardware_mode())?;
                let names = unit.word1.names().chain(unit.word2.names());
                names.into_iter().try_for_each(|name| write!(f, ", {name}"))
            }
            Self::Heartbeat { .. } => f.write_str("user interface"),
            Self::PowerbaseOff { .. } => f.write_str("user interface on, power base off"),
            Self::Interface(_) => f.write_str("message of the user interface"),
            Self::Command(command) => command.fmt(f),
            Self::Shutdown => f.write_str("command shutdown"),
        }
    }
}

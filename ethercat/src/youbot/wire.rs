//! Process data of a youBot drive: five bytes out, 20 or 32 bytes in, little-endian. No state is kept here.
#![warn(clippy::indexing_slicing)]

use std::fmt;

use super::Firmware;

/// Mode of a [`Command`]: the meaning of its value (byte 4 of the outputs).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// The motor stops; the value is ignored.
    #[default]
    Stop,
    /// Encoder ticks to go to.
    Position,
    /// Motor revolutions per minute.
    Velocity,
    /// The previous command stays in force.
    NoAction,
    /// Sets the present position, ticks.
    SetPosition,
    /// Duty; firmware 1.48 only.
    Pwm,
    /// Motor current, mA.
    Current,
    /// Find the commutation; firmware 1.48 only.
    Initialize,
    /// Any other number.
    Other(u8),
}

impl Mode {
    /// The number on the wire.
    pub const fn raw(self) -> u8 {
        match self {
            Self::Stop => 0,
            Self::Position => 1,
            Self::Velocity => 2,
            Self::NoAction => 3,
            Self::SetPosition => 4,
            Self::Pwm => 5,
            Self::Current => 6,
            Self::Initialize => 7,
            Self::Other(raw) => raw,
        }
    }

    /// From the number on the wire.
    pub const fn from_raw(raw: u8) -> Self {
        match raw {
            0 => Self::Stop,
            1 => Self::Position,
            2 => Self::Velocity,
            3 => Self::NoAction,
            4 => Self::SetPosition,
            5 => Self::Pwm,
            6 => Self::Current,
            7 => Self::Initialize,
            other => Self::Other(other),
        }
    }
}

/// Outputs of a drive.
///
/// | bytes | meaning |
/// |---|---|
/// | 0..4 | value, i32 |
/// | 4 | mode |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Command {
    /// In the unit of its mode.
    pub value: i32,
    /// Meaning of the value.
    pub mode: Mode,
}

impl Command {
    /// Length, bytes.
    pub const LEN: usize = 5;
    /// Holds by the velocity loop: an arm does not sag, a wheel does not roll.
    pub const HOLD: Self = Self::velocity(0);

    /// Motor speed, rpm.
    pub const fn velocity(rpm: i32) -> Self {
        Self {
            value: rpm,
            mode: Mode::Velocity,
        }
    }

    /// Target position, ticks.
    pub const fn position(ticks: i32) -> Self {
        Self {
            value: ticks,
            mode: Mode::Position,
        }
    }

    /// Motor current, mA.
    pub const fn current(ma: i32) -> Self {
        Self {
            value: ma,
            mode: Mode::Current,
        }
    }

    /// Its bytes.
    #[must_use]
    pub const fn encode(self) -> [u8; Self::LEN] {
        let [a, b, c, d] = self.value.to_le_bytes();
        [a, b, c, d, self.mode.raw()]
    }

    /// From its bytes; `None` if too short.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let [a, b, c, d, mode] = *bytes.first_chunk()?;
        Some(Self {
            value: i32::from_le_bytes([a, b, c, d]),
            mode: Mode::from_raw(mode),
        })
    }
}

/// Flags of a drive, as in parameter 156.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags(pub u32);

impl Flags {
    /// The motor's current is above parameter 6.
    pub const OVER_CURRENT: u32 = 1;
    /// The emergency stop is pressed.
    pub(crate) const EMERGENCY_STOP: u32 = 1 << 12;
    /// The target position is reached.
    pub const POSITION_REACHED: u32 = 1 << 14;
    /// The commutation is known.
    pub const INITIALIZED: u32 = 1 << 15;
    /// No frames for longer than global parameter 90; latched until parameter 158 is written.
    pub const TIMEOUT: u32 = 1 << 16;
    /// Overload (I2t); latched until parameter 29 is written.
    pub const I2T: u32 = 1 << 17;
    /// Flags that keep a drive from executing commands, except timeout and I2t.
    pub const BLOCKING: u32 = 0b1110_1110 | Self::EMERGENCY_STOP;

    /// Whether any of these is set.
    pub const fn any(self, of: u32) -> bool {
        self.0 & of != 0
    }
}

/// Names of the flags by bit.
const NAMES: [&str; 18] = [
    "over-current",
    "under-voltage",
    "over-voltage",
    "over-temperature",
    "motor halted",
    "Hall sensor error",
    "encoder error",
    "sine initialization error",
    "PWM mode",
    "velocity mode",
    "position mode",
    "torque mode",
    "emergency stop",
    "free running",
    "position reached",
    "initialized",
    "EtherCAT time-out",
    "I2t exceeded",
];

impl fmt::Display for Flags {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let set = |bit: &usize| self.0 >> bit & 1 != 0;
        let mut first = true;
        for bit in (0..32).filter(set) {
            if !first {
                f.write_str(", ")?;
            }
            first = false;
            match NAMES.get(bit) {
                Some(name) => f.write_str(name)?,
                None => write!(f, "bit {bit}")?,
            }
        }
        if first {
            f.write_str("no flag")?;
        }
        Ok(())
    }
}

/// Targets reported by firmware 2.00.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Targets {
    /// Ticks.
    pub position: i32,
    /// mA.
    pub current_ma: i32,
    /// rpm.
    pub velocity_rpm: i32,
    /// Present velocity of the ramp, rpm.
    pub ramp_rpm: i32,
}

/// Inputs of a drive.
///
/// | bytes | firmware 1.48 | firmware 2.00 |
/// |---|---|---|
/// | 0..4 | position, ticks | the same |
/// | 4..8 | current, mA | the same |
/// | 8..12 | velocity, rpm | the same |
/// | 12..16 | flags | the same |
/// | 16..20 | duty | target position, ticks |
/// | 20..32 | | target current, target velocity, velocity of the ramp |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Feedback {
    /// Encoder position, ticks.
    pub position: i32,
    /// Current of the motor, mA.
    pub current_ma: i32,
    /// Speed of the motor, rpm.
    pub velocity_rpm: i32,
    /// Flags.
    pub flags: Flags,
    /// Duty, from firmware 1.48.
    pub duty: Option<i32>,
    /// Targets, from firmware 2.00.
    pub targets: Option<Targets>,
}

impl Feedback {
    /// From the inputs of a drive; `None` if too short for its firmware.
    pub fn decode(firmware: Firmware, bytes: &[u8]) -> Option<Self> {
        let word = |at: usize| {
            let four = bytes.get(4 * at..)?.first_chunk()?;
            Some(i32::from_le_bytes(*four))
        };
        let (duty, targets) = match firmware {
            Firmware::V148 => (Some(word(4)?), None),
            Firmware::V200 => {
                let targets = Targets {
                    position: word(4)?,
                    current_ma: word(5)?,
                    velocity_rpm: word(6)?,
                    ramp_rpm: word(7)?,
                };
                (None, Some(targets))
            }
        };
        Some(Self {
            position: word(0)?,
            current_ma: word(1)?,
            velocity_rpm: word(2)?,
            flags: Flags(word(3)?.cast_unsigned()),
            duty,
            targets,
        })
    }
}

#[cfg(test)]
#[expect(clippy::indexing_slicing, reason = "of bytes made by the test")]
mod tests {
    use super::*;

    /// Values recorded from the vendor's driver.
    #[test]
    fn commands_match_bytes_of_the_vendor_driver() {
        for (command, bytes) in [
            (Command::velocity(-1039), [0xF1, 0xFB, 0xFF, 0xFF, 2]),
            (Command::velocity(1039), [0x0F, 0x04, 0, 0, 2]),
            (Command::velocity(1000), [0xE8, 0x03, 0, 0, 2]),
            (Command::velocity(-100), [0x9C, 0xFF, 0xFF, 0xFF, 2]),
            (Command::current(0), [0, 0, 0, 0, 6]),
            (Command::velocity(156), [0x9C, 0, 0, 0, 2]),
            (Command::position(-99_313), [0x0F, 0x7C, 0xFE, 0xFF, 1]),
        ] {
            assert_eq!(command.encode(), bytes, "{command:?}");
            assert_eq!(Command::decode(&bytes), Some(command));
        }
        assert_eq!(Command::decode(&[0; 4]), None);
    }

    #[test]
    fn every_mode_survives() {
        for raw in 0..=255 {
            assert_eq!(Mode::from_raw(raw).raw(), raw);
        }
    }

    #[test]
    fn both_layouts_are_read_and_short_ones_refused() {
        let bytes: Vec<u8> = (1..=8_i32).flat_map(|n| (-n).to_le_bytes()).collect();
        let old = Feedback::decode(Firmware::V148, &bytes[..20]).unwrap();
        let new = Feedback::decode(Firmware::V200, &bytes).unwrap();
        assert_eq!(
            (old.position, old.current_ma, old.velocity_rpm),
            (-1, -2, -3)
        );
        assert_eq!(
            (old.flags.0, old.duty, old.targets),
            (0xFFFF_FFFC, Some(-5), None)
        );
        assert_eq!((new.position, new.duty), (-1, None));
        let targets = new.targets.unwrap();
        assert_eq!((targets.position, targets.current_ma), (-5, -6));
        assert_eq!((targets.velocity_rpm, targets.ramp_rpm), (-7, -8));
        assert_eq!(Feedback::decode(Firmware::V148, &bytes[..19]), None);
        assert_eq!(Feedback::decode(Firmware::V200, &bytes[..31]), None);
        for firmware in [Firmware::V148, Firmware::V200] {
            let len = usize::from(firmware.inputs_len());
            assert_eq!(Firmware::of_inputs(len), Some(firmware));
        }
        assert_eq!(Firmware::of_inputs(18), None);
    }

    #[test]
    fn flags_are_shown_by_name() {
        assert_eq!(Flags(0).to_string(), "no flag");
        let flags = Flags(Flags::TIMEOUT | Flags::I2T | 1 << 30);
        assert_eq!(flags.to_string(), "EtherCAT time-out, I2t exceeded, bit 30");
        assert!(flags.any(Flags::I2T) && !flags.any(Flags::BLOCKING));
        assert!(
            Flags(1 << 3).any(Flags::BLOCKING),
            "over-temperature blocks"
        );
        assert!(
            !Flags(1).any(Flags::BLOCKING),
            "over-current alone does not"
        );
        assert!(
            !Flags(1 << 4).any(Flags::BLOCKING),
            "nor does standing still"
        );
    }
}

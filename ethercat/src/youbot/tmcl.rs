//! TMCL over the raw mailbox: eight bytes each way, values big-endian. The parameters are in [`super::parameters`]; the
//! mailbox transports requests.
#![warn(clippy::indexing_slicing)]

use super::Firmware;

/// The drive itself.
const DRIVE: u8 = 0;
/// The gripper behind the last joint.
const GRIPPER: u8 = 1;

const MST: u8 = 3;
const MVP: u8 = 4;
const SAP: u8 = 5;
const GAP: u8 = 6;
const STAP: u8 = 7;
const SGP: u8 = 9;
const GGP: u8 = 10;
const FIRMWARE: u8 = 136;

/// Status of success.
const OK: u8 = 100;

/// A request. All requests may be repeated: none is relative to previous values.
///
/// | byte | meaning |
/// |---|---|
/// | 0 | module: 0 the drive, 1 the gripper |
/// | 1 | command |
/// | 2 | type: parameter, or kind of motion |
/// | 3 | motor, or bank of a global parameter |
/// | 4..8 | value, big-endian |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    module: u8,
    command: u8,
    kind: u8,
    motor: u8,
    value: i32,
}

impl Request {
    /// Length, bytes.
    pub const LEN: usize = 8;

    const fn new(module: u8, command: u8, kind: u8, motor: u8, value: i32) -> Self {
        Self {
            module,
            command,
            kind,
            motor,
            value,
        }
    }

    /// Requests the firmware name (136).
    pub const fn firmware() -> Self {
        Self::new(DRIVE, FIRMWARE, 0, 0, 0)
    }

    /// Reads an axis parameter (GAP).
    pub const fn get(number: u8) -> Self {
        Self::new(DRIVE, GAP, number, 0, 0)
    }

    /// Writes an axis parameter (SAP).
    pub const fn set(number: u8, value: i32) -> Self {
        Self::new(DRIVE, SAP, number, 0, value)
    }

    /// Stores an axis parameter permanently (STAP).
    pub const fn store(number: u8) -> Self {
        Self::new(DRIVE, STAP, number, 0, 0)
    }

    /// Reads a global parameter (GGP).
    pub const fn get_global(bank: u8, number: u8) -> Self {
        Self::new(DRIVE, GGP, number, bank, 0)
    }

    /// Writes a global parameter (SGP).
    pub(crate) const fn set_global(bank: u8, number: u8, value: i32) -> Self {
        Self::new(DRIVE, SGP, number, bank, value)
    }

    /// Reads a parameter of a bar of the gripper, 0 or 1.
    pub(crate) const fn get_bar(bar: u8, number: u8) -> Self {
        Self::new(GRIPPER, GAP, number, bar, 0)
    }

    /// Writes a parameter of a bar of the gripper.
    pub(crate) const fn set_bar(bar: u8, number: u8, value: i32) -> Self {
        Self::new(GRIPPER, SAP, number, bar, value)
    }

    /// Moves a bar of the gripper to a position (MVP ABS), steps.
    pub(crate) const fn move_bar(bar: u8, steps: i32) -> Self {
        Self::new(GRIPPER, MVP, 0, bar, steps)
    }

    /// Stops a bar of the gripper (MST).
    pub(crate) const fn stop_bar(bar: u8) -> Self {
        Self::new(GRIPPER, MST, 0, bar, 0)
    }

    /// Its bytes.
    #[must_use]
    pub const fn encode(self) -> [u8; Self::LEN] {
        let [a, b, c, d] = self.value.to_be_bytes();
        [self.module, self.command, self.kind, self.motor, a, b, c, d]
    }

    /// Decodes the answer: `reply address | module | status | command | value`; the firmware's name is eight letters
    /// instead.
    ///
    /// # Errors
    /// [`TmclError::Foreign`] if it is not an answer to this request, else the error of the drive.
    pub fn answer(self, bytes: &[u8]) -> Result<Answer, TmclError> {
        let Some(eight) = bytes.first_chunk::<8>() else {
            return Err(TmclError::Foreign);
        };
        if self.command == FIRMWARE {
            let version = Version::decode(*eight).ok_or(TmclError::Foreign)?;
            return Ok(Answer::Version(version));
        }
        let [_, module, status, command, a, b, c, d] = *eight;
        let value = i32::from_be_bytes([a, b, c, d]);
        let writes = matches!(self.command, SAP | SGP | MVP | MST);
        if module != self.module || command != self.command {
            return Err(TmclError::Foreign);
        }
        if status != OK {
            return Err(TmclError::of_status(status));
        }
        if writes && value != self.value {
            return Err(TmclError::Foreign);
        }
        Ok(Answer::Value(value))
    }
}

/// The answer of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// The value of a parameter, as read or written.
    Value(i32),
    /// The firmware.
    Version(Version),
}

impl Answer {
    /// The value, if it is one.
    pub const fn value(self) -> Option<i32> {
        match self {
            Self::Value(value) => Some(value),
            Self::Version(_) => None,
        }
    }
}

/// Why a request failed: the status byte of a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TmclError {
    /// 2.
    #[error("the drive has no such command (status 2)")]
    Command,
    /// 3.
    #[error("the drive has no such parameter, or it cannot be written (status 3)")]
    Type,
    /// 4.
    #[error("the value is out of range (status 4)")]
    Value,
    /// 5.
    #[error("the EEPROM is locked (status 5)")]
    Locked,
    /// 6.
    #[error("the command is not available now (status 6)")]
    Unavailable,
    /// 8.
    #[error("the parameter is protected (status 8); unlock it by parameter 248 first")]
    Protected,
    /// Any other.
    #[error("the drive refuses (status {0})")]
    Other(u8),
    /// The reply belongs to another request, or is invalid.
    #[error("the reply is not to this request")]
    Foreign,
}

impl TmclError {
    const fn of_status(status: u8) -> Self {
        match status {
            2 => Self::Command,
            3 => Self::Type,
            4 => Self::Value,
            5 => Self::Locked,
            6 => Self::Unavailable,
            8 => Self::Protected,
            other => Self::Other(other),
        }
    }
}

/// The firmware version, such as `1610V200`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Version {
    /// Number of the board, such as 1610 for a joint, 1632 for a wheel.
    pub board: u16,
    /// Version times 100.
    pub number: u16,
}

impl Version {
    fn decode(bytes: [u8; 8]) -> Option<Self> {
        let text = std::str::from_utf8(&bytes).ok()?;
        let (board, number) = text.split_once(['V', 'v'])?;
        Some(Self {
            board: board.trim().parse().ok()?,
            number: number.trim_end_matches('\0').trim().parse().ok()?,
        })
    }

    /// Its process data and commutation; `None` if unknown.
    pub const fn firmware(self) -> Option<Firmware> {
        match self.number {
            148 => Some(Firmware::V148),
            200..=299 => Some(Firmware::V200),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_have_the_bytes_of_the_protocol() {
        for (request, bytes) in [
            (Request::firmware(), [0, 136, 0, 0, 0, 0, 0, 0]),
            (Request::get(15), [0, 6, 15, 0, 0, 0, 0, 0]),
            (Request::set(158, 1), [0, 5, 158, 0, 0, 0, 0, 1]),
            (Request::store(11), [0, 7, 11, 0, 0, 0, 0, 0]),
            (Request::get_global(2, 16), [0, 10, 16, 2, 0, 0, 0, 0]),
            (Request::set_global(2, 16, 1), [0, 9, 16, 2, 0, 0, 0, 1]),
            (Request::get_bar(1, 8), [1, 6, 8, 1, 0, 0, 0, 0]),
            (Request::set_bar(0, 174, 50), [1, 5, 174, 0, 0, 0, 0, 50]),
            (
                Request::move_bar(1, -66_000),
                [1, 4, 0, 1, 0xFF, 0xFE, 0xFE, 0x30],
            ),
        ] {
            assert_eq!(request.encode(), bytes);
        }
    }

    #[test]
    fn tmcl_answers_are_decoded() {
        let set = Request::set(6, 1000);
        let get = Request::get(6);
        let of = |status, command| [0, 0, status, command, 0, 0, 3, 0xE8];
        for (request, bytes, answer) in [
            (set, of(100, 5), Ok(Answer::Value(1000))),
            (get, of(100, 6), Ok(Answer::Value(1000))),
            (set, of(100, 6), Err(TmclError::Foreign)),
            (Request::set(6, 999), of(100, 5), Err(TmclError::Foreign)),
            (get, of(2, 6), Err(TmclError::Command)),
            (get, of(3, 6), Err(TmclError::Type)),
            (set, of(4, 5), Err(TmclError::Value)),
            (set, of(5, 5), Err(TmclError::Locked)),
            (set, of(6, 5), Err(TmclError::Unavailable)),
            (set, of(8, 5), Err(TmclError::Protected)),
            (set, of(77, 5), Err(TmclError::Other(77))),
            (Request::get_bar(0, 6), of(100, 6), Err(TmclError::Foreign)),
        ] {
            assert_eq!(request.answer(&bytes), answer, "{request:?} {bytes:?}");
        }
        assert_eq!(get.answer(&[0; 7]), Err(TmclError::Foreign));
    }

    #[test]
    fn firmware_version_is_parsed_from_its_name() {
        let of = |text: &[u8; 8]| Request::firmware().answer(text);
        for (text, board, number, firmware) in [
            (b"1610V148", 1610, 148, Some(Firmware::V148)),
            (b"1632V200", 1632, 200, Some(Firmware::V200)),
            (b"0841V148", 841, 148, Some(Firmware::V148)),
            (b"1610V132", 1610, 132, None),
        ] {
            let version = Version { board, number };
            assert_eq!(of(text), Ok(Answer::Version(version)));
            assert_eq!(version.firmware(), firmware);
        }
        for text in [b"1610x200", b"V2000000", b"\xFF\xFF\xFF\xFFV200"] {
            assert_eq!(of(text), Err(TmclError::Foreign));
        }
    }
}

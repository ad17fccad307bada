//! TMCL over the raw mailbox: eight bytes each way, values big-endian. Parameters are handled by the drive.

/// A request: `module | command | type | motor or bank | value`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Request {
    /// 0 the drive, 1 the gripper.
    pub(super) module: u8,
    pub(super) command: u8,
    pub(super) kind: u8,
    /// Motor, or bank of a global parameter.
    pub(super) motor: u8,
    pub(super) value: i32,
}

impl Request {
    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        let [module, command, kind, motor, value @ ..] = *bytes.first_chunk::<8>()?;
        Some(Self {
            module,
            command,
            kind,
            motor,
            value: i32::from_be_bytes(value),
        })
    }
}

/// Commands.
pub(super) mod command {
    /// Rotate right with a speed.
    pub(in super::super) const ROR: u8 = 1;
    /// Rotate left with a speed.
    pub(in super::super) const ROL: u8 = 2;
    /// Stop.
    pub(in super::super) const MST: u8 = 3;
    /// Move to a position: type 0 absolute, 1 relative.
    pub(in super::super) const MVP: u8 = 4;
    /// Set an axis parameter.
    pub(in super::super) const SAP: u8 = 5;
    /// Get an axis parameter.
    pub(in super::super) const GAP: u8 = 6;
    /// Store an axis parameter.
    pub(in super::super) const STAP: u8 = 7;
    /// Restore an axis parameter.
    pub(in super::super) const RSAP: u8 = 8;
    /// Set a global parameter.
    pub(in super::super) const SGP: u8 = 9;
    /// Get a global parameter.
    pub(in super::super) const GGP: u8 = 10;
    /// Store a global parameter.
    pub(in super::super) const STGP: u8 = 11;
    /// Restore a global parameter.
    pub(in super::super) const RSGP: u8 = 12;
    /// Report the firmware version as text.
    pub(in super::super) const FIRMWARE: u8 = 136;
}

/// Why a command was rejected: the status byte of a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Rejection {
    InvalidCommand = 2,
    WrongType = 3,
    InvalidValue = 4,
    WriteProtected = 8,
}

/// Status of a successful command.
const OK: u8 = 100;

/// A reply: `reply address | module | status | command | value`.
pub(super) fn reply(request: &Request, done: Result<i32, Rejection>) -> [u8; 8] {
    let (status, value) = match done {
        Ok(value) => (OK, value),
        Err(rejection) => (rejection as u8, request.value),
    };
    let [a, b, c, d] = value.to_be_bytes();
    [0, request.module, status, request.command, a, b, c, d]
}

//! The states of a slave's application layer and its status codes (ETG.1000.6, clause 6.4; codes in ETG.1020). The
//! checks during state changes are not here.

use std::fmt;

/// A state of the application layer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum AlState {
    /// Neither mailbox nor process data.
    #[default]
    Init,
    /// Mailbox.
    PreOp,
    /// Firmware download.
    Boot,
    /// Mailbox and inputs.
    SafeOp,
    /// Mailbox, inputs and outputs.
    Op,
    /// Any other, as received.
    Other(u8),
}

impl AlState {
    /// The four bits on the wire.
    pub const fn raw(self) -> u8 {
        match self {
            Self::Init => 1,
            Self::PreOp => 2,
            Self::Boot => 3,
            Self::SafeOp => 4,
            Self::Op => 8,
            Self::Other(raw) => raw,
        }
    }

    /// From the lowest four bits.
    pub const fn from_raw(raw: u8) -> Self {
        match raw & 0x0F {
            1 => Self::Init,
            2 => Self::PreOp,
            3 => Self::Boot,
            4 => Self::SafeOp,
            8 => Self::Op,
            other => Self::Other(other),
        }
    }
}

impl fmt::Display for AlState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Init => f.write_str("INIT"),
            Self::PreOp => f.write_str("PRE-OP"),
            Self::Boot => f.write_str("BOOT"),
            Self::SafeOp => f.write_str("SAFE-OP"),
            Self::Op => f.write_str("OP"),
            Self::Other(raw) => write!(f, "state {raw}"),
        }
    }
}

/// AL status (0130h), and AL control (0120h), which has the same bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AlStatus {
    /// The actual or requested state.
    pub state: AlState,
    /// In AL status: the slave left a state or refused one. In AL control: acknowledges the error.
    pub error: bool,
}

impl AlStatus {
    /// From the word on the wire.
    pub const fn from_raw(raw: u16) -> Self {
        let [low, _] = raw.to_le_bytes();
        Self {
            state: AlState::from_raw(low),
            error: low & 0x10 != 0,
        }
    }

    /// The word on the wire.
    pub fn raw(self) -> u16 {
        u16::from(self.state.raw()) | u16::from(self.error) << 4
    }
}

impl fmt::Display for AlStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let error = if self.error { " + error" } else { "" };
        write!(f, "{}{error}", self.state)
    }
}

/// AL status code (0134h).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct AlStatusCode(pub u16);

/// Code, text, probable cause and what to do.
const CODES: [(u16, &str, &str); 42] = [
    (0x0000, "no error", "nothing is wrong"),
    (0x0001, "unspecified error", "see the slave's own diagnosis"),
    (
        0x0002,
        "no memory",
        "the slave cannot take such a configuration; map less",
    ),
    (
        0x0003,
        "invalid device set-up",
        "modules differ from those configured",
    ),
    (
        0x0006,
        "SII and firmware do not match",
        "the slave's EEPROM belongs to another firmware",
    ),
    (
        0x0011,
        "invalid requested state change",
        "go up one state at a time",
    ),
    (
        0x0012,
        "unknown requested state",
        "the master requested an unknown state",
    ),
    (
        0x0013,
        "bootstrap not supported",
        "the slave has no firmware download",
    ),
    (0x0014, "no valid firmware", "load a firmware"),
    (
        0x0015,
        "invalid mailbox configuration in BOOT",
        "take the bootstrap mailbox from the SII",
    ),
    (
        0x0016,
        "invalid mailbox configuration",
        "SyncManager 0 and 1 differ from the SII",
    ),
    (
        0x0017,
        "invalid SyncManager configuration",
        "compare SyncManagers with SII and ESI",
    ),
    (
        0x0018,
        "no valid inputs",
        "the slave has no input data yet; see its supply and sensors",
    ),
    (
        0x0019,
        "no valid outputs",
        "no process data with outputs arrived; is the cycle running?",
    ),
    (
        0x001A,
        "synchronisation error",
        "process data too late or irregular; see jitter and DC phase",
    ),
    (
        0x001B,
        "SyncManager watchdog",
        "no outputs within the watchdog time; see cycle and cable",
    ),
    (
        0x001C,
        "invalid SyncManager types",
        "mailbox and process data are mixed up",
    ),
    (
        0x001D,
        "invalid output configuration",
        "length of SyncManager 2 and the sum of 1C12h differ, or 1C12h lists PDOs that may not be assigned together",
    ),
    (
        0x001E,
        "invalid input configuration",
        "length of SyncManager 3 and the sum of 1C13h differ, or 1C13h lists PDOs that may not be assigned together",
    ),
    (
        0x001F,
        "invalid watchdog configuration",
        "the watchdog time is not allowed",
    ),
    (
        0x0020,
        "slave needs a cold start",
        "switch its power off and on",
    ),
    (0x0021, "slave needs INIT", "go to INIT first"),
    (0x0022, "slave needs PRE-OP", "go to PRE-OP first"),
    (0x0023, "slave needs SAFE-OP", "go to SAFE-OP first"),
    (
        0x0024,
        "invalid input mapping",
        "an object in 1A00h and following cannot be mapped",
    ),
    (
        0x0025,
        "invalid output mapping",
        "an object in 1600h and following cannot be mapped",
    ),
    (
        0x0026,
        "inconsistent settings",
        "two settings contradict each other; see its manual",
    ),
    (
        0x0027,
        "free run not supported",
        "configure DC or SyncManager synchronisation",
    ),
    (
        0x0028,
        "synchronisation not supported",
        "another sync type in 1C32h is needed",
    ),
    (
        0x0029,
        "free run needs three-buffer mode",
        "SyncManagers must have three buffers",
    ),
    (
        0x002B,
        "no valid inputs and outputs",
        "the process data never ran; is the cycle running?",
    ),
    (
        0x002C,
        "fatal synchronisation error",
        "SYNC0 came, process data did not, several times",
    ),
    (
        0x002D,
        "no synchronisation",
        "SYNC0 does not come: start time in the past, or DC not on",
    ),
    (
        0x0030,
        "invalid DC SYNC configuration",
        "AssignActivate or cycle differ from the ESI, or it needs SYNC0 and has none",
    ),
    (
        0x0031,
        "invalid DC latch configuration",
        "latch units are set up wrongly",
    ),
    (
        0x0032,
        "PLL error",
        "the slave cannot lock to SYNC0; the master's jitter is too large",
    ),
    (
        0x0033,
        "DC SYNC input or output error",
        "inputs or outputs missed SYNC0",
    ),
    (
        0x0034,
        "DC SYNC timeout",
        "too many SYNC events without process data",
    ),
    (
        0x0035,
        "invalid DC cycle time",
        "the cycle is not one of those the slave can do",
    ),
    (
        0x0036,
        "invalid DC SYNC0 cycle time",
        "the SYNC0 cycle is not allowed",
    ),
    (
        0x0037,
        "invalid DC SYNC1 cycle time",
        "the SYNC1 cycle is not allowed",
    ),
    (
        0x0060,
        "slave restarted locally",
        "the slave reset itself; see its supply",
    ),
];

impl AlStatusCode {
    /// The text.
    pub fn text(self) -> &'static str {
        let found = CODES.iter().find(|(code, ..)| *code == self.0);
        found.map_or("vendor specific code", |(_, text, _)| text)
    }

    /// The probable cause, or what to do.
    pub fn cause(self) -> &'static str {
        let found = CODES.iter().find(|(code, ..)| *code == self.0);
        found.map_or("see the slave's manual", |(.., cause)| cause)
    }
}

impl fmt::Display for AlStatusCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({:04X}h): {}", self.text(), self.0, self.cause())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_state_survives() {
        for raw in 0..16 {
            assert_eq!(AlState::from_raw(raw).raw(), raw);
        }
        let fallen = AlStatus::from_raw(0x0014);
        assert_eq!(fallen.to_string(), "SAFE-OP + error");
        assert_eq!(fallen.raw(), 0x0014);
    }

    #[test]
    fn al_status_codes_are_sorted_and_show_cause() {
        assert!(CODES.windows(2).all(|pair| pair[0].0 < pair[1].0));
        assert_eq!(
            AlStatusCode(0x001B).to_string(),
            "SyncManager watchdog (001Bh): no outputs within the watchdog time; see cycle and cable"
        );
        assert_eq!(AlStatusCode(0x8001).text(), "vendor specific code");
    }
}

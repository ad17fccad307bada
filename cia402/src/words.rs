//! The two words as values, with names for their bits. Bits that depend on the mode of operation
//! (4 to 6 and 9 of the controlword, 12 and 13 of the statusword) are not interpreted.

use std::fmt;

/// The controlword, object 6040h: the command of the master.
#[doc(alias = "6040h")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ControlWord(u16);

/// The statusword, object 6041h: the status of the drive.
#[doc(alias = "6041h")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct StatusWord(u16);

/// Bit names, from bit 0.
const CONTROL_BITS: [&str; 16] = [
    "switch-on",
    "enable-voltage",
    "quick-stop",
    "enable-operation",
    "mode4",
    "mode5",
    "mode6",
    "fault-reset",
    "halt",
    "mode9",
    "reserved10",
    "vendor11",
    "vendor12",
    "vendor13",
    "vendor14",
    "vendor15",
];

/// Bit names, from bit 0.
const STATUS_BITS: [&str; 16] = [
    "ready-to-switch-on",
    "switched-on",
    "operation-enabled",
    "fault",
    "voltage-enabled",
    "quick-stop",
    "switch-on-disabled",
    "warning",
    "vendor8",
    "remote",
    "target-reached",
    "internal-limit",
    "mode12",
    "mode13",
    "vendor14",
    "vendor15",
];

impl ControlWord {
    /// Power off at once; the motor is free unless a brake holds it.
    pub const DISABLE_VOLTAGE: Self = Self(0x0000);
    /// Stop by the quick stop option code (605Ah). The bit is active low.
    pub const QUICK_STOP: Self = Self(0x0002);
    /// To Ready to switch on.
    pub const SHUTDOWN: Self = Self(0x0006);
    /// To Switched on, from either side: from Operation enabled it is *disable operation*.
    pub(crate) const SWITCH_ON: Self = Self(0x0007);
    /// To Operation enabled.
    pub(crate) const ENABLE_OPERATION: Self = Self(0x000F);
    /// Acts by its rising edge only: the word before must have had bit 7 low.
    pub const FAULT_RESET: Self = Self(0x0080);

    /// From the raw value; any 16 bits are a controlword.
    pub const fn new(raw: u16) -> Self {
        Self(raw)
    }

    /// As on the wire.
    pub const fn raw(self) -> u16 {
        self.0
    }

    /// True if bit 7 is high.
    pub(crate) const fn fault_reset(self) -> bool {
        self.0 & 0x0080 != 0
    }

    /// True if bit 8 commands the drive to stop and stay enabled (605Dh selects how).
    pub const fn halt(self) -> bool {
        self.0 & 0x0100 != 0
    }
}

impl StatusWord {
    /// From the raw value; any 16 bits can be received. [`StatusWord::state`] decodes those that show a state.
    pub const fn new(raw: u16) -> Self {
        Self(raw)
    }

    /// As on the wire.
    pub const fn raw(self) -> u16 {
        self.0
    }

    /// True if the power stage is supplied (bit 4).
    pub(crate) const fn voltage_enabled(self) -> bool {
        self.0 & 0x0010 != 0
    }

    /// True if a warning is present (bit 7); it changes no state.
    pub const fn warning(self) -> bool {
        self.0 & 0x0080 != 0
    }

    /// True if the drive accepts the controlword (bit 9).
    pub const fn remote(self) -> bool {
        self.0 & 0x0200 != 0
    }

    /// True if the target is reached or, during halt, the drive has stopped (bit 10).
    pub const fn target_reached(self) -> bool {
        self.0 & 0x0400 != 0
    }

    /// True if the drive limits the commanded value (bit 11).
    pub const fn internal_limit(self) -> bool {
        self.0 & 0x0800 != 0
    }
}

impl fmt::Display for ControlWord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        bits(f, self.0, &CONTROL_BITS)
    }
}

impl fmt::Display for StatusWord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        bits(f, self.0, &STATUS_BITS)
    }
}

/// `0x0231 ready-to-switch-on+quick-stop`: the number, then the names of the bits that are high.
fn bits(f: &mut fmt::Formatter<'_>, word: u16, names: &[&str; 16]) -> fmt::Result {
    write!(f, "{word:#06x}")?;
    let high = names
        .iter()
        .enumerate()
        .filter(|(bit, _)| word & (1 << bit) != 0);
    for (count, (_, name)) in high.enumerate() {
        write!(f, "{}{name}", if count == 0 { ' ' } else { '+' })?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn display_names_the_high_bits() {
        assert_eq!(ControlWord::DISABLE_VOLTAGE.to_string(), "0x0000");
        assert_eq!(
            StatusWord::new(0x0231).to_string(),
            "0x0231 ready-to-switch-on+voltage-enabled+quick-stop+remote"
        );
        assert_eq!(
            ControlWord::new(0x8180).to_string(),
            "0x8180 fault-reset+halt+vendor15"
        );
    }

    #[test]
    fn getters_read_their_bit_only() {
        let check = |getter: fn(StatusWord) -> bool, bit: u16| {
            assert!(getter(StatusWord::new(1 << bit)), "bit {bit}");
            assert!(!getter(StatusWord::new(!(1 << bit))), "bit {bit}");
        };
        check(StatusWord::voltage_enabled, 4);
        check(StatusWord::warning, 7);
        check(StatusWord::remote, 9);
        check(StatusWord::target_reached, 10);
        check(StatusWord::internal_limit, 11);
        assert!(ControlWord::FAULT_RESET.fault_reset() && !ControlWord::new(0xFF7F).fault_reset());
        assert!(ControlWord::new(0x0100).halt() && !ControlWord::new(0xFEFF).halt());
    }
}

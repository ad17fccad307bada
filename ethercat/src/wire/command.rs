//! Commands of datagrams. Which slave executes them, and what that adds to the working counter, is known to the
//! emulator and the master, not here.

use std::fmt;

/// First byte of a datagram (ETG.1000.4, command table).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Command {
    /// Nothing.
    Nop,
    /// Read one slave by its position in the ring.
    Aprd,
    /// Write one slave by position.
    Apwr,
    /// Read and write one slave by position.
    Aprw,
    /// Read one slave by its station address.
    Fprd,
    /// Write one slave by station address.
    Fpwr,
    /// Read and write one slave by station address.
    Fprw,
    /// Read all slaves; the answers are OR-ed.
    Brd,
    /// Write all slaves.
    Bwr,
    /// Read and write all slaves.
    Brw,
    /// Read the logical address space.
    Lrd,
    /// Write the logical address space.
    Lwr,
    /// Read and write the logical address space.
    Lrw,
    /// Read one slave by position, write all others.
    Armw,
    /// Read one slave by station address, write all others.
    Frmw,
    /// An unknown code, as received.
    Other(u8),
}

/// Codes 0 to 14, in order.
const KNOWN: [(Command, &str); 15] = [
    (Command::Nop, "NOP"),
    (Command::Aprd, "APRD"),
    (Command::Apwr, "APWR"),
    (Command::Aprw, "APRW"),
    (Command::Fprd, "FPRD"),
    (Command::Fpwr, "FPWR"),
    (Command::Fprw, "FPRW"),
    (Command::Brd, "BRD"),
    (Command::Bwr, "BWR"),
    (Command::Brw, "BRW"),
    (Command::Lrd, "LRD"),
    (Command::Lwr, "LWR"),
    (Command::Lrw, "LRW"),
    (Command::Armw, "ARMW"),
    (Command::Frmw, "FRMW"),
];

impl Command {
    /// True if each slave adds one to the position in the address.
    pub const fn is_positional(self) -> bool {
        matches!(
            self,
            Self::Aprd | Self::Apwr | Self::Aprw | Self::Brd | Self::Bwr | Self::Brw | Self::Armw
        )
    }

    /// True if the address is one logical number.
    pub(crate) const fn is_logical(self) -> bool {
        matches!(self, Self::Lrd | Self::Lwr | Self::Lrw)
    }
}

impl From<u8> for Command {
    fn from(code: u8) -> Self {
        KNOWN
            .get(usize::from(code))
            .map_or(Self::Other(code), |(command, _)| *command)
    }
}

impl From<Command> for u8 {
    fn from(command: Command) -> Self {
        match command {
            Command::Nop => 0,
            Command::Aprd => 1,
            Command::Apwr => 2,
            Command::Aprw => 3,
            Command::Fprd => 4,
            Command::Fpwr => 5,
            Command::Fprw => 6,
            Command::Brd => 7,
            Command::Bwr => 8,
            Command::Brw => 9,
            Command::Lrd => 10,
            Command::Lwr => 11,
            Command::Lrw => 12,
            Command::Armw => 13,
            Command::Frmw => 14,
            Command::Other(code) => code,
        }
    }
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match KNOWN.get(usize::from(u8::from(*self))) {
            Some((_, name)) => f.pad(name),
            None => write!(f, "CMD{}", u8::from(*self)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_survives() {
        for code in 0..=u8::MAX {
            let command = Command::from(code);
            assert_eq!(u8::from(command), code);
            assert_eq!(matches!(command, Command::Other(_)), code > 14);
        }
    }

    #[test]
    fn names_are_those_of_the_standard() {
        let shown: Vec<String> = (0..16)
            .map(|code| Command::from(code).to_string())
            .collect();
        let expected = "NOP APRD APWR APRW FPRD FPWR FPRW BRD BWR BRW LRD LWR LRW ARMW FRMW CMD15";
        assert_eq!(shown.join(" "), expected);
    }

    #[test]
    fn three_commands_are_logical() {
        let logical: Vec<u8> = (0..=255)
            .filter(|code| Command::from(*code).is_logical())
            .collect();
        assert_eq!(logical, [10, 11, 12]);
    }
}

//! A CAN FD frame (ISO 11898-1:2015) as a value that is always valid. CANopen FD is not supported; these frames are
//! transferred, logged and counted.

use std::fmt;

use crate::{FrameError, Id};

/// Lengths of CAN FD frames, indexed by length code.
const LENGTHS: [u8; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64];

/// A CAN FD data frame; CAN FD has no remote frames.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct FdFrame {
    id: Id,
    /// Bit rate switch (BRS): the data were sent at the data bit rate.
    pub bit_rate_switch: bool,
    /// Error state indicator (ESI): the sender is error-passive.
    pub sender_is_passive: bool,
    len: u8,
    data: [u8; 64],
}

impl FdFrame {
    /// Maximum payload, bytes.
    pub const LEN_MAX: usize = 64;

    /// A frame with payload `data`, without BRS and ESI.
    pub fn new(id: Id, data: &[u8]) -> Result<Self, FrameError> {
        let error = FrameError::FdLength { len: data.len() };
        let len = u8::try_from(data.len()).map_err(|_| error)?;
        if !LENGTHS.contains(&len) {
            return Err(error);
        }
        let mut frame = Self {
            id,
            bit_rate_switch: false,
            sender_is_passive: false,
            len,
            data: [0; 64],
        };
        for (to, from) in frame.data.iter_mut().zip(data) {
            *to = *from;
        }
        Ok(frame)
    }

    /// Number of bytes of a 4-bit length code.
    pub(crate) fn len_of_code(code: u8) -> Option<usize> {
        LENGTHS.get(usize::from(code)).copied().map(usize::from)
    }

    /// The identifier.
    pub const fn id(&self) -> Id {
        self.id
    }

    /// The payload.
    pub fn data(&self) -> &[u8] {
        self.data.get(..usize::from(self.len)).unwrap_or_default()
    }

    /// BRS as bit 0 and ESI as bit 1, as the kernel and candump write them.
    pub fn flags(&self) -> u8 {
        u8::from(self.bit_rate_switch) | u8::from(self.sender_is_passive) << 1
    }

    /// Sets BRS and ESI from bits 0 and 1; other bits are ignored.
    #[must_use]
    pub const fn with_flags(mut self, flags: u8) -> Self {
        self.bit_rate_switch = flags & 1 != 0;
        self.sender_is_passive = flags & 2 != 0;
        self
    }
}

impl fmt::Debug for FdFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "FdFrame({self})")
    }
}

impl fmt::Display for FdFrame {
    /// `123##1DEADBEEF`: after `##` the flags, then the data.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}##{:X}", self.id, self.flags())?;
        self.data()
            .iter()
            .try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fd_frame_invalid_lengths_are_rejected() {
        let id = Id::standard(0x123).unwrap();
        for len in 0..=80 {
            let built = FdFrame::new(id, &vec![0xA5; len]);
            match built {
                Ok(frame) => assert_eq!(frame.data(), vec![0xA5; len]),
                Err(error) => assert_eq!(error, FrameError::FdLength { len }),
            }
            let has_code = (0..16).any(|code| FdFrame::len_of_code(code) == Some(len));
            assert_eq!(built.is_ok(), has_code, "{len}");
        }
        assert_eq!(FdFrame::len_of_code(16), None);
        assert!(FdFrame::new(id, &[0; 256]).is_err());
    }

    #[test]
    fn fd_frame_flags_match_candump() {
        let frame = FdFrame::new(Id::extended(0x123).unwrap(), &[0xDE, 0xAD]).unwrap();
        assert_eq!(frame.to_string(), "00000123##0DEAD");
        for flags in 0..16 {
            assert_eq!(frame.with_flags(flags).flags(), flags & 3);
        }
        assert_eq!(frame.with_flags(3).to_string(), "00000123##3DEAD");
    }
}

//! A classic CAN frame as a value that is always valid: identifier and length are checked at
//! construction. It does no I/O.

use std::fmt;

use crate::FrameError;

/// An identifier of 11 or 29 bits; 123h in 11 bits differs from 123h in 29 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Id {
    raw: u32,
    extended: bool,
}

impl Id {
    const STANDARD_MAX: u16 = 0x7FF;
    const EXTENDED_MAX: u32 = 0x1FFF_FFFF;

    /// An identifier of 11 bits.
    pub const fn standard(id: u16) -> Result<Self, FrameError> {
        if id > Self::STANDARD_MAX {
            return Err(FrameError::StandardId { id });
        }
        // `u32::from` is not const; widening loses nothing.
        Ok(Self {
            raw: id as u32,
            extended: false,
        })
    }

    /// An identifier of 29 bits.
    pub const fn extended(id: u32) -> Result<Self, FrameError> {
        if id > Self::EXTENDED_MAX {
            return Err(FrameError::ExtendedId { id });
        }
        Ok(Self {
            raw: id,
            extended: true,
        })
    }

    /// The number, without any flag.
    pub const fn raw(self) -> u32 {
        self.raw
    }

    /// True for 29 bits.
    pub const fn is_extended(self) -> bool {
        self.extended
    }
}

impl fmt::Display for Id {
    /// 3 or 8 digits, by which logs distinguish the two kinds.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = if self.extended { 8 } else { 3 };
        write!(f, "{:0width$X}", self.raw)
    }
}

/// A data frame or a remote frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Frame {
    id: Id,
    remote: bool,
    dlc: u8,
    /// The length code on the wire if it was 9 to 15 (which also means 8 bytes); else 0.
    raw_dlc: u8,
    /// Zero from `dlc` on; all zero in a remote frame.
    data: [u8; 8],
}

impl Frame {
    /// Maximum payload, bytes.
    pub const LEN_MAX: usize = 8;

    /// A data frame with payload `data`.
    #[inline]
    pub fn new(id: Id, data: &[u8]) -> Result<Self, FrameError> {
        let mut frame = Self::remote(id, data.len())?;
        frame.remote = false;
        for (to, from) in frame.data.iter_mut().zip(data) {
            *to = *from;
        }
        Ok(frame)
    }

    /// A data frame with eight bytes.
    pub const fn full(id: Id, data: [u8; 8]) -> Self {
        Self {
            id,
            remote: false,
            dlc: 8,
            raw_dlc: 0,
            data,
        }
    }

    /// A data frame without payload.
    pub const fn empty(id: Id) -> Self {
        Self {
            id,
            remote: false,
            dlc: 0,
            raw_dlc: 0,
            data: [0; 8],
        }
    }

    /// A remote frame that requests `len` bytes.
    #[inline]
    pub fn remote(id: Id, len: usize) -> Result<Self, FrameError> {
        match u8::try_from(len) {
            Ok(dlc) if len <= Self::LEN_MAX => Ok(Self {
                id,
                remote: true,
                dlc,
                raw_dlc: 0,
                data: [0; 8],
            }),
            _ => Err(FrameError::TooLong { len }),
        }
    }

    /// The identifier.
    pub const fn id(&self) -> Id {
        self.id
    }

    /// Whether it is a remote frame.
    pub const fn is_remote(&self) -> bool {
        self.remote
    }

    /// Length of the payload, or the requested length of a remote frame; 0 to 8.
    pub const fn dlc(&self) -> u8 {
        self.dlc
    }

    /// The same frame with a length code of 9 to 15 on the wire (ISO 11898-1, clause 8.4.2.4: it means
    /// eight bytes, and some devices use the difference). For frames of eight bytes only.
    pub(crate) const fn with_raw_dlc(mut self, raw: u8) -> Result<Self, FrameError> {
        if self.dlc != 8 || raw < 9 || raw > 15 {
            return Err(FrameError::RawDlc { raw, len: self.dlc });
        }
        self.raw_dlc = raw;
        Ok(self)
    }

    /// The length code on the wire if it is above 8.
    pub(crate) const fn raw_dlc(&self) -> Option<u8> {
        match self.raw_dlc {
            0 => None,
            raw => Some(raw),
        }
    }

    /// The payload; empty for a remote frame.
    pub fn data(&self) -> &[u8] {
        let len = if self.remote {
            0
        } else {
            usize::from(self.dlc)
        };
        self.data.get(..len).unwrap_or_default()
    }
}

impl fmt::Display for Frame {
    /// `123#DEADBEEF`, or `123#R4` for a remote frame; with the suffix `_E` for a length code above
    /// 8.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}#", self.id)?;
        match (self.remote, self.dlc) {
            (true, 0) => f.write_str("R")?,
            (true, dlc) => write!(f, "R{dlc}")?,
            (false, _) => self
                .data()
                .iter()
                .try_for_each(|byte| write!(f, "{byte:02X}"))?,
        }
        self.raw_dlc().map_or(Ok(()), |raw| write!(f, "_{raw:X}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_identifiers_and_lengths_are_checked() {
        let id = Id::standard(0x7FF).unwrap();
        assert_eq!(
            Id::standard(0x800),
            Err(FrameError::StandardId { id: 0x800 })
        );
        assert!(Id::extended(0x1FFF_FFFF).is_ok());
        assert_eq!(
            Id::extended(0x2000_0000),
            Err(FrameError::ExtendedId { id: 0x2000_0000 })
        );
        for len in 0..=8 {
            assert_eq!(Frame::new(id, &[0xAA; 8][..len]).unwrap().data().len(), len);
            assert_eq!(usize::from(Frame::remote(id, len).unwrap().dlc()), len);
        }
        for len in [9, 256, 264] {
            assert_eq!(
                Frame::new(id, &vec![0; len]),
                Err(FrameError::TooLong { len })
            );
            assert_eq!(Frame::remote(id, len), Err(FrameError::TooLong { len }));
        }
    }

    #[test]
    fn frame_raw_length_code_needs_eight_bytes() {
        let id = Id::standard(1).unwrap();
        let eight = Frame::new(id, &[0; 8]).unwrap();
        for raw in 0..=u8::MAX {
            let built = eight.with_raw_dlc(raw);
            assert_eq!(built.is_ok(), (9..=15).contains(&raw), "{raw}");
            assert!(Frame::empty(id).with_raw_dlc(raw).is_err());
        }
        let built = eight.with_raw_dlc(14).unwrap();
        assert_eq!((built.raw_dlc(), built.dlc()), (Some(14), 8));
        assert_eq!(built.to_string(), "001#0000000000000000_E");
        assert_eq!(eight.raw_dlc(), None);
    }

    #[test]
    fn id_standard_and_extended_of_same_number_differ() {
        assert_ne!(Id::standard(0x123).unwrap(), Id::extended(0x123).unwrap());
        let id = Id::standard(0x123).unwrap();
        let (data, remote) = (
            Frame::new(id, &[0, 0]).unwrap(),
            Frame::remote(id, 2).unwrap(),
        );
        assert_ne!(data, remote);
        assert_eq!((data.dlc(), remote.dlc(), remote.data()), (2, 2, &[][..]));
    }

    #[test]
    fn frame_display_matches_cansend_syntax() {
        let (short, long) = (Id::standard(0x1).unwrap(), Id::extended(0x1).unwrap());
        assert_eq!(
            Frame::new(short, &[0xDE, 0x0D]).unwrap().to_string(),
            "001#DE0D"
        );
        assert_eq!(Frame::new(long, &[]).unwrap().to_string(), "00000001#");
        assert_eq!(Frame::remote(short, 0).unwrap().to_string(), "001#R");
        assert_eq!(Frame::remote(short, 8).unwrap().to_string(), "001#R8");
    }
}

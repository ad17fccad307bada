//! Puts fragments together to Ethernet frames, in a buffer of its own. It does not wait: a frame that is not continued is
//! dropped when the next one begins.

use super::{Fragment, UNIT};

/// Shortest Ethernet frame that has a header, bytes.
pub const FRAME_MIN: usize = 14;
/// Longest Ethernet frame, with a VLAN tag and without checksum, bytes.
pub const FRAME_MAX: usize = 1518;
/// Length of an appended time stamp, bytes.
const STAMP: usize = 4;

/// Why a fragment was dropped, and with it its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum FragmentError {
    /// Another number than the next: fragments were lost or came in the wrong order.
    #[error("fragment {found} after fragment {before}: fragments are lost or in the wrong order")]
    Number {
        /// The number of the fragment before.
        before: u8,
        /// The number of this one.
        found: u8,
    },
    /// It belongs to a frame whose beginning was not received.
    #[error("fragment {0} of a frame whose beginning was not received")]
    NoBeginning(u8),
    /// It belongs to another frame than the one before.
    #[error("a fragment of frame {found} in frame {expected}")]
    Frame {
        /// The number of the frame.
        expected: u8,
        /// The number in the fragment.
        found: u8,
    },
    /// It does not continue where the one before ended.
    #[error("a fragment at byte {found}, and the frame has {expected} bytes so far")]
    Offset {
        /// Bytes so far.
        expected: usize,
        /// The offset of the fragment, bytes.
        found: usize,
    },
    /// The frame is longer than it announced, or than Ethernet allows.
    #[error("a frame of {len} bytes or more, where {allowed} are allowed")]
    TooLong {
        /// Bytes with this fragment.
        len: usize,
        /// What its first fragment announced, at most 1518.
        allowed: usize,
    },
    /// The frame is shorter than an Ethernet header.
    #[error("a frame of {0} bytes, and an Ethernet header has 14")]
    TooShort(usize),
    /// The frame before ended without its last fragment.
    #[error("the frame before ended after {0} bytes without its last fragment")]
    Unfinished(usize),
}

/// The frame that is being received, and what was dropped.
#[derive(Debug)]
pub struct Reassembly {
    frame: Box<[u8; FRAME_MAX + STAMP]>,
    len: usize,
    /// The number of the last fragment; `None` between two frames.
    number: Option<u8>,
    /// The number of the frame.
    of: u8,
    /// Longest that the frame may become, bytes.
    allowed: usize,
    /// The rest of the frame is dropped with what was dropped and counted.
    dropping: bool,
    dropped: u64,
    cause: Option<FragmentError>,
}

impl Default for Reassembly {
    fn default() -> Self {
        Self {
            frame: Box::new([0; FRAME_MAX + STAMP]),
            len: 0,
            number: None,
            of: 0,
            allowed: 0,
            dropping: false,
            dropped: 0,
            cause: None,
        }
    }
}

impl Reassembly {
    /// Frames dropped so far, and the cause of the last.
    pub const fn dropped(&self) -> (u64, Option<FragmentError>) {
        (self.dropped, self.cause)
    }

    /// Drops a frame that has begun.
    pub fn reset(&mut self) {
        if self.number.take().is_some() {
            self.fail(FragmentError::Unfinished(self.len));
        }
    }

    fn fail(&mut self, cause: FragmentError) {
        (self.number, self.dropping) = (None, true);
        self.dropped += 1;
        self.cause = Some(cause);
    }

    /// Takes a fragment. The last one gives the frame, and its time stamp if it has one. A fragment that does not fit drops its
    /// frame; further ones of the same frame are not counted again.
    pub fn push(&mut self, fragment: &Fragment<'_>) -> Option<(&[u8], Option<u32>)> {
        let taken = self.take(fragment);
        let (len, time) = match taken {
            Ok(whole) => whole?,
            Err(cause) => {
                self.fail(cause);
                return None;
            }
        };
        Some((self.frame.get(..len)?, time))
    }

    /// Takes a fragment; the last gives the length of the frame and its time stamp.
    fn take(
        &mut self,
        fragment: &Fragment<'_>,
    ) -> Result<Option<(usize, Option<u32>)>, FragmentError> {
        if !self.place(fragment)? {
            return Ok(None);
        }
        let stamp = if fragment.stamped { STAMP } else { 0 };
        let (len, allowed) = (self.len + fragment.data.len(), self.allowed + stamp);
        let room = self.frame.get_mut(self.len..len).filter(|_| len <= allowed);
        let room = room.ok_or(FragmentError::TooLong { len, allowed })?;
        room.copy_from_slice(fragment.data);
        self.len = len;
        if !fragment.last {
            return Ok(None);
        }
        self.number = None;
        let whole = self.frame.get(..len).unwrap_or_default();
        let (len, time) = match whole.split_last_chunk() {
            Some((frame, time)) if fragment.stamped => {
                (frame.len(), Some(u32::from_le_bytes(*time)))
            }
            Some(_) | None => (len, None),
        };
        if len < FRAME_MIN {
            return Err(FragmentError::TooShort(len));
        }
        Ok(Some((len, time)))
    }

    /// Checks where a fragment belongs; false for the rest of a dropped frame.
    fn place(&mut self, fragment: &Fragment<'_>) -> Result<bool, FragmentError> {
        let (found, at) = (fragment.number, usize::from(fragment.offset) * UNIT);
        if found == 0 {
            self.reset();
            (self.number, self.of, self.len) = (Some(0), fragment.frame, 0);
            self.dropping = false;
            self.allowed = at.min(FRAME_MAX);
            return Ok(true);
        }
        let Some(before) = self.number else {
            if self.dropping && self.of == fragment.frame {
                return Ok(false);
            }
            self.of = fragment.frame;
            return Err(FragmentError::NoBeginning(found));
        };
        let expected = self.len;
        if fragment.frame != self.of {
            let (expected, found) = (self.of, fragment.frame);
            return Err(FragmentError::Frame { expected, found });
        }
        if found != before + 1 {
            return Err(FragmentError::Number { before, found });
        }
        if at != expected {
            let found = at;
            return Err(FragmentError::Offset { expected, found });
        }
        self.number = Some(found);
        Ok(true)
    }
}

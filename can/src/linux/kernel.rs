//! Frames as the kernel lays them out in memory (`struct can_frame`, `struct canfd_frame` of
//! `linux/can.h`), as bytes. It makes no system calls.
//!
//! | bytes | content |
//! |---|---|
//! | 0 to 3 | identifier; bit 31: 29 bits, bit 30: remote, bit 29: error frame |
//! | 4 | bytes of data |
//! | 5 | flags of CAN FD |
//! | 7 | raw length code of a classic frame |
//! | 8 ... | data: 8 bytes, of CAN FD 64 |

use crate::fault::ERROR_FLAG;
use crate::{AnyFrame, ErrorFrame, FdFrame, Frame, Id};

/// Length of a classic frame or error frame.
pub(super) const CLASSIC_LEN: usize = 16;
/// Length of a CAN FD frame.
pub(super) const FD_LEN: usize = 72;

const EXTENDED_FLAG: u32 = 1 << 31;
const REMOTE_FLAG: u32 = 1 << 30;
/// Flag of CAN FD: the frame is CAN FD.
const FDF: u8 = 4;

/// A frame in the kernel's layout.
pub(super) struct Encoded {
    bytes: [u8; FD_LEN],
    len: usize,
}

impl Encoded {
    pub(super) fn as_slice(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }
}

fn raw_id(id: Id) -> u32 {
    id.raw() | if id.is_extended() { EXTENDED_FLAG } else { 0 }
}

pub(super) fn encode(frame: &AnyFrame) -> Encoded {
    let (id, len, flags, code, data, size) = match frame {
        AnyFrame::Classic(frame) => {
            let remote = if frame.is_remote() { REMOTE_FLAG } else { 0 };
            let code = frame.raw_dlc().unwrap_or(0);
            let id = raw_id(frame.id()) | remote;
            (id, frame.dlc(), 0, code, frame.data(), CLASSIC_LEN)
        }
        AnyFrame::Fd(frame) => {
            let len = u8::try_from(frame.data().len()).unwrap_or(0);
            let flags = frame.flags() | FDF;
            (raw_id(frame.id()), len, flags, 0, frame.data(), FD_LEN)
        }
        AnyFrame::Error(frame) => {
            let id = frame.class() | ERROR_FLAG;
            (id, 8, 0, 0, frame.data.as_slice(), CLASSIC_LEN)
        }
    };
    let mut bytes = [0; FD_LEN];
    let [a, b, c, d] = id.to_ne_bytes();
    let head = [a, b, c, d, len, flags, 0, code];
    for (to, from) in bytes.iter_mut().zip(head.iter().chain(data)) {
        *to = *from;
    }
    Encoded { bytes, len: size }
}

/// `None` for any other length, or an invalid frame; the kernel delivers neither.
#[inline]
pub(super) fn decode(bytes: &[u8]) -> Option<AnyFrame> {
    let (head, data) = bytes.split_first_chunk::<8>()?;
    let [a, b, c, d, len, flags, _, code] = *head;
    let raw = u32::from_ne_bytes([a, b, c, d]);
    if raw & ERROR_FLAG != 0 {
        let data = *data.first_chunk::<8>()?;
        return Some(ErrorFrame::new(raw & !(EXTENDED_FLAG | REMOTE_FLAG), data).into());
    }
    let id = if raw & EXTENDED_FLAG != 0 {
        Id::extended(raw & 0x1FFF_FFFF).ok()?
    } else {
        Id::standard(u16::try_from(raw & 0x7FF).ok()?).ok()?
    };
    let len = usize::from(len);
    match bytes.len() {
        FD_LEN => Some(
            FdFrame::new(id, data.get(..len)?)
                .ok()?
                .with_flags(flags)
                .into(),
        ),
        CLASSIC_LEN => {
            let frame = if raw & REMOTE_FLAG != 0 {
                Frame::remote(id, len).ok()?
            } else {
                Frame::new(id, data.get(..len)?).ok()?
            };
            Some(frame.with_raw_dlc(code).unwrap_or(frame).into())
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::log::parse_frame;

    #[test]
    fn frame_layout_matches_kernel() {
        assert_eq!(CLASSIC_LEN, size_of::<libc::can_frame>());
        assert_eq!(FD_LEN, size_of::<libc::canfd_frame>());
        assert_eq!(4, std::mem::offset_of!(libc::can_frame, can_dlc));
        assert_eq!(8, std::mem::offset_of!(libc::can_frame, data));
        assert_eq!(5, std::mem::offset_of!(libc::canfd_frame, flags));
        assert_eq!(8, std::mem::offset_of!(libc::canfd_frame, data));
        assert_eq!(EXTENDED_FLAG, libc::CAN_EFF_FLAG);
        assert_eq!(REMOTE_FLAG, libc::CAN_RTR_FLAG);
        assert_eq!(ERROR_FLAG, libc::CAN_ERR_FLAG);
    }

    #[test]
    fn frame_kernel_layout_survives_round_trip() {
        for text in [
            "123#DEADBEEF",
            "1FFFFFFF#",
            "123#R5",
            "123#1122334455667788_B",
            "123##3112233445566778899AABBCC",
            "20000044#0030000000008205",
        ] {
            let frame = parse_frame(text).unwrap();
            assert_eq!(decode(encode(&frame).as_slice()), Some(frame), "{text}");
        }
    }

    proptest! {
        #[test]
        fn frame_any_kernel_bytes_do_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..80)) {
            let _ = decode(&bytes);
            for len in [CLASSIC_LEN, FD_LEN] {
                if let Some(frame) = bytes.get(..len).and_then(decode) {
                    prop_assert_eq!(decode(encode(&frame).as_slice()), Some(frame));
                }
            }
        }
    }
}

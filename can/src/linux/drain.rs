//! Up to 32 frames by one system call, each with what the kernel knows of it: time stamps, where it comes
//! from, how many were lost before it. It does not wait.

#![allow(
    unsafe_code,
    reason = "recvmmsg takes pointers, and no library offers it with these answers"
)]

use std::io;
use std::mem::MaybeUninit;
use std::os::fd::{AsRawFd as _, BorrowedFd};
use std::ptr;
use std::time::Duration;

use super::kernel;
use crate::AnyFrame;
use crate::link::Origin;

/// Frames taken by one system call, at most.
pub(super) const BATCH: usize = 32;

/// Room for the two control messages: 64 bytes for three time stamps, 24 for the count of losses.
const CONTROL_LEN: usize = 128;

/// A frame and what the kernel says about it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stamped {
    pub(super) frame: Option<AnyFrame>,
    /// Since 1970.
    pub(super) software: Option<Duration>,
    pub(super) hardware: Option<Duration>,
    pub(super) origin: Origin,
    pub(super) dropped: Option<u32>,
}

#[derive(Clone, Copy)]
#[repr(C, align(8))]
struct Control([u8; CONTROL_LEN]);

/// Memory that the kernel writes frames into; reused, so that receiving allocates nothing.
pub(super) struct Buffers {
    frames: [[u8; kernel::FD_LEN]; BATCH],
    controls: [Control; BATCH],
    lens: [(usize, usize, i32); BATCH],
}

impl std::fmt::Debug for Buffers {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Buffers").finish_non_exhaustive()
    }
}

impl Buffers {
    pub(super) fn new() -> Box<Self> {
        Box::new(Self {
            frames: [[0; kernel::FD_LEN]; BATCH],
            controls: [Control([0; CONTROL_LEN]); BATCH],
            lens: [(0, 0, 0); BATCH],
        })
    }

    /// Takes what is there, at most `limit` frames; returns how many. 0 when nothing is there.
    pub(super) fn fill(&mut self, socket: BorrowedFd<'_>, limit: usize) -> io::Result<usize> {
        // SAFETY: an iovec of null and length 0 is valid.
        let mut vectors: [libc::iovec; BATCH] = unsafe { MaybeUninit::zeroed().assume_init() };
        // SAFETY: null pointers with lengths of 0 are valid in every field of a message header.
        let mut headers: [libc::mmsghdr; BATCH] = unsafe { MaybeUninit::zeroed().assume_init() };
        let limit = limit.clamp(1, BATCH);
        // Only what the call may use: who takes frames one by one does not pay for 32.
        let memory = self.frames.iter_mut().zip(&mut self.controls).take(limit);
        for ((vector, header), (frame, control)) in vectors.iter_mut().zip(&mut headers).zip(memory)
        {
            vector.iov_base = frame.as_mut_ptr().cast();
            vector.iov_len = frame.len();
            header.msg_hdr.msg_iov = vector;
            header.msg_hdr.msg_iovlen = 1;
            header.msg_hdr.msg_control = control.0.as_mut_ptr().cast();
            header.msg_hdr.msg_controllen = CONTROL_LEN as _;
        }
        let limit = libc::c_uint::try_from(limit).unwrap_or(1);
        // SAFETY: `limit` is at most the number of headers. Each of so many headers points to one vector and to a control
        // buffer of the length it tells; vectors point to buffers of the lengths they tell. All of them live
        // until the call is over, nobody else has them, and the kernel writes within these bounds. A null
        // timeout is allowed.
        let count = unsafe {
            libc::recvmmsg(
                socket.as_raw_fd(),
                headers.as_mut_ptr(),
                limit,
                libc::MSG_DONTWAIT,
                ptr::null_mut(),
            )
        };
        let Ok(count) = usize::try_from(count) else {
            let error = io::Error::last_os_error();
            let nothing = matches!(error.raw_os_error(), Some(libc::EAGAIN | libc::EINTR));
            return if nothing { Ok(0) } else { Err(error) };
        };
        for (len, header) in self.lens.iter_mut().zip(headers.iter().take(count)) {
            let header = (header.msg_len, &header.msg_hdr);
            *len = (
                usize::try_from(header.0).unwrap_or(0),
                header.1.msg_controllen,
                header.1.msg_flags,
            );
        }
        Ok(count)
    }

    /// The frame at a place below the last count.
    pub(super) fn get(&self, place: usize) -> Stamped {
        let all = (
            self.lens.get(place),
            self.frames.get(place),
            self.controls.get(place),
        );
        let (Some((len, control_len, flags)), Some(frame), Some(control)) = all else {
            return Stamped::default();
        };
        let mut stamped = Stamped {
            frame: frame.get(..*len).and_then(kernel::decode),
            origin: origin(*flags),
            ..Stamped::default()
        };
        read_control(
            control.0.get(..*control_len).unwrap_or_default(),
            &mut stamped,
        );
        stamped
    }
}

/// The kernel marks what a program of this host sent, and of that what this socket sent.
const fn origin(flags: i32) -> Origin {
    if flags & libc::MSG_CONFIRM != 0 {
        Origin::Own
    } else if flags & libc::MSG_DONTROUTE != 0 {
        Origin::Host
    } else {
        Origin::Bus
    }
}

/// Length of the head of a control message: its length, level and kind.
const HEAD: usize = size_of::<libc::cmsghdr>();

/// Control messages lie one behind the other, each at a multiple of the word length.
fn read_control(mut rest: &[u8], stamped: &mut Stamped) {
    const WORD: usize = size_of::<usize>();
    while let Some((len, after)) = rest.split_first_chunk::<WORD>() {
        let len = usize::from_ne_bytes(*len);
        let kind = after.get(..8).and_then(|bytes| {
            let (level, kind) = bytes.split_first_chunk::<4>()?;
            let kind = kind.first_chunk::<4>()?;
            Some((i32::from_ne_bytes(*level), i32::from_ne_bytes(*kind)))
        });
        let Some((kind, content)) = kind.zip(rest.get(HEAD..len)) else {
            return;
        };
        match kind {
            (libc::SOL_SOCKET, libc::SO_RXQ_OVFL) => {
                stamped.dropped = content
                    .first_chunk()
                    .map(|bytes| u32::from_ne_bytes(*bytes));
            }
            (libc::SOL_SOCKET, libc::SCM_TIMESTAMPING) => {
                stamped.software = timespec(content, 0);
                stamped.hardware = timespec(content, 2);
            }
            _ => {}
        }
        rest = rest.get(len.next_multiple_of(WORD)..).unwrap_or_default();
    }
}

/// One of three times; all zero means that there is none.
fn timespec(content: &[u8], place: usize) -> Option<Duration> {
    const LEN: usize = size_of::<libc::timespec>();
    const HALF: usize = LEN / 2;
    let bytes = content.get(place * LEN..)?;
    let (seconds, rest) = bytes.split_first_chunk::<HALF>()?;
    let nanos = rest.first_chunk::<HALF>()?;
    let number = |bytes: &[u8; HALF]| -> u64 {
        let mut wide = [0; 8];
        wide.iter_mut()
            .zip(bytes)
            .for_each(|(to, from)| *to = *from);
        // The field is as wide as a word, or 64 bits; words of this crate's hosts are little-endian when
        // they are shorter.
        u64::from_ne_bytes(wide)
    };
    let (seconds, nanos) = (number(seconds), number(nanos));
    let stamp = Duration::new(seconds, u32::try_from(nanos).ok()?);
    (!stamp.is_zero()).then_some(stamp)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn message(kind: i32, content: &[u8]) -> Vec<u8> {
        let mut bytes = (HEAD + content.len()).to_ne_bytes().to_vec();
        bytes.extend(libc::SOL_SOCKET.to_ne_bytes());
        bytes.extend(kind.to_ne_bytes());
        bytes.extend(content);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    }

    #[test]
    fn control_messages_are_read() {
        let times: Vec<u8> = [1_700_000_000_u64, 125_000, 0, 0, 9, 7]
            .iter()
            .flat_map(|number| number.to_ne_bytes())
            .collect();
        let bytes = [
            message(99, &[1, 2, 3]),
            message(libc::SO_RXQ_OVFL, &722_u32.to_ne_bytes()),
            message(libc::SCM_TIMESTAMPING, &times),
        ]
        .concat();
        let mut stamped = Stamped::default();
        read_control(&bytes, &mut stamped);
        assert_eq!(stamped.dropped, Some(722));
        assert_eq!(
            stamped.software,
            Some(Duration::new(1_700_000_000, 125_000))
        );
        assert_eq!(stamped.hardware, Some(Duration::new(9, 7)));
    }

    #[test]
    fn flags_tell_the_origin() {
        assert_eq!(origin(0), Origin::Bus);
        assert_eq!(origin(0x4), Origin::Host);
        assert_eq!(origin(0x804), Origin::Own);
    }

    #[test]
    fn nothing_there_is_no_error() {
        let (socket, _peer) = std::os::unix::net::UnixDatagram::pair().unwrap();
        let mut buffers = Buffers::new();
        assert_eq!(
            buffers
                .fill(std::os::fd::AsFd::as_fd(&socket), BATCH)
                .unwrap(),
            0
        );
    }

    /// The system call needs no CAN: any socket of datagrams will do.
    #[test]
    fn one_call_takes_all_that_is_there() {
        let (socket, peer) = std::os::unix::net::UnixDatagram::pair().unwrap();
        for id in 1..=5_u32 {
            let mut bytes = [0; kernel::CLASSIC_LEN];
            bytes[..4].copy_from_slice(&id.to_ne_bytes());
            peer.send(&bytes).unwrap();
        }
        let mut buffers = Buffers::new();
        let fd = std::os::fd::AsFd::as_fd(&socket);
        assert_eq!(buffers.fill(fd, 3).unwrap(), 3);
        assert_eq!(
            buffers.get(2).frame.and_then(|f| f.id()).map(|id| id.raw()),
            Some(3)
        );
        assert_eq!(buffers.fill(fd, BATCH).unwrap(), 2);
        assert_eq!(
            buffers.get(1).frame.and_then(|f| f.id()).map(|id| id.raw()),
            Some(5)
        );
        assert!(buffers.get(BATCH).frame.is_none());
    }

    proptest! {
        #[test]
        fn any_control_bytes_are_answered(bytes in prop::collection::vec(any::<u8>(), 0..140), len in 0..40_usize) {
            let mut bytes = bytes;
            if let Some(head) = bytes.first_chunk_mut::<8>() {
                *head = len.to_ne_bytes();
            }
            read_control(&bytes, &mut Stamped::default());
        }
    }
}

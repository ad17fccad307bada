//! Receives one or up to 32 frames with one system call, each with time stamps, origin and the count of lost frames. It
//! does not block.

#![allow(
    unsafe_code,
    reason = "recvmsg and recvmmsg take pointers, and no library offers them with these control messages"
)]

use std::io;
use std::mem::MaybeUninit;
use std::os::fd::{AsRawFd as _, BorrowedFd};
use std::ptr;

use super::kernel;
use crate::AnyFrame;
use crate::link::Origin;

/// Maximum frames per system call.
pub(super) const BATCH: usize = 32;

/// Size of the two control messages: 64 bytes for three time stamps, 24 for the count of losses.
const CONTROL_LEN: usize = 128;

/// A frame with the metadata of the kernel.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stamped {
    pub(super) frame: Option<AnyFrame>,
    /// Kernel time stamp since 1970, ns.
    pub(super) software: Option<u64>,
    /// Hardware time stamp, ns.
    pub(super) hardware: Option<u64>,
    pub(super) origin: Origin,
    pub(super) dropped: Option<u32>,
}

#[derive(Clone, Copy)]
#[repr(C, align(8))]
struct Control([u8; CONTROL_LEN]);

/// Buffers for the kernel; reused, so that reception does not allocate.
pub(super) struct Buffers {
    frames: [[u8; kernel::FD_LEN]; BATCH],
    controls: [Control; BATCH],
    info: [MessageInfo; BATCH],
}

/// Metadata of a received message.
#[derive(Clone, Copy, Default)]
struct MessageInfo {
    len: usize,
    control_len: usize,
    flags: i32,
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
            info: [MessageInfo::default(); BATCH],
        })
    }

    /// Receives up to `limit` available frames; returns their number, 0 if there are none.
    pub(super) fn fill(&mut self, socket: BorrowedFd<'_>, limit: usize) -> io::Result<usize> {
        let filled = if limit <= 1 {
            self.fill_one(socket)
        } else {
            self.fill_many(socket, limit.min(BATCH))
        };
        filled.or_else(|error| match error.raw_os_error() {
            Some(libc::EAGAIN | libc::EINTR) => Ok(0),
            _ => Err(error),
        })
    }

    /// For one frame `recvmsg` is cheaper than `recvmmsg`.
    #[inline]
    fn fill_one(&mut self, socket: BorrowedFd<'_>) -> io::Result<usize> {
        let ([frame, ..], [control, ..], [info, ..]) =
            (&mut self.frames, &mut self.controls, &mut self.info);
        let mut vector = NOWHERE;
        // SAFETY: null pointers with lengths of 0 are valid in every field of a message header.
        let mut header: libc::msghdr = unsafe { MaybeUninit::zeroed().assume_init() };
        init_header(&mut header, &mut vector, frame, control);
        // SAFETY: the header points to one vector and to a control buffer of the given length, the vector to a buffer
        // of the given length. All of them outlive the call, are not aliased, and the kernel writes within these
        // bounds.
        let len = unsafe { libc::recvmsg(socket.as_raw_fd(), &raw mut header, libc::MSG_DONTWAIT) };
        let len = usize::try_from(len).map_err(|_| io::Error::last_os_error())?;
        *info = MessageInfo::by(len, &header);
        Ok(1)
    }

    fn fill_many(&mut self, socket: BorrowedFd<'_>, limit: usize) -> io::Result<usize> {
        let mut vectors = [NOWHERE; BATCH];
        // SAFETY: null pointers with lengths of 0 are valid in every field of a message header.
        let mut headers: [libc::mmsghdr; BATCH] = unsafe { MaybeUninit::zeroed().assume_init() };
        let memory = self.frames.iter_mut().zip(&mut self.controls).take(limit);
        for ((vector, header), (frame, control)) in vectors.iter_mut().zip(&mut headers).zip(memory)
        {
            init_header(&mut header.msg_hdr, vector, frame, control);
        }
        let limit = libc::c_uint::try_from(limit).unwrap_or(1);
        // SAFETY: `limit` is at most the number of headers. Each of so many headers points to one vector and to a
        // control buffer of the given length; vectors point to buffers of the given lengths. All of them outlive the
        // call, are not aliased, and the kernel writes within these bounds. A null timeout is allowed.
        let count = unsafe {
            libc::recvmmsg(
                socket.as_raw_fd(),
                headers.as_mut_ptr(),
                limit,
                libc::MSG_DONTWAIT,
                ptr::null_mut(),
            )
        };
        let count = usize::try_from(count).map_err(|_| io::Error::last_os_error())?;
        for (info, header) in self.info.iter_mut().zip(headers.iter().take(count)) {
            let len = usize::try_from(header.msg_len).unwrap_or(0);
            *info = MessageInfo::by(len, &header.msg_hdr);
        }
        Ok(count)
    }

    /// The frame at an index below the last count.
    #[inline]
    pub(super) fn get(&self, at: usize) -> Stamped {
        let all = (
            self.info.get(at),
            self.frames.get(at),
            self.controls.get(at),
        );
        let (Some(info), Some(frame), Some(control)) = all else {
            return Stamped::default();
        };
        let mut stamped = Stamped {
            frame: frame.get(..info.len).and_then(kernel::decode),
            origin: origin(info.flags),
            ..Stamped::default()
        };
        read_control(
            control.0.get(..info.control_len).unwrap_or_default(),
            &mut stamped,
        );
        stamped
    }
}

impl MessageInfo {
    const fn by(len: usize, header: &libc::msghdr) -> Self {
        Self {
            len,
            control_len: header.msg_controllen,
            flags: header.msg_flags,
        }
    }
}

const NOWHERE: libc::iovec = libc::iovec {
    iov_base: ptr::null_mut(),
    iov_len: 0,
};

/// Points a message header to the buffers of a frame and its control messages.
fn init_header(
    header: &mut libc::msghdr,
    vector: &mut libc::iovec,
    frame: &mut [u8; kernel::FD_LEN],
    control: &mut Control,
) {
    vector.iov_base = frame.as_mut_ptr().cast();
    vector.iov_len = frame.len();
    header.msg_iov = vector;
    header.msg_iovlen = 1;
    header.msg_control = control.0.as_mut_ptr().cast();
    header.msg_controllen = CONTROL_LEN as _;
}

/// The kernel marks frames of this host's programs, and among them those of this socket.
const fn origin(flags: i32) -> Origin {
    if flags & libc::MSG_CONFIRM != 0 {
        Origin::Own
    } else if flags & libc::MSG_DONTROUTE != 0 {
        Origin::Host
    } else {
        Origin::Bus
    }
}

/// Length of a control message header: length, level and type.
const HEAD: usize = size_of::<libc::cmsghdr>();

/// Control messages are contiguous, aligned to the word length.
#[inline]
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

/// One of three time stamps, ns; zero means absent.
#[inline]
fn timespec(content: &[u8], at: usize) -> Option<u64> {
    let bytes = content.get(at * size_of::<libc::timespec>()..)?;
    let (seconds, rest) = bytes.split_first_chunk()?;
    let seconds = u64::try_from(libc::time_t::from_ne_bytes(*seconds)).ok()?;
    let nanos = u64::try_from(libc::c_long::from_ne_bytes(*rest.first_chunk()?)).ok()?;
    let stamp = seconds.saturating_mul(1_000_000_000).saturating_add(nanos);
    (stamp != 0).then_some(stamp)
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
    fn drain_control_messages_are_decoded() {
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
        assert_eq!(stamped.software, Some(1_700_000_000_000_125_000));
        assert_eq!(stamped.hardware, Some(9_000_000_007));
    }

    #[test]
    fn drain_flags_map_to_origin() {
        assert_eq!(origin(0), Origin::Bus);
        assert_eq!(origin(0x4), Origin::Host);
        assert_eq!(origin(0x804), Origin::Own);
    }

    #[test]
    fn drain_empty_socket_is_no_error() {
        let (socket, _peer) = std::os::unix::net::UnixDatagram::pair().unwrap();
        let mut buffers = Buffers::new();
        assert_eq!(
            buffers
                .fill(std::os::fd::AsFd::as_fd(&socket), BATCH)
                .unwrap(),
            0
        );
    }

    /// The system call works with any datagram socket.
    #[test]
    fn drain_one_call_receives_all_available_frames() {
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
        assert_eq!(buffers.fill(fd, 1).unwrap(), 1);
        assert_eq!(
            buffers.get(0).frame.and_then(|f| f.id()).map(|id| id.raw()),
            Some(4)
        );
        assert_eq!(buffers.fill(fd, BATCH).unwrap(), 1);
        assert_eq!(
            buffers.get(0).frame.and_then(|f| f.id()).map(|id| id.raw()),
            Some(5)
        );
        assert!(buffers.get(BATCH).frame.is_none());
        assert_eq!(buffers.fill(fd, 1).unwrap(), 0);
    }

    proptest! {
        #[test]
        fn drain_any_control_bytes_do_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..140), len in 0..40_usize) {
            let mut bytes = bytes;
            if let Some(head) = bytes.first_chunk_mut::<8>() {
                *head = len.to_ne_bytes();
            }
            read_control(&bytes, &mut Stamped::default());
        }
    }
}

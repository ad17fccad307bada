//! Changes of a network interface by rtnetlink, with the kernel's error number and error text. The library that reads
//! the state of interfaces loses both on a change. Of CAN it knows only the attribute numbers.
//!
//! | bytes of a request | content |
//! |---|---|
//! | 0 to 3 | total length |
//! | 4, 5 | 16: `RTM_NEWLINK` |
//! | 6, 7 | 5: request with acknowledgement |
//! | 20 to 23 | interface index |
//! | 24 to 27, 28 to 31 | flags, and mask of the flags to change |
//! | 32 ... | attributes: length (2 bytes), type (2 bytes), content, each aligned to four bytes |

#![allow(
    unsafe_code,
    reason = "no library in use offers these two options of a netlink socket"
)]

use std::io;
use std::os::fd::{AsRawFd as _, OwnedFd};

use nix::errno::Errno;
use nix::sys::socket::{
    AddressFamily, MsgFlags, NetlinkAddr, SockFlag, SockProtocol, SockType, recv, sendto, socket,
};

const RTM_NEWLINK: u16 = 16;
const REQUEST_AND_ACK: u16 = 1 | 4;
pub(super) const NLMSG_ERROR: u16 = 2;
/// Flag of an answer: attributes follow the request.
const ACK_TLVS: u16 = 0x200;
/// Flag of an answer: it contains only the header of the request.
const CAPPED: u16 = 0x100;
const ERROR_TEXT: u16 = 1;
const IFF_UP: u32 = 1;

const IFLA_TXQLEN: u16 = 13;
const IFLA_LINKINFO: u16 = 18;
const IFLA_INFO_KIND: u16 = 1;
const IFLA_INFO_DATA: u16 = 2;

/// Attributes of a CAN controller (`linux/can/netlink.h`).
pub(super) mod can {
    pub(in crate::linux) const BIT_TIMING: u16 = 1;
    pub(in crate::linux) const MODES: u16 = 5;
    pub(in crate::linux) const RESTART_MS: u16 = 6;
    pub(in crate::linux) const RESTART: u16 = 7;
    pub(in crate::linux) const DATA_BIT_TIMING: u16 = 9;
}

/// Error of a change, as reported by the kernel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct KernelError {
    pub(super) errno: i32,
    /// Error text; older kernels have none.
    pub(super) text: Option<String>,
}

impl From<io::Error> for KernelError {
    fn from(error: io::Error) -> Self {
        Self {
            errno: error.raw_os_error().unwrap_or(libc::EIO),
            text: None,
        }
    }
}

impl From<Errno> for KernelError {
    fn from(errno: Errno) -> Self {
        Self {
            errno: errno as i32,
            text: None,
        }
    }
}

/// A change of one interface.
#[derive(Clone, Debug)]
pub(super) struct Change {
    bytes: Vec<u8>,
}

const HEAD: usize = 32;

impl Change {
    fn new(index: u32, flags: u32, mask: u32) -> Self {
        let mut bytes = vec![0; 4];
        bytes.extend(RTM_NEWLINK.to_ne_bytes());
        bytes.extend(REQUEST_AND_ACK.to_ne_bytes());
        // Sequence number, port, family and type: 0.
        bytes.extend([0; 12]);
        for number in [index, flags, mask] {
            bytes.extend(number.to_ne_bytes());
        }
        debug_assert_eq!(bytes.len(), HEAD);
        Self { bytes }
    }

    /// Up or down.
    pub(super) fn up(index: u32, up: bool) -> Self {
        Self::new(index, if up { IFF_UP } else { 0 }, IFF_UP)
    }

    /// Length of the send queue, frames.
    pub(super) fn queue(index: u32, frames: u32) -> Self {
        let mut change = Self::new(index, 0, 0);
        attribute(&mut change.bytes, IFLA_TXQLEN, &frames.to_ne_bytes());
        change
    }

    /// An attribute of a CAN controller, made of 32-bit numbers.
    pub(super) fn can(index: u32, kind: u16, numbers: &[u32]) -> Self {
        let content: Vec<u8> = numbers
            .iter()
            .flat_map(|number| number.to_ne_bytes())
            .collect();
        let mut data = Vec::new();
        attribute(&mut data, kind, &content);
        let mut info = Vec::new();
        attribute(&mut info, IFLA_INFO_KIND, b"can");
        attribute(&mut info, IFLA_INFO_DATA, &data);
        let mut change = Self::new(index, 0, 0);
        attribute(&mut change.bytes, IFLA_LINKINFO, &info);
        change
    }

    /// Sends the request to the kernel and waits for the answer.
    pub(super) fn request(mut self) -> Result<(), KernelError> {
        let len = u32::try_from(self.bytes.len()).unwrap_or(0).to_ne_bytes();
        self.bytes
            .iter_mut()
            .zip(len)
            .for_each(|(to, from)| *to = from);
        let kernel = Kernel::open()?;
        enable_error_text(&kernel.0);
        kernel.send(&self.bytes)?;
        let mut answer = [0; 4096];
        read_answer(kernel.receive(&mut answer)?)
    }
}

/// Address of the kernel.
pub(super) struct Kernel(OwnedFd);

impl Kernel {
    pub(super) fn open() -> nix::Result<Self> {
        let protocol = SockProtocol::NetlinkRoute;
        let flags = SockFlag::SOCK_CLOEXEC;
        socket(AddressFamily::Netlink, SockType::Raw, flags, protocol).map(Self)
    }

    pub(super) fn send(&self, bytes: &[u8]) -> nix::Result<()> {
        let kernel = NetlinkAddr::new(0, 0);
        sendto(self.0.as_raw_fd(), bytes, &kernel, MsgFlags::empty()).map(drop)
    }

    /// Waits for an answer; restarts after a signal.
    pub(super) fn receive<'a>(&self, answer: &'a mut [u8]) -> nix::Result<&'a [u8]> {
        loop {
            match recv(self.0.as_raw_fd(), answer, MsgFlags::empty()) {
                Ok(len) => return Ok(answer.get(..len).unwrap_or_default()),
                Err(Errno::EINTR) => {}
                Err(errno) => return Err(errno),
            }
        }
    }
}

pub(super) fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_ne_bytes(*bytes.get(at..)?.first_chunk()?))
}

pub(super) fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_ne_bytes(*bytes.get(at..)?.first_chunk()?))
}

/// The content of the first attribute of that type.
pub(super) fn find_attribute(mut rest: &[u8], kind: u16) -> Option<&[u8]> {
    loop {
        let len = usize::from(u16_at(rest, 0)?);
        let content = rest.get(4..len)?;
        // The top bits are flags.
        if u16_at(rest, 2)? & 0x3FFF == kind {
            return Some(content);
        }
        rest = rest.get(len.next_multiple_of(4)..)?;
    }
}

/// Appends an attribute, padded to four bytes.
pub(super) fn attribute(bytes: &mut Vec<u8>, kind: u16, content: &[u8]) {
    let len = u16::try_from(4 + content.len()).unwrap_or(u16::MAX);
    bytes.extend(len.to_ne_bytes());
    bytes.extend(kind.to_ne_bytes());
    bytes.extend(content);
    bytes.resize(bytes.len().next_multiple_of(4), 0);
}

/// Older kernels support neither option and send no text.
fn enable_error_text(socket: &OwnedFd) {
    let on: libc::c_int = 1;
    let len = libc::socklen_t::try_from(size_of_val(&on)).unwrap_or(0);
    for option in [libc::NETLINK_EXT_ACK, libc::NETLINK_CAP_ACK] {
        // SAFETY: the option's value outlives the call and has the given length.
        let _ = unsafe {
            libc::setsockopt(
                socket.as_raw_fd(),
                libc::SOL_NETLINK,
                option,
                (&raw const on).cast(),
                len,
            )
        };
    }
}

/// | bytes of an answer | content |
/// |---|---|
/// | 0 to 3 | total length |
/// | 4, 5 | 2: `NLMSG_ERROR`, acknowledgement or error |
/// | 6, 7 | flags |
/// | 16 to 19 | negative error number; 0 for success |
/// | 20 ... | the request, or its 16-byte header; then attributes |
fn read_answer(bytes: &[u8]) -> Result<(), KernelError> {
    let (u16_at, u32_at) = (|at| u16_at(bytes, at), |at| u32_at(bytes, at));
    let foreign = || KernelError {
        errno: libc::EBADMSG,
        text: None,
    };
    let kind = u16_at(4).filter(|kind| *kind == NLMSG_ERROR);
    let (_, flags, error) = match (kind, u16_at(6), u32_at(16)) {
        (Some(kind), Some(flags), Some(error)) => (kind, flags, error.cast_signed()),
        _ => return Err(foreign()),
    };
    if error == 0 {
        return Ok(());
    }
    let echoed = if flags & CAPPED != 0 {
        Some(16)
    } else {
        u32_at(20).and_then(|len| usize::try_from(len).ok())
    };
    let tail = echoed.and_then(|len| bytes.get(20_usize.checked_add(len.next_multiple_of(4))?..));
    Err(KernelError {
        errno: error.saturating_neg(),
        text: tail.filter(|_| flags & ACK_TLVS != 0).and_then(text),
    })
}

/// The error text of the attributes.
fn text(rest: &[u8]) -> Option<String> {
    let content = find_attribute(rest, ERROR_TEXT)?;
    let end = content.split(|byte| *byte == 0).next()?;
    Some(String::from_utf8_lossy(end).into_owned())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn netlink_attributes_are_nested_and_padded() {
        let change = Change::can(7, can::RESTART_MS, &[100]);
        let rest = &change.bytes[HEAD..];
        let expected: Vec<u8> = [
            [24_u16.to_ne_bytes(), IFLA_LINKINFO.to_ne_bytes()].concat(),
            [7_u16.to_ne_bytes(), IFLA_INFO_KIND.to_ne_bytes()].concat(),
            b"can\0".to_vec(),
            [12_u16.to_ne_bytes(), IFLA_INFO_DATA.to_ne_bytes()].concat(),
            [8_u16.to_ne_bytes(), can::RESTART_MS.to_ne_bytes()].concat(),
            100_u32.to_ne_bytes().to_vec(),
        ]
        .concat();
        assert_eq!(rest, expected);
        assert_eq!(change.bytes[20..24], 7_u32.to_ne_bytes());
        assert_eq!(RTM_NEWLINK, libc::RTM_NEWLINK);
        assert_eq!(IFLA_TXQLEN, libc::IFLA_TXQLEN);
        assert_eq!(IFLA_LINKINFO, libc::IFLA_LINKINFO);
    }

    fn answer(flags: u16, error: i32, tail: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; 4];
        bytes.extend(NLMSG_ERROR.to_ne_bytes());
        bytes.extend(flags.to_ne_bytes());
        bytes.extend([0; 8]);
        bytes.extend(error.to_ne_bytes());
        bytes.extend(16_u32.to_ne_bytes());
        bytes.extend([0; 12]);
        bytes.extend(tail);
        bytes
    }

    #[test]
    fn netlink_answers_are_decoded() {
        assert_eq!(read_answer(&answer(CAPPED, 0, &[])), Ok(()));
        let mut tail = Vec::new();
        attribute(&mut tail, 2, &[0; 4]);
        attribute(&mut tail, ERROR_TEXT, b"bitrate error too high\0");
        for flags in [CAPPED | ACK_TLVS, ACK_TLVS] {
            let error = read_answer(&answer(flags, -libc::EINVAL, &tail)).unwrap_err();
            assert_eq!(error.errno, libc::EINVAL);
            assert_eq!(error.text.as_deref(), Some("bitrate error too high"));
        }
        let error = read_answer(&answer(CAPPED, -libc::EPERM, &[])).unwrap_err();
        assert_eq!((error.errno, error.text), (libc::EPERM, None));
        assert_eq!(read_answer(&[]).unwrap_err().errno, libc::EBADMSG);
    }

    /// As any user: the interface does not exist, or the user lacks permission.
    #[test]
    fn netlink_missing_interface_is_rejected() {
        let error = Change::up(0x7FFF_FFF0, true).request().unwrap_err();
        assert!(
            matches!(error.errno, libc::ENODEV | libc::EPERM),
            "{error:?}"
        );
    }

    proptest! {
        #[test]
        fn netlink_any_answer_does_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..100), flags in any::<u16>()) {
            let _ = read_answer(&bytes);
            let _ = read_answer(&answer(flags, -1, &bytes));
        }
    }
}

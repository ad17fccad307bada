//! The kernel's broadcast manager (BCM): cyclic transmission and timeout monitoring by the kernel. The kernel starts
//! each period when the previous one actually ended, so periods drift; a SYNC that must stay in phase with a cycle is
//! sent by the cycle instead.
//!
//! | bytes of a message (64-bit words) | content |
//! |---|---|
//! | 0 to 3 | command |
//! | 4 to 7 | flags |
//! | 8 to 11 | number of periods of the first length; 0 here |
//! | 16 to 31 | first period or timeout, s and µs |
//! | 32 to 47 | second period, s and µs |
//! | 48 to 51 | identifier |
//! | 52 to 55 | number of frames that follow |
//! | 56 ... | frames |

#![allow(
    unsafe_code,
    reason = "a socket of this protocol is connected to an interface, which no library does"
)]

use std::io;
use std::os::fd::{AsFd as _, AsRawFd as _, FromRawFd as _, OwnedFd};
use std::time::Duration;

use nix::errno::Errno;
use nix::net::if_::if_nametoindex;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::socket::{MsgFlags, recv, send};
use nix::sys::time::TimeSpec;

use super::kernel::{self, CLASSIC_LEN};
use crate::{AnyFrame, Frame, Id};

const TX_SETUP: u32 = 1;
const RX_SETUP: u32 = 5;
const RX_TIMEOUT: u32 = 11;
const RX_CHANGED: u32 = 12;

const SETTIMER: u32 = 0x0001;
const STARTTIMER: u32 = 0x0002;
const RX_ANNOUNCE_RESUME: u32 = 0x0100;

/// Size of a word: half of a time value, and the alignment of the header.
const WORD: usize = size_of::<libc::c_long>();
/// Command, flags and count, padded to a multiple of a word.
const TIMES: usize = 12_usize.next_multiple_of(WORD);
const ID: usize = TIMES + 4 * WORD;
/// Frames are aligned to eight bytes.
const HEAD: usize = (ID + 8).next_multiple_of(8);
const LEN: usize = HEAD + CLASSIC_LEN;

/// A message with at most one frame.
fn message(
    command: u32,
    flags: u32,
    (first, second): (Duration, Duration),
    id: u32,
    frame: Option<&Frame>,
) -> ([u8; LEN], usize) {
    let mut bytes = [0; LEN];
    let mut put = |at: usize, number: &[u8]| {
        let target = bytes.iter_mut().skip(at);
        target.zip(number).for_each(|(to, from)| *to = *from);
    };
    put(0, &command.to_ne_bytes());
    put(4, &flags.to_ne_bytes());
    for (at, time) in [(TIMES, first), (TIMES + 2 * WORD, second)] {
        let seconds = libc::c_long::try_from(time.as_secs()).unwrap_or(libc::c_long::MAX);
        put(at, &seconds.to_ne_bytes());
        let micros = libc::c_long::from(time.subsec_micros().cast_signed());
        put(at + WORD, &micros.to_ne_bytes());
    }
    put(ID, &id.to_ne_bytes());
    put(ID + 4, &u32::from(frame.is_some()).to_ne_bytes());
    if let Some(frame) = frame {
        put(HEAD, kernel::encode(&AnyFrame::Classic(*frame)).as_slice());
    }
    let len = if frame.is_some() { LEN } else { HEAD };
    (bytes, len)
}

/// A socket of the broadcast manager on an interface.
fn connect(interface: &str) -> io::Result<OwnedFd> {
    let index = if_nametoindex(interface).map_err(|_| no_such(interface))?;
    let kind = libc::SOCK_DGRAM | libc::SOCK_CLOEXEC;
    // SAFETY: three plain numbers.
    let fd = unsafe { libc::socket(libc::PF_CAN, kind, libc::CAN_BCM) };
    if fd < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the descriptor is new, so no one else owns or closes it.
    let socket = unsafe { OwnedFd::from_raw_fd(fd) };
    // SAFETY: all fields are numbers, of which 0 is a valid one.
    let mut address: libc::sockaddr_can = unsafe { std::mem::zeroed() };
    address.can_family = libc::sa_family_t::try_from(libc::AF_CAN).unwrap_or(29);
    address.can_ifindex = libc::c_int::try_from(index).unwrap_or(0);
    let len = libc::socklen_t::try_from(size_of_val(&address)).unwrap_or(0);
    // SAFETY: the address outlives the call and has the given length.
    let done = unsafe { libc::connect(fd, (&raw const address).cast(), len) };
    if done < 0 {
        return Err(io::Error::last_os_error());
    }
    Ok(socket)
}

fn no_such(interface: &str) -> io::Error {
    let text = format!("there is no interface {interface}");
    io::Error::new(io::ErrorKind::NotFound, text)
}

fn write(socket: &OwnedFd, (bytes, len): &([u8; LEN], usize)) -> io::Result<()> {
    let bytes = bytes.get(..*len).unwrap_or_default();
    send(socket.as_raw_fd(), bytes, MsgFlags::empty())?;
    Ok(())
}

fn frame_id(id: Id) -> u32 {
    id.raw()
        | if id.is_extended() {
            libc::CAN_EFF_FLAG
        } else {
            0
        }
}

/// A frame that the kernel sends cyclically until this value is dropped.
#[derive(Debug)]
pub struct Cyclic {
    socket: OwnedFd,
    period: Duration,
}

impl Cyclic {
    /// Sends a frame at once and then every period, in whole microseconds.
    ///
    /// # Errors
    /// Of the operating system, e.g. when the kernel module `can-bcm` is missing.
    pub fn start(interface: &str, frame: &Frame, period: Duration) -> io::Result<Self> {
        let cyclic = Self {
            socket: connect(interface)?,
            period,
        };
        cyclic.setup(frame, SETTIMER | STARTTIMER)?;
        Ok(cyclic)
    }

    /// Replaces the content from the next period on. The identifier must not change.
    pub fn update(&self, frame: &Frame) -> io::Result<()> {
        self.setup(frame, 0)
    }

    fn setup(&self, frame: &Frame, flags: u32) -> io::Result<()> {
        let times = (Duration::ZERO, self.period);
        let id = frame_id(frame.id());
        write(
            &self.socket,
            &message(TX_SETUP, flags, times, id, Some(frame)),
        )
    }
}

/// Event of a monitored identifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Watched {
    /// Received for the first time, with changed content, or again after a timeout.
    Changed(Frame),
    /// Not received within the timeout.
    Silent(Id),
}

/// Timeout monitoring of an identifier by the kernel; unchanged frames wake no thread.
#[derive(Debug)]
pub struct Watch {
    socket: OwnedFd,
    id: Id,
}

impl Watch {
    /// Monitors an identifier with a `timeout`, which starts with its first frame.
    pub fn start(interface: &str, id: Id, timeout: Duration) -> io::Result<Self> {
        let socket = connect(interface)?;
        let flags = SETTIMER | STARTTIMER | RX_ANNOUNCE_RESUME;
        // The frame is the mask of compared bits: all.
        let all = Frame::new(id, &[0xFF; 8]).map_err(|_| io::ErrorKind::InvalidInput)?;
        let times = (timeout, Duration::ZERO);
        write(
            &socket,
            &message(RX_SETUP, flags, times, frame_id(id), Some(&all)),
        )?;
        Ok(Self { socket, id })
    }

    /// Waits at most `timeout` for a change or for a timeout of the identifier.
    pub fn wait(&self, timeout: Duration) -> io::Result<Option<Watched>> {
        let mut fds = [PollFd::new(self.socket.as_fd(), PollFlags::POLLIN)];
        match ppoll(&mut fds, Some(TimeSpec::from_duration(timeout)), None) {
            Ok(0) | Err(Errno::EINTR) => return Ok(None),
            Ok(_) => {}
            Err(error) => return Err(error.into()),
        }
        let mut bytes = [0; LEN];
        let len = recv(self.socket.as_raw_fd(), &mut bytes, MsgFlags::MSG_DONTWAIT)?;
        Ok(self.decode(bytes.get(..len).unwrap_or_default()))
    }

    fn decode(&self, bytes: &[u8]) -> Option<Watched> {
        match u32::from_ne_bytes(*bytes.first_chunk()?) {
            RX_TIMEOUT => Some(Watched::Silent(self.id)),
            RX_CHANGED => match kernel::decode(bytes.get(HEAD..HEAD + CLASSIC_LEN)?)? {
                AnyFrame::Classic(frame) => Some(Watched::Changed(frame)),
                AnyFrame::Fd(_) | AnyFrame::Error(_) => None,
            },
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bcm_layout_matches_kernel() {
        type Head = libc::bcm_msg_head;
        assert_eq!(TIMES, std::mem::offset_of!(Head, ival1));
        assert_eq!(TIMES + 2 * WORD, std::mem::offset_of!(Head, ival2));
        assert_eq!(ID, std::mem::offset_of!(Head, can_id));
        assert_eq!(HEAD, std::mem::offset_of!(Head, frames));
        assert_eq!(HEAD, size_of::<Head>());
        assert_eq!(TX_SETUP, libc::TX_SETUP);
        assert_eq!(RX_SETUP, libc::RX_SETUP);
        assert_eq!(RX_TIMEOUT, libc::RX_TIMEOUT);
        assert_eq!(RX_CHANGED, libc::RX_CHANGED);
        assert_eq!(RX_ANNOUNCE_RESUME, libc::RX_ANNOUNCE_RESUME);
    }

    #[test]
    fn bcm_missing_interface_is_named() {
        let frame = Frame::empty(Id::standard(0x80).unwrap());
        let error = Cyclic::start("nosuchcan0", &frame, Duration::from_millis(10)).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
        assert!(error.to_string().contains("nosuchcan0"));
    }
}

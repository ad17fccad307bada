//! Times of arrival as the kernel stamps them (`SO_TIMESTAMPNS`), on the monotonic clock: with them, what the network delays
//! differs from what this host adds until its program wakes up. Stamps of network interfaces are not used: their clocks
//! are others.

use std::io::{self, IoSliceMut};
use std::net::SocketAddr;
use std::os::fd::{AsFd, AsRawFd as _, BorrowedFd};
use std::time::Duration;

use nix::sys::socket::{
    ControlMessageOwned, MsgFlags, SockaddrLike, SockaddrStorage, recvmsg, setsockopt, sockopt,
};
use nix::time::{ClockId, clock_gettime};

use super::monotonic;

/// A stamp older than this, or of the future, means that the wall clock was set: the time of reading stands in for it.
const AGE_MAX: Duration = Duration::from_secs(10);
/// Longest time to read both clocks, and the number of attempts.
const READING_MAX: Duration = Duration::from_micros(50);
const READINGS_MAX: u32 = 3;

/// Space for one control message with a stamp, aligned as the kernel's header.
#[repr(align(8))]
struct Control([u8; 64]);

/// Lets the kernel stamp what arrives at a socket from now on.
///
/// # Errors
/// Of the operating system.
pub fn stamp_arrivals(socket: &impl AsFd) -> io::Result<()> {
    Ok(setsockopt(socket, sockopt::ReceiveTimestampns, &true)?)
}

/// Receives one datagram without waiting: its length (at most that of `buf`), its sender, and its time of arrival.
///
/// # Errors
/// Of the operating system: [`io::ErrorKind::WouldBlock`] if none is waiting at a non-blocking socket.
pub fn receive_from(
    socket: BorrowedFd<'_>,
    buf: &mut [u8],
) -> io::Result<(usize, Option<SocketAddr>, Duration)> {
    let (len, from, at) = receive::<SockaddrStorage>(socket, buf)?;
    Ok((len, from.as_ref().and_then(address), at))
}

/// As [`receive_from`], from a packet socket: length and time of arrival.
///
/// # Errors
/// As there.
pub fn receive_frame(socket: BorrowedFd<'_>, buf: &mut [u8]) -> io::Result<(usize, Duration)> {
    let (len, _, at) = receive::<()>(socket, buf)?;
    Ok((len, at))
}

fn receive<S: SockaddrLike>(
    socket: BorrowedFd<'_>,
    buf: &mut [u8],
) -> io::Result<(usize, Option<S>, Duration)> {
    let mut control = Control([0; 64]);
    let mut parts = [IoSliceMut::new(buf)];
    let fd = socket.as_raw_fd();
    let received = recvmsg::<S>(fd, &mut parts, Some(&mut control.0), MsgFlags::empty())?;
    let mut stamps = received.cmsgs().into_iter().flatten();
    let stamp = stamps.find_map(|message| {
        let ControlMessageOwned::ScmTimestampns(stamp) = message else {
            return None;
        };
        Some(Duration::from(stamp))
    });
    let (len, from) = (received.bytes, received.address);
    Ok((len, from, arrival(stamp)?))
}

fn address(from: &SockaddrStorage) -> Option<SocketAddr> {
    let v4 = from.as_sockaddr_in().map(|v4| SocketAddr::V4((*v4).into()));
    v4.or_else(|| {
        from.as_sockaddr_in6()
            .map(|v6| SocketAddr::V6((*v6).into()))
    })
}

/// The instant of a stamp of the wall clock, on the monotonic clock.
fn arrival(stamp: Option<Duration>) -> io::Result<Duration> {
    let mut now = monotonic()?;
    // Simulated time may have stood since: the wall clock has not.
    let is_simulated = takt_rt::simulated::waited().is_some();
    let Some(stamp) = stamp.filter(|_| !is_simulated) else {
        return Ok(now);
    };
    let mut wall = Duration::ZERO;
    for _ in 0..READINGS_MAX {
        wall = clock_gettime(ClockId::CLOCK_REALTIME)?.into();
        let before = std::mem::replace(&mut now, monotonic()?);
        if now.saturating_sub(before) < READING_MAX {
            break;
        }
    }
    Ok(before(now, wall, stamp))
}

/// `now` less the age of a stamp at the same instant of the wall clock.
fn before(now: Duration, wall: Duration, stamp: Duration) -> Duration {
    let age = wall.checked_sub(stamp).filter(|age| *age <= AGE_MAX);
    now.saturating_sub(age.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{Ipv4Addr, UdpSocket};

    #[test]
    #[expect(
        clippy::disallowed_methods,
        reason = "time passes between arrival and reading"
    )]
    fn stamp_is_arrival_not_reading() {
        let receiver = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let sender = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        stamp_arrivals(&receiver).unwrap();
        // The kernel enables stamps a moment after the first socket asks for them.
        let wait = Duration::from_millis(20);
        let mut is_stamped = false;
        for _ in 0..50 {
            let address = receiver.local_addr().unwrap();
            sender.send_to(&[7; 3], address).unwrap();
            let sent = monotonic().unwrap();
            std::thread::sleep(wait);
            let mut buf = [0; 2];
            let (len, from, at) = receive_from(receiver.as_fd(), &mut buf).unwrap();
            assert_eq!((len, buf), (2, [7; 2]), "cut to the buffer");
            assert_eq!(from, Some(sender.local_addr().unwrap()));
            is_stamped |= at <= sent;
            if is_stamped {
                break;
            }
        }
        assert!(is_stamped);
        receiver.set_nonblocking(true).unwrap();
        let none = receive_from(receiver.as_fd(), &mut [0; 2]).unwrap_err();
        assert_eq!(none.kind(), io::ErrorKind::WouldBlock);
    }

    #[test]
    fn stamp_after_clock_step_is_time_of_reading() {
        let s = Duration::from_secs;
        assert_eq!(before(s(100), s(1_000), s(999)), s(99));
        assert_eq!(before(s(100), s(1_000), s(1_001)), s(100), "set back");
        assert_eq!(before(s(100), s(1_000), s(900)), s(100), "set on");
        assert_eq!(before(s(1), s(1_000), s(995)), s(0));
    }
}

//! A network interface as a [`Link`]: a raw packet socket (packet(7)) that sees EtherCAT frames alone. No
//! allocation after opening. It does not configure the interface; see its driver's interrupt coalescing, which
//! delays answers by up to 100 us (`ethtool -C IFACE rx-usecs 0 tx-usecs 0`).
#![expect(unsafe_code, reason = "packet sockets have no safe wrapper")]

use std::io;
use std::os::fd::{AsFd, AsRawFd, FromRawFd, OwnedFd};
use std::time::Duration;

use takt_link::linux::{monotonic, readable, receive_frame, stamp_arrivals};

use super::InterfaceLock;
use crate::link::{ETHER_TYPE, Link};

/// A raw packet socket on one interface.
#[derive(Debug)]
pub struct PacketLink {
    socket: OwnedFd,
    interface: String,
    /// Of the interface.
    mac: [u8; 6],
    /// How long a wait polls before it sleeps.
    spin: Duration,
    /// Excludes other programs; `None` for a listener or on request of the caller.
    _lock: Option<InterfaceLock>,
}

impl PacketLink {
    /// Polls for this time before a wait sleeps; zero, the default, sleeps at once.
    ///
    /// Frames that arrive meanwhile are received without a wake-up by the kernel, some microseconds earlier and with
    /// less jitter. Polling keeps a processor busy for this time in each cycle: set it to 1.5 round trips, on a
    /// dedicated processor.
    #[must_use]
    pub const fn spinning(mut self, spin: Duration) -> Self {
        self.spin = spin;
        self
    }

    /// Opens an interface as [`Self::open`] does, and excludes other programs of Takt; used by masters and emulated
    /// segments.
    ///
    /// # Errors
    /// If it cannot be opened, or another program has it.
    pub fn open_locked(interface: &str) -> io::Result<Self> {
        let link = Self::open(interface)?;
        Ok(Self {
            _lock: Some(InterfaceLock::take(interface)?),
            ..link
        })
    }

    /// Listens before the first frame goes out.
    ///
    /// # Errors
    /// If a frame is received in that time (`AddrInUse`): another master sends on that segment. Nothing was sent then.
    pub fn listen_first(&mut self, interface: &str, time: Duration) -> io::Result<()> {
        let mut frame = [0; crate::link::FRAME_MAX];
        if self.receive(&mut frame, time)?.is_none() {
            return Ok(());
        }
        let text = format!(
            "{interface}: frames of another master came, nothing was sent\nhint: stop what sends on this segment first"
        );
        Err(io::Error::new(io::ErrorKind::AddrInUse, text))
    }

    /// Opens an interface, promiscuous, for EtherCAT frames. Needs CAP_NET_RAW.
    pub fn open(interface: &str) -> io::Result<Self> {
        let index = nix::net::if_::if_nametoindex(interface).map_err(|error| {
            with_context(
                interface,
                "there is no such interface (`ip link` lists them)",
                error.into(),
            )
        })?;
        let index = index.cast_signed();
        let kind = libc::SOCK_RAW | libc::SOCK_NONBLOCK | libc::SOCK_CLOEXEC;
        let protocol = libc::c_int::from(ETHER_TYPE.to_be());
        // SAFETY: socket(2) takes three numbers.
        let raw = unsafe { libc::socket(libc::AF_PACKET, kind, protocol) };
        if raw < 0 {
            let error = io::Error::last_os_error();
            let text = "no raw socket: run as root, or `setcap cap_net_raw+ep` the program";
            return Err(with_context(interface, text, error));
        }
        // SAFETY: `raw` was just opened, is valid, and has no other owner.
        let socket = unsafe { OwnedFd::from_raw_fd(raw) };
        bind(&socket, index)
            .map_err(|error| with_context(interface, "the socket cannot be bound", error))?;
        set(&socket, libc::PACKET_IGNORE_OUTGOING, &1_i32)?;
        stamp_arrivals(&socket)?;
        let member = libc::packet_mreq {
            mr_ifindex: index,
            mr_type: u16::try_from(libc::PACKET_MR_PROMISC).unwrap_or_default(),
            mr_alen: 0,
            mr_address: [0; 8],
        };
        set(&socket, libc::PACKET_ADD_MEMBERSHIP, &member)?;
        let mac = mac_of(interface).unwrap_or([0x02, 0, 0, 0, 0, 1]);
        let spin = Duration::ZERO;
        Ok(Self {
            socket,
            interface: interface.to_owned(),
            mac,
            spin,
            _lock: None,
        })
    }

    /// MAC address of the interface; a locally administered one if it has none.
    pub const fn mac(&self) -> [u8; 6] {
        self.mac
    }
}

fn with_context(interface: &str, text: &str, error: io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{interface}: {text}: {error}"))
}

fn bind(socket: &OwnedFd, index: libc::c_int) -> io::Result<()> {
    let address = libc::sockaddr_ll {
        sll_family: u16::try_from(libc::AF_PACKET).unwrap_or_default(),
        sll_protocol: ETHER_TYPE.to_be(),
        sll_ifindex: index,
        sll_hatype: 0,
        sll_pkttype: 0,
        sll_halen: 0,
        sll_addr: [0; 8],
    };
    let len = len_of::<libc::sockaddr_ll>();
    // SAFETY: the pointer is to a whole sockaddr_ll that lives over the call, and `len` is its size.
    let done = unsafe { libc::bind(socket.as_raw_fd(), (&raw const address).cast(), len) };
    checked(done)
}

fn set<T>(socket: &OwnedFd, option: libc::c_int, value: &T) -> io::Result<()> {
    let (fd, value, len) = (
        socket.as_raw_fd(),
        (&raw const *value).cast(),
        len_of::<T>(),
    );
    // SAFETY: the pointer is to a value of `len` bytes that lives over the call.
    let done = unsafe { libc::setsockopt(fd, libc::SOL_PACKET, option, value, len) };
    checked(done)
}

fn len_of<T>() -> libc::socklen_t {
    libc::socklen_t::try_from(size_of::<T>()).unwrap_or_default()
}

fn checked(done: libc::c_int) -> io::Result<()> {
    if done < 0 {
        Err(io::Error::last_os_error())
    } else {
        Ok(())
    }
}

/// As in sysfs, `02:00:00:00:00:01`.
fn mac_of(interface: &str) -> Option<[u8; 6]> {
    let text = std::fs::read_to_string(format!("/sys/class/net/{interface}/address")).ok()?;
    let mut mac = [0; 6];
    for (to, from) in mac.iter_mut().zip(text.trim().split(':')) {
        *to = u8::from_str_radix(from, 16).ok()?;
    }
    (mac != [0; 6]).then_some(mac)
}

impl Link for PacketLink {
    fn send(&mut self, frame: &[u8]) -> io::Result<usize> {
        Ok(nix::unistd::write(&self.socket, frame)?)
    }

    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>> {
        if let Some(received) = self.take(buf)? {
            return Ok(Some(received));
        }
        if timeout.is_zero() {
            return Ok(None);
        }
        if let Some(received) = self.spin(buf, timeout)? {
            return Ok(Some(received));
        }
        if readable(self.socket.as_fd(), timeout.saturating_sub(self.spin))? {
            self.take(buf)
        } else {
            Ok(None)
        }
    }

    fn interface(&self) -> Option<&str> {
        Some(&self.interface)
    }
}

impl PacketLink {
    fn spin(&self, buf: &mut [u8], timeout: Duration) -> io::Result<Option<(usize, Duration)>> {
        if self.spin.is_zero() {
            return Ok(None);
        }
        let end = monotonic()? + self.spin.min(timeout);
        while monotonic()? < end {
            if let Some(received) = self.take(buf)? {
                return Ok(Some(received));
            }
        }
        Ok(None)
    }

    fn take(&self, buf: &mut [u8]) -> io::Result<Option<(usize, Duration)>> {
        match receive_frame(self.socket.as_fd(), buf) {
            Ok(received) => Ok(Some(received)),
            // The interface went down: nothing is received, as with an unplugged cable.
            Err(error) if is_transient(&error) => Ok(None),
            Err(error) => Err(error),
        }
    }
}

fn is_transient(error: &io::Error) -> bool {
    matches!(
        error.raw_os_error(),
        Some(libc::EAGAIN | libc::ENETDOWN | libc::EINTR)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packet_missing_interface_is_reported() {
        let error = PacketLink::open("no-such-if").unwrap_err().to_string();
        assert!(
            error.starts_with("no-such-if: there is no such interface"),
            "{error}"
        );
    }
}

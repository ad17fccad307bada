//! Whether a network interface can carry frames, and in words what to do where it cannot. One place for the field buses
//! over Ethernet, CAN and IP, so that the same error number gets the same cause and remedy in drivers and in tools.
//!
//! The flags are asked by an ioctl rather than read from sysfs: that shows the interfaces of the network namespace in which it
//! was mounted, not of the one in which the program runs.
#![expect(unsafe_code, reason = "the ioctl SIOCGIFFLAGS has no safe form")]

use std::{
    ffi::c_char,
    fmt, io,
    net::IpAddr,
    os::fd::{AsRawFd as _, OwnedFd},
};

use nix::{
    errno::Errno,
    sys::socket::{AddressFamily, SockFlag, SockType, SockaddrStorage, socket},
};

/// What goes over an interface; the remedies differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Medium {
    /// EtherCAT: raw Ethernet frames.
    Ethernet,
    /// SocketCAN.
    Can,
    /// Datagrams.
    Ip,
    /// A serial port.
    Serial,
}

/// Why a bus carries no frames, as far as this host knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkFault {
    /// There is no interface of that name.
    Missing,
    /// The interface was removed and is there again; who opened it before has the one that was removed (`ENXIO`, `ENODEV`).
    Replaced,
    /// The interface is not up (`ENETDOWN`).
    Down,
    /// The interface is up, and nothing is at its other end.
    NoCarrier,
    /// The send queue is full (`ENOBUFS`).
    QueueFull,
    /// Another error number.
    Os(i32),
}

impl LinkFault {
    /// What an error number of a socket means; of one that says that there is nothing yet, nothing.
    pub const fn of_errno(errno: i32) -> Self {
        match errno {
            libc::ENETDOWN => Self::Down,
            libc::ENXIO | libc::ENODEV => Self::Missing,
            libc::ENOBUFS => Self::QueueFull,
            other => Self::Os(other),
        }
    }

    /// The cause, and the remedy on a line of its own.
    pub const fn on(self, interface: &str, medium: Medium) -> LinkFaultText<'_> {
        LinkFaultText {
            fault: self,
            interface,
            medium,
        }
    }
}

/// A [`LinkFault`] of an interface in words.
#[derive(Clone, Copy, Debug)]
pub struct LinkFaultText<'i> {
    fault: LinkFault,
    interface: &'i str,
    medium: Medium,
}

impl fmt::Display for LinkFaultText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            fault,
            interface,
            medium,
        } = *self;
        write!(f, "{interface}: ")?;
        match (fault, medium) {
            (LinkFault::Missing, _) => write!(
                f,
                "no such interface (ENODEV)\nhint: plug the adapter in again, or correct the name; `ip link` lists the \
                 interfaces"
            ),
            (LinkFault::Replaced, _) => write!(
                f,
                "the interface was removed and came back (ENXIO)\nhint: restart takt, which opens the new one; see to what \
                 unplugs the adapter"
            ),
            (LinkFault::Down, Medium::Can) => write!(
                f,
                "the interface is not up: Network is down (ENETDOWN)\nhint: `ip link set {interface} up type can bitrate \
                 BITRATE` with the bit rate of the nodes; a virtual one by `ip link set {interface} up`"
            ),
            (LinkFault::Down, _) => write!(
                f,
                "the interface is not up: Network is down (ENETDOWN)\nhint: `ip link set {interface} up`"
            ),
            (LinkFault::NoCarrier, Medium::Can) => write!(
                f,
                "no carrier: the controller is bus-off or stopped\nhint: see to cable, termination and bit rate, then `ip \
                 link set {interface} type can restart`"
            ),
            (LinkFault::NoCarrier, _) => write!(
                f,
                "no carrier: nothing answers at the other end of the cable\nhint: see whether the cable is in at both ends \
                 and the device there has power"
            ),
            (LinkFault::QueueFull, Medium::Can) => write!(
                f,
                "the send queue is full: No buffer space available (ENOBUFS)\nhint: if no node acknowledges, see to cable, \
                 termination and bit rate; if the bus works, `ip link set {interface} txqueuelen 1000`"
            ),
            (LinkFault::QueueFull, _) => write!(
                f,
                "the send queue is full: No buffer space available (ENOBUFS)\nhint: see what the adapter does not send \
                 (`ip -s link show {interface}`), then `ip link set {interface} txqueuelen 1000`"
            ),
            (LinkFault::Os(errno), Medium::Serial) => write!(
                f,
                "{}\nhint: see whether the cable is in and the device there has power",
                io::Error::from_raw_os_error(errno)
            ),
            (LinkFault::Os(errno @ (libc::ENETUNREACH | libc::EHOSTUNREACH)), Medium::Ip) => {
                write!(
                    f,
                    "{}\nhint: give an interface of this host an address of the robot's net (`ip addr`, `ip route`)",
                    io::Error::from_raw_os_error(errno)
                )
            }
            (LinkFault::Os(errno), _) => write!(
                f,
                "{}\nhint: see `ip -d link show {interface}`",
                io::Error::from_raw_os_error(errno)
            ),
        }
    }
}

/// A network interface whose state can be asked: a system call that neither waits nor allocates.
#[derive(Debug)]
pub struct Interface {
    socket: OwnedFd,
    name: [c_char; libc::IFNAMSIZ],
}

impl Interface {
    /// Prepares queries of the interface of that name; a missing one is reported by the first query. It stays that of the
    /// network namespace of the thread that calls this.
    ///
    /// # Errors
    /// If the name is longer than 15 bytes or holds a zero, or no socket is to be had.
    pub fn open(name: &str) -> io::Result<Self> {
        Ok(Self {
            name: packed(name)?,
            socket: question_socket()?,
        })
    }

    /// What keeps it from carrying frames.
    pub fn fault(&self) -> Option<LinkFault> {
        match self.flags() {
            Err(Errno::ENODEV | Errno::ENXIO) => Some(LinkFault::Missing),
            Err(error) => Some(LinkFault::Os(error as i32)),
            Ok(flags) if flags & libc::IFF_UP == 0 => Some(LinkFault::Down),
            Ok(flags) if flags & libc::IFF_RUNNING == 0 => Some(LinkFault::NoCarrier),
            Ok(_) => None,
        }
    }

    fn flags(&self) -> Result<i32, Errno> {
        let mut request = libc::ifreq {
            ifr_name: self.name,
            ifr_ifru: libc::__c_anonymous_ifr_ifru { ifru_flags: 0 },
        };
        // SAFETY: the request is live over the call, and the kernel writes no more than it.
        let status = unsafe {
            libc::ioctl(
                self.socket.as_raw_fd(),
                libc::SIOCGIFFLAGS,
                &raw mut request,
            )
        };
        Errno::result(status)?;
        // SAFETY: SIOCGIFFLAGS has written this member, and any bits are a short.
        Ok(i32::from(unsafe { request.ifr_ifru.ifru_flags }))
    }
}

/// The name of an interface as requests of the kernel have it.
pub(super) fn packed(interface: &str) -> io::Result<[c_char; libc::IFNAMSIZ]> {
    let bytes = interface.as_bytes();
    if bytes.len() >= libc::IFNAMSIZ || bytes.contains(&0) {
        return Err(Errno::ENODEV.into());
    }
    let mut name = [0; libc::IFNAMSIZ];
    for (to, &from) in name.iter_mut().zip(bytes) {
        *to = c_char::from_ne_bytes([from]);
    }
    Ok(name)
}

/// A socket for questions about interfaces; of any family.
pub(super) fn question_socket() -> io::Result<OwnedFd> {
    let flags = SockFlag::SOCK_CLOEXEC;
    Ok(socket(
        AddressFamily::Inet,
        SockType::Datagram,
        flags,
        None,
    )?)
}

/// The interface that has an address; `None` if none has, as of one that means all.
pub fn interface_of(address: IpAddr) -> io::Result<Option<String>> {
    let mut all = nix::ifaddrs::getifaddrs()?;
    let found = all.find(|one| one.address.as_ref().and_then(ip) == Some(address));
    Ok(found.map(|one| one.interface_name))
}

/// The address of this host from which datagrams to a peer leave, if there is a way to it.
pub fn local_address_to(peer: IpAddr) -> Option<IpAddr> {
    let any: IpAddr = match peer {
        IpAddr::V4(_) => std::net::Ipv4Addr::UNSPECIFIED.into(),
        IpAddr::V6(_) => std::net::Ipv6Addr::UNSPECIFIED.into(),
    };
    let socket = std::net::UdpSocket::bind((any, 0)).ok()?;
    // Nothing is sent by that; the port is of no matter.
    socket.connect((peer, 9)).ok()?;
    Some(socket.local_addr().ok()?.ip())
}

fn ip(address: &SockaddrStorage) -> Option<IpAddr> {
    let v4 = address.as_sockaddr_in().map(|it| it.ip().into());
    v4.or_else(|| Some(address.as_sockaddr_in6()?.ip().into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loopback_has_no_link_fault() {
        assert_eq!(Interface::open("lo").unwrap().fault(), None);
        let name = interface_of([127, 0, 0, 1].into()).unwrap();
        assert_eq!(name.as_deref(), Some("lo"));
        let local = local_address_to([127, 0, 0, 9].into());
        assert_eq!(local, Some([127, 0, 0, 1].into()));
        assert_eq!(interface_of([0, 0, 0, 0].into()).unwrap(), None);
    }

    #[test]
    fn unknown_interface_is_missing() {
        let nowhere = Interface::open("nowhere0").unwrap();
        assert_eq!(nowhere.fault(), Some(LinkFault::Missing));
        assert!(Interface::open("a-name-of-sixteen").is_err());
    }

    #[test]
    fn each_link_fault_names_cause_and_remedy() {
        let media = [Medium::Ethernet, Medium::Can, Medium::Ip, Medium::Serial];
        let errnos = [
            libc::ENETDOWN,
            libc::ENODEV,
            libc::ENXIO,
            libc::ENOBUFS,
            libc::EIO,
        ];
        for medium in media {
            let of_errno = errnos.map(LinkFault::of_errno);
            let others = [LinkFault::Replaced, LinkFault::NoCarrier];
            for fault in of_errno.into_iter().chain(others) {
                let text = fault.on("bus0", medium).to_string();
                let (cause, hint) = text.split_once("\nhint: ").unwrap();
                assert!(cause.starts_with("bus0: ") && !hint.is_empty(), "{text}");
            }
        }
        let text = LinkFault::of_errno(libc::ENETDOWN).on("can0", Medium::Can);
        let text = text.to_string();
        assert!(text.contains("Network is down"), "{text}");
        assert!(
            text.contains("`ip link set can0 up type can bitrate"),
            "{text}"
        );
        let text = LinkFault::of_errno(libc::ENOBUFS).on("can0", Medium::Can);
        let text = text.to_string();
        assert!(text.contains("No buffer space available"), "{text}");
        assert!(text.contains("txqueuelen"), "{text}");
    }
}

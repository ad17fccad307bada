//! Capture of all packets of this host's interfaces (`packet(7)`), to find out why a peer is silent; needs CAP_NET_RAW.
//! Each packet of the host costs a copy while it is open, so it is closed as soon as the cause is known.

use std::os::fd::{AsRawFd as _, OwnedFd};

use nix::sys::socket::{
    AddressFamily, LinkAddr, SockFlag, SockProtocol, SockType, recvfrom, socket,
};

/// Most packets received at once.
const PACKETS_MAX: usize = 4_096;

/// A socket that receives all packets, without their link headers.
#[derive(Debug)]
pub struct Sniffer(Option<OwnedFd>);

impl Sniffer {
    /// Opens it, if this user is permitted to.
    pub fn open() -> Self {
        let flags = SockFlag::SOCK_NONBLOCK | SockFlag::SOCK_CLOEXEC;
        let all = SockProtocol::EthAll;
        Self(socket(AddressFamily::Packet, SockType::Datagram, flags, all).ok())
    }

    /// Whether this user is permitted to capture packets.
    pub fn is_permitted(&self) -> bool {
        self.0.is_some()
    }

    /// Passes the packets since the last call, each with its type (IEEE 802 number), to `handle`.
    pub fn poll(&self, mut handle: impl FnMut(u16, &[u8])) {
        let Some(socket) = &self.0 else { return };
        let mut buffer = [0; 2048];
        for _ in 0..PACKETS_MAX {
            match recvfrom::<LinkAddr>(socket.as_raw_fd(), &mut buffer) {
                Ok((len, Some(from))) => {
                    let packet = buffer.get(..len).unwrap_or(&buffer);
                    handle(u16::from_be(from.protocol()), packet);
                }
                Ok((_, None)) => {}
                Err(_) => return,
            }
        }
    }
}

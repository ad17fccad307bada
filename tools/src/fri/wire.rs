//! Capture of all packets of this host's interfaces while no measurement arrives (`packet(7)`); needs CAP_NET_RAW. It
//! judges none of them.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::os::fd::{AsRawFd as _, OwnedFd};

use nix::sys::socket::{
    AddressFamily, LinkAddr, SockFlag, SockProtocol, SockType, recvfrom, socket,
};

use super::silence::Evidence;

/// Most packets received at once.
const PACKETS_MAX: usize = 4_096;

/// A socket that receives all packets.
pub(super) struct Wire(Option<OwnedFd>);

impl Wire {
    /// Opens it, if this user is permitted to.
    pub(super) fn open() -> Self {
        let flags = SockFlag::SOCK_NONBLOCK | SockFlag::SOCK_CLOEXEC;
        let all = SockProtocol::EthAll;
        Self(socket(AddressFamily::Packet, SockType::Datagram, flags, all).ok())
    }

    /// Receives the packets since the last call.
    pub(super) fn look(&self, evidence: &mut Evidence) {
        evidence.is_allowed = self.0.is_some();
        let Some(socket) = &self.0 else { return };
        let mut buffer = [0; 2048];
        for _ in 0..PACKETS_MAX {
            match recvfrom::<LinkAddr>(socket.as_raw_fd(), &mut buffer) {
                Ok((len, Some(from))) => {
                    let packet = buffer.get(..len).unwrap_or(&buffer);
                    evidence.handle_packet(u16::from_be(from.protocol()), packet);
                }
                Ok((_, None)) => {}
                Err(_) => return,
            }
        }
    }
}

/// Whether this host has a route there.
pub(super) fn has_route(to: Ipv4Addr) -> bool {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0));
    // Sends nothing: only looks up the route.
    socket.is_ok_and(|socket| socket.connect(SocketAddr::from((to, 9))).is_ok())
}

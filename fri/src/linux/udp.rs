//! A UDP socket as a [`Link`]. It does not allocate after opening. Times of arrival are those of the kernel.

use std::io::{self, ErrorKind};
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::AsFd;
use std::time::Duration;
use takt_link::Link;
use takt_link::linux::host::{Transport, bind_error};
use takt_link::linux::{readable, receive_from, stamp_arrivals};

/// Datagrams of other senders skipped per call.
const FOREIGN_MAX: usize = 16;
/// Most datagrams discarded at once: more than the buffer of a socket holds.
const DISCARD_MAX: u32 = 4_096;

/// A UDP socket with one peer.
#[derive(Debug)]
pub struct UdpLink {
    socket: UdpSocket,
    peer: Option<SocketAddr>,
    fixed: bool,
    foreign: u64,
}

impl UdpLink {
    /// The client's endpoint: listens on `local` and answers the sender of the last datagram, as every FRI client does.
    ///
    /// # Errors
    /// If the address cannot be bound; the text names the program that has the port, or this host's addresses.
    pub fn bind(local: SocketAddr) -> io::Result<Self> {
        let socket =
            UdpSocket::bind(local).map_err(|error| bind_error(Transport::Udp, local, &error))?;
        socket.set_nonblocking(true)?;
        stamp_arrivals(&socket)?;
        Ok(Self {
            socket,
            peer: None,
            fixed: false,
            foreign: 0,
        })
    }

    /// The controller's endpoint: sends from `local` to `peer` and ignores all other senders.
    ///
    /// The socket is not connected: while no client is running, the kernel would report errors on a later send.
    pub fn connect(local: SocketAddr, peer: SocketAddr) -> io::Result<Self> {
        Ok(Self {
            peer: Some(peer),
            fixed: true,
            ..Self::bind(local)?
        })
    }

    /// Local address of the socket.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        self.socket.local_addr()
    }

    /// Receiver of the next datagram.
    pub fn peer(&self) -> Option<SocketAddr> {
        self.peer
    }

    /// Sends to `peer` until another sender's datagram arrives: for callers that recognise foreign datagrams.
    pub fn answer_to(&mut self, peer: SocketAddr) {
        if !self.fixed {
            self.peer = Some(peer);
        }
    }

    /// Datagrams ignored because the fixed peer did not send them.
    pub fn foreign(&self) -> u64 {
        self.foreign
    }

    /// Discards the datagrams that are waiting, and returns their number: those that arrived before the client began are
    /// no concern of it.
    ///
    /// # Errors
    /// Of the operating system.
    pub fn discard_queued(&mut self) -> io::Result<u32> {
        for count in 0..DISCARD_MAX {
            match self.socket.recv(&mut [0]) {
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(count),
                Err(error) if is_transient(error.kind()) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(DISCARD_MAX)
    }

    fn take(&mut self, buf: &mut [u8]) -> io::Result<Option<(usize, Duration)>> {
        for _ in 0..FOREIGN_MAX {
            let (len, from, at) = match receive_from(self.socket.as_fd(), buf) {
                Ok((len, Some(from), at)) => (len, from, at),
                Ok((_, None, _)) => continue,
                Err(error) if is_transient(error.kind()) => return Ok(None),
                Err(error) => return Err(error),
            };
            if self.fixed && self.peer != Some(from) {
                self.foreign += 1;
                continue;
            }
            self.peer = Some(from);
            return Ok(Some((len, at)));
        }
        Ok(None)
    }
}

/// No datagram, a signal, or an ICMP error about an undelivered datagram: the socket is still usable.
fn is_transient(kind: ErrorKind) -> bool {
    matches!(
        kind,
        ErrorKind::WouldBlock | ErrorKind::Interrupted | ErrorKind::ConnectionRefused
    )
}

impl Link for UdpLink {
    fn send(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let Some(peer) = self.peer else { return Ok(0) };
        match self.socket.send_to(bytes, peer) {
            Err(error) if is_transient(error.kind()) => Ok(0),
            sent => sent,
        }
    }

    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>> {
        // Not the socket's own timeout: changing it costs a system call, and the kernel rounds it to scheduler ticks.
        if !timeout.is_zero() && !readable(self.socket.as_fd(), timeout)? {
            return Ok(None);
        }
        self.take(buf)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linux::monotonic;
    use std::net::Ipv4Addr;

    const ANY: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 0);
    const TIMEOUT: Duration = Duration::from_secs(5);

    #[test]
    fn udp_bound_socket_answers_last_sender() {
        let mut pc = UdpLink::bind(ANY).unwrap();
        let mut buf = [0; 8];
        assert_eq!(pc.send(&[1]).unwrap(), 0);
        for byte in 1..3 {
            let mut krc = UdpLink::connect(ANY, pc.local_addr().unwrap()).unwrap();
            let before = monotonic().unwrap();
            krc.send(&[byte]).unwrap();
            let (len, stamp) = pc.receive(&mut buf, TIMEOUT).unwrap().unwrap();
            // Two clocks are read one after the other.
            let error = Duration::from_millis(1);
            assert!(stamp + error >= before && stamp <= monotonic().unwrap());
            assert_eq!(buf[..len], [byte]);
            assert_eq!(pc.send(&[byte + 10]).unwrap(), 1);
            assert!(krc.receive(&mut buf, TIMEOUT).unwrap().is_some());
            assert_eq!(buf[0], byte + 10);
        }
    }

    #[test]
    fn udp_answer_to_overrides_last_sender() {
        let mut pc = UdpLink::bind(ANY).unwrap();
        let mut buf = [0; 8];
        let mut ends = [(); 2].map(|()| UdpLink::connect(ANY, pc.local_addr().unwrap()).unwrap());
        for end in &mut ends {
            end.send(&[1]).unwrap();
            pc.receive(&mut buf, TIMEOUT).unwrap().unwrap();
        }
        pc.answer_to(ends[0].local_addr().unwrap());
        pc.send(&[7]).unwrap();
        assert!(ends[0].receive(&mut buf, TIMEOUT).unwrap().is_some());
        let other = ends[1].local_addr().unwrap();
        ends[0].answer_to(other);
        assert_ne!(ends[0].peer(), Some(other));
    }

    #[test]
    fn udp_connected_socket_ignores_other_senders() {
        let mut pc = UdpLink::bind(ANY).unwrap();
        let mut krc = UdpLink::connect(ANY, pc.local_addr().unwrap()).unwrap();
        let stranger = UdpSocket::bind(ANY).unwrap();
        stranger.send_to(&[9], krc.local_addr().unwrap()).unwrap();
        krc.send(&[0]).unwrap();
        let mut buf = [0; 8];
        pc.receive(&mut buf, TIMEOUT).unwrap().unwrap();
        pc.send(&[5]).unwrap();
        // The first wait may end with the foreign datagram, which is not returned.
        let received = (0..2).find_map(|_| krc.receive(&mut buf, TIMEOUT).unwrap());
        assert_eq!(received.map(|(len, _)| buf[..len].to_vec()), Some(vec![5]));
        assert_eq!(krc.foreign(), 1);
    }

    #[test]
    fn udp_queue_is_discarded_before_start() {
        let mut pc = UdpLink::bind(ANY).unwrap();
        let mut krc = UdpLink::connect(ANY, pc.local_addr().unwrap()).unwrap();
        for byte in 0..10 {
            krc.send(&[byte; 900]).unwrap();
        }
        assert_eq!(pc.discard_queued().unwrap(), 10);
        krc.send(&[77]).unwrap();
        let mut buf = [0; 8];
        let received = pc.receive(&mut buf, TIMEOUT).unwrap();
        assert_eq!(received.map(|(len, _)| buf[..len].to_vec()), Some(vec![77]));
        assert_eq!(pc.discard_queued().unwrap(), 0);
    }

    #[test]
    fn udp_absent_peer_is_no_error() {
        let unbound = UdpSocket::bind(ANY).unwrap().local_addr().unwrap();
        let mut krc = UdpLink::connect(ANY, unbound).unwrap();
        let mut buf = [0; 8];
        for _ in 0..3 {
            krc.send(&[1]).unwrap();
            assert_eq!(
                krc.receive(&mut buf, Duration::from_millis(1)).unwrap(),
                None
            );
        }
    }
}

//! Why no measurement arrives: compares the packets on the wire with the address this host listens at, and names the
//! cause with a remedy, for tools and drivers alike. It answers nothing and sends nothing.

use std::collections::BTreeMap;
use std::fmt;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV4};
use std::time::Duration;

use takt_link::linux::Sniffer;
use takt_link::linux::host::{Address, Transport, addresses, has_route, is_port_taken, list};

use crate::capture::Datagram;
use crate::client::DatagramError;
use crate::generation::Kind;

/// Types of packets (IEEE 802 numbers).
const IPV4: u16 = 0x0800;
const ARP: u16 = 0x0806;
/// Pairs of addresses kept at most.
const KINDS_MAX: usize = 64;
/// Unanswered ARP requests after which an address counts as unassigned.
const UNANSWERED: u32 = 2;

/// Captures packets while no measurement arrives at an address; then [`cause`](Self::cause) says why. A controller that gets
/// no answer to its ARP requests repeats them every second: capture for three. Drop it as soon as a measurement arrives:
/// each packet of the host costs a copy.
#[derive(Debug)]
pub struct Watch {
    listen: SocketAddr,
    sniffer: Sniffer,
    evidence: Evidence,
}

impl Watch {
    /// Starts to capture, if this user is permitted to (CAP_NET_RAW).
    pub fn new(listen: SocketAddr) -> Self {
        let sniffer = Sniffer::open();
        let evidence = Evidence {
            is_allowed: sniffer.is_permitted(),
            ..Evidence::default()
        };
        Self {
            listen,
            sniffer,
            evidence,
        }
    }

    /// Takes the packets captured since the last call; call it at least ten times a second.
    pub fn poll(&mut self) {
        let Self {
            sniffer, evidence, ..
        } = self;
        sniffer.poll(|kind, packet| evidence.handle_packet(kind, packet));
    }

    /// Why nothing arrives, by what was captured so far. `refusal` is the error of the last datagram that arrived there and
    /// was rejected, if any did.
    pub fn cause(&self, refusal: Option<DatagramError>) -> Cause {
        let is_taken = |port| is_port_taken(Transport::Udp, port);
        self.evidence
            .judge(self.listen, refusal, addresses(), has_route, is_taken)
    }
}

/// Packets observed on the wire.
#[derive(Debug, Default)]
struct Evidence {
    /// Whether this user may capture packets.
    is_allowed: bool,
    /// ARP requests: sender and requested address, and how often.
    requests: BTreeMap<(Ipv4Addr, Ipv4Addr), u32>,
    /// Measurements: sender and destination, and how many.
    measurements: BTreeMap<(SocketAddrV4, SocketAddrV4), u32>,
}

/// Why nothing arrives. Its text names cause and remedy, the remedy as `hint:` on its own line.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Cause {
    /// Datagrams arrive, but no measurements, or of another version than expected.
    Refused(DatagramError),
    /// Sent to another port of this host.
    Port {
        /// The controller.
        from: Ipv4Addr,
        /// Where it sends to.
        to: SocketAddrV4,
    },
    /// Sent to another address of this host.
    Interface {
        /// The controller.
        from: Ipv4Addr,
        /// Where it sends to.
        to: SocketAddrV4,
    },
    /// Arrives at this host, which has no route back to its sender.
    NoRoute {
        /// The controller.
        from: Ipv4Addr,
        /// This host's addresses.
        ours: Vec<Address>,
    },
    /// Arrives at this host, which drops it.
    Dropped {
        /// The controller.
        from: Ipv4Addr,
        /// The port it sends to.
        port: u16,
    },
    /// A host requests an address that is not ours, without an answer.
    Target {
        /// The host that requests it, likely the controller.
        asker: Ipv4Addr,
        /// The requested address.
        wanted: Ipv4Addr,
        /// This host's addresses.
        ours: Vec<Address>,
    },
    /// A host outside of our netmask requests our address.
    Mask {
        /// The host that requests it, likely the controller.
        asker: Ipv4Addr,
        /// The requested address.
        ours: Address,
    },
    /// No trace of a controller.
    Nothing {
        /// Where this host listens.
        listen: SocketAddr,
        /// This host's addresses.
        ours: Vec<Address>,
    },
    /// This user may not capture packets.
    Blind {
        /// Where this host listens.
        listen: SocketAddr,
        /// This host's addresses.
        ours: Vec<Address>,
    },
}

impl Evidence {
    /// Handles a packet of a type, without its link header.
    fn handle_packet(&mut self, kind: u16, packet: &[u8]) {
        match kind {
            IPV4 => self.handle_ip(packet),
            ARP => self.handle_arp(packet),
            _ => {}
        }
    }

    fn handle_ip(&mut self, packet: &[u8]) {
        let Some(datagram) = Datagram::in_packet(Duration::ZERO, packet) else {
            return;
        };
        if Kind::of(&datagram.bytes).is_from_controller() {
            count(&mut self.measurements, (datagram.from, datagram.to));
        }
    }

    fn handle_arp(&mut self, packet: &[u8]) {
        if let Some(request) = arp_request(packet) {
            count(&mut self.requests, request);
        }
    }

    /// The cause for a client at `listen` on a host with the addresses `ours`. `has_route` and `is_taken` describe the
    /// host: where it has routes to, and which other ports are in use, which have controllers of their own.
    fn judge(
        &self,
        listen: SocketAddr,
        refusal: Option<DatagramError>,
        ours: Vec<Address>,
        has_route: impl Fn(Ipv4Addr) -> bool,
        is_taken: impl Fn(u16) -> bool,
    ) -> Cause {
        if let Some(refusal) = refusal {
            return Cause::Refused(refusal);
        }
        if let Some(cause) = self.judge_measurements(listen, &ours, has_route, is_taken) {
            return cause;
        }
        if let Some(cause) = self.judge_requests(&ours) {
            return cause;
        }
        if self.is_allowed {
            Cause::Nothing { listen, ours }
        } else {
            Cause::Blind { listen, ours }
        }
    }

    fn judge_measurements(
        &self,
        listen: SocketAddr,
        ours: &[Address],
        has_route: impl Fn(Ipv4Addr) -> bool,
        is_taken: impl Fn(u16) -> bool,
    ) -> Option<Cause> {
        let is_ours = |ip: Ipv4Addr| ours.iter().any(|it| it.ip == ip);
        let is_free = |port: u16| port == listen.port() || !is_taken(port);
        let mut all = self.measurements.keys();
        let (from, to) = all.find(|(_, to)| is_ours(*to.ip()) && is_free(to.port()))?;
        let (from, to) = (*from.ip(), *to);
        if !has_route(from) {
            let ours = ours.to_vec();
            return Some(Cause::NoRoute { from, ours });
        }
        if to.port() != listen.port() {
            return Some(Cause::Port { from, to });
        }
        if !listen.ip().is_unspecified() && listen.ip() != IpAddr::V4(*to.ip()) {
            return Some(Cause::Interface { from, to });
        }
        let port = to.port();
        Some(Cause::Dropped { from, port })
    }

    fn judge_requests(&self, ours: &[Address]) -> Option<Cause> {
        let of_others = |asker: &Ipv4Addr| ours.iter().all(|it| it.ip != *asker);
        let mut asked = self
            .requests
            .iter()
            .filter(|(_, times)| **times >= UNANSWERED);
        let (&(asker, wanted), _) = asked.find(|((asker, _), _)| of_others(asker))?;
        let Some(address) = ours.iter().find(|it| it.ip == wanted) else {
            let ours = ours.iter().filter(|it| !it.ip.is_loopback());
            let ours = ours.cloned().collect();
            return Some(Cause::Target {
                asker,
                wanted,
                ours,
            });
        };
        let is_near = ours.iter().any(|it| it.is_near(asker));
        let ours = address.clone();
        (!is_near).then_some(Cause::Mask { asker, ours })
    }
}

fn count<K: Ord>(all: &mut BTreeMap<K, u32>, key: K) {
    if all.len() < KINDS_MAX || all.contains_key(&key) {
        *all.entry(key).or_insert(0) += 1;
    }
}

/// Sender and requested address of an ARP request (RFC 826); `None` for other packets and announcements.
fn arp_request(packet: &[u8]) -> Option<(Ipv4Addr, Ipv4Addr)> {
    let address_at = |at: usize| {
        let four: [u8; 4] = *packet.get(at..)?.first_chunk()?;
        Some(Ipv4Addr::from(four))
    };
    let is_request = packet.get(2..8)? == [0x08, 0x00, 6, 4, 0, 1];
    let (asker, wanted) = (address_at(14)?, address_at(24)?);
    (is_request && asker != wanted && !asker.is_unspecified()).then_some((asker, wanted))
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(refusal) => refusal.fmt(f),
            Self::Port { from, to } => write!(
                f,
                "{from} sends to port {} of this host\nhint: listen at {to}, or correct the port that the controller sends \
                 to",
                to.port()
            ),
            Self::Interface { from, to } => write!(
                f,
                "{from} sends to {}, another address of this host\nhint: listen at {to}, or at 0.0.0.0:{}",
                to.ip(),
                to.port()
            ),
            Self::NoRoute { from, ours } => write!(
                f,
                "measurements of {from} reach this host, which has no route back (it has {})\nhint: correct its netmask, or \
                 add a route (`ip route`)",
                list(ours)
            ),
            Self::Dropped { from, port } => write!(
                f,
                "measurements of {from} reach this host and are dropped by it\nhint: let its firewall pass UDP port {port} \
                 (`nft list ruleset`, `iptables -S`, `ip rule`)"
            ),
            Self::Target {
                asker,
                wanted,
                ours,
            } => write!(
                f,
                "{asker} requests {wanted}, which is no address of this host ({})\nhint: correct the address that \
                 the controller sends to, or this host's",
                list(ours)
            ),
            Self::Mask { asker, ours } => write!(
                f,
                "{asker} requests {} and gets no answer: this host's netmask of {} bits excludes it\nhint: correct \
                 the netmask of {}",
                ours.ip, ours.prefix, ours.interface
            ),
            Self::Nothing { listen, ours } => write!(
                f,
                "no measurement arrives at {listen}, and the wire shows no trace of a controller\nhint: is the cable in, has the \
                 robot program opened FRI, does it send to this host ({}), is the controller's netmask right?",
                list(ours)
            ),
            Self::Blind { listen, ours } => write!(
                f,
                "no measurement arrives at {listen}\nhint: has the robot program opened FRI, does it send to this host ({}) and \
                 port, do both netmasks fit, does a firewall drop it? As root, takt captures packets and names the cause",
                list(ours)
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lwr::emulator::{Krc, KrcConfig};
    use crate::lwr::wire::Msr;

    const ROBOT: Ipv4Addr = Ipv4Addr::new(192, 168, 0, 20);
    const HOST: Ipv4Addr = Ipv4Addr::new(192, 168, 0, 5);

    fn ours(prefix: u32) -> Vec<Address> {
        vec![Address {
            interface: "enp3s0".into(),
            ip: HOST,
            prefix,
        }]
    }

    fn measurement_to(to: &str) -> Vec<u8> {
        let mut krc = Krc::new(KrcConfig::default(), Duration::ZERO);
        let mut bytes = [0; Msr::LEN];
        let len = krc.poll_transmit(krc.poll_timeout(), &mut bytes).unwrap();
        let datagram = Datagram {
            at: Duration::ZERO,
            from: SocketAddrV4::new(ROBOT, 49_152),
            to: to.parse().unwrap(),
            bytes: bytes[..len].to_vec(),
        };
        datagram.to_packet()
    }

    fn arp(asker: Ipv4Addr, wanted: Ipv4Addr, operation: u8) -> Vec<u8> {
        let mut packet = vec![0, 1, 8, 0, 6, 4, 0, operation];
        packet.extend([2, 0, 0, 0, 0, 1]);
        packet.extend(asker.octets());
        packet.extend([0; 6]);
        packet.extend(wanted.octets());
        packet
    }

    /// The cause for packets of a type, for a client at `listen` with a netmask of `prefix` bits.
    fn cause(listen: &str, prefix: u32, packets: &[(u16, Vec<u8>)]) -> String {
        let mut evidence = Evidence {
            is_allowed: true,
            ..Evidence::default()
        };
        for (kind, packet) in packets {
            evidence.handle_packet(*kind, packet);
        }
        let near = |ip| ours(prefix).iter().any(|it| it.is_near(ip));
        let cause = evidence.judge(listen.parse().unwrap(), None, ours(prefix), near, |port| {
            port == 30_209
        });
        cause.to_string()
    }

    #[test]
    fn silence_measurements_on_wire_name_cause() {
        let sent = |to: &str| [(IPV4, measurement_to(to))];
        let all = "0.0.0.0:49938";
        let port = cause(all, 24, &sent("192.168.0.5:30200"));
        assert!(
            port.starts_with("192.168.0.20 sends to port 30200 of this host\nhint: listen at 192.168.0.5:30200, or"),
            "{port}"
        );
        let interface = cause("127.0.0.1:49938", 24, &sent("192.168.0.5:49938"));
        assert_eq!(
            interface,
            "192.168.0.20 sends to 192.168.0.5, another address of this host\nhint: listen at 192.168.0.5:49938, or at 0.0.0.0:49938"
        );
        let dropped = cause(all, 24, &sent("192.168.0.5:49938"));
        assert!(
            dropped.contains("dropped by it\nhint: let its firewall pass UDP port 49938"),
            "{dropped}"
        );
        let route = cause(all, 30, &sent("192.168.0.5:49938"));
        assert!(
            route.contains(
                "no route back (it has 192.168.0.5/30 on enp3s0)\nhint: correct its netmask"
            ),
            "{route}"
        );
        // Measurements for another host, on a mirrored port of a switch; those of another arm of this host.
        for others in ["192.168.0.9:49938", "192.168.0.5:30209"] {
            let others = cause(all, 24, &sent(others));
            assert!(others.starts_with("no measurement arrives at"), "{others}");
        }
    }

    #[test]
    fn silence_unanswered_arp_names_address_or_mask() {
        let asks = |wanted, times| vec![(ARP, arp(ROBOT, wanted, 1)); times];
        let all = "0.0.0.0:49938";
        let elsewhere = Ipv4Addr::new(192, 168, 0, 99);
        let target = cause(all, 24, &asks(elsewhere, 3));
        assert_eq!(
            target,
            "192.168.0.20 requests 192.168.0.99, which is no address of this host (192.168.0.5/24 on \
             enp3s0)\nhint: correct the address that the controller sends to, or this host's"
        );
        let mask = cause(all, 30, &asks(HOST, 2));
        assert!(
            mask.contains("netmask of 30 bits excludes it\nhint: correct the netmask of enp3s0"),
            "{mask}"
        );
        for harmless in [
            asks(elsewhere, 1),
            asks(HOST, 5),
            vec![(ARP, arp(ROBOT, elsewhere, 2)); 3],
            vec![(ARP, arp(elsewhere, elsewhere, 1)); 3],
            vec![(ARP, arp(HOST, elsewhere, 1)); 3],
            vec![(ARP, vec![0; 9]); 3],
            vec![(IPV4, b"no packet".to_vec()), (0x86dd, vec![0; 40])],
        ] {
            let text = cause(all, 24, &harmless);
            assert!(text.contains("no trace of a controller"), "{text}");
        }
    }

    #[test]
    fn silence_without_capture_permission_suggests_root() {
        let evidence = Evidence::default();
        let listen = "0.0.0.0:49938".parse().unwrap();
        let cause = evidence.judge(listen, None, ours(24), |_| true, |_| false);
        assert!(cause.to_string().contains("As root"), "{cause}");
    }

    #[test]
    fn memory_is_bounded() {
        let mut evidence = Evidence::default();
        for number in 0..1_000_u32 {
            evidence.handle_packet(ARP, &arp(ROBOT, Ipv4Addr::from(number), 1));
        }
        assert_eq!(evidence.requests.len(), KINDS_MAX);
    }
}

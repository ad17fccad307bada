//! Why no measurement comes: what the wire shows against what this host listens to, as one sentence with what to do. It
//! reads no socket; `wire` does.

use std::collections::BTreeMap;
use std::fmt;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV4};
use std::time::Duration;

use takt_fri::capture::Datagram;
use takt_fri::client::DatagramError;
use takt_fri::generation::Kind;

use super::port::{Address, list};

/// Types of packets (IEEE 802 numbers).
const IPV4: u16 = 0x0800;
const ARP: u16 = 0x0806;
/// Different askers and datagrams remembered.
const KINDS_MAX: usize = 64;
/// Questions for an address in vain, after which nobody has it.
const IN_VAIN: u32 = 2;

/// What was seen on the wire.
#[derive(Debug, Default)]
pub(super) struct Evidence {
    /// Whether this user may look at all.
    pub(super) is_allowed: bool,
    /// Who asks for which address (ARP), and how often.
    asks: BTreeMap<(Ipv4Addr, Ipv4Addr), u32>,
    /// Measurements: from and to, and how many.
    measurements: BTreeMap<(SocketAddrV4, SocketAddrV4), u32>,
}

/// Why nothing comes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Cause {
    /// Something comes, but no measurement, or of another version than asked for.
    Refused(DatagramError),
    /// Sent to another port of this host.
    Port { from: Ipv4Addr, to: SocketAddrV4 },
    /// Sent to another address of this host.
    Interface { from: Ipv4Addr, to: SocketAddrV4 },
    /// Comes to this host, which has no way back to its sender.
    NoRoute { from: Ipv4Addr, ours: Vec<Address> },
    /// Comes to this host, which drops it.
    Dropped { from: Ipv4Addr, port: u16 },
    /// Somebody asks in vain for an address that is not ours.
    Target {
        asker: Ipv4Addr,
        wanted: Ipv4Addr,
        ours: Vec<Address>,
    },
    /// Somebody asks for us and is outside of our netmask.
    Mask { asker: Ipv4Addr, ours: Address },
    /// No trace of a controller.
    Nothing {
        listen: SocketAddr,
        ours: Vec<Address>,
    },
    /// Nobody may look at the wire.
    Blind {
        listen: SocketAddr,
        ours: Vec<Address>,
    },
}

impl Evidence {
    /// Takes a packet without its link header, of that type.
    pub(super) fn handle_packet(&mut self, kind: u16, packet: &[u8]) {
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
        if let Some(question) = question(packet) {
            count(&mut self.asks, question);
        }
    }

    /// What it means for who listens at `listen` on a host with the addresses `ours`, knowing where it has routes to and
    /// which other ports are listened at: those have their own controllers.
    pub(super) fn judge(
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
        if let Some(cause) = self.judge_questions(&ours) {
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

    fn judge_questions(&self, ours: &[Address]) -> Option<Cause> {
        let of_others = |asker: &Ipv4Addr| ours.iter().all(|it| it.ip != *asker);
        let mut asked = self.asks.iter().filter(|(_, times)| **times >= IN_VAIN);
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

/// Who asks for whom in an ARP request (RFC 826); `None` if it is none, or only announces itself.
fn question(packet: &[u8]) -> Option<(Ipv4Addr, Ipv4Addr)> {
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
                "{from} sends to port {} of this host: listen there (--listen {to}), or correct the port that the \
                 controller sends to",
                to.port()
            ),
            Self::Interface { from, to } => write!(
                f,
                "{from} sends to {}, another address of this host: --listen {to}",
                to.ip()
            ),
            Self::NoRoute { from, ours } => write!(
                f,
                "measurements of {from} reach this host, which has no route back (it has {}): correct its netmask, or \
                 add a route (`ip route`)",
                list(ours)
            ),
            Self::Dropped { from, port } => write!(
                f,
                "measurements of {from} reach this host and are dropped by it: let its firewall pass UDP port {port} \
                 (`nft list ruleset`, `iptables -S`, `ip rule`)"
            ),
            Self::Target {
                asker,
                wanted,
                ours,
            } => write!(
                f,
                "{asker} looks for {wanted} in vain, which is no address of this host ({}): correct the address that \
                 the controller sends to, or this host's",
                list(ours)
            ),
            Self::Mask { asker, ours } => write!(
                f,
                "{asker} looks for {} and gets no answer, since this host's netmask of {} bits leaves it out: correct \
                 the netmask of {}",
                ours.ip, ours.prefix, ours.interface
            ),
            Self::Nothing { listen, ours } => write!(
                f,
                "nothing comes to {listen}, and the wire shows no trace of a controller: is the cable in, has the \
                 robot program opened FRI, does it send to this host ({}), is the controller's netmask right?",
                list(ours)
            ),
            Self::Blind { listen, ours } => write!(
                f,
                "nothing comes to {listen}: has the robot program opened FRI, does it send to this host ({}) and \
                 port, do both netmasks fit, does a firewall drop it? As root, takt looks at the wire and tells which",
                list(ours)
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_fri::lwr::emulator::{Krc, KrcConfig};
    use takt_fri::lwr::wire::Msr;

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

    /// The sentence for packets of a type, seen by who listens there with a netmask of `prefix` bits.
    fn told(listen: &str, prefix: u32, packets: &[(u16, Vec<u8>)]) -> String {
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
    fn measurements_on_the_wire_tell_where_they_end() {
        let sent = |to: &str| [(IPV4, measurement_to(to))];
        let all = "0.0.0.0:49938";
        let port = told(all, 24, &sent("192.168.0.5:30200"));
        assert!(
            port.starts_with("192.168.0.20 sends to port 30200 of this host: listen there (--listen 192.168.0.5:30200)"),
            "{port}"
        );
        let interface = told("127.0.0.1:49938", 24, &sent("192.168.0.5:49938"));
        assert_eq!(
            interface,
            "192.168.0.20 sends to 192.168.0.5, another address of this host: --listen 192.168.0.5:49938"
        );
        let dropped = told(all, 24, &sent("192.168.0.5:49938"));
        assert!(
            dropped.contains("dropped by it: let its firewall pass UDP port 49938"),
            "{dropped}"
        );
        let route = told(all, 30, &sent("192.168.0.5:49938"));
        assert!(
            route.contains("no route back (it has 192.168.0.5/30 on enp3s0): correct its netmask"),
            "{route}"
        );
        // Somebody else's measurements, on a mirrored port of a switch; those of another arm of this host.
        for others in ["192.168.0.9:49938", "192.168.0.5:30209"] {
            let others = told(all, 24, &sent(others));
            assert!(others.starts_with("nothing comes to"), "{others}");
        }
    }

    #[test]
    fn questions_in_vain_tell_wrong_addresses_and_masks() {
        let asks = |wanted, times| vec![(ARP, arp(ROBOT, wanted, 1)); times];
        let all = "0.0.0.0:49938";
        let elsewhere = Ipv4Addr::new(192, 168, 0, 99);
        let target = told(all, 24, &asks(elsewhere, 3));
        assert_eq!(
            target,
            "192.168.0.20 looks for 192.168.0.99 in vain, which is no address of this host (192.168.0.5/24 on \
             enp3s0): correct the address that the controller sends to, or this host's"
        );
        let mask = told(all, 30, &asks(HOST, 2));
        assert!(
            mask.contains("netmask of 30 bits leaves it out: correct the netmask of enp3s0"),
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
            let told = told(all, 24, &harmless);
            assert!(told.contains("no trace of a controller"), "{told}");
        }
    }

    #[test]
    fn who_may_not_look_is_told_so() {
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
        assert_eq!(evidence.asks.len(), KINDS_MAX);
    }
}

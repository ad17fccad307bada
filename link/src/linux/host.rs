//! What this host is on its networks: its addresses, its routes, and the programs that hold its ports. It changes
//! nothing.

use std::fmt;
use std::io::{self, ErrorKind};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::path::Path;

/// An IPv4 address of this host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// Its network interface.
    pub interface: String,
    /// The address.
    pub ip: Ipv4Addr,
    /// Bits of the netmask, 0 to 32.
    pub prefix: u32,
}

impl Address {
    /// Whether it is reached without a router.
    pub fn is_near(&self, other: Ipv4Addr) -> bool {
        let host_bits = 32_u32.saturating_sub(self.prefix);
        let network = |ip: Ipv4Addr| ip.to_bits().checked_shr(host_bits).unwrap_or(0);
        network(self.ip) == network(other)
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{} on {}", self.ip, self.prefix, self.interface)
    }
}

/// Addresses as one text.
pub fn list(addresses: &[Address]) -> String {
    let all: Vec<_> = addresses.iter().map(Address::to_string).collect();
    if all.is_empty() {
        "none".to_owned()
    } else {
        all.join(", ")
    }
}

/// This host's IPv4 addresses.
pub fn addresses() -> Vec<Address> {
    let interfaces = nix::ifaddrs::getifaddrs().into_iter().flatten();
    let address = |it: nix::ifaddrs::InterfaceAddress| {
        let mask = it.netmask?.as_sockaddr_in()?.ip();
        Some(Address {
            ip: it.address?.as_sockaddr_in()?.ip(),
            prefix: mask.to_bits().leading_ones(),
            interface: it.interface_name,
        })
    };
    interfaces.filter_map(address).collect()
}

/// Whether this host has a route there.
pub fn has_route(to: Ipv4Addr) -> bool {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0));
    // Sends nothing: only looks up the route.
    socket.is_ok_and(|socket| socket.connect(SocketAddr::from((to, 9))).is_ok())
}

/// A transport whose ports programs hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    /// UDP.
    Udp,
    /// TCP: ports that programs listen at.
    Tcp,
}

impl Transport {
    const fn name(self) -> &'static str {
        match self {
            Self::Udp => "UDP",
            Self::Tcp => "TCP",
        }
    }

    /// Tables of the kernel (`proc_net(5)`).
    const fn tables(self) -> [&'static str; 2] {
        match self {
            Self::Udp => ["/proc/net/udp", "/proc/net/udp6"],
            Self::Tcp => ["/proc/net/tcp", "/proc/net/tcp6"],
        }
    }

    /// Code of the sockets that hold a port: unconnected (UDP), or listening (TCP). Connected UDP sockets hold one too.
    fn holds(self, state: &str) -> bool {
        match self {
            Self::Udp => true,
            Self::Tcp => state == "0A",
        }
    }

    /// Argument of `ss` that lists them.
    const fn ss(self) -> &'static str {
        match self {
            Self::Udp => "-ulpn",
            Self::Tcp => "-tlpn",
        }
    }
}

/// The program that holds a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortOwner {
    /// Its process.
    pub pid: u32,
    /// Its name (`comm`, at most 15 bytes).
    pub name: String,
}

impl fmt::Display for PortOwner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "`{}` (process {})", self.name, self.pid)
    }
}

/// The program that holds a port of this host; `None` if there is none, or if this user cannot see it.
pub fn port_owner(transport: Transport, port: u16) -> Option<PortOwner> {
    let link = format!("socket:[{}]", inode(transport, port)?);
    let processes = std::fs::read_dir("/proc").ok()?.flatten();
    // Not `self`, which is a process under its number, too.
    let mut numbered = processes.filter_map(|process| {
        let pid: u32 = process.file_name().to_str()?.parse().ok()?;
        Some((pid, process.path()))
    });
    let (pid, process) = numbered.find(|(_, process)| has_open(process, &link))?;
    let name = std::fs::read_to_string(process.join("comm")).ok()?;
    let name = name.trim().to_owned();
    Some(PortOwner { pid, name })
}

/// Whether a program of this host holds a port.
pub fn is_port_taken(transport: Transport, port: u16) -> bool {
    inode(transport, port).is_some()
}

/// The error of binding a local address, with cause and remedy: who has the port, or which addresses there are.
pub fn bind_error(transport: Transport, address: SocketAddr, error: &io::Error) -> io::Error {
    let kind = error.kind();
    #[expect(clippy::wildcard_enum_match_arm, reason = "some 40 other kinds")]
    let text = match kind {
        ErrorKind::AddrInUse => in_use(transport, address.port()),
        ErrorKind::AddrNotAvailable => not_ours(address.ip(), &addresses()),
        ErrorKind::PermissionDenied => {
            format!("{address}: ports below 1024 are for root\nhint: choose a port from 1024 on")
        }
        _ => format!("{address}: {error}"),
    };
    io::Error::new(kind, text)
}

fn in_use(transport: Transport, port: u16) -> String {
    let owner = port_owner(transport, port);
    taken_by(transport, port, owner.as_ref())
}

fn taken_by(transport: Transport, port: u16, owner: Option<&PortOwner>) -> String {
    let name = transport.name();
    match owner {
        Some(owner) if owner.pid == std::process::id() => format!(
            "{name} port {port} is taken by this process\nhint: give each device a port of its own"
        ),
        Some(owner) => format!("{name} port {port} is taken by {owner}\nhint: end it first"),
        None => format!(
            "{name} port {port} is taken by another program\nhint: end it first; as root, \
             `ss {} 'sport = :{port}'` names it",
            transport.ss()
        ),
    }
}

fn not_ours(ip: IpAddr, ours: &[Address]) -> String {
    let ours = list(ours);
    format!(
        "{ip} is no address of this host, which has {ours}\nhint: listen at one of them, or give the interface that address"
    )
}

fn inode(transport: Transport, port: u16) -> Option<u64> {
    let tables = transport.tables();
    tables
        .iter()
        .filter_map(|path| std::fs::read_to_string(path).ok())
        .find_map(|table| inode_of(transport, &table, port))
}

fn has_open(process: &Path, link: &str) -> bool {
    let files = std::fs::read_dir(process.join("fd"));
    let files = files.into_iter().flatten().flatten();
    files
        .filter_map(|file| std::fs::read_link(file.path()).ok())
        .any(|target| target.as_os_str() == link)
}

/// The inode of the socket that holds a port, in a table of the kernel (`proc_net(5)`).
fn inode_of(transport: Transport, table: &str, port: u16) -> Option<u64> {
    table.lines().skip(1).find_map(|line| {
        let words: Vec<_> = line.split_whitespace().collect();
        let (_, local) = words.get(1)?.rsplit_once(':')?;
        let is_it = u16::from_str_radix(local, 16) == Ok(port);
        let is_held = is_it && transport.holds(words.get(3)?);
        is_held.then(|| words.get(9)?.parse().ok()).flatten()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    fn address(ip: [u8; 4], prefix: u32) -> Address {
        Address {
            interface: "enp3s0".into(),
            ip: ip.into(),
            prefix,
        }
    }

    #[test]
    fn port_holder_is_found_in_kernel_table() {
        let table = "   sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode ref pointer drops
  117: 0100007F:C312 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 48213 2 0000000000000000 0
  118: 00000000:0044 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 7 2 0000000000000000 0
";
        let of = |port| inode_of(Transport::Udp, table, port);
        assert_eq!(of(49938), Some(48213));
        assert_eq!(of(68), Some(7));
        assert_eq!(of(69), None);
        assert_eq!(inode_of(Transport::Tcp, table, 68), None, "not listening");
    }

    #[test]
    fn taken_port_names_its_owner() {
        let local = (Ipv4Addr::LOCALHOST, 0);
        let udp = UdpSocket::bind(local).unwrap();
        let tcp = TcpListener::bind(local).unwrap();
        let ports = [
            (Transport::Udp, udp.local_addr().unwrap()),
            (Transport::Tcp, tcp.local_addr().unwrap()),
        ];
        for (transport, address) in ports {
            let owner = port_owner(transport, address.port()).unwrap();
            assert_eq!(owner.pid, std::process::id());
            assert!(!owner.name.is_empty());
            let error = io::Error::from(ErrorKind::AddrInUse);
            let text = bind_error(transport, address, &error).to_string();
            assert!(text.contains("is taken by this process\nhint: "), "{text}");
        }
    }

    #[test]
    fn bind_errors_name_cause_and_remedy() {
        let owner = PortOwner {
            pid: 812,
            name: "lwr_driver".into(),
        };
        assert_eq!(
            taken_by(Transport::Udp, 49938, Some(&owner)),
            "UDP port 49938 is taken by `lwr_driver` (process 812)\nhint: end it first"
        );
        let unknown = taken_by(Transport::Tcp, 8080, None);
        assert!(unknown.contains("ss -tlpn 'sport = :8080'"), "{unknown}");
        assert_eq!(
            not_ours(
                IpAddr::from([192, 168, 0, 7]),
                &[address([192, 168, 0, 5], 24)]
            ),
            "192.168.0.7 is no address of this host, which has 192.168.0.5/24 on enp3s0\nhint: listen at one of them, or \
             give the interface that address"
        );
    }

    #[test]
    fn netmask_decides_whether_an_address_is_near() {
        let near = |prefix, ip: [u8; 4]| address([192, 168, 0, 5], prefix).is_near(ip.into());
        assert!(near(24, [192, 168, 0, 20]));
        assert!(!near(24, [192, 168, 1, 20]));
        assert!(!near(30, [192, 168, 0, 20]));
        assert!(near(0, [10, 0, 0, 1]));
        assert!(!near(32, [192, 168, 0, 4]));
    }
}

//! The port for a controller's datagrams, and why it cannot be opened. It receives nothing itself.

use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::Path;

use takt_fri::linux::UdpLink;

/// An IPv4 address of this host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Address {
    pub(super) interface: String,
    pub(super) ip: Ipv4Addr,
    /// Bits of the netmask.
    pub(super) prefix: u32,
}

impl Address {
    /// Whether it is reached without a router.
    pub(super) fn is_near(&self, other: Ipv4Addr) -> bool {
        let host_bits = 32_u32.saturating_sub(self.prefix);
        let network = |ip: Ipv4Addr| ip.to_bits().checked_shr(host_bits).unwrap_or(0);
        network(self.ip) == network(other)
    }
}

/// Opens it. The error names cause and remedy.
pub(super) fn open(listen: SocketAddr) -> anyhow::Result<UdpLink> {
    UdpLink::bind(listen).map_err(|error| {
        #[expect(clippy::wildcard_enum_match_arm, reason = "some 40 other kinds")]
        let why = match error.kind() {
            ErrorKind::AddrInUse => in_use(listen, owner(listen.port())),
            ErrorKind::AddrNotAvailable => not_ours(listen.ip(), &addresses()),
            ErrorKind::PermissionDenied => {
                "ports below 1024 are for root\nhint: the port of the controller is 49938 (LWR) or 30200 (Sunrise)".to_owned()
            }
            _ => error.to_string(),
        };
        anyhow::anyhow!("cannot listen at {listen}: {why}")
    })
}

fn in_use(listen: SocketAddr, owner: Option<String>) -> String {
    let port = listen.port();
    let owner = owner.unwrap_or_else(|| {
        format!("another program (as root, `ss -ulpn 'sport = :{port}'` names it)")
    });
    format!("UDP port {port} is taken by {owner}, a second client on this host; end it first")
}

fn not_ours(ip: IpAddr, ours: &[Address]) -> String {
    let ours = list(ours);
    format!(
        "{ip} is no address of this host, which has {ours}; correct --listen, or give the interface that address"
    )
}

/// Addresses as text.
pub(super) fn list(addresses: &[Address]) -> String {
    let one = |it: &Address| format!("{}/{} on {}", it.ip, it.prefix, it.interface);
    let all: Vec<_> = addresses.iter().map(one).collect();
    if all.is_empty() {
        "none".to_owned()
    } else {
        all.join(", ")
    }
}

/// This host's IPv4 addresses.
pub(super) fn addresses() -> Vec<Address> {
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

/// The program that holds a UDP port, if this user can read it.
fn owner(port: u16) -> Option<String> {
    let inode = inode(port)?;
    let link = format!("socket:[{inode}]");
    let processes = std::fs::read_dir("/proc").ok()?.flatten();
    let holder = processes
        .map(|process| process.path())
        .find(|process| holds(process, &link))?;
    let name = std::fs::read_to_string(holder.join("comm")).ok()?;
    let id = holder.file_name()?.to_string_lossy().into_owned();
    Some(format!("`{}` (process {id})", name.trim()))
}

/// Whether a program of this host listens at a UDP port.
pub(super) fn is_taken(port: u16) -> bool {
    inode(port).is_some()
}

fn inode(port: u16) -> Option<u64> {
    let tables = ["/proc/net/udp", "/proc/net/udp6"];
    tables
        .iter()
        .filter_map(|path| std::fs::read_to_string(path).ok())
        .find_map(|table| inode_of(&table, port))
}

fn holds(process: &Path, link: &str) -> bool {
    let files = std::fs::read_dir(process.join("fd"))
        .into_iter()
        .flatten()
        .flatten();
    files
        .filter_map(|file| std::fs::read_link(file.path()).ok())
        .any(|target| target.as_os_str() == link)
}

/// The inode of the socket bound to a port, in a table of the kernel (`proc_net(5)`).
fn inode_of(table: &str, port: u16) -> Option<u64> {
    table.lines().skip(1).find_map(|line| {
        let mut words = line.split_whitespace();
        let (_, local) = words.nth(1)?.rsplit_once(':')?;
        let is_it = u16::from_str_radix(local, 16) == Ok(port);
        is_it.then(|| words.nth(7)?.parse().ok()).flatten()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(ip: [u8; 4], prefix: u32) -> Address {
        Address {
            interface: "enp3s0".into(),
            ip: ip.into(),
            prefix,
        }
    }

    #[test]
    fn fri_port_holder_is_found_in_kernel_table() {
        let table = "   sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode ref pointer drops
  117: 0100007F:C312 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 48213 2 0000000000000000 0
  118: 00000000:0044 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 7 2 0000000000000000 0
";
        assert_eq!(inode_of(table, 49938), Some(48213));
        assert_eq!(inode_of(table, 68), Some(7));
        assert_eq!(inode_of(table, 69), None);
    }

    #[test]
    fn fri_netmask_decides_whether_an_address_is_near() {
        let near = |prefix, ip: [u8; 4]| address([192, 168, 0, 5], prefix).is_near(ip.into());
        assert!(near(24, [192, 168, 0, 20]));
        assert!(!near(24, [192, 168, 1, 20]));
        assert!(!near(30, [192, 168, 0, 20]));
        assert!(near(0, [10, 0, 0, 1]));
        assert!(!near(32, [192, 168, 0, 4]));
    }

    #[test]
    fn fri_port_errors_name_cause_and_remedy() {
        let listen = "0.0.0.0:49938".parse().unwrap();
        assert_eq!(
            in_use(listen, Some("`lwr_driver` (process 812)".into())),
            "UDP port 49938 is taken by `lwr_driver` (process 812), a second client on this host; end it first"
        );
        assert!(in_use(listen, None).contains("ss -ulpn"));
        assert_eq!(
            not_ours(
                IpAddr::from([192, 168, 0, 7]),
                &[address([192, 168, 0, 5], 24)]
            ),
            "192.168.0.7 is no address of this host, which has 192.168.0.5/24 on enp3s0; correct --listen, or give \
             the interface that address"
        );
    }
}

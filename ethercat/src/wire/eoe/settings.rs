//! The addresses of the Ethernet port of a slave, as EoE carries them.

use std::fmt;
use std::net::Ipv4Addr;

/// Bytes of a host name on the wire, filled up by zeros.
const NAME_LEN: usize = 32;

/// A host name, 1 to 32 bytes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct HostName([u8; NAME_LEN]);

impl HostName {
    /// The name; `None` if it is empty, longer than 32 bytes, or has other characters than a host name.
    pub fn new(name: &str) -> Option<Self> {
        let is_valid =
            |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'.' | b'_');
        let mut bytes = [0; NAME_LEN];
        bytes
            .get_mut(..name.len())
            .filter(|_| !name.is_empty() && name.bytes().all(is_valid))?
            .copy_from_slice(name.as_bytes());
        Some(Self(bytes))
    }

    /// From at most 32 bytes as received.
    pub(super) fn received(bytes: &[u8]) -> Self {
        let mut name = [0; NAME_LEN];
        for (to, from) in name.iter_mut().zip(bytes) {
            *to = *from;
        }
        Self(name)
    }
}

impl fmt::Display for HostName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.0.split(|byte| *byte == 0).next().unwrap_or_default();
        // What a slave sent may be anything, also control sequences of a terminal.
        write!(f, "{}", name.escape_ascii())
    }
}

impl fmt::Debug for HostName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{self}\"")
    }
}

/// The addresses of a port; those that are `None` are not included.
///
/// | bytes | field |
/// |---|---|
/// | 0 to 3 | bits 0 MAC, 1 IP, 2 subnet mask, 3 gateway, 4 DNS server, 5 host name included |
/// | then | the included ones in this order: 6, 4, 4, 4, 4, 32 bytes; IP addresses last octet first |
///
/// Some masters, slaves and Wireshark instead keep the places of those that are not included, 58 bytes in all. Where none
/// before the last included one is missing, and zeros follow it, both forms are the same: masters include all up to there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IpSettings {
    /// MAC address.
    pub mac: Option<[u8; 6]>,
    /// IP address.
    pub ip: Option<Ipv4Addr>,
    /// Subnet mask.
    pub mask: Option<Ipv4Addr>,
    /// Default gateway; 0.0.0.0 for none.
    pub gateway: Option<Ipv4Addr>,
    /// DNS server; 0.0.0.0 for none.
    pub dns: Option<Ipv4Addr>,
    /// Host name.
    pub name: Option<HostName>,
}

/// Lengths of the fields in their order.
const LENS: [usize; 6] = [6, 4, 4, 4, 4, NAME_LEN];

impl IpSettings {
    /// Longest encoding, bytes.
    pub const LEN_MAX: usize = 58;

    /// Decodes either form; `None` if truncated.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (flags, mut rest) = bytes.split_first_chunk::<4>()?;
        let flags = u32::from_le_bytes(*flags);
        let keeps_places = bytes.len() >= Self::LEN_MAX;
        let mut fields = [None; 6];
        for (number, (field, len)) in fields.iter_mut().zip(LENS).enumerate() {
            let is_included = flags >> number & 1 == 1;
            if !is_included && !keeps_places {
                continue;
            }
            // A host name at the end may be shorter.
            let len = if len == NAME_LEN {
                len.min(rest.len())
            } else {
                len
            };
            let (bytes, behind) = rest.split_at_checked(len)?;
            (*field, rest) = (is_included.then_some(bytes), behind);
        }
        let [mac, ip, mask, gateway, dns, name] = fields;
        let address = |field: Option<&[u8]>| {
            let [d, c, b, a] = *field?.first_chunk()?;
            Some(Ipv4Addr::new(a, b, c, d))
        };
        Some(Self {
            mac: mac.and_then(|bytes| bytes.first_chunk().copied()),
            ip: address(ip),
            mask: address(mask),
            gateway: address(gateway),
            dns: address(dns),
            name: name.map(HostName::received),
        })
    }

    /// The bytes: included fields, one after the other; if none before the last is missing, filled up to 58 bytes by zeros.
    pub fn encode(&self) -> Vec<u8> {
        let address = |field: Option<Ipv4Addr>| {
            field.map(|ip| ip.octets().into_iter().rev().collect::<Vec<u8>>())
        };
        let fields = [
            self.mac.map(Vec::from),
            address(self.ip),
            address(self.mask),
            address(self.gateway),
            address(self.dns),
            self.name.map(|name| name.0.to_vec()),
        ];
        let flags = fields.iter().rev().fold(0_u32, |flags, field| {
            flags << 1 | u32::from(field.is_some())
        });
        let mut bytes = flags.to_le_bytes().to_vec();
        bytes.extend(fields.into_iter().flatten().flatten());
        if (flags + 1).is_power_of_two() {
            bytes.resize(Self::LEN_MAX, 0);
        }
        bytes
    }
}

/// A MAC address, as people write it.
pub(super) fn mac(f: &mut fmt::Formatter<'_>, mac: [u8; 6]) -> fmt::Result {
    for (number, byte) in mac.into_iter().enumerate() {
        let colon = if number == 0 { "" } else { ":" };
        write!(f, "{colon}{byte:02x}")?;
    }
    Ok(())
}

impl fmt::Display for IpSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "";
        if let Some(address) = self.mac {
            f.write_str("MAC ")?;
            mac(f, address)?;
            separator = ", ";
        }
        let addresses = [
            ("IP", self.ip),
            ("mask", self.mask),
            ("gateway", self.gateway),
            ("DNS", self.dns),
        ];
        for (what, address) in addresses {
            if let Some(address) = address {
                write!(f, "{separator}{what} {address}")?;
                separator = ", ";
            }
        }
        if let Some(name) = self.name {
            write!(f, "{separator}name {name}")?;
            separator = ", ";
        }
        if separator.is_empty() {
            f.write_str("none")?;
        }
        Ok(())
    }
}

//! Link, IPv4 (RFC 791) and UDP (RFC 768) headers around datagrams of a recording. No reassembly, no IPv6: controllers have
//! none.
#![warn(clippy::indexing_slicing)]

use super::Datagram;
use std::net::{Ipv4Addr, SocketAddrV4};
use takt_link::capture::LinkType;

const IPV4: u16 = 0x0800;
const VLAN: u16 = 0x8100;
const UDP: u8 = 17;
/// Lengths of headers without options, bytes.
const IP_LEN: usize = 20;
const UDP_LEN: usize = 8;

/// The IPv4 packet in a frame, `Some(None)` if it holds none; `None` if the link layer is unknown.
pub(super) fn network(link: LinkType, frame: &[u8]) -> Option<Option<&[u8]>> {
    let packet = match link {
        LinkType::ETHERNET => ethernet(frame),
        LinkType::RAW | LinkType::IPV4 => Some(frame),
        LinkType::LINUX_SLL => typed(frame, 14, 16),
        LinkType::LINUX_SLL2 => typed(frame, 0, 20),
        // BSD loopback: the address family is not needed, the IPv4 header identifies itself.
        LinkType::NULL => frame.get(4..),
        _ => return None,
    };
    Some(packet)
}

fn ethernet(frame: &[u8]) -> Option<&[u8]> {
    match u16_at(frame, 12)? {
        IPV4 => frame.get(14..),
        VLAN => typed(frame, 16, 18),
        _ => None,
    }
}

/// The packet at `start` if the EtherType at `at` is IPv4.
fn typed(frame: &[u8], at: usize, start: usize) -> Option<&[u8]> {
    (u16_at(frame, at)? == IPV4).then(|| frame.get(start..))?
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    let two = bytes.get(at..)?.first_chunk()?;
    Some(u16::from_be_bytes(*two))
}

fn address_at(bytes: &[u8], at: usize) -> Option<Ipv4Addr> {
    let four: [u8; 4] = *bytes.get(at..)?.first_chunk()?;
    Some(four.into())
}

/// Sender, receiver and content of the UDP datagram in an IPv4 packet; `None` if it holds no whole one.
pub(super) fn parse(packet: &[u8]) -> Option<(SocketAddrV4, SocketAddrV4, &[u8])> {
    let version_and_len = *packet.first()?;
    let is_fragment = u16_at(packet, 6)? & 0x3fff != 0;
    if version_and_len >> 4 != 4 || is_fragment || *packet.get(9)? != UDP {
        return None;
    }
    let (from, to) = (address_at(packet, 12)?, address_at(packet, 16)?);
    let udp = packet.get(usize::from(version_and_len & 0xf) * 4..)?;
    let len = usize::from(u16_at(udp, 4)?);
    let content = udp.get(UDP_LEN..len)?;
    let from = SocketAddrV4::new(from, u16_at(udp, 0)?);
    let to = SocketAddrV4::new(to, u16_at(udp, 2)?);
    Some((from, to, content))
}

/// An IPv4 packet around a datagram. A datagram longer than UDP can carry is cut.
pub(super) fn build(datagram: &Datagram) -> Vec<u8> {
    let room = usize::from(u16::MAX) - IP_LEN - UDP_LEN;
    let content = datagram.bytes.get(..room).unwrap_or(&datagram.bytes);
    let total = |header: usize| u16::try_from(content.len() + header).unwrap_or(u16::MAX);
    let mut packet = Vec::with_capacity(IP_LEN + UDP_LEN + content.len());
    packet.extend([0x45, 0]);
    packet.extend(total(IP_LEN + UDP_LEN).to_be_bytes());
    // No identification, don't fragment, 64 hops.
    packet.extend([0, 0, 0x40, 0, 64, UDP, 0, 0]);
    packet.extend(datagram.from.ip().octets());
    packet.extend(datagram.to.ip().octets());
    let checksum = checksum(&packet).to_be_bytes();
    if let Some(field) = packet.get_mut(10..12) {
        field.copy_from_slice(&checksum);
    }
    packet.extend(datagram.from.port().to_be_bytes());
    packet.extend(datagram.to.port().to_be_bytes());
    packet.extend(total(UDP_LEN).to_be_bytes());
    // A UDP checksum of 0 means that none was computed.
    packet.extend([0, 0]);
    packet.extend(content);
    packet
}

/// Checksum of an IPv4 header whose checksum field is 0.
fn checksum(header: &[u8]) -> u16 {
    let words = header.chunks_exact(2).filter_map(|word| u16_at(word, 0));
    let mut sum: u32 = words.map(u32::from).sum();
    while sum > 0xffff {
        sum = (sum & 0xffff) + (sum >> 16);
    }
    !u16::try_from(sum).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ipv4_checksum_matches_textbook_header() {
        // A textbook example: its checksum is 0xb861.
        let header = [
            0x45, 0, 0, 0x73, 0, 0, 0x40, 0, 0x40, 0x11, 0, 0, 0xc0, 0xa8, 0, 1, 0xc0, 0xa8, 0,
            0xc7,
        ];
        assert_eq!(checksum(&header), 0xb861);
    }
}

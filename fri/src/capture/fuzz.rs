//! What must hold for any recorded packets, in one function for tests and fuzzers. It generates no input itself.

use super::{Datagram, Decoded, Reader, Writer};
use crate::diagnosis::Observer;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::Duration;
use takt_link::capture::LinkType;

/// Longest packet taken out of the input, bytes.
const PACKET_MAX: usize = 2048;

/// Reads `bytes` as IPv4 packets of a recording, each preceded by its time (8 bytes) and length (2 bytes), little
/// endian, and passes their content to an observer of either generation, as the tools do.
pub fn fuzz(bytes: &[u8]) {
    let mut observers = [Observer::lwr(), Observer::sunrise()];
    let mut rest = bytes;
    while let Some((at, packet, behind)) = next(rest) {
        rest = behind;
        let Some(datagram) = Datagram::in_packet(at, packet) else {
            continue;
        };
        let decoded = Decoded::of(&datagram.bytes);
        let _line = decoded.to_string();
        let _named = Observer::of(&decoded);
        for observer in &mut observers {
            observer.handle_datagram(&datagram);
        }
    }
    for observer in observers {
        let _line = observer.verdict().to_string();
    }
}

/// Reads `bytes` as a pcap or pcapng file, up to the first error.
pub fn fuzz_file(bytes: &[u8]) {
    let Ok(reader) = Reader::new(bytes) else {
        return;
    };
    for datagram in reader.map_while(Result::ok) {
        let _line = datagram.to_string();
    }
}

/// Small seed files for [`fuzz_file`]: raw IP as this crate writes it, and Ethernet.
pub fn files() -> Vec<Vec<u8>> {
    let address = |port| SocketAddrV4::new(Ipv4Addr::new(192, 168, 0, 2), port);
    let datagram = Datagram {
        at: Duration::from_secs(1_700_000_000),
        from: address(49_152),
        to: address(49_153),
        bytes: vec![0x5A; 40],
    };
    let ours = Writer::new(Vec::new()).and_then(|mut writer| {
        writer.write(&datagram)?;
        writer.write(&datagram)?;
        Ok(writer.into_inner())
    });
    let ethernet = takt_link::capture::Writer::new(Vec::new(), LinkType::ETHERNET);
    let ethernet = ethernet.and_then(|mut writer| {
        let mut frame = vec![2; 12];
        frame.extend([8, 0]);
        frame.extend(datagram.to_packet());
        writer.write(datagram.at, &frame)?;
        Ok(writer.into_inner())
    });
    let files = [ours.ok(), ethernet.ok()].into_iter().flatten();
    files.chain([ng(&datagram.to_packet())]).collect()
}

/// A pcapng file: a section, an interface for raw IP, a packet.
fn ng(packet: &[u8]) -> Vec<u8> {
    let block = |kind: u32, body: &[u8]| {
        let mut body = body.to_vec();
        body.resize(body.len().next_multiple_of(4), 0);
        let len = u32::try_from(body.len() + 12)
            .unwrap_or(u32::MAX)
            .to_le_bytes();
        [&kind.to_le_bytes()[..], &len, &body, &len].concat()
    };
    let len = u32::try_from(packet.len())
        .unwrap_or(u32::MAX)
        .to_le_bytes();
    let head = [
        0x4D, 0x3C, 0x2B, 0x1A, 1, 0, 0, 0, 255, 255, 255, 255, 255, 255, 255, 255,
    ];
    // Link type 101, no limit, resolution of 10^-9 s.
    let interface = [101, 0, 0, 0, 0, 0, 0, 0, 9, 0, 1, 0, 9, 0, 0, 0, 0, 0, 0, 0];
    let data = [&[0; 12][..], &len, &len, packet].concat();
    [
        block(0x0A0D_0D0A, &head),
        block(1, &interface),
        block(6, &data),
    ]
    .concat()
}

fn next(bytes: &[u8]) -> Option<(Duration, &[u8], &[u8])> {
    let (at, rest) = bytes.split_first_chunk()?;
    let (len, rest) = rest.split_first_chunk()?;
    let len = usize::from(u16::from_le_bytes(*len)) % PACKET_MAX;
    let (packet, behind) = rest.split_at(len.min(rest.len()));
    Some((
        Duration::from_nanos(u64::from_le_bytes(*at)),
        packet,
        behind,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capture_fuzz_seeds_are_readable() {
        let counts = files().into_iter().map(|file| {
            let reader = Reader::new(file.as_slice()).unwrap();
            reader.map(Result::unwrap).count()
        });
        assert_eq!(counts.collect::<Vec<_>>(), [2, 1, 1]);
    }
}

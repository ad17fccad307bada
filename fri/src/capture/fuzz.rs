//! What must hold for any packets of a recording, in one function for tests and fuzzers. It makes no input of its own.

use super::{Datagram, Decoded};
use crate::diagnosis::Observer;
use std::time::Duration;

/// Longest packet taken out of the input, bytes.
const PACKET_MAX: usize = 2048;

/// Takes `bytes` for IPv4 packets of a recording, each behind its time (8 bytes) and length (2 bytes), little endian, and
/// gives what they hold to an observer of either generation, as the tools do.
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

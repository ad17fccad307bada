//! Records of a pcap file. Time stamps are not validated: a fraction of more than a second is accepted.

use std::io::Read;
use std::time::Duration;

use pcap_file::pcap::{PcapHeader, PcapParser};
use pcap_file::{Endianness, PcapError, TsResolution};

use super::input::Input;
use super::{CaptureError, LinkType, PACKET_MAX, Packet, Step, damaged, too_long};

const HEADER: usize = 24;
const RECORD: usize = 16;

/// Reads the header of the file.
pub(super) fn begin<R: Read>(input: &mut Input<R>) -> Result<PcapParser, CaptureError> {
    let bytes = input.fill(HEADER)?;
    let parser = match PcapParser::new(bytes) {
        Ok((_, parser)) => parser,
        Err(PcapError::IncompleteBuffer) => return Err(CaptureError::Short(bytes.len())),
        Err(error) => return Err(damaged(0, &error)),
    };
    input.take(HEADER);
    Ok(parser)
}

/// Returns the packet of the next record.
pub(super) fn next<R: Read>(
    input: &mut Input<R>,
    parser: &PcapParser,
) -> Result<Step, CaptureError> {
    let header = parser.header();
    let offset = input.offset();
    let bytes = input.fill(RECORD)?;
    if bytes.is_empty() {
        return Ok(Step::End);
    }
    let Some(len) = included(bytes, header) else {
        return Ok(Step::Cut(left(bytes)));
    };
    if len > PACKET_MAX {
        return Err(too_long(offset, len, PACKET_MAX));
    }
    let whole = RECORD + usize::try_from(len).unwrap_or(usize::MAX);
    let bytes = input.fill(whole)?;
    let Some(record) = bytes.get(..whole) else {
        return Ok(Step::Cut(left(bytes)));
    };
    let (_, raw) = parser
        .next_raw_packet(record)
        .map_err(|error| damaged(offset, &error))?;
    let packet = Packet {
        at: time(raw.ts_sec, raw.ts_frac, header.ts_resolution),
        link: LinkType(header.datalink.into()),
        interface: 0,
        offset,
        is_big_endian: header.endianness == Endianness::Big,
        original_len: raw.orig_len,
        data: raw.data.into_owned(),
    };
    input.take(whole);
    Ok(Step::Packet(packet))
}

fn left(bytes: &[u8]) -> u64 {
    u64::try_from(bytes.len()).unwrap_or(u64::MAX)
}

/// Bytes of a packet that follow the header of its record.
fn included(record: &[u8], header: PcapHeader) -> Option<u32> {
    let four = *record.get(..RECORD)?.get(8..)?.first_chunk()?;
    Some(match header.endianness {
        Endianness::Big => u32::from_be_bytes(four),
        Endianness::Little => u32::from_le_bytes(four),
    })
}

fn time(seconds: u32, fraction: u32, resolution: TsResolution) -> Duration {
    let fraction = u64::from(fraction);
    let part = match resolution {
        TsResolution::MicroSecond => Duration::from_micros(fraction),
        TsResolution::NanoSecond => Duration::from_nanos(fraction),
    };
    Duration::from_secs(seconds.into()) + part
}

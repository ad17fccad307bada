//! Blocks of a pcapng file. Blocks without packets are skipped unread, so that an unusual name or statistics block does
//! not stop reading.

use std::io::Read;
use std::time::Duration;

use pcap_file::Endianness;
use pcap_file::pcapng::blocks::interface_description::{
    InterfaceDescriptionBlock, InterfaceDescriptionOption,
};
use pcap_file::pcapng::{Block, PcapNgParser};

use super::input::Input;
use super::{BLOCK_MAX, CaptureError, LinkType, PCAPNG, Packet, Step, damaged, too_long};

/// Type and length before the content, length after it.
const AROUND: usize = 12;
const SECTION: u32 = u32::from_be_bytes(PCAPNG);
const INTERFACE: u32 = 1;
/// Obsolete packet block with a 16-bit interface.
const PACKET: u32 = 2;
/// Simple packet block without time and interface.
const SIMPLE: u32 = 3;
const ENHANCED: u32 = 6;
/// Maximum number of interfaces in a section; Wireshark's limits are far lower.
const INTERFACES_MAX: usize = 4096;
/// Default time resolution of an interface: 10^-6 s.
const MICROSECONDS: u8 = 6;

/// Reads the first section header of the file.
pub(super) fn begin<R: Read>(input: &mut Input<R>) -> Result<PcapNgParser, CaptureError> {
    let Some((_, len)) = head(input, Endianness::Big)? else {
        return Err(CaptureError::Short(input.fill(AROUND)?.len()));
    };
    let bytes = input.fill(len)?;
    if bytes.len() < len {
        return Err(CaptureError::Short(bytes.len()));
    }
    let (_, parser) = PcapNgParser::new(bytes).map_err(|error| damaged(0, &error))?;
    input.take(len);
    Ok(parser)
}

/// Type and length of the next block; `None` if fewer bytes than the smallest block are left.
fn head<R: Read>(
    input: &mut Input<R>,
    order: Endianness,
) -> Result<Option<(u32, usize)>, CaptureError> {
    let offset = input.offset();
    let bytes = input.fill(AROUND)?;
    let at = |at: usize| bytes.get(at..).and_then(|rest| rest.first_chunk().copied());
    let (Some(kind), Some(len), Some(magic)) = (at(0), at(4), at(8)) else {
        return Ok(None);
    };
    // A section header states its own byte order.
    let is_big = if kind == PCAPNG {
        magic == 0x1A2B_3C4D_u32.to_be_bytes()
    } else {
        order == Endianness::Big
    };
    let word = |four| {
        if is_big {
            u32::from_be_bytes(four)
        } else {
            u32::from_le_bytes(four)
        }
    };
    let kind = if kind == PCAPNG { SECTION } else { word(kind) };
    let len = word(len);
    if len > BLOCK_MAX {
        return Err(too_long(offset, len, BLOCK_MAX));
    }
    let len = usize::try_from(len).unwrap_or(usize::MAX);
    if len < AROUND || !len.is_multiple_of(4) {
        let cause = format!("a block of {len} bytes");
        return Err(CaptureError::Damaged { offset, cause });
    }
    Ok(Some((kind, len)))
}

/// Returns the next packet; `last` is the time of the previous one.
pub(super) fn next<R: Read>(
    input: &mut Input<R>,
    parser: &mut PcapNgParser,
    last: Duration,
) -> Result<Step, CaptureError> {
    loop {
        let order = parser.section().endianness;
        let Some((kind, len)) = head(input, order)? else {
            return Ok(end(input.fill(AROUND)?));
        };
        let offset = input.offset();
        let bytes = input.fill(len)?;
        let Some(block) = bytes.get(..len) else {
            return Ok(end(bytes));
        };
        let mut step = Ok(None);
        if matches!(kind, SECTION | INTERFACE | PACKET | SIMPLE | ENHANCED) {
            step = parser
                .next_block(block)
                .map_err(|error| damaged(offset, &error))
                .and_then(|(_, block)| of_block(block, parser.interfaces(), order, last, offset));
            if parser.interfaces().len() > INTERFACES_MAX {
                let cause = format!("more than {INTERFACES_MAX} interfaces");
                return Err(CaptureError::Damaged { offset, cause });
            }
        }
        input.take(len);
        match step {
            Ok(Some(packet)) => return Ok(Step::Packet(packet)),
            Ok(None) => {}
            // Without its section or interface, later packets would be misread.
            Err(error) if matches!(kind, SECTION | INTERFACE) => return Err(error),
            Err(error) => return Ok(Step::Skipped(error)),
        }
    }
}

fn end(bytes: &[u8]) -> Step {
    match bytes.len() {
        0 => Step::End,
        left => Step::Cut(u64::try_from(left).unwrap_or(u64::MAX)),
    }
}

/// The packet of a block, if it has one.
fn of_block(
    block: Block<'_>,
    interfaces: &[InterfaceDescriptionBlock<'_>],
    order: Endianness,
    last: Duration,
    offset: u64,
) -> Result<Option<Packet>, CaptureError> {
    let packet = |number: u32, ticks: Option<u64>, original_len, data: &[u8]| {
        let interface = interface(interfaces, number).ok_or_else(|| {
            let cause = "a packet of an interface without description".to_owned();
            CaptureError::Damaged { offset, cause }
        })?;
        Ok(Some(Packet {
            at: ticks.map_or(last, |ticks| time(ticks, interface)),
            link: LinkType(interface.linktype.into()),
            interface: number,
            offset,
            is_big_endian: order == Endianness::Big,
            original_len,
            data: data.to_vec(),
        }))
    };
    match block {
        Block::EnhancedPacket(it) => {
            // The library reads the time in the file as nanoseconds, whatever the interface's resolution.
            let ticks = u64::try_from(it.timestamp.as_nanos()).unwrap_or(u64::MAX);
            packet(it.interface_id, Some(ticks), it.original_len, &it.data)
        }
        Block::Packet(it) => {
            // Two words, the higher first in either byte order; the library reads one number.
            let ticks = match order {
                Endianness::Big => it.timestamp,
                Endianness::Little => it.timestamp.rotate_left(32),
            };
            let interface = it.interface_id.into();
            packet(interface, Some(ticks), it.original_len, &it.data)
        }
        Block::SimplePacket(it) => {
            // The data are padded to whole words.
            let len = usize::try_from(it.original_len).unwrap_or(usize::MAX);
            let data = it.data.get(..len).unwrap_or(&it.data);
            packet(0, None, it.original_len, data)
        }
        Block::SectionHeader(_)
        | Block::InterfaceDescription(_)
        | Block::NameResolution(_)
        | Block::InterfaceStatistics(_)
        | Block::SystemdJournalExport(_)
        | Block::Unknown(_) => Ok(None),
    }
}

fn interface<'a, 'b>(
    interfaces: &'a [InterfaceDescriptionBlock<'b>],
    number: u32,
) -> Option<&'a InterfaceDescriptionBlock<'b>> {
    interfaces.get(usize::try_from(number).ok()?)
}

/// Name of an interface.
pub(super) fn name<'a>(
    interfaces: &'a [InterfaceDescriptionBlock<'_>],
    number: u32,
) -> Option<&'a str> {
    let options = &interface(interfaces, number)?.options;
    options.iter().find_map(|option| {
        if let InterfaceDescriptionOption::IfName(name) = option {
            Some(name.as_ref())
        } else {
            None
        }
    })
}

/// Ticks of an interface as a time: 10^-n s, or 2^-n s with the highest bit set, and its offset in seconds.
fn time(ticks: u64, interface: &InterfaceDescriptionBlock<'_>) -> Duration {
    let (mut resolution, mut offset) = (MICROSECONDS, 0);
    for option in &interface.options {
        if let InterfaceDescriptionOption::IfTsResol(it) = option {
            resolution = *it;
        } else if let InterfaceDescriptionOption::IfTsOffset(it) = option {
            offset = *it;
        }
    }
    let exponent = u32::from(resolution & 0x7F);
    let base: u128 = if resolution & 0x80 == 0 { 10 } else { 2 };
    let per_second = base.checked_pow(exponent).unwrap_or(u128::MAX);
    let nanos = u128::from(ticks).saturating_mul(1_000_000_000) / per_second;
    let at = Duration::from_nanos(u64::try_from(nanos).unwrap_or(u64::MAX));
    // Negative offsets belong to recordings from before 1970.
    let offset = i64::from_ne_bytes(offset.to_ne_bytes());
    at.saturating_add(Duration::from_secs(u64::try_from(offset).unwrap_or(0)))
}

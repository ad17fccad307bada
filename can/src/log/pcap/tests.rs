//! Files made by the crate's writers, and by hand where those cannot.

use std::borrow::Cow;
use std::time::Duration;

use pcap_file::pcap::{PcapHeader, PcapPacket, PcapWriter};
use pcap_file::pcapng::PcapNgWriter;
use pcap_file::pcapng::blocks::enhanced_packet::EnhancedPacketBlock;
use pcap_file::pcapng::blocks::interface_description::{
    InterfaceDescriptionBlock, InterfaceDescriptionOption,
};
use pcap_file::{DataLink, Endianness, TsResolution};

use super::super::Format;
use super::*;

/// Frames as SocketCAN has them, and how they are printed.
fn frames() -> Vec<(Vec<u8>, &'static str)> {
    let frame = |id: u32, head: [u8; 4], data: &[u8]| {
        let mut bytes = id.to_be_bytes().to_vec();
        bytes.extend(head);
        bytes.extend(data);
        bytes
    };
    vec![
        (
            frame(0x123, [4, 0, 0, 0], &[0xDE, 0xAD, 0xBE, 0xEF]),
            "123#DEADBEEF",
        ),
        // Padded to eight bytes, as the kernel's structure is.
        (
            frame(0x98FE_F100, [2, 0, 0, 0], &[1, 2, 0, 0, 0, 0, 0, 0]),
            "18FEF100#0102",
        ),
        (frame(0x4000_0705, [1, 0, 0, 0], &[0; 8]), "705#R1"),
        (
            frame(0x2000_0004, [8, 0, 0, 0], &[0, 0x30, 0, 0, 0, 0, 0x82, 5]),
            "20000004#0030000000008205",
        ),
        (
            frame(0x321, [12, 0x07, 0, 0], &[0xAB; 12]),
            "321##3ABABABABABABABABABABABAB",
        ),
        (
            frame(0x321, [12, 0, 0, 0], &[0xAB; 12]),
            "321##0ABABABABABABABABABABABAB",
        ),
        (frame(0x321, [1, 0x04, 0, 0], &[0xAB]), "321##0AB"),
        (
            frame(0x7FF, [8, 0, 0, 15], &[0x11; 8]),
            "7FF#1111111111111111_F",
        ),
    ]
}

fn pcap(link: DataLink, endianness: Endianness, packets: &[Vec<u8>]) -> Vec<u8> {
    let header = PcapHeader {
        datalink: link,
        endianness,
        ts_resolution: TsResolution::NanoSecond,
        ..PcapHeader::default()
    };
    let mut writer = PcapWriter::with_header(Vec::new(), header).unwrap();
    for (turn, packet) in (0..).zip(packets) {
        let at = Duration::new(1_700_000_000 + turn, 125_000);
        let len = u32::try_from(packet.len()).unwrap();
        writer
            .write_packet(&PcapPacket::new(at, len, packet))
            .unwrap();
    }
    writer.into_writer()
}

fn printed(bytes: &[u8], format: Format) -> Vec<String> {
    assert_eq!(Format::of(bytes), format);
    let log = Log::read(bytes);
    assert_eq!(log.left_out, []);
    log.records.iter().map(ToString::to_string).collect()
}

fn expected(interface: &str, direction: &str) -> Vec<String> {
    let lines = (0..).zip(frames());
    lines
        .map(|(turn, (_, text))| {
            let at = 1_700_000_000 + turn;
            format!("({at}.000125) {interface} {text}{direction}")
        })
        .collect()
}

#[test]
fn pcap_of_can_frames_is_read() {
    let packets: Vec<_> = frames().into_iter().map(|(bytes, _)| bytes).collect();
    for order in [Endianness::Big, Endianness::Little] {
        let file = pcap(DataLink::CAN_SOCKETCAN, order, &packets);
        assert_eq!(printed(&file, Format::Pcap), expected("can", ""));
    }
}

/// Behind the header of "any" the identifier is in the order of the machine that recorded.
#[test]
fn pcap_of_the_any_device_is_read() {
    for order in [Endianness::Big, Endianness::Little] {
        let in_order = |mut frame: Vec<u8>| {
            if order.is_little() {
                frame[..4].reverse();
            }
            frame
        };
        let cooked = |(frame, _): (Vec<u8>, _)| {
            let mut packet = vec![0, 4, 1, 0x18, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x0C];
            packet.extend(in_order(frame));
            packet
        };
        let mut packets: Vec<_> = frames().into_iter().map(cooked).collect();
        let mut other = packets[0].clone();
        // IPv4 on another interface of the host.
        (other[14], other[15]) = (8, 0);
        packets.push(other);
        let file = pcap(DataLink::LINUX_SLL, order, &packets);
        assert_eq!(printed(&file, Format::Pcap), expected("can", " T"));
        let second = |(frame, _): (Vec<u8>, _)| {
            let mut packet = vec![0, 0x0C, 0, 0, 0, 0, 0, 3, 1, 0x18, 0, 0];
            packet.extend([0; 8]);
            packet.extend(in_order(frame));
            packet
        };
        let packets: Vec<_> = frames().into_iter().map(second).collect();
        let file = pcap(DataLink::from(LinkType::LINUX_SLL2.0), order, &packets);
        assert_eq!(printed(&file, Format::Pcap), expected("if3", " R"));
    }
}

#[test]
fn pcapng_with_names_and_resolutions_is_read() {
    for (resolution, ticks) in [
        (None, 1_700_000_000_000_125_u64),
        (Some(6), 1_700_000_000_000_125),
        (Some(9), 1_700_000_000_000_125_000),
        (Some(0x80 | 20), (1_700_000_000 << 20) | 132),
    ] {
        let mut options = vec![InterfaceDescriptionOption::IfName(Cow::from("vcan7"))];
        options.extend(resolution.map(InterfaceDescriptionOption::IfTsResol));
        let mut writer = PcapNgWriter::new(Vec::new()).unwrap();
        let interface = InterfaceDescriptionBlock {
            linktype: DataLink::CAN_SOCKETCAN,
            snaplen: 0,
            options,
        };
        writer.write_pcapng_block(interface).unwrap();
        let (data, text) = &frames()[0];
        let packet = EnhancedPacketBlock {
            interface_id: 0,
            timestamp: Duration::from_nanos(ticks),
            original_len: u32::try_from(data.len()).unwrap(),
            data: Cow::from(data),
            options: vec![],
        };
        writer.write_pcapng_block(packet).unwrap();
        let file = writer.into_inner();
        let expected = format!("(1700000000.000125) vcan7 {text}");
        assert_eq!(printed(&file, Format::PcapNg), [expected], "{resolution:?}");
        // A damaged block does not hide those behind it, and a cut one ends the file.
        let mut damaged = file.clone();
        let end = damaged.len();
        let len = u32::from_ne_bytes(*damaged.last_chunk().unwrap()) as usize;
        damaged.extend_from_within(end - len..);
        // Its captured length.
        damaged[end - len + 20..end - len + 24].fill(0xFF);
        let log = Log::read(&damaged);
        assert_eq!((log.records.len(), log.left_out_count), (1, 1), "{log:?}");
        let log = Log::read(&file[..file.len() - 3]);
        assert_eq!((log.records.len(), log.left_out_count), (0, 1));
    }
}

#[test]
fn pcap_of_another_link_is_one_error() {
    let packets = vec![vec![0; 60]; 20];
    let log = Log::read(&pcap(DataLink::ETHERNET, Endianness::Little, &packets));
    let link = LogError::LinkType { link: 1 };
    assert_eq!((log.records.len(), log.left_out_count), (0, 1));
    assert_eq!(log.left_out[0].why, link);
    assert!(link.to_string().contains("link type 1"));
}

#[test]
fn pcap_damaged_frames_are_counted() {
    let good = frames().remove(0).0;
    for bad in [
        vec![],
        vec![0; 7],
        good[..10].to_vec(),
        vec![0, 0, 8, 0, 0, 0, 0, 0],
        vec![0, 0, 1, 0, 0x81, 0, 0, 0],
        vec![0, 0, 1, 0, 9, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9],
        vec![0, 0, 1, 0, 100, 4, 0, 0],
    ] {
        let packets = [good.clone(), bad.clone(), good.clone()];
        let log = Log::read(&pcap(DataLink::CAN_SOCKETCAN, Endianness::Big, &packets));
        assert_eq!(
            (log.records.len(), log.left_out_count),
            (2, 1),
            "{bad:02X?}"
        );
    }
    let file = pcap(
        DataLink::CAN_SOCKETCAN,
        Endianness::Big,
        &[good.clone(), good],
    );
    let log = Log::read(&file[..file.len() - 1]);
    assert_eq!((log.records.len(), log.left_out_count), (1, 1));
    assert_eq!(log.left_out[0].location, 24 + 16 + 12);
}

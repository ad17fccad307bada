//! Recordings of every container, whole, cut off and damaged.

use std::io::{self, Read, Write};

use proptest::prelude::*;

use super::*;

/// A pcap file of packets, in a byte order.
fn pcap(magic: u32, link: u32, packets: &[(u32, u32, &[u8])], to: fn(u32) -> [u8; 4]) -> Vec<u8> {
    let mut file = to(magic).to_vec();
    file.extend([0; 16]);
    file.extend(to(link));
    for (seconds, fraction, data) in packets {
        let len = u32::try_from(data.len()).unwrap();
        for word in [*seconds, *fraction, len, len] {
            file.extend(to(word));
        }
        file.extend(*data);
    }
    file
}

fn words(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// A block of pcapng, little-endian, with its padding.
fn block(kind: u32, body: &[u8]) -> Vec<u8> {
    let mut body = body.to_vec();
    body.resize(body.len().next_multiple_of(4), 0);
    let len = words(&[u32::try_from(body.len() + 12).unwrap()]);
    [words(&[kind]), len.clone(), body, len].concat()
}

fn section() -> Vec<u8> {
    block(0x0A0D_0D0A, &words(&[0x1A2B_3C4D, 1, u32::MAX, u32::MAX]))
}

/// An interface with options, each a code and its bytes.
fn interface(link: u32, options: &[(u16, &[u8])]) -> Vec<u8> {
    let mut body = words(&[link, 0]);
    for (code, value) in options {
        body.extend(code.to_le_bytes());
        body.extend(u16::try_from(value.len()).unwrap().to_le_bytes());
        body.extend(*value);
        body.resize(body.len().next_multiple_of(4), 0);
    }
    if !options.is_empty() {
        body.extend([0; 4]);
    }
    block(1, &body)
}

fn enhanced(interface: u32, ticks: u64, data: &[u8]) -> Vec<u8> {
    let len = u32::try_from(data.len()).unwrap();
    let [high, low] = [ticks >> 32, ticks & 0xFFFF_FFFF].map(|half| u32::try_from(half).unwrap());
    let head = words(&[interface, high, low, len, len]);
    block(6, &[&head, data].concat())
}

fn read(file: &[u8]) -> Vec<Packet> {
    Reader::new(file).unwrap().map(Result::unwrap).collect()
}

fn written(packets: &[&[u8]]) -> Vec<u8> {
    let mut writer = Writer::new(Vec::new(), LinkType::ETHERNET).unwrap();
    for (second, packet) in (7..).zip(packets) {
        writer.write(Duration::new(second, 8), packet).unwrap();
    }
    writer.into_inner()
}

#[test]
fn capture_roundtrip() {
    let packets = read(&written(&[&[1, 2, 3], &[4; 60]]));
    assert_eq!(
        (packets[0].at, &packets[0].data[..]),
        (Duration::new(7, 8), &[1, 2, 3][..])
    );
    assert_eq!((packets.len(), packets[1].data.len()), (2, 60));
}

#[test]
fn pcap_reads_byte_orders_and_resolutions() {
    for to in [u32::to_le_bytes, u32::to_be_bytes] {
        for (magic, nanos) in [(0xA1B2_C3D4, 5000), (0xA1B2_3C4D, 5)] {
            let file = pcap(magic, 1, &[(1, 5, &[9, 9])], to);
            let packets = read(&file);
            assert_eq!(packets[0].at, Duration::new(1, nanos));
            assert_eq!(
                (packets[0].link, packets[0].data.len()),
                (LinkType::ETHERNET, 2)
            );
        }
    }
}

#[test]
fn pcapng_interfaces_use_their_resolution() {
    let file = [
        section(),
        interface(1, &[]),
        interface(197, &[(9, &[9]), (14, &100_u64.to_le_bytes())]),
        // A name resolution block with invalid content, a statistics block, an unknown block.
        block(4, &[0xFF; 8]),
        block(5, &[0xFF; 8]),
        block(0x0BAD, &[1, 2, 3, 4]),
        enhanced(0, 2_000_001, &[1]),
        enhanced(1, 3, &[2, 2]),
        block(3, &words(&[3, 0x0003_0303])),
        // A new section: interface 0 is another one.
        section(),
        interface(101, &[(9, &[0x8A])]),
        enhanced(0, 512, &[4; 4]),
    ]
    .concat();
    let packets = read(&file);
    let seen: Vec<_> = packets
        .iter()
        .map(|packet| {
            (
                packet.at,
                packet.link.0,
                packet.interface,
                packet.data.len(),
            )
        })
        .collect();
    let expected = [
        (Duration::from_micros(2_000_001), 1, 0, 1),
        (Duration::new(100, 3), 197, 1, 2),
        (Duration::new(100, 3), 1, 0, 3),
        (Duration::from_millis(500), 101, 0, 4),
    ];
    assert_eq!(seen, expected);
}

#[test]
fn pcapng_obsolete_packet_block_has_time() {
    let len = 2_u32;
    // Interface and drops, then the upper half of the time first.
    let body = [words(&[0, 1, 7, len, len]), vec![5, 6]].concat();
    let file = [section(), interface(1, &[]), block(2, &body)].concat();
    let at = Duration::from_micros((1 << 32) + 7);
    assert_eq!(
        (read(&file)[0].at, &read(&file)[0].data[..]),
        (at, &[5, 6][..])
    );
}

#[test]
fn reader_cut_file_returns_whole_packets() {
    let pcapng = [
        section(),
        interface(1, &[]),
        enhanced(0, 1, &[1; 8]),
        enhanced(0, 2, &[2; 8]),
    ];
    let ng_head = pcapng[0].len() + pcapng[1].len();
    let files = [
        (24, 16 + 8, written(&[&[1; 8], &[2; 8]])),
        (ng_head, pcapng[2].len(), pcapng.concat()),
    ];
    for (head, record, file) in files {
        for len in head..=file.len() {
            let mut reader = Reader::new(&file[..len]).unwrap();
            let count = reader.by_ref().map(Result::unwrap).count();
            let (whole, left) = ((len - head) / record, (len - head) % record);
            assert_eq!(count, whole, "{len}");
            let cut = Cut {
                packets: whole as u64,
                left: left as u64,
            };
            assert_eq!(reader.cut(), (left > 0).then_some(cut), "{len}");
        }
    }
    let cut = Cut {
        packets: 3,
        left: 5,
    }
    .to_string();
    assert!(cut.contains("cut off after 3 packets (5 bytes"), "{cut}");
}

#[test]
fn reader_error_ends_reading() {
    let huge = pcap(0xA1B2_C3D4, 1, &[(1, 1, &[1])], u32::to_le_bytes);
    let mut too_long = huge.clone();
    too_long.extend(words(&[1, 1, PACKET_MAX + 1, 1]));
    too_long.extend([0; 64]);
    let missing = [section(), enhanced(0, 1, &[1])].concat();
    let crooked = [section(), words(&[6, 13, 0, 0])].concat();
    let mut trailer = [section(), interface(1, &[])].concat();
    let last = trailer.len() - 1;
    trailer[last] = 7;
    for (file, good, why) in [
        (too_long, 1, "announces 1048577 bytes"),
        (missing, 0, "interface"),
        (crooked, 0, "a block of 13 bytes"),
        (trailer, 0, "damaged at byte 28"),
    ] {
        let mut reader = Reader::new(file.as_slice()).unwrap();
        assert_eq!(reader.by_ref().take_while(Result::is_ok).count(), good);
        let mut reader = Reader::new(file.as_slice()).unwrap();
        let errors: Vec<_> = reader.by_ref().filter_map(Result::err).take(10).collect();
        assert_eq!(errors.len(), 1, "{errors:?}");
        assert!(errors[0].to_string().contains(why), "{}", errors[0]);
        assert!(reader.next().is_none());
    }
}

#[test]
fn pcapng_damaged_packet_is_skipped() {
    let good = enhanced(0, 1, &[1; 8]);
    let mut damaged = good.clone();
    // Its captured length.
    damaged[20..24].fill(0xFF);
    let missing = enhanced(7, 1, &[1; 8]);
    let named = interface(227, &[(2, b"can7")]);
    for bad in [damaged, missing] {
        let file = [section(), named.clone(), good.clone(), bad, good.clone()].concat();
        let mut reader = Reader::new(file.as_slice()).unwrap();
        let items: Vec<_> = reader.by_ref().collect();
        assert!(
            matches!(
                items[..],
                [
                    Ok(_),
                    Err(CaptureError::Damaged { offset: 100, .. }),
                    Ok(Packet { offset: 140, .. })
                ]
            ),
            "{items:?}"
        );
        assert_eq!(reader.interface_name(0), Some("can7"));
        assert_eq!(reader.interface_name(7), None);
    }
}

#[test]
fn reader_io_error_is_returned_once() {
    struct Failing;
    impl Read for Failing {
        fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
            Err(io::Error::from_raw_os_error(5))
        }
    }
    let head = written(&[&[1; 4]]);
    let mut reader = Reader::new(head.as_slice().chain(Failing)).unwrap();
    assert_eq!(reader.next().unwrap().unwrap().data, [1; 4]);
    let error = reader.next().unwrap().unwrap_err().to_string();
    assert!(
        error.contains("cannot read the recording: Input/output"),
        "{error}"
    );
    assert!(reader.next().is_none());
}

#[test]
fn reader_other_formats_are_rejected_by_name() {
    let erf_only = [0; 40];
    for (file, why) in [
        (&b""[..], "header: 0 bytes"),
        (
            &[0xD4, 0xC3, 0xB2, 0xA1, 2][..],
            "cut off in its header: 5 bytes",
        ),
        (
            &[0x0A, 0x0D, 0x0D, 0x0A, 28, 0, 0, 0, 0x4D, 0x3C, 0x2B, 0x1A][..],
            "12 bytes",
        ),
        (&[0x1F, 0x8B, 8, 0][..], "gunzip"),
        (&erf_only[..], "00000000h"),
        (b"(1436509052.249713) vcan0 044#2A366C2BBA", "28313433h"),
    ] {
        let error = Reader::new(file).unwrap_err().to_string();
        assert!(error.contains(why), "{error}");
    }
}

/// A disk with that many bytes left.
struct Disk(usize, Vec<u8>);

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let len = bytes.len().min(self.0);
        self.0 -= len;
        self.1.extend(&bytes[..len]);
        if len == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        Ok(len)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn writer_full_disk_leaves_readable_file() {
    for room in 24..=(24 + 3 * 20) {
        let mut writer = Writer::new(Disk(room, Vec::new()), LinkType::RAW).unwrap();
        let results: Vec<_> = (0..4)
            .map(|_| writer.write(Duration::ZERO, &[5; 4]))
            .collect();
        let good = results.iter().take_while(|result| result.is_ok()).count();
        assert_eq!(good, (room - 24) / 20, "{room}");
        let first = results.iter().find_map(|result| result.as_ref().err());
        assert_eq!(first.map(io::Error::kind), Some(io::ErrorKind::StorageFull));
        // Space that becomes free later does not help: nothing follows half a record.
        assert!(results[good..].iter().all(Result::is_err));
        let mut disk = writer.into_inner();
        disk.0 = 100;
        let mut reader = Reader::new(disk.1.as_slice()).unwrap();
        assert_eq!(reader.by_ref().map(Result::unwrap).count(), good);
        assert_eq!(reader.cut().is_some(), (room - 24) % 20 > 0);
    }
}

/// The 16 bytes of an ET2000.
fn mark(ports: u8, flags: u8, ns: u64) -> Vec<u8> {
    [&[1, 1, 5, 0x10, 0, 0, ports, flags][..], &ns.to_le_bytes()].concat()
}

/// An ERF record.
fn erf(kind: u8, flags: u8, extensions: &[[u8; 8]], frame: &[u8]) -> Vec<u8> {
    let on_wire = u16::try_from(frame.len()).unwrap().to_be_bytes();
    let mut record = [0, 0, 0, 0x40, 9, 0, 0, 0, kind, flags, 0, 0, 0, 0].to_vec();
    record.extend(on_wire);
    record.extend(extensions.concat());
    record.extend([0, 0]);
    record.extend(frame);
    record.resize(record.len().next_multiple_of(8), 0);
    record
}

fn frames(file: &[u8]) -> Vec<EthernetFrame> {
    Frames::new(file).unwrap().map(Result::unwrap).collect()
}

#[test]
fn erf_records_yield_ethernet_frames() {
    let frame = [7; 61];
    let records = [
        erf(2, 4, &[], &frame),
        erf(0x80 | 2, 4 | 3, &[[0x80 | 5; 8], [5; 8]], &frame),
        // Not Ethernet: skipped.
        erf(1, 4, &[], &frame),
        // Extension headers without an end.
        erf(0x80 | 2, 4, &[[0x85; 8]], &[0x85; 6]),
        erf(2, 4 | 0x10, &[], &frame),
        vec![2; 3],
    ];
    let packets: Vec<_> = records
        .iter()
        .map(|record| (1, 1, record.as_slice()))
        .collect();
    let file = pcap(0xA1B2_C3D4, 197, &packets, u32::to_le_bytes);
    let frames = frames(&file);
    let seen: Vec<_> = frames
        .iter()
        .map(|it| (it.interface, it.is_corrupt, &it.bytes[..]))
        .collect();
    let expected = [(0, false), (3, false), (0, true)];
    assert_eq!(
        seen,
        expected.map(|(port, corrupt)| (port, corrupt, &frame[..]))
    );
    assert!(
        frames
            .iter()
            .all(|it| it.at == Duration::from_millis(9_250))
    );
}

#[test]
fn et2000_marks_yield_port_and_time() {
    let frame = [7; 60];
    let packets = [
        [&frame[..], &mark(0x80, 0, 5_000)].concat(),
        [&frame[..], &mark(0x40, 0x10, 5_700)].concat(),
        [&mark(0, 0x40, 6_000)[..], &frame].concat(),
        // The probe was restarted.
        [&frame[..], &mark(1, 0, 10)].concat(),
        frame.to_vec(),
    ];
    let packets: Vec<_> = (0..)
        .zip(&packets)
        .map(|(n, it)| (1, 900 * n, it.as_slice()))
        .collect();
    let read = frames(&pcap(0xA1B2_C3D4, 1, &packets, u32::to_le_bytes));
    let seen: Vec<_> = read
        .iter()
        .map(|it| (it.port, it.is_corrupt, it.at.subsec_nanos()))
        .collect();
    let expected = [
        (Some(0), false, 0),
        (Some(1), true, 700),
        (Some(9), false, 1_000),
        (Some(7), false, 2_700_000),
        (None, false, 3_600_000),
    ];
    assert_eq!(seen, expected);
    assert!(read.iter().all(|it| it.bytes == frame));
}

#[test]
fn frames_other_link_type_ends_reading() {
    let file = pcap(
        0xA1B2_C3D4,
        227,
        &[(1, 1, &[0; 16]), (2, 1, &[0; 16])],
        u32::to_le_bytes,
    );
    let items: Vec<_> = Frames::new(file.as_slice()).unwrap().take(5).collect();
    assert_eq!(items.len(), 1);
    let error = items[0].as_ref().unwrap_err().to_string();
    assert!(error.contains("link type 227 (SocketCAN)"), "{error}");
}

proptest! {
    #[test]
    fn reader_any_bytes_accepted_or_rejected(bytes in prop::collection::vec(any::<u8>(), 0..400), which in 0..4_usize) {
        let head = match which {
            0 => written(&[]),
            1 => section(),
            2 => [section(), interface(197, &[(9, &[6])])].concat(),
            _ => vec![],
        };
        fuzz(&[head, bytes].concat());
    }

    #[test]
    fn reader_flipped_bytes_accepted_or_rejected(at in 0..300_usize, value: u8) {
        let record = erf(2, 4, &[[5; 8]], &[7; 60]);
        let ng = [section(), interface(197, &[(9, &[9])]), enhanced(0, 3, &record)].concat();
        let classic = written(&[&[1; 60], &[2; 60]]);
        for mut file in [ng, classic] {
            let at = at % file.len();
            file[at] = value;
            fuzz(&file);
        }
    }
}

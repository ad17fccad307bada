//! Recordings written and read again, foreign files, and files that are none.

use super::*;
use crate::lwr::wire::CmdFlags;
use crate::sunrise::wire::Dialect;
use takt_tests::Random;

const KRC: SocketAddrV4 = SocketAddrV4::new(std::net::Ipv4Addr::new(192, 168, 0, 20), 49938);
const PC: SocketAddrV4 = SocketAddrV4::new(std::net::Ipv4Addr::new(192, 168, 0, 100), 49938);

fn datagram(ms: u64, bytes: &[u8]) -> Datagram {
    Datagram {
        at: Duration::from_secs(1_700_000_000) + Duration::from_millis(ms),
        from: KRC,
        to: PC,
        bytes: bytes.to_vec(),
    }
}

fn samples() -> Vec<Datagram> {
    let mut cmd = [0; Cmd::LEN];
    let value = Cmd {
        flags: CmdFlags::JNTPOS,
        ..Cmd::default()
    };
    value.encode(&mut cmd).unwrap();
    let mut buf = [0; 256];
    let message = Command::default();
    let len = Dialect::V3
        .frame(&mut buf, |buf| message.encode(buf))
        .unwrap();
    let mut damaged = buf[..len].to_vec();
    damaged[8] ^= 4;
    vec![
        datagram(0, &cmd),
        datagram(1, &buf[..len]),
        datagram(2, b"hello"),
        datagram(3, &damaged),
    ]
}

fn written(datagrams: &[Datagram]) -> Vec<u8> {
    let mut writer = Writer::new(Vec::new()).unwrap();
    for datagram in datagrams {
        writer.write(datagram).unwrap();
    }
    writer.into_inner()
}

fn read(file: &[u8]) -> Result<Vec<Datagram>, CaptureError> {
    Reader::new(file)?.collect()
}

/// A little-endian pcap file of one packet.
fn pcap(link: u32, packet: &[u8]) -> Vec<u8> {
    let len = u32::try_from(packet.len()).unwrap();
    let mut file = Vec::new();
    for word in [
        0xa1b2_c3d4,
        0x0004_0002,
        0,
        0,
        65_535,
        link,
        7,
        250,
        len,
        len,
    ] {
        file.extend(u32::to_le_bytes(word));
    }
    file.extend(packet);
    file
}

/// A little-endian pcapng file of one packet, whose interface counts in `resolution`.
fn pcapng(resolution: Option<u8>, ticks: u32, packet: &[u8]) -> Vec<u8> {
    let block = |kind: u32, body: &[u8]| {
        let len = u32::try_from(body.len() + 12).unwrap().to_le_bytes();
        [&kind.to_le_bytes()[..], &len, body, &len].concat()
    };
    let words = |words: &[u32]| {
        words
            .iter()
            .flat_map(|word| word.to_le_bytes())
            .collect::<Vec<_>>()
    };
    let options = resolution.map_or(Vec::new(), |it| vec![9, 0, 1, 0, it, 0, 0, 0, 0, 0, 0, 0]);
    let len = u32::try_from(packet.len()).unwrap();
    let mut padded = packet.to_vec();
    padded.resize(packet.len().next_multiple_of(4), 0);
    [
        block(0x0a0d_0d0a, &words(&[0x1a2b_3c4d, 1, u32::MAX, u32::MAX])),
        block(1, &[words(&[101, 65_535]), options].concat()),
        block(6, &[words(&[0, 0, ticks, len, len]), padded].concat()),
    ]
    .concat()
}

#[test]
fn capture_roundtrip() {
    let samples = samples();
    assert_eq!(read(&written(&samples)).unwrap(), samples);
}

#[test]
fn datagrams_are_shown_in_one_line() {
    let lines: Vec<_> = samples().iter().map(ToString::to_string).collect();
    let addresses = "192.168.0.20:49938 > 192.168.0.100:49938";
    assert_eq!(
        lines[0],
        format!(
            "22:13:20.000000 {addresses} CMD seq 0 refl 0 JNTPOS q [0.0000 0.0000 0.0000 0.0000 0.0000 0.0000 0.0000] rad"
        )
    );
    assert_eq!(
        lines[1],
        format!("22:13:20.001000 {addresses} COM seq 0 refl 0 empty")
    );
    assert_eq!(
        lines[2],
        format!("22:13:20.002000 {addresses} no FRI datagram, 5 bytes")
    );
    assert!(lines[3].ends_with("damaged in transit"), "{}", lines[3]);
}

#[test]
fn capture_tcpdump_link_layers_are_read() {
    let sample = samples().remove(2);
    let ip = packet::build(&sample);
    let sll = [&[0; 14][..], &[8, 0], &ip].concat();
    let sll2 = [&[8, 0][..], &[0; 18], &ip].concat();
    let ethernet = [&[0; 12][..], &[8, 0], &ip, &[0; 9]].concat();
    let vlan = [&[0; 12][..], &[0x81, 0, 0, 5, 8, 0], &ip].concat();
    let null = [&[2, 0, 0, 0][..], &ip].concat();
    for (link, frame) in [
        (1, ethernet),
        (1, vlan),
        (101, ip),
        (113, sll),
        (276, sll2),
        (0, null),
    ] {
        let found = read(&pcap(link, &frame)).unwrap();
        assert_eq!((found.len(), &found[0].bytes), (1, &sample.bytes), "{link}");
        assert_eq!(
            (found[0].from, found[0].at),
            (KRC, Duration::new(7, 250_000))
        );
    }
    let refused = read(&pcap(105, &[0; 40])).unwrap_err().to_string();
    assert!(
        refused.contains("link type 105\nhint: record on the interface"),
        "{refused}"
    );
}

#[test]
fn pcapng_interfaces_use_their_resolution() {
    let ip = packet::build(&samples()[0]);
    for (resolution, ticks, at) in [
        (None, 1_500_000, Duration::from_millis(1500)),
        (Some(9), 1_500_000, Duration::from_micros(1500)),
        (Some(0x8a), 512, Duration::from_millis(500)),
    ] {
        let found = read(&pcapng(resolution, ticks, &ip)).unwrap();
        assert_eq!((found.len(), found[0].at), (1, at), "{resolution:?}");
    }
}

#[test]
fn capture_other_packets_are_skipped_and_counted() {
    let mut ip = packet::build(&samples()[2]);
    let udp = ip.clone();
    ip[9] = 6;
    let mut fragment = udp.clone();
    fragment[6] = 0x20;
    let mut short = udp.clone();
    short.truncate(25);
    for packet in [&ip[..], &fragment, &short, &[], &[0x60; 60]] {
        let file = pcap(101, packet);
        let mut reader = Reader::new(&file[..]).unwrap();
        assert!(reader.next().is_none());
        assert_eq!(reader.skipped(), 1);
    }
}

#[test]
fn capture_foreign_file_is_rejected() {
    let text = b"hello, this is no recording at all";
    assert!(matches!(read(text), Err(CaptureError::Unknown(_))));
    assert!(matches!(read(b"abc"), Err(CaptureError::Short(3))));
}

#[test]
fn capture_cut_file_reads_whole_datagrams() {
    let whole = written(&samples());
    for len in 24..whole.len() {
        let mut reader = Reader::new(&whole[..len]).unwrap();
        let good = reader.by_ref().map(Result::unwrap).count();
        assert!(good < 4, "{len}");
        assert_eq!(
            reader.cut().is_some(),
            written(&samples()[..good]).len() < len
        );
    }
}

#[test]
fn capture_wrong_link_type_ends_reader() {
    let file = [pcap(105, &[0; 40]), pcap(105, &[0; 40]).split_off(24)].concat();
    assert_eq!(Reader::new(&file[..]).unwrap().take(9).count(), 1);
}

#[test]
fn capture_hostile_files_do_not_panic() {
    let mut sound = Vec::new();
    for (at, sample) in (0_u64..).zip(recorded()) {
        let packet = packet::build(&sample);
        sound.extend((at * 2_000_000).to_le_bytes());
        sound.extend(u16::try_from(packet.len()).unwrap().to_le_bytes());
        sound.extend(packet);
    }
    fuzz(&sound);
    let mut random = Random::new(1);
    for _ in 0..10_000 {
        let mut input = sound.clone();
        for _ in 0..random.below(16) {
            let at = random.below(input.len());
            input[at] = random.byte();
        }
        input.truncate(random.below(sound.len() + 1));
        fuzz(&input);
    }
}

/// Measurements and answers of both generations.
fn recorded() -> Vec<Datagram> {
    use crate::lwr::emulator::{Krc, KrcConfig};
    use crate::sunrise::emulator::{Cabinet, CabinetConfig};
    let (mut krc, mut cabinet) = (
        Krc::new(KrcConfig::default(), Duration::ZERO),
        Cabinet::new(CabinetConfig::default(), Duration::ZERO),
    );
    let mut all = samples();
    let mut buf = [0; crate::sunrise::wire::MESSAGE_MAX];
    for ms in [0, 2, 4] {
        let now = Duration::from_millis(ms);
        let len = krc.poll_transmit(now, &mut buf).unwrap();
        all.push(datagram(ms, &buf[..len]));
        let len = cabinet.poll_transmit(now, &mut buf).unwrap();
        all.push(datagram(ms, &buf[..len]));
    }
    all
}

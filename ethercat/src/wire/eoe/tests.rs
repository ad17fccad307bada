//! EoE messages: bytes by the offsets of the standard, and fragments in every wrong order. Masters and slaves are not here.

use std::net::Ipv4Addr;

use super::*;

/// A frame in fragments of mailboxes that hold `capacity` bytes after the EoE header.
fn fragments(frame: &[u8], capacity: usize) -> Vec<Fragment<'_>> {
    let (mut all, mut at): (Vec<Fragment<'_>>, _) = (Vec::new(), 0);
    while let Some(fragment) = Fragment::of(frame, at, u8::try_from(all.len()).unwrap(), capacity) {
        at += fragment.data.len();
        all.push(Fragment {
            frame: 5,
            ..fragment
        });
    }
    all
}

fn frame(len: usize) -> Vec<u8> {
    (0..len).map(|at| u8::try_from(at % 251).unwrap()).collect()
}

fn settings() -> IpSettings {
    IpSettings {
        mac: Some([2, 0, 0, 0, 0, 7]),
        ip: Some(Ipv4Addr::new(192, 168, 7, 2)),
        mask: Some(Ipv4Addr::new(255, 255, 255, 0)),
        gateway: Some(Ipv4Addr::UNSPECIFIED),
        dns: None,
        name: None,
    }
}

#[test]
fn eoe_messages_match_golden_bytes() {
    let data = settings().encode();
    let set = Eoe::Request {
        port: 1,
        request: EoeRequest::SetAddress,
        data: &data,
    };
    // Offsets of the standard: type and port, last fragment, flags of what is included, addresses last octet first.
    let mut golden = vec![
        0x12, 0x01, 0, 0, 0x0F, 0, 0, 0, 2, 0, 0, 0, 0, 7, 2, 7, 168, 192, 0, 255, 255, 255, 0, 0,
        0, 0,
    ];
    golden.resize(62, 0);
    let mut bytes = [0; 64];
    assert_eq!(set.encode(&mut bytes), Some(golden.len()));
    assert_eq!(bytes[..golden.len()], golden);
    assert_eq!(Eoe::decode(&golden), Some(set));
    let response = [0x03, 0x01, 0x01, 0x02];
    let Some(Eoe::Response { result, .. }) = Eoe::decode(&response) else {
        panic!("no response");
    };
    assert_eq!(result, EoeResult::NO_IP);
    let stamp = Eoe::TimeStamp { port: 0, time: 7 };
    assert_eq!(Eoe::decode(&[1, 1, 0, 0, 7, 0, 0, 0]), Some(stamp));
    assert_eq!(Eoe::decode(&[1, 1, 0, 0, 7, 0, 0]), None, "truncated");
    assert_eq!(Eoe::decode(&[10, 1, 0, 0]), None, "unknown");
    let fragment = Fragment {
        port: 2,
        last: true,
        stamped: true,
        stamp_requested: true,
        number: 3,
        offset: 0x21,
        frame: 9,
        data: &[1, 2],
    };
    let fragment = Eoe::Fragment(fragment);
    let golden = [0x20, 0x07, 0x43, 0x98, 1, 2];
    assert_eq!(fragment.encode(&mut bytes), Some(6));
    assert_eq!(bytes[..6], golden);
    assert_eq!(Eoe::decode(&golden), Some(fragment));
    assert_eq!(fragment.encode(&mut [0; 5]), None);
}

#[test]
fn eoe_settings_are_read_in_both_forms() {
    for gaps in [false, true] {
        let settings = IpSettings {
            mac: if gaps { None } else { settings().mac },
            dns: gaps.then_some(Ipv4Addr::new(8, 8, 4, 4)),
            name: HostName::new("drive-7"),
            ..settings()
        };
        let compact = settings.encode();
        assert_eq!(IpSettings::decode(&compact), Some(settings));
        // The last field is the name: shorter is accepted, other fields not.
        let short = &compact[..compact.len() - 25];
        assert_eq!(IpSettings::decode(short), Some(settings));
        let truncated = &compact[..compact.len() - 33];
        assert_eq!(IpSettings::decode(truncated), None);
    }
    // With a place for each, as some masters write.
    let wanted = IpSettings {
        mac: None,
        gateway: None,
        ..settings()
    };
    let mut bytes = vec![0x06, 0, 0, 0];
    bytes.extend([0; 6]);
    bytes.extend([2, 7, 168, 192, 0, 255, 255, 255]);
    bytes.resize(IpSettings::LEN_MAX, 0);
    assert_eq!(IpSettings::decode(&bytes), Some(wanted));
    let name = HostName::received(b"\x1b[2Jx\0y");
    assert_eq!(name.to_string(), "\\x1b[2Jx");
    for name in ["", "a b", &"x".repeat(33)] {
        assert_eq!(HostName::new(name), None);
    }
}

#[test]
fn eoe_filter_survives_the_wire() {
    let filter = AddressFilter {
        addresses: vec![[1, 2, 3, 4, 5, 6]; 15],
        masks: vec![[0xFF; 6]; 3],
        no_broadcasts: true,
    };
    let bytes = filter.encode().unwrap();
    assert_eq!((bytes.len(), &bytes[..2]), (122, &[0xBF, 0][..]));
    assert_eq!(AddressFilter::decode(&bytes), Some(filter.clone()));
    assert_eq!(AddressFilter::decode(&bytes[..121]), None);
    let too_many = AddressFilter {
        addresses: vec![[0; 6]; 16],
        ..filter
    };
    assert_eq!(too_many.encode(), None);
}

#[test]
fn eoe_frames_of_any_length_are_reassembled() {
    let mut reassembly = Reassembly::default();
    for capacity in [32, 100, 118, 1014, 2000] {
        for len in [14, 31, 32, 33, 60, 96, 97, 1014, 1514, FRAME_MAX] {
            let frame = frame(len);
            let parts = fragments(&frame, capacity);
            let (last, before) = parts.split_last().unwrap();
            for part in before {
                assert_eq!(reassembly.push(part), None);
            }
            let whole = reassembly.push(last);
            assert_eq!(whole, Some((&frame[..], None)), "{len} in {capacity}");
        }
    }
    assert_eq!(reassembly.dropped(), (0, None));
    // A unit does not fit; a frame is longer than 63 units.
    assert_eq!(Fragment::of(&[0; 60], 0, 0, 31), None);
    assert_eq!(Fragment::of(&[0; 2017], 0, 0, 1000), None);
}

#[test]
fn eoe_time_stamp_is_cut_from_frame() {
    let mut reassembly = Reassembly::default();
    let frame = [&frame(64)[..], &[1, 2, 0, 0]].concat();
    let mut part = fragments(&frame, 100)[0];
    (part.stamped, part.offset) = (true, 2);
    let whole = reassembly.push(&part);
    assert_eq!(whole, Some((&frame[..64], Some(0x0201))));
    part.data = &[0; 3];
    assert_eq!(reassembly.push(&part), None);
    assert_eq!(reassembly.dropped().0, 1);
}

#[test]
fn eoe_broken_fragments_drop_their_frame_once() {
    let frame = frame(300);
    let parts = fragments(&frame, 64);
    let changed = |at: usize, change: &dyn Fn(&mut Fragment<'_>)| {
        let mut parts = parts.clone();
        change(&mut parts[at]);
        parts
    };
    let without = |at: usize| {
        let mut parts = parts.clone();
        parts.remove(at);
        parts
    };
    let mut swapped = parts.clone();
    swapped.swap(1, 2);
    let other = FragmentError::Frame {
        expected: 5,
        found: 6,
    };
    let (before, found) = (0, 2);
    let number = FragmentError::Number { before, found };
    let cases = [
        (without(1), number),
        (swapped, number),
        (without(0), FragmentError::NoBeginning(1)),
        (changed(2, &|part| part.frame = 6), other),
        (
            changed(1, &|part| part.offset = 3),
            FragmentError::Offset {
                expected: 64,
                found: 96,
            },
        ),
        (
            changed(0, &|part| part.offset = 4),
            FragmentError::TooLong {
                len: 192,
                allowed: 128,
            },
        ),
        (
            changed(0, &|part| (part.last, part.data) = (true, &[1; 13])),
            FragmentError::TooShort(13),
        ),
    ];
    for (parts, cause) in cases {
        let mut reassembly = Reassembly::default();
        for part in &parts {
            assert_eq!(reassembly.push(part), None, "{cause}");
        }
        assert_eq!(reassembly.dropped(), (1, Some(cause)));
        // The next frame is not affected.
        let next = self::frame(60);
        let part = fragments(&next, 64)[0];
        let part = Fragment { frame: 7, ..part };
        assert_eq!(reassembly.push(&part), Some((&next[..], None)), "{cause}");
        assert_eq!(reassembly.dropped(), (1, Some(cause)));
    }
    // The end is missing: known when the next begins.
    let mut reassembly = Reassembly::default();
    for part in &parts[..3] {
        reassembly.push(part);
    }
    assert_eq!(reassembly.dropped(), (0, None));
    reassembly.push(&parts[0]);
    let unfinished = FragmentError::Unfinished(192);
    assert_eq!(reassembly.dropped(), (1, Some(unfinished)));
}

#[test]
fn eoe_announced_length_beyond_ethernet_is_bounded() {
    let mut reassembly = Reassembly::default();
    let data = [0; 96];
    let mut part = Fragment::of(&data, 0, 0, 96).unwrap();
    (part.offset, part.last) = (0x3F, false);
    for number in 0..64 {
        if number > 0 {
            (part.number, part.offset) = (number, (number * 3).min(0x3F));
        }
        assert_eq!(reassembly.push(&part), None);
    }
    let (len, allowed) = (1536, FRAME_MAX);
    let cause = FragmentError::TooLong { len, allowed };
    assert_eq!(reassembly.dropped(), (1, Some(cause)));
}

/// Any bytes are decoded without panic, and any fragments are reassembled or dropped.
#[test]
fn eoe_any_bytes_are_answered() {
    let mut random = takt_link::Random::new(7);
    let mut reassembly = Reassembly::default();
    for _ in 0..10_000 {
        let len = usize::try_from(random.next() % 80).unwrap();
        let bytes: Vec<u8> = (0..len).map(|_| random.next().to_le_bytes()[0]).collect();
        let Some(message) = Eoe::decode(&bytes) else {
            continue;
        };
        let _ = message.to_string();
        let mut again = [0; 96];
        let len = message.encode(&mut again).unwrap();
        assert_eq!(Eoe::decode(&again[..len]), Some(message));
        if let Eoe::Fragment(fragment) = message {
            let whole = reassembly.push(&fragment);
            assert!(whole.is_none_or(|(frame, _)| frame.len() <= FRAME_MAX));
        }
    }
}

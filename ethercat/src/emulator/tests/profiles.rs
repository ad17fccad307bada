//! What the recordings of real devices show, device by device: registers, clocks, SII, mailboxes, states.

use super::*;
use crate::emulator::{Handles, Profile};
use crate::sii::{Category, MailboxAreas, Sii, word};

fn line(profiles: &[Profile]) -> (Bench, Vec<Handles>) {
    let (segment, handles) = Profile::line(profiles, 1).unwrap();
    let mut bench = Bench {
        segment,
        now: 100 * MS,
    };
    bench.address();
    (bench, handles)
}

fn word_at(bench: &mut Bench, at: Register) -> u16 {
    u16::from_le_bytes(bench.read(0x1000, at))
}

#[test]
fn information_registers_are_those_of_each_device() {
    // Type, revision, build, FMMUs, SyncManagers, KiB, 0007h, 0008h, 0140h and 0141h.
    for (profile, information, configuration) in [
        (
            Profile::Ek1100,
            [0x11, 0, 3, 0, 8, 8, 8, 0x3B, 0xFC, 0x00],
            [0x00, 0x0D],
        ),
        (
            Profile::El1004,
            [0x12, 1, 1, 0, 3, 4, 1, 0x4A, 0xFC, 0x01],
            [0x04, 0x01],
        ),
        (
            Profile::Lan9252,
            [0xC0, 2, 1, 0, 3, 4, 4, 0x1F, 0xCC, 0x01],
            [0x89, 0x0E],
        ),
        (
            Profile::Akd,
            [0x04, 2, 0x43, 0, 3, 4, 4, 0x0F, 0x84, 0x01],
            [0x08, 0x0C],
        ),
    ] {
        let (mut bench, _) = line(&[profile]);
        assert_eq!(bench.read::<10>(0x1000, 0x0000), information, "{profile}");
        assert_eq!(bench.read::<2>(0x1000, 0x0140), configuration, "{profile}");
    }
    for profile in Profile::ALL {
        let (mut bench, _) = line(&[profile]);
        assert_eq!(
            word_at(&mut bench, 0x0008) & 0x0004,
            4,
            "{profile} announces a clock"
        );
    }
}

#[test]
fn status_registers_at_rest_are_those_of_each_device() {
    // SII status, DL status of the last in line, and AL status after 0011h.
    for (profile, sii, dl, al) in [
        (Profile::Ek1100, 0x0040, 0x5611, 0x0011_u16),
        (Profile::El1004, 0x0050, 0x5613, 0x0011),
        (Profile::El2004, 0x0040, 0x5613, 0x0011),
        (Profile::El2828, 0x0050, 0x5613, 0x0011),
        (Profile::El2889, 0x0040, 0x5613, 0x0011),
        (Profile::El3004, 0x0050, 0x5613, 0x0001),
        (Profile::Ek1914, 0x0040, 0x5613, 0x0001),
        (Profile::Lan9252, 0x0080, 0x5617, 0x0001),
        (Profile::Akd, 0x0020, 0x5613, 0x0001),
    ] {
        let (mut bench, _) = line(&[profile]);
        assert_eq!(word_at(&mut bench, register::SII_CONTROL), sii, "{profile}");
        assert_eq!(word_at(&mut bench, register::DL_STATUS), dl, "{profile}");
        bench.write(0x1000, register::AL_CONTROL, &[0x11, 0]);
        bench.now += 50 * MS;
        let shown: [u8; 6] = bench.read(0x1000, register::AL_STATUS);
        assert_eq!(shown, [al.to_le_bytes()[0], 0, 0, 0, 0, 0], "{profile}");
    }
    let (mut bench, _) = line(&[Profile::Ek1100, Profile::El2828, Profile::El2889]);
    assert_eq!(word_at(&mut bench, register::DL_STATUS), 0x5A31);
    let middle = bench.read::<2>(0x1001, register::DL_STATUS);
    assert_eq!(u16::from_le_bytes(middle), 0x5A33);
}

#[test]
fn clocks_answer_as_far_as_each_device_has_one() {
    for profile in Profile::ALL {
        let (mut bench, _) = line(&[profile]);
        let whole = matches!(
            profile,
            Profile::Ek1100 | Profile::El2889 | Profile::Lan9252 | Profile::Akd
        );
        assert_eq!(bench.device(Command::Bwr, 0, 0x0900, &[0; 4]).counter, 1);
        assert_ne!(
            bench.read::<4>(0x1000, 0x0900),
            *b"Verl",
            "{profile}: latched"
        );
        // Ports without a link keep their values.
        assert_eq!(bench.read::<12>(0x1000, 0x0904), *b"VerlVerlVerl");
        let counter = u16::from(whole);
        for (at, len) in [
            (0x0910, 8),
            (0x0918, 8),
            (0x0920, 8),
            (0x0928, 4),
            (0x092C, 4),
            (0x0930, 2),
            (0x0934, 2),
            (0x0981, 1),
            (0x0990, 8),
            (0x09A0, 4),
            (0x09A4, 4),
        ] {
            let answer = bench.device(Command::Fprd, 0x1000, at, &vec![0; len]);
            assert_eq!(answer.counter, counter, "{profile} {at:04X}h");
        }
        if whole {
            let answer = bench.device(Command::Fpwr, 0x1000, 0x092C, &[0; 4]);
            assert_eq!(answer.counter, 0, "092Ch is read only");
            let time: [u8; 8] = bench.read(0x1000, 0x0910);
            let narrow = profile == Profile::Akd;
            assert_eq!(time[4..] == [0; 4], narrow, "{profile}: {time:X?}");
        }
    }
}

#[test]
fn receive_times_of_lines_are_those_recorded() {
    for (devices, between) in [
        (
            &[Profile::Ek1100, Profile::El2828, Profile::El2889][..],
            &[600, 310][..],
        ),
        (&[Profile::Lan9252, Profile::Lan9252], &[720]),
    ] {
        let (mut bench, _) = line(devices);
        bench.device(Command::Bwr, 0, 0x0900, &[0; 4]);
        for (n, between) in (0..).zip(between) {
            let [a, b, c, d, e, f, g, h] = bench.read(0x1000 + n, 0x0900);
            let (first, second) = ([a, b, c, d], [e, f, g, h]);
            let passed = u32::from_le_bytes(second).wrapping_sub(u32::from_le_bytes(first));
            assert!(passed.abs_diff(*between) <= 2, "slave {n}: {passed} ns");
        }
    }
}

#[test]
fn fmmus_and_memory_beyond_the_chip_are_missing() {
    let (mut bench, _) = line(&[Profile::El1004]);
    bench.device(Command::Fpwr, 0x1000, register::FMMU + 48, &[1; 16]);
    assert_eq!(bench.read::<16>(0x1000, register::FMMU + 48), [0; 16]);
    bench.device(Command::Fpwr, 0x1000, register::SYNC_MANAGER + 32, &[1; 8]);
    assert_eq!(bench.read::<8>(0x1000, register::SYNC_MANAGER + 32), [0; 8]);
    assert_eq!(bench.device(Command::Fprd, 0x1000, 0x13FF, &[0]).counter, 1);
    assert_eq!(bench.device(Command::Fprd, 0x1000, 0x1400, &[0]).counter, 0);
}

/// Reads a whole EEPROM in units of the interface; returns how many times it was busy.
fn eeprom(bench: &mut Bench, bytes_at_once: usize) -> (Vec<u8>, u32) {
    let (mut image, mut busy) = (Vec::new(), 0);
    while image.len() < 512 {
        let word = u16::try_from(image.len() / 2).unwrap().to_le_bytes();
        bench.write(
            0x1000,
            register::SII_CONTROL,
            &[0, 1, word[0], word[1], 0, 0],
        );
        while word_at(bench, register::SII_CONTROL) & 0x8000 != 0 {
            busy += 1;
            bench.now += MS / 2;
        }
        let data: [u8; 8] = bench.read(0x1000, register::SII_DATA);
        image.extend_from_slice(&data[..bytes_at_once]);
    }
    (image, busy)
}

#[test]
fn eeproms_are_read_by_four_or_eight_bytes() {
    for profile in Profile::ALL {
        let four = matches!(profile, Profile::Lan9252 | Profile::Akd);
        let (mut bench, _) = line(&[profile]);
        let (image, busy) = eeprom(&mut bench, if four { 4 } else { 8 });
        let kept = bench.segment.slave(0).unwrap().eeprom();
        assert_eq!(image, kept[..image.len()], "{profile}");
        assert!(busy >= 64, "{profile} was busy {busy} times");
    }
}

#[test]
fn eeprom_that_stores_refuses_three_commands_running() {
    let (mut bench, _) = line(&[Profile::Ek1100]);
    let write = [1, 2, 4, 0, 0, 0, 0x34, 0x12];
    bench.write(0x1000, register::SII_CONTROL, &write);
    assert_eq!(
        word_at(&mut bench, register::SII_CONTROL),
        0x0040,
        "free at once"
    );
    for _ in 0..3 {
        bench.now += MS / 4;
        bench.write(0x1000, register::SII_CONTROL, &write);
        let status = word_at(&mut bench, register::SII_CONTROL);
        assert_eq!(status & 0x2000, 0x2000, "no acknowledge");
    }
    bench.now += MS / 4;
    bench.write(0x1000, register::SII_CONTROL, &write);
    assert_eq!(
        word_at(&mut bench, register::SII_CONTROL) & 0x2000,
        0,
        "taken"
    );
    assert_eq!(
        bench.segment.slave(0).unwrap().eeprom()[8..10],
        [0x34, 0x12]
    );
}

/// Start, length, control, enable and kind of each SyncManager.
type Rows = &'static [(u16, u16, u8, u8, u8)];

/// Protocols, CoE details, uses of FMMUs, SyncManagers, other categories.
type Row = (Profile, u16, u8, &'static [u8], Rows, &'static [u16]);

#[test]
#[expect(clippy::too_many_lines, reason = "a table and its comparison")]
fn eeproms_match_those_of_the_devices() {
    const MAILBOX: [(u16, u16, u8, u8, u8); 2] =
        [(0x1000, 128, 0x26, 1, 1), (0x1080, 128, 0x22, 1, 2)];
    let table: [Row; 9] = [
        (Profile::Ek1100, 0, 0, &[], &[], &[]),
        (Profile::El1004, 0, 0, &[2], &[(0x1000, 1, 0, 1, 4)], &[43]),
        (
            Profile::El2004,
            0,
            0,
            &[1],
            &[(0x0F00, 0, 0x44, 9, 3)],
            &[43],
        ),
        (
            Profile::El2828,
            0,
            0,
            &[1],
            &[(0x0F00, 1, 0x44, 9, 3)],
            &[3, 43],
        ),
        (
            Profile::El2889,
            0,
            0,
            &[1, 1],
            &[(0x0F00, 1, 0x44, 9, 3), (0x0F01, 1, 0x44, 9, 3)],
            &[43],
        ),
        (
            Profile::El3004,
            0x0C,
            0x07,
            &[2, 3],
            &[
                MAILBOX[0],
                MAILBOX[1],
                (0x1100, 0, 0x04, 0, 3),
                (0x1180, 16, 0x20, 1, 4),
            ],
            &[43],
        ),
        (
            Profile::Ek1914,
            0x0C,
            0x03,
            &[1, 2, 3],
            &[
                (0x1000, 256, 0x26, 1, 1),
                (0x1100, 256, 0x22, 1, 2),
                (0x1200, 8, 0x24, 1, 3),
                (0x1900, 8, 0x20, 1, 4),
            ],
            &[],
        ),
        (
            Profile::Lan9252,
            0x04,
            0x23,
            &[1, 2, 3],
            &[
                MAILBOX[0],
                MAILBOX[1],
                (0x1100, 2, 0x64, 1, 3),
                (0x1400, 6, 0x20, 1, 4),
            ],
            &[],
        ),
        (
            Profile::Akd,
            0x0E,
            0x0D,
            &[1, 2, 3],
            &[
                (0x1800, 1024, 0x26, 1, 1),
                (0x1C00, 1024, 0x22, 1, 2),
                (0x1100, 0, 0x24, 1, 3),
                (0x1140, 0, 0x20, 1, 4),
            ],
            &[2048, 2049],
        ),
    ];
    for (profile, protocols, coe, fmmus, rows, others) in table {
        let image = profile.slave(1).unwrap().slave.eeprom().to_vec();
        let sii = Sii::new(&image);
        assert!(sii.is_checked(), "{profile}");
        let found: Vec<_> = sii
            .sync_managers()
            .map(|sm| (sm.start, sm.len, sm.control, sm.enable, sm.kind))
            .collect();
        assert_eq!(found, rows, "{profile}");
        assert_eq!(sii.protocols(), Some(protocols), "{profile}");
        assert_eq!(sii.general().unwrap().coe, coe, "{profile}");
        // An odd number of them has a zero behind.
        assert_eq!(sii.fmmus()[..fmmus.len()], *fmmus, "{profile}");
        let found: Vec<u16> = sii
            .categories()
            .filter_map(|(kind, _)| match kind {
                Category::Other(number) => Some(number),
                Category::Strings
                | Category::General
                | Category::Fmmu
                | Category::SyncManager
                | Category::TxPdo
                | Category::RxPdo
                | Category::Dc => None,
            })
            .collect();
        assert_eq!(found, others, "{profile}");
        let areas = sii.mailbox(word::MAILBOX).unwrap();
        let expected = match rows {
            [out, back, ..] if protocols > 0 => MailboxAreas {
                receive: out.0,
                receive_len: out.1,
                send: back.0,
                send_len: back.1,
            },
            _ => MailboxAreas::default(),
        };
        assert_eq!(areas, expected, "{profile}");
    }
    let image = Profile::Ek1100.slave(1).unwrap().slave.eeprom().to_vec();
    assert_eq!(Sii::new(&image).word(0), Some(0x0D00));
    let image = Profile::Akd.slave(1).unwrap().slave.eeprom().to_vec();
    assert_ne!(Sii::new(&image).identity().unwrap().serial, 0);
}

#[test]
fn outputs_in_registers_count_once_a_slave() {
    let (mut bench, handles) = line(&[Profile::El2828, Profile::El2889]);
    for (station, number, start, logical) in [
        (0x1000, 0, 0x0F00, 0),
        (0x1001, 0, 0x0F00, 1),
        (0x1001, 1, 0x0F01, 2),
    ] {
        bench.channel(station, number, start, 1, 0x44);
        let fmmu = Fmmu {
            logical,
            len: 1,
            stop_bit: 7,
            physical: start,
            writes: true,
            active: true,
            ..Fmmu::default()
        };
        bench.fmmu(station, number, &fmmu);
        bench.write(station, register::AL_CONTROL, &[8, 0]);
    }
    assert_eq!(bench.logical(Command::Lrw, 0, &[0x11]).counter, 2, "EL2828");
    assert_eq!(
        bench.logical(Command::Lrw, 1, &[0x22, 0x33]).counter,
        2,
        "EL2889"
    );
    let both = bench.logical(Command::Lrw, 0, &[0x11, 0x22, 0x33]);
    assert_eq!(both.counter, 4, "both");
    bench.segment.poll(bench.now + MS);
    let outputs = |n: usize| handles[n].0.as_ref().unwrap().outputs();
    assert_eq!((outputs(0), outputs(1)), (vec![0x11], vec![0x22, 0x33]));
}

/// In PRE-OP, with both mailboxes.
fn in_pre_op(profile: Profile, mailbox: MailboxAreas) -> Bench {
    let (mut bench, _) = line(&[profile]);
    bench.channel(0x1000, 0, mailbox.receive, mailbox.receive_len, 0x26);
    bench.channel(0x1000, 1, mailbox.send, mailbox.send_len, 0x22);
    bench.write(0x1000, register::AL_CONTROL, &[2, 0]);
    bench.now += 30 * MS;
    assert_eq!(bench.al(0x1000), (AlState::PreOp, false, 0));
    bench
}

/// Advances by milliseconds, in which firmware polls.
fn pass(bench: &mut Bench, ms: u64) {
    for _ in 0..10 * ms {
        bench.now += MS / 10;
        bench.segment.poll(bench.now);
    }
}

const EL3004: MailboxAreas = MailboxAreas {
    receive: 0x1000,
    receive_len: 128,
    send: 0x1080,
    send_len: 128,
};

/// A mailbox message, padded with zeros.
fn message(len: usize, kind: u8, counter: u8, inside: &[u8]) -> Vec<u8> {
    let mut bytes = vec![
        u8::try_from(inside.len()).unwrap(),
        0,
        0,
        0,
        0,
        counter << 4 | kind,
    ];
    bytes.extend_from_slice(inside);
    bytes.resize(len, 0);
    bytes
}

fn upload(index: u16) -> Vec<u8> {
    let [low, high] = index.to_le_bytes();
    vec![0, 0x20, 0x40, low, high, 0, 0, 0, 0, 0]
}

#[test]
fn mailboxes_answer_late_with_stale_bytes_behind() {
    let mut bench = in_pre_op(Profile::El3004, EL3004);
    assert_eq!(
        bench
            .device(Command::Fprd, 0x1000, 0x1080, &[0; 128])
            .counter,
        0,
        "empty"
    );
    assert_eq!(bench.read::<1>(0x1000, 0x080D)[0] & 0x08, 0);
    // From the front without the last byte, then the last byte alone.
    let request = message(128, 3, 1, &upload(0x1008));
    bench.write(0x1000, 0x1000, &request[..68]);
    assert_eq!(bench.read::<1>(0x1000, 0x0805)[0] & 0x08, 0, "not full yet");
    bench.write(0x1000, 0x107F, &request[127..]);
    let begin = bench.now;
    while bench.read::<1>(0x1000, 0x080D)[0] & 0x08 == 0 {
        bench.now += MS / 10;
    }
    let after = bench.now - begin;
    assert!((600_000..8_000_000).contains(&after), "{after} ns");
    assert_eq!(bench.read::<1>(0x1000, 0x080D), [0x09], "full");
    let head: [u8; 22] = bench.read(0x1000, 0x1080);
    assert_eq!(head[16..], *b"EL3004");
    bench.read::<1>(0x1000, 0x10FF);
    assert_eq!(
        bench.read::<1>(0x1000, 0x080D)[0] & 0x08,
        0,
        "turned over by the last byte"
    );
    // The end of a longer previous answer follows a shorter one.
    bench.write(0x1000, 0x1000, &message(128, 3, 2, &upload(0x1000)));
    pass(&mut bench, 10);
    let answer: [u8; 128] = bench.read(0x1000, 0x1080);
    assert_eq!(answer[..2], [10, 0]);
    assert_eq!(answer[16..22], *b"EL3004");
}

#[test]
fn eoe_frames_are_sent_once_addressed() {
    let akd = MailboxAreas {
        receive: 0x1800,
        receive_len: 1024,
        send: 0x1C00,
        send_len: 1024,
    };
    let mut bench = in_pre_op(Profile::Akd, akd);
    pass(&mut bench, 200);
    assert_eq!(
        bench
            .device(Command::Fprd, 0x1000, 0x1C00, &[0; 1024])
            .counter,
        0
    );
    bench.write(
        0x1000,
        0x1800,
        &message(1024, 2, 1, &[2, 1, 0, 0, 0, 0, 0, 0]),
    );
    pass(&mut bench, 5);
    let kind = |bench: &mut Bench| {
        let bytes: [u8; 1024] = bench.read(0x1000, 0x1C00);
        (bytes[5] & 0x0F, bytes[5] >> 4)
    };
    assert_eq!(kind(&mut bench), (2, 1), "the address is set");
    pass(&mut bench, 60);
    assert_eq!(kind(&mut bench), (2, 2), "a frame");
    bench.write(0x1000, 0x1800, &message(1024, 3, 2, &upload(0x1000)));
    pass(&mut bench, 5);
    // A queued frame comes first.
    assert_eq!(kind(&mut bench), (2, 3));
    pass(&mut bench, 1);
    assert_eq!(
        kind(&mut bench),
        (3, 2),
        "the answer has the counter of its request"
    );
}

#[test]
fn states_take_the_times_of_their_devices() {
    // PRE-OP from and to, us.
    for (profile, least, most) in [
        (Profile::Ek1100, 0, 100),
        (Profile::El1004, 0, 100),
        (Profile::El3004, 300, 800),
        (Profile::Ek1914, 1_500, 5_900),
        (Profile::Akd, 5_000, 19_100),
        (Profile::Lan9252, 12_000, 18_600),
    ] {
        let (mut bench, _) = line(&[profile]);
        // Its mailboxes are not set up: what counts is the time of the refusal.
        bench.write(0x1000, register::AL_CONTROL, &[2, 0]);
        let begin = bench.now - 10_000;
        while word_at(&mut bench, register::AL_STATUS) == 1 {
            bench.now += 10_000;
        }
        let took = (bench.now - begin) / 1000;
        assert!((least..=most).contains(&took), "{profile}: {took} us");
    }
}

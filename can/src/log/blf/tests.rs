//! BLF files of python-can, objects that python-can does not write, and damaged files.

use proptest::prelude::*;

use super::*;

const FILE: &[u8] = include_bytes!("../../../tests/captures/python_can.blf");

fn printed(log: &Log) -> Vec<String> {
    log.records.iter().map(ToString::to_string).collect()
}

/// BLF keeps channel numbers from 1 instead of interface names. python-can truncates its floating-point times to
/// nanoseconds.
#[test]
fn blf_file_of_python_can_is_read() {
    let log = Log::read(FILE);
    let long: String = (0..64).map(|byte| format!("{byte:02X}")).collect();
    assert_eq!(log.left_out, []);
    assert_eq!(
        printed(&log),
        [
            "(1700000000.000124) 1 123#DEADBEEF R".to_owned(),
            "(1700000000.000999) 1 7FF# T".to_owned(),
            "(1700000000.002500) 2 18FEF100#0001020304050607 R".to_owned(),
            "(1700000000.003000) 1 705#R1 R".to_owned(),
            format!("(1700000000.003999) 1 321##1{long} R"),
            "(1700000000.005000) 1 20000044#0030000000008205".to_owned(),
            "(1700000000.006000) 1 1FFFFFFF##2000102030405060708090A0B T".to_owned(),
        ]
    );
}

/// A file with these objects, uncompressed.
fn file(objects: &[u8]) -> Vec<u8> {
    let mut file = b"LOGG".to_vec();
    file.extend(144_u32.to_le_bytes());
    file.resize(144, 0);
    file.extend(objects);
    file
}

/// An object with a header of version 1 and a time stamp of 7 units.
fn object(kind: u32, unit: u32, content: &[u8]) -> Vec<u8> {
    let mut object = b"LOBJ".to_vec();
    object.extend(32_u16.to_le_bytes());
    object.extend(1_u16.to_le_bytes());
    object.extend(u32::try_from(32 + content.len()).unwrap().to_le_bytes());
    object.extend(kind.to_le_bytes());
    object.extend(unit.to_le_bytes());
    object.extend([0; 4]);
    object.extend(7_u64.to_le_bytes());
    object.extend(content);
    object
}

fn container(content: &[u8]) -> Vec<u8> {
    let mut object = b"LOBJ".to_vec();
    object.extend(16_u16.to_le_bytes());
    object.extend(1_u16.to_le_bytes());
    object.extend(u32::try_from(32 + content.len()).unwrap().to_le_bytes());
    object.extend(10_u32.to_le_bytes());
    object.extend([0; 8]);
    object.extend(u32::try_from(content.len()).unwrap().to_le_bytes());
    object.extend([0; 4]);
    object.extend(content);
    object
}

fn data_message(flags: u8, code: u8) -> Vec<u8> {
    let mut content = vec![2, 0, flags, code, 0x81, 1, 0, 0];
    content.extend([1, 2, 3, 4, 5, 6, 7, 8]);
    content
}

#[test]
fn blf_time_units_and_length_codes_are_read() {
    let mut objects = object(1, 1, &data_message(1, 2));
    objects.extend(object(86, 2, &data_message(0, 12)));
    objects.extend(object(1, 2, &data_message(0x80, 3)));
    assert_eq!(
        printed(&Log::read(&file(&objects))),
        [
            "(0000000000.000070) 2 181#0102 T",
            "(0000000000.000000) 2 181#0102030405060708_C R",
            "(0000000000.000000) 2 181#R3 R",
        ]
    );
}

#[test]
fn blf_fd_message_64_is_read() {
    let mut content = vec![3, 9, 12, 0];
    content.extend(0x8000_0123_u32.to_le_bytes());
    content.extend([0; 4]);
    content.extend(0x7000_u32.to_le_bytes());
    content.resize(34, 0);
    content.push(1);
    content.resize(40, 0);
    content.extend(0..12);
    let long = object(101, 2, &content);
    content[12..16].copy_from_slice(&[0x10, 0, 0, 0]);
    content[2] = 0;
    content[1] = 5;
    let remote = object(101, 2, &content);
    assert_eq!(
        printed(&Log::read(&file(&[long, remote].concat()))),
        [
            "(0000000000.000000) 3 00000123##3000102030405060708090A0B T",
            "(0000000000.000000) 3 00000123#R5 T",
        ]
    );
}

/// Loggers omit trailing zeros: 64 bytes are declared, 48 are present.
#[test]
fn blf_fd_message_64_truncated_by_logger_is_padded() {
    let mut content = vec![1, 15, 64, 0];
    content.extend(0x123_u32.to_le_bytes());
    content.extend([0; 4]);
    content.extend(0x1000_u32.to_le_bytes());
    content.resize(40, 0);
    content.extend([0xAB; 48]);
    let cut = object(101, 2, &content);
    let expected = format!(
        "(0000000000.000000) 1 123##0{}{} R",
        "AB".repeat(48),
        "00".repeat(16)
    );
    let log = Log::read(&file(&cut));
    assert_eq!((printed(&log), log.left_out_count), (vec![expected], 0));
}

#[test]
fn blf_controller_error_code_maps_to_location_and_kind() {
    let mut content = vec![1, 0, 0, 0, 0, 0, 0, 0, 0x80 | 0x19];
    content.resize(32, 0);
    let log = Log::read(&file(&object(73, 2, &content)));
    let AnyFrame::Error(frame) = log.records[0].frame else {
        panic!("{:?}", log.records)
    };
    assert_eq!(frame.to_string(), "20000088#0000841900000000");
    assert!(frame.is_unacknowledged());
}

#[test]
fn blf_object_split_over_containers_is_read() {
    let object = object(1, 2, &data_message(0, 8));
    for cut in 1..object.len() {
        let (first, second) = object.split_at(cut);
        let log = Log::read(&file(&[container(first), container(second)].concat()));
        assert_eq!((log.records.len(), log.left_out_count), (1, 0), "{cut}");
    }
}

#[test]
fn blf_other_objects_skipped_damaged_ones_reported() {
    let other = object(96, 2, &[0; 20]);
    let good = object(1, 2, &data_message(0, 1));
    let log = Log::read(&file(&[other, good.clone()].concat()));
    assert_eq!((log.records.len(), log.left_out_count), (1, 0));

    let short = object(1, 2, &[0; 5]);
    let log = Log::read(&file(&[short, good.clone()].concat()));
    assert_eq!((log.records.len(), log.left_out_count), (1, 1));
    assert_eq!(log.left_out[0].location, 144);

    let log = Log::read(&file(&good[..good.len() - 1]));
    assert_eq!((log.records.len(), log.left_out_count), (0, 1));

    let log = Log::read(&file(&[b"rubbish, no object".to_vec(), good].concat()));
    assert_eq!((log.records.len(), log.left_out_count), (0, 1));
    assert_eq!(Log::read(b"LOGG").left_out_count, 1);
}

/// The data kept between containers is bounded.
#[test]
fn blf_object_above_size_limit_is_rejected() {
    let good = object(1, 2, &data_message(0, 1));
    let mut endless = object(1, 2, &[0; 64]);
    endless[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut objects = container(&endless);
    objects.extend(container(&[0xAA; 64]));
    objects.extend(container(&good));
    let log = Log::read(&file(&objects));
    assert!(log.left_out[0].why.to_string().contains("1 MiB"));
    assert_eq!(log.records.len(), 1, "{:?}", log.left_out);
    let largest = object(1, 2, &vec![0; OBJECT_MAX - 32]);
    let cut = largest.split_at(700);
    let log = Log::read(&file(&[container(cut.0), container(cut.1)].concat()));
    assert_eq!(log.left_out_count, 0);
}

#[test]
fn blf_container_above_size_limit_is_rejected() {
    let mut bytes = FILE.to_vec();
    bytes[144 + 24..144 + 28].copy_from_slice(&u32::MAX.to_le_bytes());
    let log = Log::read(&bytes);
    assert_eq!((log.records.len(), log.left_out_count), (0, 1));
    assert!(log.left_out[0].why.to_string().contains("64 MiB"));
}

proptest! {
    #[test]
    fn blf_damaged_files_do_not_panic(at in 0..FILE.len(), byte in any::<u8>(), end in 0..=FILE.len()) {
        let mut bytes = FILE.to_vec();
        bytes[at] = byte;
        crate::fuzz::log(&bytes);
        crate::fuzz::log(&FILE[..end]);
    }

    #[test]
    fn blf_damaged_headers_do_not_panic(at in 0..144_usize, bytes in any::<[u8; 8]>()) {
        let mut damaged = FILE.to_vec();
        let target = &mut damaged[at.min(136)..][..8];
        target.copy_from_slice(&bytes);
        crate::fuzz::log(&damaged);
    }

    #[test]
    fn blf_damaged_objects_do_not_panic(
        kind in prop::sample::select(vec![1, 10, 73, 86, 100, 101]),
        content in prop::collection::vec(any::<u8>(), 0..120), at in 0..100_usize, byte in any::<u8>(),
    ) {
        let mut bytes = file(&[object(kind, 2, &content), object(kind, 1, &content)].concat());
        let at = (144 + at).min(bytes.len() - 1);
        bytes[at] = byte;
        let _ = Log::read(&bytes);
    }
}

//! Every format that comes over a bus, from a serial port or out of a file, fed with bytes from a seeded generator: a
//! short run of what `cargo fuzz` does for hours. The targets panic if a property is violated.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::time::Duration;

use takt_can::canopen::NodeId;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::{Frame, Id, fuzz};
use takt_tests::Random;
use takt_tests::fuzz::{feed, feed_files};

/// Inputs for each target.
const INPUTS: u64 = 5_000;

/// A standard frame of eight bytes in the input format of the targets.
fn frame((id, data): (u16, [u8; 8])) -> [u8; 12] {
    let mut bytes = [0, 0, 0, 0x50, 0, 0, 0, 0, 0, 0, 0, 0];
    bytes[..2].copy_from_slice(&id.to_le_bytes());
    bytes[4..].copy_from_slice(&data);
    bytes
}

#[test]
fn canopen_stands_random_input() {
    let frames = [
        (0x585, [0x43, 0, 0x10, 0, 0x92, 1, 2, 0]),
        (0x585, [0x41, 0, 0x10, 0, 20, 0, 0, 0]),
        (0x585, [0xC6, 0, 0x10, 0, 20, 0, 0, 0]),
        (0x585, [0x60, 0, 0x10, 0, 0, 0, 0, 0]),
        (0x585, [0xA4, 0, 0x10, 0, 7, 0, 0, 0]),
        (0x585, [0xA2, 3, 7, 0, 0, 0, 0, 0]),
        (0x585, [0x01, 1, 2, 3, 4, 5, 6, 7]),
        (0x585, [0x81, 1, 2, 3, 4, 5, 6, 7]),
        (0x605, [0x80, 0, 0x10, 0, 0, 0, 4, 5]),
        (0x085, [0x10, 0x81, 0x11, 0, 0, 0, 0, 0]),
        (0x7E4, [0x4F, 0, 0, 0, 0, 0, 0, 0]),
        (0x7E5, [0x51, 0, 0, 0, 0, 0x80, 0, 0]),
    ]
    .map(frame);
    let words: Vec<&[u8]> = frames.iter().map(<[u8; 12]>::as_slice).collect();
    feed("canopen", fuzz::canopen, &words, INPUTS);
}

#[test]
fn eds_stands_random_input() {
    let words = "[DeviceInfo]\n [DeviceComissioning]\nNodeID=5\n [1000]\n [1018]\n [1018sub0]\n [1018sub1]\n [1A00sub1]\n \
                 [2000]\n [2000Name]\n [2000Value]\n 1=x\n CompactSubObj=9\n ParameterName=x\n ObjectType=0x7\n \
                 ObjectType=8\n DataType=0x0005\n DataType=7\n DataType=0x9\n DataType=0x000F\n AccessType=rw\n \
                 AccessType=const\n DefaultValue=0x12\n DefaultValue=$NODEID+0x180\n ParameterValue=-1\n LowLimit=5\n \
                 HighLimit=0xFFFFFFFF\n PDOMapping=1\n SubNumber=3\n ;x\n = ] [ \" 0x";
    let words: Vec<&[u8]> = words.split(' ').map(str::as_bytes).collect();
    feed("eds", fuzz::eds, &words, INPUTS);
}

#[test]
fn logs_stand_random_input() {
    let lines = "(1.000000) can0 123#DEADBEEF\n|(1.0) 1 18FEF100##1AA T\n|(9.9) can0 20000080#0000000000000000\n|123#R8\n|\
                   can0  TX - -  705   [8]  |00 01 02 03 04 05 06 07 |remote request\n|;$FILEVERSION=2.1\n|;$COLUMNS=N,O,T,B,I,d,R,l,D\n|\
                 1 1.000 FB 1 0300 Rx - 9 |1) 1.0 Rx 0300 8 |date Mon Jan 1 00:00:00 2024\n|base hex timestamps absolute\n|   0.100000 1  123x Rx d 8 1 2 3\n|\
                 0.2 CANFD 1 Rx 123 1 0 d 32 1\n|0.1 1 ErrorFrame\n|#|_E\n|LOBJ\u{10}\0\u{1}\0\u{20}\0\0\0|LOGG\u{90}\0\0\0";
    let words: Vec<&[u8]> = lines.split('|').map(str::as_bytes).collect();
    feed("can_log", fuzz::log, &words, INPUTS);
}

fn capture(name: &str) -> Vec<u8> {
    let path = format!("{}/tests/captures/{name}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read(path).unwrap()
}

/// Whole files of every kind, damaged.
#[test]
fn log_files_stand_damage() {
    let names = [
        "python_can.log",
        "python_can.asc",
        "python_can.blf",
        "python_can.trc",
        "made.txt",
        "made.pcap",
        "made.pcapng",
    ];
    let files = names.map(capture);
    for (name, file) in names.iter().zip(&files) {
        let log = takt_can::log::Log::read(file);
        assert!(!log.records.is_empty() && log.left_out_count == 0, "{name}");
    }
    let files: Vec<&[u8]> = files.iter().map(Vec::as_slice).collect();
    feed_files("can_log_files", fuzz::log, &files, INPUTS);
}

#[test]
fn rmp_stands_random_input() {
    let frames = [
        (0x400, [0, 1, 0, 0, 0, 0, 0, 2]),
        (0x401, [0, 1, 0, 0, 0, 0, 0, 2]),
        (0x402, [0x7F, 0xFF, 0x80, 0, 0, 0, 0, 2]),
        (0x403, [0x7F, 0xFF, 0xFF, 0xFF, 0x80, 0, 0, 0]),
        (0x404, [0, 1, 0, 0, 0, 0, 0, 2]),
        (0x406, [0, 2, 0, 0, 0, 0, 0, 2]),
        (0x407, [0, 1, 0, 0, 0, 0, 0, 2]),
        (0x680, [0, 0x80, 0, 0, 0, 0, 0, 2]),
    ]
    .map(frame);
    let mut words: Vec<&[u8]> = frames.iter().map(<[u8; 12]>::as_slice).collect();
    words.push(&[
        0xF0, 0x55, 0xAA, 0, 4, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 0x11,
    ]);
    feed("rmp", fuzz::rmp, &words, INPUTS);
}

/// A whole emulated drive with random frames: node, SDO server, PDOs, LSS, its motor.
#[test]
fn a_drive_stands_random_frames() {
    let mut random = Random::new(3);
    let id = NodeId::new(5).unwrap();
    let ids = [
        0x000, 0x080, 0x100, 0x205, 0x305, 0x605, 0x705, 0x7E5, 0x701,
    ];
    for _ in 0..20 {
        let mut drive = DriveNode::power_on(DriveNodeConfig::new(id), Duration::ZERO).unwrap();
        for turn in 0..1_000_u64 {
            let now = Duration::from_micros(turn * 500);
            let frame_id = Id::standard(ids[random.below(ids.len())]).unwrap();
            let mut data = random.next().to_le_bytes();
            // SDO and NMT commands for existing objects.
            if random.next().is_multiple_of(2) {
                let index = [
                    0x1000_u16, 0x1400, 0x1600, 0x1A00, 0x1016, 0x6040, 0x6060, 0x1F80,
                ][random.below(8)];
                data[1..3].copy_from_slice(&index.to_le_bytes());
                (data[0], data[3]) = (
                    [0x40, 0x2F, 0x2B, 0x23, 0x21, 0xC6, 0xA4, 0x60][random.below(8)],
                    data[3] % 4,
                );
            }
            let len = [8, 8, 8, 2, 1, 0][random.below(6)];
            drive.handle_frame(&Frame::new(frame_id, &data[..len]).unwrap(), now);
            while drive.poll_transmit(now).is_some() {}
        }
    }
}

//! Recordings of an emulated segment contain its faults and figures.

use std::time::Duration;

use takt_ethercat::AlState;
use takt_ethercat::config::{Location, MasterConfig, SlaveSpec, SyncSpec};
use takt_ethercat::emulator::{Corrupt, Faults};

use super::{Recording, dc, stat};
use crate::Verdict;
use crate::ecat::finding::{verdict, verdict_of};
use crate::ecat::frames::Capture;
use crate::ecat::tests::{CYCLE, recorded, session, tree, up};

/// Evaluates a recording in memory.
fn read(name: &str, bytes: &[u8]) -> Recording {
    Recording::of(name, &Capture::of(bytes).unwrap()).unwrap()
}

const MS: Duration = Duration::from_millis(1);

fn texts(recording: &Recording) -> (String, String, Verdict) {
    let report = stat(recording);
    let text = verdict("r", &report.findings);
    (report.table, text, verdict_of(&report.findings))
}

#[test]
fn recording_of_good_run_has_no_findings() {
    let mut session = up(tree(), AlState::Op);
    session.run_for(500 * MS).unwrap();
    session.leave().unwrap();
    let read = read("good", &recorded(&mut session));
    let (table, text, good) = texts(&read);
    assert_eq!(
        (good, text.as_str()),
        (Verdict::Good, "r: good\n"),
        "{table}"
    );
    for part in [
        "3 slaves",
        "at a cycle of 1.0 ms",
        "0 lost, 0 late, 0 foreign",
        "     1   1002h   OP",
    ] {
        assert!(table.contains(part), "{part}\n{table}");
    }
    assert!(table.contains(", 0 of "), "{table}");
}

#[test]
fn recording_shows_losses_late_frames_and_bad_cable() {
    let mut session = up(tree(), AlState::Op);
    session.run_for(100 * MS).unwrap();
    let faults = Faults {
        corrupt: Some(Corrupt {
            slave: 2,
            port: 0,
            frames: 4,
        }),
        late: None,
        ..Faults::default()
    };
    session.wire().inject(50 * MS, faults);
    session.run_for(150 * MS).unwrap();
    let late = Faults {
        late: Some((2, 1_500_000)),
        ..Faults::default()
    };
    session.wire().inject(Duration::ZERO, late);
    session.run_for(150 * MS).unwrap();
    let read = read("bad", &recorded(&mut session));
    let (table, text, judged) = texts(&read);
    assert_eq!(judged, Verdict::Failed);
    for part in [
        "FAIL  the cable from slave 0 port 3 to slave 1 port 0: 4 broken frames",
        "FAIL  4 of ",
        "WARN  2 frames returned after the end of their cycle",
    ] {
        assert!(text.contains(part), "{part}\n{text}\n{table}");
    }
    // The recorded file of the command line tests.
    let recorded = include_bytes!("../../../tests/ecat/cable.pcap");
    assert_eq!(texts(&self::read("recorded", recorded)).1, text);
    let object = stat(&read).object;
    assert_eq!(object["frames"]["lost"], 4);
    assert_eq!(object["slaves"][1]["invalid"][0], 4);
}

#[test]
fn recording_blames_misses_on_slave_not_in_op() {
    let mut session = up(tree(), AlState::Op);
    session.run_for(200 * MS).unwrap();
    let segment = &mut session.wire().segment;
    let drive = segment.slave(2).unwrap();
    drive.fall(AlState::SafeOp, takt_ethercat::AlStatusCode(0x001B));
    session.run_for(300 * MS).unwrap();
    let read = read("fell", &recorded(&mut session));
    let (table, text, judged) = texts(&read);
    assert_eq!(judged, Verdict::Failed, "{table}");
    assert!(text.contains("slave 1: SAFE-OP + error at "), "{text}");
    assert!(
        text.contains("slave 1: no answer or not in OP at 204 of 204 missed"),
        "{text}"
    );
    assert!(!text.contains("slave 0"), "{text}");
}

#[test]
fn recording_shows_clocks_and_sync0_phase() {
    let mut session = session(tree(), AlState::Op);
    let specs = (0..3).map(|number| {
        let mut spec = SlaveSpec::new(format!("{number}"), Location::Position(number));
        spec.sync = (number == 1).then(|| SyncSpec::sync0(CYCLE));
        spec
    });
    let config = MasterConfig {
        slaves: specs.collect(),
        cycle: CYCLE,
        ..MasterConfig::default()
    };
    session.restart(config).unwrap();
    session.follow_sync0();
    session.bring_up(Duration::from_secs(10)).unwrap();
    session.run_for(Duration::from_secs(2)).unwrap();
    session.wire().seen.retain(|(at, _)| *at > Duration::ZERO);
    let read = read("clocks", &recorded(&mut session));
    let report = dc(&read, Duration::from_secs(1));
    let text = &report.table;
    assert!(text.contains("the reference runs +0.0 ppm"), "{text}");
    assert!(text.contains("     0   1001h   reference"), "{text}");
    assert!(
        text.contains("slave 1: SYNC0 every 1.0 ms; frames pass "),
        "{text}"
    );
    assert_eq!(verdict_of(&report.findings), Verdict::Good);
    // The clock has settled at the end.
    let last = report.object["slaves"][1]["last_ns"].as_i64().unwrap();
    assert!(last.abs() < 100, "{text}");
    let narrow = dc(&read, Duration::ZERO);
    assert!(narrow.findings.is_empty() || verdict_of(&narrow.findings) == Verdict::Failed);
}

/// The recording as `tcpdump -s` makes it: at most `len` bytes of each frame.
fn snapped(bytes: &[u8], len: usize) -> Vec<u8> {
    let (head, mut rest) = bytes.split_at(24);
    let mut out = head.to_vec();
    while let Some((record, behind)) = rest.split_first_chunk::<16>() {
        let full = u32::from_le_bytes([record[8], record[9], record[10], record[11]]);
        let kept = full.min(u32::try_from(len).unwrap());
        out.extend_from_slice(&record[..8]);
        out.extend_from_slice(&kept.to_le_bytes());
        out.extend_from_slice(&record[12..]);
        let (frame, next) = behind.split_at(full as usize);
        out.extend_from_slice(&frame[..kept as usize]);
        rest = next;
    }
    out
}

#[test]
fn recording_with_snap_length_is_cut_not_broken() {
    let mut session = up(tree(), AlState::Op);
    session.run_for(300 * MS).unwrap();
    session.leave().unwrap();
    let whole = recorded(&mut session);
    for len in [15, 24, 47, 60, 90, 120] {
        let capture = Capture::of(&snapped(&whole, len)[..]).unwrap();
        assert!(capture.truncated > 0, "{len}");
        let notes = capture.notes().join("\n");
        assert!(notes.contains("frames are recorded in part"), "{notes}");
        if len < 30 {
            let error = Recording::of("snapped", &capture).unwrap_err().to_string();
            assert!(
                error.contains("none up to the end of its first datagram"),
                "{error}"
            );
            continue;
        }
        let read = Recording::of("snapped", &capture).unwrap();
        assert_eq!(
            (read.broken, read.frames.lost, read.frames.foreign),
            (0, 0, 0),
            "{len}"
        );
    }
}

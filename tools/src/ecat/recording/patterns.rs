//! Recordings built frame by frame with the patterns of real masters and slaves, and the verdict that an expert would
//! give. No frame is copied from a real recording.

use std::time::Duration;

use takt_link::capture::{LinkType, Writer};

use super::{Recording, dc, stat};
use crate::Verdict;
use crate::ecat::directions::directions;
use crate::ecat::dump;
use crate::ecat::finding::{verdict, verdict_of};
use crate::ecat::frames::Capture;

const US: Duration = Duration::from_micros(1);
const MS: Duration = Duration::from_millis(1);

/// An outgoing datagram.
#[derive(Clone, Debug)]
struct Request {
    command: u8,
    index: u8,
    address: u32,
    data: Vec<u8>,
}

const APWR: u8 = 2;
const FPRD: u8 = 4;
const FPWR: u8 = 5;
const BRD: u8 = 7;
const BWR: u8 = 8;
const LRW: u8 = 12;
const ARMW: u8 = 13;
const FRMW: u8 = 14;

fn datagram(command: u8, index: u8, [adp, ado]: [u16; 2], data: &[u8]) -> Request {
    Request {
        command,
        index,
        address: u32::from(adp) | u32::from(ado) << 16,
        data: data.to_vec(),
    }
}

/// The recorded interface of a master.
struct Wire {
    writer: Writer<Vec<u8>>,
    now: Duration,
    source: [u8; 6],
    /// Number of slaves, each of which increments positions.
    slaves: u16,
}

impl Wire {
    fn new(slaves: u16) -> Self {
        Self {
            writer: Writer::new(Vec::new(), LinkType::ETHERNET).unwrap(),
            now: Duration::from_secs(1_700_000_000),
            source: [0x00, 1, 5, 0x10, 0x20, 0x30],
            slaves,
        }
    }

    fn wait(&mut self, time: Duration) -> &mut Self {
        self.now += time;
        self
    }

    fn record(&mut self, source: [u8; 6], request: &Request, counter: u16, is_long: bool) {
        let mut frame = [[1, 1, 5, 1, 0, 0], source].concat();
        frame.extend([0x88, 0xA4]);
        let len = u16::try_from(request.data.len()).unwrap();
        // A length that was rounded up announces a byte that is not there.
        let total = len + 12 + u16::from(is_long);
        frame.extend((0x1000 | total).to_le_bytes());
        frame.extend([request.command, request.index]);
        frame.extend(request.address.to_le_bytes());
        frame.extend(len.to_le_bytes());
        frame.extend([0, 0]);
        frame.extend(&request.data);
        frame.extend(counter.to_le_bytes());
        frame.resize(frame.len().max(60), 0);
        self.writer.write(self.now, &frame).unwrap();
    }

    fn send(&mut self, request: &Request) -> &mut Self {
        self.record(self.source, request, 0, false);
        self
    }

    /// The answer of the slaves: marked, with its counter, and with other data if given.
    fn answer(&mut self, request: &Request, counter: u16, data: &[u8]) -> &mut Self {
        let mut source = self.source;
        source[0] |= 2;
        self.answer_to(source, request, counter, data)
    }

    fn answer_to(
        &mut self,
        source: [u8; 6],
        request: &Request,
        counter: u16,
        data: &[u8],
    ) -> &mut Self {
        let mut back = request.clone();
        if matches!(request.command, 1..=3 | 7..=9 | ARMW) {
            let adp = u16::try_from(request.address & 0xFFFF).unwrap();
            let adp = adp.wrapping_add(self.slaves);
            back.address = request.address & 0xFFFF_0000 | u32::from(adp);
        }
        if !data.is_empty() {
            back.data = data.to_vec();
        }
        self.record(source, &back, counter, false);
        self
    }

    /// A request and its answer after 200 us.
    fn exchange(&mut self, request: &Request, counter: u16, data: &[u8]) -> &mut Self {
        self.send(request).wait(200 * US);
        self.answer(request, counter, data)
    }

    /// Assigns station addresses from 1001h after the slaves were counted.
    fn addressed(slaves: u16) -> Self {
        let mut wire = Self::new(slaves);
        wire.exchange(&datagram(BRD, 1, [0, 0], &[0]), slaves, &[0x11]);
        for number in 0..slaves {
            let station = (0x1001 + number).to_le_bytes();
            let request = datagram(APWR, 2, [0_u16.wrapping_sub(number), 0x0010], &station);
            wire.wait(300 * US).exchange(&request, 1, &[]);
        }
        wire
    }

    fn finish(self) -> Capture {
        Capture::of(self.writer.into_inner().as_slice()).unwrap()
    }
}

/// The verdict of `stat` and its table.
fn judge(wire: Wire) -> (Verdict, String, String) {
    let read = Recording::of("r", &wire.finish()).unwrap();
    let report = stat(&read);
    let text = verdict("r", &report.findings);
    (verdict_of(&report.findings), text, report.table)
}

fn contains(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part}\n{text}");
    }
}

#[test]
fn mirrored_acknowledgement_is_healthy() {
    // A coupler and terminals show AL control, bit 4 included, for good; masters read the code with the state or by itself.
    for (len, with_code) in [(6, true), (2, true), (2, false)] {
        let mut wire = Wire::addressed(3);
        for state in [0x11_u8, 0x12] {
            for station in 0x1001..=0x1003 {
                let control = datagram(FPWR, 3, [station, 0x0120], &[state, 0]);
                wire.wait(MS).exchange(&control, 1, &[]);
                let status = datagram(FPRD, 4, [station, 0x0130], &vec![0; len]);
                let shown: Vec<u8> = [&[state, 0][..], &[0; 4]].concat();
                wire.wait(MS).exchange(&status, 1, &shown[..len]);
                if with_code && len == 2 {
                    let code = datagram(FPRD, 5, [station, 0x0134], &[0, 0]);
                    wire.wait(MS).exchange(&code, 1, &[0, 0]);
                }
            }
        }
        let (judged, text, table) = judge(wire);
        assert_eq!(
            (judged, text.as_str()),
            (Verdict::Good, "r: good\n"),
            "{table}"
        );
        contains(&table, &["r: 3 slaves", "1002h   PRE-OP "]);
    }
}

#[test]
fn refused_state_is_a_failure_with_its_code() {
    // A drive refuses SAFE-OP: 001Dh; read with the state, or by itself after it.
    for len in [6, 2] {
        let mut wire = Wire::addressed(1);
        wire.exchange(&datagram(FPWR, 3, [0x1001, 0x0120], &[4, 0]), 1, &[]);
        let shown = &[0x12, 0, 0, 0, 0x1D, 0][..len];
        let status = datagram(FPRD, 4, [0x1001, 0x0130], &vec![0; len]);
        wire.wait(5 * MS).exchange(&status, 1, shown);
        wire.wait(MS)
            .exchange(&datagram(FPRD, 5, [0x1001, 0x0134], &[0, 0]), 1, &[0x1D, 0]);
        wire.wait(MS).exchange(&status, 1, shown);
        let (judged, text, _) = judge(wire);
        assert_eq!(judged, Verdict::Failed);
        contains(
            &text,
            &[
                "FAIL  slave 0: PRE-OP + error at ",
                "001Dh",
                "r: 1 FAIL, 0 WARN",
            ],
        );
    }
}

#[test]
fn segment_without_slaves_fails() {
    let mut wire = Wire::new(0);
    for index in 0..19 {
        wire.send(&datagram(BRD, index, [0, 0x0130], &[0, 0]))
            .wait(2 * MS);
    }
    let (judged, text, table) = judge(wire);
    assert_eq!(judged, Verdict::Failed);
    contains(&text, &["FAIL  no answer to 19 frames in 36.0 ms"]);
    contains(&table, &["r: 0 slaves", "19 sent, "]);
    // A single frame at the end of a recording proves nothing.
    let mut wire = Wire::new(0);
    wire.send(&datagram(BRD, 0, [0, 0x0130], &[0, 0]));
    let (judged, text, _) = judge(wire);
    assert_eq!(judged, Verdict::Good);
    contains(
        &text,
        &["note  the recording ends 0 ns after its first frame"],
    );
}

#[test]
fn repeated_index_is_answered_by_the_last_frame() {
    // A master without an answer sends the frame again with the same index after 2 ms; 3 of 48 are lost.
    let mut wire = Wire::addressed(1);
    for round in 0..45_u8 {
        let request = datagram(FPRD, round % 16, [0x1001, 0x0130], &[0, 0]);
        if matches!(round, 7 | 20 | 33) {
            wire.send(&request).wait(2 * MS);
        }
        wire.send(&request).wait(640 * US);
        wire.answer(&request, 1, &[2, 0]).wait(200 * US);
    }
    let (judged, text, table) = judge(wire);
    assert_eq!(judged, Verdict::Failed);
    contains(&text, &["FAIL  3 of 50 frames lost", "r: 1 FAIL, 0 WARN"]);
    contains(
        &table,
        &["3 lost, 0 late, 0 foreign", "p99 640 us, max 640 us"],
    );
}

#[test]
fn answer_behind_its_repetition_is_not_lost() {
    let mut wire = Wire::addressed(1);
    let request = datagram(FPRD, 9, [0x1001, 0x0130], &[0, 0]);
    wire.send(&request).wait(2 * MS);
    wire.send(&request).wait(100 * US);
    wire.answer(&request, 1, &[2, 0]).wait(100 * US);
    wire.answer(&request, 1, &[2, 0]).wait(50 * MS);
    wire.exchange(&request, 1, &[2, 0]);
    let (judged, text, table) = judge(wire);
    assert_eq!((judged, text.as_str()), (Verdict::Good, "r: good\n"));
    contains(&table, &["0 lost, 0 late, 0 foreign", "max 2.1 ms"]);
}

#[test]
fn clock_frames_in_a_row_are_no_cycle() {
    // 100 FRMW at start, each sent when the one before is back; some take longer than the usual step.
    let mut wire = Wire::addressed(2);
    for round in 0..100_u64 {
        let request = datagram(FRMW, 5, [0x1001, 0x0910], &[0; 8]);
        wire.send(&request)
            .wait(if round % 9 == 0 { 600 * US } else { 290 * US });
        wire.answer(&request, 2, &(round * 295_000).to_le_bytes())
            .wait(5 * US);
    }
    let (judged, text, table) = judge(wire);
    assert_eq!((judged, text.as_str()), (Verdict::Good, "r: good\n"));
    assert!(!table.contains("cycle of"), "{table}");
}

#[test]
fn process_data_gives_cycle_and_late_frames() {
    let mut wire = Wire::addressed(2);
    for round in 0..60_u32 {
        let request = datagram(LRW, 7, [0, 1], &[0; 8]);
        let took = if matches!(round, 30 | 40) {
            2_500 * US
        } else {
            100 * US
        };
        wire.send(&request).wait(took);
        wire.answer(&request, 3, &[])
            .wait(2 * MS - took.min(2 * MS));
        // A slow mailbox frame is not part of the cycle.
        if round == 20 {
            wire.exchange(&datagram(FPRD, 8, [0x1001, 0x0130], &[0, 0]), 1, &[8, 0]);
        }
    }
    let (judged, text, table) = judge(wire);
    assert_eq!(judged, Verdict::Good, "{text}");
    contains(
        &text,
        &["WARN  2 frames returned after the end of their cycle"],
    );
    contains(
        &table,
        &[
            "at a cycle of 2.0 ms",
            "00010000h, 8 bytes: 3 expected, 0 of 60 missed",
        ],
    );
}

#[test]
fn search_answers_of_another_address_are_no_second_master() {
    let mut wire = Wire::addressed(3);
    let search = datagram(BWR, 0, [0, 0x0101], &[0]);
    for source in [[2, 1, 5, 9, 9, 1], [2, 1, 5, 9, 9, 2], [2, 1, 5, 9, 9, 3]] {
        wire.wait(150 * MS).answer_to(source, &search, 3, &[]);
    }
    wire.wait(MS)
        .exchange(&datagram(BRD, 1, [0, 0x0130], &[0, 0]), 3, &[1, 0]);
    let (judged, text, table) = judge(wire);
    assert_eq!(judged, Verdict::Good, "{text}");
    contains(&text, &["note  3 answers to broadcasts", "r: good\n"]);
    contains(&table, &["0 foreign"]);
    // A sender that reads and writes slaves is another master.
    let mut wire = Wire::addressed(3);
    let other = datagram(FPRD, 0, [0x1001, 0x0130], &[0, 0]);
    wire.wait(150 * MS)
        .answer_to([2, 7, 7, 7, 7, 7], &other, 1, &[8, 0]);
    let (judged, text, _) = judge(wire);
    assert_eq!(judged, Verdict::Failed);
    contains(&text, &["FAIL  1 frames of another sender"]);
}

#[test]
fn recording_of_answers_alone_loses_nothing() {
    let mut wire = Wire::new(10);
    for (ado, counter) in [(0x0000, 10), (0x0130, 10), (0x0110, 10), (0x0FFE, 0)] {
        wire.wait(3 * MS)
            .answer(&datagram(BRD, 1, [0, ado], &[0, 0]), counter, &[1, 0]);
    }
    let (judged, text, table) = judge(wire);
    assert_eq!(judged, Verdict::Good, "{text}");
    contains(&text, &["note  only answers were recorded"]);
    contains(
        &table,
        &["r: 10 slaves", "0 sent, 0 lost, 0 late, 0 foreign"],
    );
}

#[test]
fn single_broadcast_counts_its_slaves() {
    let mut wire = Wire::new(1);
    wire.exchange(&datagram(BRD, 1, [0, 0], &[0]), 1, &[0x11]);
    let (judged, text, table) = judge(wire);
    assert_eq!((judged, text.as_str()), (Verdict::Good, "r: good\n"));
    contains(&table, &["r: 1 slave, 200 us", "1 sent, 0 lost"]);
}

#[test]
fn empty_mailboxes_and_missing_clocks_are_not_silence() {
    let mut wire = Wire::addressed(1);
    for round in 0..40_u16 {
        let lrw = datagram(LRW, 7, [0, 1], &[0; 2]);
        wire.send(&lrw).wait(100 * US);
        wire.answer(&lrw, if round == 20 { 1 } else { 3 }, &[])
            .wait(100 * US);
        for ado in [0x1080, 0x0910, 0x092C] {
            wire.exchange(&datagram(FPRD, 8, [0x1001, ado], &[0; 4]), 0, &[]);
        }
        wire.exchange(&datagram(FPWR, 9, [0x1001, 0x0120], &[4, 0]), 0, &[])
            .wait(MS);
    }
    let (judged, text, _) = judge(wire);
    assert_eq!(judged, Verdict::Failed);
    contains(
        &text,
        &["FAIL  1 cycles with an unexpected working counter"],
    );
    assert!(!text.contains("slave 0: no answer"), "{text}");
}

#[test]
fn answers_at_the_start_belong_to_earlier_frames() {
    let mut wire = Wire::new(1);
    let lrw = datagram(LRW, 7, [0, 1], &[0; 2]);
    wire.answer(&lrw, 3, &[]).wait(MS);
    for _ in 0..5 {
        wire.exchange(&lrw, 3, &[]).wait(MS);
    }
    let (judged, text, table) = judge(wire);
    assert_eq!(judged, Verdict::Good, "{text}");
    contains(&text, &["note  1 answers at the start"]);
    contains(&table, &["0 foreign"]);
}

#[test]
fn doubled_recording_is_judged_once() {
    let mut wire = Wire::addressed(1);
    let begun = Wire::new(1).now;
    for round in 0..30_u8 {
        let request = datagram(LRW, round, [0, 1], &[0; 2]);
        wire.send(&request).wait(US);
        wire.send(&request).wait(100 * US);
        wire.answer(&request, 3, &[]).wait(US);
        wire.answer(&request, 3, &[]).wait(898 * US);
    }
    assert!(wire.now > begun);
    let (judged, text, table) = judge(wire);
    assert_eq!(judged, Verdict::Good, "{text}");
    contains(&text, &["note  each frame was recorded twice"]);
    contains(
        &table,
        &["at a cycle of 1.0 ms", "0 lost, 0 late, 0 foreign"],
    );
}

#[test]
fn probe_line_and_times_are_taken() {
    // Line 0 is at the master, line 1 behind a slave; its copies are left out.
    let mut writer = Writer::new(Vec::new(), LinkType::ETHERNET).unwrap();
    let mut wire = Wire::new(1);
    let lrw = datagram(LRW, 7, [0, 1], &[0; 2]);
    for _ in 0..20 {
        wire.exchange(&lrw, 3, &[]).wait(800 * US);
    }
    let file = wire.writer.into_inner();
    let mut host = Duration::from_secs(9);
    for (number, frame) in (0..).zip(takt_link::capture::Reader::new(file.as_slice()).unwrap()) {
        let frame = frame.unwrap();
        // The recording host is late by up to 900 us, the probe is exact.
        let at = u64::from(frame.at.subsec_nanos());
        host = host
            .max(Duration::from_secs(9) + Duration::from_nanos(at) + 45 * US * (number * 7 % 20));
        for line in [0, 1] {
            let port = 0x80_u8 >> (2 * line + number % 2);
            let mark = [&[1, 1, 5, 0x10, 0, 0, port, 0][..], &at.to_le_bytes()].concat();
            writer
                .write(host, &[frame.data.clone(), mark].concat())
                .unwrap();
        }
    }
    let capture = Capture::of(writer.into_inner().as_slice()).unwrap();
    let read = Recording::of("r", &capture).unwrap();
    let report = stat(&read);
    let text = verdict("r", &report.findings);
    assert_eq!(verdict_of(&report.findings), Verdict::Good, "{text}");
    contains(
        &text,
        &["note  the probe recorded 1 other lines", "r: good\n"],
    );
    contains(
        &report.table,
        &["at a cycle of 1.0 ms", "20 sent, 0 lost", "max 200 us"],
    );
}

#[test]
fn armw_of_32_bits_carries_the_time() {
    // Some masters set clocks by ARMW, by position; here of the second slave, over a wrap of its 32 bits.
    let mut wire = Wire::addressed(2);
    for round in 0..2_000_u64 {
        let request = datagram(ARMW, 5, [0xFFFF, 0x0910], &[0; 4]);
        let time = (4_294_000_000 + round * 1_000_010).to_le_bytes();
        wire.send(&request).wait(100 * US);
        wire.answer(&request, 2, &time[..4]).wait(900 * US);
    }
    let difference = datagram(FPRD, 6, [0x1001, 0x092C], &[0; 4]);
    wire.exchange(&difference, 1, &[253, 0, 0, 0]);
    let read = Recording::of("r", &wire.finish()).unwrap();
    let report = dc(&read, Duration::from_secs(1));
    assert_eq!(
        verdict_of(&report.findings),
        Verdict::Good,
        "{:?}",
        report.findings
    );
    contains(
        &report.table,
        &[
            "2000 frames carry the reference time, 32 bits",
            "the reference runs +10.0 ppm",
            "     1   1002h   reference",
            "     0   1001h   follows",
        ],
    );
}

#[test]
fn cut_recording_is_judged_up_to_the_cut() {
    let mut wire = Wire::addressed(1);
    for _ in 0..20 {
        wire.wait(MS)
            .exchange(&datagram(FPRD, 8, [0x1001, 0x0130], &[0, 0]), 1, &[8, 0]);
    }
    let file = wire.writer.into_inner();
    let capture = Capture::of(&file[..file.len() - 7]).unwrap();
    let report = stat(&Recording::of("r", &capture).unwrap());
    let text = verdict("r", &report.findings);
    assert_eq!(verdict_of(&report.findings), Verdict::Good, "{text}");
    contains(
        &text,
        &["note  the recording is cut off after 43 packets (69 bytes"],
    );
    let early = Capture::of(&file[..40]).unwrap();
    let error = Recording::of("r", &early).unwrap_err().to_string();
    assert!(error.contains("cut off before the first"), "{error}");
}

#[test]
fn dump_names_what_real_masters_send() {
    let mut wire = Wire::addressed(1);
    // Rounded up: 14 bytes announced for a datagram of 13.
    let search = datagram(BWR, 0, [0, 0x0101], &[0]);
    wire.record(wire.source, &search, 0, true);
    let sync_managers = [
        &[0x00, 0x10, 0x80, 0, 0x26, 0, 1, 0][..],
        &[0x80, 0x10, 0x80, 0, 0x22, 0, 1, 0],
    ]
    .concat();
    wire.wait(MS)
        .exchange(&datagram(FPWR, 1, [0x1001, 0x0800], &sync_managers), 1, &[]);
    wire.wait(MS).exchange(
        &datagram(FPRD, 2, [0x1001, 0x0502], &[0; 2]),
        1,
        &[0x40, 0x81],
    );
    wire.wait(MS).exchange(
        &datagram(FPRD, 2, [0x1001, 0x0502], &[0; 2]),
        1,
        &[0x40, 0x20],
    );
    wire.wait(MS).exchange(
        &datagram(FPRD, 3, [0x1001, 0x0140], &[0; 2]),
        1,
        &[0x04, 0x0D],
    );
    // Complete access to 1C12h, in parts: the front, then the last byte.
    let mut request = vec![
        10, 0, 0, 0, 0, 0x13, 0, 0x20, 0x50, 0x12, 0x1C, 0, 0, 0, 0, 0,
    ];
    request.resize(68, 0);
    wire.wait(MS)
        .exchange(&datagram(FPWR, 4, [0x1001, 0x1000], &request), 1, &[]);
    wire.wait(MS)
        .exchange(&datagram(FPWR, 5, [0x1001, 0x107F], &[0]), 1, &[]);
    let answer = [
        10, 0, 0, 0, 0, 0x13, 0, 0x30, 0x53, 0x12, 0x1C, 0, 1, 0, 0, 0x16,
    ];
    wire.wait(MS)
        .exchange(&datagram(FPRD, 6, [0x1001, 0x1080], &[0; 16]), 1, &answer);
    wire.wait(MS)
        .exchange(&datagram(FPRD, 7, [0x1001, 0x10FF], &[0]), 1, &[0xEE]);
    let capture = wire.finish();
    let mut decoder = dump::Decoder::default();
    let mut lines = Vec::new();
    for (taken, way) in capture.frames.iter().zip(directions(&capture.frames)) {
        lines.extend(decoder.lines(taken, way, dump::Filter::default()));
    }
    assert_eq!(decoder.verdict(), Verdict::Good, "{lines:#?}");
    for part in [
        "SII control 8140h: busy, read, 8 bytes a read",
        "SII control 2040h: no acknowledge, 8 bytes a read",
        "PDI control 0D04h: digital I/O; device emulation, DC SYNC unit, DC latch unit",
        "> FPWR    04  1001:1000    68    -  CoE #1 SDO read 1C12h:00 (complete access) (first 68 of 128 bytes)",
        "> FPWR    05  1001:107F     1    -  mailbox (its last byte, 127) 00",
        "< FPRD    06  1001:1080    16    1  CoE #1 SDO 1C12h:00, 4 bytes (complete access): 01 00 00 16 (first 16 of 128 bytes)",
        "< FPRD    07  1001:10FF     1    1  mailbox (its last byte, 127) EE",
    ] {
        assert!(
            lines.iter().any(|line| line.ends_with(part)),
            "{part}\n{lines:#?}"
        );
    }
}

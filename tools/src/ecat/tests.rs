//! The commands on an emulated segment, in virtual time. Tests compare the printed text.

use std::collections::VecDeque;
use std::io;
use std::time::Duration;

use takt_ethercat::AlState;
use takt_ethercat::config::MasterConfig;
use takt_ethercat::emulator::{
    Corrupt, Coupler, Entry, Faults, Io, Segment, ServoConfig, ServoDrive,
};
use takt_ethercat::link::{FRAME_MAX, Link};
use takt_link::capture::{LinkType, Writer};

use super::session::{Session, Wire};
use super::{dc, difference, directions, dump, finding, frames, pdos, recording, scan, sdo, stat};
use crate::Verdict;

mod ring;

/// A cable with a segment at its end; virtual time advances with each wait.
#[derive(Debug)]
pub(super) struct Emulated {
    pub(super) segment: Segment,
    now: Duration,
    returned: VecDeque<(Duration, Vec<u8>)>,
    /// Faults to inject, and when.
    later: Option<(Duration, Faults)>,
    /// All frames in both directions.
    pub(super) seen: Vec<(Duration, Vec<u8>)>,
}

impl Emulated {
    pub(super) fn new(segment: Segment) -> Self {
        Self {
            segment,
            now: Duration::from_secs(1),
            returned: VecDeque::new(),
            later: None,
            seen: Vec::new(),
        }
    }

    /// Injects faults after a time.
    pub(super) fn inject(&mut self, after: Duration, faults: Faults) {
        self.later = Some((self.now + after, faults));
    }

    fn nanos(&self) -> u64 {
        u64::try_from(self.now.as_nanos()).unwrap()
    }
}

impl Link for Emulated {
    fn send(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut frame = bytes.to_vec();
        self.seen.push((self.now, frame.clone()));
        let now = self.nanos();
        if let Some((_, faults)) = self.later.take_if(|(at, _)| *at <= self.now) {
            self.segment.faults = faults;
        }
        if let Some(back) = self.segment.process_ethernet(&mut frame, Entry::First, now) {
            let due = self.now + Duration::from_nanos(back.after);
            self.seen.push((due, frame.clone()));
            self.returned.push_back((due, frame));
        }
        Ok(bytes.len())
    }

    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>> {
        let until = self.now + timeout;
        match self.returned.pop_front() {
            Some((due, frame)) if due <= until => {
                self.now = self.now.max(due);
                let len = frame.len().min(buf.len()).min(FRAME_MAX);
                buf[..len].copy_from_slice(&frame[..len]);
                Ok(Some((len, self.now)))
            }
            later => {
                self.returned.extend(later);
                self.wait_until(until)?;
                Ok(None)
            }
        }
    }
}

impl Wire for Emulated {
    fn now(&mut self) -> io::Result<Duration> {
        Ok(self.now)
    }

    fn wait_until(&mut self, at: Duration) -> io::Result<()> {
        self.now = self.now.max(at);
        self.segment.poll(self.nanos());
        Ok(())
    }
}

pub(super) const CYCLE: Duration = Duration::from_millis(1);

/// A coupler with a terminal at its port 1 and a drive at port 3.
pub(super) fn tree() -> Segment {
    let (terminal, _) = Io::digital(8, 8);
    let (drive, _) = ServoDrive::slave(ServoConfig::default()).unwrap();
    let mut segment = Segment::line([Coupler::slave()]);
    segment.add(terminal, Some((0, 1)));
    segment.add(drive, Some((0, 3)));
    segment
}

pub(super) fn session(segment: Segment, goal: AlState) -> Session<Emulated> {
    let config = MasterConfig {
        goal,
        cycle: CYCLE,
        ..MasterConfig::default()
    };
    Session::new(
        "emulated0",
        Emulated::new(segment),
        [2, 0, 0, 0, 0, 1],
        config,
    )
    .unwrap()
}

/// A session that is brought up.
pub(super) fn up(segment: Segment, goal: AlState) -> Session<Emulated> {
    let mut session = session(segment, goal);
    session.listen().unwrap();
    session.bring_up(Duration::from_secs(10)).unwrap();
    session
}

#[test]
fn scan_prints_tree_names_states_and_ports() {
    let session = up(tree(), AlState::PreOp);
    let text = scan::text(&session);
    let lines: Vec<&str> = text.lines().collect();
    let expected = [
        "emulated0: 3 slaves",
        " pos  slave                           at   state       ports  vendor    product   revision",
        "   0  o TK1100 coupler                -    PRE-OP      01-3   00007A87  00001100  00010000",
        "   1  | o TK4021 servo                0:3  PRE-OP      0---   00007A87  00004021  00010000",
        "   2  o TK0808 digital                0:1  PRE-OP      0---   00007A87  00002808  00010000",
    ];
    assert_eq!(lines, expected);
    assert_eq!(scan::verdict(session.master()), Verdict::Good);
    let object = scan::object(&session);
    assert_eq!(object["good"], true);
    assert_eq!(object["slaves"][1]["parent"]["port"], 3);
    assert_eq!(object["slaves"][2]["name"], "TK0808 digital");
}

#[test]
fn scan_of_silent_segment_fails_with_hint() {
    let mut segment = tree();
    segment.set_power(0, false);
    let mut session = session(segment, AlState::PreOp);
    let error = session.bring_up(Duration::from_secs(10)).unwrap_err();
    let error = format!("{error:#}");
    assert!(
        error.contains("none returned\nhint: check the link"),
        "{error}"
    );
    assert!(error.contains("IN port"), "{error}");
}

#[test]
fn session_with_another_master_sends_nothing() {
    let mut session = session(tree(), AlState::PreOp);
    let mut frame = vec![0xFF; 60];
    frame[12..14].copy_from_slice(&[0x88, 0xA4]);
    session
        .wire()
        .returned
        .push_back((Duration::from_secs(1), frame));
    let error = session.listen().unwrap_err().to_string();
    assert!(error.contains("another master"), "{error}");
    assert!(session.wire().seen.is_empty());
}

#[test]
fn slave_is_found_by_number_or_unique_name() {
    let (terminals, handles): (Vec<_>, Vec<_>) = (0..2).map(|_| Io::digital(8, 8)).unzip();
    let mut slaves = vec![Coupler::slave()];
    slaves.extend(terminals);
    let session = up(Segment::line(slaves), AlState::PreOp);
    assert_eq!(handles.len(), 2);
    assert_eq!(session.find("2").unwrap(), 2);
    assert_eq!(session.find("TK1100").unwrap(), 0);
    for (text, cause) in [
        ("3", "there is no slave 3: emulated0 has 3"),
        ("TK0808", "2 slaves are named"),
        ("EK1100", "no slave is named"),
    ] {
        let error = session.find(text).unwrap_err().to_string();
        assert!(error.contains(cause), "{error}");
    }
}

fn perform(session: &mut Session<Emulated>, action: &sdo::Action) -> Result<String, String> {
    let done = sdo::perform(session, 1, action).map_err(|error| format!("{error:#}"))?;
    done.map_err(|error| error.to_string())
}

fn upload(address: &str, json: bool) -> sdo::Action {
    sdo::Action::Upload {
        address: address.parse().unwrap(),
        data_type: None,
        complete: false,
        json,
    }
}

fn download(address: &str, value: &str) -> sdo::Action {
    sdo::Action::Download {
        address: address.parse().unwrap(),
        value: value.to_owned(),
        data_type: None,
        complete: false,
        confirm_motion: true,
    }
}

#[test]
fn sdo_objects_are_listed_read_and_written() {
    let mut session = up(tree(), AlState::PreOp);
    let text = perform(&mut session, &sdo::Action::List { entries: true }).unwrap();
    for line in [
        "60FFh     VAR    INTEGER32        target velocity",
        "60FDh:00   32 bit UNSIGNED32       rrr---  -T  digital inputs",
        "60C2h:01    8 bit UNSIGNED8        rrrwww  --  interpolation time period value",
    ] {
        assert!(text.lines().any(|other| other == line), "{line}\n{text}");
    }
    let vendor = perform(&mut session, &upload("1018:01", false)).unwrap();
    assert_eq!(vendor, "31367 (00007A87h)");
    let written = perform(&mut session, &download("60F2", "0x12")).unwrap();
    assert_eq!(written, "60F2h:00 <- 18 (0012h)");
    let object = perform(&mut session, &upload("60F2", true)).unwrap();
    let object: serde_json::Value = serde_json::from_str(&object).unwrap();
    assert_eq!(
        (&object["type"], &object["value"]),
        (&"UNSIGNED16".into(), &18.into())
    );
}

#[test]
fn sdo_rejection_reports_cause() {
    let mut session = up(tree(), AlState::PreOp);
    let read_only = perform(&mut session, &download("6502", "1")).unwrap_err();
    assert!(read_only.contains("the slave refuses"), "{read_only}");
    let absent = perform(&mut session, &upload("5FFF", false)).unwrap_err();
    assert!(absent.contains("the slave refuses"), "{absent}");
    let wide = perform(&mut session, &download("60F2", "65536")).unwrap_err();
    assert!(wide.contains("does not fit UNSIGNED16"), "{wide}");
    let no_mailbox = sdo::perform(&mut session, 0, &upload("1018:01", false)).unwrap();
    let no_mailbox = no_mailbox.unwrap_err().to_string();
    assert!(no_mailbox.contains("the slave has no"), "{no_mailbox}");
}

#[test]
fn stat_of_good_segment_has_no_findings() {
    let mut session = up(tree(), AlState::Op);
    let measured = stat::Measured::take(&mut session, Duration::from_millis(500)).unwrap();
    assert_eq!(measured.findings(session.master()), []);
    assert_eq!(finding::verdict("emulated0", &[]), "emulated0: good\n");
    let text = stat::table(&session, &measured);
    for line in [
        "emulated0: 3 slaves, 500 ms at a cycle of 1.0 ms",
        "frames      500 sent, 0 lost, 0 late, 0 foreign",
        "counters    0 cycles with an unexpected working counter",
        "   0  TK1100 coupler        OP              0        0        0          0           0",
    ] {
        assert!(text.lines().any(|other| other == line), "{line}\n{text}");
    }
}

#[test]
fn stat_port_errors_name_the_cable() {
    let mut session = up(tree(), AlState::Op);
    let corrupt = Some(Corrupt {
        slave: 2,
        port: 0,
        frames: 3,
    });
    let faults = Faults {
        corrupt,
        ..Faults::default()
    };
    session.wire().inject(Duration::from_millis(500), faults);
    let measured = stat::Measured::take(&mut session, Duration::from_secs(1)).unwrap();
    let findings = measured.findings(session.master());
    let text = finding::verdict("emulated0", &findings);
    let first = text.lines().next().unwrap();
    assert_eq!(
        first,
        "FAIL  the cable from slave 0 port 3 to slave 1 port 0: 3 broken frames (shield, bend, plug, disturbance)"
    );
    assert!(
        text.contains("3 of 1000 frames lost\n      hint: check the cable above"),
        "{text}"
    );
    let object = stat::object(&session, &measured, &findings);
    assert_eq!(object["frames"]["lost"], 3);
    assert_eq!(object["slaves"][1]["invalid"][0], 3);
    assert_eq!(object["findings"][0]["failure"], true);
}

#[test]
fn stat_late_frames_warn_and_cut_cable_fails() {
    let mut session = up(tree(), AlState::SafeOp);
    session.run_for(Duration::from_millis(200)).unwrap();
    let faults = Faults {
        late: Some((2, 1_500_000)),
        ..Faults::default()
    };
    session.wire().inject(Duration::from_millis(300), faults);
    let measured = stat::Measured::take(&mut session, Duration::from_millis(500)).unwrap();
    let findings = measured.findings(session.master());
    let text = finding::verdict("emulated0", &findings);
    assert!(
        text.starts_with("WARN  2 frames returned after the end"),
        "{text}"
    );
    assert!(text.ends_with("emulated0: good, 1 WARN\n"), "{text}");

    session.wire().segment.set_link(1, false);
    let measured = stat::Measured::take(&mut session, Duration::from_millis(200)).unwrap();
    let text = finding::verdict("emulated0", &measured.findings(session.master()));
    assert!(text.contains("slave 2: lost from the segment"), "{text}");
    assert!(
        text.contains("the cable from slave 0 port 1 to slave 2 port 0"),
        "{text}"
    );
}

#[test]
fn session_leaves_slaves_in_init() {
    let mut session = up(tree(), AlState::SafeOp);
    session.leave().unwrap();
    session.run_for(Duration::from_millis(20)).unwrap();
    let state = |number| session.master().slave(number).unwrap().al().0.state;
    assert_eq!((0..3).map(state).collect::<Vec<_>>(), [AlState::Init; 3]);
}

#[test]
fn pdos_lists_entries_with_positions() {
    let session = up(tree(), AlState::PreOp);
    let text = pdos::text(&session, Some(1));
    let begin = [
        "slave 1 TK4021 servo: 14 bytes out, 16 bytes in",
        "  SyncManager 2 outputs at 1100h, 14 bytes",
        "    PDO 1600h, 112 bits",
        "         0.0  6040h:00   16 bits",
        "         2.0  6060h:00    8 bits",
        "         3.0  gap         8 bits",
        "         4.0  607Ah:00   32 bits",
    ];
    assert_eq!(text.lines().take(7).collect::<Vec<_>>(), begin);
    let text = pdos::text(&session, Some(2));
    assert!(
        text.contains("    PDO 1607h, 1 bits\n         0.7  7070h:01    1 bits\n"),
        "{text}"
    );
    let object = pdos::object(&session, None);
    let pdo = &object["slaves"][2]["channels"][1]["pdos"][3];
    assert_eq!(
        (&pdo["index"], &pdo["entries"][0]["bit"]),
        (&0x1A03.into(), &3.into())
    );
}

#[test]
fn dc_reports_differences_and_drift() {
    let mut session = up(tree(), AlState::SafeOp);
    session.run_for(Duration::from_secs(2)).unwrap();
    let watched = dc::Watched::take(&mut session, Duration::from_millis(500)).unwrap();
    let findings = watched.findings(session.master(), Duration::from_micros(1));
    assert!(findings.is_empty(), "{findings:?}");
    let text = dc::text(&session, &watched, &findings);
    for line in [
        "the reference runs +0.0 ppm against the host's clock",
        "   0  TK1100 coupler        reference         0                  0        0        0",
        "   1  TK4021 servo          64 bit          400                  0        0        0",
        "   2  TK0808 digital        none              0",
        "emulated0: good",
    ] {
        assert!(text.lines().any(|other| other == line), "{line}\n{text}");
    }
    let findings = watched_with(1500).findings(session.master(), Duration::from_micros(1));
    assert!(
        findings[0].starts_with("slave 1: its clock was up to 1500 ns"),
        "{findings:?}"
    );
}

/// Figures of a clock with a difference.
fn watched_with(difference: i32) -> dc::Watched {
    let range = difference::Range {
        least: -3,
        most: difference,
        last: 0,
    };
    dc::Watched {
        duration: Duration::from_secs(1),
        ranges: vec![None, Some(range), None],
        drift_ppm: None,
        phase: takt_ethercat::dc::PhaseFigures::default(),
    }
}

/// The frames on the wire as a recording.
pub(super) fn recorded(session: &mut Session<Emulated>) -> Vec<u8> {
    let mut seen = std::mem::take(&mut session.wire().seen);
    seen.sort_by_key(|(at, _)| *at);
    let mut writer = Writer::new(Vec::new(), LinkType::ETHERNET).unwrap();
    for (at, frame) in seen {
        writer.write(at, &frame).unwrap();
    }
    writer.into_inner()
}

fn decoded(bytes: &[u8], filter: dump::Filter) -> (Vec<String>, Verdict) {
    let capture = frames::Capture::of(bytes).unwrap();
    let mut decoder = dump::Decoder::default();
    let mut lines = Vec::new();
    for (taken, way) in capture
        .frames
        .iter()
        .zip(directions::directions(&capture.frames))
    {
        lines.extend(decoder.lines(taken, way, filter));
    }
    (lines, decoder.verdict())
}

#[test]
fn dump_prints_each_datagram() {
    let mut session = up(tree(), AlState::SafeOp);
    session.wire().seen.clear();
    perform(&mut session, &upload("1018:01", false)).unwrap();
    let bytes = recorded(&mut session);
    let (lines, verdict) = decoded(&bytes, dump::Filter::default());
    assert_eq!(verdict, Verdict::Good);
    let prints = |text: &str| {
        assert!(
            lines.iter().any(|line| line.ends_with(text)),
            "{text}\n{lines:#?}"
        );
    };
    prints("0000:0130     2    -  AL status");
    prints("0003:0130     2    3  AL status SAFE-OP (0004h)");
    prints("1002:1000   128    -  CoE #6 SDO read 1018h:01");
    prints("1002:1000   128    1  mailbox");
    prints("1002:1080   128    1  CoE #6 SDO 1018h:01, 4 bytes: 87 7A 00 00");
    prints("1003:0300    20    1  error counters all zero");
    let filter = dump::Filter {
        returned: true,
        station: Some(0x1002),
    };
    let (lines, _) = decoded(&bytes, filter);
    assert!(
        lines
            .iter()
            .all(|line| line.contains(" < ") && line.contains("1002:")),
        "{lines:#?}"
    );
}

#[test]
fn dump_prints_ethernet_frames_between_sdo_answers() {
    let drive = ServoDrive::slave(ServoConfig::default()).unwrap().0;
    let mut drive = drive.with_ethernet();
    drive.set_ethernet(Some(3_000_000));
    let mut session = up(Segment::line([Coupler::slave(), drive]), AlState::PreOp);
    for _ in 0..5 {
        perform(&mut session, &upload("1018:01", false)).unwrap();
    }
    let (lines, verdict) = decoded(&recorded(&mut session), dump::Filter::default());
    assert_eq!(verdict, Verdict::Good);
    let ethernet = |line: &&String| {
        line.contains(" < FPRD")
            && line.contains("EoE #")
            && line.contains("Ethernet frame ")
            && line.ends_with(", fragment 0, last, 60 bytes")
    };
    assert!(lines.iter().filter(ethernet).count() > 1, "{lines:#?}");
    let answered = |line: &&String| line.contains("SDO 1018h:01, 4 bytes: 87 7A 00 00");
    assert_eq!(lines.iter().filter(answered).count(), 5);
}

#[test]
fn dump_of_damaged_recording_does_not_panic() {
    let mut session = up(tree(), AlState::PreOp);
    let bytes = recorded(&mut session);
    let begin: Vec<u8> = bytes.iter().copied().take(2000).collect();
    let mut broken = 0;
    for at in (24..begin.len()).step_by(7) {
        let mut bytes = begin.clone();
        bytes[at] ^= 0x5A;
        let Ok(capture) = frames::Capture::of(&bytes[..]) else {
            continue;
        };
        let mut decoder = dump::Decoder::default();
        for (taken, way) in capture
            .frames
            .iter()
            .zip(directions::directions(&capture.frames))
        {
            decoder.lines(taken, way, dump::Filter::default());
        }
        if let Ok(read) = recording::Recording::of("flipped", &capture) {
            let _reports = (recording::stat(&read), recording::dc(&read, CYCLE));
        }
        broken += u32::from(decoder.verdict() == Verdict::Failed);
    }
    assert!(broken > 10, "{broken}");
}

#[test]
fn stat_fault_that_is_over_says_when() {
    use takt_ethercat::master::{Event, Fault};
    let at = |ms: u64| Duration::from_millis(10_000 + ms);
    let fault = |slave| Event::Fault {
        slave,
        fault: Fault::Lost,
    };
    let state = AlState::SafeOp;
    let events = [
        (at(250), fault(1)),
        (at(300), fault(2)),
        (at(1500), Event::Reached { slave: 1, state }),
    ];
    let past = stat::past_faults(&events, at(0));
    assert_eq!(past.len(), 1);
    let text = &past[0];
    assert!(
        text.starts_with("slave 1 from 0.250 s to 1.500 s: lost"),
        "{text}"
    );
}

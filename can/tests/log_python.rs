//! Recordings written by python-can, and our logs read by it. Needs a Python (`TAKT_PYTHON`, else `python3`) that has
//! `can`; otherwise the tests are skipped. The unit tests of the readers cover what each format does not keep.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use takt_can::log::{Format, Log, Record};

/// Writes the frames of candump lines into the file named, or prints those of a file as candump lines.
const PEER: &str = r#"
import sys, can
action, path, log = sys.argv[1:4]
if action == "write":
    with can.CanutilsLogReader(log) as frames, can.Logger(path) as logger:
        for frame in frames:
            frame.channel = 0
            logger.on_message_received(frame)
else:
    with can.LogReader(path) as frames, can.Logger(log) as logger:
        for frame in frames:
            logger.on_message_received(frame)
"#;

fn python() -> String {
    std::env::var("TAKT_PYTHON").unwrap_or_else(|_| "python3".to_owned())
}

/// Not in this folder: Python would import it as the module.
fn peer(arguments: &[&str]) -> bool {
    let mut command = Command::new(python());
    let command = command.args(["-c"]).args(arguments).current_dir("/");
    let command = command.stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

fn has_python_can(test: &str) -> bool {
    let has = peer(&["import can; can.Logger"]);
    if !has {
        // It must be present where the tests with a bus run.
        takt_tests::skip(test, "needs python-can, as where vcan is");
    }
    has
}

struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("takt-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn file(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Frames that every format keeps.
const CLASSIC: &[&str] = &[
    "123#DEADBEEF R",
    "605#2B40600006000000 T",
    "18FEF100#0001020304050607 R",
    "000#0105 T",
    "7FF# R",
];

/// Frames that python-can's TRC files do not keep.
const OTHERS: &[&str] = &["705#R R", "321##1000102030405060708090A0B R", "321##0AB R"];

fn lines(frames: &[&[&str]]) -> Vec<String> {
    let frames = (0..).zip(frames.concat());
    frames
        .map(|(turn, frame)| format!("(1700000000.{:06}) can0 {frame}", 1_000 * turn))
        .collect()
}

fn read(path: &str, format: Format) -> Vec<Record> {
    let bytes = std::fs::read(Path::new(path)).unwrap();
    assert_eq!(Format::of(&bytes), format, "{path}");
    let log = Log::read(&bytes);
    assert_eq!(log.left_out, [], "{path}");
    log.records
}

/// Frames, directions and times: some formats round their start time to whole seconds.
fn assert_same(found: &[Record], expected: &[String], path: &str) {
    assert_eq!(found.len(), expected.len(), "{path}");
    for (record, line) in found.iter().zip(expected) {
        let wanted = Record::parse(line).unwrap();
        assert_eq!(
            (record.frame, record.direction),
            (wanted.frame, wanted.direction),
            "{path}: {record}"
        );
        let since = |record: &Record, first: Duration| record.at.abs_diff(first);
        let first = Record::parse(&expected[0]).unwrap().at;
        let (ours, theirs) = (since(record, found[0].at), since(&wanted, first));
        assert!(
            ours.abs_diff(theirs) < Duration::from_micros(2),
            "{path}: {record}"
        );
        assert!(
            record.at.abs_diff(wanted.at) < Duration::from_secs(1),
            "{path}: {record}"
        );
    }
}

#[test]
fn python_can_files_contain_written_frames() {
    if !has_python_can("python_can_files_contain_written_frames") {
        return;
    }
    let folder = Folder::new("log-write");
    for (name, format, kinds) in [
        ("frames.trc", Format::Trc, &[CLASSIC][..]),
        ("frames.asc", Format::Asc, &[CLASSIC, OTHERS]),
        ("frames.blf", Format::Blf, &[CLASSIC, OTHERS]),
        ("frames.log", Format::Candump, &[CLASSIC, OTHERS]),
    ] {
        let (path, log) = (folder.file(name), folder.file("ours.log"));
        let expected = lines(kinds);
        std::fs::write(&log, expected.join("\n") + "\n").unwrap();
        assert!(peer(&[PEER, "write", &path, &log]), "{name} is not written");
        assert_same(&read(&path, format), &expected, name);
    }
}

#[test]
fn python_can_reads_our_logs() {
    if !has_python_can("python_can_reads_our_logs") {
        return;
    }
    let folder = Folder::new("log-read");
    let (path, log) = (folder.file("ours.log"), folder.file("theirs.log"));
    let expected = lines(&[CLASSIC, OTHERS]);
    let printed: Vec<_> = expected
        .iter()
        .map(|line| Record::parse(line).unwrap().to_string())
        .collect();
    std::fs::write(&path, printed.join("\n") + "\n").unwrap();
    assert!(peer(&[PEER, "read", &path, &log]));
    assert_same(&read(&log, Format::Candump), &expected, "theirs.log");
}

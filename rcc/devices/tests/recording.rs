//! Recordings of running controllers and their replay: replay yields the same words, finds a
//! difference, and rejects broken files.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::time::Duration;

use common::{Cell, swing};
use takt_core::controller::NetState;
use takt_core::record::{Recorder, replay};
use takt_tests::{pass, simulate_time};

/// Outputs its cycles, the time of day and its inputs; ends when cancelled.
const TALKATIVE: &str = "{clock=Core::Clock(),
    t=Core::DoubleNetcommOut(inValue=clock.outValue,Key='t'),
    x=Core::IntNetcommIn(Key='x',Value='0'),y=Core::IntAdd(inFirst=x.outValue,Second='1'),
    out=Core::IntNetcommOut(inValue=y.outValue,Key='y'),
    cancel=Cancel(),outTerminate=cancel.outCancel}";

/// A value that occurs nowhere else in a recording.
const MARK: i32 = 0x05EE_D5EE;

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.mcap"))
}

/// Records a controller of these arms while `run` does something with it.
fn record(name: &str, arms: &[&str], run: impl Fn(&Cell)) -> (PathBuf, u64) {
    let path = path(name);
    let cell = Cell::recorded(arms, Some(Recorder::start(&path).unwrap()));
    run(&cell);
    let cycles = cell.controller.finish_recording().unwrap().unwrap();
    (path, cycles)
}

fn value(cell: &Cell, net: takt_core::NetId, key: &str) -> Option<String> {
    let values = cell.controller.out_values(net);
    values
        .into_iter()
        .find(|(k, _)| k == key)
        .map(|(_, text)| text)
}

/// Nets that are written to, cancelled, aborted and started one after the other.
fn talk(cell: &Cell) {
    let [first, second, slow] = [
        cell.load(TALKATIVE),
        cell.load(TALKATIVE),
        cell.load_every(TALKATIVE, Duration::from_millis(3)),
    ];
    // Before it runs, too.
    cell.controller.write_in(second, "inx", "5").unwrap();
    for net in [first, second, slow] {
        cell.controller.start_net(net).unwrap();
    }
    for x in [1, MARK, 2] {
        let (text, seen) = (x.to_string(), (x + 1).to_string());
        cell.controller.write_in(first, "inx", &text).unwrap();
        cell.wait("the value written", |_| {
            value(cell, first, "outy").as_ref() == Some(&seen)
        });
    }
    cell.controller.cancel(first).unwrap();
    assert_eq!(cell.wait_for_end(first).end, None);
    cell.controller.abort(second).unwrap();
    cell.wait_for_end(second);
    let last = cell.load(TALKATIVE);
    cell.controller.start_net(last).unwrap();
    cell.controller.cancel(last).unwrap();
    cell.wait_for_end(last);
}

/// The messages of a file, each with its channel's topic and content.
fn messages(bytes: &[u8]) -> Vec<mcap::Message<'_>> {
    mcap::MessageStream::new(bytes)
        .unwrap()
        .map(Result::unwrap)
        .collect()
}

/// Writes a recording again with changed words in its cycles and correct checksums.
fn rewrite(from: &[u8], to: &Path, mut change: impl FnMut(usize, &mut [u8])) {
    let mut bytes = Vec::new();
    let options = mcap::WriteOptions::new().compression(None);
    let mut writer = options.create(Cursor::new(&mut bytes)).unwrap();
    let mut cycle = 0;
    for mut message in messages(from) {
        if message.channel.topic == "/takt/cycles" {
            change(cycle, message.data.to_mut());
            cycle += 1;
        }
        writer.write(&message).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    std::fs::write(to, bytes).unwrap();
}

fn position(haystack: &[u8], needle: &[u8]) -> Option<usize> {
    haystack
        .windows(needle.len())
        .position(|window| window == needle)
}

#[test]
fn nets_without_devices_replay_identically() {
    let (path, cycles) = record("nets", &[], talk);
    assert!(cycles > 10, "{cycles}");
    let first = replay(&path).unwrap();
    assert_eq!((first.differs, first.cycles), (None, cycles));
    assert!(first.bytes > 64 * cycles);
    assert_eq!(replay(&path).unwrap(), first);
}

#[test]
fn moved_arm_replays_identically() {
    simulate_time(1.0);
    let (path, cycles) = record("arm", &["left"], |cell| {
        let net = cell.load(&swing("left", 0.3));
        cell.controller.start_net(net).unwrap();
        assert_eq!(cell.wait_for_end(net).end, None);
        // Ended by the robot.
        let net = cell.load(&swing("left", 30.0));
        cell.controller.start_net(net).unwrap();
        cell.robots[0].status.set_power(false);
        assert!(cell.wait_for_end(net).end.is_some());
    });
    let outcome = replay(&path).unwrap();
    assert_eq!((outcome.differs, outcome.cycles), (None, cycles));
}

#[test]
fn endless_net_replays_to_end_of_recording() {
    let (path, cycles) = record("endless", &[], |cell| {
        let net = cell.load(TALKATIVE);
        cell.controller.start_net(net).unwrap();
        cell.wait("some cycles", |_| {
            value(cell, net, "outt").is_some_and(|t| t != "0")
        });
        assert_eq!(cell.controller.net(net).unwrap().state(), NetState::Running);
    });
    let outcome = replay(&path).unwrap();
    assert_eq!((outcome.differs, outcome.cycles), (None, cycles));
}

#[test]
fn replay_finds_cycle_of_changed_input() {
    let (path, _) = record("mark", &[], talk);
    let bytes = std::fs::read(path).unwrap();
    let mark = u64::from(MARK.cast_unsigned()).to_le_bytes();
    let changed = self::path("changed");
    let mut marked = None;
    rewrite(&bytes, &changed, |cycle, words| {
        if marked.is_none()
            && let Some(at) = position(words, &mark)
        {
            words[at] ^= 1;
            marked = Some(cycle as u64);
        }
    });
    assert!(marked.is_some(), "the value is written somewhere");
    assert_eq!(replay(&changed).unwrap().differs, marked);
    // Unchanged, a recording written again replays as before.
    rewrite(&bytes, &changed, |_, _| {});
    assert_eq!(replay(&changed).unwrap().differs, None);
}

#[test]
fn replay_detects_any_flipped_bit() {
    let (path, _) = record("flip", &[], talk);
    let bytes = std::fs::read(path).unwrap();
    let (from, to) = (bytes.len() / 10, bytes.len() / 2);
    let flipped = self::path("flipped");
    for i in 0..200 {
        let mut bytes = bytes.clone();
        bytes[from + i * (to - from) / 200] ^= 1 << (i % 8);
        std::fs::write(&flipped, &bytes).unwrap();
        match replay(&flipped) {
            Ok(outcome) => assert!(outcome.differs.is_some(), "flip {i} passed"),
            Err(error) => assert_clear(&error, &flipped),
        }
    }
}

#[test]
fn replay_never_panics_on_random_words() {
    let (path, _) = record("words", &[], talk);
    let bytes = std::fs::read(path).unwrap();
    let whole = messages(&bytes)
        .iter()
        .map(|m| m.data.len())
        .collect::<Vec<_>>();
    let mut random = Random(1);
    let changed = self::path("words-changed");
    for _ in 0..300 {
        let (victim, word) = (random.below(whole.len()), random.below(1 << 20));
        let value = match random.next() % 4 {
            0 => 0,
            1 => u64::MAX,
            2 => i64::MAX.cast_unsigned(),
            _ => random.next(),
        };
        rewrite(&bytes, &changed, |cycle, words| {
            if cycle == victim {
                let at = word % (words.len() / 8) * 8;
                words[at..at + 8].copy_from_slice(&value.to_le_bytes());
            }
        });
        if let Err(error) = replay(&changed) {
            assert_clear(&error, &changed);
        }
    }
}

#[test]
fn cut_recording_replays_up_to_the_cut() {
    let (path, cycles) = record("whole", &[], |cell| {
        talk(cell);
        // Each second ends a chunk.
        pass(Duration::from_millis(2500));
    });
    let bytes = std::fs::read(path).unwrap();
    let cut = self::path("cut");
    let mut last = 0;
    for i in 0..100 {
        std::fs::write(&cut, &bytes[..i * bytes.len() / 100]).unwrap();
        match replay(&cut) {
            Ok(outcome) => {
                assert_eq!((outcome.is_cut, outcome.differs), (true, None), "{i}");
                assert!((last..=cycles).contains(&outcome.cycles), "{i}");
                last = outcome.cycles;
            }
            Err(error) => {
                assert_eq!(last, 0, "{i}: {error}");
                assert_clear(&error, &cut);
            }
        }
    }
    assert!(last * 10 > cycles * 5, "{last} of {cycles}");
}

#[test]
fn random_recordings_are_rejected() {
    let file = path("random");
    let mut random = Random(7);
    for i in 0..100_usize {
        let mut bytes: Vec<_> = (0..40 * i)
            .map(|_| random.next().to_le_bytes()[0])
            .collect();
        if i % 2 == 0 && bytes.len() > 16 {
            // As if it were one.
            let end = bytes.len() - 8;
            bytes[..8].copy_from_slice(b"\x89MCAP0\r\n");
            bytes[end..].copy_from_slice(b"\x89MCAP0\r\n");
        }
        std::fs::write(&file, &bytes).unwrap();
        assert_clear(&replay(&file).unwrap_err(), &file);
    }
    let none = path("no-such-directory/none");
    assert_clear(&replay(&none).unwrap_err(), &none);
}

/// The error text begins with the file name and states a cause.
fn assert_clear(error: &takt_core::Error, path: &Path) {
    let text = error.to_string();
    let rest = text.strip_prefix(&format!("{}: ", path.display()));
    assert!(rest.is_some_and(|rest| rest.len() > 8), "{text}");
}

/// Numbers that look random (xorshift).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, bound: usize) -> usize {
        usize::try_from(self.next() % bound as u64).unwrap()
    }
}

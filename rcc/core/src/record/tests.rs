//! Recordings on disks that are full, and files that are cut off.

use std::io;
use std::sync::Mutex;
use std::time::{SystemTime, UNIX_EPOCH};

use takt_net::Nanos;

use super::file::Writer;
use super::notes::{CYCLES, FORMAT};
use super::read::Recording;
use super::*;

mod parts;

/// A disk with room for so many bytes, and what is on it.
#[derive(Clone, Debug)]
struct Disk {
    room: usize,
    bytes: Arc<Mutex<Vec<u8>>>,
}

impl Disk {
    fn new(room: usize) -> Self {
        let bytes = Arc::default();
        Self { room, bytes }
    }

    fn bytes(&self) -> Vec<u8> {
        self.bytes.lock().unwrap().clone()
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut on_disk = self.bytes.lock().unwrap();
        let len = bytes.len().min(self.room - on_disk.len());
        on_disk.extend(&bytes[..len]);
        if len == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        Ok(len)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

const PATH: &str = "/data/run.mcap";

/// Writes cycles until the disk is full; the error, and how many were given to the file.
fn fill(disk: &Disk) -> (Option<Error>, usize) {
    let mut writer = match Writer::on(disk.clone(), Path::new(PATH)) {
        Ok(writer) => writer,
        Err(error) => return (Some(error), 0),
    };
    for cycle in 0..50 {
        let result = writer.cycle(&[cycle; 40]).and_then(|()| writer.flush());
        if let Err(error) = result {
            // Nothing more gets into the file, whatever is tried.
            let len = disk.bytes().len();
            assert!(writer.cycle(&[0; 40]).is_err() && writer.finish().is_err());
            drop(writer);
            assert_eq!(disk.bytes().len(), len);
            return (Some(error), usize::try_from(cycle).unwrap());
        }
    }
    let error = writer.finish().err();
    (error, 50)
}

#[test]
fn pause_of_writer_leaves_three_quarters_of_buffers() {
    let [shortest, longest] = PAUSE;
    for cycle_us in [62, 125, 250, 500, 1000, 4000, 20_000, 1_000_000] {
        // The recording begins a second before the thread.
        let (mut pause, mut now_us, mut seen) = (shortest, 0_u128, 0);
        let mut came = 0;
        while now_us < 30_000_000 {
            now_us += pause.as_micros();
            let all = usize::try_from(now_us.saturating_sub(1_000_000) / cycle_us).unwrap();
            came = all - std::mem::replace(&mut seen, all);
            assert!(came <= BUFFERS / 4, "{cycle_us} us: {came} in {pause:?}");
            pause = pause_after(pause, came);
        }
        let is_long = came >= BUFFERS / 8 || pause == longest;
        assert!(is_long, "{cycle_us} us: {came} in {pause:?}");
    }
    // A disk that was slow for long.
    assert_eq!(pause_after(longest, BUFFERS), longest / 2);
    assert_eq!(pause_after(shortest, BUFFERS), shortest);
}

#[test]
fn full_disk_leaves_complete_chunks_readable() {
    let whole = Disk::new(usize::MAX);
    assert!(fill(&whole).0.is_none());
    let all = Recording::parse(&whole.bytes(), Path::new(PATH)).unwrap();
    assert_eq!((all.cycles.iter().count(), all.is_cut), (50, false));
    // Times compress to lengths that differ by some bytes: the last ones may suffice for another run.
    for room in (0..whole.bytes().len() - 64).step_by(61) {
        let disk = Disk::new(room);
        let (error, written) = fill(&disk);
        let error = error.unwrap().to_string();
        for part in [
            PATH,
            "the recording ended at cycle ",
            "\nhint: free space on that disk",
        ] {
            assert!(error.contains(part), "{room}: {error}");
        }
        match Recording::parse(&disk.bytes(), Path::new(PATH)) {
            Ok(read) => {
                assert!(read.is_cut, "{room}");
                // The chunk of the write that failed may be complete, without its index.
                let len = read.cycles.iter().count();
                assert!((written..=written + 1).contains(&len), "{room}: {len}");
                assert!(read.cycles.iter().eq(all.cycles.iter().take(len)), "{room}");
            }
            Err(error) => {
                assert_eq!(written, 0, "{room}: {error}");
                assert!(error.to_string().contains(PATH), "{error}");
            }
        }
    }
}

#[test]
fn writer_that_is_dropped_ends_its_file() {
    let disk = Disk::new(usize::MAX);
    let mut writer = Writer::on(disk.clone(), Path::new(PATH)).unwrap();
    writer.cycle(&[0; 40]).unwrap();
    drop(writer);
    let read = Recording::parse(&disk.bytes(), Path::new(PATH)).unwrap();
    assert_eq!((read.cycles.iter().count(), read.is_cut), (1, false));
}

fn moment(cycle: u64) -> Moment {
    Moment {
        cycle,
        time: Nanos(0),
        wall: Nanos(0),
        every: 1,
        cancel: false,
        takeover: false,
        device_failed: false,
        net: 0,
    }
}

#[test]
fn full_disk_is_reported_once_when_it_happens() {
    let disk = Disk::new(100_000);
    let writer = Writer::on(disk.clone(), Path::new(PATH)).unwrap();
    let (mut recorder, mut tap) = Recorder::begin((writer, None), Path::new(PATH)).unwrap();
    let executor = Executor::default();
    let mut event = None;
    // The net thread goes on whatever becomes of the file.
    for cycle in 0..1_000_000 {
        tap.inputs(moment(cycle), &executor);
        tap.outputs(moment(cycle), &executor);
        tap.finish();
        match recorder.poll_event(Instant::now()) {
            Some(RecordingEvent::Failed(what)) => {
                event = Some(what);
                break;
            }
            // The writing thread had no turn.
            Some(RecordingEvent::CyclesLost(_)) => std::thread::sleep(Duration::from_millis(1)),
            None => std::thread::yield_now(),
        }
    }
    let event = event.unwrap();
    assert!(
        event.starts_with("/data/run.mcap: the recording ended at cycle "),
        "{event}"
    );
    for cycle in 0..2_000 {
        tap.inputs(moment(cycle), &executor);
        tap.outputs(moment(cycle), &executor);
        tap.finish();
        assert_eq!(recorder.poll_event(Instant::now()), None);
    }
    assert_eq!(recorder.finish().unwrap_err().to_string(), event);
    let read = Recording::parse(&disk.bytes(), Path::new(PATH)).unwrap();
    assert!(
        read.is_cut && read.cycles.iter().count() > 100,
        "{}",
        read.cycles.iter().count()
    );
}

#[test]
fn lost_cycles_are_reported_once_for_each_onset() {
    let writer = Writer::on(Disk::new(usize::MAX), Path::new(PATH)).unwrap();
    let (mut recorder, _tap) = Recorder::begin((writer, None), Path::new(PATH)).unwrap();
    let begin = Instant::now();
    let lost = Arc::clone(&recorder.lost);
    let mut at = |seconds: u64, more: u64| {
        lost.fetch_add(more, Ordering::Relaxed);
        recorder.poll_event(begin + Duration::from_secs(seconds))
    };
    assert_eq!(at(1, 0), None);
    assert_eq!(at(2, 3), Some(RecordingEvent::CyclesLost(3)));
    assert_eq!(at(3, 1), None);
    assert_eq!(at(11, 1), None);
    assert_eq!(at(21, 4), Some(RecordingEvent::CyclesLost(9)));
}

#[test]
fn recorded_cycles_carry_unix_time_of_their_start() {
    let unix = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    let disk = Disk::new(usize::MAX);
    let before = unix();
    let writer = Writer::on(disk.clone(), Path::new(PATH)).unwrap();
    let (recorder, mut tap) = Recorder::begin((writer, None), Path::new(PATH)).unwrap();
    let executor = Executor::default();
    let start = takt_rt::monotonic().0;
    for cycle in 0..3 {
        let wall = Nanos(start + i64::try_from(cycle).unwrap() * 1_000_000);
        let moment = Moment {
            wall,
            ..moment(cycle)
        };
        tap.inputs(moment, &executor);
        tap.outputs(moment, &executor);
        tap.finish();
    }
    assert_eq!(recorder.finish().unwrap(), 3);
    let bytes = disk.bytes();
    let messages = mcap::MessageStream::new(&bytes).unwrap();
    let cycles = messages.map(Result::unwrap);
    let cycles = cycles.filter(|message| message.channel.topic == CYCLES);
    let times: Vec<u64> = cycles.map(|message| message.log_time).collect();
    assert_eq!(times.len(), 3);
    let range = before.as_nanos()..=unix().as_nanos();
    assert!(range.contains(&times[0].into()), "{times:?}");
    assert_eq!([times[1] - times[0], times[2] - times[1]], [1_000_000; 2]);
}

#[test]
fn recording_beyond_limit_when_unpacked_is_rejected() {
    let disk = Disk::new(usize::MAX);
    let mut writer = Writer::on(disk.clone(), Path::new(PATH)).unwrap();
    // Of changing lengths, so that each is there as a whole.
    for number in 0..100 {
        writer.cycle(&vec![0; 10_000 + number % 2]).unwrap();
    }
    writer.finish().unwrap();
    // 8 MB of zeros in a small file.
    assert!(disk.bytes().len() < 100_000, "{}", disk.bytes().len());
    let path = Path::new(PATH);
    let error = Recording::parse_limited(&disk.bytes(), path, 7_000_000).unwrap_err();
    assert!(
        error.to_string().contains("when unpacked\nhint: "),
        "{error}"
    );
    assert!(Recording::parse_limited(&disk.bytes(), path, 8_010_000).is_ok());
}

#[test]
fn recording_of_other_version_is_rejected_with_both() {
    let other = files();
    let at = |bytes: &[u8]| bytes.windows(7).position(|part| part == b"\x06\0\0\0for");
    // The one without chunks has no checksums; each of its channels names the format.
    let mut bytes = other[1].clone();
    let mut changed = 0;
    for start in 0..bytes.len() {
        if at(&bytes[start..]) == Some(0) {
            let value = start + 4 + 6 + 4;
            assert_eq!(bytes[value..=value], *FORMAT.as_bytes());
            bytes[value] = b'9';
            changed += 1;
        }
    }
    assert!(changed >= 3);
    let error = Recording::parse(&bytes, Path::new(PATH))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("its format is 9, this version reads 6\nhint: "),
        "{error}"
    );
}

#[test]
fn log_that_disk_cannot_follow_is_bounded_and_counted() {
    let disk = Disk::new(usize::MAX);
    let (notes, waiting) = mpsc::channel();
    let lines = Arc::new(Lines::default());
    let log = RecordedLog {
        notes,
        lines: Arc::clone(&lines),
    };
    for number in 0..LINES_MAX + 3 {
        log.line(tracing::Level::INFO, "test", &number.to_string());
    }
    let mut thread = FileThread {
        writer: Writer::on(disk.clone(), Path::new(PATH)).unwrap(),
        parts: None,
        free: ring(1).0,
        full: ring(1).1,
        notes: waiting,
        lines,
        stop: Arc::default(),
    };
    thread.notes().unwrap();
    log.line(tracing::Level::INFO, "test", "there is room again");
    thread.notes().unwrap();
    thread.writer.finish().unwrap();
    let bytes = disk.bytes();
    let messages = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(Result::unwrap);
    let lines: Vec<_> = messages
        .filter(|message| message.channel.topic == "/rosout")
        .collect();
    assert_eq!(lines.len(), LINES_MAX + 2);
    let has = |line: &mcap::Message<'_>, text: &[u8]| {
        line.data.windows(text.len()).any(|part| part == text)
    };
    assert!(has(
        &lines[LINES_MAX],
        b"3 lines of the log are missing before this one"
    ));
    assert!(has(&lines[LINES_MAX + 1], b"there is room again"));
}

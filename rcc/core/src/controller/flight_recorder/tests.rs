//! Triggers, limits and the directory of the flight recorder.

use super::*;

fn folder(name: &str) -> PathBuf {
    let name = format!("takt-flights-{name}-{}", std::process::id());
    let path = std::env::temp_dir().join(name);
    let _ = std::fs::remove_dir_all(&path);
    path
}

fn recorder(name: &str, mib: u64) -> FlightRecorder {
    let settings = FlightSettings {
        directory: folder(name),
        bytes_max: mib << 20,
        cell: Some("[controller]\n".to_owned()),
    };
    FlightRecorder::new(settings).unwrap()
}

fn nothing(log: FlightLog) -> Sources {
    Sources {
        devices: Vec::new(),
        threads: Vec::new(),
        machines: Vec::new(),
        nets: Vec::new(),
        frames: crate::cell::CellFrames::default(),
        log,
    }
}

#[test]
fn flight_file_holds_log_causes_and_texts() {
    let flights = recorder("texts", 16);
    flights
        .log()
        .line_of(tracing::Level::WARN, "test", "before the fault");
    let Answer::Written(path) = flights.trigger(Trigger::Fault, "left", "left faulted") else {
        panic!("the first file is written");
    };
    let joined = flights.trigger(Trigger::Request, "request", "a person");
    assert_eq!(joined, Answer::Written(path.clone()), "one file for both");
    assert!(!flights.files().iter().any(|file| file.is_complete));
    flights.stop();
    let texts = |_: &Sources| vec![("nets/rpinet3.net".to_owned(), Arc::from("{a=…}"))];
    let mut polls = 0;
    flights.run(|| nothing(flights.log()), texts, || polls += 1);
    assert_eq!(polls, 0);
    let bytes = std::fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let names: Vec<_> = summary
        .attachment_indexes
        .iter()
        .map(|it| it.name.as_str())
        .collect();
    assert_eq!(names, ["cell.toml", "nets/rpinet3.net"]);
    assert_eq!(summary.metadata_indexes.len(), 1);
    let has = |text: &str| {
        bytes
            .windows(text.len())
            .any(|part| part == text.as_bytes())
    };
    assert!(has("left faulted\na person") && has(env!("CARGO_PKG_VERSION")));
    let messages = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(Result::unwrap);
    let topics: Vec<_> = messages.map(|it| it.channel.topic.clone()).collect();
    assert_eq!(topics, ["/rosout"]);
    let files = flights.files();
    assert_eq!((files.len(), files[0].is_complete), (1, true));
    std::fs::remove_dir_all(flights.directory()).unwrap();
}

#[test]
fn device_that_faults_each_second_gets_few_files() {
    let flights = recorder("often", 16);
    let mut written = 0;
    for second in 0..3600 {
        let now = (100_000 + second) * 1_000_000_000;
        match flights.trigger_at(Trigger::Fault, ("left", "fault"), now) {
            Answer::Written(_) => written += 1,
            Answer::Limited(wait) => assert!(wait <= Duration::from_secs(600), "{wait:?}"),
        }
        flights.state().current = None;
    }
    assert_eq!(written, 11, "six at once, and one each ten minutes");
    // Faults do not use up what there is for overruns, and requests are not limited.
    for trigger in [Trigger::Overruns, Trigger::Request, Trigger::Request] {
        let answer = flights.trigger_at(trigger, ("x", "y"), 103_700_000_000_000);
        assert!(matches!(answer, Answer::Written(_)), "{answer:?}");
        flights.state().current = None;
    }
    std::fs::remove_dir_all(flights.directory()).unwrap();
}

#[test]
fn flight_files_beyond_bound_are_deleted_oldest_first() {
    let flights = recorder("bound", 16);
    let directory = flights.directory().to_owned();
    let make = |name: &str, mib: usize| {
        std::fs::write(directory.join(name), vec![0; mib << 20]).unwrap();
    };
    make("flight-1.mcap", 5);
    make("flight-2.mcap", 5);
    make("flight-3.mcap", 5);
    make("another.mcap", 5);
    let deleted = prune(&directory, 12 << 20);
    assert_eq!(deleted, [directory.join("flight-1.mcap")]);
    for number in 0..100 {
        make(&format!("flight-4-{number:03}.mcap"), 0);
    }
    let deleted = prune(&directory, u64::MAX).len();
    assert_eq!((deleted, list(&directory).len()), (39, 63));
    assert!(directory.join("another.mcap").exists());
    std::fs::remove_dir_all(directory).unwrap();
}

#[test]
fn flight_directory_that_cannot_be_written_is_an_error() {
    let settings = FlightSettings {
        directory: "/proc/flights".into(),
        bytes_max: 1 << 20,
        cell: None,
    };
    let error = FlightRecorder::new(settings).unwrap_err().to_string();
    assert!(error.starts_with("/proc/flights: "), "{error}");
}

#[test]
fn overruns_are_burst_if_ten_within_second() {
    let mut bursts = Bursts::default();
    assert_eq!(bursts.poll(5), None, "those from before do not count");
    for reading in 0..100 {
        // Three a second.
        assert_eq!(bursts.poll(5 + reading * 3 / 10), None);
    }
    let mut bursts = Bursts::default();
    assert_eq!(bursts.poll(0), None);
    assert_eq!(bursts.poll(6), None);
    assert_eq!(bursts.poll(11), Some(11));
    assert_eq!(bursts.poll(12), None, "it begins again");
}

/// A disk whose room grows.
#[derive(Clone, Debug, Default)]
struct Disk {
    room: Arc<AtomicU64>,
    bytes: Arc<Mutex<Vec<u8>>>,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let mut on_disk = self.bytes.lock().unwrap();
        let room = usize::try_from(self.room.load(Ordering::Relaxed)).unwrap();
        let len = bytes.len().min(room.saturating_sub(on_disk.len()));
        on_disk.extend(&bytes[..len]);
        if len == 0 && !bytes.is_empty() {
            return Err(std::io::ErrorKind::StorageFull.into());
        }
        Ok(len)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn full_disk_is_reported_once_until_file_fits() {
    let flights = recorder("full", 16);
    let disk = Disk::default();
    let lines = Mutex::new(Vec::new());
    let open = |path: &Path, sources: &Sources, _, _| {
        disk.bytes.lock().unwrap().clear();
        FlightFile::create_on(disk.clone(), path, sources)
    };
    let report = |level, text: &str| lines.lock().unwrap().push((level, text.to_owned()));
    let work = (|| nothing(flights.log()), |_: &Sources| Vec::new());
    std::thread::scope(|scope| {
        scope.spawn(|| flights.run_on(open, work, || {}, report));
        // The second after the fault is over.
        let long_ago = monotonic().0 - 2_000_000_000;
        let fault = || {
            let answer = flights.trigger_at(Trigger::Fault, ("left", "it faulted"), long_ago);
            assert!(matches!(answer, Answer::Written(_)), "{answer:?}");
            let until = monotonic().0 + 30_000_000_000;
            while flights.state().current.is_some() && monotonic().0 < until {
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        for room in [0, 300, 300, u64::MAX / 2, u64::MAX / 2, 300] {
            disk.room.store(room, Ordering::Relaxed);
            fault();
        }
        flights.stop();
    });
    let lines = lines.into_inner().unwrap();
    let levels: Vec<_> = lines.iter().map(|(level, _)| *level).collect();
    let (full, written) = (Level::Error, Level::Info);
    assert_eq!(levels, [full, written, written, full], "{lines:?}");
    for part in ["-left.mcap: ", "\nhint: free space on that disk"] {
        assert!(lines[0].1.contains(part), "{}", lines[0].1);
    }
    let counts = FlightCounts {
        written: 2,
        failed: 4,
        limited: 0,
    };
    assert_eq!(flights.counts(), counts);
    std::fs::remove_dir_all(flights.directory()).unwrap();
}

#[test]
fn flight_file_that_failed_leaves_no_empty_file() {
    let directory = folder("empty");
    std::fs::create_dir_all(&directory).unwrap();
    let empty = directory.join("flight-1.mcap");
    std::fs::write(&empty, b"").unwrap();
    discard_unreadable(&empty);
    assert!(!empty.exists(), "it would push out an earlier one");
    discard_unreadable(&empty);
    std::fs::remove_dir_all(directory).unwrap();
}

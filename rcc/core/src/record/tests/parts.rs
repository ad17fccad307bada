//! Recordings in several files: each whole, together one replay.

use super::*;
use crate::record::parts::Part;
use crate::record::read::RecordedNote;

/// The least size of a part in these tests: each ends with its first chunk, of about 170 cycles.
const BYTES: u64 = 40_000;
/// Cycles of some parts.
const CYCLES: u64 = 800;
/// A net whose state a replay needs from its first cycle on.
const NET: &str = "{t=Core::Clock(),o=Core::DoubleNetcommOut(inValue=t.outValue,Key='t'),\
    c=Cancel(),outTerminate=c.outCancel}";

/// Records so many cycles of two nets, of which the first ends early, to parts on disks, from the second on with that room.
/// Returns the disks, and the error of one that became full.
fn rotated(cycles: u64, room: usize) -> (Vec<Disk>, Option<Error>) {
    let disks = Arc::new(Mutex::new(Vec::new()));
    let all = Arc::clone(&disks);
    let open = move |part: &Part| {
        let disk = Disk::new(if part.number > 1 { room } else { usize::MAX });
        all.lock().unwrap().push(disk.clone());
        Writer::part_on(disk, Path::new(PATH), Some(part))
    };
    let time = "20261123T000000.000Z".to_owned();
    let (parts, writer) = Parts::new(BYTES, time, Box::new(open)).unwrap();
    let (mut recorder, mut tap) = Recorder::begin((writer, Some(parts)), Path::new(PATH)).unwrap();
    let mut executor = Executor::default();
    executor.use_words(600, 0);
    for id in [3, 4] {
        let net = crate::executor::tests::net(id, NET);
        let period = (1, Duration::from_millis(1));
        recorder.net(NetId(id), period, &Arc::from(NET), net.plan.outbox());
        executor.start_checked(net);
        tap.started(id);
    }
    let mut random = 1_u64;
    for cycle in 0..cycles {
        for word in executor.signals() {
            random = random.wrapping_mul(6_364_136_223_846_793_005);
            random = random.wrapping_add(1);
            word.set(random);
        }
        if cycle == 2 {
            executor.cancel(3);
            tap.cancelled(3);
        }
        let time = Nanos(i64::try_from(cycle).unwrap() * 1_000_000);
        let moment = Moment {
            time,
            ..moment(cycle)
        };
        tap.inputs(moment, &executor);
        executor.cycle(moment);
        executor.publish(|net| tap.outbox(net));
        tap.outputs(moment, &executor);
        while executor.take_ended(|net, end| {
            tap.ended(net.id, end);
            Ok(())
        }) {}
        tap.finish();
        // No cycle is lost, however slow the writing thread is.
        while tap.full.free_slots() < BUFFERS / 2 {
            if recorder.poll_event(Instant::now()).is_some() {
                break;
            }
            std::thread::yield_now();
        }
        if recorder.has_failed {
            break;
        }
    }
    let error = recorder.finish().err();
    let disks = disks.lock().unwrap().clone();
    (disks, error)
}

fn folder(name: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("takt-parts-{name}-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).unwrap();
    path
}

/// Writes parts to a directory; returns their paths.
fn saved(directory: &Path, disks: &[Disk]) -> Vec<PathBuf> {
    let save = |(place, disk): (usize, &Disk)| {
        let path = directory.join(format!("run-20261123T000000.000Z-{:04}.mcap", place + 1));
        std::fs::write(&path, disk.bytes()).unwrap();
        path
    };
    disks.iter().enumerate().map(save).collect()
}

#[test]
fn rotated_parts_are_whole_and_repeat_what_runs() {
    let (disks, error) = rotated(CYCLES, usize::MAX);
    assert!(error.is_none(), "{error:?}");
    assert!(disks.len() > 3, "{}", disks.len());
    let mut cycles = 0;
    for (place, disk) in disks.iter().enumerate() {
        let bytes = disk.bytes();
        let read = Recording::parse(&bytes, Path::new(PATH)).unwrap();
        let number = u32::try_from(place + 1).unwrap();
        assert_eq!(read.part.map(|part| part.number), Some(number));
        let nets = read.notes.iter().map(|note| match note {
            RecordedNote::Net(net) => (net.id, net.is_repeated),
            RecordedNote::Device(_) | RecordedNote::Machine(_) => panic!("{note:?}"),
        });
        let nets: Vec<_> = nets.collect();
        // Net 3 has ended, net 4 has not.
        let wanted: &[_] = match place {
            0 => &[(3, false), (4, false)],
            _ => &[(4, true)],
        };
        assert_eq!((nets.as_slice(), read.is_cut), (wanted, false));
        cycles += read.cycles.iter().count();
        // With an index of its own, and the values of the net that runs.
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        let topics = summary.channels.values();
        let topics: Vec<_> = topics.map(|channel| channel.topic.as_str()).collect();
        assert!(topics.contains(&"/takt/nets/rpinet4"), "{topics:?}");
    }
    assert_eq!(cycles as u64, CYCLES, "each cycle is in one part");
}

#[test]
fn rotated_recording_replays_over_all_parts() {
    let directory = folder("replay");
    let (disks, _) = rotated(CYCLES, usize::MAX);
    let paths = saved(&directory, &disks);
    let outcome = replay(&directory).unwrap();
    assert_eq!((outcome.cycles, outcome.differs), (CYCLES, None));
    assert!(!outcome.is_cut);
    let first = replay(&paths[0]).unwrap();
    assert!(
        first.cycles < CYCLES && first.differs.is_none(),
        "{first:?}"
    );
    let why = |path: &Path| replay(path).unwrap_err().to_string();
    let hint = "\nhint: name a directory that contains all parts of one recording, from the first";
    let text = why(&paths[1]);
    assert!(
        text.contains("it is part 2 of a recording") && text.ends_with(hint),
        "{text}"
    );
    std::fs::rename(&paths[1], directory.join("away")).unwrap();
    let text = why(&directory);
    assert!(
        text.contains("part 3, but the file before it is part 1"),
        "{text}"
    );
    std::fs::rename(directory.join("away"), &paths[1]).unwrap();
    let cut = disks[1].bytes();
    std::fs::write(&paths[1], &cut[..cut.len() - 40]).unwrap();
    let text = why(&directory);
    assert!(
        text.contains("it is cut off, but another part follows"),
        "{text}"
    );
    std::fs::remove_dir_all(directory).unwrap();
}

#[test]
fn kill_at_any_byte_of_last_part_leaves_replay() {
    let directory = folder("kill");
    let (disks, _) = rotated(400, usize::MAX);
    let paths = saved(&directory, &disks);
    let last = disks.last().unwrap().bytes();
    let path = paths.last().unwrap();
    let whole = replay(&directory).unwrap();
    let mut before = 0;
    // The file was created, and nothing or a part of it is on the disk.
    for length in (0..64).chain((64..last.len() - 1).step_by(20_011)) {
        std::fs::write(path, &last[..length]).unwrap();
        let outcome = replay(&directory);
        let outcome = outcome.unwrap_or_else(|error| panic!("{length} bytes: {error}"));
        assert_eq!((outcome.is_cut, outcome.differs), (true, None), "{length}");
        assert!(outcome.cycles >= before && outcome.cycles <= whole.cycles);
        before = outcome.cycles;
    }
    // Killed between two parts.
    std::fs::remove_file(path).unwrap();
    let outcome = replay(&directory).unwrap();
    assert!(!outcome.is_cut && outcome.cycles > 0, "{outcome:?}");
    std::fs::remove_dir_all(directory).unwrap();
}

#[test]
fn full_disk_ends_rotated_recording_readable() {
    let (disks, error) = rotated(CYCLES, 39_000);
    let error = error.unwrap().to_string();
    assert!(error.contains("\nhint: free space on that disk"), "{error}");
    assert_eq!(disks.len(), 2, "it does not go on in another file");
    let first = Recording::parse(&disks[0].bytes(), Path::new(PATH)).unwrap();
    assert!(!first.is_cut && !first.cycles.is_empty());
    let second = Recording::parse(&disks[1].bytes(), Path::new(PATH));
    // The chunk that did not fit may be the first.
    assert!(second.is_ok_and(|it| it.is_cut) || disks[1].bytes().len() == 39_000);
}

#[test]
fn rotation_keeps_number_of_newest_files() {
    let directory = folder("keep");
    for name in [
        "run-20261122T000000.000Z-0001.mcap",
        "run-20261122T000000.000Z-0002.mcap",
        "run-20261123T000000.000Z-0001.mcap",
        "run-20261123T000000.000Z-9999.mcap",
        "run-20261123T000000.000Z-10000.mcap",
        "run-other-20261101T000000.000Z-0001.mcap",
        "run.mcap",
    ] {
        std::fs::write(directory.join(name), b"").unwrap();
    }
    let path = directory.join("run.mcap");
    let rotation = Rotation {
        bytes: PART_BYTES_MIN,
        keep: Some(3),
    };
    let (recorder, _tap) = Recorder::start_rotating(&path, rotation).unwrap();
    assert_eq!(recorder.finish().unwrap(), 0);
    let files = std::fs::read_dir(&directory).unwrap();
    let mut names: Vec<_> = files
        .map(|it| it.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(names.len(), 5, "{names:?}");
    for kept in [
        "23T000000.000Z-9999.mcap",
        "23T000000.000Z-10000.mcap",
        "run.mcap",
        "other-2",
    ] {
        assert!(names.iter().any(|name| name.contains(kept)), "{names:?}");
    }
    std::fs::remove_dir_all(directory).unwrap();
}

#[test]
fn rotation_below_least_size_is_rejected() {
    let rotation = Rotation {
        bytes: 1000,
        keep: None,
    };
    let error = Recorder::start_rotating(Path::new("/nonexistent/run.mcap"), rotation);
    let error = error.unwrap_err().to_string();
    assert!(error.contains("at least 4 MiB"), "{error}");
}

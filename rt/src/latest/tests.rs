//! Single-threaded tests; `tests/loom.rs` explores the interleavings.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use super::{ONE_READ, latest};

#[test]
fn cell_holds_initial_value_until_first_write() {
    let (mut writer, mut reader) = latest(1, || 7);
    assert_eq!((reader.version(), reader.read()), (0, 7));
    writer.write(8);
    assert_eq!((reader.version(), reader.read()), (1, 8));
    assert_eq!(reader.read(), 8, "a value can be read again");
}

#[test]
fn cell_writer_continues_with_all_readers_busy() {
    let (mut writer, mut first) = latest(2, || 0);
    let mut second = first.another().unwrap();
    writer.write(1);
    first.read_with(|&old| {
        writer.write(2);
        second.read_with(|&newer| {
            for value in 3..100 {
                writer.write(value);
            }
            assert_eq!((old, newer), (1, 2));
        });
    });
    assert_eq!((first.read(), second.read()), (99, 99));
}

#[test]
fn cell_handles_are_limited_and_reusable() {
    let (_writer, reader) = latest(2, || 0);
    let second = reader.another().unwrap();
    assert!(reader.another().is_none());
    drop(second);
    assert!(reader.another().is_some());
}

#[test]
fn cell_for_zero_readers_has_one() {
    let (mut writer, mut reader) = latest(0, || 0);
    writer.write(1);
    assert_eq!(reader.read(), 1);
    assert!(reader.another().is_none());
}

#[test]
fn cell_panicking_reader_releases_slot() {
    let (mut writer, mut reader) = latest(1, || 0);
    for value in 1..10 {
        writer.write(value);
        let read = AssertUnwindSafe(|| reader.read_with(|_| panic!("in the reader")));
        assert!(catch_unwind(read).is_err());
    }
    assert_eq!(reader.read(), 9);
}

#[test]
fn cell_panicking_writer_publishes_nothing() {
    let (mut writer, mut reader) = latest(1, || (0, 0));
    writer.write((1, 1));
    let write = AssertUnwindSafe(|| {
        writer.write_with(|pair| {
            pair.0 = 2;
            panic!("in the writer");
        });
    });
    assert!(catch_unwind(write).is_err());
    assert_eq!((reader.version(), reader.read()), (1, (1, 1)));
    writer.write((3, 3));
    assert_eq!(reader.read(), (3, 3));
}

#[test]
fn cell_counts_wrap_together() {
    let (mut writer, mut reader) = latest(1, || 0);
    // As if slot 0 had been read 2^48 - 1 times since it was published.
    let almost = 0_u64.wrapping_sub(ONE_READ);
    writer.shared.current.store(almost, Ordering::Relaxed);
    writer.shared.slots[0]
        .released
        .store(almost, Ordering::Relaxed);
    assert_eq!(reader.read(), 0);
    assert_eq!(reader.read(), 0);
    for value in 1..10 {
        reader.read_with(|_| writer.write(value));
        assert_eq!(reader.read(), value);
    }
}

#[test]
fn cell_values_are_dropped_once() {
    let token = Arc::new(());
    let (mut writer, mut reader) = latest(3, || Arc::clone(&token));
    assert_eq!(Arc::strong_count(&token), 6);
    writer.write_with(|slot| *slot = Arc::new(()));
    reader.read_with(|newest| assert!(!Arc::ptr_eq(newest, &token)));
    assert_eq!(Arc::strong_count(&token), 5);
    drop((writer, reader));
    assert_eq!(Arc::strong_count(&token), 1);
}

/// The model checker explores few steps exactly; this runs many at random.
#[test]
fn cell_readers_never_see_torn_or_older_values() {
    const WORDS: usize = 64;
    let (mut writer, reader) = latest(2, || [0_u64; WORDS]);
    let readers = [reader.another().unwrap(), reader];
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for mut reader in readers {
            scope.spawn({
                let done = &done;
                move || {
                    let mut newest = 0;
                    while !done.load(Ordering::Relaxed) {
                        let version = reader.version();
                        let image = reader.read();
                        assert_eq!(image, [image[0]; WORDS]);
                        assert!(image[0] >= newest, "went back");
                        assert!(image[0] >= version, "older than its announced version");
                        newest = image[0];
                    }
                }
            });
        }
        for value in 1..=20_000 {
            writer.write_with(|image| image.fill(value));
        }
        done.store(true, Ordering::Relaxed);
    });
}

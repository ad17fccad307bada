//! The cell and the ring under every interleaving and every allowed weak ordering, within loom's bounds:
//! `RUSTFLAGS="--cfg loom" cargo test -p takt-rt --test loom --release`.
//!
//! Loom itself fails a test on two conflicting accesses to a slot, an item leaked or one used after it
//! was dropped. It cannot show wait-freedom, which follows from reading the code, nor an addition that
//! overtakes a load, so the ordering of `version` rests on the argument in `latest` alone.
#![cfg(loom)]

use loom::{model::Builder, sync::Arc, thread};
use takt_rt::{latest::latest, ring::ring};

/// Explores `model` with at most five forced thread switches, which finds nearly all errors
/// and ends in seconds.
fn explore(model: impl Fn() + Sync + Send + 'static) {
    let mut builder = Builder::new();
    builder.preemption_bound = Some(5);
    builder.check(model);
}

#[test]
fn cell_readers_see_whole_monotonic_values() {
    explore(|| {
        let (mut writer, reader) = latest(2, || (0, 0));
        let readers = [reader.another().unwrap(), reader].map(|mut reader| {
            thread::spawn(move || {
                let first = reader.read();
                let second = reader.read();
                assert_eq!(first.0, first.1);
                assert_eq!(second.0, second.1);
                assert!(first.0 <= second.0);
            })
        });
        for value in 1..=3 {
            writer.write((value, value));
        }
        for reader in readers {
            reader.join().unwrap();
        }
    });
}

#[test]
fn cell_new_reader_sees_earlier_write() {
    explore(|| {
        let (mut writer, mut reader) = latest(1, || 0);
        writer.write(1);
        let reading = thread::spawn(move || {
            assert!(reader.read() >= 1);
            reader
        });
        writer.write(2);
        assert_eq!(reading.join().unwrap().read(), 2);
    });
}

#[test]
fn cell_value_is_not_older_than_version() {
    explore(|| {
        let (mut writer, mut reader) = latest(1, || 0);
        let reading = thread::spawn(move || {
            let version = reader.version();
            assert!(reader.read() >= version);
        });
        writer.write(1);
        writer.write(2);
        reading.join().unwrap();
    });
}

/// A slot released late in the writer's eyes may not add to the one the same handle reads now.
#[test]
fn cell_reader_occupies_one_slot() {
    explore(|| {
        let (mut writer, mut reader) = latest(1, || 0);
        let reading = thread::spawn(move || {
            reader.read();
            reader.read();
        });
        for value in 1..=3 {
            writer.write(value);
        }
        reading.join().unwrap();
    });
}

/// The same across a handle dropped on one thread and its successor on another.
#[test]
fn cell_replaced_handle_occupies_one_slot() {
    explore(|| {
        let (mut writer, mut reader) = latest(2, || 0);
        let mut first = reader.another().unwrap();
        let reading = thread::spawn(move || {
            first.read();
        });
        let replacing = thread::spawn(move || {
            if let Some(mut successor) = reader.another() {
                reader.read_with(|_| successor.read());
            }
        });
        for value in 1..=4 {
            writer.write(value);
        }
        reading.join().unwrap();
        replacing.join().unwrap();
    });
}

#[test]
fn cell_overwritten_values_are_freed_once() {
    explore(|| {
        let (mut writer, mut reader) = latest(1, || Arc::new(0));
        let reading = thread::spawn(move || reader.read_with(|value| **value));
        writer.write_with(|slot| *slot = Arc::new(1));
        assert!(reading.join().unwrap() <= 1);
    });
}

#[test]
fn ring_keeps_order_and_counts_rejected() {
    explore(|| {
        let (mut producer, mut consumer) = ring(2);
        let pushing = thread::spawn(move || {
            let accepted: Vec<u64> = (0..4).filter(|&item| producer.push(item).is_ok()).collect();
            assert_eq!(accepted.len() as u64 + producer.dropped(), 4);
            accepted
        });
        let mut popped: Vec<u64> = (0..3).filter_map(|_| consumer.pop()).collect();
        let accepted = pushing.join().unwrap();
        popped.extend(std::iter::from_fn(|| consumer.pop()));
        assert_eq!(popped, accepted);
    });
}

#[test]
fn ring_of_one_reuses_slot() {
    explore(|| {
        let (mut producer, mut consumer) = ring(1);
        let pushing =
            thread::spawn(move || (0..3).filter(|&item| producer.push(item).is_ok()).count());
        let popped = (0..3).filter_map(|_| consumer.pop()).count();
        let accepted = pushing.join().unwrap();
        let left = std::iter::from_fn(|| consumer.pop()).count();
        assert_eq!(popped + left, accepted);
    });
}

#[test]
fn ring_last_endpoint_drops_remaining_items() {
    explore(|| {
        let (mut producer, mut consumer) = ring(2);
        let pushing = thread::spawn(move || {
            let _ = producer.push(Arc::new(0));
            let _ = producer.push(Arc::new(1));
        });
        drop(consumer.pop());
        drop(consumer);
        pushing.join().unwrap();
    });
}

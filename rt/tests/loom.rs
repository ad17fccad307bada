//! The cell and the ring under every interleaving and every allowed weak ordering, within loom's bounds:
//! `RUSTFLAGS="--cfg loom" cargo test -p takt-rt --test loom --release`.
//!
//! Loom itself fails a test on two conflicting accesses to a slot, an item leaked or one used after it
//! was dropped. What it cannot show: that nothing waits, which is seen by reading; and an addition that
//! overtakes a load, so the ordering of `version` rests on the argument in `latest` alone.
#![cfg(loom)]

use loom::{model::Builder, sync::Arc, thread};
use takt_rt::{latest::latest, ring::ring};

/// Explores `model` with at most five forced thread switches, which finds nearly all there is to find
/// and ends in seconds.
fn explore(model: impl Fn() + Sync + Send + 'static) {
    let mut builder = Builder::new();
    builder.preemption_bound = Some(5);
    builder.check(model);
}

#[test]
fn readers_see_whole_values_that_never_go_back() {
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
fn a_reader_finds_what_was_written_before_it_came() {
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
fn a_value_is_at_least_as_new_as_its_announced_version() {
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
fn one_reader_keeps_one_slot_from_the_writer() {
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
fn a_handle_and_its_successor_keep_one_slot_from_the_writer() {
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
fn values_with_drop_glue_are_overwritten_and_freed_once() {
    explore(|| {
        let (mut writer, mut reader) = latest(1, || Arc::new(0));
        let reading = thread::spawn(move || reader.read_with(|value| **value));
        writer.write_with(|slot| *slot = Arc::new(1));
        assert!(reading.join().unwrap() <= 1);
    });
}

#[test]
fn the_ring_keeps_order_and_counts_what_it_refuses() {
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
fn a_ring_of_one_reuses_its_place() {
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
fn items_left_in_the_ring_are_dropped_by_whichever_end_goes_last() {
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

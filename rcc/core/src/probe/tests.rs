//! Scopes without a controller: groups over rings that a test writes, and triggers over rows that it gives.

use proptest::prelude::*;

use super::group::{Group, Source};
use super::trigger::{Found, GroupSize, Watch};
use super::*;
use crate::executor::flight::{FlightWriter, ring};

/// Which of these values trigger, in mode normal with captures of one row.
fn triggering(condition: Condition, values: &[f64]) -> Vec<usize> {
    let mut engine = engine(condition, Mode::Normal, 0.0, 0.0);
    let mut found = Vec::new();
    for (number, value) in values.iter().enumerate() {
        engine.handle_rows(&[(0, &[seconds(number), *value])], seconds(number));
        found.extend(engine.poll_capture().map(|_| number));
    }
    found
}

fn seconds(ms: usize) -> f64 {
    f64::from(u32::try_from(ms).unwrap()) * 1e-3
}

fn engine(condition: Condition, mode: Mode, pre_s: f64, post_s: f64) -> Engine {
    let settings = Settings {
        watch: Watch {
            group: 0,
            column: 0,
            name: "a".to_owned(),
            states: Vec::new(),
            condition,
        },
        mode,
        pre_s,
        post_s,
    };
    let size = GroupSize {
        columns: 1,
        period_s: 1e-3,
    };
    Engine::new(settings, &[size]).unwrap()
}

#[test]
fn trigger_conditions_match_table() {
    const NAN: f64 = f64::NAN;
    let edge = |level, hysteresis| (level, hysteresis);
    let rising = |(level, hysteresis)| Condition::Rising { level, hysteresis };
    let falling = |(level, hysteresis)| Condition::Falling { level, hysteresis };
    let (low, high) = (1.0, 2.0);
    let table: [(Condition, &[f64], &[usize]); 13] = [
        (Condition::Above(1.0), &[0.0, 1.0, 1.5, NAN, 2.0], &[2, 4]),
        (Condition::Below(1.0), &[2.0, 1.0, 0.5, NAN, 0.0], &[2, 4]),
        // It begins above: no edge.
        (
            rising(edge(1.0, 0.0)),
            &[2.0, 0.5, 1.0, 3.0, 0.9, 1.1],
            &[2, 5],
        ),
        (rising(edge(1.0, 0.0)), &[0.0, NAN, 1.0], &[2]),
        // Chatter within the hysteresis is one edge.
        (
            rising(edge(1.0, 0.5)),
            &[0.0, 1.1, 0.9, 1.1, 0.6, 1.2, 0.5, 1.0],
            &[1, 7],
        ),
        (
            falling(edge(1.0, 0.0)),
            &[0.5, 2.0, 1.0, 0.0, 1.1, 0.9],
            &[2, 5],
        ),
        (
            falling(edge(1.0, 0.5)),
            &[2.0, 0.9, 1.1, 0.9, 1.5, 1.0],
            &[1, 5],
        ),
        (
            Condition::Inside { low, high },
            &[0.9, 1.0, 2.0, 2.1, NAN],
            &[1, 2],
        ),
        (
            Condition::Outside { low, high },
            &[1.0, 0.9, 2.0, 2.1, NAN],
            &[1, 3],
        ),
        // The state of the first row counts; staying in it does not.
        (
            Condition::Becomes(4.0),
            &[4.0, 4.0, NAN, 4.0, 5.0, 4.0],
            &[0, 5],
        ),
        (
            Condition::Increases,
            &[3.0, 3.0, 4.0, 2.0, NAN, 3.0],
            &[2, 5],
        ),
        (Condition::Positive, &[0.0, 1.0, 0.0, 3.0], &[1, 3]),
        (Condition::Above(0.0), &[], &[]),
    ];
    for (condition, values, expected) in table {
        assert_eq!(triggering(condition, values), expected, "{condition:?}");
    }
}

#[test]
fn trigger_modes_capture_as_named() {
    let rows: Vec<f64> = (0..2000)
        .flat_map(|n| [seconds(n), f64::from(u8::from(n % 100 == 50))])
        .collect();
    let captures = |mode, condition| {
        let mut engine = engine(condition, mode, 0.01, 0.02);
        for (number, rows) in rows.chunks(2).enumerate() {
            engine.handle_rows(&[(0, rows)], seconds(number));
        }
        std::iter::from_fn(|| engine.poll_capture()).count()
    };
    let edge = Condition::Rising {
        level: 1.0,
        hysteresis: 0.0,
    };
    assert_eq!(captures(Mode::Single, edge), 1);
    assert_eq!(captures(Mode::Normal, edge), 20);
    assert_eq!(captures(Mode::Auto, edge), 20, "triggers come in time");
    assert_eq!(captures(Mode::Normal, Condition::Above(2.0)), 0);
    assert_eq!(captures(Mode::Auto, Condition::Above(2.0)), 3, "each 0.5 s");
}

#[test]
fn trigger_capture_waits_for_slow_group_with_bound() {
    let settings = Settings {
        watch: Watch {
            group: 0,
            column: 0,
            name: "a".to_owned(),
            states: Vec::new(),
            condition: Condition::Above(0.5),
        },
        mode: Mode::Single,
        pre_s: 0.0,
        post_s: 0.002,
    };
    let size = GroupSize {
        columns: 1,
        period_s: 1e-3,
    };
    let mut engine = Engine::new(settings, &[size, size]).unwrap();
    let rows = [0.0, 0.0, 0.001, 1.0, 0.002, 0.0, 0.003, 0.0, 0.004, 0.0];
    engine.handle_rows(&[(0, &rows), (3, &[])], 0.0);
    assert_eq!(engine.poll_capture(), None, "the other group has no rows");
    engine.poll(1.0);
    assert_eq!(engine.poll_capture(), None);
    engine.poll(1.1);
    let capture = engine.poll_capture().unwrap();
    assert_eq!(capture.groups[0].values, rows[2..8]);
    assert!(capture.groups[1].values.is_empty());
    assert!(engine.is_done());
}

#[test]
fn trigger_memory_beyond_bound_is_refused() {
    let settings = Settings {
        watch: Watch {
            group: 0,
            column: 0,
            name: String::new(),
            states: Vec::new(),
            condition: Condition::Positive,
        },
        mode: Mode::Auto,
        pre_s: 60.0,
        post_s: 60.0,
    };
    let size = GroupSize {
        columns: 64,
        period_s: 1e-3,
    };
    let text = Engine::new(settings, &[size]).unwrap_err().to_string();
    assert!(
        text.contains(&CAPTURE_BYTES_MAX.to_string()) && text.contains("hint: "),
        "{text}"
    );
}

proptest! {
    /// A capture has its trigger, exactly the rows before and after it that exist, in order, and counts what was lost among them.
    #[test]
    fn trigger_captures_hold_trigger_and_whole_window(
        values in proptest::collection::vec((0_u8..8, 0_u64..3), 1..300),
        pre in 0_usize..20,
        post in 0_usize..20,
        batch in 1_usize..40,
    ) {
        let mut engine = engine(Condition::Above(6.5), Mode::Normal, seconds(pre), seconds(post));
        let (mut rows, mut numbers, mut number) = (Vec::new(), Vec::new(), 0_usize);
        for (value, lost) in &values {
            number += usize::try_from(*lost).unwrap();
            rows.push((*lost, [seconds(number), f64::from(*value)]));
            numbers.push(number);
            number += 1;
        }
        let mut triggers = Vec::new();
        let mut captures = Vec::new();
        for chunk in rows.chunks(batch) {
            for (lost, row) in chunk {
                engine.handle_rows(&[(*lost, row)], row[0]);
            }
            while let Some(found) = engine.poll_found() {
                match found {
                    Found::Trigger(trigger) => triggers.push(trigger),
                    Found::Capture(capture) => captures.push(capture),
                }
            }
        }
        prop_assert!(triggers.len() - captures.len() <= 1);
        for capture in &captures {
            let at = rows.iter().position(|(_, row)| row[0] >= capture.trigger.time_s).unwrap();
            prop_assert!(rows[at].1[1] > 6.5);
            let (first, last) = (at.saturating_sub(pre), at + post + 1);
            prop_assert!(last <= rows.len());
            let expected: Vec<f64> = rows[first..last].iter().flat_map(|(_, row)| *row).collect();
            prop_assert_eq!(&capture.groups[0].values, &expected);
            let lost: u64 = rows[first..last].iter().map(|(lost, _)| lost).sum();
            prop_assert_eq!(capture.groups[0].lost, lost);
        }
    }
}

/// A thread's ring and one source, written as a net thread does.
struct Rings {
    timing: FlightWriter,
    source: Option<FlightWriter>,
    group: Group,
}

impl Rings {
    fn new(rows: usize, net_every: u64, every: u64) -> Self {
        Self::of_rows(rows, rows, (net_every, every))
    }

    fn of_rows(timing: usize, source: usize, (net_every, every): (u64, u64)) -> Self {
        let (timing, timing_reader) = ring(2, timing);
        let (source, reader) = ring(2, source);
        let base = takt_rt::Nanos(1_000_000);
        let mut group = Group::new(&timing_reader, base, net_every, every);
        group.sources = vec![Source::of_ring(&reader, "it has ended".to_owned())];
        let column = Column {
            name: "a".to_owned(),
            unit: String::new(),
            states: Arc::default(),
            pick: Arc::new(|row| f64::from_bits(row[1])),
        };
        group.add(Some(0), &column);
        group.begin();
        Self {
            timing,
            source: Some(source),
            group,
        }
    }

    fn source(&mut self, cycle: u32) {
        if let Some(source) = &mut self.source {
            let words = [u64::from(cycle), f64::from(cycle).to_bits()];
            source.write(words.into_iter());
        }
    }

    fn thread(&mut self, cycle: u32) {
        let words = [u64::from(cycle), 1_000_000 * (u64::from(cycle) + 1)];
        self.timing.write(words.into_iter());
    }

    fn cycles(&mut self, cycles: std::ops::Range<u32>) {
        for cycle in cycles {
            self.source(cycle);
            self.thread(cycle);
        }
    }

    /// Lost rows and the values of rows, whose times must fit.
    fn read(&mut self) -> (u64, Vec<u32>) {
        let read = self.group.read();
        let rows = read.values.chunks(2).map(|row| {
            assert!((row[0] - row[1] * 1e-3).abs() < 1e-12, "{row:?}");
            format!("{}", row[1]).parse().unwrap()
        });
        (read.lost, rows.collect())
    }
}

#[test]
fn scope_group_waits_for_end_of_cycle() {
    let mut rings = Rings::new(64, 1, 1);
    rings.cycles(1..4);
    assert_eq!(rings.read(), (0, vec![1, 2, 3]));
    rings.source(4);
    assert_eq!(rings.read(), (0, vec![]), "the cycle is not over");
    rings.thread(4);
    assert_eq!(rings.read(), (0, vec![4]));
    // A cycle without row of the source, as of a net that is not evaluated.
    rings.thread(5);
    rings.cycles(6..7);
    assert_eq!(rings.read(), (0, vec![6]));
}

#[test]
fn scope_group_takes_every_nth_period() {
    let mut rings = Rings::new(64, 2, 3);
    rings.cycles(1..20);
    assert_eq!(rings.read().1, [1, 6, 7, 12, 13, 18, 19]);
}

#[test]
fn scope_slow_reader_loses_counted_rows() {
    let mut rings = Rings::new(8, 1, 1);
    rings.cycles(1..4);
    assert_eq!(rings.read(), (0, vec![1, 2, 3]));
    rings.cycles(4..104);
    let (lost, rows) = rings.read();
    assert_eq!(lost + rows.len() as u64, 100);
    assert_eq!(rows, (96..104).collect::<Vec<_>>());
}

/// The ring of a sampler holds less time than that of its thread.
#[test]
fn scope_source_overwritten_alone_counts_lost_rows() {
    for every in [1, 2] {
        let mut rings = Rings::of_rows(256, 8, (1, every));
        rings.cycles(1..4);
        let _ = rings.read();
        rings.cycles(4..104);
        let (lost, rows) = rings.read();
        assert_eq!(lost + rows.len() as u64, 100 / every, "{rows:?}");
        assert_eq!(
            *rows.last().unwrap(),
            103 / u32::try_from(every).unwrap() * u32::try_from(every).unwrap()
        );
        rings.cycles(104..108);
        assert_eq!(rings.read().0, 0);
    }
}

#[test]
fn scope_group_reports_end_of_source_once() {
    let mut rings = Rings::new(8, 1, 1);
    rings.cycles(1..3);
    rings.source = None;
    let read = rings.group.read();
    assert_eq!(
        (read.values.len(), read.ended.len()),
        (4, 0),
        "its last rows first"
    );
    let ended: Vec<_> = (0..3).flat_map(|_| rings.group.read().ended).collect();
    assert_eq!(ended, [(0, "it has ended".to_owned())]);
}

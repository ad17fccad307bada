//! A kernel whose service locks, steps, stops and comes back, reading by reading.

use super::*;

/// Readings a second apart, of a kernel whose error is set to `error` by each update.
struct Kernel {
    reading: Reading,
    updates: bool,
}

impl Kernel {
    fn new() -> Self {
        let reading = Reading {
            before: Nanos(1_000_000_000),
            tai: Nanos(1_800_000_000_000_000_050),
            after: Nanos(1_000_000_100),
            tai_utc_s: 37,
            unsynchronised: false,
            max_error: Nanos::ZERO,
            estimated_error: Nanos::ZERO,
        };
        Self {
            reading,
            updates: true,
        }
    }

    fn next(&mut self) -> Reading {
        let second = Nanos::from_millis(1_000);
        for at in [
            &mut self.reading.before,
            &mut self.reading.tai,
            &mut self.reading.after,
        ] {
            *at += second;
        }
        self.reading.max_error = if self.updates {
            Nanos::ZERO
        } else {
            self.reading.max_error + Nanos::from_micros(500)
        };
        self.reading
    }

    fn states(&mut self, watch: &mut TaiWatch, seconds: usize) -> Vec<TaiState> {
        (0..seconds)
            .map(|_| watch.handle(self.next()).state)
            .collect()
    }
}

const FLOOR: Nanos = Nanos::from_micros(10);

#[test]
fn tai_updated_by_service_is_locked_with_offset() {
    let (mut kernel, mut watch) = (Kernel::new(), TaiWatch::new(FLOOR));
    assert_eq!(watch.now().state, TaiState::Free);
    assert_eq!(kernel.states(&mut watch, 20), [TaiState::Locked; 20]);
    let now = watch.now();
    assert_eq!(now.offset, Nanos(1_800_000_000_000_000_050 - 1_000_000_050));
    assert_eq!(now.uncertainty, FLOOR + Nanos(50));
    assert_eq!(now.monotonic(now.tai(Nanos(5))), Nanos(5));
    assert!(now.estimate().is_valid_at(now.at));
    assert_eq!(now.estimate().remote_at(now.at), now.tai(now.at));
}

#[test]
fn tai_offset_zero_is_free_with_cause() {
    let (mut kernel, mut watch) = (Kernel::new(), TaiWatch::new(FLOOR));
    kernel.reading.tai_utc_s = 0;
    let now = watch.handle(kernel.next());
    assert_eq!(
        (now.state, now.cause),
        (TaiState::Free, FreeCause::NoTaiOffset)
    );
    assert!(!now.estimate().is_valid_at(now.at));
}

#[test]
fn tai_of_unsynchronised_kernel_is_free() {
    let (mut kernel, mut watch) = (Kernel::new(), TaiWatch::new(FLOOR));
    (kernel.reading.unsynchronised, kernel.updates) = (true, false);
    assert_eq!(kernel.states(&mut watch, 10), [TaiState::Free; 10]);
    assert_eq!(watch.now().cause, FreeCause::Unsynchronised);
}

#[test]
fn tai_stepped_is_free_until_settled() {
    let (mut kernel, mut watch) = (Kernel::new(), TaiWatch::new(FLOOR));
    kernel.states(&mut watch, 5);
    kernel.reading.tai += Nanos::from_micros(90);
    assert_eq!(kernel.states(&mut watch, 1), [TaiState::Locked], "slewed");
    kernel.reading.tai += Nanos::from_micros(-110);
    let after = kernel.states(&mut watch, 4);
    let [free, locked] = [TaiState::Free, TaiState::Locked];
    assert_eq!(after, [free, free, free, locked]);
    kernel.reading.tai_utc_s = 38;
    assert_eq!(kernel.states(&mut watch, 1), [free], "a new TAI offset");
}

#[test]
fn tai_without_service_is_holdover_then_free() {
    let (mut kernel, mut watch) = (Kernel::new(), TaiWatch::new(FLOOR));
    kernel.states(&mut watch, 5);
    kernel.updates = false;
    let states = kernel.states(&mut watch, 80);
    let first = |state| states.iter().position(|s| *s == state).unwrap();
    assert!((4..10).contains(&first(TaiState::Holdover)), "{states:?}");
    assert!((58..66).contains(&first(TaiState::Free)), "{states:?}");
    assert_eq!(watch.now().cause, FreeCause::Silent);
    kernel.updates = true;
    assert_eq!(kernel.states(&mut watch, 1), [TaiState::Locked]);
}

#[test]
fn tai_in_holdover_grows_uncertain() {
    let (mut kernel, mut watch) = (Kernel::new(), TaiWatch::new(FLOOR));
    kernel.states(&mut watch, 5);
    let locked = watch.now().uncertainty;
    kernel.updates = false;
    kernel.states(&mut watch, 30);
    let grown = watch.now().uncertainty - locked;
    assert!(
        (Nanos::from_micros(50)..Nanos::from_micros(70)).contains(&grown),
        "{grown}"
    );
}

#[test]
fn tai_errors_of_kernel_and_gap_count() {
    let (mut kernel, mut watch) = (Kernel::new(), TaiWatch::new(FLOOR));
    kernel.reading.estimated_error = Nanos::from_micros(40);
    kernel.reading.after += Nanos(2_000);
    let now = watch.handle(kernel.next());
    assert_eq!(
        now.uncertainty,
        FLOOR + Nanos::from_micros(40) + Nanos(1_050)
    );
}

#[test]
fn tai_extreme_readings_do_not_panic() {
    let mut watch = TaiWatch::new(Nanos::MAX);
    for value in [i64::MIN, -1, 0, 1, i64::MAX] {
        for other in [i64::MIN, 0, i64::MAX] {
            let [a, b] = [Nanos(value), Nanos(other)];
            watch.handle(Reading {
                before: a,
                tai: b,
                after: b,
                max_error: a,
                estimated_error: b,
                tai_utc_s: 37,
                unsynchronised: false,
            });
        }
    }
}

//! Real-time code does not allocate, shown with the crate's own allocator installed; and the allocator
//! detects allocations.
//!
//! The count is the process's, so the tests that read it take turns.
#![cfg(not(loom))]

use std::{
    hint::black_box,
    ops::ControlFlow,
    process::Command,
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use takt_rt::{
    Nanos,
    alloc::{CountingAllocator, Guard, enter_real_time, real_time_allocations, set_guard},
    cycle::{Cycles, Follow, Grid, run_cycles},
    flight::{Entry, FlightRecorder},
    latest::latest,
    ring::ring,
    servo::{Estimate, Servo, ServoConfig},
    stats,
    thread::{ThreadConfig, spawn},
};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

static TURN: Mutex<()> = Mutex::new(());

fn take_turn() -> MutexGuard<'static, ()> {
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Allocator calls that `body` makes when marked as real-time.
fn allocations(body: impl FnOnce()) -> u64 {
    let _turn = take_turn();
    let before = real_time_allocations();
    let scope = enter_real_time();
    body();
    drop(scope);
    real_time_allocations() - before
}

#[test]
fn cycles_10000_allocate_nothing() {
    let (mut writer, reader) = stats::pair();
    let (mut image_out, mut image_in) = latest(1, || [0_u64; 64]);
    let (mut producer, mut consumer) = ring(16);
    let flight = FlightRecorder::new(64);
    let mut grid = Grid::new(Nanos(0), Duration::from_millis(1));
    let mut servo = Servo::new(&ServoConfig::new(Duration::from_millis(1)));
    let count = allocations(|| {
        for cycle in 0..10_000 {
            let late = Nanos(i64::try_from(cycle).unwrap() * 7_919 % 3_000_000);
            let tick = grid.next(grid.deadline() + late);
            image_out.write_with(|image| image.fill(cycle));
            black_box(image_in.read());
            let _ = producer.push(tick);
            let _ = producer.push(tick);
            black_box(consumer.pop());
            flight.record(Entry {
                cycle,
                source: "test",
                event: "late",
                value: late.0,
            });
            writer.record(&tick, tick.woken + late);
            // Steps, outliers and rest: every path of the servo.
            let step = Nanos(i64::try_from(cycle / 1_500).unwrap() * 40_000_000);
            servo.handle_sample(tick.scheduled, tick.time + step);
            grid.steer(&servo.estimate(), Nanos(300_000));
        }
    });
    assert_eq!(count, 0);
    assert_eq!(reader.snapshot().cycles, 10_000);
}

#[test]
fn cycle_thread_allocates_nothing() {
    let _turn = take_turn();
    let before = real_time_allocations();
    let (mut writer, reader) = stats::pair();
    let config = ThreadConfig {
        priority: Some(1),
        ..ThreadConfig::new("cycles")
    };
    let thread = spawn(config, move || {
        let mut cycles = 0;
        let _scope = enter_real_time();
        run_cycles(Duration::from_micros(20), None, &mut writer, |_| {
            cycles += 1;
            if cycles < 1_000 {
                ControlFlow::Continue(())
            } else {
                ControlFlow::Break(())
            }
        })
    });
    assert_eq!(thread.unwrap().join().unwrap(), 1_000);
    assert_eq!(real_time_allocations() - before, 0);
    assert_eq!(reader.snapshot().cycles, 1_000);
}

/// A driver thread that measures a clock and follows its own servo, with missed slots to record.
#[test]
fn cycle_thread_with_servo_allocates_nothing() {
    let _turn = take_turn();
    let before = real_time_allocations();
    let period = Duration::from_micros(50);
    let (mut clock_out, clock) = latest(1, Estimate::default);
    let (mut writer, reader) = stats::pair();
    let thread = spawn(ThreadConfig::new("disciplined"), move || {
        let flight = FlightRecorder::new(1_024);
        let mut servo = Servo::new(&ServoConfig {
            uncertainty_max: Nanos::from_millis(1),
            ..ServoConfig::new(period)
        });
        let scope = enter_real_time();
        let cycles = Cycles {
            follow: Some(Follow::new(clock, Nanos(10_000))),
            flight: Some(&flight),
            ..Cycles::every(period)
        };
        let mut left = 500;
        cycles.run(&mut writer, |tick| {
            // A clock 100 ppm fast, read without delay.
            let remote = Nanos(tick.woken.0 + tick.woken.0 / 10_000);
            servo.handle_sample(tick.woken, remote);
            clock_out.write(servo.estimate());
            left -= 1;
            if left > 0 {
                ControlFlow::Continue(())
            } else {
                ControlFlow::Break(())
            }
        });
        drop(scope);
        flight
    });
    let flight = thread.unwrap().join().unwrap();
    assert_eq!(real_time_allocations() - before, 0);
    let of_the_clock = |entry: Entry| entry.source == "clock";
    assert!(flight.entries().any(of_the_clock));
    // Whether the servo locks depends on the wake-up jitter of this host.
    assert_eq!(reader.snapshot().cycles, 500);
}

#[test]
fn allocator_counts_every_call_kind() {
    assert_eq!(
        allocations(|| drop(black_box(Box::new(1)))),
        2,
        "alloc and dealloc"
    );
    let mut vector: Vec<u64> = Vec::with_capacity(1);
    assert_eq!(
        allocations(|| vector.reserve_exact(black_box(100))),
        1,
        "realloc"
    );
    assert_eq!(
        allocations(|| drop(black_box(vec![0_u8; 100]))),
        2,
        "alloc_zeroed and dealloc"
    );
}

#[test]
fn allocator_ignores_ordinary_threads() {
    let count = allocations(|| ());
    assert_eq!(count, 0);
    let _turn = take_turn();
    let before = real_time_allocations();
    drop(black_box(Box::new(1)));
    std::thread::spawn(|| drop(black_box(Box::new(1))))
        .join()
        .unwrap();
    assert_eq!(real_time_allocations(), before);
}

const CHILD: &str = "TAKT_RT_TEST_ALLOCATE_AND_DIE";

/// Runs itself as a child process, which the first allocation ends.
#[test]
fn allocator_guard_aborts_on_first_allocation() {
    if std::env::var_os(CHILD).is_some() {
        set_guard(Guard::Abort);
        let thread = spawn(ThreadConfig::new("offender"), || {
            let _scope = enter_real_time();
            drop(black_box([0_u8; 4_321].to_vec()));
        });
        let _ = thread.unwrap().join();
        return;
    }
    let output = Command::new(std::env::current_exe().unwrap())
        .args([
            "--exact",
            "allocator_guard_aborts_on_first_allocation",
            "--nocapture",
        ])
        .env(CHILD, "1")
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert_eq!(
        text,
        "takt: real-time thread offender allocated or freed 4321 bytes; ending the run\n"
    );
}

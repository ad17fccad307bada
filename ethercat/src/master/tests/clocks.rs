//! Distributed clocks: delays, offsets, lock, SYNC0, and the samples by which the cycle is disciplined.

use super::*;
use crate::config::{ClockConfig, SyncSpec, Unlocked};
use crate::dc::{PhaseFigures, phase_ns};
use crate::emulator::{ServoConfig, ServoDrive};

const CYCLE: Duration = Duration::from_millis(1);
/// Phase in the period at which a frame should pass the reference clock, ns before SYNC0.
const BEFORE_SYNC0: i64 = 500_000;

/// Drives whose clocks show anything and drift by these, ppb.
fn drives(drifts: &[i64]) -> Segment {
    Segment::line((1..).zip(drifts).map(|(number, drift)| {
        let clock = (number * 0x1234_5678_9ABC, *drift);
        ServoDrive::slave(ServoConfig {
            needs_sync0: true,
            clock,
            ..ServoConfig::default()
        })
        .unwrap()
        .0
    }))
}

fn config(count: u16) -> MasterConfig {
    let slave = |position| SlaveSpec {
        sync: Some(SyncSpec::sync0(CYCLE)),
        ..SlaveSpec::new(format!("axis {position}"), Location::Position(position))
    };
    MasterConfig {
        slaves: (0..count).map(slave).collect(),
        ..MasterConfig::default()
    }
}

/// A simple servo that moves the cycle towards its wanted phase, as an owner would.
#[derive(Default)]
struct Servo {
    integral: f64,
    figures: PhaseFigures,
}

impl Servo {
    /// Delay of the next cycle, ns, given the lateness of this one.
    fn step(&mut self, sample: &Sample, noise: i64) -> f64 {
        let period = i64::try_from(CYCLE.as_nanos()).unwrap();
        let phase = i64::try_from(phase_ns(sample.system_ns, CYCLE, 0)).unwrap();
        let wanted = period - BEFORE_SYNC0;
        let late = (phase - wanted + period / 2).rem_euclid(period) - period / 2;
        self.figures.add(late - noise);
        let late = late as f64;
        self.integral += 0.002 * late;
        -(0.1 * late + self.integral)
    }
}

impl Rig {
    /// Cycles on a grid that a servo disciplines; each starts late by `noise`.
    fn disciplined(&mut self, count: usize, servo: &mut Servo, noise: impl Fn(usize) -> u32) {
        for n in 0..count {
            let (grid, late) = (self.now, noise(n));
            self.now += Duration::from_nanos(late.into());
            self.cycle();
            let mut next = i64::try_from((grid + CYCLE).as_nanos()).unwrap();
            if let Some(sample) = self.master.poll_sample() {
                #[expect(clippy::cast_possible_truncation, reason = "far below 2^63 ns")]
                let by = servo.step(&sample, late.into()) as i64;
                next += by;
            }
            self.now = Duration::from_nanos(next.unsigned_abs());
        }
    }
}

/// Lateness of a cycle, up to 20 us, the same in each run.
fn noise(n: usize) -> u32 {
    let n = u64::try_from(n)
        .unwrap()
        .wrapping_mul(0x9E37_79B9_7F4A_7C15);
    u32::try_from((n >> 40) % 20_001).unwrap()
}

#[test]
fn delays_are_those_of_the_line() {
    let mut rig = Rig::new(config(4), drives(&[0, 20_000, -20_000, 50_000]));
    rig.until(8000, |master| master.phase() == Phase::Running);
    let delays: Vec<_> = (0..4)
        .map(|n| rig.master.slave(n).unwrap().delay_ns())
        .collect();
    // Forwarding 300 ns and a cable of 100 ns from each to the next.
    for (number, delay) in (0_u32..).zip(delays) {
        assert!(
            delay.abs_diff(400 * number) <= 2,
            "slave {number}: {delay} ns"
        );
    }
}

#[test]
fn drifting_clocks_lock_and_sync0_is_simultaneous() {
    let mut rig = Rig::new(config(4), drives(&[50_000, -50_000, 100_000, 0]));
    let mut servo = Servo::default();
    for _ in 0..200 {
        rig.disciplined(100, &mut servo, |_| 0);
        if rig.master.is_operational() {
            break;
        }
    }
    assert!(rig.master.is_operational(), "{:?}", rig.events);
    rig.disciplined(2000, &mut servo, |_| 0);
    let starts: Vec<_> = (0..4)
        .map(|n| rig.master.slave(n).unwrap().sync_start_ns().unwrap() % 1_000_000)
        .collect();
    assert_eq!(starts, [0; 4]);
    for number in 0..4 {
        let slave = rig.master.slave(number).unwrap();
        let difference = slave.clock_difference_ns().unwrap();
        assert!(difference.abs() < 500, "slave {number}: {difference} ns");
        assert_eq!(slave.clock_violations(), 0);
        assert!(
            rig.segment
                .slave(number)
                .unwrap()
                .clock()
                .unwrap()
                .next_sync0()
                .is_some()
        );
    }
}

#[test]
fn cycle_keeps_phase_to_sync0_despite_noise_and_drift() {
    let mut rig = Rig::new(config(2), drives(&[50_000, -50_000]));
    let mut servo = Servo::default();
    rig.disciplined(4000, &mut servo, noise);
    assert!(rig.master.is_operational(), "{:?}", rig.events);
    servo.figures = PhaseFigures::default();
    rig.disciplined(2000, &mut servo, noise);
    // The mean lateness is part of the phase; what the servo adds to it is small.
    let rms = servo.figures.rms_ns();
    let mean = servo.figures.mean_ns();
    let around = (rms * rms - mean * mean).sqrt();
    assert!(
        around < 5000.0 && (mean + 10_000.0).abs() < 500.0,
        "{around} ns around {mean} ns"
    );
    assert!(rig.master.is_operational());
}

#[test]
fn clock_without_lock_is_handled_as_configured() {
    for unlocked in [Unlocked::Refuse, Unlocked::Start] {
        let clocks = ClockConfig {
            window_ns: 0,
            lock: Duration::from_millis(200),
            unlocked,
            ..ClockConfig::default()
        };
        let mut rig = Rig::new(
            MasterConfig {
                clocks,
                ..config(2)
            },
            drives(&[0, 900_000]),
        );
        rig.until(8000, |master| {
            master
                .slave(1)
                .is_some_and(|slave| slave.fault().is_some() || slave.is_running())
        });
        let fault = rig.master.slave(1).unwrap().fault();
        assert_eq!(
            matches!(fault, Some(Fault::Clock { window_ns: 0, .. })),
            unlocked == Unlocked::Refuse,
            "{fault:?}"
        );
    }
}

#[test]
fn sync0_without_clock_is_refused() {
    let (terminal, _) = Io::digital(4, 0);
    let mut rig = Rig::new(config(1), Segment::line([terminal]));
    rig.until(3000, |master| {
        master.slave(0).is_some_and(|slave| slave.fault().is_some())
    });
    let text = rig.master.slave(0).unwrap().fault().unwrap().to_string();
    assert!(
        text.starts_with("SYNC0 is wanted, and the slave has no clock"),
        "{text}"
    );
}

#[test]
fn slaves_without_required_sync0_report_it() {
    let mut rig = Rig::new(MasterConfig::default(), drives(&[0]));
    rig.until(6000, |master| {
        master.slave(0).is_some_and(|slave| slave.fault().is_some())
    });
    let text = rig.master.slave(0).unwrap().fault().unwrap().to_string();
    assert!(text.contains("(0030h)"), "{text}");
}

#[test]
fn reference_lost_is_replaced_by_another_clock() {
    let mut segment = drives(&[0, 30_000, -30_000]);
    segment.set_redundant(true);
    let mut rig = Rig::new(
        MasterConfig {
            redundant: true,
            ..config(3)
        },
        segment,
    );
    rig.until(9000, Master::is_operational);
    assert_eq!(rig.master.reference(), Some(0));
    rig.segment.set_power(0, false);
    rig.cycles(400);
    assert_eq!(rig.master.reference(), Some(1), "{:?}", rig.events);
    assert!(rig.master.poll_sample().is_some());
    assert!(
        (1..3).all(|slave| rig.master.slave(slave).unwrap().is_running()),
        "{:?}",
        rig.events
    );
    rig.segment.set_power(0, true);
    rig.until(9000, Master::is_operational);
    assert_eq!(rig.master.reference(), Some(1));
}

#[test]
fn clock_that_jumps_is_reported_and_recovers() {
    let mut rig = Rig::new(config(2), drives(&[0, 10_000]));
    rig.until(9000, Master::is_operational);
    rig.cycles(200);
    rig.events.clear();
    let now = u64::try_from(rig.now.as_nanos()).unwrap();
    rig.segment
        .slave(1)
        .unwrap()
        .clock()
        .unwrap()
        .jump(100_000, now);
    rig.cycles(3000);
    let texts: Vec<_> = rig.events.iter().map(ToString::to_string).collect();
    assert!(
        texts[0].starts_with("slave 1: its clock is ")
            && texts[0].contains(" ns from the reference"),
        "{texts:?}"
    );
    assert!(
        texts.contains(&"slave 1: its clock follows the reference again".to_owned()),
        "{texts:?}"
    );
    assert!(rig.master.slave(1).unwrap().clock_violations() >= 3);
}

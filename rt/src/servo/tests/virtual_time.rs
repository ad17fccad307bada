//! The servo's promises with drifting and stepping clocks, delays with tails, and silence.

use std::time::Duration;

use proptest::prelude::*;

use super::sim::{Bench, Random, Rms};
use crate::{
    Nanos,
    cycle::Grid,
    servo::{SampleOutcome, Servo, ServoConfig, State, phase_gain, rate_gain},
};

fn config(period_us: u64) -> ServoConfig {
    ServoConfig::new(Duration::from_micros(period_us))
}

/// From 1 ms and up to 200 ppm, with 20 us rms of noise: within 2 us rms two seconds later, at 1 kHz.
#[test]
fn servo_settles_within_2_s_to_2_us() {
    for (seed, drift_ppm) in [(1, 100.0), (2, -100.0), (3, 200.0), (4, -200.0), (5, 0.0)] {
        for offset in [Nanos::from_millis(1), Nanos::from_millis(-1)] {
            let mut bench = Bench::new(&config(1_000), offset, drift_ppm * 1e3);
            let mut random = Random::new(seed);
            let (mut after, mut worst) = (Rms::default(), 0.0_f64);
            for cycle in 0..12_000 {
                bench.sample(random.normal() * 20e3);
                if cycle >= 2_000 {
                    after.add(bench.error_ns());
                    worst = worst.max(bench.error_ns().abs());
                }
            }
            assert!(after.get() < 2e3, "{drift_ppm} ppm: {} ns rms", after.get());
            assert!(worst < 8e3, "{drift_ppm} ppm: {worst} ns");
            assert_eq!(bench.servo.state(), State::Stable);
        }
    }
}

/// The noise gain matches the theory at every period: sqrt(2.75 / N).
#[test]
fn servo_noise_gain_matches_theory() {
    for period_us in [250, 1_000, 4_000, 12_000, 50_000] {
        let config = config(period_us);
        let mut bench = Bench::new(&config, Nanos::from_millis(1), 100e3);
        let mut random = Random::new(period_us);
        let mut rms = Rms::default();
        for cycle in 0..60_000 {
            bench.sample(random.normal() * 20e3);
            if cycle >= 4 * config.memory {
                rms.add(bench.error_ns());
            }
        }
        let expected = 20e3 * (2.75 / f64::from(config.memory)).sqrt();
        let ratio = rms.get() / expected;
        assert!((0.8..1.25).contains(&ratio), "{period_us} us: {ratio}");
        assert!(rms.get() < 2e3);
        assert_eq!(bench.servo.state(), State::Stable, "{period_us} us");
    }
}

/// A network: each sample a little late, one in a hundred much, and now and then ten in a row.
#[test]
fn servo_tolerates_queueing_delays() {
    let mut bench = Bench::usual();
    let mut random = Random::new(11);
    let mut rms = Rms::default();
    let mut burst = 0;
    for cycle in 0..60_000 {
        burst = if burst == 0 && random.uniform() < 0.001 {
            10
        } else {
            burst.max(1) - 1
        };
        let tail = if random.uniform() < 0.01 {
            300e3 * random.exponential()
        } else {
            0.0
        };
        let queue = if burst > 0 {
            1e6 * random.exponential()
        } else {
            0.0
        };
        bench.sample(-(5e3 * random.exponential() + tail + queue));
        if cycle >= 2_000 {
            // The mean delay of 5 us cannot be distinguished from an offset.
            rms.add(bench.error_ns() + 5e3);
        }
    }
    assert!(rms.get() < 2e3, "{} ns rms", rms.get());
    assert_eq!(bench.servo.state(), State::Stable);
}

/// A queue may spoil the very first samples too.
#[test]
fn servo_tolerates_late_first_samples() {
    for seed in 0..50 {
        let mut bench = Bench::usual();
        let mut random = Random::new(seed);
        for cycle in 0..200 {
            let late = if cycle % 5 == seed % 5 {
                3e6 * random.uniform()
            } else {
                0.0
            };
            bench.sample(random.normal() * 2e3 - late);
        }
        assert!(
            bench.error_ns().abs() < 5e3,
            "{seed}: {} ns",
            bench.error_ns()
        );
        assert!(bench.servo.state().is_followed(), "{seed}");
    }
}

#[test]
fn servo_tolerates_lost_samples() {
    let mut bench = Bench::usual();
    let mut random = Random::new(13);
    let mut rms = Rms::default();
    for cycle in 0..30_000 {
        if random.uniform() < 0.3 {
            bench.lose();
            continue;
        }
        bench.sample(random.normal() * 20e3);
        if cycle >= 3_000 {
            rms.add(bench.error_ns());
        }
    }
    assert!(rms.get() < 2.5e3, "{} ns rms", rms.get());
    assert_eq!(bench.servo.state(), State::Stable);
}

/// Without samples the clock stays within its stated uncertainty until it expires; and it returns
/// without a step.
#[test]
fn servo_holdover_stays_within_uncertainty() {
    let mut bench = Bench::stable();
    let drift = bench.drift_ppb;
    let mut seconds = 0;
    // The quartz wanders by 0.5 ppm meanwhile.
    bench.drift_ppb = drift + 500.0;
    loop {
        (0..1_000).for_each(|_| bench.lose());
        seconds += 1;
        bench.servo.handle_time(bench.now);
        if bench.servo.state() != State::Holdover {
            break;
        }
        let stated = bench.servo.estimate().uncertainty_at(bench.now).to_f64();
        assert!(bench.error_ns().abs() < stated, "after {seconds} s");
        assert!(stated <= 100e3);
        if seconds == 2 {
            let back = bench.sample(0.0);
            assert_eq!(
                (back.outcome, bench.servo.state()),
                (SampleOutcome::Used, State::Locked)
            );
            bench.run(5_000, || 0.0);
            assert_eq!(bench.servo.state(), State::Stable);
        }
    }
    assert_eq!(bench.servo.state(), State::Unlocked);
    assert!((4..60).contains(&seconds), "{seconds} s");
}

/// Steps are followed within 16 samples and the time to find the line; small ones at 0.5 %.
#[test]
fn servo_real_steps_are_followed() {
    for (step_us, outcome) in [
        (300, SampleOutcome::Slewing),
        (-900, SampleOutcome::Slewing),
        (1_100, SampleOutcome::Stepped),
        (-20_000, SampleOutcome::Stepped),
        (3_600_000_000, SampleOutcome::Stepped),
    ] {
        let mut bench = Bench::stable();
        let mut random = Random::new(17);
        bench.step(Nanos::from_micros(step_us));
        let outcomes: Vec<_> = (0..16)
            .map(|_| bench.sample(random.normal() * 20e3).outcome)
            .collect();
        assert_eq!(outcomes[..15], [SampleOutcome::Outlier; 15], "{step_us} us");
        assert_eq!(outcomes[15], outcome, "{step_us} us");
        bench.run(1_500, || random.normal() * 20e3);
        assert!(
            bench.error_ns().abs() < 8e3,
            "{step_us} us: {}",
            bench.error_ns()
        );
        assert_eq!(bench.servo.state(), State::Stable, "{step_us} us");
    }
}

/// Another device becomes the clock source: another rate, another phase.
#[test]
fn servo_new_rate_is_found() {
    for (period_us, ppm) in [(1_000, 300.0), (50_000, 300.0), (50_000, -50.0)] {
        let mut bench = Bench::new(&config(period_us), Nanos::ZERO, 100e3);
        let mut random = Random::new(19);
        bench.run(5_000, || random.normal() * 20e3);
        bench.drift_ppb += ppm * 1e3;
        bench.run(5_000, || random.normal() * 20e3);
        assert!(
            bench.error_ns().abs() < 8e3,
            "{period_us}: {}",
            bench.error_ns()
        );
        assert_eq!(bench.servo.state(), State::Stable);
    }
}

/// Lasting noise widens the gate.
#[test]
fn servo_increased_noise_widens_gate() {
    let mut bench = Bench::stable();
    let mut random = Random::new(23);
    bench.run(10_000, || random.normal() * 200e3);
    assert!(bench.servo.state().is_followed());
    let outliers = (0..1_000)
        .filter(|_| bench.sample(random.normal() * 200e3).outcome == SampleOutcome::Outlier);
    assert!(outliers.count() < 5);
    assert!(bench.error_ns().abs() < 80e3, "{}", bench.error_ns());
}

/// A driver with a repeating time stamp does not stay locked.
#[test]
fn servo_stopped_clock_is_rejected() {
    let mut bench = Bench::stable();
    let stuck = bench.remote();
    for _ in 0..64 {
        bench.lose();
        bench.servo.handle_sample(bench.now, stuck);
    }
    for _ in 0..1_000 {
        bench.lose();
        bench.servo.handle_sample(bench.now, stuck);
        assert!(!bench.servo.state().is_followed());
    }
}

#[test]
fn servo_excessive_drift_is_rejected_rate_clamped() {
    let mut bench = Bench::new(&config(1_000), Nanos::ZERO, 2e6);
    for _ in 0..5_000 {
        bench.sample(0.0);
        assert!(!bench.servo.state().is_followed());
    }
    let mut bench = Bench::new(&config(1_000), Nanos::ZERO, 499e3);
    let mut random = Random::new(29);
    for _ in 0..5_000 {
        let frequency_ppb = bench.sample(random.normal() * 20e3).frequency_ppb;
        assert!(frequency_ppb.abs() <= 500_000.001);
    }
    assert_eq!(bench.servo.state(), State::Stable);
}

#[test]
fn servo_local_time_step_back_is_finally_accepted() {
    let mut bench = Bench::stable();
    let (now, remote) = (bench.now, bench.remote());
    for back in 0..15 {
        let at = now - Nanos::from_millis(back);
        assert_eq!(
            bench.servo.handle_sample(at, remote).outcome,
            SampleOutcome::Disordered
        );
    }
    assert_eq!(bench.sample(0.0).outcome, SampleOutcome::Used);
    bench.now = Nanos::ZERO;
    bench.run(1_000, || 0.0);
    assert!(bench.servo.state().is_followed());
    // One stamp from the far future ends the lock, but not for ever.
    bench.servo.handle_sample(Nanos::MAX, Nanos::ZERO);
    bench.run(1_000, || 0.0);
    assert!(bench.servo.state().is_followed());
}

/// A grid that follows all of the above keeps its least distance, and its phase within 2 us rms.
#[test]
fn servo_steered_grid_keeps_phase_and_spacing() {
    for (period_us, offset_us) in [
        (250, 100),
        (1_000, 499),
        (4_000, -1_900),
        (12_000, 1_000),
        (50_000, 20_000),
    ] {
        let config = config(period_us);
        let mut bench = Bench::new(&config, Nanos::from_micros(offset_us), 100e3);
        let mut grid = Grid::new(Nanos::ZERO, config.period);
        let phase = Nanos(bench.period.0 * 3 / 10);
        let mut random = Random::new(31);
        let (mut before, mut rms) = (None, Rms::default());
        for cycle in 0..10_000 {
            if cycle == 5_000 {
                bench.step(Nanos(bench.period.0 / 3));
            }
            bench.sample(random.normal() * 20e3);
            let estimate = bench.servo.estimate();
            if estimate.is_valid_at(bench.now) {
                grid.steer(&estimate, phase);
            }
            let tick = grid.next(grid.deadline());
            if let Some(before) = before.replace(tick.scheduled) {
                let spacing = tick.scheduled - before;
                let most = bench.period.0 / 200;
                assert!((spacing - bench.period).abs() <= Nanos(most), "{spacing}");
            }
            // The true phase, of the true clock.
            let remote = tick.scheduled - bench.now;
            let at =
                bench.remote() + Nanos::from_f64(remote.to_f64() * (1.0 + bench.drift_ppb * 1e-9));
            let behind = (at - phase).0.rem_euclid(bench.period.0);
            let error = if behind > bench.period.0 / 2 {
                behind - bench.period.0
            } else {
                behind
            };
            if (2_000..5_000).contains(&cycle) || cycle >= 7_000 {
                rms.add(Nanos(error).to_f64());
            }
        }
        assert!(rms.get() < 2.5e3, "{period_us} us: {} ns rms", rms.get());
    }
}

/// After holdover the phase is found at once, not with the gains of a full memory; and a clock that has
/// wandered no further than stated is let in.
#[test]
fn servo_recovers_quickly_from_holdover() {
    let mut bench = Bench::stable();
    bench.drift_ppb += 20_000.0;
    (0..3_000).for_each(|_| bench.lose());
    bench.servo.handle_time(bench.now);
    assert_eq!(bench.servo.state(), State::Holdover);
    assert!(bench.error_ns() < -30e3);
    bench.run(100, || 0.0);
    assert!(bench.error_ns().abs() < 5e3, "{}", bench.error_ns());

    let mut bench = Bench::usual();
    bench.run(2_000, || 0.0);
    bench.drift_ppb += 500.0;
    (0..30_000).for_each(|_| bench.lose());
    bench.servo.handle_time(bench.now);
    let back = bench.sample(0.0);
    assert!(back.error > Nanos::from_micros(10), "{}", back.error);
    assert_eq!(back.outcome, SampleOutcome::Used);
}

/// Samples in a burst contain little information about the rate.
#[test]
fn servo_burst_keeps_rate() {
    let mut bench = Bench::stable();
    for _ in 0..10 {
        bench.now += Nanos::from_micros(1);
        let remote = bench.remote() - Nanos::from_micros(60);
        let frequency_ppb = bench.servo.handle_sample(bench.now, remote).frequency_ppb;
        assert!(
            (frequency_ppb - bench.drift_ppb).abs() < 50e3,
            "{frequency_ppb}"
        );
    }
}

/// Outliers count in a row only: with a good sample among them they are neither a step nor the end.
#[test]
fn servo_good_sample_resets_outlier_count() {
    let mut bench = Bench::stable();
    for _ in 0..5 {
        for _ in 0..15 {
            assert_eq!(bench.sample(5e6).outcome, SampleOutcome::Outlier);
        }
        assert_eq!(bench.sample(0.0).outcome, SampleOutcome::Used);
    }
    let mut bench = Bench::usual();
    bench.run(2_000, || 0.0);
    for _ in 0..5 {
        for i in 0..20 {
            bench.sample(if i % 2 == 0 { 50e6 } else { -50e6 });
        }
        assert_eq!(bench.sample(0.0).outcome, SampleOutcome::Used);
        assert!(bench.error_ns().abs() < 10e3, "{}", bench.error_ns());
    }
}

/// A large step while a small one is still being slewed leaves nothing behind.
#[test]
fn servo_step_ends_slew() {
    let config = ServoConfig {
        slew_max_ppb: 100_000,
        ..config(1_000)
    };
    let mut bench = Bench::new(&config, Nanos::ZERO, 0.0);
    bench.run(1_000, || 0.0);
    bench.step(Nanos::from_micros(900));
    bench.run(1_000, || 0.0);
    assert!(bench.error_ns() < -700e3, "still slewing");
    bench.step(Nanos::from_millis(5));
    bench.run(16, || 0.0);
    assert!(bench.error_ns().abs() < 10.0, "{}", bench.error_ns());
}

/// The gains are those of the least-squares line.
#[test]
fn servo_gains_match_least_squares() {
    let mut random = Random::new(37);
    let samples: Vec<f64> = (0..100).map(|_| random.normal()).collect();
    let (mut phase, mut rate) = (0.0, 0.0);
    for (n, sample) in (1..).zip(&samples) {
        let error = sample - (phase + rate);
        phase += rate + phase_gain(n) * error;
        // One sample has no slope.
        rate += if n > 1 { rate_gain(n) * error } else { 0.0 };
    }
    let mean = samples.iter().sum::<f64>() / 100.0;
    let moment: f64 = (0..)
        .zip(&samples)
        .map(|(i, y)| (f64::from(i) - 49.5) * y)
        .sum();
    let slope = moment / (100.0 * (100.0 * 100.0 - 1.0) / 12.0);
    assert!((rate - slope).abs() < 1e-12, "{rate} {slope}");
    assert!((phase - (mean + 49.5 * slope)).abs() < 1e-12);
}

/// The published clock never exceeds the slew limit while it is followed.
fn assert_smooth(config: &ServoConfig, samples: impl IntoIterator<Item = (Nanos, Nanos)>) {
    let mut servo = Servo::new(config);
    for (local, remote) in samples {
        let before = servo.estimate();
        let correction = servo.handle_sample(local, remote);
        let after = servo.estimate();
        assert!(correction.frequency_ppb.abs() <= 500_000.001);
        assert!(after.uncertainty >= Nanos::ZERO && after.uncertainty_ppb.is_finite());
        let is_step = matches!(
            correction.outcome,
            SampleOutcome::Stepped | SampleOutcome::Restarted
        );
        if before.state.is_followed() && after.state.is_followed() && !is_step {
            let moved = (after.remote_at(after.local) - before.remote_at(after.local)).abs();
            let room = (after.local - before.local).to_f64() * 0.005 + 3.0;
            assert!(moved.to_f64() <= room, "{moved} at {}", after.local);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Invalid input causes neither a panic nor invalid output.
    #[test]
    fn servo_extreme_samples_do_not_panic(
        samples in proptest::collection::vec((any::<i64>(), any::<i64>()), 1..200),
        period in any::<u64>(),
    ) {
        let samples = samples.into_iter().map(|(local, remote)| (Nanos(local), Nanos(remote)));
        assert_smooth(&ServoConfig::new(Duration::from_nanos(period)), samples);
    }

    /// Clocks with noise, losses and steps of all kinds.
    #[test]
    fn servo_published_clock_is_smooth(
        seed: u64,
        noise_us in 0.0..200.0_f64,
        loss in 0.0..0.5_f64,
        steps in proptest::collection::vec((0_usize..3_000, -3_000_i64..3_000), 0..4),
    ) {
        let config = config(1_000);
        let mut random = Random::new(seed);
        let mut offset = 0;
        let samples = (0..3_000).filter_map(|cycle| {
            offset += steps.iter().filter(|step| step.0 == cycle).map(|step| step.1 * 1_000).sum::<i64>();
            let local = Nanos::from_millis(i64::try_from(cycle).unwrap());
            let noise = Nanos::from_f64(random.normal() * noise_us * 1e3);
            (random.uniform() >= loss).then_some((local, local + Nanos(offset) + noise))
        });
        assert_smooth(&config, samples);
    }
}

//! A device's clock and the noise of its samples, in virtual time. Seeded: a failure can be repeated.

use std::time::Duration;

use crate::{
    Nanos,
    servo::{Correction, Servo, ServoConfig},
};

/// Random numbers, the same at each run.
pub(super) struct Random(u64);

impl Random {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    /// In (0, 1).
    pub(super) fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        ((self.0 >> 12) as f64 + 0.5) / (1_u64 << 52) as f64
    }

    /// Of standard deviation 1.
    pub(super) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// Of mean 1, never negative: the delay of a queue.
    pub(super) fn exponential(&mut self) -> f64 {
        -self.uniform().ln()
    }
}

/// A servo, the clock it follows and the time.
pub(super) struct Bench {
    pub(super) servo: Servo,
    pub(super) period: Nanos,
    pub(super) now: Nanos,
    remote_ns: f64,
    pub(super) drift_ppb: f64,
}

impl Bench {
    pub(super) fn new(config: &ServoConfig, offset: Nanos, drift_ppb: f64) -> Self {
        Self {
            servo: Servo::new(config),
            period: config.period.into(),
            now: Nanos::ZERO,
            remote_ns: offset.to_f64(),
            drift_ppb,
        }
    }

    /// At a millisecond, 1 ms and 100 ppm off, as first met.
    pub(super) fn usual() -> Self {
        let config = ServoConfig::new(Duration::from_millis(1));
        Self::new(&config, Nanos::from_millis(1), 100_000.0)
    }

    /// The same after ten seconds of samples with 20 us rms noise.
    pub(super) fn stable() -> Self {
        let mut bench = Self::usual();
        let mut random = Random::new(7);
        for _ in 0..10_000 {
            bench.sample(random.normal() * 20e3);
        }
        assert_eq!(bench.servo.state(), crate::servo::State::Stable);
        bench
    }

    /// A period goes by without a sample.
    pub(super) fn lose(&mut self) {
        let period = self.period.to_f64();
        self.now += self.period;
        self.remote_ns += period * (1.0 + self.drift_ppb * 1e-9);
    }

    /// A period goes by; at its end comes a sample, `noise_ns` too high.
    pub(super) fn sample(&mut self, noise_ns: f64) -> Correction {
        self.lose();
        let remote = Nanos::from_f64(self.remote_ns + noise_ns);
        self.servo.handle_sample(self.now, remote)
    }

    /// So many samples with noise from `noise_ns`.
    pub(super) fn run(&mut self, count: usize, mut noise_ns: impl FnMut() -> f64) {
        for _ in 0..count {
            self.sample(noise_ns());
        }
    }

    /// The remote clock jumps.
    pub(super) fn step(&mut self, by: Nanos) {
        self.remote_ns += by.to_f64();
    }

    pub(super) fn remote(&self) -> Nanos {
        Nanos::from_f64(self.remote_ns)
    }

    /// By how much the servo's clock is ahead of the true one, ns.
    pub(super) fn error_ns(&self) -> f64 {
        (self.servo.estimate().remote_at(self.now) - self.remote()).to_f64()
    }
}

/// Root of the mean square.
#[derive(Default)]
pub(super) struct Rms {
    sum: f64,
    count: f64,
}

impl Rms {
    pub(super) fn add(&mut self, value: f64) {
        self.sum += value * value;
        self.count += 1.0;
    }

    pub(super) fn get(&self) -> f64 {
        (self.sum / self.count).sqrt()
    }
}

//! The clock servo: finds from samples (local time, remote time) how a device's clock runs, so that a
//! cycle thread can keep its phase. One servo for all drivers: datagrams of a robot controller,
//! distributed clocks of a fieldbus, a SYNC message.
//!
//! It reads no clock, steers no thread and knows no bus: time comes in as arguments, and what goes out is
//! an [`Estimate`], which [`cycle`](crate::cycle) follows.
//!
//! # Theory
//!
//! The servo keeps a clock of its own, a line through the samples, which it corrects in phase and
//! frequency by every sample's error `e` (remote time minus that of the line): a proportional and an
//! integral part, `phase += Kp·e`, `frequency += Ki·e/T`, where `T` is the time between samples. With
//!
//! ```text
//! Kp(n) = 2 (2n - 1) / (n (n + 1))        Ki(n) = 6 / (n (n + 1))
//! ```
//!
//! the n-th sample makes that line the least-squares line through all n. No gains do better on a
//! clock of constant rate and white noise, and there is nothing to overshoot. At `n = N`, the
//! [`memory`](ServoConfig::memory), they stop to fall, and what was a fit becomes a loop:
//!
//! | of the loop | in general | N = 512, T = 1 ms |
//! |---|---|---|
//! | gains | Kp = 4/N, Ki = 6/N² | 0.0078, 2.3e-5 |
//! | natural frequency | √Ki / T = 2.45 / (N T) | 4.8 rad/s |
//! | damping | Kp / (2 √Ki) | 0.82 |
//! | noise bandwidth, one-sided | (Kp + Ki/Kp) / (4 T) = 1.4 / (N T) | 2.7 Hz |
//! | rms phase error per rms sample noise | √((Kp + Ki/Kp) / 2) = √(2.75 / N) | 0.073 |
//! | settling of a small disturbance, 4/(ζ ω) | 2 N T | 1 s |
//! | lag behind a rate that changes by a ppm/s | 1 µs / ω² | 43 ns |
//!
//! N is counted in samples, so all rows hold at every period, seconds apart.
//!
//! Delays have tails. A sample further off than six times the mean deviation is an outlier: not used, but
//! kept. Sixteen outliers in a row that agree among themselves are a step of the remote clock; four times
//! sixteen that do not are the end of the lock. So nothing real is rejected for ever.
//!
//! # States
//!
//! ```text
//!                (1)             (3)               (5)
//!   UNLOCKED ─────────► JUMP ─────────► LOCKED ─────────► STABLE
//!    ▲  ▲  ▲             │ ▲             │ │ ▲ ▲             │ │
//!    │  │  └─────(2)─────┘ └──────(4)────┴─│─│─│─────────────┤ │
//!    │  │                                  │ │ └──────(6)────┘ │
//!    │  │                               (7)│ │(8)              │(7)
//!    │  └──────────(9)───────────────── HOLDOVER ◄─────────────┘
//!    └── (10) from any other
//! ```
//!
//! | | from → to | when | made by |
//! |---|---|---|---|
//! | 1 | unlocked → jump | a sample: the clock is set to it | `begin` |
//! | 2 | jump → unlocked | no sample for 16 periods; or the first 16 fit no clock that runs within [`drift_max_ppb`](ServoConfig::drift_max_ppb) | `handle_time`, `acquire` |
//! | 3 | jump → locked | 32 samples, and uncertainty within [`uncertainty_max`](ServoConfig::uncertainty_max) | `settle` |
//! | 4 | locked, stable, holdover → jump | a step above [`step_above`](ServoConfig::step_above); a second step before the first is absorbed (then the frequency is measured anew); 64 outliers in a row that fit nothing | `relocate`, `outlier` |
//! | 5 | locked → stable | the memory is full, smoothed error and slew left within [`stable_within`](ServoConfig::stable_within) | `settle` |
//! | 6 | stable → locked | smoothed error beyond three times that; a smaller step, which is slewed | `settle`, `relocate` |
//! | 7 | locked, stable → holdover | no sample was good for 16 periods | `handle_time` |
//! | 8 | holdover → locked | a good sample, or a smaller step | `settle`, `relocate` |
//! | 9 | holdover → unlocked | uncertainty has grown beyond its bound | `handle_time` |
//! | 10 | any → unlocked, and 1 at once | 16 samples in a row older than one before: the local time went back | `disordered` |

mod config;
mod estimate;
mod fit;

use self::{
    config::Bounds,
    fit::{Fit, WINDOW, Window},
};
pub use self::{
    config::ServoConfig,
    estimate::{Estimate, State},
};
use crate::Nanos;

/// Samples before a line counts as locked.
const LOCK_SAMPLES: u32 = 32;
/// A sample is an outlier beyond so many mean deviations: 4.8 standard deviations of white noise.
const GATE: f64 = 6.0;
/// What one sample may claim as its deviation, in mean deviations, so that an outlier widens the gate a
/// little only. Many do: noise that grows for good is let in.
const DEVIATION_MAX: f64 = 2.5;
/// Windows of outliers that fit nothing before the lock is given up.
const STRIKES: u8 = 4;
/// Share of a sample in the mean deviation and in the smoothed error.
const SMOOTHING: f64 = 1.0 / 64.0;
/// Periods without a good sample before holdover.
const SILENCE: i64 = 16;
/// Standard deviation of white noise over its mean deviation.
const SIGMA: f64 = 1.25;
/// Uncertainties are three standard deviations.
const CONFIDENCE: f64 = 3.0;
/// How far a quartz left alone may run from its rate, as a ratio: 1 ppm.
const WANDER: f64 = 1e-6;

/// What became of a sample, and what it did to the servo's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    /// What became of the sample.
    pub fate: Fate,
    /// The sample's remote time minus that of the servo's clock before.
    pub error: Nanos,
    /// By how much the servo's clock was set forward now.
    pub phase: Nanos,
    /// How much faster than the local clock it runs from now on, ppb.
    pub frequency_ppb: f64,
}

/// What became of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// It corrected the clock, or waits for the first line to be drawn.
    Used,
    /// Too far off; not used.
    Outlier,
    /// Not newer than one before; not used.
    Disordered,
    /// The last of sixteen that prove a step, which the clock will make good bit by bit.
    Slewing,
    /// The last of sixteen that prove a step, which the clock has made.
    Stepped,
    /// The clock was set anew.
    Restarted,
}

/// The servo.
#[derive(Debug, Clone)]
pub struct Servo {
    bounds: Bounds,
    state: State,
    /// The line: at `local` the remote clock shows `remote + fraction_ns`, and gains `drift` per unit.
    local: Nanos,
    remote: Nanos,
    fraction_ns: f64,
    drift: f64,
    /// By how much the line is ahead of the clock given out, which may not move as fast.
    lag_ns: f64,
    /// Samples that the line's phase rests on, and its rate; both end at the memory. 0 while the first
    /// window fills.
    phase_samples: u32,
    rate_samples: u32,
    /// Mean deviation of the samples.
    noise_ns: f64,
    /// Smoothed error.
    smooth_ns: f64,
    /// The first samples, later the outliers since the last good one.
    window: Window,
    strikes: u8,
    /// Local time of the newest sample, good or not.
    newest: Nanos,
    disordered: usize,
}

impl Servo {
    /// A servo without a sample.
    pub fn new(config: &ServoConfig) -> Self {
        let bounds = Bounds::new(config);
        Self {
            bounds,
            state: State::Unlocked,
            local: Nanos::ZERO,
            remote: Nanos::ZERO,
            fraction_ns: 0.0,
            drift: 0.0,
            lag_ns: 0.0,
            phase_samples: 0,
            rate_samples: 0,
            noise_ns: bounds.noise_min_ns,
            smooth_ns: 0.0,
            window: Window::default(),
            strikes: 0,
            newest: Nanos::ZERO,
            disordered: 0,
        }
    }

    /// At `local` the remote clock showed `remote`. Whatever delay the driver knows (its own lateness, a
    /// cable) it should take out before. Bounded: at worst one sort of 120 numbers.
    pub fn handle_sample(&mut self, local: Nanos, remote: Nanos) -> Correction {
        self.handle_time(local);
        if self.state == State::Unlocked {
            return self.begin(local, remote);
        }
        let error = self.error(local, remote);
        if local <= self.newest {
            return self.disordered(local, remote, error);
        }
        self.newest = local;
        self.disordered = 0;
        if self.phase_samples == 0 {
            return self.acquire(local, error);
        }
        let gate = (GATE * self.noise_ns).max(self.uncertainty_ns(local));
        let deviation = error.abs().min(DEVIATION_MAX * self.noise_ns);
        self.noise_ns += (deviation - self.noise_ns) * SMOOTHING;
        self.noise_ns = self.noise_ns.max(self.bounds.noise_min_ns);
        if error.abs() > gate {
            self.outlier(local, remote, error)
        } else {
            self.accept(local, error)
        }
    }

    /// It is `now`, on the local clock: notices that samples have stopped. Wanted only while none come.
    pub fn handle_time(&mut self, now: Nanos) {
        let silence = Nanos(self.bounds.period.0.saturating_mul(SILENCE));
        match self.state {
            State::Jump if now - self.newest > silence => self.state = State::Unlocked,
            State::Locked | State::Stable if now - self.local > silence => {
                self.state = State::Holdover;
            }
            State::Unlocked | State::Jump | State::Locked | State::Stable | State::Holdover => {}
        }
        if self.state == State::Holdover && now >= self.expires() {
            self.state = State::Unlocked;
        }
    }

    /// How well it follows.
    pub fn state(&self) -> State {
        self.state
    }

    /// Its clock, to be handed to those who follow it.
    pub fn estimate(&self) -> Estimate {
        Estimate {
            state: self.state,
            local: self.local,
            remote: self.remote + Nanos::from_f64(self.fraction_ns - self.lag_ns),
            frequency_ppb: self.drift * 1e9,
            uncertainty: Nanos::from_f64(self.phase_uncertainty_ns() + self.lag_ns.abs()),
            uncertainty_ppb: self.rate_uncertainty() * 1e9,
            expires: self.expires(),
        }
    }

    /// Mean deviation of the samples from the line.
    pub fn noise(&self) -> Nanos {
        Nanos::from_f64(self.noise_ns)
    }

    /// Remote time minus that of the line, ns.
    fn error(&self, local: Nanos, remote: Nanos) -> f64 {
        let span = local - self.local;
        (remote - self.remote - span).to_f64() - self.drift * span.to_f64() - self.fraction_ns
    }

    /// Transition 1.
    fn begin(&mut self, local: Nanos, remote: Nanos) -> Correction {
        *self = Self {
            bounds: self.bounds,
            state: State::Jump,
            local,
            remote,
            fraction_ns: 0.0,
            drift: 0.0,
            lag_ns: 0.0,
            phase_samples: 0,
            rate_samples: 0,
            noise_ns: self.bounds.noise_min_ns,
            smooth_ns: 0.0,
            window: Window::default(),
            strikes: 0,
            newest: local,
            disordered: 0,
        };
        self.window.push(0.0, 0.0);
        self.correction(Fate::Restarted, 0.0, 0.0)
    }

    /// One of the first samples. The last of them draws the line.
    fn acquire(&mut self, local: Nanos, error: f64) -> Correction {
        let Some(fit) = self.window.push((local - self.local).to_f64(), error) else {
            return self.correction(Fate::Used, error, 0.0);
        };
        if !self.is_clock(&fit) || fit.deviation > self.bounds.period.to_f64() / 2.0 {
            self.state = State::Unlocked;
            return self.correction(Fate::Outlier, error, 0.0);
        }
        self.adopt(local, &fit);
        self.noise_ns = fit.deviation.max(self.bounds.noise_min_ns);
        self.correction(Fate::Restarted, error, fit.last)
    }

    /// Takes phase and frequency from the window.
    fn adopt(&mut self, local: Nanos, fit: &Fit) {
        self.advance(local, fit.last);
        self.turn(fit.slope);
        self.lag_ns = 0.0;
        self.smooth_ns = 0.0;
        (self.phase_samples, self.rate_samples) = (WINDOW_SAMPLES, WINDOW_SAMPLES);
        self.window.clear();
        self.strikes = 0;
        self.state = State::Jump;
    }

    /// The proportional and integral step.
    fn accept(&mut self, local: Nanos, error: f64) -> Correction {
        let span = (local - self.local).to_f64();
        self.phase_samples = (self.phase_samples + 1).min(self.bounds.memory);
        self.rate_samples = (self.rate_samples + 1).min(self.bounds.memory);
        let step = phase_gain(self.phase_samples) * error;
        // Who follows must not see the clock run faster than it may; what is left over waits.
        let room = if self.state == State::Jump {
            f64::MAX
        } else {
            self.bounds.slew * span
        };
        let moved = (self.lag_ns + step).clamp(-room, room);
        self.lag_ns += step - moved;
        self.advance(local, step);
        // Samples in a burst must not divide by nearly nothing.
        self.turn(rate_gain(self.rate_samples) * error / span.max(self.bounds.period.to_f64()));
        self.smooth_ns += (error - self.smooth_ns) * SMOOTHING;
        self.window.clear();
        self.strikes = 0;
        self.settle();
        self.correction(Fate::Used, error, moved)
    }

    /// Transitions 3, 5, 6 and 8, after a good sample.
    fn settle(&mut self) {
        let within = self.bounds.stable_within_ns;
        match self.state {
            State::Jump => {
                let is_sure = self.phase_uncertainty_ns() <= self.bounds.uncertainty_max_ns;
                if self.phase_samples >= LOCK_SAMPLES && is_sure {
                    self.state = State::Locked;
                }
            }
            State::Locked => {
                let is_full = self.phase_samples.min(self.rate_samples) == self.bounds.memory;
                if is_full && self.smooth_ns.abs() <= within && self.lag_ns.abs() <= within {
                    self.state = State::Stable;
                }
            }
            State::Stable => {
                if self.smooth_ns.abs() > 3.0 * within {
                    self.state = State::Locked;
                }
            }
            State::Holdover => {
                // The phase has to be found again; the rate is what it was.
                self.phase_samples = self.phase_samples.min(LOCK_SAMPLES);
                self.state = State::Locked;
            }
            State::Unlocked => {}
        }
    }

    fn outlier(&mut self, local: Nanos, remote: Nanos, error: f64) -> Correction {
        let Some(fit) = self.window.push((local - self.local).to_f64(), error) else {
            return self.correction(Fate::Outlier, error, 0.0);
        };
        self.window.clear();
        if self.is_clock(&fit) && fit.deviation <= GATE / 2.0 * self.noise_ns {
            return self.relocate(local, error, &fit);
        }
        self.strikes += 1;
        if self.strikes < STRIKES {
            return self.correction(Fate::Outlier, error, 0.0);
        }
        self.begin(local, remote)
    }

    /// The remote clock has made a step.
    fn relocate(&mut self, local: Nanos, error: f64, fit: &Fit) -> Correction {
        if self.phase_samples < self.bounds.memory {
            // Another step was hardly absorbed, or none of this is sure yet: doubt the rate too.
            self.adopt(local, fit);
            return self.correction(Fate::Restarted, error, fit.last);
        }
        self.advance(local, fit.median);
        self.phase_samples = WINDOW_SAMPLES;
        self.smooth_ns = 0.0;
        self.strikes = 0;
        if fit.median.abs() <= self.bounds.step_above_ns {
            self.lag_ns += fit.median;
            self.state = State::Locked;
            return self.correction(Fate::Slewing, error, 0.0);
        }
        let moved = self.lag_ns + fit.median;
        self.lag_ns = 0.0;
        self.state = State::Jump;
        self.correction(Fate::Stepped, error, moved)
    }

    /// Transition 10, if it goes on.
    fn disordered(&mut self, local: Nanos, remote: Nanos, error: f64) -> Correction {
        self.disordered += 1;
        if self.disordered < WINDOW {
            return self.correction(Fate::Disordered, error, 0.0);
        }
        self.begin(local, remote)
    }

    /// Moves the line's foot to `local` and the line up by `phase`.
    fn advance(&mut self, local: Nanos, phase: f64) {
        let span = local - self.local;
        let gained = self.fraction_ns + self.drift * span.to_f64() + phase;
        let whole = Nanos::from_f64(gained);
        self.remote = self.remote + span + whole;
        // Clamped for spans of centuries, which saturate.
        self.fraction_ns = (gained - whole.to_f64()).clamp(-1.0, 1.0);
        self.local = local;
    }

    /// Turns the line. At the bound nothing accumulates.
    fn turn(&mut self, by: f64) {
        self.drift = (self.drift + by).clamp(-self.bounds.drift_max, self.bounds.drift_max);
    }

    /// Whether what the window shows can be a clock: its rate within bounds, as far as noise lets see.
    fn is_clock(&self, fit: &Fit) -> bool {
        let noise = CONFIDENCE * SIGMA * fit.slope_deviation();
        fit.slope.abs() <= self.bounds.drift_max + noise
    }

    fn correction(&self, fate: Fate, error: f64, phase: f64) -> Correction {
        Correction {
            fate,
            error: Nanos::from_f64(error),
            phase: Nanos::from_f64(phase),
            frequency_ppb: self.drift * 1e9,
        }
    }

    fn sigma_ns(&self) -> f64 {
        CONFIDENCE * SIGMA * self.noise_ns
    }

    /// Of a least-squares line at its end: 2 σ / √n.
    fn phase_uncertainty_ns(&self) -> f64 {
        self.sigma_ns() * 2.0 / f64::from(self.phase_samples.max(1)).sqrt()
    }

    /// Of the slope of a least-squares line: σ √12 / (T √n³); and the quartz's own.
    fn rate_uncertainty(&self) -> f64 {
        let samples = f64::from(self.rate_samples.max(1));
        let of_line =
            self.sigma_ns() * 12.0_f64.sqrt() / (samples.powf(1.5) * self.bounds.period.to_f64());
        of_line + WANDER
    }

    fn uncertainty_ns(&self, local: Nanos) -> f64 {
        let span = (local - self.local).to_f64().max(0.0);
        self.phase_uncertainty_ns() + self.rate_uncertainty() * span
    }

    /// When the uncertainty, without the part that is only being slewed, reaches its bound.
    fn expires(&self) -> Nanos {
        let left = (self.bounds.uncertainty_max_ns - self.phase_uncertainty_ns()).max(0.0);
        self.local + Nanos::from_f64(left / self.rate_uncertainty())
    }
}

#[expect(clippy::cast_possible_truncation, reason = "16")]
const WINDOW_SAMPLES: u32 = WINDOW as u32;

/// Of the `n`-th sample.
fn phase_gain(n: u32) -> f64 {
    let n = f64::from(n);
    2.0 * (2.0 * n - 1.0) / (n * (n + 1.0))
}

/// Of the `n`-th sample.
fn rate_gain(n: u32) -> f64 {
    let n = f64::from(n);
    6.0 / (n * (n + 1.0))
}

#[cfg(test)]
mod tests;

//! The clock servo: estimates from samples (local time, remote time) the phase and rate of a device's
//! clock, so that a cycle thread can keep phase. All drivers use it: datagrams of a robot controller,
//! distributed clocks of a fieldbus, SYNC messages.
//!
//! It reads no clock, steers no thread and knows no bus: times are arguments, and the result is an
//! [`Estimate`], which [`cycle`](crate::cycle) follows.
//!
//! # Theory
//!
//! The servo maintains its own clock, a line through the samples, and corrects its phase and frequency by
//! every sample's error `e` (remote time minus that of the line): a proportional and an integral part,
//! `phase += Kp·e`, `frequency += Ki·e/T`, where `T` is the time between samples. With
//!
//! ```text
//! Kp(n) = 2 (2n - 1) / (n (n + 1))        Ki(n) = 6 / (n (n + 1))
//! ```
//!
//! the n-th sample makes that line the least-squares line through all n. No gains do better on a clock of
//! constant rate and white noise, and there is no overshoot. At `n = N`, the
//! [`memory`](ServoConfig::memory), they stay constant, and the fit becomes a control loop:
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
//! N is counted in samples, so all rows hold at every period.
//!
//! Delays have tails. A sample further off than six times the mean deviation is an outlier: not used, but
//! stored. Sixteen consecutive outliers that agree with each other are a step of the remote clock; four
//! times sixteen that do not agree end the lock. So no real change is rejected for ever.
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
//! | 4 | locked, stable, holdover → jump | a step above [`step_above`](ServoConfig::step_above); a second step before the first is absorbed (then the frequency is measured again); 64 consecutive outliers that fit no line | `relocate`, `outlier` |
//! | 5 | locked → stable | the memory is full, smoothed error and remaining slew within [`stable_within`](ServoConfig::stable_within) | `settle` |
//! | 6 | stable → locked | smoothed error beyond three times that; a smaller step, which is slewed | `settle`, `relocate` |
//! | 7 | locked, stable → holdover | no sample was good for 16 periods | `handle_time` |
//! | 8 | holdover → locked | a good sample, or a smaller step | `settle`, `relocate` |
//! | 9 | holdover → unlocked | uncertainty has grown beyond its bound | `handle_time` |
//! | 10 | any → unlocked, and 1 at once | 16 consecutive samples older than one before: the local time went back | `disordered` |

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
/// A sample is an outlier beyond this many mean deviations: 4.8 standard deviations of white noise.
const GATE: f64 = 6.0;
/// Largest deviation that one sample contributes, in mean deviations, so that an outlier widens the gate
/// only a little. Many do: a lasting increase of noise is accepted.
const DEVIATION_MAX: f64 = 2.5;
/// Windows of outliers that fit no line before the lock is lost.
const STRIKES: u8 = 4;
/// Weight of a sample in the mean deviation and in the smoothed error.
const SMOOTHING: f64 = 1.0 / 64.0;
/// Periods without a good sample before holdover.
const SILENCE: i64 = 16;
/// Ratio of standard deviation to mean deviation of white noise.
const SIGMA: f64 = 1.25;
/// Uncertainties are three standard deviations.
const CONFIDENCE: f64 = 3.0;
/// Largest rate change of a free-running quartz, as a ratio: 1 ppm.
const WANDER: f64 = 1e-6;

/// Use of a sample, and its effect on the servo's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    /// Use of the sample.
    pub outcome: SampleOutcome,
    /// The sample's remote time minus that of the servo's clock before.
    pub error: Nanos,
    /// Phase step of the servo's clock.
    pub phase: Nanos,
    /// Frequency offset of the servo's clock from the local clock, ppb.
    pub frequency_ppb: f64,
}

/// Use of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampleOutcome {
    /// It corrected the clock, or waits for the first line.
    Used,
    /// Too far off; discarded.
    Outlier,
    /// Not newer than one before; discarded.
    Disordered,
    /// The last of sixteen that prove a step, which the clock will slew.
    Slewing,
    /// The last of sixteen that prove a step, which the clock has made.
    Stepped,
    /// The clock was set again.
    Restarted,
}

/// The clock servo.
#[derive(Debug, Clone)]
pub struct Servo {
    bounds: Bounds,
    state: State,
    /// The line: at `local` the remote clock shows `remote + fraction_ns`, and gains `drift` per unit.
    local: Nanos,
    remote: Nanos,
    fraction_ns: f64,
    drift: f64,
    /// Lead of the line over the published clock, whose slew is limited.
    lag_ns: f64,
    /// Number of samples in the line's phase and in its rate; both limited to the memory. 0 while the
    /// first window fills.
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

    /// At `local` the remote clock showed `remote`. The driver should subtract known delays (its own
    /// lateness, a cable) before. Bounded: at worst one sort of 120 numbers.
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

    /// Informs the servo of the local time `now`: detects that samples have stopped. Needed only while
    /// none arrive.
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

    /// State of the servo.
    pub fn state(&self) -> State {
        self.state
    }

    /// Its clock, for the threads that follow it.
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
        self.correction(SampleOutcome::Restarted, 0.0, 0.0)
    }

    /// Handles one of the first samples. The last of them gives the line.
    fn acquire(&mut self, local: Nanos, error: f64) -> Correction {
        let Some(fit) = self.window.push((local - self.local).to_f64(), error) else {
            return self.correction(SampleOutcome::Used, error, 0.0);
        };
        if !self.is_clock(&fit) || fit.deviation > self.bounds.period.to_f64() / 2.0 {
            self.state = State::Unlocked;
            return self.correction(SampleOutcome::Outlier, error, 0.0);
        }
        self.adopt(local, &fit);
        self.noise_ns = fit.deviation.max(self.bounds.noise_min_ns);
        self.correction(SampleOutcome::Restarted, error, fit.last)
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
        // Followers must not see the clock run faster than the slew limit; the rest is slewed later.
        let limit = if self.state == State::Jump {
            f64::MAX
        } else {
            self.bounds.slew * span
        };
        let moved = (self.lag_ns + step).clamp(-limit, limit);
        self.lag_ns += step - moved;
        self.advance(local, step);
        // Samples in a burst must not divide by nearly zero.
        self.turn(rate_gain(self.rate_samples) * error / span.max(self.bounds.period.to_f64()));
        self.smooth_ns += (error - self.smooth_ns) * SMOOTHING;
        self.window.clear();
        self.strikes = 0;
        self.settle();
        self.correction(SampleOutcome::Used, error, moved)
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
                // The phase must be found again; the rate is unchanged.
                self.phase_samples = self.phase_samples.min(LOCK_SAMPLES);
                self.state = State::Locked;
            }
            State::Unlocked => {}
        }
    }

    fn outlier(&mut self, local: Nanos, remote: Nanos, error: f64) -> Correction {
        let Some(fit) = self.window.push((local - self.local).to_f64(), error) else {
            return self.correction(SampleOutcome::Outlier, error, 0.0);
        };
        self.window.clear();
        if self.is_clock(&fit) && fit.deviation <= GATE / 2.0 * self.noise_ns {
            return self.relocate(local, error, &fit);
        }
        self.strikes += 1;
        if self.strikes < STRIKES {
            return self.correction(SampleOutcome::Outlier, error, 0.0);
        }
        self.begin(local, remote)
    }

    /// Handles a step of the remote clock.
    fn relocate(&mut self, local: Nanos, error: f64, fit: &Fit) -> Correction {
        if self.phase_samples < self.bounds.memory {
            // The previous step is hardly absorbed, or the lock is not sure yet: the rate is in doubt too.
            self.adopt(local, fit);
            return self.correction(SampleOutcome::Restarted, error, fit.last);
        }
        self.advance(local, fit.median);
        self.phase_samples = WINDOW_SAMPLES;
        self.smooth_ns = 0.0;
        self.strikes = 0;
        if fit.median.abs() <= self.bounds.step_above_ns {
            self.lag_ns += fit.median;
            self.state = State::Locked;
            return self.correction(SampleOutcome::Slewing, error, 0.0);
        }
        let moved = self.lag_ns + fit.median;
        self.lag_ns = 0.0;
        self.state = State::Jump;
        self.correction(SampleOutcome::Stepped, error, moved)
    }

    /// Transition 10, if it persists.
    fn disordered(&mut self, local: Nanos, remote: Nanos, error: f64) -> Correction {
        self.disordered += 1;
        if self.disordered < WINDOW {
            return self.correction(SampleOutcome::Disordered, error, 0.0);
        }
        self.begin(local, remote)
    }

    /// Moves the origin of the line to `local` and the line up by `phase`.
    fn advance(&mut self, local: Nanos, phase: f64) {
        let span = local - self.local;
        let gained = self.fraction_ns + self.drift * span.to_f64() + phase;
        let whole = Nanos::from_f64(gained);
        self.remote = self.remote + span + whole;
        // Clamped for spans of centuries, which saturate.
        self.fraction_ns = (gained - whole.to_f64()).clamp(-1.0, 1.0);
        self.local = local;
    }

    /// Changes the rate of the line. At the bound nothing accumulates.
    fn turn(&mut self, by: f64) {
        self.drift = (self.drift + by).clamp(-self.bounds.drift_max, self.bounds.drift_max);
    }

    /// Whether the window can show a clock: its rate is within bounds, within the resolution that the noise permits.
    fn is_clock(&self, fit: &Fit) -> bool {
        let noise = CONFIDENCE * SIGMA * fit.slope_deviation();
        fit.slope.abs() <= self.bounds.drift_max + noise
    }

    fn correction(&self, outcome: SampleOutcome, error: f64, phase: f64) -> Correction {
        Correction {
            outcome,
            error: Nanos::from_f64(error),
            phase: Nanos::from_f64(phase),
            frequency_ppb: self.drift * 1e9,
        }
    }

    fn sigma_ns(&self) -> f64 {
        CONFIDENCE * SIGMA * self.noise_ns
    }

    /// Uncertainty of a least-squares line at its end: 2 σ / √n.
    fn phase_uncertainty_ns(&self) -> f64 {
        self.sigma_ns() * 2.0 / f64::from(self.phase_samples.max(1)).sqrt()
    }

    /// Uncertainty of the slope of a least-squares line: σ √12 / (T √n³); plus the quartz's own.
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

    /// Time at which the uncertainty, without the part that is being slewed, reaches its bound.
    fn expires(&self) -> Nanos {
        let left = (self.bounds.uncertainty_max_ns - self.phase_uncertainty_ns()).max(0.0);
        self.local + Nanos::from_f64(left / self.rate_uncertainty())
    }
}

#[expect(clippy::cast_possible_truncation, reason = "16")]
const WINDOW_SAMPLES: u32 = WINDOW as u32;

/// Gain of the `n`-th sample.
fn phase_gain(n: u32) -> f64 {
    let n = f64::from(n);
    2.0 * (2.0 * n - 1.0) / (n * (n + 1.0))
}

/// Gain of the `n`-th sample.
fn rate_gain(n: u32) -> f64 {
    let n = f64::from(n);
    6.0 / (n * (n + 1.0))
}

#[cfg(test)]
mod tests;

//! Settings of a servo in engineering units, and their internal form.
//!
//! It has no gains: they follow from the memory (theory in [`servo`](super)).

use std::time::Duration;

use crate::Nanos;

/// Settings of a servo. [`ServoConfig::new`] derives all from the time between samples; few programs need
/// more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ServoConfig {
    /// Time between two samples when none is lost.
    pub period: Duration,
    /// Number of samples it remembers, clamped to 32..=65,536. Four times as many halve the noise and
    /// quadruple the time to follow a change of rate.
    pub memory: u32,
    /// Largest accepted difference of rates, ppb.
    pub drift_max_ppb: u32,
    /// Largest rate change of its clock while it slews an error once it is locked, ppb.
    pub slew_max_ppb: u32,
    /// Larger steps of the remote clock are stepped, smaller ones slewed.
    pub step_above: Nanos,
    /// Lower bound of the mean deviation of samples, so that a quiet second does not turn all later
    /// samples into outliers.
    pub noise_min: Nanos,
    /// Smoothed error up to which it is stable.
    pub stable_within: Nanos,
    /// Uncertainty (three standard deviations) up to which it is locked, and at which holdover ends.
    pub uncertainty_max: Nanos,
}

impl ServoConfig {
    /// For samples every `period`: memory 512, drift to 500 ppm, slew to 0.5 %, steps above a period,
    /// noise from 1 µs, stable within 1 % of the period but at least 5 µs, uncertainty to a tenth of it but
    /// at least 25 µs.
    pub fn new(period: Duration) -> Self {
        let period_ns = Nanos::from(period);
        Self {
            period,
            memory: 512,
            drift_max_ppb: 500_000,
            slew_max_ppb: 5_000_000,
            step_above: period_ns,
            noise_min: Nanos::from_micros(1),
            stable_within: Nanos(period_ns.0 / 100).max(Nanos::from_micros(5)),
            uncertainty_max: Nanos(period_ns.0 / 10).max(Nanos::from_micros(25)),
        }
    }
}

/// The settings, checked, in ns and as ratios.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub(super) period: Nanos,
    pub(super) memory: u32,
    pub(super) drift_max: f64,
    pub(super) slew: f64,
    pub(super) step_above_ns: f64,
    pub(super) noise_min_ns: f64,
    pub(super) stable_within_ns: f64,
    pub(super) uncertainty_max_ns: f64,
}

impl Bounds {
    pub(super) fn new(config: &ServoConfig) -> Self {
        Self {
            period: Nanos::from(config.period).max(Nanos(1)),
            memory: config.memory.clamp(32, 65_536),
            drift_max: ratio(config.drift_max_ppb),
            slew: ratio(config.slew_max_ppb),
            step_above_ns: config.step_above.to_f64(),
            noise_min_ns: config.noise_min.to_f64().max(1.0),
            stable_within_ns: config.stable_within.to_f64(),
            uncertainty_max_ns: config.uncertainty_max.to_f64(),
        }
    }
}

/// At most 0.4: a larger value would permit a clock that nearly stops.
fn ratio(ppb: u32) -> f64 {
    (f64::from(ppb) * 1e-9).min(0.4)
}

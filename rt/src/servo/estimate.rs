//! A servo's clock as a plain value: small enough to be passed every cycle from the measuring thread to
//! its followers, by a [`latest`](crate::latest) cell.
//!
//! It does not change by itself; followers detect the silence of its source by `expires`.

use std::fmt;

use crate::Nanos;

/// State of a servo; [`servo`](super) has the diagram.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// No clock to follow.
    #[default]
    Unlocked,
    /// The clock was set, and is still uncertain.
    Jump,
    /// The clock is followed.
    Locked,
    /// The clock is followed, and errors have been small for a while.
    Stable,
    /// Samples stopped; the last rate is kept while its uncertainty is within the bound.
    Holdover,
}

impl State {
    /// Display name.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Unlocked => "unlocked",
            Self::Jump => "jump",
            Self::Locked => "locked",
            Self::Stable => "stable",
            Self::Holdover => "holdover",
        }
    }

    /// Whether a cycle may be kept in phase with this clock.
    pub const fn is_followed(self) -> bool {
        match self {
            Self::Locked | Self::Stable | Self::Holdover => true,
            Self::Unlocked | Self::Jump => false,
        }
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A remote clock as a line over the local one. The default is unlocked. Displays as one line.
#[derive(Debug, Default, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// State of the servo.
    pub state: State,
    /// An instant of the local clock.
    pub local: Nanos,
    /// Remote time at that instant.
    pub remote: Nanos,
    /// Frequency offset from the local clock, ppb.
    pub frequency_ppb: f64,
    /// Uncertainty of `remote`: three standard deviations, and the phase being slewed.
    pub uncertainty: Nanos,
    /// Growth of the uncertainty while no samples arrive, ppb of the time since `local`.
    pub uncertainty_ppb: f64,
    /// Local time from which it is too old to rely on.
    pub expires: Nanos,
}

impl Estimate {
    /// Remote time at `local`.
    pub fn remote_at(&self, local: Nanos) -> Nanos {
        let span = local - self.local;
        self.remote + span + Nanos::from_f64(span.to_f64() * self.frequency_ppb * 1e-9)
    }

    /// Local time at which the remote clock shows `remote`.
    pub fn local_at(&self, remote: Nanos) -> Nanos {
        let span = remote - self.remote;
        let rate = self.frequency_ppb * 1e-9;
        self.local + span - Nanos::from_f64(span.to_f64() * rate / (1.0 + rate))
    }

    /// Delay of `local` after the nearest instant at which the remote clock shows `n · period + phase`:
    /// from minus half a period (exclusive) to half a period.
    pub fn phase_error(&self, local: Nanos, period: Nanos, phase: Nanos) -> Nanos {
        let period = period.0.max(1);
        let behind = (self.remote_at(local) - phase).0.rem_euclid(period);
        if behind > period / 2 {
            Nanos(behind - period)
        } else {
            Nanos(behind)
        }
    }

    /// Uncertainty at `local`, if no sample has arrived since.
    pub fn uncertainty_at(&self, local: Nanos) -> Nanos {
        let span = (local - self.local).to_f64().max(0.0);
        self.uncertainty + Nanos::from_f64(span * self.uncertainty_ppb * 1e-9)
    }

    /// Whether a cycle may be kept in phase with it at `local`.
    pub fn is_valid_at(&self, local: Nanos) -> bool {
        self.state.is_followed() && local < self.expires
    }
}

impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            state,
            frequency_ppb,
            uncertainty,
            ..
        } = self;
        write!(
            f,
            "{state}, {:+.3} ppm, +-{uncertainty}",
            frequency_ppb * 1e-3
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use proptest::prelude::*;

    fn line(frequency_ppb: f64) -> Estimate {
        Estimate {
            state: State::Locked,
            local: Nanos(1_000_000),
            remote: Nanos(5_000_000),
            frequency_ppb,
            uncertainty: Nanos(100),
            uncertainty_ppb: 1_000.0,
            expires: Nanos::from_millis(1_000),
        }
    }

    #[test]
    fn estimate_remote_and_local_are_inverse() {
        let fast = line(100_000.0);
        assert_eq!(fast.remote_at(Nanos(1_000_000)), Nanos(5_000_000));
        assert_eq!(fast.remote_at(Nanos(11_000_000)), Nanos(15_001_000));
        assert_eq!(fast.local_at(Nanos(15_001_000)), Nanos(11_000_000));
        assert_eq!(fast.remote_at(Nanos(-9_000_000)), Nanos(-5_001_000));
    }

    #[test]
    fn estimate_phase_error_folds_to_nearest() {
        let steady = line(0.0);
        let period = Nanos(1_000);
        for (local, phase, error) in [
            (1_000_000, 0, 0),
            (1_000_001, 0, 1),
            (1_000_500, 0, 500),
            (1_000_501, 0, -499),
            (999_999, 0, -1),
            (1_000_000, 300, -300),
            (1_000_000, 1_300, -300),
            (1_000_000, -300, 300),
        ] {
            let found = steady.phase_error(Nanos(local), period, Nanos(phase));
            assert_eq!(found, Nanos(error), "at {local}, phase {phase}");
        }
    }

    #[test]
    fn estimate_uncertainty_grows_until_expiry() {
        let line = line(0.0);
        assert_eq!(line.uncertainty_at(Nanos::ZERO), Nanos(100));
        assert_eq!(line.uncertainty_at(Nanos(1_001_000_000)), Nanos(1_100));
        assert!(line.is_valid_at(Nanos::from_millis(999)));
        assert!(!line.is_valid_at(Nanos::from_millis(1_000)));
        assert!(!Estimate::default().is_valid_at(Nanos(-1)));
    }

    #[test]
    fn displays_as_one_line() {
        assert_eq!(line(-1_500.0).to_string(), "locked, -1.500 ppm, +-100ns");
    }

    proptest! {
        #[test]
        fn estimate_roundtrip(ppb in -500_000.0..500_000.0_f64, local in -1_000_000_000_000..1_000_000_000_000_i64) {
            let line = line(ppb);
            let back = line.local_at(line.remote_at(Nanos(local)));
            prop_assert!((back - Nanos(local)).abs() <= Nanos(2));
        }

        #[test]
        fn estimate_extreme_times_do_not_panic(local: i64, period: i64, phase: i64) {
            let error = line(1e5).phase_error(Nanos(local), Nanos(period), Nanos(phase));
            prop_assert!(error.abs().0 <= period.max(1) / 2);
        }
    }
}

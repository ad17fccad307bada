//! A servo's clock as a plain value: small enough to be handed from the thread that measures to those
//! that follow, by a [`latest`](crate::latest) cell, every cycle.
//!
//! It does not change by itself; that its maker has gone silent shows by its end.

use std::fmt;

use crate::Nanos;

/// How well a servo follows; the diagram stands in [`servo`](super).
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// No clock to follow.
    #[default]
    Unlocked,
    /// The clock was set, and is not yet sure.
    Jump,
    /// It is followed.
    Locked,
    /// It is followed, and errors have been small for a while.
    Stable,
    /// Samples stopped; the last rate is kept while it can be trusted.
    Holdover,
}

impl State {
    /// Its name, as shown to people.
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

/// How a remote clock runs, as a line over the local one. The default is that of nobody. Displays as one
/// line.
#[derive(Debug, Default, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// How well it is known.
    pub state: State,
    /// An instant of the local clock.
    pub local: Nanos,
    /// What the remote clock shows then.
    pub remote: Nanos,
    /// How much faster than the local clock it runs, ppb.
    pub frequency_ppb: f64,
    /// How far off `remote` may be: three standard deviations, and what is being slewed.
    pub uncertainty: Nanos,
    /// How fast that grows while no samples come, ppb of the time since `local`.
    pub uncertainty_ppb: f64,
    /// From this local instant on it is too old to rely on.
    pub expires: Nanos,
}

impl Estimate {
    /// What the remote clock shows at `local`.
    pub fn remote_at(&self, local: Nanos) -> Nanos {
        let span = local - self.local;
        self.remote + span + Nanos::from_f64(span.to_f64() * self.frequency_ppb * 1e-9)
    }

    /// When the remote clock shows `remote`.
    pub fn local_at(&self, remote: Nanos) -> Nanos {
        let span = remote - self.remote;
        let rate = self.frequency_ppb * 1e-9;
        self.local + span - Nanos::from_f64(span.to_f64() * rate / (1.0 + rate))
    }

    /// By how much `local` lies behind the nearest instant at which the remote clock shows
    /// `n · period + phase`: from minus half a period (not included) to half a period.
    pub fn phase_error(&self, local: Nanos, period: Nanos, phase: Nanos) -> Nanos {
        let period = period.0.max(1);
        let behind = (self.remote_at(local) - phase).0.rem_euclid(period);
        if behind > period / 2 {
            Nanos(behind - period)
        } else {
            Nanos(behind)
        }
    }

    /// How far off it may be at `local`, if no sample has come since.
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
    fn the_line_and_its_inverse() {
        let fast = line(100_000.0);
        assert_eq!(fast.remote_at(Nanos(1_000_000)), Nanos(5_000_000));
        assert_eq!(fast.remote_at(Nanos(11_000_000)), Nanos(15_001_000));
        assert_eq!(fast.local_at(Nanos(15_001_000)), Nanos(11_000_000));
        assert_eq!(fast.remote_at(Nanos(-9_000_000)), Nanos(-5_001_000));
    }

    #[test]
    fn phase_errors_fold_to_the_nearest() {
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
    fn uncertainty_grows_and_the_estimate_ends() {
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
        fn there_and_back_again(ppb in -500_000.0..500_000.0_f64, local in -1_000_000_000_000..1_000_000_000_000_i64) {
            let line = line(ppb);
            let back = line.local_at(line.remote_at(Nanos(local)));
            prop_assert!((back - Nanos(local)).abs() <= Nanos(2));
        }

        #[test]
        fn absurd_times_do_no_harm(local: i64, period: i64, phase: i64) {
            let error = line(1e5).phase_error(Nanos(local), Nanos(period), Nanos(phase));
            prop_assert!(error.abs().0 <= period.max(1) / 2);
        }
    }
}

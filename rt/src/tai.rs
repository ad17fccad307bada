//! TAI of this host against its monotonic clock: whether a time service disciplines it, how well, and whether it was
//! stepped. The kernel slews `CLOCK_MONOTONIC` and `CLOCK_TAI` with the same frequency and steps only the latter, so
//! their difference is constant while the service is locked. Time is an argument; the readings come from
//! [`read`](crate::read_tai). It disciplines no clock.

use std::fmt;

use crate::{
    Nanos,
    servo::{Estimate, State},
};

/// A change of the difference between two readings from which the clock counts as stepped.
pub const JUMP: Nanos = Nanos::from_micros(100);
/// Readings without a step after which a clock is locked again.
pub const SETTLED_READINGS: u32 = 3;
/// Without an update by the service for so long, the clock is in holdover.
pub const SILENCE: Nanos = Nanos::from_millis(6_000);
/// Distance of two readings between which the kernel has added to its error at least once.
const UPDATE_SPAN: Nanos = Nanos::from_millis(1_900);
/// Drift of a host's oscillator without service, beyond the frequency that the kernel keeps, ppb.
pub const HOLDOVER_PPB: i64 = 2_000;
/// How long holdover lasts at most.
pub const HOLDOVER: Nanos = Nanos::from_millis(60_000);
/// Growth of the kernel's `maxerror` without updates, ppb: its own constant.
const MAXERROR_PPB: i64 = 500_000;
/// Readings that an estimate outlives.
const EXPIRES: Nanos = Nanos::from_millis(5_000);

/// One reading of the kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reading {
    /// `CLOCK_MONOTONIC` before and after, and `CLOCK_TAI` between: the narrowest of several.
    pub before: Nanos,
    /// See `before`.
    pub tai: Nanos,
    /// See `before`.
    pub after: Nanos,
    /// TAI minus UTC as configured in the kernel, s; 0 if it is not.
    pub tai_utc_s: i32,
    /// Whether the kernel counts its clock as not synchronised (`STA_UNSYNC`).
    pub unsynchronised: bool,
    /// The kernel's bound of the error. A service sets it with each update; between updates it grows.
    pub max_error: Nanos,
    /// The kernel's estimate of the error.
    pub estimated_error: Nanos,
}

impl Reading {
    /// TAI minus `CLOCK_MONOTONIC`.
    #[must_use]
    pub fn offset(&self) -> Nanos {
        self.tai - Nanos(i64::midpoint(self.before.0, self.after.0))
    }

    /// By how much the offset may be wrong because the three were read one after the other.
    #[must_use]
    pub fn gap(&self) -> Nanos {
        Nanos((self.after - self.before).0.max(0) / 2)
    }
}

/// Quality of the host's TAI.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TaiState {
    /// No service disciplines it, or it was stepped.
    #[default]
    Free,
    /// A service disciplines it.
    Locked,
    /// The service has not updated it for a while; the last frequency is kept.
    Holdover,
}

impl TaiState {
    /// Display name.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Free => "free",
            Self::Locked => "locked",
            Self::Holdover => "holdover",
        }
    }
}

impl fmt::Display for TaiState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Why a clock is free.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum FreeCause {
    /// No reading yet.
    #[default]
    Unread,
    /// The kernel's TAI offset is 0, so that `CLOCK_TAI` shows UTC.
    NoTaiOffset,
    /// No service has synchronised the kernel's clock.
    Unsynchronised,
    /// The clock was stepped by this much.
    Stepped(Nanos),
    /// The service has not updated it for longer than [`HOLDOVER`].
    Silent,
}

impl fmt::Display for FreeCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unread => f.write_str("it was not read yet"),
            Self::NoTaiOffset => f.write_str(
                "the kernel's TAI offset is 0, so that CLOCK_TAI shows UTC\nhint: phc2sys sets it with a grandmaster \
                 that distributes it (ptp4l: utc_offset valid); chrony needs `leapsectz right/UTC`",
            ),
            Self::Unsynchronised => f.write_str(
                "no time service has synchronised it\nhint: start ptp4l and phc2sys, or chrony with a PTP hardware clock",
            ),
            Self::Stepped(by) => {
                write!(f, "it was stepped by {by}\nhint: wait until the time service has settled")
            }
            Self::Silent => f.write_str(
                "the time service stopped updating it\nhint: systemctl status ptp4l phc2sys chrony",
            ),
        }
    }
}

/// The host's TAI at an instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tai {
    /// Its quality.
    pub state: TaiState,
    /// Why it is free, if it is.
    pub cause: FreeCause,
    /// The instant on `CLOCK_MONOTONIC`.
    pub at: Nanos,
    /// TAI minus `CLOCK_MONOTONIC`.
    pub offset: Nanos,
    /// By how much it may be wrong.
    pub uncertainty: Nanos,
    /// TAI minus UTC as configured in the kernel, s.
    pub tai_utc_s: i32,
}

impl Tai {
    /// TAI at an instant of `CLOCK_MONOTONIC`.
    #[must_use]
    pub fn tai(&self, monotonic: Nanos) -> Nanos {
        monotonic + self.offset
    }

    /// The instant of `CLOCK_MONOTONIC` at which TAI shows this.
    #[must_use]
    pub fn monotonic(&self, tai: Nanos) -> Nanos {
        tai - self.offset
    }

    /// As the estimate of a clock that a net thread can follow.
    #[must_use]
    pub fn estimate(&self) -> Estimate {
        let state = match self.state {
            TaiState::Free => State::Unlocked,
            TaiState::Locked => State::Stable,
            TaiState::Holdover => State::Holdover,
        };
        Estimate {
            state,
            local: self.at,
            remote: self.tai(self.at),
            frequency_ppb: 0.0,
            uncertainty: self.uncertainty,
            uncertainty_ppb: HOLDOVER_PPB as f64,
            expires: self.at + EXPIRES,
        }
    }
}

/// What a rate in ppb adds up to in a span; none in a negative one.
fn drift(span: Nanos, ppb: i64) -> Nanos {
    let sum = i128::from(span.0.max(0)) * i128::from(ppb) / 1_000_000_000;
    Nanos(i64::try_from(sum).unwrap_or(i64::MAX))
}

/// Follows the readings of one host; one a second is enough.
#[derive(Clone, Debug)]
pub struct TaiWatch {
    /// Error of the service that the kernel does not know of.
    floor: Nanos,
    last: Option<Reading>,
    /// The reading with which later ones are compared to see an update.
    basis: Option<Reading>,
    now: Tai,
    /// Readings without a step since the last one.
    settled: u32,
    stepped: Nanos,
    /// When the service updated the clock last, and the kernel's error then.
    updated: Option<(Nanos, Nanos)>,
}

impl TaiWatch {
    /// No reading yet. `floor` is the error of the service itself, of which the kernel knows nothing.
    #[must_use]
    pub fn new(floor: Nanos) -> Self {
        Self {
            floor,
            last: None,
            basis: None,
            now: Tai::default(),
            settled: 0,
            stepped: Nanos::ZERO,
            updated: None,
        }
    }

    /// The state after the last reading.
    #[must_use]
    pub const fn now(&self) -> Tai {
        self.now
    }

    /// Takes a reading.
    pub fn handle(&mut self, reading: Reading) -> Tai {
        let at = reading.after;
        self.note_update(&reading);
        self.note_step(&reading);
        let (age, error) = self
            .updated
            .map_or((Nanos::MAX, Nanos::ZERO), |(when, error)| {
                (at - when, error)
            });
        let (state, cause) = self.judge(&reading, age);
        let drift = match state {
            TaiState::Holdover => drift(age, HOLDOVER_PPB),
            TaiState::Free | TaiState::Locked => Nanos::ZERO,
        };
        let known = error.max(reading.estimated_error);
        self.now = Tai {
            state,
            cause,
            at,
            offset: reading.offset(),
            uncertainty: self.floor + known + reading.gap() + drift,
            tai_utc_s: reading.tai_utc_s,
        };
        self.last = Some(reading);
        self.now
    }

    /// A service has updated the clock if the kernel's error grew less than it does by itself. The kernel adds to it
    /// once a second, so that only readings [`UPDATE_SPAN`] apart show it.
    fn note_update(&mut self, reading: &Reading) {
        let Some(basis) = self.basis else {
            self.basis = Some(*reading);
            self.updated = (!reading.unsynchronised).then_some((reading.after, reading.max_error));
            return;
        };
        let span = (reading.before - basis.after).0;
        let by_itself = drift(Nanos(span), MAXERROR_PPB);
        let is_lower = reading.max_error < basis.max_error;
        if !is_lower && span < UPDATE_SPAN.0 {
            return;
        }
        let updated = is_lower || reading.max_error < basis.max_error + Nanos(by_itself.0 / 2);
        if updated && !reading.unsynchronised {
            let error = reading.max_error.min(basis.max_error);
            self.updated = Some((reading.after, error));
        }
        self.basis = Some(*reading);
    }

    fn note_step(&mut self, reading: &Reading) {
        let Some(last) = self.last else {
            self.settled = SETTLED_READINGS;
            return;
        };
        let by = reading.offset() - last.offset();
        let doubt = reading.gap() + last.gap();
        if by.abs() > JUMP + doubt || reading.tai_utc_s != last.tai_utc_s {
            (self.settled, self.stepped) = (0, by);
        } else {
            self.settled = self.settled.saturating_add(1);
        }
    }

    fn judge(&self, reading: &Reading, age: Nanos) -> (TaiState, FreeCause) {
        let free = |cause| (TaiState::Free, cause);
        if reading.tai_utc_s == 0 {
            return free(FreeCause::NoTaiOffset);
        }
        if self.settled < SETTLED_READINGS {
            return free(FreeCause::Stepped(self.stepped));
        }
        if self.updated.is_none() {
            return free(FreeCause::Unsynchronised);
        }
        if age > HOLDOVER {
            return free(FreeCause::Silent);
        }
        if reading.unsynchronised || age > SILENCE {
            return (TaiState::Holdover, FreeCause::default());
        }
        (TaiState::Locked, FreeCause::default())
    }
}

#[cfg(test)]
mod tests;

//! The client's side of a connection whose generation is not known in advance: detects it from the first datagrams,
//! answers as its [session](crate) prescribes, and [observes](crate::diagnosis) the timing. For tools; a driver knows
//! its robot and owns the session itself.

use crate::diagnosis::{Measurement, Observed, Observer};
use crate::error::{AnswerError, DecodeError};
use crate::generation::Kind;
use crate::guard::Violation;
use crate::lwr;
use crate::sunrise::{self, wire::Dialect};
use std::fmt;
use std::time::Duration;

mod status;
#[cfg(test)]
mod tests;

pub use crate::counters::Counters;
pub use status::{AnswerStatistics, Phase, Quality, State, Status};

/// Number of axes of both generations.
pub const AXES: usize = 7;

/// A generation of FRI, and the dialect of Sunrise once known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Version {
    /// FRI 1.0.
    Lwr,
    /// FRI of Sunrise.
    Sunrise(Option<Dialect>),
}

/// Settings of a [`Client`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ClientConfig {
    /// Version that the controller must have; `None` accepts any.
    pub expected: Option<Version>,
    /// Session settings for an LWR.
    pub lwr: lwr::SessionConfig,
    /// Session settings for Sunrise; `expected` overrides their dialect.
    pub sunrise: sunrise::SessionConfig,
}

/// Why a datagram was rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DatagramError {
    /// The datagram is no measurement.
    #[error("expected a controller's measurements, received {found}{}", remedy(*found))]
    NoMeasurement {
        /// Received kind.
        found: Kind,
    },
    /// The controller has another version than configured.
    #[error(
        "the controller speaks {actual}, expected {expected}: the client's SDK must have the controller's version"
    )]
    Version {
        /// Configured version.
        expected: Version,
        /// Version of the controller.
        actual: Version,
    },
    /// The datagram is damaged, or of another dialect than configured.
    #[error(transparent)]
    Decode(#[from] DecodeError),
}

fn remedy(found: Kind) -> &'static str {
    match found {
        Kind::LwrCommand | Kind::SunriseCommand { .. } => {
            ": a second client sends to this host instead of a controller; correct its target address"
        }
        Kind::Unknown | Kind::LwrMeasurement | Kind::SunriseMonitoring { .. } => {
            ": another program uses this port; choose a port that only the controller uses"
        }
    }
}

/// Result of one datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reception {
    /// Whether it is newer than those before; otherwise it was ignored.
    pub is_new: bool,
    /// Number of measurements lost since the previous one.
    pub lost: u16,
    /// Whether the robot follows our answers from now on; they start at [`Client::mirror`].
    pub has_entered: bool,
}

/// Why the commanded values are not in an answer.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Withheld {
    /// A value exceeds a limit of the guard.
    #[error(transparent)]
    Guard(Violation),
    /// The Sunrise session withheld it.
    #[error(transparent)]
    Sunrise(sunrise::Withheld),
}

/// An answer that was built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// Length of the answer, bytes.
    pub len: usize,
    /// Why the commanded positions are not in the answer, if so.
    pub withheld: Option<Withheld>,
}

/// The client of a controller of either generation.
///
/// Per cycle, as with the sessions: [`handle_datagram`](Self::handle_datagram), [`answer`](Self::answer), send the
/// bytes, then [`handle_sent`](Self::handle_sent). A controller that returns after a silence may be of the other generation.
#[derive(Debug, Clone)]
pub struct Client {
    config: ClientConfig,
    version: Option<Version>,
    lwr: lwr::Session,
    sunrise: sunrise::Session,
    observer: Observer,
    refused: u64,
    last_error: Option<DatagramError>,
}

impl Client {
    /// A client that has received nothing yet.
    pub fn new(mut config: ClientConfig) -> Self {
        if let Some(Version::Sunrise(dialect)) = config.expected {
            config.sunrise.dialect = dialect;
        }
        Self {
            version: None,
            lwr: lwr::Session::new(config.lwr),
            sunrise: sunrise::Session::new(config.sunrise),
            observer: Observer::lwr(),
            refused: 0,
            last_error: None,
            config,
        }
    }

    /// Handles a received datagram; `now` is its time of arrival.
    pub fn handle_datagram(
        &mut self,
        bytes: &[u8],
        now: Duration,
    ) -> Result<Reception, DatagramError> {
        self.take(bytes, now).inspect_err(|error| {
            self.refused += 1;
            self.last_error = Some(*error);
        })
    }

    fn take(&mut self, bytes: &[u8], now: Duration) -> Result<Reception, DatagramError> {
        self.handle_timeout(now);
        if self.phase() == Phase::Offline {
            self.detect(bytes)?;
        }
        match self.version {
            Some(Version::Sunrise(_)) => self.take_sunrise(bytes, now),
            Some(Version::Lwr) | None => self.take_lwr(bytes, now),
        }
    }

    /// Detects the version of the controller.
    fn detect(&mut self, bytes: &[u8]) -> Result<(), DatagramError> {
        let found = Kind::of(bytes);
        let actual = match found {
            Kind::LwrMeasurement => Version::Lwr,
            Kind::SunriseMonitoring { .. } => Version::Sunrise(None),
            Kind::LwrCommand | Kind::SunriseCommand { .. } | Kind::Unknown => {
                return Err(DatagramError::NoMeasurement { found });
            }
        };
        if let Some(expected) = self.config.expected.filter(|it| !it.is_same(actual)) {
            return Err(DatagramError::Version { expected, actual });
        }
        if self.version.is_none_or(|before| !before.is_same(actual)) {
            self.observer = actual.observer();
            self.version = Some(actual);
        }
        Ok(())
    }

    fn take_lwr(&mut self, bytes: &[u8], now: Duration) -> Result<Reception, DatagramError> {
        let reception = self.lwr.handle_datagram(bytes, now)?;
        // After a duplicate or an old one this is the newest again, counted as a duplicate.
        if let Some(msr) = self.lwr.measurement() {
            self.observer.handle_measurement(Measurement::lwr(now, msr));
        }
        Ok(Reception {
            is_new: reception.order.is_new(),
            lost: reception.lost,
            has_entered: reception.event == Some(lwr::Event::CommandEntered),
        })
    }

    fn take_sunrise(&mut self, bytes: &[u8], now: Duration) -> Result<Reception, DatagramError> {
        let reception = self.sunrise.handle_datagram(bytes, now)?;
        self.version = Some(Version::Sunrise(self.sunrise.dialect()));
        if let Some(message) = self.sunrise.message() {
            self.observer
                .handle_measurement(Measurement::sunrise(now, message));
        }
        Ok(Reception {
            is_new: reception.order.is_new(),
            lost: reception.lost,
            has_entered: reception.event == Some(sunrise::Event::CommandEntered),
        })
    }

    /// Enables positions from now on, in command mode; not needed for an LWR. They start at [`mirror`](Self::mirror).
    pub fn engage(&mut self) -> Result<(), Withheld> {
        match self.version {
            Some(Version::Sunrise(_)) => self.sunrise.engage().map_err(Withheld::Sunrise),
            Some(Version::Lwr) | None => Ok(()),
        }
    }

    /// Builds the answer to the last measurement. `None` commands nothing: in command mode an LWR holds its position, an
    /// iiwa follows its interpolator.
    pub fn answer(
        &mut self,
        joints: Option<&[f64; AXES]>,
        buf: &mut [u8],
    ) -> Result<Answer, AnswerError> {
        Ok(match self.version {
            Some(Version::Sunrise(_)) => {
                let demand = joints.map_or(sunrise::Demand::Hold, |joints| {
                    sunrise::Demand::Position(*joints)
                });
                let answer = self.sunrise.answer(&demand, buf)?;
                Answer {
                    len: answer.len,
                    withheld: answer.withheld.map(Withheld::Sunrise),
                }
            }
            Some(Version::Lwr) | None => Answer {
                len: self.lwr.answer(joints, buf)?,
                withheld: self.lwr.violation().map(Withheld::Guard),
            },
        })
    }

    /// Counter of the answer built last.
    fn sent_sequence(&self) -> u32 {
        match self.version {
            Some(Version::Sunrise(_)) => self.sunrise.sent_sequence(),
            Some(Version::Lwr) | None => self.lwr.sent_sequence().into(),
        }
    }

    /// Records that the answer built last left at `at`.
    pub fn handle_sent(&mut self, at: Duration) {
        self.observer.handle_answer(at, self.sent_sequence());
    }

    /// Records that the last datagram, which the kernel received `delay` earlier, was handled: what this host adds.
    pub fn handle_wake_up(&mut self, delay: Duration) {
        self.observer.handle_wake_up(delay);
    }

    /// Checks the receive timeout at `now`; returns whether the controller has just become offline.
    pub fn handle_timeout(&mut self, now: Duration) -> bool {
        match self.version {
            Some(Version::Sunrise(_)) => self.sunrise.handle_timeout(now),
            Some(Version::Lwr) => self.lwr.handle_timeout(now),
            None => false,
        }
    }

    /// Whether an answer is due.
    pub fn is_pending(&self) -> bool {
        match self.version {
            Some(Version::Sunrise(_)) => self.sunrise.is_pending(),
            Some(Version::Lwr) => self.lwr.is_pending(),
            None => false,
        }
    }

    /// Joint positions, rad, that the next answer may carry without a jump. Zeros before the first measurement.
    pub fn mirror(&self) -> [f64; AXES] {
        match self.version {
            Some(Version::Sunrise(_)) => self.sunrise.mirror(),
            Some(Version::Lwr) | None => self.lwr.mirror(),
        }
    }

    /// Time between measurements; `None` before the first one.
    pub fn period(&self) -> Option<Duration> {
        match self.version? {
            Version::Sunrise(_) => self.sunrise.period(),
            Version::Lwr => self.lwr.period(),
        }
    }

    /// Version of the controller; `None` before the first measurement.
    pub fn version(&self) -> Option<Version> {
        self.version
    }

    /// Timing observed so far.
    pub fn observed(&self) -> Observed {
        self.observer.observed()
    }
}

impl Version {
    /// Whether both may be the same generation.
    fn is_same(self, other: Self) -> bool {
        match (self, other) {
            (Self::Lwr, Self::Lwr) | (Self::Sunrise(_), Self::Sunrise(_)) => true,
            (Self::Lwr, Self::Sunrise(_)) | (Self::Sunrise(_), Self::Lwr) => false,
        }
    }

    fn observer(self) -> Observer {
        match self {
            Self::Lwr => Observer::lwr(),
            Self::Sunrise(_) => Observer::sunrise(),
        }
    }

    /// Largest absolute position of each joint by the data sheets, rad.
    pub fn position_max_rad(self) -> [f64; AXES] {
        let last = match self {
            Self::Lwr => 170.0,
            Self::Sunrise(_) => 175.0_f64,
        };
        [170.0, 120.0, 170.0, 120.0, 170.0, 120.0, last].map(f64::to_radians)
    }

    /// Names of the joints in the order of every joint array.
    pub fn joint_names(self) -> [&'static str; AXES] {
        match self {
            Self::Lwr => lwr::JOINT_NAMES,
            Self::Sunrise(_) => sunrise::JOINT_NAMES,
        }
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lwr => f.pad("FRI 1.0 (LWR)"),
            Self::Sunrise(None) => f.pad("FRI of Sunrise"),
            Self::Sunrise(Some(Dialect::V1)) => f.pad("FRI 1.x of Sunrise"),
            Self::Sunrise(Some(Dialect::V2)) => f.pad("FRI 2.0 to 2.5 of Sunrise"),
            Self::Sunrise(Some(Dialect::V3)) => f.pad("FRI 2.7 (3.0) of Sunrise"),
        }
    }
}

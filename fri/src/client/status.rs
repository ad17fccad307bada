//! A snapshot of a connection, in one type for both generations. It draws no conclusion.

use super::{AXES, Client, DatagramError, Version};
use crate::counters::Counters;
use crate::lwr::{self, wire as lwr_wire};
use crate::sunrise::{self, wire};
use std::fmt;
use std::time::Duration;

/// Phase of the connection, common to both generations.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Phase {
    /// No measurement yet, or none for a while.
    #[default]
    Offline,
    /// Measurements flow; the robot does not follow.
    Monitor,
    /// An overlay is about to begin.
    Synchronising,
    /// The robot follows our answers.
    Command,
}

/// State that the controller reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// Of FRI 1.0.
    Lwr(lwr_wire::State),
    /// Of Sunrise.
    Sunrise(wire::SessionState),
}

/// Quality that the controller reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quality {
    /// Of FRI 1.0.
    Lwr(lwr_wire::Quality),
    /// Of Sunrise.
    Sunrise(wire::Quality),
}

/// Statistics of our answers that an LWR's controller reports: averages over its last 100 measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AnswerStatistics {
    /// Share of measurements answered in time, 0..=1.
    pub answer_rate: f32,
    /// Time from measurement to answer, s.
    pub latency_s: f32,
    /// Variation of that time, s.
    pub jitter_s: f32,
    /// Answers missing since the interface was opened.
    pub missed: u32,
}

/// Snapshot of a connection.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Status {
    /// Version of the controller; `None` before the first measurement, as all that follows.
    pub version: Option<Version>,
    /// Phase of the connection.
    pub phase: Phase,
    /// Reported state.
    pub state: Option<State>,
    /// Reported quality.
    pub quality: Option<Quality>,
    /// Whether the drives have power.
    pub has_power: Option<bool>,
    /// Values that an overlay of Sunrise expects from the client; `None` without one, and for an LWR.
    pub overlay: Option<wire::CommandMode>,
    /// Time between measurements.
    pub period: Option<Duration>,
    /// Measured joint positions, rad.
    pub measured: Option<[f64; AXES]>,
    /// The controller's joint set-point, rad.
    pub set_point: Option<[f64; AXES]>,
    /// Estimated external torques, Nm.
    pub external_torque: Option<[f64; AXES]>,
    /// Statistics of our answers that an LWR's controller reports.
    pub statistics: Option<AnswerStatistics>,
    /// Totals.
    pub counters: Counters,
    /// Error of the last rejected datagram.
    pub last_error: Option<DatagramError>,
}

impl Quality {
    /// Whether it suffices for commands with a margin: OK or PERFECT, GOOD or EXCELLENT.
    pub fn is_sound(self) -> bool {
        match self {
            Self::Lwr(quality) => match quality {
                lwr_wire::Quality::Ok | lwr_wire::Quality::Perfect => true,
                lwr_wire::Quality::Unacceptable
                | lwr_wire::Quality::Bad
                | lwr_wire::Quality::Other(_) => false,
            },
            Self::Sunrise(quality) => match quality {
                wire::Quality::Good | wire::Quality::Excellent => true,
                wire::Quality::Poor | wire::Quality::Fair | wire::Quality::Other(_) => false,
            },
        }
    }
}

impl Client {
    /// Phase of the connection.
    pub fn phase(&self) -> Phase {
        match self.version {
            None => Phase::Offline,
            Some(Version::Lwr) => match self.lwr.phase() {
                lwr::Phase::Offline => Phase::Offline,
                lwr::Phase::Monitor => Phase::Monitor,
                lwr::Phase::Command => Phase::Command,
            },
            Some(Version::Sunrise(_)) => match self.sunrise.phase() {
                sunrise::Phase::Offline => Phase::Offline,
                sunrise::Phase::Idle
                | sunrise::Phase::MonitoringWait
                | sunrise::Phase::MonitoringReady => Phase::Monitor,
                sunrise::Phase::CommandingWait => Phase::Synchronising,
                sunrise::Phase::CommandingActive => Phase::Command,
            },
        }
    }

    /// Snapshot of the connection.
    pub fn status(&self) -> Status {
        let reported = match self.version {
            None => None,
            Some(Version::Lwr) => self.lwr.measurement().map(Status::of_lwr),
            Some(Version::Sunrise(_)) => self.sunrise.message().map(Status::of_sunrise),
        };
        Status {
            version: self.version,
            phase: self.phase(),
            period: self.period(),
            counters: self.counters(),
            last_error: self.last_error,
            ..reported.unwrap_or_default()
        }
    }

    /// Totals of both generations: both may have used the port.
    fn counters(&self) -> Counters {
        Counters {
            refused: self.refused,
            ..self.lwr.counters() + self.sunrise.counters()
        }
    }
}

impl Status {
    /// What one measurement of an LWR reports.
    pub(crate) fn of_lwr(msr: &lwr_wire::Msr) -> Self {
        let statistics = msr.statistics;
        Self {
            state: Some(State::Lwr(msr.interface.state)),
            quality: Some(Quality::Lwr(msr.interface.quality)),
            has_power: Some(msr.robot.power != 0),
            measured: Some(msr.measured_joints.map(f64::from)),
            set_point: Some(msr.set_point()),
            external_torque: Some(msr.external_torque.map(f64::from)),
            statistics: Some(AnswerStatistics {
                answer_rate: statistics.answer_rate,
                latency_s: statistics.latency_s,
                jitter_s: statistics.jitter_s,
                missed: statistics.miss_counter,
            }),
            ..Self::default()
        }
    }

    /// What one message of Sunrise reports.
    pub(crate) fn of_sunrise(message: &wire::Monitoring) -> Self {
        let drives = message.robot.and_then(|robot| robot.drives);
        let data = message.monitor;
        let ipo = message.ipo.and_then(|ipo| ipo.joints);
        Self {
            state: Some(State::Sunrise(message.state())),
            overlay: Some(message.command_mode()).filter(|mode| *mode != wire::CommandMode::None),
            quality: Some(Quality::Sunrise(message.quality())),
            has_power: drives
                .map(|drives| drives.iter().all(|drive| *drive == wire::Drive::Active)),
            measured: message.measured(),
            set_point: ipo.or_else(|| data.and_then(|data| data.commanded)),
            external_torque: data.and_then(|data| data.external_torque),
            ..Self::default()
        }
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lwr(state) => state.fmt(f),
            Self::Sunrise(state) => state.fmt(f),
        }
    }
}

impl fmt::Display for Quality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lwr(quality) => quality.fmt(f),
            Self::Sunrise(quality) => quality.fmt(f),
        }
    }
}

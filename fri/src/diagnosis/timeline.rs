//! What a controller reported in the course of a recording: each change of state, quality, power or safety, and each
//! silence, with the reason as far as the datagrams show it. It judges no whole connection.

use super::{Measurement, Observer, Verdict};
use crate::capture::{Datagram, Decoded};
use crate::client::{Quality, State, Status};
use crate::lwr::wire as lwr_wire;
use crate::sunrise::wire::{Safety, SessionState};
use std::fmt;
use std::time::Duration;

/// Changes kept at most; further ones are counted.
const CHANGES_MAX: usize = 1_000;
/// Measurements after which the older of two observers is restarted: reasons cover one to two windows.
const WINDOW: u32 = 100;
/// Missing periods from which a pause between measurements is a silence.
const SILENT_PERIODS: u32 = 50;

/// What a measurement reports of the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Reported {
    state: State,
    quality: Quality,
    has_power: Option<bool>,
    safety: Option<Safety>,
}

/// Why something changed.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Reason {
    /// The timing of the measurements before.
    Timing(Verdict),
    /// No measurement for this long.
    Silence(Duration),
    /// The drives have no power.
    Power,
    /// The safety controller requests a stop.
    Safety(Safety),
    /// Command mode ended at insufficient quality.
    Quality,
    /// Command mode ended although quality and power sufficed.
    Program,
}

/// A change of what a controller reports.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    /// Time stamp of the measurement.
    pub at: Duration,
    /// Reported state from then on.
    pub state: State,
    /// Reported quality from then on.
    pub quality: Quality,
    /// Whether the drives have power from then on; `None` if it is not reported.
    pub has_power: Option<bool>,
    reason: Option<Reason>,
}

impl Change {
    /// Why, for changes for the worse; `None` for others.
    pub fn reason(&self) -> Option<String> {
        self.reason.map(|reason| reason.to_string())
    }
}

/// The changes of one connection in a recording.
#[derive(Debug, Clone)]
pub struct Timeline {
    fresh: Observer,
    older: Observer,
    newer: Observer,
    count: u32,
    last: Option<(Measurement, Reported)>,
    changes: Vec<Change>,
    omitted: u64,
}

impl Timeline {
    /// A timeline of a connection whose generation `observer`, a fresh one, is for.
    pub fn new(observer: &Observer) -> Self {
        Self {
            fresh: observer.clone(),
            older: observer.clone(),
            newer: observer.clone(),
            count: 0,
            last: None,
            changes: Vec::new(),
            omitted: 0,
        }
    }

    /// The changes, oldest first; the first one is the beginning.
    pub fn changes(&self) -> &[Change] {
        &self.changes
    }

    /// Changes that were not kept.
    pub fn omitted(&self) -> u64 {
        self.omitted
    }

    /// Handles a datagram of the connection, in either direction.
    pub fn handle_datagram(&mut self, datagram: &Datagram) {
        let (measurement, reported) = match Decoded::of(&datagram.bytes) {
            Decoded::LwrMeasurement(msr) => {
                let reported = Reported::of(&Status::of_lwr(&msr), None);
                (Measurement::lwr(datagram.at, &msr), reported)
            }
            Decoded::SunriseMonitoring { message, .. } => {
                let safety = message.robot.and_then(|robot| robot.safety);
                let reported = Reported::of(&Status::of_sunrise(&message), safety);
                (Measurement::sunrise(datagram.at, &message), reported)
            }
            Decoded::LwrCommand(_)
            | Decoded::SunriseCommand { .. }
            | Decoded::Foreign { .. }
            | Decoded::Refused(_) => {
                self.older.handle_datagram(datagram);
                return self.newer.handle_datagram(datagram);
            }
        };
        if let Some(reported) = reported {
            self.compare(&measurement, reported);
            self.last = Some((measurement, reported));
        }
        self.older.handle_measurement(measurement);
        self.newer.handle_measurement(measurement);
        self.count += 1;
        if self.count >= WINDOW {
            self.count = 0;
            self.older = std::mem::replace(&mut self.newer, self.fresh.clone());
        }
    }

    fn compare(&mut self, next: &Measurement, reported: Reported) {
        let Some((last, before)) = self.last else {
            return self.note(next.at, reported, None);
        };
        let pause = next.at.saturating_sub(last.at);
        if pause >= last.period.saturating_mul(SILENT_PERIODS) {
            self.note(next.at, reported, Some(Reason::Silence(pause)));
            (self.older, self.newer) = (self.fresh.clone(), self.fresh.clone());
            self.count = 0;
        } else if before != reported {
            let reason = reported.reason_after(&before, &self.older.verdict());
            self.note(next.at, reported, reason);
        }
    }

    fn note(&mut self, at: Duration, reported: Reported, reason: Option<Reason>) {
        if self.changes.len() >= CHANGES_MAX {
            self.omitted += 1;
            return;
        }
        self.changes.push(Change {
            at,
            state: reported.state,
            quality: reported.quality,
            has_power: reported.has_power,
            reason,
        });
    }
}

impl Reported {
    fn of(status: &Status, safety: Option<Safety>) -> Option<Self> {
        Some(Self {
            state: status.state?,
            quality: status.quality?,
            has_power: status.has_power,
            safety,
        })
    }

    /// Why this is worse than `before`; `verdict` is that on the timing of the last measurements.
    fn reason_after(&self, before: &Self, verdict: &Verdict) -> Option<Reason> {
        let has_lost_power = self.has_power == Some(false) && before.has_power == Some(true);
        let stop = self.safety.filter(|it| *it != Safety::Normal);
        let left = is_command(before.state) && !is_command(self.state);
        if has_lost_power {
            Some(Reason::Power)
        } else if let Some(stop) = stop.filter(|_| left || before.safety != self.safety) {
            Some(Reason::Safety(stop))
        } else if rank(self.quality) < rank(before.quality) {
            Some(Reason::Timing(*verdict))
        } else if left && !self.quality.is_sound() {
            Some(Reason::Quality)
        } else {
            left.then_some(Reason::Program)
        }
    }
}

fn rank(quality: Quality) -> i32 {
    match quality {
        Quality::Lwr(quality) => quality.code().into(),
        Quality::Sunrise(quality) => quality.code(),
    }
}

fn is_command(state: State) -> bool {
    match state {
        State::Lwr(state) => state == lwr_wire::State::Cmd,
        State::Sunrise(state) => matches!(
            state,
            SessionState::CommandingWait | SessionState::CommandingActive
        ),
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Timing(Verdict::Good) => f.write_str("no delay visible in this recording"),
            Self::Timing(verdict) => verdict.fmt(f),
            Self::Silence(pause) => write!(f, "no measurement for {pause:.1?}"),
            Self::Power => f.write_str("the drives lost their power"),
            Self::Safety(safety) => write!(f, "the safety controller requests {safety}"),
            Self::Quality => f.write_str("quality is too bad for commands"),
            Self::Program => {
                f.write_str("the robot program ended it, or the controller rejected a command")
            }
        }
    }
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, quality {}", self.state, self.quality)?;
        if self.has_power == Some(false) {
            f.write_str(", drives off")?;
        }
        self.reason.map_or(Ok(()), |reason| write!(f, ": {reason}"))
    }
}

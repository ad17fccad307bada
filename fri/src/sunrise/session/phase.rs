//! Phases of a connection as the client sees them, and the events of their changes.

use crate::sunrise::wire::SessionState;
use std::fmt;

/// Phase of the connection: the five session states as last reported, or offline.
///
/// ```text
///            (1)                  quality           motion with overlay        commands consistent
///  Offline ───────▶ MonitoringWait ⇄ MonitoringReady ─────────▶ CommandingWait ────────▶ CommandingActive
///     ▲                 ▲  ▲                                        │                        │
///     │                 │  └───── quality lost, motion over ────────┴────────────────────────┘
///     └─(2) silence     └──────▶ Idle (closed by the robot program; not answered)
/// ```
/// The controller makes all transitions but 1 and 2; [`super::Session::handle_datagram`] follows in any order.
/// [`super::Session::handle_timeout`] makes transition 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Phase {
    /// No datagram for some periods, or none yet.
    Offline,
    /// The session is closed; no answer is due.
    Idle,
    /// Measurements flow, quality is insufficient.
    MonitoringWait,
    /// Measurements flow, quality is sufficient.
    MonitoringReady,
    /// The overlay is about to begin; answers agree with the interpolator.
    CommandingWait,
    /// The robot follows our answers.
    CommandingActive,
}

/// A change of [`Phase`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Event {
    /// Measurements flow after silence or after a closed session.
    Online,
    /// Quality is sufficient from now on.
    Ready,
    /// Quality is no longer sufficient.
    QualityLost,
    /// An overlay is about to begin.
    Synchronising,
    /// The robot follows from now on, once [`super::Session::engage`] was called; start from
    /// [`super::Session::mirror`].
    CommandEntered,
    /// The robot no longer follows, or the overlay never became active.
    CommandLeft,
    /// The robot program closed the session.
    Closed,
}

impl Phase {
    /// All phases.
    pub const ALL: [Self; 6] = [
        Self::Offline,
        Self::Idle,
        Self::MonitoringWait,
        Self::MonitoringReady,
        Self::CommandingWait,
        Self::CommandingActive,
    ];

    /// Whether the motion has an overlay, active or about to be.
    pub fn is_commanding(self) -> bool {
        match self {
            Self::CommandingWait | Self::CommandingActive => true,
            Self::Offline | Self::Idle | Self::MonitoringWait | Self::MonitoringReady => false,
        }
    }

    /// The event of a change from `self` to `to`.
    pub(super) fn event(self, to: Self) -> Option<Event> {
        use Phase::{
            CommandingActive, CommandingWait, Idle, MonitoringReady, MonitoringWait, Offline,
        };
        match (self, to) {
            (_, Offline)
            | (Offline | Idle, Idle)
            | (MonitoringWait, MonitoringWait)
            | (MonitoringReady, MonitoringReady)
            | (CommandingWait, CommandingWait)
            | (CommandingActive, CommandingActive) => None,
            (MonitoringWait | MonitoringReady | CommandingWait | CommandingActive, Idle) => {
                Some(Event::Closed)
            }
            (Offline | Idle, MonitoringWait | MonitoringReady) => Some(Event::Online),
            (MonitoringWait, MonitoringReady) => Some(Event::Ready),
            (MonitoringReady, MonitoringWait) => Some(Event::QualityLost),
            (CommandingWait | CommandingActive, MonitoringWait | MonitoringReady)
            | (CommandingActive, CommandingWait) => Some(Event::CommandLeft),
            (Offline | Idle | MonitoringWait | MonitoringReady, CommandingWait) => {
                Some(Event::Synchronising)
            }
            (
                Offline | Idle | MonitoringWait | MonitoringReady | CommandingWait,
                CommandingActive,
            ) => Some(Event::CommandEntered),
        }
    }
}

impl From<SessionState> for Phase {
    /// A state unknown to this crate commands nothing: it is answered like MONITORING_WAIT.
    fn from(state: SessionState) -> Self {
        match state {
            SessionState::Idle => Self::Idle,
            SessionState::MonitoringWait | SessionState::Other(_) => Self::MonitoringWait,
            SessionState::MonitoringReady => Self::MonitoringReady,
            SessionState::CommandingWait => Self::CommandingWait,
            SessionState::CommandingActive => Self::CommandingActive,
        }
    }
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Offline => "offline",
            Self::Idle => "idle",
            Self::MonitoringWait => "monitoring, waiting for quality",
            Self::MonitoringReady => "monitoring, ready",
            Self::CommandingWait => "commanding, synchronising",
            Self::CommandingActive => "commanding",
        })
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Online => "measurements flow",
            Self::Ready => "quality suffices for commands",
            Self::QualityLost => "quality below GOOD",
            Self::Synchronising => "overlay about to begin",
            Self::CommandEntered => "overlay active",
            Self::CommandLeft => "overlay ended",
            Self::Closed => "session closed by the robot program",
        })
    }
}

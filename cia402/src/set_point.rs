//! The master's side of profile position: the hand-shake of set-points (CiA 402-2, clause on profile position). The
//! statusword shows the progress of the motion; the caller decides when the next set-point is due.

use std::fmt;
use std::time::Duration;

use crate::StatusWord;

/// Bit 4 of the controlword, new set-point: its rising edge hands a set-point over.
const NEW: u16 = 1 << 4;
/// Bit 5, change immediately: the set-point replaces the current one.
const AT_ONCE: u16 = 1 << 5;
/// Bit 6, relative: the target is relative to the position that 60F2h selects.
const RELATIVE: u16 = 1 << 6;
/// Bit 9, change on set-point: the previous target is passed without a stop.
const PASS: u16 = 1 << 9;
/// Bit 12 of the statusword, set-point acknowledge: high once the set-point is accepted, low when the drive can accept
/// the next.
const TAKEN: u16 = 1 << 12;

/// When a set-point becomes the current target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Change {
    /// Once the previous target is reached and the motor has stopped (set of set-points).
    #[default]
    AfterStop,
    /// Once the previous target is reached, without a stop (change on set-point).
    InPassing,
    /// Now (change immediately); waiting set-points are dropped.
    AtOnce,
}

/// A set-point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SetPoint {
    /// 607Ah, user units.
    pub target: i32,
    /// Whether the target is a distance rather than a position.
    pub relative: bool,
    /// When it becomes active.
    pub change: Change,
}

impl SetPoint {
    const fn bits(self) -> u16 {
        let relative = if self.relative { RELATIVE } else { 0 };
        relative
            | match self.change {
                Change::AfterStop => 0,
                Change::InPassing => PASS,
                Change::AtOnce => AT_ONCE,
            }
    }
}

/// Why a set-point was not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetPointError {
    /// Bit 12 did not rise.
    NotTaken(Duration),
    /// The drive left Operation enabled, or the mode.
    Interrupted,
}

impl fmt::Display for SetPointError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotTaken(after) => write!(
                f,
                "the drive did not accept a set-point within {after:?} (bit 12 of 6041h stays low); is halt (bit 8) low, \
                 607Ah within 607Dh, and do 6040h and 607Ah come with the same PDO?"
            ),
            Self::Interrupted => f.write_str(
                "the drive left Operation enabled or profile position before it accepted a set-point; set-points that \
                 waited in it are lost",
            ),
        }
    }
}

impl std::error::Error for SetPointError {}

/// What to send in a cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Offer {
    /// 607Ah; `None` to leave it unchanged.
    pub target: Option<i32>,
    /// Bits 4, 5, 6 and 9 of 6040h.
    pub bits: u16,
    /// How the last set-point ended; reported once.
    pub outcome: Option<Result<(), SetPointError>>,
}

impl Offer {
    const fn with(self, set_point: SetPoint) -> Self {
        Self {
            target: Some(set_point.target),
            bits: NEW | set_point.bits(),
            ..self
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Idle,
    /// The drive holds a waiting set-point and accepts no other.
    Full(SetPoint),
    /// Bit 4 is high since this time.
    Offered(SetPoint, Duration),
}

/// The hand-shake of one axis.
///
/// ```text
///       offer            bit 12 low                 bit 12 high
/// Idle -------> Full ------------------> Offered ---------------> Idle (accepted)
///                 \--- not ready, or no answer in time ---------> Idle (error)
/// ```
/// Bit 4 is low for a cycle between two set-points: the drive needs the edge. An immediate set-point does not wait
/// until the drive can accept another; as bit 12 is high already, its acceptance is not visible and is assumed.
#[derive(Clone, Copy, Debug)]
pub struct HandShake {
    phase: Phase,
    /// Bit 4 in the last cycle.
    high: bool,
    timeout: Duration,
}

impl HandShake {
    /// An idle hand-shake; `timeout` is how long a drive may take to accept a set-point.
    pub const fn new(timeout: Duration) -> Self {
        Self {
            phase: Phase::Idle,
            high: false,
            timeout,
        }
    }

    /// Whether the next set-point can be offered.
    pub fn is_idle(&self) -> bool {
        self.phase == Phase::Idle
    }

    /// Offers a set-point; it replaces one that was not yet accepted.
    pub const fn offer(&mut self, set_point: SetPoint) {
        self.phase = Phase::Full(set_point);
    }

    /// One cycle. `ready`: the drive is in Operation enabled and 6061h shows profile position.
    pub fn step(&mut self, status: StatusWord, ready: bool, now: Duration) -> Offer {
        let taken = status.raw() & TAKEN != 0;
        let was_high = std::mem::take(&mut self.high);
        match self.phase {
            Phase::Idle => Offer::default(),
            Phase::Full(_) | Phase::Offered(..) if !ready => {
                self.end(Err(SetPointError::Interrupted))
            }
            // A drive with a waiting set-point cannot acknowledge another, but accepts an immediate one.
            Phase::Full(set_point) if taken && set_point.change == Change::AtOnce && !was_high => {
                self.high = true;
                self.end(Ok(())).with(set_point)
            }
            Phase::Full(_) if was_high || taken => Offer::default(),
            Phase::Full(set_point) => {
                self.phase = Phase::Offered(set_point, now);
                self.present(set_point)
            }
            Phase::Offered(..) if taken => self.end(Ok(())),
            Phase::Offered(_, since) if now.saturating_sub(since) > self.timeout => {
                let after = now.saturating_sub(since);
                self.end(Err(SetPointError::NotTaken(after)))
            }
            Phase::Offered(set_point, _) => self.present(set_point),
        }
    }

    fn present(&mut self, set_point: SetPoint) -> Offer {
        self.high = true;
        Offer::default().with(set_point)
    }

    const fn end(&mut self, outcome: Result<(), SetPointError>) -> Offer {
        self.phase = Phase::Idle;
        Offer {
            target: None,
            bits: 0,
            outcome: Some(outcome),
        }
    }
}

#[cfg(test)]
mod tests;

//! The master's side of profile position: how a set-point is handed over (CiA 402-2, clause on profile position). Where
//! the motor is on its way, the statusword tells; when the next one is to come, the caller knows.

use std::fmt;
use std::time::Duration;

use crate::StatusWord;

/// Bit 4 of the controlword: its rise hands a set-point over.
const NEW: u16 = 1 << 4;
/// Bit 5: it replaces the one that is under way.
const AT_ONCE: u16 = 1 << 5;
/// Bit 6: it counts from where 60F2h says.
const RELATIVE: u16 = 1 << 6;
/// Bit 9: the one before is passed without a stop.
const PASS: u16 = 1 << 9;
/// Bit 12 of the statusword: it is taken; low again, there is room for the next.
const TAKEN: u16 = 1 << 12;

/// When a set-point becomes the one that is moved to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Change {
    /// When the one before is reached, and the motor stands (set of set-points).
    #[default]
    AfterStop,
    /// When the one before is reached, without a stop there (change on set-point).
    InPassing,
    /// Now (change immediately); what waits is given up.
    AtOnce,
}

/// A set-point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SetPoint {
    /// 607Ah, user units.
    pub target: i32,
    /// Whether it is a way rather than a place.
    pub relative: bool,
    /// When it counts.
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

/// Why a set-point was not taken.
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
                "the drive did not take a set-point within {after:?} (bit 12 of 6041h stays low); is halt (bit 8) low, \
                 607Ah within 607Dh, and do 6040h and 607Ah come with the same PDO?"
            ),
            Self::Interrupted => f.write_str(
                "the drive left Operation enabled or profile position before it took a set-point; set-points that \
                 waited in it are lost",
            ),
        }
    }
}

impl std::error::Error for SetPointError {}

/// What to send in a cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Offer {
    /// 607Ah; `None` while there is nothing to say.
    pub target: Option<i32>,
    /// Bits 4, 5, 6 and 9 of 6040h.
    pub bits: u16,
    /// How the last set-point ended; told once.
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
    /// The drive has one that waits: there is no room.
    Full(SetPoint),
    /// Bit 4 is high since then.
    Offered(SetPoint, Duration),
}

/// The hand-shake of one axis.
///
/// ```text
///       offer            bit 12 low                 bit 12 high
/// Idle -------> Full ------------------> Offered ---------------> Idle (taken)
///                 \--- not ready, or no answer in time ---------> Idle (error)
/// ```
/// Bit 4 is low for a cycle between two of them: the drive needs the edge. A set-point to be moved to at once does not wait
/// for room; as bit 12 is high already, nothing shows that it was taken, and it is taken for granted.
#[derive(Clone, Copy, Debug)]
pub struct HandShake {
    phase: Phase,
    /// Bit 4 of the last cycle.
    high: bool,
    timeout: Duration,
}

impl HandShake {
    /// Nothing is offered; a drive may take so long to take a set-point for which it has room.
    #[must_use]
    pub const fn new(timeout: Duration) -> Self {
        Self {
            phase: Phase::Idle,
            high: false,
            timeout,
        }
    }

    /// Whether the next set-point can be offered.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.phase == Phase::Idle
    }

    /// Offers a set-point; one that was not yet taken is replaced.
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
            // A full drive cannot show that it has taken one more. One to be moved to at once it takes all the same.
            Phase::Full(set_point) if taken && set_point.change == Change::AtOnce && !was_high => {
                self.high = true;
                self.end(Ok(())).with(set_point)
            }
            Phase::Full(_) if was_high || taken => Offer::default(),
            Phase::Full(set_point) => {
                self.phase = Phase::Offered(set_point, now);
                self.say(set_point)
            }
            Phase::Offered(..) if taken => self.end(Ok(())),
            Phase::Offered(_, since) if now.saturating_sub(since) > self.timeout => {
                let after = now.saturating_sub(since);
                self.end(Err(SetPointError::NotTaken(after)))
            }
            Phase::Offered(set_point, _) => self.say(set_point),
        }
    }

    fn say(&mut self, set_point: SetPoint) -> Offer {
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

//! The master's side of a homing run: when to start it, and what the statusword reports. 6098h selects how the drive
//! finds home.

use std::fmt;
use std::time::Duration;

use crate::StatusWord;

/// Bit 4 of the controlword: homing runs while it is high.
pub const HOMING_START: u16 = 1 << 4;
/// The homing mode of operation (6060h).
pub const HOMING_MODE: i8 = 6;

/// Bits 13, 12 and 10 of the statusword in homing mode (CiA 402-2, clause on homing).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomingStatus {
    /// 000: in progress.
    Running,
    /// 001: not started or interrupted; at rest.
    Stopped,
    /// 010: home is found, still moving.
    Attained,
    /// 011: completed.
    Done,
    /// 100: an error, still moving.
    FailedMoving,
    /// 101: an error, at rest.
    Failed,
    /// 110, 111: reserved.
    Reserved,
}

impl HomingStatus {
    /// The status that a statusword shows in homing mode.
    pub fn of(status: StatusWord) -> Self {
        let bit = |n: u16| status.raw() >> n & 1 == 1;
        match (bit(13), bit(12), bit(10)) {
            (false, false, false) => Self::Running,
            (false, false, true) => Self::Stopped,
            (false, true, false) => Self::Attained,
            (false, true, true) => Self::Done,
            (true, false, false) => Self::FailedMoving,
            (true, false, true) => Self::Failed,
            (true, true, _) => Self::Reserved,
        }
    }
}

/// Why a homing run failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomingError {
    /// Bit 13: the drive reports an error.
    Reported,
    /// The drive stopped before it was home.
    Interrupted,
    /// The run timed out.
    TimedOut(Duration),
}

impl fmt::Display for HomingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Reported => f.write_str(
                "bit 13 of 6041h: the drive reports a homing error; check 6098h, the switches in \
                 60FDh and 6099h",
            ),
            Self::Interrupted => f.write_str(
                "the drive stopped before it was home (001 in bits 13, 12, 10 of 6041h); was it \
                 halted or its mode changed?",
            ),
            Self::TimedOut(after) => write!(
                f,
                "not home after {after:?}; check 6098h, 6099h and whether the switch in 60FDh is \
                 ever reached"
            ),
        }
    }
}

impl std::error::Error for HomingError {}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Not yet enabled in homing mode.
    Waits,
    /// Bit 4 is high since this time; the statusword may still show the previous run.
    Started(Duration),
    /// The run was observed; the time is since when it shows home without standstill.
    Runs(Duration, Option<Duration>),
    Over,
}

/// One homing run.
///
/// ```text
///        enabled in mode 6      running seen, or 100 ms      bits 13, 12, 10
/// Waits -----------------> Started ------------------> Runs ----------------> Over
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Homing {
    phase: Phase,
    timeout: Duration,
}

impl Homing {
    /// How long the statusword may still show the previous run.
    const GRACE: Duration = Duration::from_millis(100);
    /// After this time at home a run is complete, even if the drive never shows target reached.
    const SETTLED: Duration = Duration::from_millis(500);

    /// A run that has not started; `timeout` is its longest duration.
    pub const fn new(timeout: Duration) -> Self {
        Self {
            phase: Phase::Waits,
            timeout,
        }
    }

    /// One cycle. `ready`: the drive is enabled and 6061h shows homing mode. Returns whether to set bit 4, and, once,
    /// how the run ended.
    pub fn step(
        &mut self,
        status: StatusWord,
        ready: bool,
        now: Duration,
    ) -> (bool, Option<Result<(), HomingError>>) {
        let shown = HomingStatus::of(status);
        match self.phase {
            Phase::Waits if ready => {
                self.phase = Phase::Started(now);
                (true, None)
            }
            Phase::Waits | Phase::Over => (false, None),
            Phase::Started(_) | Phase::Runs(..) if !ready => {
                self.end(Err(HomingError::Interrupted))
            }
            Phase::Started(since) => {
                let running = shown == HomingStatus::Running;
                if running || now.saturating_sub(since) >= Self::GRACE {
                    self.phase = Phase::Runs(since, None);
                }
                (true, None)
            }
            Phase::Runs(since, home) => self.run(shown, since, home, now),
        }
    }

    fn run(
        &mut self,
        shown: HomingStatus,
        since: Duration,
        home: Option<Duration>,
        now: Duration,
    ) -> (bool, Option<Result<(), HomingError>>) {
        let settled = home.is_some_and(|home| now.saturating_sub(home) >= Self::SETTLED);
        match shown {
            HomingStatus::Done => self.end(Ok(())),
            HomingStatus::Attained if settled => self.end(Ok(())),
            HomingStatus::FailedMoving | HomingStatus::Failed => {
                self.end(Err(HomingError::Reported))
            }
            HomingStatus::Stopped => self.end(Err(HomingError::Interrupted)),
            _ if now.saturating_sub(since) >= self.timeout => {
                self.end(Err(HomingError::TimedOut(self.timeout)))
            }
            HomingStatus::Attained => {
                self.phase = Phase::Runs(since, home.or(Some(now)));
                (true, None)
            }
            HomingStatus::Running | HomingStatus::Reserved => {
                self.phase = Phase::Runs(since, None);
                (true, None)
            }
        }
    }

    const fn end(
        &mut self,
        outcome: Result<(), HomingError>,
    ) -> (bool, Option<Result<(), HomingError>>) {
        self.phase = Phase::Over;
        (false, Some(outcome))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn word(bits: u16) -> StatusWord {
        StatusWord::new(0x0237 & !0x3400 | bits)
    }

    /// Bits 13, 12, 10 as in the statusword, from three digits.
    fn shows(digits: u16) -> StatusWord {
        word((digits >> 2 & 1) << 13 | (digits >> 1 & 1) << 12 | (digits & 1) << 10)
    }

    fn running() -> Homing {
        let mut homing = Homing::new(1000 * MS);
        assert_eq!(homing.step(shows(0b001), false, MS), (false, None));
        assert_eq!(homing.step(shows(0b001), true, 2 * MS), (true, None));
        assert_eq!(homing.step(shows(0b000), true, 3 * MS), (true, None));
        homing
    }

    /// Each of the eight patterns while it runs.
    #[test]
    fn homing_run_handles_every_status_pattern() {
        for (digits, expected) in [
            (0b000, (true, None)),
            (0b001, (false, Some(Err(HomingError::Interrupted)))),
            (0b010, (true, None)),
            (0b011, (false, Some(Ok(())))),
            (0b100, (false, Some(Err(HomingError::Reported)))),
            (0b101, (false, Some(Err(HomingError::Reported)))),
            (0b110, (true, None)),
            (0b111, (true, None)),
        ] {
            let mut homing = running();
            let step = homing.step(shows(digits), true, 4 * MS);
            assert_eq!(step, expected, "{digits:03b}");
            if expected.1.is_some() {
                assert_eq!(
                    homing.step(shows(digits), true, 5 * MS),
                    (false, None),
                    "once"
                );
            }
        }
    }

    #[test]
    fn homing_run_ignores_status_of_previous_run() {
        let mut homing = Homing::new(1000 * MS);
        homing.step(shows(0b011), true, MS);
        assert_eq!(
            homing.step(shows(0b011), true, 50 * MS),
            (true, None),
            "still old"
        );
        assert_eq!(homing.step(shows(0b011), true, 101 * MS), (true, None));
        // A method without motion may complete between two cycles.
        assert_eq!(
            homing.step(shows(0b011), true, 102 * MS),
            (false, Some(Ok(())))
        );
    }

    #[test]
    fn homing_run_completes_without_target_reached() {
        let mut homing = running();
        assert_eq!(homing.step(shows(0b010), true, 10 * MS), (true, None));
        assert_eq!(homing.step(shows(0b010), true, 509 * MS), (true, None));
        assert_eq!(
            homing.step(shows(0b010), true, 510 * MS),
            (false, Some(Ok(())))
        );
    }

    #[test]
    fn homing_run_ends_by_timeout_or_interruption() {
        let mut homing = running();
        let timed_out = Err(HomingError::TimedOut(1000 * MS));
        assert_eq!(
            homing.step(shows(0b000), true, 1002 * MS),
            (false, Some(timed_out))
        );
        let mut homing = running();
        let interrupted = Err(HomingError::Interrupted);
        assert_eq!(
            homing.step(shows(0b000), false, 9 * MS),
            (false, Some(interrupted))
        );
    }
}

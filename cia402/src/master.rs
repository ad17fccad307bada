//! The master's side over time: brings one axis to a goal, keeps its target at the actual position until the drive
//! follows, resets faults by an edge, and reports why a drive does not reach its goal. It sends nothing itself, and it
//! never resets a fault without a request.
//!
//! ```text
//! each cycle: Feedback (6041h, 6061h, 6064h) -> step -> DriveCommand (6040h, 6060h, may the target move)
//!
//!             set_goal         1 mode first: 6060h until 6061h shows it (mode_after_enable: last)
//! Operation   ---------->      2 one command per state, by next_control_word
//! enabled                      3 target = actual until Operation enabled, and in cyclic modes
//!                                until bit 12 shows that the drive follows
//! reset_fault ---------->      bit 7 low, high for two cycles, low; bounded number of tries
//! ```

use std::fmt;
use std::time::Duration;

use crate::proof::ProofFault;
use crate::{ControlWord, DecodeError, Goal, State, StatusWord, next_control_word};

/// What a master receives from an axis in a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Feedback {
    /// 6041h.
    pub status: StatusWord,
    /// 6061h; `None` if it is not mapped.
    pub mode: Option<i8>,
    /// 6064h, user units.
    pub position: i32,
}

/// What a master sends to an axis in a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DriveCommand {
    /// 6040h without the mode-specific bits.
    pub control: ControlWord,
    /// 6060h.
    pub mode: i8,
    /// Whether the drive follows its target. While it does not, the target must be the actual
    /// value: [`Self::hold`] for 607Ah, zero for 60FFh and 6071h.
    pub follows: bool,
    /// The actual position as last received, user units.
    pub hold: i32,
}

/// Tolerated deviations of a drive from the profile, and timeouts of the master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MasterOptions {
    /// 0020h in the statusword is Switch on disabled (slaves on an old sample stack).
    pub sod_as_0020: bool,
    /// The mode changes only in Operation enabled.
    pub mode_after_enable: bool,
    /// Bit 12 does not show whether a cyclic mode follows.
    pub no_follow_bit: bool,
    /// Longest time from a command to the state it leads to; that of enabling, with its brake and
    /// its DC link, is [`Self::enable`].
    pub state: Duration,
    /// Longest time for Switched on and Operation enabled.
    pub enable: Duration,
    /// Longest time from 6060h to 6061h.
    pub mode: Duration,
    /// Number of attempts of a fault reset.
    pub resets: u8,
    /// After this many consecutive enablings that ended in a fault, no further fault is reset.
    pub enablings: u8,
}

/// Time after which an enabling counts as successful: a later fault has another cause.
const ENABLED_WELL: Duration = Duration::from_millis(500);

impl Default for MasterOptions {
    fn default() -> Self {
        Self {
            sod_as_0020: false,
            mode_after_enable: false,
            no_follow_bit: false,
            state: Duration::from_secs(1),
            enable: Duration::from_secs(3),
            mode: Duration::from_secs(1),
            resets: 3,
            enablings: 3,
        }
    }
}

/// Why an axis has not reached its goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriveFault {
    /// The statusword shows no state.
    Undefined(DecodeError),
    /// A fault is present; 603Fh says which.
    Fault,
    /// The fault remained after this many resets.
    ResetRefused(u8),
    /// This many consecutive enablings ended in a fault; it is not reset again.
    EnablingFails(u8),
    /// Bit 9 is low: the drive is controlled locally.
    NotRemote,
    /// Bit 4 is low: the power stage has no voltage.
    NoVoltage,
    /// 6061h does not show the wanted mode.
    Mode {
        /// 6060h.
        wanted: i8,
        /// 6061h.
        shown: i8,
    },
    /// The state did not follow the controlword.
    Stuck {
        /// Present state.
        state: State,
        /// Controlword that was sent.
        sent: ControlWord,
        /// Time since then.
        waited: Duration,
    },
    /// A quick stop is held: the option code leaves the drive in Quick stop active.
    QuickStopHeld,
    /// Enabled, but bit 12 shows that the drive does not follow its target.
    NotFollowing,
    /// The process data are not proven: the axis gets no power.
    NotProven(ProofFault),
}

impl fmt::Display for DriveFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Undefined(error) => error.fmt(f),
            Self::Fault => f.write_str("the drive is in fault: read 603Fh, fix the cause, reset"),
            Self::ResetRefused(tries) => write!(
                f,
                "the fault remained after {tries} resets: its cause is still present; see 603Fh"
            ),
            Self::EnablingFails(times) => write!(
                f,
                "{times} enablings in a row ended in a fault: find its cause by the EMCY or 603Fh; it is reset no \
                 more until another goal is set, the drive leaves the fault by other means or its node starts again"
            ),
            Self::NotRemote => f.write_str(
                "bit 9 of 6041h is low: the drive is controlled locally; close its service tool",
            ),
            Self::NoVoltage => f.write_str(
                "bit 4 of 6041h is low: no voltage; check mains, DC link, safe torque off",
            ),
            Self::Mode { wanted, shown } => write!(
                f,
                "6061h shows mode {shown}, not {wanted}; check 6502h, and whether the drive \
                 changes mode only with halt low, or only when enabled (quirk mode_after_enable)"
            ),
            Self::Stuck {
                state,
                sent,
                waited,
            } => write!(
                f,
                "{state} for {waited:?} although 6040h is {sent}; is 6040h mapped and the PDO \
                 received?{}",
                if *state == State::NotReadyToSwitchOn {
                    " If 6041h is 0020h, set the quirk sod_as_0020"
                } else {
                    ""
                }
            ),
            Self::QuickStopHeld => f.write_str(
                "a quick stop is held (605Ah is 5 to 8); command Switch on disabled to leave it",
            ),
            Self::NotFollowing => f.write_str(
                "enabled, but bit 12 of 6041h shows that the target is ignored; check the mode and that set-points \
                 come in every cycle, or set the quirk no_follow_bit if its manual gives bit 12 no meaning",
            ),
            Self::NotProven(fault) => fault.fmt(f),
        }
    }
}

/// State of a fault reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reset {
    /// No reset requested.
    Idle,
    /// Bit 7 is low for this many more cycles, to make an edge.
    Low(u8),
    /// Bit 7 is high for this many more cycles.
    High(u8),
}

/// The master of one axis.
#[derive(Clone, Debug)]
pub struct Master {
    options: MasterOptions,
    goal: Goal,
    /// Highest state allowed on the path to the goal.
    ceiling: Goal,
    mode: i8,
    reset: Reset,
    tries: u8,
    /// The last observed state and since when.
    seen: Option<(State, Duration)>,
    /// Since when the mode has been wanted.
    mode_since: Option<Duration>,
    drive_fault: Option<DriveFault>,
    /// The state of the last cycle and since when, independent of the goal.
    last: Option<(State, Duration)>,
    /// Consecutive enablings that ended in a fault.
    failures: u8,
}

impl Master {
    /// A master of an axis whose goal is to be without power.
    pub const fn new(options: MasterOptions) -> Self {
        Self {
            options,
            goal: Goal::SwitchOnDisabled,
            ceiling: Goal::OperationEnabled,
            mode: 0,
            reset: Reset::Idle,
            tries: 0,
            seen: None,
            mode_since: None,
            drive_fault: None,
            last: None,
            failures: 0,
        }
    }

    /// Sets the goal of the axis.
    pub fn set_goal(&mut self, goal: Goal) {
        if goal != self.goal {
            self.goal = goal;
            self.seen = None;
            if goal != Goal::OperationEnabled {
                self.failures = 0;
            }
        }
    }

    /// Limits the state of the axis for the time being; the goal is unchanged. A quick stop is not limited.
    pub fn set_ceiling(&mut self, ceiling: Goal) {
        if ceiling != self.ceiling {
            self.ceiling = ceiling;
            self.seen = None;
        }
    }

    /// The goal, limited by the ceiling.
    fn allowed(&self) -> Goal {
        let rank = |goal| match goal {
            Goal::SwitchOnDisabled => 0,
            Goal::ReadyToSwitchOn => 1,
            Goal::SwitchedOn => 2,
            Goal::OperationEnabled | Goal::QuickStop => 3,
        };
        if self.goal != Goal::QuickStop && rank(self.ceiling) < rank(self.goal) {
            self.ceiling
        } else {
            self.goal
        }
    }

    /// The goal.
    pub const fn goal(&self) -> Goal {
        self.goal
    }

    /// The commanded mode of operation.
    pub const fn mode(&self) -> i8 {
        self.mode
    }

    /// Sets the mode of operation (6060h).
    pub fn set_mode(&mut self, mode: i8) {
        if mode != self.mode {
            self.mode = mode;
            self.mode_since = None;
        }
    }

    /// Requests a fault reset; afterwards the drive is brought to the goal.
    pub const fn reset_fault(&mut self) {
        self.reset = Reset::Low(2);
        self.tries = 0;
    }

    /// Why the axis has not reached its goal; `None` while it has, or is on schedule.
    pub const fn drive_fault(&self) -> Option<DriveFault> {
        self.drive_fault
    }

    /// One cycle at time `now` of any clock that does not go back.
    pub fn step(&mut self, feedback: &Feedback, now: Duration) -> DriveCommand {
        let (control, follows) = match self.state(feedback.status) {
            Ok(state) => {
                self.note(state, now);
                let control = self.control(state, feedback, now);
                let enabled = state == State::OperationEnabled;
                let wanted = self.allowed() == Goal::OperationEnabled;
                let mode = feedback.mode.is_none_or(|mode| mode == self.mode);
                (
                    control,
                    enabled && wanted && mode && self.is_followed(feedback.status),
                )
            }
            Err(error) => {
                self.drive_fault = Some(DriveFault::Undefined(error));
                (ControlWord::DISABLE_VOLTAGE, false)
            }
        };
        DriveCommand {
            control,
            mode: self.mode,
            follows,
            hold: feedback.position,
        }
    }

    /// The state that a statusword shows, with the quirks of the drive.
    pub fn state(&self, status: StatusWord) -> Result<State, DecodeError> {
        if self.options.sod_as_0020 && status.raw() & 0x6F == 0x20 {
            return Ok(State::SwitchOnDisabled);
        }
        status.state()
    }

    /// Cyclic modes show by bit 12 whether the target is used.
    fn is_followed(&self, status: StatusWord) -> bool {
        let cyclic = (8..=11).contains(&self.mode);
        !cyclic || self.options.no_follow_bit || status.raw() & 0x1000 != 0
    }

    fn note(&mut self, state: State, now: Duration) {
        if self.seen.is_none_or(|(seen, _)| seen != state) {
            self.seen = Some((state, now));
        }
        let (last, since) = *self.last.get_or_insert((state, now));
        let well = now.saturating_sub(since) >= ENABLED_WELL;
        if last == State::OperationEnabled && well {
            self.failures = 0;
        }
        if last != state {
            self.last = Some((state, now));
            self.count_failure(last, state, well);
        }
    }

    /// A fault before Operation enabled, or soon after it, is a failed enabling. A fault that was reset by others does
    /// not count.
    fn count_failure(&mut self, before: State, state: State, well: bool) {
        let in_fault = |state| matches!(state, State::Fault | State::FaultReactionActive);
        let on_its_way = matches!(before, State::ReadyToSwitchOn | State::SwitchedOn)
            || before == State::OperationEnabled && !well;
        if in_fault(state) && on_its_way && self.goal == Goal::OperationEnabled {
            self.failures = self.failures.saturating_add(1);
        } else if in_fault(before) && !in_fault(state) && self.reset == Reset::Idle {
            self.failures = 0;
        }
    }

    /// Whether a fault may be reset again.
    const fn may_reset(&self) -> bool {
        self.failures < self.options.enablings
    }

    fn control(&mut self, state: State, feedback: &Feedback, now: Duration) -> ControlWord {
        if state == State::Fault {
            return self.reset();
        }
        self.reset = Reset::Idle;
        let allowed = self.allowed();
        let mode_first = !self.options.mode_after_enable && allowed == Goal::OperationEnabled;
        let shown = feedback.mode.unwrap_or(self.mode);
        if allowed != Goal::OperationEnabled {
            self.mode_since = None;
        }
        let since = *self.mode_since.get_or_insert(now);
        let late = now.saturating_sub(since) > self.options.mode;
        let wrong = shown != self.mode && allowed == Goal::OperationEnabled;
        let mode = (wrong && late).then_some(DriveFault::Mode {
            wanted: self.mode,
            shown,
        });
        // With the wrong mode the drive goes up to Switched on and waits there.
        let enables = state == State::SwitchedOn && wrong && mode_first;
        let goal = if enables { Goal::SwitchedOn } else { allowed };
        let control = next_control_word(state, goal);
        self.drive_fault = mode.or_else(|| self.judge(state, feedback.status, control, now));
        control
    }

    fn judge(
        &self,
        state: State,
        status: StatusWord,
        sent: ControlWord,
        now: Duration,
    ) -> Option<DriveFault> {
        let since = self.seen.map_or(now, |(_, since)| since);
        let waited = now.saturating_sub(since);
        let slow = matches!(state, State::ReadyToSwitchOn | State::SwitchedOn);
        let timeout = if slow {
            self.options.enable
        } else {
            self.options.state
        };
        let late = waited > timeout;
        if self.allowed().is_reached(state) {
            let ignored = self.goal == Goal::OperationEnabled && !self.is_followed(status);
            return (ignored && late).then_some(DriveFault::NotFollowing);
        }
        if state == State::FaultReactionActive {
            return Some(DriveFault::Fault);
        }
        if !late {
            return None;
        }
        // Bit 5 alone: what an old sample stack shows in Switch on disabled. Its other bits say nothing.
        let shows_0020 = status.raw() & 0x6F == 0x20;
        Some(if state == State::QuickStopActive {
            DriveFault::QuickStopHeld
        } else if !status.remote() && !shows_0020 {
            DriveFault::NotRemote
        } else if !status.voltage_enabled() && state != State::NotReadyToSwitchOn {
            DriveFault::NoVoltage
        } else {
            DriveFault::Stuck {
                state,
                sent,
                waited,
            }
        })
    }

    /// In Fault: bit 7 low unless a reset was requested, then an edge.
    fn reset(&mut self) -> ControlWord {
        if !self.may_reset() {
            self.reset = Reset::Idle;
            self.drive_fault = Some(DriveFault::EnablingFails(self.failures));
            return ControlWord::DISABLE_VOLTAGE;
        }
        self.drive_fault = Some(if self.tries >= self.options.resets {
            DriveFault::ResetRefused(self.tries)
        } else {
            DriveFault::Fault
        });
        match self.reset {
            // The edge would not reach the drive now.
            _ if self.ceiling == Goal::SwitchOnDisabled => ControlWord::DISABLE_VOLTAGE,
            Reset::Idle => ControlWord::DISABLE_VOLTAGE,
            Reset::Low(0) if self.tries >= self.options.resets => {
                self.reset = Reset::Idle;
                ControlWord::DISABLE_VOLTAGE
            }
            Reset::Low(0) => {
                self.tries += 1;
                self.reset = Reset::High(1);
                ControlWord::FAULT_RESET
            }
            Reset::Low(left) => {
                self.reset = Reset::Low(left - 1);
                ControlWord::DISABLE_VOLTAGE
            }
            Reset::High(0) => {
                self.reset = Reset::Low(10);
                ControlWord::DISABLE_VOLTAGE
            }
            Reset::High(left) => {
                self.reset = Reset::High(left - 1);
                ControlWord::FAULT_RESET
            }
        }
    }
}

#[cfg(test)]
mod tests;

//! The master's side: the controlword that brings a drive towards its goal. Total over states and goals and without
//! memory: it does not check whether the drive is slow to follow.

use crate::{ControlWord, State};

/// The state in which a master wants a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Goal {
    /// No power, at once. A moving motor is stopped by its brake alone.
    SwitchOnDisabled,
    /// Power may be switched on.
    ReadyToSwitchOn,
    /// Power on, motor without current.
    SwitchedOn,
    /// Following set-points.
    OperationEnabled,
    /// Stopped, as the quick stop option code says.
    QuickStop,
}

impl Goal {
    /// True if the drive has reached the goal. A quick stop is reached in Quick stop active and in Switch on disabled;
    /// whether the motor has stopped, the actual velocity shows.
    pub fn is_reached(self, state: State) -> bool {
        match self {
            Self::SwitchOnDisabled => state == State::SwitchOnDisabled,
            Self::ReadyToSwitchOn => state == State::ReadyToSwitchOn,
            Self::SwitchedOn => state == State::SwitchedOn,
            Self::OperationEnabled => state == State::OperationEnabled,
            Self::QuickStop => {
                matches!(state, State::QuickStopActive | State::SwitchOnDisabled)
            }
        }
    }
}

/// The controlword for this cycle, mode bits low; sent again each cycle until the state changes.
///
/// In Fault and Fault reaction active it is *disable voltage* for every goal: [`ControlWord::FAULT_RESET`] requests a
/// reset, a goal never does. In Quick stop active the stop is held, unless [`Goal::SwitchOnDisabled`] cuts the power.
pub fn next_control_word(state: State, goal: Goal) -> ControlWord {
    match goal {
        Goal::SwitchOnDisabled => ControlWord::DISABLE_VOLTAGE,
        Goal::QuickStop => stop(state),
        Goal::ReadyToSwitchOn => power(state, ControlWord::SHUTDOWN, ControlWord::SHUTDOWN),
        Goal::SwitchedOn => power(state, ControlWord::SWITCH_ON, ControlWord::SWITCH_ON),
        Goal::OperationEnabled => {
            power(state, ControlWord::SWITCH_ON, ControlWord::ENABLE_OPERATION)
        }
    }
}

fn stop(state: State) -> ControlWord {
    match state {
        State::FaultReactionActive | State::Fault => ControlWord::DISABLE_VOLTAGE,
        State::NotReadyToSwitchOn
        | State::SwitchOnDisabled
        | State::ReadyToSwitchOn
        | State::SwitchedOn
        | State::OperationEnabled
        | State::QuickStopActive => ControlWord::QUICK_STOP,
    }
}

/// Goals with power allowed: what to send in Ready to switch on, and in the two states above it.
fn power(state: State, when_ready: ControlWord, when_on: ControlWord) -> ControlWord {
    match state {
        State::NotReadyToSwitchOn | State::FaultReactionActive | State::Fault => {
            ControlWord::DISABLE_VOLTAGE
        }
        State::SwitchOnDisabled => ControlWord::SHUTDOWN,
        State::ReadyToSwitchOn => when_ready,
        State::SwitchedOn | State::OperationEnabled => when_on,
        State::QuickStopActive => ControlWord::QUICK_STOP,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Trigger, transition};

    const GOALS: [Goal; 5] = [
        Goal::SwitchOnDisabled,
        Goal::ReadyToSwitchOn,
        Goal::SwitchedOn,
        Goal::OperationEnabled,
        Goal::QuickStop,
    ];

    /// Rows as `State::ALL`, columns as `GOALS`.
    const CELLS: [[u16; 5]; 8] = [
        [0x00, 0x00, 0x00, 0x00, 0x02],
        [0x00, 0x06, 0x06, 0x06, 0x02],
        [0x00, 0x06, 0x07, 0x07, 0x02],
        [0x00, 0x06, 0x07, 0x0F, 0x02],
        [0x00, 0x06, 0x07, 0x0F, 0x02],
        [0x00, 0x02, 0x02, 0x02, 0x02],
        [0x00, 0x00, 0x00, 0x00, 0x00],
        [0x00, 0x00, 0x00, 0x00, 0x00],
    ];

    #[test]
    fn control_word_for_every_state_and_goal() {
        for (state, row) in State::ALL.into_iter().zip(CELLS) {
            for (goal, raw) in GOALS.into_iter().zip(row) {
                let word = next_control_word(state, goal);
                assert_eq!(word, ControlWord::new(raw), "{goal:?} in {state}");
            }
        }
    }

    /// The states that a drive passes which executes each word at once and makes no transition by itself.
    fn states_passed(from: State, goal: Goal) -> Vec<State> {
        let mut passed = vec![from];
        let mut state = from;
        let mut previous = ControlWord::DISABLE_VOLTAGE;
        for _ in 0..8 {
            let word = next_control_word(state, goal);
            let command = word.command(previous).map(Trigger::Command);
            if let Some(arrow) = command.and_then(|trigger| transition(state, trigger)) {
                state = arrow.to;
                passed.push(state);
            }
            previous = word;
        }
        passed
    }

    #[test]
    fn goals_are_reached_from_every_state_at_rest() {
        let at_rest = [
            State::SwitchOnDisabled,
            State::ReadyToSwitchOn,
            State::SwitchedOn,
        ];
        for from in at_rest.into_iter().chain([State::OperationEnabled]) {
            for goal in GOALS {
                let passed = states_passed(from, goal);
                let last = passed.last().copied().unwrap();
                assert!(goal.is_reached(last), "{goal:?} from {from}: {passed:?}");
            }
        }
    }

    #[test]
    fn quick_stop_never_passes_operation_enabled() {
        for from in State::ALL {
            let passed = states_passed(from, Goal::QuickStop);
            assert!(
                !passed[1..].contains(&State::OperationEnabled),
                "{from}: {passed:?}"
            );
        }
    }

    #[test]
    fn fault_is_left_by_reset_only() {
        for goal in GOALS {
            assert_eq!(
                states_passed(State::Fault, goal),
                [State::Fault],
                "{goal:?}"
            );
            let before = next_control_word(State::Fault, goal);
            let command = ControlWord::FAULT_RESET
                .command(before)
                .map(Trigger::Command);
            let arrow = command.and_then(|trigger| transition(State::Fault, trigger));
            assert_eq!(arrow.map(|t| t.number), Some(15), "{goal:?}");
        }
    }

    #[test]
    fn quick_stop_under_way_is_held_until_power_is_cut() {
        for goal in GOALS {
            let passed = states_passed(State::QuickStopActive, goal);
            let leaves = passed.len() > 1;
            assert_eq!(
                leaves,
                goal == Goal::SwitchOnDisabled,
                "{goal:?}: {passed:?}"
            );
        }
    }
}

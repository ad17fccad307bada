//! Transitions 0 to 16 of the profile as data, and which of them a controlword causes: the drive's side of the state
//! machine. What a drive does during a transition (ramps, brakes) is not here.

use std::fmt;

use crate::{ControlWord, State};

/// The command in a controlword.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Command {
    /// `cw & 0x87 == 0x06`
    Shutdown,
    /// `cw & 0x8F == 0x07`; in Operation enabled the same bits are *disable operation*.
    SwitchOn,
    /// `cw & 0x8F == 0x0F`
    EnableOperation,
    /// `cw & 0x82 == 0x00`
    DisableVoltage,
    /// `cw & 0x86 == 0x02`
    QuickStop,
    /// Rising edge of bit 7; while the bit stays high the word commands nothing.
    FaultReset,
}

/// The cause of a transition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Trigger {
    /// Power came on, or the application was reset.
    Start,
    /// The activity of the state is complete: the self test, the quick stop, the fault reaction.
    Done,
    /// The drive detected a fault.
    Fault,
    /// The master commanded it.
    Command(Command),
}

/// A numbered transition of the profile's state diagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transition {
    /// 0 to 16, as in the profile.
    pub number: u8,
    /// Its source states; none for the initial transition.
    pub from: &'static [State],
    /// Its target state.
    pub to: State,
    /// Its triggers: any of these.
    pub triggers: &'static [Trigger],
}

const SHUTDOWN: Trigger = Trigger::Command(Command::Shutdown);
const SWITCH_ON: Trigger = Trigger::Command(Command::SwitchOn);
const ENABLE_OPERATION: Trigger = Trigger::Command(Command::EnableOperation);
const DISABLE_VOLTAGE: Trigger = Trigger::Command(Command::DisableVoltage);
const QUICK_STOP: Trigger = Trigger::Command(Command::QuickStop);
const FAULT_RESET: Trigger = Trigger::Command(Command::FaultReset);

const fn arrow(
    number: u8,
    from: &'static [State],
    to: State,
    triggers: &'static [Trigger],
) -> Transition {
    Transition {
        number,
        from,
        to,
        triggers,
    }
}

/// All transitions by number. An automatic transition 12 needs a 605Ah of 0 to 4, transition 16 one of 5 to 8; many
/// drives do not support 16.
pub const TRANSITIONS: [Transition; 17] = {
    use State::{
        Fault, FaultReactionActive, NotReadyToSwitchOn, OperationEnabled, QuickStopActive,
        ReadyToSwitchOn, SwitchOnDisabled, SwitchedOn,
    };
    [
        arrow(0, &[], NotReadyToSwitchOn, &[Trigger::Start]),
        arrow(1, &[NotReadyToSwitchOn], SwitchOnDisabled, &[Trigger::Done]),
        arrow(2, &[SwitchOnDisabled], ReadyToSwitchOn, &[SHUTDOWN]),
        arrow(
            3,
            &[ReadyToSwitchOn],
            SwitchedOn,
            &[SWITCH_ON, ENABLE_OPERATION],
        ),
        arrow(4, &[SwitchedOn], OperationEnabled, &[ENABLE_OPERATION]),
        arrow(5, &[OperationEnabled], SwitchedOn, &[SWITCH_ON]),
        arrow(6, &[SwitchedOn], ReadyToSwitchOn, &[SHUTDOWN]),
        arrow(
            7,
            &[ReadyToSwitchOn],
            SwitchOnDisabled,
            &[DISABLE_VOLTAGE, QUICK_STOP],
        ),
        arrow(8, &[OperationEnabled], ReadyToSwitchOn, &[SHUTDOWN]),
        arrow(9, &[OperationEnabled], SwitchOnDisabled, &[DISABLE_VOLTAGE]),
        arrow(
            10,
            &[SwitchedOn],
            SwitchOnDisabled,
            &[DISABLE_VOLTAGE, QUICK_STOP],
        ),
        arrow(11, &[OperationEnabled], QuickStopActive, &[QUICK_STOP]),
        arrow(
            12,
            &[QuickStopActive],
            SwitchOnDisabled,
            &[Trigger::Done, DISABLE_VOLTAGE],
        ),
        arrow(
            13,
            &[
                NotReadyToSwitchOn,
                SwitchOnDisabled,
                ReadyToSwitchOn,
                SwitchedOn,
                OperationEnabled,
                QuickStopActive,
            ],
            FaultReactionActive,
            &[Trigger::Fault],
        ),
        arrow(14, &[FaultReactionActive], Fault, &[Trigger::Done]),
        arrow(15, &[Fault], SwitchOnDisabled, &[FAULT_RESET]),
        arrow(
            16,
            &[QuickStopActive],
            OperationEnabled,
            &[ENABLE_OPERATION],
        ),
    ]
};

impl ControlWord {
    /// The command in the word, given the previous word (for the edge of bit 7). `None` while bit 7 stays high.
    pub const fn command(self, previous: Self) -> Option<Command> {
        if self.fault_reset() {
            return if previous.fault_reset() {
                None
            } else {
                Some(Command::FaultReset)
            };
        }
        let raw = self.raw();
        // The safer bit has priority: voltage, then quick stop, then the commands upwards.
        Some(if raw & 0x02 == 0 {
            Command::DisableVoltage
        } else if raw & 0x04 == 0 {
            Command::QuickStop
        } else if raw & 0x01 == 0 {
            Command::Shutdown
        } else if raw & 0x08 == 0 {
            Command::SwitchOn
        } else {
            Command::EnableOperation
        })
    }
}

/// The transition out of `state` that `trigger` causes, if there is one.
pub fn transition(state: State, trigger: Trigger) -> Option<&'static Transition> {
    TRANSITIONS
        .iter()
        .find(|t| t.from.contains(&state) && t.triggers.contains(&trigger))
}

impl fmt::Display for Transition {
    /// `T4 to operation enabled`
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "T{} to {}", self.number, self.to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_is_in_order_of_numbers() {
        for (index, transition) in TRANSITIONS.iter().enumerate() {
            assert_eq!(usize::from(transition.number), index);
        }
        assert_eq!(TRANSITIONS[4].to_string(), "T4 to operation enabled");
    }

    /// Number of the transition for each state (rows as `State::ALL`) and command (columns: shutdown,
    /// switch on, enable operation, disable voltage, quick stop, fault reset); 0 for none.
    const CELLS: [[u8; 6]; 8] = [
        [0, 0, 0, 0, 0, 0],
        [2, 0, 0, 0, 0, 0],
        [0, 3, 3, 7, 7, 0],
        [6, 0, 4, 10, 10, 0],
        [8, 5, 0, 9, 11, 0],
        [0, 0, 16, 12, 0, 0],
        [0, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 15],
    ];

    const COMMANDS: [ControlWord; 6] = [
        ControlWord::SHUTDOWN,
        ControlWord::SWITCH_ON,
        ControlWord::ENABLE_OPERATION,
        ControlWord::DISABLE_VOLTAGE,
        ControlWord::QUICK_STOP,
        ControlWord::FAULT_RESET,
    ];

    #[test]
    fn commands_in_every_state() {
        for (state, row) in State::ALL.into_iter().zip(CELLS) {
            for (word, number) in COMMANDS.into_iter().zip(row) {
                let command = word.command(ControlWord::DISABLE_VOLTAGE).unwrap();
                let found = transition(state, Trigger::Command(command));
                assert_eq!(found.map_or(0, |t| t.number), number, "{word} in {state}");
            }
        }
    }

    #[test]
    fn automatic_transitions_in_every_state() {
        let by_itself = [1, 0, 0, 0, 0, 12, 14, 0];
        let on_fault = [13, 13, 13, 13, 13, 13, 0, 0];
        for (index, state) in State::ALL.into_iter().enumerate() {
            let number = |trigger| transition(state, trigger).map_or(0, |t| t.number);
            assert_eq!(number(Trigger::Done), by_itself[index], "{state}");
            assert_eq!(number(Trigger::Fault), on_fault[index], "{state}");
            assert_eq!(number(Trigger::Start), 0, "{state}");
        }
    }

    /// The masks of the profile, each command by itself.
    fn reference(raw: u16) -> Command {
        let mut fits = Vec::new();
        for (mask, value, command) in [
            (0x87, 0x06, Command::Shutdown),
            (0x8F, 0x07, Command::SwitchOn),
            (0x8F, 0x0F, Command::EnableOperation),
            (0x82, 0x00, Command::DisableVoltage),
            (0x86, 0x02, Command::QuickStop),
            (0x80, 0x80, Command::FaultReset),
        ] {
            if raw & mask == value {
                fits.push(command);
            }
        }
        assert_eq!(fits.len(), 1, "{raw:#06x}");
        fits[0]
    }

    #[test]
    fn every_controlword_agrees_with_the_reference() {
        for raw in 0..=u16::MAX {
            let word = ControlWord::new(raw);
            assert_eq!(
                word.command(ControlWord::DISABLE_VOLTAGE),
                Some(reference(raw)),
                "{word}"
            );
        }
    }

    #[test]
    fn fault_reset_held_high_commands_nothing() {
        assert_eq!(
            ControlWord::FAULT_RESET.command(ControlWord::FAULT_RESET),
            None
        );
        assert_eq!(
            ControlWord::new(0x008F).command(ControlWord::new(0x0080)),
            None
        );
    }
}

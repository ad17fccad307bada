//! The eight states and how a statusword shows them. The transitions are in the table of [`crate::transition()`].

use std::fmt;

use crate::{DecodeError, StatusWord};

/// A state of the drive (the power drive system of IEC 61800-7-201).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// Initialization and self test; commands are ignored.
    NotReadyToSwitchOn,
    /// Parameters may be set; power may not be switched on.
    SwitchOnDisabled,
    /// Power may be switched on.
    ReadyToSwitchOn,
    /// Power is on; the motor gets no current.
    SwitchedOn,
    /// The motor follows its set-points.
    OperationEnabled,
    /// Stopping as 605Ah says, or stopped.
    QuickStopActive,
    /// A fault was detected; the drive stops as 605Eh says.
    FaultReactionActive,
    /// The fault reaction is complete; only a fault reset leads out.
    Fault,
}

/// State, mask and value of the statusword. No word fits two rows.
const SHOWN: [(State, u16, u16); 8] = [
    (State::NotReadyToSwitchOn, 0x4F, 0x00),
    (State::SwitchOnDisabled, 0x4F, 0x40),
    (State::ReadyToSwitchOn, 0x6F, 0x21),
    (State::SwitchedOn, 0x6F, 0x23),
    (State::OperationEnabled, 0x6F, 0x27),
    (State::QuickStopActive, 0x6F, 0x07),
    (State::FaultReactionActive, 0x4F, 0x0F),
    (State::Fault, 0x4F, 0x08),
];

impl State {
    /// All of them, in the order of the profile.
    pub const ALL: [Self; 8] = [
        Self::NotReadyToSwitchOn,
        Self::SwitchOnDisabled,
        Self::ReadyToSwitchOn,
        Self::SwitchedOn,
        Self::OperationEnabled,
        Self::QuickStopActive,
        Self::FaultReactionActive,
        Self::Fault,
    ];

    /// The statusword bits of this state; bits that the state does not define are low.
    pub(crate) fn status_bits(self) -> u16 {
        SHOWN
            .iter()
            .find(|(state, _, _)| *state == self)
            .map_or(0, |(_, _, value)| *value)
    }
}

impl StatusWord {
    /// The state the word shows.
    pub fn state(self) -> Result<State, DecodeError> {
        let fits = |(_, mask, value): &&(State, u16, u16)| self.raw() & mask == *value;
        match SHOWN.iter().find(fits) {
            Some((state, _, _)) => Ok(*state),
            None => Err(DecodeError::UndefinedState { word: self }),
        }
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotReadyToSwitchOn => "not ready to switch on",
            Self::SwitchOnDisabled => "switch on disabled",
            Self::ReadyToSwitchOn => "ready to switch on",
            Self::SwitchedOn => "switched on",
            Self::OperationEnabled => "operation enabled",
            Self::QuickStopActive => "quick stop active",
            Self::FaultReactionActive => "fault reaction active",
            Self::Fault => "fault",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The profile's table by its bits: 6 (switch on disabled), 5 (quick stop), 3 to 0.
    fn reference(word: u16) -> Option<State> {
        let bit = |n: u16| word >> n & 1;
        match (bit(6), bit(5), bit(3), bit(2), bit(1), bit(0)) {
            (0, _, 0, 0, 0, 0) => Some(State::NotReadyToSwitchOn),
            (1, _, 0, 0, 0, 0) => Some(State::SwitchOnDisabled),
            (0, 1, 0, 0, 0, 1) => Some(State::ReadyToSwitchOn),
            (0, 1, 0, 0, 1, 1) => Some(State::SwitchedOn),
            (0, 1, 0, 1, 1, 1) => Some(State::OperationEnabled),
            (0, 0, 0, 1, 1, 1) => Some(State::QuickStopActive),
            (0, _, 1, 1, 1, 1) => Some(State::FaultReactionActive),
            (0, _, 1, 0, 0, 0) => Some(State::Fault),
            _ => None,
        }
    }

    #[test]
    fn every_statusword_agrees_with_the_reference() {
        for raw in 0..=u16::MAX {
            let word = StatusWord::new(raw);
            let expected = reference(raw).ok_or(DecodeError::UndefinedState { word });
            assert_eq!(word.state(), expected, "{word}");
        }
    }

    #[test]
    fn recorded_statuswords_show_their_states() {
        for (raw, state) in [
            (0x0200, State::NotReadyToSwitchOn),
            (0x0250, State::SwitchOnDisabled),
            (0x0231, State::ReadyToSwitchOn),
            (0x0233, State::SwitchedOn),
            (0x1237, State::OperationEnabled),
            (0x0217, State::QuickStopActive),
            (0x021F, State::FaultReactionActive),
            (0x0238, State::Fault),
        ] {
            assert_eq!(StatusWord::new(raw).state(), Ok(state), "{raw:#06x}");
        }
    }

    /// Words recorded from drives of five makers; bits 4 and 7 to 15 are as they were.
    #[test]
    fn statusword_of_recorded_drives_shows_its_state() {
        for (raw, state) in [
            (0x0218, State::Fault),
            (0x0638, State::Fault),
            (0x4238, State::Fault),
            (0x0670, State::SwitchOnDisabled),
            (0x0631, State::ReadyToSwitchOn),
            (0x0633, State::SwitchedOn),
            (0x0637, State::OperationEnabled),
            (0x1037, State::OperationEnabled),
            (0x0740, State::SwitchOnDisabled),
            (0x0721, State::ReadyToSwitchOn),
            (0x0723, State::SwitchedOn),
            (0x0737, State::OperationEnabled),
            (0x12B7, State::OperationEnabled),
            (0x0A50, State::SwitchOnDisabled),
            (0x1A50, State::SwitchOnDisabled),
            (0x1637, State::OperationEnabled),
            (0x1A37, State::OperationEnabled),
        ] {
            assert_eq!(StatusWord::new(raw).state(), Ok(state), "{raw:04X}h");
        }
        let (enabled, fault) = (StatusWord::new(0x1037), StatusWord::new(0x0638));
        assert!(!enabled.remote() && fault.target_reached() && fault.remote());
        assert!(StatusWord::new(0x12B7).warning());
    }

    #[test]
    fn status_bits_decode_to_their_state() {
        for state in State::ALL {
            assert_eq!(StatusWord::new(state.status_bits()).state(), Ok(state));
        }
    }

    #[test]
    fn undefined_statusword_error_names_the_mapping() {
        let text = StatusWord::new(0x0001).state().unwrap_err().to_string();
        assert!(
            text.starts_with("statusword 0x0001 ready-to-switch-on shows no state"),
            "{text}"
        );
    }
}

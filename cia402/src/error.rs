//! Decoding errors of received words. The fault of a drive is not an error but a state.

use crate::StatusWord;

/// Why a received word cannot be decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The state bits fit none of the eight states.
    #[error("statusword {word} shows no state of the profile; check that 6041h is what is mapped")]
    UndefinedState {
        /// As received.
        word: StatusWord,
    },
}

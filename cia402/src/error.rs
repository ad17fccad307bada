//! What can be wrong with what a drive tells. A drive's fault is not here: it is a state.

use crate::StatusWord;

/// Why a word from a drive has no meaning.
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

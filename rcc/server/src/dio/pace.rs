//! When a subscription pushes states. The known client queues what it receives and reads the state of a net when it
//! works on the queue, so that a state or a value that follows a start at once overtakes the start there. It
//! hangs then. The default pace keeps a distance of [`WINDOW`]; clients without such a queue select the other.

use std::time::Duration;

/// For how long changes are collected, and the least time between a start and the values or the end of the net.
pub(super) const WINDOW: Duration = Duration::from_millis(10);

/// When a subscription pushes states, and which.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Pace {
    /// The last state only, [`WINDOW`] after the first change; before the reply of a command, the present one.
    #[default]
    Coalesced,
    /// Every state, at once.
    Every,
}

impl Pace {
    /// The variant of its name on the wire.
    pub(super) fn of_word(word: &str) -> Option<Self> {
        match word {
            "coalesced" => Some(Self::Coalesced),
            "every" => Some(Self::Every),
            _ => None,
        }
    }
}

/// Which of the pending pushes are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pushes {
    /// Those that precede the reply to a command.
    BeforeReply,
    /// All whose time has come, including unloaded nets.
    Due,
}

impl Pushes {
    /// When a change is pushed that is due at `due` if nothing happens before.
    pub(super) const fn at(self, due: Duration) -> Duration {
        match self {
            Self::BeforeReply => Duration::ZERO,
            Self::Due => due,
        }
    }
}

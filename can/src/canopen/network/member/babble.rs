//! A node whose SDO answers belong to no request: it is aborted once, left until it is quiet, and asked again a few
//! times. What is asked, its start-up knows.

use std::time::Duration;

use takt_cia402::dictionary::AbortCode;

use super::{Member, Outcome, SETTLING, Trouble};

/// A node that answers more than it was asked, or not in the protocol.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Babble {
    /// Reported once for each start of the node.
    pub(super) reported: bool,
    /// Requests of the same object in a row that were answered so.
    pub(super) tries: u8,
    /// When it is asked again even if it is not quiet.
    pub(super) end: Duration,
}

/// How often an object is requested that was answered with what is no answer.
const BABBLE_TRIES: u8 = 3;
/// Longest wait for such a node to become quiet.
const BABBLE_MAX: Duration = Duration::from_secs(1);

impl Member {
    /// A node that answered a request of its start-up with what is no answer is asked again when it is quiet; returns
    /// whether it is.
    pub(super) fn ask_again(&mut self, outcome: Outcome, now: Duration) -> bool {
        let Outcome::GaveUp(code) = outcome else {
            self.babble.tries = 0;
            return false;
        };
        if code == AbortCode::TimedOut || self.babble.tries >= BABBLE_TRIES {
            return false;
        }
        self.wanted = self.startup.pending();
        self.babble.tries += 1;
        self.babble.end = now + BABBLE_MAX;
        self.settled = now + SETTLING;
        if !std::mem::replace(&mut self.babble.reported, true) {
            let address = self.client.address();
            self.note(Trouble::Garbled { address, code });
        }
        true
    }
}

//! Handling of unsolicited SDO responses: the transfer is aborted once, and the request of the start procedure is
//! repeated a few times when the node is quiet.

use std::time::Duration;

use takt_cia402::dictionary::AbortCode;

use super::{Member, NodeFault, Outcome, QUIET_TIME};

/// State of a node that sends unsolicited or invalid responses.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Babble {
    /// Reported once for each start of the node.
    pub(super) reported: bool,
    /// Consecutive requests of the same object with such a response.
    pub(super) tries: u8,
    /// Time of the next request even if it is not quiet.
    pub(super) end: Duration,
}

/// Maximum requests of an object with invalid responses.
const BABBLE_TRIES: u8 = 3;
/// Maximum wait for such a node to become quiet.
const BABBLE_MAX: Duration = Duration::from_secs(1);

impl Member {
    /// Schedules the repetition of a start procedure request after an invalid response; returns whether it is repeated.
    pub(super) fn retry_request(&mut self, outcome: Outcome, now: Duration) -> bool {
        let Outcome::GaveUp(code) = outcome else {
            self.babble.tries = 0;
            return false;
        };
        if code == AbortCode::TimedOut || self.babble.tries >= BABBLE_TRIES {
            return false;
        }
        self.pending_request = self.startup.pending();
        self.babble.tries += 1;
        self.babble.end = now + BABBLE_MAX;
        self.quiet_until = now + QUIET_TIME;
        if !std::mem::replace(&mut self.babble.reported, true) {
            let address = self.client.address();
            self.record_fault(NodeFault::Garbled { address, code });
        }
        true
    }
}

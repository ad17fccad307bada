//! Node guarding, master side (CiA 301, clause 7.2.8.3.1): requests the state of a node and checks
//! that the toggle bit alternates. For old slaves without heartbeat.

use std::time::Duration;

use crate::canopen::message::HEARTBEAT;
use crate::canopen::{NmtState, NodeId};
use crate::{Frame, Id};

/// Result of a guarding response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Guarded {
    /// The node is present, in this state.
    Alive(NmtState),
    /// The toggle bit did not alternate: a response was lost or is stale, or another node responds
    /// too.
    Toggle(NmtState),
    /// A boot-up message: the node has restarted.
    Restarted,
}

/// The master of one guarded node.
#[derive(Clone, Debug)]
pub struct Guarding {
    cob: Id,
    period: Duration,
    factor: u8,
    due: Duration,
    toggle: bool,
    /// Unanswered requests.
    open: u8,
}

impl Guarding {
    /// Sends a request every `period` (100Ch) from `now` on; the node is lost after `factor` (100Dh) unanswered
    /// requests.
    pub fn new(node: NodeId, period: Duration, factor: u8, now: Duration) -> Self {
        Self {
            cob: node.cob(HEARTBEAT),
            period: period.max(Duration::from_millis(1)),
            factor: factor.max(1),
            due: now,
            toggle: false,
            open: 0,
        }
    }

    /// The next request, if due, and whether the node is lost (repeated with each further request).
    pub fn poll(&mut self, now: Duration) -> Option<(Frame, bool)> {
        if now < self.due {
            return None;
        }
        let lost = self.open >= self.factor;
        self.open = self.open.saturating_add(1);
        let next = self.due + self.period;
        self.due = if next > now { next } else { now + self.period };
        let question = Frame::remote(self.cob, 1).unwrap_or_else(|_| Frame::empty(self.cob));
        Some((question, lost))
    }

    /// Handles a response.
    pub fn handle(&mut self, state: NmtState, toggle: bool) -> Guarded {
        self.open = 0;
        if state == NmtState::BootUp {
            self.toggle = false;
            return Guarded::Restarted;
        }
        let right = toggle == self.toggle;
        self.toggle = !toggle;
        if right {
            Guarded::Alive(state)
        } else {
            Guarded::Toggle(state)
        }
    }

    /// When the next request is due.
    pub const fn poll_timeout(&self) -> Duration {
        self.due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn guarding() -> Guarding {
        Guarding::new(NodeId::new(5).unwrap(), 10 * MS, 3, Duration::ZERO)
    }

    #[test]
    fn guarding_requests_on_grid_count_unanswered_ones() {
        let mut guarding = guarding();
        let (question, lost) = guarding.poll(Duration::ZERO).unwrap();
        assert_eq!((question.to_string().as_str(), lost), ("705#R1", false));
        assert!(guarding.poll(9 * MS).is_none());
        assert!(!guarding.poll(12 * MS).unwrap().1);
        assert_eq!(guarding.poll_timeout(), 20 * MS);
        assert!(!guarding.poll(20 * MS).unwrap().1);
        assert!(guarding.poll(30 * MS).unwrap().1, "three requests are open");
        guarding.handle(NmtState::Operational, false);
        assert!(!guarding.poll(40 * MS).unwrap().1);
    }

    #[test]
    fn guarding_toggle_bit_starts_zero_and_alternates() {
        let mut guarding = guarding();
        let state = NmtState::Operational;
        assert_eq!(guarding.handle(state, false), Guarded::Alive(state));
        assert_eq!(guarding.handle(state, true), Guarded::Alive(state));
        assert_eq!(guarding.handle(state, true), Guarded::Toggle(state));
        assert_eq!(
            guarding.handle(state, false),
            Guarded::Alive(state),
            "it follows the node"
        );
        assert_eq!(guarding.handle(NmtState::BootUp, false), Guarded::Restarted);
        assert_eq!(guarding.handle(state, false), Guarded::Alive(state));
    }
}

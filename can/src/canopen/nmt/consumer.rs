//! Heartbeat consumer for one node (CiA 301, clause 7.2.8.3.2).

use std::time::Duration;

use crate::canopen::NmtState;

/// Monitoring state of a node.
///
/// ```text
///            1 any heartbeat            2 timeout   
/// Waiting ---------------------> Alive --------------> Lost
///    ^                             ^                     |
///    | 4 configure                 +---- 3 heartbeat ----+
/// ```
///
/// 1 and 3 are [`Consumer::handle`], 2 is [`Consumer::poll`], 4 is [`Consumer::new`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Watch {
    /// No heartbeat received yet; no timeout runs.
    Waiting,
    /// Last reported state.
    Alive(NmtState),
    /// Heartbeat timeout.
    Lost,
}

/// Change detected by a heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeartbeatEvent {
    /// The same state as before.
    Same,
    /// The first heartbeat, or the first after a loss.
    Appeared(NmtState),
    /// The state changed.
    Changed(NmtState),
    /// Boot-up message of a present node: it has restarted and lost its settings.
    Restarted,
}

/// Heartbeat consumer for one node.
#[derive(Clone, Copy, Debug)]
pub struct Consumer {
    time: Duration,
    last_received: Duration,
    watch: Watch,
}

impl Consumer {
    /// A consumer with this heartbeat timeout; zero: no timeout.
    pub const fn new(time: Duration) -> Self {
        Self {
            time,
            last_received: Duration::ZERO,
            watch: Watch::Waiting,
        }
    }

    /// Monitoring state of the node.
    pub const fn watch(&self) -> Watch {
        self.watch
    }

    /// Handles a heartbeat or boot-up message.
    pub fn handle(&mut self, state: NmtState, now: Duration) -> HeartbeatEvent {
        self.last_received = now;
        let before = std::mem::replace(&mut self.watch, Watch::Alive(state));
        match (before, state) {
            (Watch::Alive(_), NmtState::BootUp) => HeartbeatEvent::Restarted,
            (Watch::Alive(last), _) if last == state => HeartbeatEvent::Same,
            (Watch::Alive(_), _) => HeartbeatEvent::Changed(state),
            (Watch::Waiting | Watch::Lost, _) => HeartbeatEvent::Appeared(state),
        }
    }

    /// Whether the node has just been lost; returned once.
    pub fn poll(&mut self, now: Duration) -> bool {
        let lost = self.poll_timeout().is_some_and(|due| now >= due);
        if lost {
            self.watch = Watch::Lost;
        }
        lost
    }

    /// When the timeout expires.
    pub fn poll_timeout(&self) -> Option<Duration> {
        match self.watch {
            Watch::Alive(_) if !self.time.is_zero() => Some(self.last_received + self.time),
            Watch::Alive(_) | Watch::Waiting | Watch::Lost => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn heartbeat_every_watch_state_with_every_heartbeat() {
        use NmtState::{BootUp, Operational, PreOperational};
        for (watch, state, expected) in [
            (Watch::Waiting, BootUp, HeartbeatEvent::Appeared(BootUp)),
            (
                Watch::Waiting,
                Operational,
                HeartbeatEvent::Appeared(Operational),
            ),
            (Watch::Lost, BootUp, HeartbeatEvent::Appeared(BootUp)),
            (
                Watch::Lost,
                Operational,
                HeartbeatEvent::Appeared(Operational),
            ),
            (Watch::Alive(Operational), Operational, HeartbeatEvent::Same),
            (
                Watch::Alive(Operational),
                PreOperational,
                HeartbeatEvent::Changed(PreOperational),
            ),
            (Watch::Alive(Operational), BootUp, HeartbeatEvent::Restarted),
            (Watch::Alive(BootUp), BootUp, HeartbeatEvent::Restarted),
            (
                Watch::Alive(BootUp),
                PreOperational,
                HeartbeatEvent::Changed(PreOperational),
            ),
        ] {
            let mut consumer = Consumer::new(50 * MS);
            consumer.watch = watch;
            assert_eq!(consumer.handle(state, MS), expected, "{watch:?}, {state}");
            assert_eq!(consumer.watch(), Watch::Alive(state));
        }
    }

    #[test]
    fn heartbeat_timeout_starts_with_first_and_reports_once() {
        let mut consumer = Consumer::new(50 * MS);
        assert_eq!(
            (consumer.poll(900 * MS), consumer.poll_timeout()),
            (false, None)
        );
        consumer.handle(NmtState::Operational, 900 * MS);
        assert_eq!(consumer.poll_timeout(), Some(950 * MS));
        assert!(!consumer.poll(949 * MS));
        assert!(consumer.poll(950 * MS));
        assert!(!consumer.poll(951 * MS));
        assert_eq!(consumer.watch(), Watch::Lost);
        let mut for_ever = Consumer::new(Duration::ZERO);
        for_ever.handle(NmtState::Operational, MS);
        assert!(!for_ever.poll(99_999 * MS));
    }
}

//! Watches the heartbeat of one node (CiA 301, clause 7.2.8.3.2). It asks for nothing; that is
//! node guarding.

use std::time::Duration;

use crate::canopen::NmtState;

/// What is known of a node.
///
/// ```text
///            1 any heartbeat            2 time passed
/// Waiting ---------------------> Alive --------------> Lost
///    ^                             ^                     |
///    | 4 configure                 +---- 3 heartbeat ----+
/// ```
///
/// 1 and 3 are [`Consumer::handle`], 2 is [`Consumer::poll`], 4 is [`Consumer::new`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Watch {
    /// Nothing was heard of it yet; its silence means nothing.
    Waiting,
    /// It said this last.
    Alive(NmtState),
    /// It has been silent for too long.
    Lost,
}

/// What a heartbeat told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heard {
    /// The same as before.
    Same,
    /// The first one, or the first after a loss.
    Appeared(NmtState),
    /// Another state.
    Changed(NmtState),
    /// A boot-up message of a node that was there: it has begun anew, its settings are gone.
    Restarted,
}

/// The consumer of one node's heartbeat.
#[derive(Clone, Copy, Debug)]
pub struct Consumer {
    time: Duration,
    heard: Duration,
    watch: Watch,
}

impl Consumer {
    /// A consumer that allows so long between two heartbeats; zero is for ever.
    #[must_use]
    pub const fn new(time: Duration) -> Self {
        Self {
            time,
            heard: Duration::ZERO,
            watch: Watch::Waiting,
        }
    }

    /// What is known of the node.
    #[must_use]
    pub const fn watch(&self) -> Watch {
        self.watch
    }

    /// Takes a heartbeat or a boot-up message.
    pub fn handle(&mut self, state: NmtState, now: Duration) -> Heard {
        self.heard = now;
        let before = std::mem::replace(&mut self.watch, Watch::Alive(state));
        match (before, state) {
            (Watch::Alive(_), NmtState::BootUp) => Heard::Restarted,
            (Watch::Alive(last), _) if last == state => Heard::Same,
            (Watch::Alive(_), _) => Heard::Changed(state),
            (Watch::Waiting | Watch::Lost, _) => Heard::Appeared(state),
        }
    }

    /// Whether the node has just been lost; told once.
    pub fn poll(&mut self, now: Duration) -> bool {
        let lost = self.poll_timeout().is_some_and(|due| now >= due);
        if lost {
            self.watch = Watch::Lost;
        }
        lost
    }

    /// When it is lost.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Duration> {
        match self.watch {
            Watch::Alive(_) if !self.time.is_zero() => Some(self.heard + self.time),
            Watch::Alive(_) | Watch::Waiting | Watch::Lost => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn every_watch_with_every_heartbeat() {
        use NmtState::{BootUp, Operational, PreOperational};
        for (watch, state, heard) in [
            (Watch::Waiting, BootUp, Heard::Appeared(BootUp)),
            (Watch::Waiting, Operational, Heard::Appeared(Operational)),
            (Watch::Lost, BootUp, Heard::Appeared(BootUp)),
            (Watch::Lost, Operational, Heard::Appeared(Operational)),
            (Watch::Alive(Operational), Operational, Heard::Same),
            (
                Watch::Alive(Operational),
                PreOperational,
                Heard::Changed(PreOperational),
            ),
            (Watch::Alive(Operational), BootUp, Heard::Restarted),
            (Watch::Alive(BootUp), BootUp, Heard::Restarted),
            (
                Watch::Alive(BootUp),
                PreOperational,
                Heard::Changed(PreOperational),
            ),
        ] {
            let mut consumer = Consumer::new(50 * MS);
            consumer.watch = watch;
            assert_eq!(consumer.handle(state, MS), heard, "{watch:?}, {state}");
            assert_eq!(consumer.watch(), Watch::Alive(state));
        }
    }

    #[test]
    fn silence_counts_from_the_first_heartbeat_and_is_told_once() {
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

//! The sessions that clients opened, and which of them are orphaned, i.e. belong to no connection any more. Orphaned
//! sessions without a net that can still run are ended, so that clients that connect and disconnect do not exhaust
//! the quota. What happens to the nets of a lost client is decided elsewhere.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use takt_core::controller::{NetState, SESSIONS_MAX};
use takt_core::{Controller, SessionId};

use crate::access::Credential;

/// How long an empty orphaned session is kept for a client that reconnects, unless another client needs the
/// session.
pub(crate) const ORPHAN_TIMEOUT: Duration = Duration::from_secs(600);

/// Most sessions of clients admitted without a credential; the rest is reserved for the others.
pub(crate) const OPEN_SESSIONS_MAX: usize = SESSIONS_MAX / 4 * 3;

/// The sessions that clients of one server opened. Clones share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sessions(Arc<Mutex<BTreeMap<SessionId, Opened>>>);

#[derive(Clone, Copy, Debug)]
struct Opened {
    by: Credential,
    /// When it lost its connection.
    orphaned_at: Option<Duration>,
}

impl Sessions {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<SessionId, Opened>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether clients without a credential have used up their quota of sessions.
    pub(crate) fn is_full_for(&self, by: Credential) -> bool {
        let open = self.lock();
        let count = open.values().filter(|s| s.by == Credential::Loopback);
        by == Credential::Loopback && count.count() >= OPEN_SESSIONS_MAX
    }

    /// Records that a connection opened a session.
    pub(crate) fn add(&self, session: SessionId, by: Credential) {
        self.lock().insert(
            session,
            Opened {
                by,
                orphaned_at: None,
            },
        );
    }

    /// Records that a session has had no connection since `now`.
    pub(crate) fn orphan(&self, session: SessionId, now: Duration) {
        if let Some(opened) = self.lock().get_mut(&session) {
            opened.orphaned_at = Some(now);
        }
    }

    /// Records that an orphaned session was used now.
    pub(crate) fn touch(&self, session: SessionId, now: Duration) {
        let mut open = self.lock();
        if let Some(orphaned_at) = open.get_mut(&session).and_then(|s| s.orphaned_at.as_mut()) {
            *orphaned_at = now;
        }
    }

    /// Gives an orphaned session to a connection; false if the session is not orphaned.
    pub(crate) fn adopt(&self, session: SessionId) -> bool {
        let mut open = self.lock();
        let opened = open.get_mut(&session);
        opened.is_some_and(|opened| opened.orphaned_at.take().is_some())
    }

    /// Ends sessions that have been orphaned for at least `min_age` and have no net that can still run; at most
    /// `max_count` of them, longest orphaned first.
    pub(crate) fn end_orphaned(
        &self,
        controller: &Controller,
        now: Duration,
        min_age: Duration,
        max_count: usize,
    ) -> usize {
        let mut orphaned: Vec<_> = {
            let mut open = self.lock();
            open.retain(|session, _| controller.session_nets(*session).is_some());
            let orphaned = open
                .iter()
                .filter_map(|(id, s)| Some((s.orphaned_at?, *id)));
            orphaned
                .filter(|(since, _)| now.saturating_sub(*since) >= min_age)
                .collect()
        };
        orphaned.sort_unstable_by_key(|(since, _)| *since);
        let mut ended = 0;
        for (_, session) in orphaned {
            if ended >= max_count {
                break;
            }
            if !is_finished(controller, session) || self.lock().remove(&session).is_none() {
                continue;
            }
            match controller.end_session(session) {
                Ok(()) | Err(takt_core::Error::NoSuchSession(_)) => ended += 1,
                Err(error) => tracing::warn!(%session, %error, "cannot end an empty session"),
            }
        }
        ended
    }
}

/// Whether no net of a session can run any more.
fn is_finished(controller: &Controller, session: SessionId) -> bool {
    let nets = controller.session_nets(session).unwrap_or_default();
    nets.into_iter().all(|net| {
        controller.net(net).is_none_or(|net| {
            matches!(
                net.state(),
                NetState::Terminated | NetState::Rejected | NetState::Unloaded
            )
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_core::CellConfig;
    use takt_core::controller::LoadRequest;

    #[test]
    fn orphaned_session_ends_unless_net_needs_it() {
        let mut cell = CellConfig::default();
        cell.controller.priority = None;
        let controller = Controller::start(&cell).unwrap();
        let sessions = Sessions::default();
        let open = || {
            let session = controller.open_session("test").unwrap();
            sessions.add(session, Credential::Loopback);
            session
        };
        let [held, used, adopted, second, first] = std::array::from_fn(|_| open());
        let text = "{x=Cancel(),outTerminate=x.outCancel}".to_owned();
        let request = LoadRequest {
            text,
            session: used,
            description: String::new(),
            period: None,
        };
        let net = controller.load(request).unwrap();
        let at = Duration::from_secs;
        sessions.orphan(first, at(1));
        sessions.orphan(second, at(2));
        for session in [used, adopted] {
            sessions.orphan(session, at(0));
        }
        assert!(sessions.adopt(adopted) && !sessions.adopt(held));
        let end =
            |now, min_age, max_count| sessions.end_orphaned(&controller, now, min_age, max_count);
        assert_eq!(end(at(3), at(5), 9), 0, "too early");
        assert_eq!(end(at(3), at(0), 1), 1);
        let open = |session| controller.session_nets(session).is_some();
        assert!(
            !open(first) && open(second),
            "longest orphaned is ended first"
        );
        assert_eq!(end(at(7), at(5), 9), 1);
        assert!([held, used, adopted].into_iter().all(open) && !open(second));
        controller.unload(net).unwrap();
        assert_eq!(end(at(7), at(5), 9), 1);
        assert!(!open(used));
    }
}

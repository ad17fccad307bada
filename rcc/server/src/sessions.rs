//! Which sessions clients opened, and which of them belong to no connection any more: those that hold no net
//! which could still do something go, so that clients that come and leave do not use up all there are. What
//! becomes of the nets of a lost client is decided elsewhere.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use takt_core::controller::{NetState, SESSIONS_MAX};
use takt_core::{Controller, SessionId};

use crate::access::Credential;

/// How long an empty session of a lost connection stays for a client that connects again, unless another one
/// needs its place.
pub(crate) const LEFT_WITHIN: Duration = Duration::from_secs(600);

/// Most sessions of clients that were admitted without a credential: the rest is kept for the others.
pub(crate) const OPEN_SESSIONS_MAX: usize = SESSIONS_MAX / 4 * 3;

/// The sessions that clients of one server opened. Clones are the same.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sessions(Arc<Mutex<BTreeMap<SessionId, Opened>>>);

#[derive(Clone, Copy, Debug)]
struct Opened {
    by: Credential,
    /// Since when no connection has it.
    left: Option<Duration>,
}

impl Sessions {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<SessionId, Opened>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether clients without a credential have as many sessions as they may.
    pub(crate) fn is_full_for(&self, by: Credential) -> bool {
        let open = self.lock();
        let count = open.values().filter(|s| s.by == Credential::Loopback);
        by == Credential::Loopback && count.count() >= OPEN_SESSIONS_MAX
    }

    /// Notes that a connection opened a session.
    pub(crate) fn add(&self, session: SessionId, by: Credential) {
        self.lock().insert(session, Opened { by, left: None });
    }

    /// Notes that a session belongs to no connection, since now.
    pub(crate) fn leave(&self, session: SessionId, now: Duration) {
        if let Some(opened) = self.lock().get_mut(&session) {
            opened.left = Some(now);
        }
    }

    /// Notes that a session which belongs to no connection was used now.
    pub(crate) fn touch(&self, session: SessionId, now: Duration) {
        let mut open = self.lock();
        if let Some(left) = open.get_mut(&session).and_then(|s| s.left.as_mut()) {
            *left = now;
        }
    }

    /// A connection goes on with a session that another one left; false if none has to.
    pub(crate) fn adopt(&self, session: SessionId) -> bool {
        let mut open = self.lock();
        let opened = open.get_mut(&session);
        opened.is_some_and(|opened| opened.left.take().is_some())
    }

    /// Ends sessions that were left for at least so long and hold no net that could do anything; at most `most`
    /// of them, the one that was left first before others.
    pub(crate) fn end_left(
        &self,
        controller: &Controller,
        now: Duration,
        least: Duration,
        most: usize,
    ) -> usize {
        let mut left: Vec<_> = {
            let mut open = self.lock();
            open.retain(|session, _| controller.session_nets(*session).is_some());
            let left = open.iter().filter_map(|(id, s)| Some((s.left?, *id)));
            left.filter(|(since, _)| now.saturating_sub(*since) >= least)
                .collect()
        };
        left.sort_unstable_by_key(|(since, _)| *since);
        let mut ended = 0;
        for (_, session) in left {
            if ended >= most {
                break;
            }
            if !is_over(controller, session) || self.lock().remove(&session).is_none() {
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

/// Whether no net of a session can do anything any more.
fn is_over(controller: &Controller, session: SessionId) -> bool {
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
    fn left_session_ends_unless_a_net_needs_it() {
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
        sessions.leave(first, at(1));
        sessions.leave(second, at(2));
        for session in [used, adopted] {
            sessions.leave(session, at(0));
        }
        assert!(sessions.adopt(adopted) && !sessions.adopt(held));
        let end = |now, least, most| sessions.end_left(&controller, now, least, most);
        assert_eq!(end(at(3), at(5), 9), 0, "too early");
        assert_eq!(end(at(3), at(0), 1), 1);
        let open = |session| controller.session_nets(session).is_some();
        assert!(
            !open(first) && open(second),
            "the one left first goes first"
        );
        assert_eq!(end(at(7), at(5), 9), 1);
        assert!([held, used, adopted].into_iter().all(open) && !open(second));
        controller.unload(net).unwrap();
        assert_eq!(end(at(7), at(5), 9), 1);
        assert!(!open(used));
    }
}

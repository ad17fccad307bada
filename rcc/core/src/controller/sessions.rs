//! The open sessions of a controller: their descriptions, and what happens to their nets when their connection is
//! lost. Nets know their session, not the other way round.

use std::collections::BTreeMap;

use crate::cell::OnLoss;
use crate::error::Error;
use crate::ids::SessionId;

/// Maximum number of open sessions.
pub const SESSIONS_MAX: usize = 256;

/// An open session.
#[derive(Debug)]
struct Session {
    description: String,
    on_loss: OnLoss,
}

/// The open sessions.
#[derive(Debug, Default)]
pub(super) struct Sessions {
    open: BTreeMap<SessionId, Session>,
    last: u32,
}

impl Sessions {
    /// Opens a session.
    ///
    /// # Errors
    /// If too many are open.
    pub(super) fn open(&mut self, description: &str, on_loss: OnLoss) -> Result<SessionId, Error> {
        if self.open.len() >= SESSIONS_MAX {
            return Err(Error::TooMany {
                item: "open sessions",
                bound: SESSIONS_MAX,
            });
        }
        self.last += 1;
        let id = SessionId(self.last);
        let description = description.to_owned();
        self.open.insert(
            id,
            Session {
                description,
                on_loss,
            },
        );
        Ok(id)
    }

    pub(super) fn close(&mut self, id: SessionId) {
        self.open.remove(&id);
    }

    /// Whether a net can belong to it: it is open, or no session.
    pub(super) fn is_valid(&self, id: SessionId) -> bool {
        id == SessionId::NONE || self.open.contains_key(&id)
    }

    /// What happens to its nets when its connection is lost; `None` if there is no such session.
    pub(super) fn on_loss(&self, id: SessionId) -> Option<OnLoss> {
        Some(self.open.get(&id)?.on_loss)
    }

    /// Replaces the description of a session.
    ///
    /// # Errors
    /// If there is no such session.
    pub(super) fn describe(&mut self, id: SessionId, description: &str) -> Result<(), Error> {
        let session = self.open.get_mut(&id);
        let session = session.ok_or_else(|| Error::NoSuchSession(id.to_string()))?;
        description.clone_into(&mut session.description);
        Ok(())
    }

    /// The sessions with their descriptions.
    pub(super) fn list(&self) -> Vec<(SessionId, String)> {
        let sessions = self.open.iter();
        sessions
            .map(|(id, session)| (*id, session.description.clone()))
            .collect()
    }
}

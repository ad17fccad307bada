//! `/sessions/`: lists, opens and ends sessions, and loads nets into them.

use std::time::Duration;

use takt_core::{OnLoss, SessionId};

use super::super::Response;
use super::super::element::Element;
use super::nets::summary;
use super::{Handler, Outcome};
use crate::sessions::OPEN_SESSIONS_MAX;

impl Handler<'_> {
    pub(super) fn sessions(&self) -> Response {
        let sessions = self.controller.sessions().into_iter();
        let sessions = sessions.map(|(id, description)| self.describe(id, &description));
        self.show(&Element::new("sessions").containing(sessions))
    }

    pub(super) fn open_session(&self) -> Outcome {
        if self
            .field("onloss")
            .is_some_and(|word| word != OnLoss::Keep.word())
        {
            let text = "onloss: a session that is opened here has no connection to lose";
            return Err(Response::bad_request(text));
        }
        let description = self.description()?;
        let open = || self.controller.open_session(&description);
        let (sessions, by) = (&self.site.sessions, self.request.credential);
        let now = self.site.now();
        let free_session = || sessions.end_orphaned(self.controller, now, Duration::ZERO, 1) > 0;
        if sessions.is_full_for(by) && !free_session() {
            return Err(Response::conflict(format!(
                "too many sessions: clients without token have at most {OPEN_SESSIONS_MAX} together"
            )));
        }
        let session = match open() {
            Err(takt_core::Error::TooMany { .. }) if free_session() => open(),
            opened => opened,
        };
        let session = session.map_err(Response::conflict)?;
        // It has no connection, so it ends when it stays empty.
        sessions.add(session, by);
        sessions.orphan(session, now);
        Ok(Response::redirect(
            "302 Found",
            &format!("/sessions/{session}/"),
        ))
    }

    pub(super) fn session(&self, name: &str) -> Outcome {
        let (id, description) = self.find_session(name)?;
        let nets = self
            .controller
            .session_nets(id)
            .unwrap_or_default()
            .into_iter();
        let nets = nets
            .filter_map(|n| self.controller.net(n))
            .map(|info| summary(&info));
        Ok(self.show(&self.describe(id, &description).containing(nets)))
    }

    pub(super) fn control_session(&self, name: &str) -> Outcome {
        let (id, _) = self.find_session(name)?;
        match self.field("action") {
            Some("LOADNET" | "LOADNETPARAM") => {
                // Loading counts as use of the session.
                self.site.sessions.touch(id, self.site.now());
                self.load(id)
            }
            Some("TERMINATE") => {
                self.controller
                    .end_session(id)
                    .map_err(Response::conflict)?;
                Ok(Response::redirect("303 See Other", "/sessions/"))
            }
            Some("UPDATE") => {
                let description = self.description()?;
                let updated = self.controller.describe_session(id, &description);
                updated.map_err(Response::conflict)?;
                Ok(Response::redirect(
                    "303 See Other",
                    &format!("/sessions/{id}/"),
                ))
            }
            _ => Err(Response::bad_request(
                "action: LOADNET, UPDATE or TERMINATE is expected",
            )),
        }
    }

    fn describe(&self, id: SessionId, description: &str) -> Element {
        let on_loss = self.controller.session_on_loss(id).unwrap_or_default();
        session(id, description).with("onloss", on_loss.word())
    }

    fn find_session(&self, name: &str) -> Result<(SessionId, String), Response> {
        let id: Option<SessionId> = name.parse().ok();
        let mut open = self.controller.sessions().into_iter();
        let found = open.find(|(session, _)| Some(*session) == id);
        found.ok_or_else(|| Response::not_found("there is no such session"))
    }
}

fn session(id: SessionId, description: &str) -> Element {
    Element::new("session")
        .with("uri", format!("/sessions/{id}/"))
        .with("id", id)
        .with("desc", description)
}

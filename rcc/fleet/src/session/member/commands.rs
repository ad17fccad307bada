//! The thread that executes commands. What may be executed is decided by [`Admission`], not here.

use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use zenoh::query::Query as Sent;

use super::{Shared, refuse, reply};
use crate::command::{Admission, Answer, Limits, Query, Reply, random, to_json};

/// Longest wait for a query, after which losses of sessions are looked for.
const WAIT_MAX: Duration = Duration::from_millis(20);

/// Takes commands until the member leaves; then all sessions are lost.
pub(super) fn serve(shared: &Shared, queue: &Receiver<Sent>, limits: Limits) {
    let keys = (shared.keys.cmd_session(), shared.keys.cmd_directio());
    let mut admission = Admission::new(keys, shared.boot, limits, random());
    while !shared.ends() {
        match queue.recv_timeout(WAIT_MAX) {
            Ok(query) => handle(shared, &mut admission, &query),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        while let Some(lost) = admission.poll(shared.cell.now()) {
            tracing::warn!(
                "session {} of the fleet is lost: no keep-alive arrived in time",
                lost.session
            );
            shared.cell.lost(lost);
        }
    }
    while let Some(lost) = admission.poll(takt_core::Nanos(i64::MAX)) {
        shared.cell.lost(lost);
    }
}

fn handle(shared: &Shared, admission: &mut Admission, sent: &Sent) {
    let now = shared.cell.now();
    let payload = sent.payload().map(|payload| payload.to_bytes());
    let query = Query {
        key: sent.key_expr().as_str(),
        parameters: sent.parameters().as_str(),
        payload: payload.as_deref().unwrap_or_default(),
    };
    // The key of the queryable that got it is not known here: what is not exactly the one is checked as the other.
    let is_session = query.key == shared.keys.cmd_session();
    let own = if is_session {
        shared.keys.cmd_session()
    } else {
        shared.keys.cmd_directio()
    };
    let answer = if is_session {
        admission.handle_session(&query, now)
    } else {
        admission.handle_query(&query, now)
    };
    match act(shared, admission, answer) {
        // A reply may only be to a key that the query includes.
        Some(said) if query.key == own => reply(sent, &own, to_json(&said)),
        Some(said) => refuse(sent, &to_json(&said)),
        None => refuse(sent, "the session ended while the command ran"),
    }
}

fn act(shared: &Shared, admission: &mut Admission, answer: Answer) -> Option<Reply> {
    match answer {
        Answer::Reply(said) => Some(said),
        Answer::Opened {
            session,
            client,
            reply,
            ..
        } => {
            shared.cell.opened(session, &client);
            Some(reply)
        }
        Answer::Closed { session, reply } => {
            shared.cell.closed(session);
            Some(reply)
        }
        Answer::Execute {
            session,
            seq,
            line,
            until,
        } => {
            let lines = if shared.cell.now() > until {
                vec!["error: too late, the command was not begun".to_owned()]
            } else {
                shared.cell.execute(session, &line)
            };
            admission.finish(session, seq, lines)
        }
    }
}

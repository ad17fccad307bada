//! What becomes of the sessions of a client that is gone. Whether this is done at all is for the
//! server's configuration to say.

use std::time::Duration;

use takt_core::controller::NetState;
use takt_core::{Controller, SessionId};

/// How long cancelled nets may take to end before they are aborted.
pub(super) const CANCEL_WITHIN: Duration = Duration::from_secs(2);

/// How often it is looked whether they have ended.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Cancels the nets of the sessions, gives them time to end, and ends the sessions.
pub(super) async fn end_sessions(
    controller: &Controller,
    sessions: Vec<SessionId>,
    within: Duration,
) {
    let cancelling = with(controller, sessions.clone(), cancel_nets).await;
    if cancelling {
        let ended = tokio::time::timeout(within, async {
            while with(controller, sessions.clone(), any_runs).await {
                tokio::time::sleep(LOOK_EVERY).await;
            }
        });
        if ended.await.is_err() {
            tracing::warn!("nets of a lost client did not end within {within:?}: aborted");
        }
    }
    with(controller, sessions, end).await;
}

/// Asks the controller in a thread that may block.
async fn with(
    controller: &Controller,
    sessions: Vec<SessionId>,
    ask: fn(&Controller, &[SessionId]) -> bool,
) -> bool {
    let controller = controller.clone();
    tokio::task::spawn_blocking(move || ask(&controller, &sessions))
        .await
        .unwrap_or(false)
}

fn cancel_nets(controller: &Controller, sessions: &[SessionId]) -> bool {
    for net in sessions
        .iter()
        .flat_map(|s| controller.session_nets(*s).unwrap_or_default())
    {
        if let Err(error) = controller.cancel(net) {
            tracing::warn!(%net, %error, "cannot cancel a net of a lost client");
        }
    }
    any_runs(controller, sessions)
}

fn any_runs(controller: &Controller, sessions: &[SessionId]) -> bool {
    let runs = |s| matches!(s, NetState::Running | NetState::Cancelling);
    let mut nets = sessions
        .iter()
        .flat_map(|s| controller.session_nets(*s).unwrap_or_default());
    nets.any(|net| controller.net(net).is_some_and(|info| runs(info.state())))
}

fn end(controller: &Controller, sessions: &[SessionId]) -> bool {
    for session in sessions {
        match controller.end_session(*session) {
            Ok(()) | Err(takt_core::Error::NoSuchSession(_)) => {}
            Err(error) => tracing::warn!(%session, %error, "cannot end a lost client's session"),
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_core::CellConfig;
    use takt_core::controller::LoadRequest;

    #[tokio::test]
    async fn nets_that_do_not_heed_cancel_are_aborted() {
        let mut cell = CellConfig::default();
        cell.controller.priority = None;
        let controller = Controller::start(&cell).unwrap();
        let session = controller.open_session("lost").unwrap();
        let net = "{f=Core::BooleanValue(Value='false'),outTerminate=f.outValue}";
        let load = |session| {
            let (text, description) = (net.to_owned(), String::new());
            let request = LoadRequest {
                text,
                session,
                description,
                period: None,
            };
            let net = controller.load(request).unwrap();
            controller.start_net(net).unwrap();
            net
        };
        let (lost, stays) = (load(session), load(SessionId::NONE));
        end_sessions(&controller, vec![session], LOOK_EVERY).await;
        assert!(controller.net(lost).is_none());
        assert_eq!(controller.session_nets(session), None);
        assert_eq!(controller.net(stays).unwrap().state(), NetState::Running);
    }
}

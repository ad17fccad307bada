//! Ends the sessions of a lost client. Whether that is done at all is decided by the configuration, not here.

use std::time::Duration;

use takt_core::{Controller, SessionId};

/// How long cancelled nets may run before they are aborted.
pub(super) const CANCEL_TIMEOUT: Duration = Duration::from_secs(2);

/// Interval in which the nets are polled.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Cancels the nets of the sessions, waits at most `within` for them to end, then ends the sessions.
pub(super) async fn end_sessions(
    controller: &Controller,
    sessions: Vec<SessionId>,
    within: Duration,
) {
    let within = within.max(controller.machines_end_within());
    let ended = tokio::time::timeout(within, async {
        while !with(controller, sessions.clone(), wind_down).await {
            tokio::time::sleep(POLL_INTERVAL).await;
        }
    });
    if ended.await.is_err() {
        tracing::warn!("nets of a lost client did not end within {within:?}; they are aborted");
    }
    with(controller, sessions, end).await;
}

/// Calls the controller in a thread that may block.
async fn with(
    controller: &Controller,
    sessions: Vec<SessionId>,
    call: fn(&Controller, &[SessionId]) -> bool,
) -> bool {
    let controller = controller.clone();
    tokio::task::spawn_blocking(move || call(&controller, &sessions))
        .await
        .unwrap_or(false)
}

/// Cancels all their nets that run; called repeatedly, since pending rules and starts may start further ones.
fn wind_down(controller: &Controller, sessions: &[SessionId]) -> bool {
    let nets = sessions
        .iter()
        .flat_map(|s| controller.session_nets(*s).unwrap_or_default());
    controller.wind_down(&nets.collect::<Vec<_>>())
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
    use takt_core::NetId;
    use takt_core::controller::{LoadRequest, NetState, RuleRequest, RuleState};

    /// A net that ignores cancelling.
    const DEAF: &str = "{f=Core::BooleanValue(Value='false'),outTerminate=f.outValue}";
    const PATIENT: &str = "{cancel=Cancel(), outTerminate=cancel.outCancel}";

    fn controller() -> Controller {
        let mut cell = CellConfig::default();
        cell.controller.priority = None;
        Controller::start(&cell).unwrap()
    }

    fn load(controller: &Controller, session: SessionId, net: &str) -> NetId {
        let (text, description) = (net.to_owned(), String::new());
        let request = LoadRequest {
            text,
            session,
            description,
            period: None,
        };
        controller.load(request).unwrap()
    }

    #[tokio::test]
    async fn lost_client_net_ignoring_cancel_is_aborted() {
        let controller = controller();
        let session = controller.open_session("lost").unwrap();
        let [lost, stays] = [session, SessionId::NONE].map(|s| load(&controller, s, DEAF));
        for net in [lost, stays] {
            controller.start_net(net).unwrap();
        }
        end_sessions(&controller, vec![session], POLL_INTERVAL).await;
        assert!(controller.net(lost).is_none());
        assert_eq!(controller.session_nets(session), None);
        assert_eq!(controller.net(stays).unwrap().state(), NetState::Running);
    }

    #[tokio::test]
    async fn lost_client_net_end_starts_no_own_net() {
        let controller = controller();
        let session = controller.open_session("lost").unwrap();
        let [first, second] = [PATIENT; 2].map(|net| load(&controller, session, net));
        let watch = load(&controller, SessionId::NONE, PATIENT);
        let rule = |start| RuleRequest {
            condition: format!("{first}.terminated"),
            start: vec![start],
            ..RuleRequest::default()
        };
        let rules = [second, watch].map(|net| controller.schedule(rule(net)).unwrap());
        controller.start_net(first).unwrap();
        // Longer than this test may take, so that nothing is aborted.
        end_sessions(&controller, vec![session], Duration::from_secs(300)).await;
        let retained = controller.retained(second).unwrap();
        assert!(!retained.states.contains(&NetState::Running));
        assert_eq!(
            controller.retained(first).unwrap().states.last(),
            Some(&NetState::Terminated)
        );
        while controller.rule(rules[1]).unwrap().state == RuleState::Active {
            tokio::task::yield_now().await;
        }
        // Nets of other clients are not ended.
        assert_ne!(controller.net(watch).unwrap().state(), NetState::Terminated);
        let states = rules.map(|rule| controller.rule(rule).unwrap().state);
        assert_ne!(states[0], RuleState::Fired);
        assert_eq!(states[1], RuleState::Fired);
    }
}

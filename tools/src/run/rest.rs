//! Shutdown to standstill: nets are cancelled, robots come to rest, and nets that do not end in time are aborted.
//! Drivers brake by themselves when their set-points stop.

use std::time::{Duration, Instant};

use takt_core::{Controller, NetId};

use super::state_file::is_running;
use crate::output::complain;

/// How long nets get to end and robots to rest after a cancel, before nets are aborted.
const CANCEL_WITHIN: Duration = Duration::from_secs(5);
/// How long robots get to rest after their nets were aborted.
const REST_WITHIN: Duration = Duration::from_secs(2);
/// How often nets and robots are polled.
const POLL_EVERY: Duration = Duration::from_millis(10);

/// Ends all nets and waits until no robot moves. Nothing begins any more. `meanwhile` is called while it waits.
pub(super) fn come_to_rest(controller: &Controller, mut meanwhile: impl FnMut()) {
    controller.close();
    let mut wait = |within: Duration| {
        let until = Instant::now() + within;
        // A net whose start or rule was pending may begin to run now, so all nets are polled each time.
        while !(controller.wind_down(&controller.nets()) && controller.is_at_rest()) {
            if Instant::now() >= until {
                return false;
            }
            meanwhile();
            std::thread::sleep(POLL_EVERY);
        }
        true
    };
    let within = CANCEL_WITHIN.max(controller.machines_end_within() + POLL_EVERY);
    if wait(within) {
        return;
    }
    for net in running(controller) {
        complain(&format!(
            "{net} did not end within {within:?}; it is aborted"
        ));
        if let Err(error) = controller.abort(net) {
            complain(&format!("cannot abort {net}: {error}"));
        }
    }
    if !wait(REST_WITHIN) {
        complain(&format!(
            "not all robots came to rest within {REST_WITHIN:?}"
        ));
    }
}

fn running(controller: &Controller) -> Vec<NetId> {
    let nets = controller.nets().into_iter();
    let nets = nets.filter_map(|id| controller.net(id)).filter(is_running);
    nets.map(|net| net.id).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use takt_core::controller::{LoadRequest, NetState, RuleRequest};
    use takt_core::{CellConfig, SessionId};

    use super::*;

    const PATIENT: &str = "{cancel=Cancel(), outTerminate=cancel.outCancel}";

    fn controller() -> Controller {
        let mut cell = CellConfig::default();
        cell.controller.priority = None;
        Controller::start(&cell).unwrap()
    }

    fn load(controller: &Controller, text: &str) -> NetId {
        let request = LoadRequest {
            text: text.to_owned(),
            session: SessionId::NONE,
            description: String::new(),
            period: None,
        };
        controller.load(request).unwrap()
    }

    #[test]
    fn shutdown_end_of_net_starts_no_other() {
        let controller = controller();
        let [first, second, third] = [PATIENT; 3].map(|net| load(&controller, net));
        let rule = RuleRequest {
            condition: format!("{first}.terminated"),
            start: vec![second],
            ..RuleRequest::default()
        };
        controller.schedule(rule).unwrap();
        controller.start_net(first).unwrap();
        let mut errors = Vec::new();
        come_to_rest(&controller, || {
            errors.extend(controller.start_net(third).err());
        });
        let net = |id| controller.net(id).unwrap();
        assert_eq!(net(first).end, None, "it ended by itself");
        for never in [second, third] {
            assert!(!net(never).states.contains(&NetState::Running));
        }
        let stopping = |error: &takt_core::Error| error.to_string() == "the controller is stopping";
        assert!(errors.iter().all(stopping), "{errors:?}");
    }

    #[test]
    fn shutdown_waits_for_bases() {
        let controller = controller();
        // A second from full speed to rest.
        let parameters = [("max_vel", "0.5"), ("max_acc", "0.5")];
        let parameters = parameters.map(|(key, value)| (key.to_owned(), value.to_owned()));
        let (kind, parameters) = ("kuka_youbot_base_sim", BTreeMap::from(parameters));
        controller.add_device("base", kind, &parameters).unwrap();
        let net = load(
            &controller,
            "{v=World::TwistValue(Value='{vel:{x:0.5}}'),
              base=RobotBase::BaseVelocity(Robot='base',inVel=v.outValue),
              cancel=Cancel(), outTerminate=cancel.outCancel}",
        );
        controller.start_net(net).unwrap();
        while controller.is_at_rest() {
            std::thread::sleep(POLL_EVERY);
        }
        let mut polls = 0;
        come_to_rest(&controller, || polls += 1);
        assert!(polls > 0 && controller.is_at_rest());
    }
}

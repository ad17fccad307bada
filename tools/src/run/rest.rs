//! The way to a standstill: nets are asked to end, robots come to rest, and only what does neither in
//! time is aborted. A driver whose set-points stop brakes by itself; that is not done here.

use std::time::{Duration, Instant};

use takt_core::{Controller, NetId};

use super::state_file::is_running;
use crate::output::complain;

/// How long nets get to end and robots to rest after a cancel, before nets are aborted.
const CANCEL_WITHIN: Duration = Duration::from_secs(5);
/// How long robots get to rest after their nets were aborted.
const REST_WITHIN: Duration = Duration::from_secs(2);
/// How often is looked.
const LOOK: Duration = Duration::from_millis(10);

/// Ends all nets and waits until no robot moves. Nothing begins any more. `meanwhile` is called while it waits.
pub(super) fn come_to_rest(controller: &Controller, mut meanwhile: impl FnMut()) {
    controller.close();
    let mut wait = |within: Duration| {
        let until = Instant::now() + within;
        // A net whose start or rule was under way may run only now, so all are looked at each time.
        while !(controller.wind_down(&controller.nets()) && controller.is_at_rest()) {
            if Instant::now() >= until {
                return false;
            }
            meanwhile();
            std::thread::sleep(LOOK);
        }
        true
    };
    if wait(CANCEL_WITHIN) {
        return;
    }
    for net in running(controller) {
        complain(&format!(
            "{net} did not end within {CANCEL_WITHIN:?}; it is aborted"
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

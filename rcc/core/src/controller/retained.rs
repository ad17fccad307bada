//! Retained results of nets that were unloaded a moment ago, so that watching clients
//! receive their last values. Such a net accepts no requests.

use std::time::{Duration, Instant};

use crate::controller::net::Net;
use crate::controller::registry::Registry;
use crate::controller::{Controller, NETS_MAX, NetId, NetState};

/// How long the result of an unloaded net is retained.
const REMEMBERED: Duration = Duration::from_secs(1);

/// Final states and values of a net that was unloaded a moment ago.
#[derive(Clone, Debug)]
pub struct RetainedNet {
    /// All its states, in order.
    pub states: Vec<NetState>,
    /// Its last out values, as key and text.
    pub values: Vec<(String, String)>,
    at: Instant,
}

impl Controller {
    /// The retained result of an unloaded net; `None` if it has expired.
    #[must_use]
    pub fn retained(&self, id: NetId) -> Option<RetainedNet> {
        self.inner.lock().retained.get(&id).cloned()
    }
}

impl Registry {
    /// Retains the result of a net that is being unloaded.
    pub(super) fn remember(&mut self, id: NetId, net: &mut Net) {
        let retained = RetainedNet {
            states: net.info(id).states,
            values: net.out_values(),
            at: Instant::now(),
        };
        self.retained.insert(id, retained);
        while self.retained.len() > NETS_MAX {
            self.retained.pop_first();
        }
    }

    /// Unloads the oldest ended net, if there is one: known clients never unload nets.
    pub(super) fn forget_oldest(&mut self) -> Option<Net> {
        let mut nets = self.nets.iter();
        let (id, _) = nets.find(|(_, net)| net.is_over())?;
        let id = *id;
        self.withdraw(id).ok()?;
        let mut net = self.nets.remove(&id)?;
        self.remember(id, &mut net);
        Some(net)
    }

    /// Drops the results whose retention time has expired.
    pub(super) fn drop_expired(&mut self) {
        if !self.retained.is_empty() {
            self.retained.retain(|_, net| net.at.elapsed() < REMEMBERED);
        }
    }
}

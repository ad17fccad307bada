//! What is still known of a net for a moment after it was unloaded, so that whoever watches it
//! can be told its last values. Nothing can be done with such a net any more.

use std::time::{Duration, Instant};

use crate::controller::desk::Desk;
use crate::controller::net::Net;
use crate::controller::{Controller, NETS_MAX, NetId, NetState};

/// How long an unloaded net is remembered.
const REMEMBERED: Duration = Duration::from_secs(1);

/// A net that was unloaded a moment ago.
#[derive(Clone, Debug)]
pub struct Departed {
    /// All states it has been in, in order.
    pub states: Vec<NetState>,
    /// The values it gave out last, as key and text.
    pub values: Vec<(String, String)>,
    at: Instant,
}

impl Controller {
    /// What a net was before it was unloaded; `None` if that is no longer known.
    #[must_use]
    pub fn departed(&self, id: NetId) -> Option<Departed> {
        self.inner.lock().departed.get(&id).cloned()
    }
}

impl Desk {
    /// Remembers a net that is being unloaded.
    pub(super) fn remember(&mut self, id: NetId, net: &mut Net) {
        let departed = Departed {
            states: net.info(id).states,
            values: net.out_values(),
            at: Instant::now(),
        };
        self.departed.insert(id, departed);
        while self.departed.len() > NETS_MAX {
            self.departed.pop_first();
        }
    }

    /// Unloads the oldest net that is over, if there is one: known clients never do it.
    pub(super) fn forget_oldest(&mut self) -> Option<Net> {
        let mut nets = self.nets.iter();
        let (id, _) = nets.find(|(_, net)| net.is_over())?;
        let id = *id;
        self.withdraw(id).ok()?;
        let mut net = self.nets.remove(&id)?;
        self.remember(id, &mut net);
        Some(net)
    }

    /// Forgets the nets that were unloaded long ago.
    pub(super) fn forget_departed(&mut self) {
        if !self.departed.is_empty() {
            self.departed.retain(|_, net| net.at.elapsed() < REMEMBERED);
        }
    }
}

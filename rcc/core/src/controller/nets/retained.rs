//! Retained results of nets that were unloaded a moment ago, so that watching clients
//! receive their last values. Such a net accepts no requests.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::net::Net;
use crate::ids::{NetId, NetState};

/// How long the result of an unloaded net is retained.
const RETENTION: Duration = Duration::from_secs(1);

/// Final states and values of a net that was unloaded a moment ago.
#[derive(Clone, Debug)]
pub struct RetainedNet {
    /// All its states, in order.
    pub states: Vec<NetState>,
    /// Its last out values, as key and text.
    pub values: Vec<(String, String)>,
    at: Instant,
}

/// The retained results.
#[derive(Debug, Default)]
pub(super) struct Retained(BTreeMap<NetId, RetainedNet>);

impl Retained {
    /// Retains the result of a net that is being unloaded; beyond `bound` results the oldest are dropped.
    pub(super) fn insert(&mut self, id: NetId, net: &mut Net, bound: usize) {
        let retained = RetainedNet {
            states: net.info(id).states,
            values: net.out_values(),
            at: Instant::now(),
        };
        self.0.insert(id, retained);
        while self.0.len() > bound {
            self.0.pop_first();
        }
    }

    pub(super) fn get(&self, id: NetId) -> Option<RetainedNet> {
        self.0.get(&id).cloned()
    }

    /// Drops the results whose retention time has expired.
    pub(super) fn drop_expired(&mut self) {
        if !self.0.is_empty() {
            self.0.retain(|_, net| net.at.elapsed() < RETENTION);
        }
    }
}

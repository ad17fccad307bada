//! Texts of nets that were unloaded within the time of a flight file.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::net::Net;
use crate::executor::flight::{AFTER, BEFORE};
use crate::ids::NetId;
use crate::record::flight::FlightNet;

/// Maximum number of nets.
const NETS_MAX: usize = 256;
/// Maximum bytes of their texts together.
const BYTES_MAX: usize = 16 << 20;
/// How long they are kept.
const KEPT_FOR: Duration = Duration::from_secs(BEFORE.as_secs() + AFTER.as_secs() + 1);

/// Those nets; none while there is no flight recorder.
#[derive(Debug, Default)]
pub(super) struct Past {
    is_kept: bool,
    nets: VecDeque<(Instant, FlightNet)>,
    bytes: usize,
}

impl Past {
    pub(super) const fn keep(&mut self) {
        self.is_kept = true;
    }

    /// Keeps a net that is being unloaded, if it ran.
    pub(super) fn insert(&mut self, id: NetId, net: &Net) {
        if let Some(net) = net.flight(id).filter(|_| self.is_kept) {
            self.bytes += net.text.len();
            self.nets.push_back((Instant::now(), net));
        }
        while self.nets.len() > NETS_MAX || self.bytes > BYTES_MAX {
            self.drop_first();
        }
    }

    fn drop_first(&mut self) {
        if let Some((_, net)) = self.nets.pop_front() {
            self.bytes -= net.text.len();
        }
    }

    pub(super) fn drop_expired(&mut self) {
        let expired = |(at, _): &(Instant, FlightNet)| at.elapsed() > KEPT_FOR;
        while self.nets.front().is_some_and(expired) {
            self.drop_first();
        }
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &FlightNet> {
        self.nets.iter().map(|(_, net)| net)
    }
}

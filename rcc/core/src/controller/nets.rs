//! The nets of a controller, from text to end, with the numbers of the resources that they hold. It sends nothing to net
//! threads: a change of a net returns what is to be sent.

mod life;
mod links;
mod net;
mod past;
mod retained;
mod taps;

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::Duration;

use takt_net::Rejection;
use takt_net::fault::{Fault, FaultKind};

use crate::error::Error;
use crate::executor::ResourceSet;
use crate::ids::{NetId, SessionId};
use crate::record::flight::FlightNet;
use past::Past;
use retained::Retained;

pub(super) use life::{Change, HandOver};
pub(crate) use net::LiveNet;
pub(super) use net::{Counted, Net, Prepared, Values, memory};

pub use net::NetInfo;
pub use retained::RetainedNet;
pub use taps::{RECORDED_NETS_MAX, TAPS_RECORDED_FOR, TapRecord, Taps};

/// Maximum number of loaded nets.
pub const NETS_MAX: usize = 1024;

/// All nets.
#[derive(Debug, Default)]
pub(super) struct Nets {
    all: BTreeMap<NetId, Net>,
    last: Option<u32>,
    retained: Retained,
    past: Past,
    /// Numbers of resources by name.
    resources: HashMap<String, usize>,
    /// Number of nets whose taps are recorded, as last counted.
    recorded: usize,
    /// By machine, its thread and what it reserves there for its step and its components.
    machines: BTreeMap<u32, (usize, Duration)>,
}

impl Nets {
    /// Adds a net with its text, to be loaded.
    pub(super) fn add(&mut self, session: SessionId, description: String, text: Arc<str>) -> NetId {
        let next = self.last.map_or(0, |last| last.wrapping_add(1));
        self.last = Some(next);
        let net = Net::new(session, description, text);
        self.all.insert(NetId(next), net);
        NetId(next)
    }

    pub(super) fn get(&self, id: NetId) -> Option<&Net> {
        self.all.get(&id)
    }

    pub(super) fn get_mut(&mut self, id: NetId) -> Option<&mut Net> {
        self.all.get_mut(&id)
    }

    /// The net of that identifier.
    ///
    /// # Errors
    /// If there is none.
    pub(super) fn find(&mut self, id: NetId) -> Result<&mut Net, Error> {
        self.all.get_mut(&id).ok_or(Error::NoSuchNet(id))
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = (NetId, &Net)> {
        self.all.iter().map(|(id, net)| (*id, net))
    }

    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = (NetId, &mut Net)> {
        self.all.iter_mut().map(|(id, net)| (*id, net))
    }

    pub(super) fn len(&self) -> usize {
        self.all.len()
    }

    /// What machines reserve in a thread.
    pub(super) fn machine_cost(&self, thread: usize) -> Duration {
        let of_thread = self.machines.values().filter(|(of, _)| *of == thread);
        of_thread.map(|(_, cost)| *cost).sum()
    }

    /// Reserves cycle time for a machine.
    pub(super) fn reserve_for_machine(&mut self, id: u32, thread: usize, cost: Duration) {
        self.machines.insert(id, (thread, cost));
    }

    /// Frees the cycle time of a machine.
    pub(super) fn free_machine(&mut self, id: u32) {
        self.machines.remove(&id);
    }

    /// Changes the state of a net; returns what is to be handed to its thread.
    pub(super) fn change(&mut self, id: NetId, change: Change) -> Option<HandOver> {
        self.all.get_mut(&id)?.change(change)
    }

    /// Removes a net that was never ready.
    pub(super) fn remove(&mut self, id: NetId) {
        self.all.remove(&id);
    }

    /// Removes a net and retains its result.
    pub(super) fn unload(&mut self, id: NetId) -> Option<Net> {
        let mut net = self.all.remove(&id)?;
        self.retained.insert(id, &mut net, NETS_MAX);
        self.past.insert(id, &net);
        Some(net)
    }

    /// The oldest net that has ended.
    pub(super) fn oldest_over(&self) -> Option<NetId> {
        let mut nets = self.all.iter();
        nets.find(|(_, net)| net.is_over()).map(|(id, _)| *id)
    }

    /// Whether all of these have ended or are unloaded.
    pub(super) fn are_over(&self, ids: &[NetId]) -> bool {
        let mut known = ids.iter().filter_map(|id| self.all.get(id));
        known.all(Net::is_over)
    }

    /// The number of a net's thread.
    pub(super) fn thread_of(&self, net: u32) -> usize {
        self.all.get(&NetId(net)).map_or(0, Net::thread)
    }

    /// The result of a net that was unloaded a moment ago.
    pub(super) fn retained(&self, id: NetId) -> Option<RetainedNet> {
        self.retained.get(id)
    }

    /// Drops retained results that have expired.
    pub(super) fn drop_expired(&mut self) {
        self.retained.drop_expired();
        self.past.drop_expired();
    }

    /// Keeps what flight files need of nets that are unloaded.
    pub(super) const fn keep_past(&mut self) {
        self.past.keep();
    }

    /// The nets that run, or ran and may be in a flight file.
    pub(super) fn that_ran(&self) -> Vec<FlightNet> {
        let loaded = self.all.iter().filter_map(|(id, net)| net.flight(*id));
        loaded.chain(self.past.iter().cloned()).collect()
    }

    /// Bytes that all nets take or that are reserved for them.
    pub(super) fn memory_taken(&self) -> usize {
        self.all.values().map(Net::memory).sum()
    }

    /// The running net that holds the resource of that name.
    pub(super) fn holder(&self, resource: &str) -> Option<NetId> {
        let number = *self.resources.get(resource)?;
        let holds = |net: &Net| {
            let counted = net.counted().filter(|_| net.runs());
            counted.is_some_and(|counted| counted.resources.contains(number))
        };
        let mut nets = self.iter();
        nets.find(|(_, net)| holds(net)).map(|(id, _)| id)
    }

    /// The number of a resource, assigned at first use.
    pub(super) fn resource(&mut self, name: &str) -> Result<usize, Rejection> {
        if let Some(number) = self.resources.get(name) {
            return Ok(*number);
        }
        let number = self.resources.len();
        if number >= ResourceSet::MAX {
            let (found, bound) = (number + 1, ResourceSet::MAX);
            let kind = FaultKind::Bound {
                item: "resources together with other nets",
                found,
                bound,
            };
            return Err(Rejection {
                faults: vec![Fault::new(kind, 0..0)],
            });
        }
        self.resources.insert(name.to_owned(), number);
        Ok(number)
    }

    /// The name of a resource.
    pub(super) fn resource_name(&self, number: usize) -> String {
        let found = self.resources.iter().find(|(_, n)| **n == number);
        found.map_or_else(|| format!("resource {number}"), |(name, _)| name.clone())
    }
}

//! Links between nets, made when one of them is loaded, and what is recorded of all their taps. The nets exchange values
//! by themselves.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use takt_net::fault::{Fault, FaultKind};
use takt_net::netcomm::Inter;
use takt_net::{Plan, Rejection};
use takt_rt::latest::LatestReader;

use super::Nets;
use super::net::Net;
use super::taps::{NetLinks, RECORDED_NETS_MAX, TapRecording, Taps};
use crate::error::Error;
use crate::executor::links::{Links, OUT_READERS, WIRES_MAX, Wire, links};
use crate::ids::NetId;

/// Out and in values of a net that other nets read or write.
type Grouped = BTreeMap<String, Vec<Inter>>;

fn grouped(values: &[Inter]) -> Grouped {
    let mut groups = Grouped::new();
    for inter in values {
        let group = groups.entry(inter.net.clone()).or_default();
        group.push(inter.clone());
    }
    groups
}

fn rejected(kind: FaultKind) -> Rejection {
    let faults = vec![Fault::new(kind, 0..0)];
    Rejection { faults }
}

fn unloaded_net(net: &str) -> Rejection {
    let why = format!("net `{net}` was unloaded meanwhile");
    let parameter = "RemoteNet".to_owned();
    rejected(FaultKind::Parameter { parameter, why })
}

fn too_many(item: &'static str, bound: usize) -> Rejection {
    let found = bound + 1;
    rejected(FaultKind::Bound { item, found, bound })
}

impl Nets {
    /// Connects a loaded net to the nets that it reads and writes.
    pub(in crate::controller) fn link(
        &mut self,
        plan: &Plan,
        out: &LatestReader<Box<[u64]>>,
    ) -> Result<(Links, NetLinks), Rejection> {
        let (mut links, end) = links(plan);
        let (asked, written) = (grouped(plan.inter_ins()), grouped(plan.inter_outs()));
        if asked.len() > WIRES_MAX {
            return Err(too_many("other nets that a net reads", WIRES_MAX));
        }
        for (name, values) in asked {
            let (given, alive) = self.giver(&name)?;
            let given = given.ok_or_else(|| too_many("nets that read one net", OUT_READERS - 1))?;
            links.ask(Wire::asked(given, alive, values));
        }
        for (name, values) in written {
            let given = out.another();
            let given =
                given.ok_or_else(|| too_many("other nets that a net writes", OUT_READERS - 1))?;
            let wire = Wire::written(given, Arc::clone(end.alive()), values);
            let taker = self.linked(&name)?;
            let connected = taker.end.connect(wire);
            connected.map_err(|_| too_many("nets that write to one net", WIRES_MAX))?;
        }
        let links_end = NetLinks::new(end, plan);
        Ok((links, links_end))
    }

    fn linked(&mut self, name: &str) -> Result<&mut NetLinks, Rejection> {
        let id: Option<NetId> = name.parse().ok();
        let net = id.and_then(|id| self.get_mut(id));
        net.and_then(|net| net.links_mut())
            .ok_or_else(|| unloaded_net(name))
    }

    #[expect(clippy::type_complexity, reason = "both go straight into a wire")]
    fn giver(
        &mut self,
        name: &str,
    ) -> Result<(Option<LatestReader<Box<[u64]>>>, Arc<AtomicBool>), Rejection> {
        let alive = Arc::clone(self.linked(name)?.end.alive());
        let id: Option<NetId> = name.parse().ok();
        let net = id.and_then(|id| self.get(id));
        let given = net.ok_or_else(|| unloaded_net(name))?.another_out_reader();
        Ok((given, alive))
    }

    /// Copies the last out values of other nets to a net that is evaluated once.
    pub(in crate::controller) fn copy_inter_values(&mut self, plan: &Plan) {
        for inter in plan.inter_ins() {
            let id: Option<NetId> = inter.net.parse().ok();
            let net = id.and_then(|id| self.get_mut(id));
            if let Some(net) = net {
                net.with_out_words(|words| plan.import_inter(inter, Some(words)));
            }
        }
    }

    /// Takes the records of all nets whose taps are recorded.
    pub(in crate::controller) fn drain_taps(&mut self) {
        if self.recorded == 0 {
            return;
        }
        let now = Instant::now();
        let recordings = self.tap_recordings();
        self.recorded = recordings.map(|recording| recording.drain(now)).count();
    }

    fn tap_recordings(&mut self) -> impl Iterator<Item = &mut TapRecording> {
        let links = self.all.values_mut().filter_map(Net::links_mut);
        links.filter_map(|links| links.recording.as_mut())
    }

    /// The debug taps of a net with their records from number `from` on, which are recorded from now on; `None` if
    /// there is no such net or it is not ready.
    ///
    /// # Errors
    /// If the taps of [`RECORDED_NETS_MAX`] other nets are recorded already.
    pub(in crate::controller) fn taps(
        &mut self,
        id: NetId,
        from: u64,
    ) -> Result<Option<Taps>, Error> {
        let recordings = self.tap_recordings();
        let recorded = recordings.filter(|recording| recording.is_on()).count();
        let Some(links) = self.get_mut(id).and_then(Net::links_mut) else {
            return Ok(None);
        };
        if recorded >= RECORDED_NETS_MAX && links.would_begin() {
            let (item, bound) = ("nets whose debug taps are recorded", RECORDED_NETS_MAX);
            return Err(Error::TooMany { item, bound });
        }
        let taps = links.poll(from);
        if !taps.taps.is_empty() {
            self.recorded = recorded + 1;
        }
        Ok(Some(taps))
    }
}

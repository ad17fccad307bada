//! A scope while it is made: probes that are sampled in the same cycles become a group, and each ring is read once for all its
//! columns.

use std::collections::BTreeMap;
use std::time::Duration;

use takt_net::ports::Port;

use super::{Found, Of};
use crate::controller::registry::Registry;
use crate::executor::flight::ring;
use crate::ids::NetId;
use crate::probe::{
    Column, Group, Member, ProbeError, Scope, ScopeError, ScopeRequest, Source, net_state_column,
    port_columns,
};

/// The groups of a scope.
#[derive(Default)]
pub(super) struct Plan {
    groups: Vec<Part>,
}

/// A group.
struct Part {
    thread: usize,
    net_every: u64,
    /// The shown ones first.
    probes: Vec<(String, Of)>,
    shown: usize,
}

impl Plan {
    pub(super) fn add(&mut self, name: String, found: Found, is_shown: bool) {
        let Found {
            thread,
            net_every,
            of,
        } = found;
        let is_it = |part: &Part| part.thread == thread && part.net_every == net_every;
        let at = self.groups.iter().position(is_it);
        let at = at.unwrap_or_else(|| {
            self.groups.push(Part {
                thread,
                net_every,
                probes: Vec::new(),
                shown: 0,
            });
            self.groups.len() - 1
        });
        if let Some(part) = self.groups.get_mut(at) {
            part.probes.push((name, of));
            part.shown += usize::from(is_shown);
        }
    }

    pub(super) fn build(
        self,
        registry: &mut Registry,
        request: &ScopeRequest,
        trigger: Option<&str>,
        mut rejected: Vec<ProbeError>,
    ) -> Result<Scope, ScopeError> {
        let (mut members, mut shown, mut watched) = (Vec::new(), Vec::new(), None);
        for part in self.groups {
            let wanted = part.shown;
            let (member, refused) = part.build(registry, request);
            let is_watched = |error: &&ProbeError| Some(error.probe.as_str()) == trigger;
            if let Some(error) = refused.iter().find(is_watched) {
                return Err(ScopeError::Trigger(error.clone()));
            }
            // Only the trigger's can be hidden: what was refused was to be shown.
            let left = wanted.saturating_sub(refused.len());
            rejected.extend(refused);
            let is_it = |column: &Column| Some(column.name.as_str()) == trigger;
            if let Some(column) = member.columns.iter().position(is_it) {
                watched = Some((members.len(), column));
            }
            if !member.columns.is_empty() {
                members.push(member);
                shown.push(left);
            }
        }
        Scope::new(request, members, shown, watched, rejected)
    }
}

/// The sources of a group.
#[derive(Default)]
struct Sources {
    all: Vec<Source>,
    devices: BTreeMap<String, usize>,
    /// By net, the ports that are sampled, and their source or why there is none.
    nets: BTreeMap<NetId, (Vec<Port>, Result<usize, String>)>,
}

impl Sources {
    /// Sends samplers to the nets of these probes.
    fn of_nets(probes: &[(String, Of)], registry: &mut Registry, request: &ScopeRequest) -> Self {
        let mut ports: BTreeMap<NetId, Vec<Port>> = BTreeMap::new();
        for (_, of) in probes {
            match of {
                Of::NetState(id) => {
                    ports.entry(*id).or_default();
                }
                Of::Port(id, port, _) => {
                    let of_net = ports.entry(*id).or_default();
                    if of_net.iter().all(|other| other.name != port.name) {
                        of_net.push(port.clone());
                    }
                }
                Of::Thread(_) | Of::Device(..) => {}
            }
        }
        let mut sources = Self::default();
        for (id, ports) in ports {
            let added = registry.sample(id, &ports, request).map(|reader| {
                let source = Source::of_sampler(reader, format!("net {id} has ended"));
                sources.all.push(source);
                sources.all.len() - 1
            });
            sources.nets.insert(id, (ports, added));
        }
        sources
    }

    /// The source and the column of a probe.
    fn column(&mut self, of: Of) -> Result<(Option<usize>, Column), String> {
        match of {
            Of::Thread(column) => Ok((None, column)),
            Of::Device(ring, device, column) => {
                let cause = format!("device {device} was removed");
                let source = *self.devices.entry(device).or_insert_with(|| {
                    self.all.push(Source::of_ring(&ring, cause));
                    self.all.len() - 1
                });
                Ok((Some(source), column))
            }
            Of::NetState(id) => {
                let source = self.of_net(id)?.1;
                Ok((Some(source), net_state_column(&id.to_string())))
            }
            Of::Port(id, port, number) => {
                let (ports, source) = self.of_net(id)?;
                let before = ports.iter().take_while(|other| other.name != port.name);
                let at = before.map(Port::len).sum();
                let columns = port_columns("", &port, at);
                let column = columns.into_iter().nth(number);
                Ok((Some(source), column.ok_or("the port has no such number")?))
            }
        }
    }

    fn of_net(&self, id: NetId) -> Result<(&[Port], usize), String> {
        let (ports, source) = self.nets.get(&id).ok_or("the net is unloaded")?;
        Ok((ports, source.clone()?))
    }
}

impl Part {
    /// The group with its sources, and the probes that cannot be sampled.
    fn build(self, registry: &mut Registry, request: &ScopeRequest) -> (Member, Vec<ProbeError>) {
        let Self {
            thread,
            net_every,
            probes,
            ..
        } = self;
        let mut refused = Vec::new();
        let mut sources = Sources::of_nets(&probes, registry, request);
        let mut columns = Vec::new();
        for (name, of) in probes {
            match sources.column(of) {
                Ok((source, column)) => columns.push((source, Column { name, ..column })),
                Err(cause) => refused.push(ProbeError {
                    probe: name,
                    cause,
                    hint: "close another scope, or sample fewer ports".to_owned(),
                }),
            }
        }
        let of_thread = registry.threads.get(thread);
        let period = of_thread.map_or(Duration::ZERO, |it| it.period);
        let (timing, base) = of_thread.map_or_else(
            || (ring(1, 1).1, takt_rt::Nanos::ZERO),
            |it| (it.timing.clone(), it.base),
        );
        let mut group = Group::new(&timing, base, net_every, request.every);
        group.sources = sources.all;
        for (source, column) in &columns {
            group.add(*source, column);
        }
        let names = registry.thread_names();
        let member = Member {
            thread: names.into_iter().nth(thread).unwrap_or_default(),
            period: period.saturating_mul(u32::try_from(net_every).unwrap_or(u32::MAX)),
            group,
            columns: columns.into_iter().map(|(_, column)| column).collect(),
        };
        (member, refused)
    }
}

//! Probes by name: the list of all, and scopes over some of them. The rows come from the rings of net threads and devices; for ports
//! of nets a sampler is sent to the net, which goes when the scope is dropped or the net ends.

mod plan;

use std::collections::BTreeMap;
use std::time::Duration;

use takt_net::fault::similar;
use takt_net::ports::Port;

use crate::controller::Controller;
use crate::controller::nets::Net;
use crate::controller::registry::Registry;
use crate::executor::flight::FlightReader;
use crate::executor::sampler::{SAMPLED_WORDS_MAX, SAMPLERS_MAX, SampleReader, sampler};
use crate::ids::NetId;
use crate::probe::{
    Column, LISTED_MAX, Probe, ProbeError, Probes, Scope, ScopeError, ScopeRequest, TriggerKind,
    device_columns, machine_column, net_state_column, port_columns, thread_columns,
};
use plan::Plan;

/// Maximum number of words of a sampler: each sample of a scope is short.
const SAMPLE_WORDS_MAX: usize = 256;

impl Controller {
    /// The probes whose names contain this text, at most [`LISTED_MAX`]; out ports of nets, whose in ports have the same values.
    #[must_use]
    pub fn probes(&self, containing: &str) -> Probes {
        self.inner.lock().probes(containing)
    }

    /// A scope over some probes. Those that cannot be sampled are in [`Scope::rejected`].
    ///
    /// # Errors
    /// If the request is out of its bounds, or the probe of its trigger cannot be sampled.
    pub fn scope(&self, request: &ScopeRequest) -> Result<Scope, ScopeError> {
        request.check()?;
        self.inner.lock().scope(request)
    }
}

/// What a name stands for.
struct Found {
    thread: usize,
    /// Cycles of the thread in a period of the net; 1 for all others.
    net_every: u64,
    of: Of,
}

enum Of {
    /// The ring of the thread.
    Thread(Column),
    /// The ring of a device.
    Device(FlightReader, String, Column),
    /// The state of a net.
    NetState(NetId),
    /// A number of a port of a net.
    Port(NetId, Port, usize),
}

/// Whether a text is usable as a part of a name.
fn is_name(text: &str) -> bool {
    let usual = |c: char| c.is_alphanumeric() || "_-. ".contains(c);
    !text.is_empty() && text.len() <= 64 && text.chars().all(usual) && text.trim() == text
}

impl Registry {
    /// The names of nets: their description if it is one and no other net has it, else their identifier.
    fn net_names(&self) -> BTreeMap<NetId, String> {
        let mut times: BTreeMap<&str, usize> = BTreeMap::new();
        let shown = |net: &&Net| net.links().is_some() && !net.is_over();
        for (_, net) in self.nets.iter().filter(|(_, net)| shown(net)) {
            *times.entry(net.description()).or_default() += 1;
        }
        let nets = self.nets.iter().filter(|(_, net)| shown(net));
        nets.map(|(id, net)| {
            let text = net.description();
            let is_own = is_name(text) && times.get(text) == Some(&1);
            let is_other = text.parse().is_ok_and(|other: NetId| other != id);
            let name = if is_own && !is_other {
                text.to_owned()
            } else {
                id.to_string()
            };
            (id, name)
        })
        .collect()
    }

    /// The names of net threads, of probes as at the system but for what all have.
    fn thread_names(&self) -> Vec<String> {
        let name = |name: &String| name.trim_start_matches("takt-").to_owned();
        self.threads.iter().map(|it| name(&it.name)).collect()
    }

    /// Calls `add` with all columns of rings and of states.
    fn each_column(&self, mut add: impl FnMut(usize, String, Column)) {
        for (thread, name) in self.thread_names().iter().enumerate() {
            for column in thread_columns(name) {
                add(thread, format!("thread {name}"), column);
            }
        }
        for (_, device) in self.devices.table.all() {
            let thread = self.threads.serving_thread(&device.name);
            for column in device_columns(device) {
                add(thread, format!("device {}", device.name), column);
            }
        }
        for (id, thread, name, states) in self.machines.of_probes() {
            let column = machine_column(&name, id, states);
            add(thread, format!("machine {name}"), column);
        }
    }

    fn probes(&self, containing: &str) -> Probes {
        let mut found = Probes::default();
        let threads = self.thread_names();
        let period = |thread: usize| self.threads.period(thread).unwrap_or_default();
        let name_of = |thread: usize| threads.get(thread).cloned().unwrap_or_default();
        let mut add = |thread: usize, period: Duration, source: &str, column: Column| {
            if !column.name.contains(containing) {
                return;
            }
            if found.probes.len() >= LISTED_MAX {
                found.left_off += 1;
                return;
            }
            found.probes.push(Probe {
                name: column.name,
                unit: column.unit,
                thread: name_of(thread),
                period,
                source: source.to_owned(),
                states: column.states,
            });
        };
        self.each_column(|thread, source, column| add(thread, period(thread), &source, column));
        for (id, name) in self.net_names() {
            let Some((net, links)) = self.nets.get(id).and_then(|net| Some((net, net.links()?)))
            else {
                continue;
            };
            let of_net = net.counted().map_or_else(Duration::default, |it| it.period);
            let source = format!("net {id}");
            add(net.thread(), of_net, &source, net_state_column(&name));
            for port in links.ports.all().iter().filter(|port| !port.is_in) {
                for column in port_columns(&name, port, 0) {
                    add(net.thread(), of_net, &source, column);
                }
            }
        }
        found
    }

    /// What a name stands for.
    fn find_probe(&self, name: &str) -> Result<Found, ProbeError> {
        if let Some(rest) = name.strip_prefix("net:") {
            return self.find_of_net(name, rest);
        }
        let mut known = Vec::new();
        let mut found = None;
        let of_device = self.devices.table.all().map(|(_, device)| device);
        for device in of_device {
            let has_prefix = name.strip_prefix(device.name.as_str());
            let is_of_it = has_prefix.is_some_and(|rest| rest.starts_with('.'));
            if !is_of_it {
                known.push(format!("{}.status", device.name));
                continue;
            }
            let Some(ring) = device.flight.get() else {
                continue;
            };
            for column in device_columns(device) {
                if column.name == name {
                    let thread = self.threads.serving_thread(&device.name);
                    let of = Of::Device(ring.clone(), device.name.clone(), column);
                    found = Some((thread, of));
                    break;
                }
                known.push(column.name);
            }
        }
        if found.is_none() {
            for (thread, of) in self.thread_names().iter().enumerate() {
                let columns = thread_columns(of).into_iter();
                found = found.or_else(|| {
                    let mut columns = columns.inspect(|column| known.push(column.name.clone()));
                    let column = columns.find(|column| column.name == name)?;
                    Some((thread, Of::Thread(column)))
                });
            }
        }
        if found.is_none() {
            for (id, thread, of, states) in self.machines.of_probes() {
                let column = machine_column(&of, id, states);
                if column.name == name {
                    found = Some((thread, Of::Thread(column)));
                } else {
                    known.push(column.name);
                }
            }
        }
        let Some((thread, of)) = found else {
            return Err(unknown(name, "no device, thread or machine has it", &known));
        };
        Ok(Found {
            thread,
            net_every: 1,
            of,
        })
    }

    /// The names of all numbers of a port, if it is one of a net and has several.
    fn parts_of_port(&self, name: &str) -> Option<Vec<String>> {
        let (net, path) = name.strip_prefix("net:")?.split_once('/')?;
        let net = self.nets.get(net_of(&self.net_names(), net)?)?;
        let ports = net.links()?.ports.all();
        let port = ports.iter().find(|port| *port.name == *path)?;
        let parts = port.parts().map(|part| format!("{name}{}", part.suffix));
        (port.len() > 1).then(|| parts.take(SAMPLE_WORDS_MAX).collect())
    }

    fn find_of_net(&self, name: &str, rest: &str) -> Result<Found, ProbeError> {
        let (net_name, port) = match rest.split_once('/') {
            Some((net, port)) => (net, Some(port)),
            None => (rest.strip_suffix(".state").unwrap_or(rest), None),
        };
        let names = self.net_names();
        let Some(id) = net_of(&names, net_name) else {
            let known: Vec<_> = names
                .values()
                .map(|own| format!("net:{own}.state"))
                .collect();
            return Err(unknown(
                name,
                "there is no net of that name that has not ended",
                &known,
            ));
        };
        let net = self.nets.get(id);
        let links = net.and_then(|net| net.links());
        let (Some(net), Some(links)) = (net, links) else {
            return Err(unknown(name, "the net is not ready", &[]));
        };
        let thread = net.thread();
        let thread_period = self.threads.period(thread).unwrap_or_default();
        let period = net.counted().map_or(thread_period, |it| it.period);
        let net_every = period.as_nanos() / thread_period.as_nanos().max(1);
        let net_every = u64::try_from(net_every).unwrap_or(u64::MAX).max(1);
        let of = match port {
            None if rest.ends_with(".state") => Of::NetState(id),
            None => {
                let known = [format!("net:{net_name}.state")];
                return Err(unknown(name, "it names no port", &known));
            }
            Some(path) => {
                let fits = |port: &&Port| path.starts_with(&*port.name);
                let mut columns = links.ports.all().iter().filter(fits).flat_map(|port| {
                    let columns = port_columns("", port, 0).into_iter().enumerate();
                    columns.map(move |(number, column)| (port, number, column))
                });
                let is_it = |column: &Column| column.name.strip_prefix("net:/") == Some(path);
                match columns.find(|(_, _, column)| is_it(column)) {
                    Some((port, number, _)) => Of::Port(id, port.clone(), number),
                    None => return Err(unknown_port(name, net_name, path, links.ports.all())),
                }
            }
        };
        Ok(Found {
            thread,
            net_every,
            of,
        })
    }

    fn scope(&mut self, request: &ScopeRequest) -> Result<Scope, ScopeError> {
        let mut rejected = Vec::new();
        let mut wanted: Vec<(String, Found)> = Vec::new();
        let whole = request.probes.iter().flat_map(|name| {
            let parts = self.parts_of_port(name);
            parts.unwrap_or_else(|| vec![name.clone()])
        });
        let all: Vec<_> = whole.collect();
        for name in all {
            if wanted.iter().any(|(other, _)| *other == name) {
                continue;
            }
            match self.find_probe(&name) {
                Ok(found) => wanted.push((name, found)),
                Err(error) => rejected.push(error),
            }
        }
        let shown = wanted.len();
        let trigger = match &request.trigger {
            None => None,
            Some(trigger) => {
                let name = self.trigger_probe(trigger.on, trigger.probe.as_deref());
                let at = wanted.iter().position(|(other, _)| *other == name);
                if at.is_none() {
                    let found = self.find_probe(&name).map_err(ScopeError::Trigger)?;
                    wanted.push((name.clone(), found));
                }
                Some(name)
            }
        };
        let mut plan = Plan::default();
        for (number, (name, found)) in wanted.into_iter().enumerate() {
            plan.add(name, found, number < shown);
        }
        plan.build(self, request, trigger.as_deref(), rejected)
    }

    /// The probe that a trigger watches.
    fn trigger_probe(&self, on: TriggerKind, probe: Option<&str>) -> String {
        let first = self.thread_names().into_iter().next().unwrap_or_default();
        let name = probe.unwrap_or_default();
        let has = |suffix: &str| name.ends_with(suffix);
        match on {
            TriggerKind::Fault if !has(".faults") => {
                format!("{}.faults", name.strip_suffix(".status").unwrap_or(name))
            }
            TriggerKind::Overrun if name.is_empty() => format!("thread:{first}.missed"),
            TriggerKind::Overrun if !has(".missed") => format!("{name}.missed"),
            TriggerKind::State | TriggerKind::Event
                if (name.starts_with("net:") || name.starts_with("machine:")) && !has(".state") =>
            {
                format!("{name}.state")
            }
            TriggerKind::Event if !has(".events") && !has(".state") => format!("{name}.events"),
            TriggerKind::Above
            | TriggerKind::Below
            | TriggerKind::Rising
            | TriggerKind::Falling
            | TriggerKind::Inside
            | TriggerKind::Outside
            | TriggerKind::State
            | TriggerKind::Fault
            | TriggerKind::Event
            | TriggerKind::Overrun => name.to_owned(),
        }
    }

    /// Sends a sampler of some ports to a net.
    fn sample(
        &mut self,
        id: NetId,
        ports: &[Port],
        request: &ScopeRequest,
    ) -> Result<SampleReader, String> {
        let thread = self.nets.get(id).map_or(0, Net::thread);
        let mut of_thread = 0;
        for (_, net) in self.nets.iter_mut() {
            if net.thread() == thread && !net.is_over() {
                net.exchange_samplers();
                of_thread += net.links_mut().map_or(0, |it| it.end.samplers.taken().0);
            }
        }
        let net = self.nets.get_mut(id).ok_or("the net is unloaded")?;
        let period = net.counted().map_or(Duration::ZERO, |it| it.period);
        let links = net.links_mut().ok_or("the net is not ready")?;
        let sampled = links.ports.sampled(ports);
        let words = sampled.words();
        if words > SAMPLE_WORDS_MAX {
            return Err(format!(
                "the ports that are sampled of its net have {words} numbers together, and may have {SAMPLE_WORDS_MAX}"
            ));
        }
        if of_thread + words > SAMPLED_WORDS_MAX {
            return Err(format!(
                "all scopes together sample {of_thread} numbers of the nets of its thread, and may sample {SAMPLED_WORDS_MAX}"
            ));
        }
        let (sampler, reader) = sampler(sampled, request.every, period);
        let sent = links.end.samplers.send(sampler);
        sent.map_err(|_| format!("{SAMPLERS_MAX} scopes sample its net, which is the maximum"))?;
        Ok(reader)
    }
}

fn unknown(name: &str, cause: &str, known: &[String]) -> ProbeError {
    let near = similar(name, known.iter().map(String::as_str));
    let near = near.map_or_else(String::new, |near| format!("did you mean `{near}`? "));
    ProbeError {
        probe: name.chars().take(crate::probe::NAME_CHARS_MAX).collect(),
        cause: cause.to_owned(),
        hint: format!("{near}`/probes/` lists all names"),
    }
}

/// The error of a port that a net does not have.
fn unknown_port(name: &str, net: &str, path: &str, ports: &[Port]) -> ProbeError {
    let names = ports.iter().map(|port| &*port.name);
    if let Some(port) = ports.iter().find(|port| *port.name == *path) {
        let parts: Vec<_> = port.parts().take(8).map(|it| it.suffix).collect();
        return ProbeError {
            probe: name.to_owned(),
            cause: format!("the port has {} numbers", port.len()),
            hint: format!("append one of {}", parts.join(" ")),
        };
    }
    let stem = path.split(['[']).next().unwrap_or(path);
    let near = similar(stem, names).map(|near| format!("net:{net}/{near}"));
    let near = near.map_or_else(String::new, |near| format!("did you mean `{near}`? "));
    ProbeError {
        probe: name.to_owned(),
        cause: "the net has no such port".to_owned(),
        hint: format!("{near}`/probes/` lists all names"),
    }
}

/// The net of this identifier or, if there is none, of this name.
fn net_of(names: &BTreeMap<NetId, String>, name: &str) -> Option<NetId> {
    let by_id = name.parse().ok().filter(|id| names.contains_key(id));
    by_id.or_else(|| names.iter().find(|(_, own)| *own == name).map(|it| *it.0))
}

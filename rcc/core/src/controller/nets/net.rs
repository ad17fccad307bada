//! A net in the registry: its life, the cost that it declares, and the program's endpoints of its values. Which nets
//! exist and which may start is decided elsewhere.

use std::sync::Arc;
use std::time::Duration;

use takt_net::netcomm::{Directory, Entry, NetBoxes, OutStatus};
use takt_net::set_points::SetPoints;
use takt_net::value::Element;
use takt_net::{Plan, Rejection};
use takt_rt::latest::{LatestReader, LatestWriter};

use super::life::{Change, HandOver, Holder, Life};
use super::taps::NetLinks;
use crate::error::Error;
use crate::executor::figures::NetCounters;
use crate::executor::links::OUT_READERS;
use crate::executor::{ResourceSet, Running};
use crate::ids::{NetId, NetState, SessionId};
use crate::record::flight::FlightNet;

/// A net as programs see it.
#[derive(Clone, Debug)]
pub struct NetInfo {
    /// Its identifier.
    pub id: NetId,
    /// Description for users.
    pub description: String,
    /// Session that it belongs to.
    pub session: SessionId,
    /// Its text.
    pub text: Arc<str>,
    /// All its states in order; the last is the present one.
    pub states: Vec<NetState>,
    /// Faults for which it was rejected.
    pub rejection: Option<Arc<Rejection>>,
    /// Reason of its end, unless it terminated by itself.
    pub end: Option<String>,
}

/// A net as a stream of live messages sees it.
#[derive(Debug)]
pub(crate) struct LiveNet {
    pub(crate) id: NetId,
    pub(crate) states: Vec<NetState>,
    /// Its out values, once it is ready.
    pub(crate) values: Option<Arc<Directory>>,
}

impl NetInfo {
    /// Its present state.
    #[must_use]
    pub fn state(&self) -> NetState {
        self.states.last().copied().unwrap_or(NetState::Loading)
    }
}

/// The program's endpoints of a net's values.
#[derive(Debug)]
pub(in crate::controller) struct Values {
    pub(in crate::controller) links: NetLinks,
    pub(in crate::controller) out_directory: Arc<Directory>,
    pub(in crate::controller) out_reader: LatestReader<Box<[u64]>>,
    pub(in crate::controller) in_directory: Arc<Directory>,
    pub(in crate::controller) in_writer: LatestWriter<Box<[u64]>>,
    pub(in crate::controller) in_words: Box<[u64]>,
}

/// A net that is ready, with the program's endpoints of its values.
#[derive(Debug)]
pub(in crate::controller) struct Prepared {
    /// The number of its thread.
    pub(in crate::controller) thread: usize,
    pub(in crate::controller) running: Box<Running>,
    pub(in crate::controller) values: Values,
}

/// Data on a net's evaluation.
#[derive(Debug)]
pub(in crate::controller) struct Counted {
    pub(in crate::controller) counters: Arc<NetCounters>,
    pub(in crate::controller) period: Duration,
    pub(in crate::controller) primitives: usize,
    pub(in crate::controller) cost: Duration,
    /// Bytes that it takes while it can run.
    memory: usize,
    pub(in crate::controller) resources: ResourceSet,
    pub(in crate::controller) set_points: Vec<SetPoints>,
}

/// What is known of a net once it was ready.
#[derive(Debug)]
struct Known {
    /// The number of its thread.
    thread: usize,
    /// Devices that it reads or commands.
    devices: Vec<String>,
    counted: Counted,
    values: Values,
}

/// A net.
#[derive(Debug)]
pub(in crate::controller) struct Net {
    pub(in crate::controller) session: SessionId,
    /// The machine of which it is a component, and the number of the component.
    pub(in crate::controller) component_of: Option<(u32, usize)>,
    description: String,
    text: Arc<str>,
    states: Vec<NetState>,
    life: Life,
    /// Why its last start failed, until the caller of that start takes it.
    start_error: Option<Error>,
    /// Why the controller aborts it; `None` if it does not.
    abort_reason: Option<String>,
    known: Option<Known>,
}

/// Bytes of a net with the boxes through which programs and other nets access it.
pub(in crate::controller) fn memory(plan: &Plan) -> usize {
    let boxes = (OUT_READERS + 2) * plan.outbox().words() + 3 * plan.inbox().words();
    plan.memory() + boxes * size_of::<u64>()
}

impl Net {
    pub(in crate::controller) fn new(
        session: SessionId,
        description: String,
        text: Arc<str>,
    ) -> Self {
        Self {
            session,
            component_of: None,
            description,
            text,
            states: vec![NetState::Loading],
            life: Life::Loading { reserved: 0 },
            start_error: None,
            abort_reason: None,
            known: None,
        }
    }

    pub(in crate::controller) const fn state(&self) -> NetState {
        self.life.state()
    }

    /// Changes its state; returns what is to be handed to its thread.
    pub(in crate::controller) fn change(&mut self, change: Change) -> Option<HandOver> {
        let placeholder = Life::Terminated { why: None };
        let (life, hand_over) = std::mem::replace(&mut self.life, placeholder).after(change);
        self.life = life;
        let state = self.life.state();
        if self.states.last() != Some(&state) {
            self.states.push(state);
        }
        hand_over
    }

    pub(in crate::controller) fn make_ready(&mut self, prepared: Prepared) {
        let Prepared {
            thread,
            running,
            values,
        } = prepared;
        self.known = Some(Known {
            thread,
            devices: running.plan.uses().to_vec(),
            counted: Counted {
                counters: Arc::clone(running.counters()),
                period: running.plan.period(),
                primitives: running.plan.primitives(),
                cost: running.plan.cost().total,
                memory: memory(&running.plan),
                resources: running.resources,
                set_points: running.plan.set_points().to_vec(),
            },
            values,
        });
        self.change(Change::Load(running));
    }

    /// Checks that no machine starts it.
    ///
    /// # Errors
    /// If it is a component of a machine and waits for its start.
    pub(in crate::controller) fn check_free(&self, id: NetId) -> Result<(), Error> {
        if self.component_of.is_none() || !matches!(&self.life, Life::Waiting { .. }) {
            return Ok(());
        }
        Err(Error::WrongState {
            net: id,
            state: self.state(),
            hint: "it waits for its machine to start it; end the machine instead",
        })
    }

    /// Checks that its start can be requested.
    ///
    /// # Errors
    /// If it is not ready, or already on its way.
    pub(in crate::controller) fn check_start(&self, id: NetId) -> Result<(), Error> {
        self.check_free(id)?;
        let waits = matches!(&self.life, Life::Waiting { .. });
        if waits && !self.is_starting() {
            return Ok(());
        }
        Err(Error::WrongState {
            net: id,
            state: self.state(),
            hint: "only a net that is READY can be started; load it again",
        })
    }

    /// Requests its start; returns what is to be handed to its thread.
    pub(in crate::controller) fn start(&mut self) -> Option<HandOver> {
        // An error that was never taken belongs to an earlier start.
        self.start_error = None;
        self.change(Change::Start)
    }

    /// Its thread rejected its start.
    pub(in crate::controller) fn reject_start(&mut self, running: Box<Running>, why: Error) {
        self.change(Change::RejectStart(running));
        self.start_error = Some(why);
    }

    /// The outcome of its start, once it is known.
    pub(in crate::controller) fn started(&mut self) -> Option<Result<(), Error>> {
        match self.start_error.take() {
            Some(error) => Some(Err(error)),
            None if self.is_starting() => None,
            None => Some(Ok(())),
        }
    }

    /// Whether a start is requested and not answered.
    pub(in crate::controller) const fn is_starting(&self) -> bool {
        self.life.is_starting()
    }

    /// Whether its thread holds it for rules to start.
    pub(in crate::controller) const fn is_with_rules(&self) -> bool {
        self.life.is_with_rules()
    }

    /// Whether its thread holds it, or will, before it runs.
    pub(in crate::controller) const fn is_away(&self) -> bool {
        self.life.is_starting() || self.life.is_with_rules()
    }

    /// Whether its thread evaluates it.
    pub(in crate::controller) const fn runs(&self) -> bool {
        matches!(&self.life, Life::Running | Life::Cancelling)
    }

    /// Sets why the controller aborts it.
    pub(in crate::controller) fn abort_because(&mut self, why: String) {
        self.abort_reason = Some(why);
    }

    /// Why the controller aborts it; `None` if it does not.
    pub(in crate::controller) fn abort_reason(&self) -> Option<&str> {
        self.abort_reason.as_deref()
    }

    /// Whether it has ended for good.
    pub(in crate::controller) const fn is_over(&self) -> bool {
        matches!(&self.life, Life::Rejected(_) | Life::Terminated { .. })
    }

    /// Whether it terminated by itself.
    pub(in crate::controller) const fn ended_by_itself(&self) -> bool {
        matches!(&self.life, Life::Terminated { why: None })
    }

    /// Bytes reserved for it while it is loaded.
    pub(in crate::controller) const fn reserved(&self) -> usize {
        let Life::Loading { reserved } = &self.life else {
            return 0;
        };
        *reserved
    }

    /// Sets the bytes reserved for it while it is loaded.
    pub(in crate::controller) const fn reserve(&mut self, bytes: usize) {
        if let Life::Loading { reserved } = &mut self.life {
            *reserved = bytes;
        }
    }

    /// Bytes that it takes or that are reserved for it.
    pub(in crate::controller) fn memory(&self) -> usize {
        match &self.life {
            Life::Loading { reserved } => *reserved,
            Life::Rejected(_) | Life::Terminated { .. } => 0,
            Life::Waiting { .. } | Life::Running | Life::Cancelling => {
                self.counted().map_or(0, |counted| counted.memory)
            }
        }
    }

    /// Data on its evaluation; `None` if it was never ready.
    pub(in crate::controller) fn counted(&self) -> Option<&Counted> {
        Some(&self.known.as_ref()?.counted)
    }

    /// The number of its thread, 0 until it is known.
    pub(in crate::controller) fn thread(&self) -> usize {
        self.known.as_ref().map_or(0, |known| known.thread)
    }

    /// Its text.
    pub(in crate::controller) fn text(&self) -> &str {
        &self.text
    }

    /// Whether the net reads or commands the device of that name.
    pub(in crate::controller) fn uses(&self, device: &str) -> bool {
        let mut devices = self.known.iter().flat_map(|known| &known.devices);
        devices.any(|name| name == device)
    }

    /// What flight files need of it, if it ran.
    pub(in crate::controller) fn flight(&self, id: NetId) -> Option<FlightNet> {
        let ran = self.states.contains(&NetState::Running);
        let values = self.values().filter(|_| ran)?;
        Some(FlightNet {
            id: id.0,
            text: Arc::clone(&self.text),
            directory: Arc::clone(&values.out_directory),
        })
    }

    fn values(&self) -> Option<&Values> {
        Some(&self.known.as_ref()?.values)
    }

    fn values_mut(&mut self) -> Option<&mut Values> {
        Some(&mut self.known.as_mut()?.values)
    }

    /// Location of an out value.
    pub(in crate::controller) fn out_entry(&self, key: &str) -> Option<Entry> {
        self.values()?.out_directory.find(key).cloned()
    }

    /// Its values for exchange with other nets.
    pub(in crate::controller) fn boxes(&self) -> Option<NetBoxes> {
        let values = self.values()?;
        Some(NetBoxes {
            inbox: Arc::clone(&values.in_directory),
            outbox: Arc::clone(&values.out_directory),
        })
    }

    /// Reads its last out values.
    pub(in crate::controller) fn with_out_words<T>(
        &mut self,
        read: impl FnOnce(&[u64]) -> T,
    ) -> Option<T> {
        let values = self.values_mut()?;
        Some(values.out_reader.read_with(|words| read(words)))
    }

    /// Its links, with its ports; `None` if it was never ready.
    pub(in crate::controller) fn links(&self) -> Option<&NetLinks> {
        Some(&self.values()?.links)
    }

    /// Passes samplers to the net while it waits in the registry.
    pub(in crate::controller) fn exchange_samplers(&mut self) {
        if let Life::Waiting {
            holder: Holder::Registry(running),
            ..
        } = &mut self.life
        {
            running.links.exchange_samplers();
        }
    }

    pub(in crate::controller) fn description(&self) -> &str {
        &self.description
    }

    pub(in crate::controller) fn links_mut(&mut self) -> Option<&mut NetLinks> {
        Some(&mut self.values_mut()?.links)
    }

    /// Adds a reader of its out values; `None` if the limit is reached.
    pub(in crate::controller) fn another_out_reader(&self) -> Option<LatestReader<Box<[u64]>>> {
        self.values()?.out_reader.another()
    }

    /// A Boolean out value, if it is non-null.
    pub(in crate::controller) fn out_bool(&mut self, entry: &Entry) -> Option<bool> {
        let reader = &mut self.values_mut()?.out_reader;
        reader.read_with(|words| {
            let current = entry.status(words) == OutStatus::Current;
            let value = entry.value(words).first().copied()?;
            current.then_some(value != 0)
        })
    }

    pub(in crate::controller) fn info(&self, id: NetId) -> NetInfo {
        let (rejection, end) = match &self.life {
            Life::Rejected(rejection) => (Some(Arc::clone(rejection)), None),
            Life::Terminated { why } => (None, why.clone()),
            Life::Loading { .. } | Life::Waiting { .. } | Life::Running | Life::Cancelling => {
                (None, None)
            }
        };
        NetInfo {
            id,
            description: self.description.clone(),
            session: self.session,
            text: Arc::clone(&self.text),
            states: self.states.clone(),
            rejection,
            end,
        }
    }

    /// What a stream of live messages needs of it.
    pub(in crate::controller) fn live(&self, id: NetId) -> LiveNet {
        LiveNet {
            id,
            states: self.states.clone(),
            values: self.values().map(|it| Arc::clone(&it.out_directory)),
        }
    }

    /// The Boolean values alone, if any value changed since the version `seen`, which becomes the present one.
    pub(in crate::controller) fn new_results(
        &mut self,
        seen: &mut Option<u64>,
    ) -> Vec<(String, String)> {
        let version = self.values().map(|values| values.out_reader.version());
        if std::mem::replace(seen, version) == version {
            return Vec::new();
        }
        self.out_values_of(|entry| entry.ty.element == Element::Bool)
    }

    pub(in crate::controller) fn out_values(&mut self) -> Vec<(String, String)> {
        self.out_values_of(|_| true)
    }

    fn out_values_of(&mut self, wanted: impl Fn(&Entry) -> bool) -> Vec<(String, String)> {
        let Some(values) = self.values_mut() else {
            return Vec::new();
        };
        let directory = &values.out_directory;
        values.out_reader.read_with(|words| {
            let seen = directory
                .entries()
                .iter()
                .filter(|entry| entry.report && wanted(entry))
                .filter(|entry| entry.status(words) != OutStatus::Never);
            seen.map(|entry| {
                let mut text = String::new();
                entry.format(words, &mut text);
                (entry.key.clone(), text)
            })
            .collect()
        })
    }

    pub(in crate::controller) fn in_values(&self) -> Vec<(String, String)> {
        let Some(values) = self.values() else {
            return Vec::new();
        };
        let entries = values.in_directory.entries().iter();
        let entries = entries.filter(|entry| !entry.is_hidden());
        let text = |entry: &Entry| {
            let mut text = String::new();
            entry.format(&values.in_words, &mut text);
            (entry.key.clone(), text)
        };
        entries.map(text).collect()
    }

    pub(in crate::controller) fn write_in(
        &mut self,
        id: NetId,
        key: &str,
        text: &str,
    ) -> Result<bool, Error> {
        let Some(values) = self.values_mut() else {
            return Ok(false);
        };
        let entry = values.in_directory.find(key);
        let Some(entry) = entry.filter(|entry| !entry.is_hidden()) else {
            return Ok(false);
        };
        let written = entry.write(text, &mut values.in_words);
        written.map_err(|e| Error::Value {
            net: id,
            key: key.to_owned(),
            why: e.message,
        })?;
        let words = &values.in_words;
        values
            .in_writer
            .write_with(|slot| slot.copy_from_slice(words));
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::executor::tests::net;

    const ID: NetId = NetId(1);
    const TEXT: &str = "{never=Core::BooleanValue(),outTerminate=never.outValue}";

    #[test]
    fn start_rejected_after_timeout_can_be_repeated() {
        let mut ready = Net::new(SessionId::NONE, String::new(), "".into());
        ready.change(Change::Load(net(ID.0, TEXT)));
        assert!(ready.check_start(ID).is_ok());
        let Some(HandOver::Start(running)) = ready.start() else {
            panic!("it is ready");
        };
        assert!(ready.check_start(ID).is_err(), "it is under way");
        assert!(ready.started().is_none());
        ready.reject_start(running, Error::Closing);
        assert!(ready.check_start(ID).is_ok());
        assert!(ready.start().is_some());
        assert!(
            ready.started().is_none(),
            "the outcome is that of this start"
        );
    }
}

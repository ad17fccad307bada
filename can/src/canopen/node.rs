//! A CANopen slave device (CiA 301): object dictionary, NMT, SDO server, PDOs, EMCY and LSS. The
//! [`Application`] defines the function of the device; frames and time are arguments.
//!
//! ```text
//! handle_frame --> NMT, SYNC, RPDOs, SDO server, heartbeats of others, LSS --> Dictionary
//!                                     |                                            |
//!                                     v  Event, poll                               v
//!                                  Application ------------------------------> Dictionary
//!                                     |  errors
//! poll_transmit <-- boot-up, heartbeat, EMCY, answers, TPDOs, SDO blocks <---------+
//! ```

mod configure;
mod hooks;
mod malfunction;
mod objects;
mod quirks;
mod receive;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Address, Dictionary, DictionaryError, Key};

use super::emcy;
use super::emcy::Source;
use super::message::{LSS_MASTER, NMT, frame};
use super::nmt::{Consumer, ErrorBehaviour, Input, Reset, Slave, State};
use super::pdo::{Rpdo, Tpdo};
use super::store::{Group, Store};
use super::sync;
use super::{Emergency, NmtState, NodeId, TimeOfDay, lss, sdo};
use crate::{Frame, Id};

pub(super) use configure::add_node_id;
pub use malfunction::Malfunctions;
pub use objects::Communication;
use quirks::ActiveQuirks;
pub use quirks::NodeQuirks;

/// Length of the send queue; further frames are counted and dropped.
pub const QUEUE_MAX: usize = 64;

/// Errors of a node's dictionary.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NodeError {
    /// The objects do not form a valid dictionary.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
    /// A mandatory object is missing or has the wrong type.
    #[error("{0} is missing or has the wrong type; CiA 301 requires it")]
    Missing(Address),
    /// A PDO mapping is invalid.
    #[error("invalid mapping {index:04X}h: {why}")]
    Mapping {
        /// Index of the mapping parameters.
        index: u16,
        /// The abort code that a write would get.
        why: AbortCode,
    },
}

/// Events of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// SYNC: received values are in the dictionary; the values after this event are transmitted.
    Sync,
    /// The RPDO with that number (from 0) wrote new values into the dictionary; for a synchronous RPDO this follows
    /// [`Self::Sync`].
    Received(u16),
    /// The RPDO with that number missed its deadline (1400h:05).
    Late(u16),
    /// The RPDO with that number was received again after a missed deadline.
    InTime(u16),
    /// The NMT state changed.
    State(State),
    /// All objects, or the communication objects, were reset to their defaults.
    Reset(Reset),
    /// A monitored heartbeat, or the guarding master, was lost.
    Lost,
    /// All monitored heartbeats are present again.
    Back,
    /// TIME.
    Time(TimeOfDay),
    /// LSS requests an action of the owner.
    Lss(lss::Done),
}

/// Context of an application callback.
#[derive(Debug)]
pub struct Context<'a> {
    /// The objects.
    pub dictionary: &'a mut Dictionary,
    /// The errors of the device.
    pub errors: &'a mut emcy::Producer,
    /// The current time.
    pub now: Duration,
}

/// The function of a device. `()` does nothing: a node with objects only.
pub trait Application {
    /// Called before a read from the bus: updates the value, or rejects the read.
    ///
    /// # Errors
    /// The abort code sent to the client.
    fn before_upload(&mut self, _: &mut Dictionary, _: Address) -> Result<(), AbortCode> {
        Ok(())
    }

    /// Called before a write from the bus that passed all checks: may reject it.
    ///
    /// # Errors
    /// The abort code sent to the client; nothing is written.
    fn check_download(&mut self, _: &Dictionary, _: Address, _: &[u8]) -> Result<(), AbortCode> {
        Ok(())
    }

    /// Called after a write from the bus by SDO.
    fn after_download(&mut self, _: &mut Dictionary, _: Address) {}

    /// Handles an event.
    fn handle(&mut self, _: Event, _: &mut Context<'_>) {}

    /// Advances time.
    fn poll(&mut self, _: &mut Context<'_>) {}

    /// Time of the next poll.
    fn poll_timeout(&self) -> Option<Duration> {
        None
    }
}

impl Application for () {}

/// Keys of the objects that a node writes, looked up once.
#[derive(Clone, Copy, Debug)]
struct Keys {
    error_register: Key<u8>,
}

/// Settings from the communication objects, updated when these are written.
#[derive(Clone, Debug)]
struct Settings {
    sync: Id,
    time: Option<Id>,
    emergency: Option<Id>,
    request: Id,
    response: Id,
    behaviour: ErrorBehaviour,
}

/// Configuration of a node.
#[derive(Debug)]
pub struct NodeConfig {
    /// Node number; without one it waits for LSS.
    pub id: Option<NodeId>,
    /// Object dictionary.
    pub dictionary: Dictionary,
    /// Entries (COB-IDs) whose default is relative to the node number.
    pub relative: Vec<Address>,
    /// Maximum length of an SDO value, bytes.
    pub sdo_len_max: usize,
    /// Timeout of the SDO server.
    pub sdo_timeout: Duration,
    /// Deviations from the standard.
    pub quirks: NodeQuirks,
}

/// A CANopen slave.
#[derive(Debug)]
pub struct Node<A> {
    application: A,
    dictionary: Dictionary,
    relative: Vec<Address>,
    /// Stored parameters (1010h).
    store: Store,
    keys: Keys,
    settings: Settings,
    slave: Slave,
    lss: lss::Slave,
    server: sdo::Server,
    rpdos: Vec<(u16, Rpdo)>,
    tpdos: Vec<(u16, Tpdo)>,
    sync: sync::Consumer,
    sync_producer: Option<sync::Producer>,
    consumers: Vec<(Option<NodeId>, Consumer)>,
    errors: emcy::Producer,
    queue: VecDeque<Frame>,
    dropped: u32,
    quirks: ActiveQuirks,
    malfunctions: Malfunctions,
}

impl<A: Application> Node<A> {
    /// Powers a node on.
    ///
    /// # Errors
    /// If a mandatory object is missing, or a PDO mapping is invalid.
    pub fn new(config: NodeConfig, application: A, now: Duration) -> Result<Self, NodeError> {
        let NodeConfig { id, dictionary, .. } = config;
        let at = Address::new(0x1001, 0);
        let error_register = dictionary.key(at).map_err(|_| NodeError::Missing(at))?;
        let identity = configure::identity(&dictionary);
        let id_or_any = id.unwrap_or(NodeId::LAST);
        let (rpdos, tpdos) = configure::pdos(&dictionary)?;
        let mut node = Self {
            application,
            keys: Keys { error_register },
            settings: configure::settings(&dictionary, id_or_any),
            dictionary,
            relative: config.relative,
            store: Store::default(),
            slave: Slave::new(id_or_any),
            lss: lss::Slave::new(identity, id),
            server: sdo::Server::new(config.sdo_len_max, config.sdo_timeout),
            rpdos,
            tpdos,
            sync: sync::Consumer::default(),
            sync_producer: None,
            consumers: Vec::with_capacity(128),
            errors: emcy::Producer::default(),
            queue: VecDeque::with_capacity(QUEUE_MAX),
            dropped: 0,
            quirks: ActiveQuirks::new(config.quirks, id_or_any),
            malfunctions: Malfunctions::default(),
        };
        node.begin(Reset::Node, now);
        Ok(node)
    }

    /// Node number; `None` while it waits for LSS.
    pub fn id(&self) -> Option<NodeId> {
        (self.slave.state() != State::Initialising).then(|| self.slave.id())
    }

    /// NMT state.
    pub const fn state(&self) -> State {
        self.slave.state()
    }

    /// Object dictionary.
    pub const fn dictionary(&self) -> &Dictionary {
        &self.dictionary
    }

    /// Mutable object dictionary for the owner; no access checks apply.
    pub const fn dictionary_mut(&mut self) -> &mut Dictionary {
        &mut self.dictionary
    }

    /// The application.
    pub const fn application(&self) -> &A {
        &self.application
    }

    /// The application, mutable.
    pub const fn application_mut(&mut self) -> &mut A {
        &mut self.application
    }

    /// The errors of the device, mutable.
    pub const fn errors_mut(&mut self) -> &mut emcy::Producer {
        &mut self.errors
    }

    /// Frames dropped because the send queue was full.
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }

    /// Triggers the TPDO with that number (from 0).
    pub fn trigger(&mut self, number: u16) {
        let mine = self.tpdos.iter_mut().filter(|(n, _)| *n == number);
        mine.for_each(|(_, tpdo)| tpdo.trigger());
    }

    fn push(&mut self, frame: Frame) {
        if self.queue.len() < QUEUE_MAX {
            self.queue.push_back(frame);
        } else {
            self.dropped = self.dropped.saturating_add(1);
        }
    }

    fn notify(&mut self, event: Event, now: Duration) {
        let mut context = Context {
            dictionary: &mut self.dictionary,
            errors: &mut self.errors,
            now,
        };
        self.application.handle(event, &mut context);
    }

    fn run_application(&mut self, now: Duration) {
        let mut context = Context {
            dictionary: &mut self.dictionary,
            errors: &mut self.errors,
            now,
        };
        self.application.poll(&mut context);
    }

    /// Resets the node: objects get their defaults or stored values, the node its number.
    fn begin(&mut self, reset: Reset, now: Duration) {
        match reset {
            Reset::Node => self.dictionary.restore_defaults(),
            Reset::Communication => self.dictionary.restore_defaults_of(0x1000..=0x1FFF),
        }
        self.queue.clear();
        self.server.reset();
        self.errors.reset();
        self.lss.activate();
        self.slave = Slave::new(self.lss.pending().unwrap_or(NodeId::LAST));
        add_node_id(&mut self.dictionary, &self.relative, self.slave.id());
        let group = match reset {
            Reset::Node => Group::All,
            Reset::Communication => Group::Communication,
        };
        self.store.apply(&mut self.dictionary, group);
        self.configure_all(now);
        self.notify(Event::Reset(reset), now);
        if self.lss.pending().is_some() && self.quirks.begin(now) {
            self.slave.handle(Input::Initialised);
            self.entered(now);
        }
    }

    /// Runs the quirks: late boot-up message, requests received before it, and emergencies.
    fn run_quirks(&mut self, now: Duration) {
        if self.quirks.take_boot_up(now) {
            self.slave.handle(Input::Initialised);
            self.entered(now);
            while let Some(request) = self.quirks.take_early() {
                self.handle_sdo(&request, now);
            }
        }
        while let Some(emergency) = self.quirks.take_emergency(now) {
            let Emergency {
                code,
                register,
                data,
            } = emergency;
            self.errors.raise(Source::Node, code, register, data);
        }
    }

    /// Handles an NMT input.
    fn manage(&mut self, input: Input, now: Duration) {
        let before = self.slave.state();
        match self.slave.handle(input) {
            Some(reset) => self.begin(reset, now),
            None if self.slave.state() != before => self.entered(now),
            None => {}
        }
    }

    fn entered(&mut self, now: Duration) {
        let state = self.slave.state();
        if state == State::Operational {
            self.tpdos.iter_mut().for_each(|(_, tpdo)| tpdo.start());
        } else {
            self.rpdos.iter_mut().for_each(|(_, rpdo)| rpdo.stop());
        }
        if !state.communicates() {
            self.server.reset();
        }
        self.notify(Event::State(state), now);
    }

    /// Handles a received frame; ignores frames for others.
    pub fn handle_frame(&mut self, frame: &Frame, now: Duration) {
        self.run_timers(now);
        let Some(frame) = self.misread(frame) else {
            return;
        };
        let frame = &frame;
        let id = frame.id();
        let data = frame.data();
        if frame.is_remote() {
            self.handle_remote(id, now);
        } else if id == NMT {
            self.handle_nmt(frame, now);
        } else if id == LSS_MASTER {
            self.handle_lss(data, now);
        } else if self.slave.state() == State::Initialising && id == self.settings.request {
            self.quirks.keep(data);
        } else if !self.slave.state().communicates() {
            self.handle_heartbeat(frame, now);
        } else if id == self.settings.sync {
            self.handle_sync(data, now);
        } else if id == self.settings.request {
            self.handle_sdo(data, now);
        } else if Some(id) == self.settings.time {
            if let Some(time) = TimeOfDay::decode(data) {
                self.notify(Event::Time(time), now);
            }
        } else {
            self.handle_rpdo(id, data, now);
            self.handle_heartbeat(frame, now);
        }
        self.write_errors();
    }

    /// Updates error register 1001h and history 1003h.
    fn write_errors(&mut self) {
        let register = self.errors.register();
        self.dictionary.set(self.keys.error_register, register);
        while let Some(emergency) = self.errors.poll_log() {
            let [_, vendor, ..] = emergency.data;
            configure::remember(&mut self.dictionary, emergency.code, vendor);
        }
    }

    /// The next frame to send, if any.
    pub fn poll_transmit(&mut self, now: Duration) -> Option<Frame> {
        self.run_malfunctions(now);
        loop {
            let frame = self.next_frame(now)?;
            if let Some(frame) = self.missend(frame) {
                return Some(frame);
            }
        }
    }

    /// The next frame of a node without malfunctions.
    fn next_frame(&mut self, now: Duration) -> Option<Frame> {
        self.run_timers(now);
        if let Some(beat) = self.slave.poll_transmit(now) {
            return Some(beat);
        }
        if self.slave.state().communicates()
            && let Some(id) = self.settings.emergency
            && let Some(emergency) = self.errors.poll(now)
        {
            return Some(frame(id, &emergency.encode()));
        }
        if let Some(queued) = self.queue.pop_front() {
            return Some(queued);
        }
        if self.slave.state() == State::Operational {
            let dictionary = &self.dictionary;
            let mut polled = self.tpdos.iter_mut();
            if let Some(frame) = polled.find_map(|(_, tpdo)| tpdo.poll(dictionary, now)) {
                return Some(frame);
            }
        }
        if let Some(answer) = self.quirks.take_late(now) {
            return Some(answer);
        }
        if self.quirks.has_late() {
            return None;
        }
        let answer = self.server.poll(now)?;
        Some(frame(self.settings.response, &answer))
    }

    /// Next time at which [`Self::poll_transmit`] has work; at or before `now`: at once.
    pub fn poll_timeout(&self) -> Option<Duration> {
        if !self.queue.is_empty() {
            return Some(Duration::ZERO);
        }
        let consumers = self.consumers.iter().map(|(_, c)| c.poll_timeout());
        let operational = self.slave.state() == State::Operational;
        let d = &self.dictionary;
        let rpdos = self.rpdos.iter().map(|(_, rpdo)| rpdo.poll_timeout());
        let tpdos = self.tpdos.iter().map(|(_, tpdo)| tpdo.poll_timeout(d));
        let pdos = rpdos.chain(tpdos).filter(|_| operational);
        let communicates = self.slave.state().communicates();
        let emergency = self
            .settings
            .emergency
            .and_then(|_| self.errors.poll_timeout());
        [
            self.slave.poll_timeout(),
            self.server.poll_timeout(),
            self.application.poll_timeout(),
            self.quirks.poll_timeout(),
            self.malfunctions.poll_timeout(),
            self.sync_producer
                .as_ref()
                .map(sync::Producer::poll_timeout),
            emergency.filter(|_| communicates),
        ]
        .into_iter()
        .chain(consumers)
        .chain(pdos)
        .flatten()
        .min()
    }

    /// The state as in heartbeats.
    pub const fn nmt_state(&self) -> NmtState {
        self.slave.state().nmt_state()
    }
}

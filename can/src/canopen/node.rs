//! A CANopen slave device (CiA 301): an object dictionary, and everything that makes it a node.
//! What the device does, its [`Application`] says; bytes come and go as frames; time is told.
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
pub use objects::Communication;
use quirks::Manners;
pub use quirks::NodeQuirks;

/// Most frames that wait to be sent; further ones are counted and dropped.
pub const QUEUE_MAX: usize = 64;

/// Why a dictionary makes no node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NodeError {
    /// The objects make no dictionary.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
    /// An object that every node has is not there, or has another type.
    #[error("{0} is missing or of a wrong type; CiA 301 demands it")]
    Missing(Address),
    /// A PDO's mapping cannot be.
    #[error("the mapping {index:04X}h is refused: {why}")]
    Mapping {
        /// Index of the mapping parameters.
        index: u16,
        /// As a write of it would be.
        why: AbortCode,
    },
}

/// What happened to a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// SYNC: received values are in the dictionary; what is there after this is transmitted.
    Sync,
    /// The RPDO of that number (from 0) put new values into the dictionary; of one that waited for SYNC this comes
    /// behind [`Self::Sync`].
    Received(u16),
    /// The RPDO of that number is late (1400h:05).
    Late(u16),
    /// The RPDO of that number came again after it was late.
    InTime(u16),
    /// Network management brought the node here.
    State(State),
    /// All objects, or those of communication, have their defaults again.
    Reset(Reset),
    /// A heartbeat that is watched, or the guarding master, was lost.
    Lost,
    /// All heartbeats that are watched are there again.
    Back,
    /// TIME.
    Time(TimeOfDay),
    /// LSS asks for something that only the owner can do.
    Lss(lss::Done),
}

/// What an application works with.
#[derive(Debug)]
pub struct Context<'a> {
    /// The objects.
    pub dictionary: &'a mut Dictionary,
    /// What is wrong with the device.
    pub errors: &'a mut emcy::Producer,
    /// The time.
    pub now: Duration,
}

/// What a device does. `()` does nothing: a node that only has objects.
pub trait Application {
    /// Before a read from the bus: bring the value up to date, or refuse.
    ///
    /// # Errors
    /// The reason is sent to who asked.
    fn before_upload(&mut self, _: &mut Dictionary, _: Address) -> Result<(), AbortCode> {
        Ok(())
    }

    /// Before a write from the bus that all rules allow: the last word on it.
    ///
    /// # Errors
    /// The reason is sent to who asked; nothing is written.
    fn check_download(&mut self, _: &Dictionary, _: Address, _: &[u8]) -> Result<(), AbortCode> {
        Ok(())
    }

    /// After a write from the bus by SDO.
    fn after_download(&mut self, _: &mut Dictionary, _: Address) {}

    /// Something happened.
    fn handle(&mut self, _: Event, _: &mut Context<'_>) {}

    /// Time passed.
    fn poll(&mut self, _: &mut Context<'_>) {}

    /// When it wants to be polled.
    fn poll_timeout(&self) -> Option<Duration> {
        None
    }
}

impl Application for () {}

/// Objects that a node writes by itself, found once.
#[derive(Clone, Copy, Debug)]
struct Keys {
    error_register: Key<u8>,
}

/// What the communication objects say, read when they are written.
#[derive(Clone, Debug)]
struct Settings {
    sync: Id,
    time: Option<Id>,
    emergency: Option<Id>,
    request: Id,
    response: Id,
    behaviour: ErrorBehaviour,
}

/// What a node is made of.
#[derive(Debug)]
pub struct NodeConfig {
    /// Its number; without one it waits for LSS.
    pub id: Option<NodeId>,
    /// Its objects.
    pub dictionary: Dictionary,
    /// Numbers (COB-IDs) to whose default the node number is added.
    pub relative: Vec<Address>,
    /// Longest value that its SDO server transfers, bytes.
    pub sdo_len_max: usize,
    /// How long its SDO server waits for a client.
    pub sdo_timeout: Duration,
    /// How it departs from the standard.
    pub quirks: NodeQuirks,
}

/// A CANopen slave.
#[derive(Debug)]
pub struct Node<A> {
    application: A,
    dictionary: Dictionary,
    relative: Vec<Address>,
    /// What it was told to keep (1010h).
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
    manners: Manners,
}

impl<A: Application> Node<A> {
    /// A node that begins now.
    ///
    /// # Errors
    /// If its dictionary lacks what every node has, or a PDO cannot be mapped.
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
            manners: Manners::new(config.quirks, id_or_any),
        };
        node.begin(Reset::Node, now);
        Ok(node)
    }

    /// Its number; `None` while it waits for LSS.
    #[must_use]
    pub fn id(&self) -> Option<NodeId> {
        (self.slave.state() != State::Initialising).then(|| self.slave.id())
    }

    /// Its state.
    #[must_use]
    pub const fn state(&self) -> State {
        self.slave.state()
    }

    /// Its objects.
    #[must_use]
    pub const fn dictionary(&self) -> &Dictionary {
        &self.dictionary
    }

    /// Its objects, to be changed by the owner: no rule is asked.
    pub const fn dictionary_mut(&mut self) -> &mut Dictionary {
        &mut self.dictionary
    }

    /// What the device does.
    #[must_use]
    pub const fn application(&self) -> &A {
        &self.application
    }

    /// What the device does, to be changed by the owner.
    pub const fn application_mut(&mut self) -> &mut A {
        &mut self.application
    }

    /// What is wrong with the device, to be added to by the owner.
    pub const fn errors_mut(&mut self) -> &mut emcy::Producer {
        &mut self.errors
    }

    /// Frames that found no place in the queue.
    #[must_use]
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }

    /// Asks for the TPDO of that number (from 0), whatever it carries.
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

    fn tell(&mut self, event: Event, now: Duration) {
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

    /// Begins anew: the objects have their defaults or what was stored of them, the node its number.
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
        self.tell(Event::Reset(reset), now);
        if self.lss.pending().is_some() && self.manners.begin(now) {
            self.slave.handle(Input::Initialised);
            self.entered(now);
        }
    }

    /// The time of its quirks: a boot-up message that was late, what was requested before it, and emergencies.
    fn run_manners(&mut self, now: Duration) {
        if self.manners.take_boot_up(now) {
            self.slave.handle(Input::Initialised);
            self.entered(now);
            while let Some(request) = self.manners.take_early() {
                self.handle_sdo(&request, now);
            }
        }
        while let Some(emergency) = self.manners.take_emergency(now) {
            let Emergency {
                code,
                register,
                data,
            } = emergency;
            self.errors.raise(Source::Node, code, register, data);
        }
    }

    /// Network management says something.
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
        self.tell(Event::State(state), now);
    }

    /// Takes a frame from the bus; those that are not for it are passed over.
    pub fn handle_frame(&mut self, frame: &Frame, now: Duration) {
        self.run_timers(now);
        let id = frame.id();
        let data = frame.data();
        if frame.is_remote() {
            self.handle_remote(id, now);
        } else if id == NMT {
            self.handle_nmt(frame, now);
        } else if id == LSS_MASTER {
            self.handle_lss(data, now);
        } else if self.slave.state() == State::Initialising && id == self.settings.request {
            self.manners.keep(data);
        } else if !self.slave.state().communicates() {
            self.handle_heartbeat(frame, now);
        } else if id == self.settings.sync {
            self.handle_sync(data, now);
        } else if id == self.settings.request {
            self.handle_sdo(data, now);
        } else if Some(id) == self.settings.time {
            if let Some(time) = TimeOfDay::decode(data) {
                self.tell(Event::Time(time), now);
            }
        } else {
            self.handle_rpdo(id, data, now);
            self.handle_heartbeat(frame, now);
        }
        self.write_errors();
    }

    /// The error register 1001h and the history 1003h.
    fn write_errors(&mut self) {
        let register = self.errors.register();
        self.dictionary.set(self.keys.error_register, register);
        while let Some(emergency) = self.errors.poll_log() {
            let [_, vendor, ..] = emergency.data;
            configure::remember(&mut self.dictionary, emergency.code, vendor);
        }
    }

    /// The next frame to send, until there is none.
    pub fn poll_transmit(&mut self, now: Duration) -> Option<Frame> {
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
        if let Some(answer) = self.manners.take_late(now) {
            return Some(answer);
        }
        if self.manners.has_late() {
            return None;
        }
        let answer = self.server.poll(now)?;
        Some(frame(self.settings.response, &answer))
    }

    /// When [`Self::poll_transmit`] has something to do; not after `now` means at once.
    #[must_use]
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
            self.manners.poll_timeout(),
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

    /// The state as heartbeats tell it.
    #[must_use]
    pub const fn told(&self) -> NmtState {
        self.slave.state().told()
    }
}

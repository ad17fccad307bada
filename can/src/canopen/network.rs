//! The master of a network (CiA 301, CiA 302-2): brings its nodes up, exchanges their process data
//! with SYNC, leads the axes of drives, watches heartbeats, and carries SDO transfers beside all
//! that. One thread owns it; it waits for nothing.
//!
//! ```text
//! each period:  cycle ------> poll_process: SYNC, then the RPDOs of all running nodes
//! in between:   handle_frame <- TPDOs, heartbeats, EMCY, SDO answers
//!               poll_service -> NMT, guarding, heartbeat, SDO: so many frames in a period
//!               poll_event   -> what happened
//! ```
//!
//! Nodes share nothing: what one does or does not do costs the others at most its frames.

mod axis;
mod member;
mod plan;
mod startup;
mod trouble;

pub use axis::{Axis, AxisCommand, AxisState};
pub use plan::{AxisPlan, Download, NodePlan, Supervision};
pub use startup::{Action, Answer, Phase, Startup};
pub use trouble::{AxisTrouble, Trouble};

use std::collections::VecDeque;
use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Address, Dictionary, DictionaryError};

use super::message::{EMERGENCY, HEARTBEAT, SDO_REQUEST, SDO_RESPONSE, frame, heartbeat};
use super::pdo::PdoCob;
use super::sdo::Outcome;
use super::sync::Counter;
use super::{Emergency, Message, NmtCommand, NmtState, NodeId, sync as sync_frame};
use crate::{Frame, Id};
use member::{Member, News};

/// Most transfers of a node that wait or were not asked about.
pub const TRANSFERS_MAX: usize = 8;
/// Identifiers of 11 bits.
const IDS: usize = 0x800;

/// How a network is led.
#[derive(Clone, Debug)]
pub struct NetworkConfig {
    /// 1019h: SYNC counts up to this; 0 is without a counter.
    pub sync_overflow: u8,
    /// The master's own node number and how often it sends a heartbeat; nodes watch it (1016h).
    pub heartbeat: Option<(NodeId, Duration)>,
    /// Longest time from reset to boot-up, and half of that from start to Operational.
    pub boot_up_max: Duration,
    /// After which time a node that failed is tried again; zero is never.
    pub retry: Duration,
    /// Longest time for an SDO answer.
    pub sdo_timeout: Duration,
    /// SDO frames that are sent in a period, of all nodes together.
    pub sdo_per_cycle: u32,
}

impl Default for NetworkConfig {
    fn default() -> Self {
        Self {
            sync_overflow: 0,
            heartbeat: None,
            boot_up_max: Duration::from_secs(5),
            retry: Duration::from_secs(5),
            sdo_timeout: Duration::from_millis(500),
            sdo_per_cycle: 4,
        }
    }
}

/// Why plans make no network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// A node number is planned twice.
    #[error("node {0} is planned twice")]
    Twice(NodeId),
    /// The master has the number of a node.
    #[error("node {0} has the master's number; give the master another one")]
    Master(NodeId),
    /// Two PDOs or services have the same identifier.
    #[error("node {node}: {id}h is used already; give its PDO another identifier")]
    Collision {
        /// Whose.
        node: NodeId,
        /// Which.
        id: Id,
    },
    /// A PDO is off, or has an identifier that PDOs may not have.
    #[error("node {0}: a PDO with {1} cannot be exchanged; give it an identifier of its own")]
    Identifier(NodeId, PdoCob),
    /// A mapping does not fit.
    #[error("node {node}: a PDO cannot be mapped so: {why}")]
    Mapping {
        /// Whose.
        node: NodeId,
        /// As a device would say.
        why: AbortCode,
    },
    /// An entry has a length that no number has.
    #[error("node {0}: {1} is mapped with a length that no number has")]
    Type(NodeId, Address),
    /// The mapped objects make no image.
    #[error("the process image: {0}")]
    Image(DictionaryError),
}

/// A transfer by SDO that runs beside the process data.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Transfer {
    /// Of which object.
    pub address: Address,
    /// Whether it is written; else it is read.
    pub write: bool,
    /// Whether by block transfer, which is for long values.
    pub in_blocks: bool,
    /// What is written, or where the value goes; with room for it nothing is allocated.
    pub data: Vec<u8>,
    /// The owner's mark.
    pub tag: u32,
}

/// What happened in a network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// The start of a node came to this point.
    Phase(NodeId, Phase),
    /// Something is wrong with a node.
    Trouble(NodeId, Trouble),
    /// A node sent emergencies: the last one, and how many since the last event.
    Emergency(NodeId, Emergency, u32),
    /// A homing run of an axis of a node ended.
    Homed(NodeId),
    /// What hinders an axis of a node changed.
    Axis(NodeId),
    /// A transfer ended.
    Transferred(NodeId, Transfer, Outcome),
}

/// Where a received identifier belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Route {
    Nowhere,
    Heartbeat(u8),
    Emergency(u8),
    Sdo(u8),
    Tpdo(u8, u8),
}

/// The master of a network.
#[derive(Debug)]
pub struct Network {
    config: NetworkConfig,
    members: Vec<Member>,
    routes: Vec<Route>,
    /// SYNC and RPDOs of the present period.
    process: VecDeque<Frame>,
    counter: Counter,
    /// When the last period began.
    cycled: Option<Duration>,
    sdo_left: u32,
    beat_due: Option<Duration>,
    /// Whose SDO and whose news come next.
    turn: usize,
}

impl Network {
    /// A network of these nodes, in which nothing happens yet.
    ///
    /// # Errors
    /// If node numbers or identifiers collide, or a PDO cannot be.
    pub fn new(config: NetworkConfig, plans: Vec<NodePlan>) -> Result<Self, NetworkError> {
        let mut members = Vec::new();
        for plan in plans {
            members.push(Member::new(plan, &config)?);
        }
        let frames = 1 + members.iter().map(|m| m.plan.rpdos.len()).sum::<usize>();
        Ok(Self {
            routes: routes(&members, config.heartbeat.map(|(master, _)| master))?,
            process: VecDeque::with_capacity(frames),
            counter: Counter::new(config.sync_overflow),
            cycled: None,
            sdo_left: 0,
            beat_due: config.heartbeat.map(|_| Duration::ZERO),
            turn: 0,
            members,
            config,
        })
    }

    fn member(&self, node: NodeId) -> Option<&Member> {
        self.members.iter().find(|member| member.plan.id == node)
    }

    fn member_mut(&mut self, node: NodeId) -> Option<&mut Member> {
        self.members
            .iter_mut()
            .find(|member| member.plan.id == node)
    }

    /// Its nodes.
    pub fn nodes(&self) -> impl Iterator<Item = NodeId> + '_ {
        self.members.iter().map(|member| member.plan.id)
    }

    /// Brings all nodes up, each as fast as it can.
    pub fn start(&mut self, now: Duration) {
        self.members.iter_mut().for_each(|member| member.begin(now));
    }

    /// Brings one node up, anew if it runs.
    pub fn start_node(&mut self, node: NodeId, now: Duration) {
        if let Some(member) = self.member_mut(node) {
            member.begin(now);
        }
    }

    /// Sends a node back to Pre-operational; its axes are lost.
    pub fn stop_node(&mut self, node: NodeId, now: Duration) {
        if let Some(member) = self.member_mut(node) {
            member.end(now);
        }
    }

    /// Sends one command of network management, beside the start. For tools.
    pub fn command(&mut self, node: NodeId, command: NmtCommand) {
        if let Some(member) = self.member_mut(node) {
            member.command = Some(command);
        }
    }

    /// Where the start of a node is.
    #[must_use]
    pub fn phase(&self, node: NodeId) -> Option<Phase> {
        self.member(node).map(|member| member.startup.phase())
    }

    /// What is wrong with a node, last.
    #[must_use]
    pub fn trouble(&self, node: NodeId) -> Option<Trouble> {
        self.member(node).and_then(|member| member.trouble)
    }

    /// An axis of a node, in the order of its plan.
    #[must_use]
    pub fn axis(&self, node: NodeId, axis: usize) -> Option<&Axis> {
        self.member(node).and_then(|member| member.axes.get(axis))
    }

    /// An axis of a node, to be told something.
    pub fn axis_mut(&mut self, node: NodeId, axis: usize) -> Option<&mut Axis> {
        let member = self.member_mut(node);
        member.and_then(|member| member.axes.get_mut(axis))
    }

    /// The process image of a node: all objects in its PDOs. Those of its axes are written by
    /// [`Self::cycle`].
    #[must_use]
    pub fn image(&self, node: NodeId) -> Option<&Dictionary> {
        self.member(node).map(|member| &member.image)
    }

    /// The process image of a node, to write outputs.
    pub fn image_mut(&mut self, node: NodeId) -> Option<&mut Dictionary> {
        self.member_mut(node).map(|member| &mut member.image)
    }

    /// Hands in a transfer; it runs when the node's SDO server is free.
    ///
    /// # Errors
    /// Gives it back if there is no such node, or [`TRANSFERS_MAX`] wait or were not asked about.
    pub fn transfer(&mut self, node: NodeId, transfer: Transfer) -> Result<(), Transfer> {
        match self.member_mut(node) {
            Some(member) => member.enqueue(transfer),
            None => Err(transfer),
        }
    }

    /// One period: SYNC, then what the running nodes receive. What was not sent of the period
    /// before is dropped: no burst of old set-points.
    pub fn cycle(&mut self, now: Duration) {
        self.process.clear();
        self.process.push_back(sync_frame(self.counter.advance()));
        for member in &mut self.members {
            member.cycle(now, |frame| self.process.push_back(frame));
        }
        self.cycled = Some(now);
        self.sdo_left = self.config.sdo_per_cycle;
    }

    /// Takes a frame from the bus.
    pub fn handle_frame(&mut self, frame: &Frame, now: Duration) {
        if frame.id().is_extended() || frame.is_remote() {
            return;
        }
        let at = usize::try_from(frame.id().raw()).unwrap_or(IDS);
        let route = self.routes.get(at).copied().unwrap_or(Route::Nowhere);
        let data = frame.data();
        match route {
            Route::Nowhere => {}
            Route::Heartbeat(at) => {
                if let Message::Heartbeat(_, state, toggle) = Message::decode(frame) {
                    self.of(at, |member| member.handle_heartbeat(state, toggle, now));
                }
            }
            Route::Emergency(at) => {
                if let Some(bytes) = data.first_chunk() {
                    let emergency = Emergency::decode(bytes);
                    self.of(at, |member| {
                        // Two may come before one is taken: a fault is not hidden by its end.
                        if emergency.code != 0 || member.news.emergencies == 0 {
                            member.emergency = Some(emergency);
                        }
                        member.news.emergencies = member.news.emergencies.saturating_add(1);
                    });
                }
            }
            Route::Sdo(at) => {
                if let Some(message) = data.first_chunk() {
                    self.of(at, |member| member.handle_sdo(message, now));
                }
            }
            Route::Tpdo(at, pdo) => self.of(at, |member| member.handle_tpdo(pdo.into(), data)),
        }
    }

    fn of(&mut self, at: u8, act: impl FnOnce(&mut Member)) {
        if let Some(member) = self.members.get_mut(usize::from(at)) {
            act(member);
        }
    }

    /// The next frame of process data. To be sent before anything else.
    pub fn poll_process(&mut self) -> Option<Frame> {
        self.process.pop_front()
    }

    /// The next frame of anything else: network management, heartbeat, guarding, SDO. Of SDO there
    /// are so many in a period; without periods, as many as there are.
    pub fn poll_service(&mut self, now: Duration) -> Option<Frame> {
        for member in &mut self.members {
            member.run_timers(now);
        }
        if let Some((node, period)) = self.config.heartbeat
            && self.beat_due.is_some_and(|due| now >= due)
        {
            self.beat_due = Some(now + period);
            return Some(heartbeat(node, NmtState::Operational));
        }
        for member in &mut self.members {
            if let Some(command) = member.command.take() {
                return Some(command.frame(Some(member.plan.id)));
            }
            if let Some(question) = member.question.take() {
                return Some(question);
            }
        }
        self.poll_sdo(now)
    }

    fn poll_sdo(&mut self, now: Duration) -> Option<Frame> {
        let long_ago = Duration::from_millis(500);
        let cycles = self
            .cycled
            .is_some_and(|at| now.saturating_sub(at) < long_ago);
        if cycles && self.sdo_left == 0 {
            return None;
        }
        let count = self.members.len();
        for n in 0..count {
            let at = (self.turn + n) % count;
            let member = &mut self.members[at];
            if let Some(message) = member.poll_sdo(now) {
                self.turn = at + 1;
                self.sdo_left = self.sdo_left.saturating_sub(1);
                return Some(frame(member.plan.id.cob(SDO_REQUEST), &message));
            }
        }
        None
    }

    /// The next frame: process data first.
    pub fn poll_transmit(&mut self, now: Duration) -> Option<Frame> {
        self.poll_process().or_else(|| self.poll_service(now))
    }

    /// When [`Self::poll_transmit`] has something to do; the periods its owner knows.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Duration> {
        if !self.process.is_empty() {
            return Some(Duration::ZERO);
        }
        let members = self.members.iter().filter_map(Member::poll_timeout);
        members.chain(self.beat_due).min()
    }

    /// What happened, until there is nothing. Nothing piles up: of each kind a node has one.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.members.iter_mut().find_map(news_of)
    }
}

fn news_of(member: &mut Member) -> Option<Event> {
    let node = member.plan.id;
    let News {
        phase,
        trouble,
        emergencies,
        homed,
        axis,
    } = &mut member.news;
    if std::mem::take(phase) {
        return Some(Event::Phase(node, member.startup.phase()));
    }
    if std::mem::take(trouble)
        && let Some(trouble) = member.trouble
    {
        return Some(Event::Trouble(node, trouble));
    }
    let count = std::mem::take(emergencies);
    if count > 0
        && let Some(emergency) = member.emergency
    {
        return Some(Event::Emergency(node, emergency, count));
    }
    if std::mem::take(homed) {
        return Some(Event::Homed(node));
    }
    if std::mem::take(axis) {
        return Some(Event::Axis(node));
    }
    let (transfer, outcome) = member.take_finished()?;
    Some(Event::Transferred(node, transfer, outcome))
}

/// Where each identifier belongs; refuses two owners.
fn routes(members: &[Member], master: Option<NodeId>) -> Result<Vec<Route>, NetworkError> {
    let mut routes = vec![Route::Nowhere; IDS];
    for (at, member) in (0_u8..).zip(members) {
        let node = member.plan.id;
        if members.iter().filter(|other| other.plan.id == node).count() > 1 {
            return Err(NetworkError::Twice(node));
        }
        if master == Some(node) {
            return Err(NetworkError::Master(node));
        }
        let mut add = |id: Id, route| {
            let place = usize::try_from(id.raw())
                .ok()
                .and_then(|raw| routes.get_mut(raw));
            match place {
                Some(place) if *place == Route::Nowhere => {
                    *place = route;
                    Ok(())
                }
                _ => Err(NetworkError::Collision { node, id }),
            }
        };
        add(node.cob(HEARTBEAT), Route::Heartbeat(at))?;
        add(node.cob(EMERGENCY), Route::Emergency(at))?;
        add(node.cob(SDO_RESPONSE), Route::Sdo(at))?;
        for (pdo, (_, parameters)) in (0_u8..).zip(&member.plan.tpdos) {
            let cob = parameters.cob;
            let id = cob.id().ok_or(NetworkError::Identifier(node, cob))?;
            add(id, Route::Tpdo(at, pdo))?;
        }
    }
    Ok(routes)
}

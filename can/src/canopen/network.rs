//! CANopen master (CiA 301, CiA 302-2): starts the nodes, exchanges process data with SYNC,
//! commands the axes of drives, monitors heartbeats, and runs SDO transfers in the background. One
//! thread owns it; it never blocks.
//!
//! ```text
//! each period:  cycle ------> poll_process: SYNC, then the RPDOs of all running nodes
//! in between:   handle_frame <- TPDOs, heartbeats, EMCY, SDO answers
//!               poll_service -> NMT, guarding, heartbeat, SDO: a limited number of frames per period
//!               poll_event   -> events
//! ```
//!
//! Nodes are independent: a faulty node costs the others at most the bus time of its frames.

mod axis;
mod fault;
mod member;
mod plan;
mod startup;

pub use axis::{Axis, AxisCommand, AxisState};
pub use fault::{AxisFault, NodeFault};
pub use plan::{AxisPlan, Download, NodePlan, Supervision, time_index};
pub use startup::{Action, Answer, Phase, Startup};

use std::collections::VecDeque;
use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Address, Dictionary, DictionaryError};

use super::message::{EMERGENCY, HEARTBEAT, SDO_REQUEST, SDO_RESPONSE, frame, heartbeat};
use super::pdo::PdoCob;
use super::sdo::Outcome;
use super::sync::Counter;
use super::{Emergency, Message, NmtCommand, NmtState, NodeId, sync as sync_frame};
use crate::{Frame, Id};
use member::{Member, PendingEvents};

/// Maximum number of pending and uncollected transfers of a node.
pub const TRANSFERS_MAX: usize = 8;
/// Number of 11-bit identifiers.
const IDS: usize = 0x800;

/// Configuration of the master.
#[derive(Clone, Debug)]
pub struct NetworkConfig {
    /// Synchronous counter overflow value (1019h); 0: no counter.
    pub sync_overflow: u8,
    /// The master's node number and heartbeat period; the nodes monitor it (1016h).
    pub heartbeat: Option<(NodeId, Duration)>,
    /// Boot-up timeout after reset; half of the timeout from start to Operational.
    pub boot_up_max: Duration,
    /// Delay until a failed node is restarted; zero: never.
    pub retry: Duration,
    /// SDO response timeout.
    pub sdo_timeout: Duration,
    /// Maximum SDO frames per period, over all nodes.
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

/// Errors of a network plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// A node number is planned twice.
    #[error("node {0} is planned twice")]
    Twice(NodeId),
    /// The master and a node have the same number.
    #[error("node {0} has the master's number; change one of them")]
    Master(NodeId),
    /// Two PDOs or services use the same identifier.
    #[error("node {node}: {id}h is used already; change the identifier of its PDO")]
    Collision {
        /// The node.
        node: NodeId,
        /// The identifier.
        id: Id,
    },
    /// A PDO is disabled, or its identifier is not allowed for PDOs.
    #[error("node {0}: a PDO with {1} cannot be exchanged; assign it a free identifier")]
    Identifier(NodeId, PdoCob),
    /// A mapping is invalid.
    #[error("node {node}: invalid PDO mapping: {why}")]
    Mapping {
        /// The node.
        node: NodeId,
        /// The abort code that a device would send.
        why: AbortCode,
    },
    /// An entry is mapped with a length that no number type has.
    #[error("node {0}: {1} is mapped with a length that no number type has")]
    Type(NodeId, Address),
    /// The mapped objects do not form a process image.
    #[error("the process image: {0}")]
    Image(DictionaryError),
}

/// An SDO transfer in the background of the process data.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Transfer {
    /// The object.
    pub address: Address,
    /// Whether the object is written, else read.
    pub write: bool,
    /// Whether to use block transfer, for long values.
    pub in_blocks: bool,
    /// The value to write, or the buffer for the read value; sufficient capacity avoids allocation.
    pub data: Vec<u8>,
    /// Tag of the owner.
    pub tag: u32,
}

/// Events of a network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// The start of a node reached this phase.
    Phase(NodeId, Phase),
    /// A node has a fault.
    Fault(NodeId, NodeFault),
    /// A node sent emergencies: the last one, and their number since the last event.
    Emergency(NodeId, Emergency, u32),
    /// A homing run of an axis of a node ended.
    Homed(NodeId),
    /// The fault of an axis of a node changed.
    Axis(NodeId),
    /// A transfer ended.
    Transferred(NodeId, Transfer, Outcome),
}

/// Receiver of an identifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Route {
    None,
    Heartbeat(u8),
    Emergency(u8),
    Sdo(u8),
    Tpdo(u8, u8),
}

/// A CANopen master.
#[derive(Debug)]
pub struct Network {
    config: NetworkConfig,
    members: Vec<Member>,
    routes: Vec<Route>,
    /// SYNC and RPDOs of the current period.
    process: VecDeque<Frame>,
    counter: Counter,
    /// When the last period began.
    cycled: Option<Duration>,
    sdo_left: u32,
    beat_due: Option<Duration>,
    /// Next node in the round robin of SDO transfers.
    turn: usize,
}

impl Network {
    /// A network of these nodes, not started.
    ///
    /// # Errors
    /// If node numbers or identifiers collide, or a PDO is invalid.
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

    /// Starts all nodes in parallel.
    pub fn start(&mut self, now: Duration) {
        self.members.iter_mut().for_each(|member| member.begin(now));
    }

    /// Starts one node; restarts it if it runs.
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

    /// Sends one NMT command, outside of the start procedure. For tools.
    pub fn command(&mut self, node: NodeId, command: NmtCommand) {
        if let Some(member) = self.member_mut(node) {
            member.command = Some(command);
        }
    }

    /// Start phase of a node.
    pub fn phase(&self, node: NodeId) -> Option<Phase> {
        self.member(node).map(|member| member.startup.phase())
    }

    /// The last fault of a node.
    pub fn fault(&self, node: NodeId) -> Option<NodeFault> {
        self.member(node).and_then(|member| member.fault)
    }

    /// An axis of a node, in the order of its plan.
    pub fn axis(&self, node: NodeId, axis: usize) -> Option<&Axis> {
        self.member(node).and_then(|member| member.axes.get(axis))
    }

    /// An axis of a node, to command it.
    pub fn axis_mut(&mut self, node: NodeId, axis: usize) -> Option<&mut Axis> {
        let member = self.member_mut(node);
        member.and_then(|member| member.axes.get_mut(axis))
    }

    /// The process image of a node: all objects in its PDOs. [`Self::cycle`] writes the objects of
    /// its axes.
    pub fn image(&self, node: NodeId) -> Option<&Dictionary> {
        self.member(node).map(|member| &member.image)
    }

    /// The process image of a node, to write outputs.
    pub fn image_mut(&mut self, node: NodeId) -> Option<&mut Dictionary> {
        self.member_mut(node).map(|member| &mut member.image)
    }

    /// Queues a transfer; it runs when the node's SDO server is free.
    ///
    /// # Errors
    /// Returns the transfer if the node is unknown, or [`TRANSFERS_MAX`] are pending or
    /// uncollected.
    pub fn transfer(&mut self, node: NodeId, transfer: Transfer) -> Result<(), Transfer> {
        match self.member_mut(node) {
            Some(member) => member.enqueue(transfer),
            None => Err(transfer),
        }
    }

    /// Starts a period: SYNC, then the RPDOs of the running nodes. Unsent frames of the previous
    /// period are dropped, so that no burst of stale set-points follows.
    pub fn cycle(&mut self, now: Duration) {
        self.process.clear();
        self.process.push_back(sync_frame(self.counter.advance()));
        for member in &mut self.members {
            member.cycle(now, |frame| self.process.push_back(frame));
        }
        self.cycled = Some(now);
        self.sdo_left = self.config.sdo_per_cycle;
    }

    /// Handles a received frame.
    pub fn handle_frame(&mut self, frame: &Frame, now: Duration) {
        if frame.id().is_extended() || frame.is_remote() {
            return;
        }
        let at = usize::try_from(frame.id().raw()).unwrap_or(IDS);
        let route = self.routes.get(at).copied().unwrap_or(Route::None);
        let data = frame.data();
        match route {
            Route::None => {}
            Route::Heartbeat(at) => {
                if let Message::Heartbeat(_, state, toggle) = Message::decode(frame) {
                    self.with_member(at, |member| member.handle_heartbeat(state, toggle, now));
                }
            }
            Route::Emergency(at) => {
                if let Some(bytes) = data.first_chunk() {
                    let emergency = Emergency::decode(bytes);
                    self.with_member(at, |member| {
                        // If several arrive before a poll, "no error" must not hide the fault.
                        if emergency.code != 0 || member.pending.emergencies == 0 {
                            member.emergency = Some(emergency);
                        }
                        member.pending.emergencies = member.pending.emergencies.saturating_add(1);
                    });
                }
            }
            Route::Sdo(at) => {
                if let Some(message) = data.first_chunk() {
                    self.with_member(at, |member| member.handle_sdo(message, now));
                }
            }
            Route::Tpdo(at, pdo) => {
                self.with_member(at, |member| member.handle_tpdo(pdo.into(), data));
            }
        }
    }

    fn with_member(&mut self, at: u8, act: impl FnOnce(&mut Member)) {
        if let Some(member) = self.members.get_mut(usize::from(at)) {
            act(member);
        }
    }

    /// The next process data frame, to be sent before all others.
    pub fn poll_process(&mut self) -> Option<Frame> {
        self.process.pop_front()
    }

    /// The next service frame: NMT, heartbeat, guarding, SDO. The number of SDO frames per period
    /// is limited; without periods it is not.
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
            if let Some(request) = member.guarding_request.take() {
                return Some(request);
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

    /// The next frame, process data first.
    pub fn poll_transmit(&mut self, now: Duration) -> Option<Frame> {
        self.poll_process().or_else(|| self.poll_service(now))
    }

    /// Next time at which [`Self::poll_transmit`] has work, apart from the periods.
    pub fn poll_timeout(&self) -> Option<Duration> {
        if !self.process.is_empty() {
            return Some(Duration::ZERO);
        }
        let members = self.members.iter().filter_map(Member::poll_timeout);
        members.chain(self.beat_due).min()
    }

    /// The next event, if any. The queue is bounded: one event of each kind per node.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.members.iter_mut().find_map(next_event)
    }
}

fn next_event(member: &mut Member) -> Option<Event> {
    let node = member.plan.id;
    let PendingEvents {
        phase,
        fault,
        emergencies,
        homed,
        axis,
    } = &mut member.pending;
    if std::mem::take(phase) {
        return Some(Event::Phase(node, member.startup.phase()));
    }
    if std::mem::take(fault)
        && let Some(fault) = member.fault
    {
        return Some(Event::Fault(node, fault));
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

/// Routing table of the identifiers; two receivers are an error.
fn routes(members: &[Member], master: Option<NodeId>) -> Result<Vec<Route>, NetworkError> {
    let mut routes = vec![Route::None; IDS];
    for (at, member) in (0_u8..).zip(members) {
        let node = member.plan.id;
        if members.iter().filter(|other| other.plan.id == node).count() > 1 {
            return Err(NetworkError::Twice(node));
        }
        if master == Some(node) {
            return Err(NetworkError::Master(node));
        }
        let mut add = |id: Id, route| {
            let slot = usize::try_from(id.raw())
                .ok()
                .and_then(|raw| routes.get_mut(raw));
            match slot {
                Some(slot) if *slot == Route::None => {
                    *slot = route;
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

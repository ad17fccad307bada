//! Master side of one node: start procedure, monitoring, process image, SDO client. It shares
//! nothing with other nodes, so that faults stay local.

mod babble;
mod transfers;

use std::collections::VecDeque;
use std::time::Duration;

use babble::Babble;
use takt_cia402::dictionary::{
    AbortCode, Access, Address, DataType, Dictionary, Entry, Mapped, Mapping, Object, PdoUse,
};

use super::plan::{NodePlan, Supervision};
use super::startup::{Action, Phase, Startup};
use super::{Axis, NetworkConfig, NetworkError, NodeFault, Outcome, TRANSFERS_MAX, Transfer};
use crate::canopen::nmt::{Consumer, Guarded, Guarding};
use crate::canopen::pdo::Parameters;
use crate::canopen::{Emergency, NmtCommand, NmtState, sdo};
use crate::{Frame, Id};

/// Pending events of a node, one flag of each kind.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PendingEvents {
    pub(super) phase: bool,
    pub(super) fault: bool,
    pub(super) emergencies: u32,
    pub(super) homed: bool,
    pub(super) axis: bool,
}

/// A TPDO received by the master.
#[derive(Debug)]
struct Received {
    number: u16,
    mapping: Mapping,
    /// Bit n: the TPDO carries the statusword of axis n of the plan.
    axes: u8,
}

/// Owner of the running SDO transfer.
#[derive(Debug)]
enum Owner {
    None,
    Startup,
    /// The process data proof of that axis.
    Axis(usize),
    User(Transfer),
}

#[derive(Debug)]
pub(super) struct Member {
    pub(super) plan: NodePlan,
    pub(super) startup: Startup,
    pub(super) image: Dictionary,
    sent: Vec<(Id, Mapping)>,
    received: Vec<Received>,
    pub(super) axes: Vec<Axis>,
    client: sdo::Client,
    owner: Owner,
    /// The next message of the running SDO transfer.
    message: Option<sdo::Message>,
    /// The next SDO request of the start procedure.
    pending_request: Action,
    waiting: VecDeque<Transfer>,
    finished: VecDeque<(Transfer, Outcome)>,
    consumer: Consumer,
    guarding: Option<Guarding>,
    pub(super) command: Option<NmtCommand>,
    pub(super) guarding_request: Option<Frame>,
    pub(super) emergency: Option<Emergency>,
    pub(super) fault: Option<NodeFault>,
    pub(super) pending: PendingEvents,
    last_phase: Phase,
    /// Remaining periods of quick stop RPDOs before the NMT stop.
    stop_cycles: u32,
    /// Until then an SDO response may belong to a request from before the boot-up, or be a repetition.
    quiet_until: Duration,
    babble: Babble,
}

/// Time in which a node may still answer requests from before its boot-up: a node that powers up together with the
/// master boots twice, by itself and by the master's reset.
const QUIET_TIME: Duration = Duration::from_millis(50);

/// Number of quick stop RPDO periods for a node that is given up: two of them may be lost.
const STOP_CYCLES: u32 = 3;

impl Member {
    pub(super) fn new(plan: NodePlan, config: &NetworkConfig) -> Result<Self, NetworkError> {
        let image = image(&plan)?;
        let node = plan.id;
        let mapping = |entries: &[Mapped], received| {
            let mapped = Mapping::new(&image, entries, received, 64);
            mapped.map_err(|why| NetworkError::Mapping { node, why })
        };
        let mut sent = Vec::new();
        for (_, pdo) in &plan.rpdos {
            let id = pdo
                .cob
                .id()
                .ok_or(NetworkError::Identifier(node, pdo.cob))?;
            sent.push((id, mapping(&pdo.mapping, true)?));
        }
        let mut received = Vec::new();
        for (number, pdo) in &plan.tpdos {
            received.push(Received {
                number: *number,
                mapping: mapping(&pdo.mapping, false)?,
                axes: axes_of(&plan, &pdo.mapping),
            });
        }
        let axes = plan
            .axes
            .iter()
            .map(|axis| Axis::new(*axis, &image))
            .collect();
        let downloads = plan.all_downloads(config.heartbeat);
        let timing = (config.boot_up_max, config.retry);
        Ok(Self {
            startup: Startup::new(&plan, downloads, timing),
            image,
            sent,
            received,
            axes,
            client: sdo::Client::new(plan.sdo_len_max, config.sdo_timeout),
            owner: Owner::None,
            message: None,
            pending_request: Action::None,
            waiting: VecDeque::with_capacity(TRANSFERS_MAX),
            finished: VecDeque::with_capacity(TRANSFERS_MAX),
            consumer: Consumer::new(Duration::ZERO),
            guarding: None,
            command: None,
            guarding_request: None,
            emergency: None,
            fault: None,
            pending: PendingEvents::default(),
            last_phase: Phase::Off,
            stop_cycles: 0,
            quiet_until: Duration::ZERO,
            babble: Babble::default(),
            plan,
        })
    }

    pub(super) fn is_running(&self) -> bool {
        self.startup.phase() == Phase::Running
    }

    /// Executes an action of the start procedure and handles a change of phase.
    pub(super) fn execute(&mut self, action: Action, now: Duration) {
        match action {
            Action::None => {}
            Action::Command(command) => self.command = Some(command),
            Action::Read(_) | Action::Write(_) => self.pending_request = action,
        }
        let phase = self.startup.phase();
        if phase == self.last_phase {
            return;
        }
        let before = std::mem::replace(&mut self.last_phase, phase);
        self.pending.phase = true;
        if self.startup.fault().is_some_and(|t| self.fault != Some(t)) {
            self.fault = self.startup.fault();
            self.pending.fault = true;
        }
        self.stop_cycles = 0;
        if before == Phase::Running {
            self.axes.iter_mut().for_each(Axis::lost);
            self.begin_stop();
        }
        match phase {
            Phase::Starting => self.watch(now),
            Phase::Running => self.fault = None,
            Phase::Resetting | Phase::Failed | Phase::Off => {
                (self.guarding, self.pending_request) = (None, Action::None);
                self.babble = Babble::default();
                if matches!(self.owner, Owner::Startup) {
                    self.drop_transfer(AbortCode::General);
                }
            }
            Phase::Checking(_) | Phase::Configuring { .. } => {}
        }
    }

    /// A quick stop by RPDO also stops a drive whose 6007h ignores NMT stop.
    fn begin_stop(&mut self) {
        if self.last_phase == Phase::Failed && !self.axes.is_empty() {
            self.stop_cycles = STOP_CYCLES;
            self.command = None;
        }
    }

    fn watch(&mut self, now: Duration) {
        self.consumer = Consumer::new(Duration::ZERO);
        match self.plan.supervision {
            Supervision::Heartbeat(period) => self.consumer = Consumer::new(period * 5 / 2),
            Supervision::Guarding(period, factor) => {
                self.guarding = Some(Guarding::new(self.plan.id, period, factor, now));
            }
            Supervision::None => {}
        }
    }

    pub(super) fn record_fault(&mut self, fault: NodeFault) {
        self.pending.fault |= self.fault != Some(fault);
        self.fault = Some(fault);
    }

    pub(super) fn begin(&mut self, now: Duration) {
        let action = self.startup.begin(now);
        self.execute(action, now);
    }

    pub(super) fn end(&mut self, now: Duration) {
        let action = self.startup.end();
        self.execute(action, now);
    }

    fn fail(&mut self, fault: NodeFault, now: Duration) {
        let action = self.startup.fail(fault, now);
        self.execute(action, now);
    }

    pub(super) fn handle_heartbeat(&mut self, state: NmtState, toggle: bool, now: Duration) {
        match &mut self.guarding {
            Some(guarding) => {
                if let Guarded::Toggle(_) = guarding.handle(state, toggle) {
                    // A repeated answer is no sign of life; the timeout will detect a loss.
                    return;
                }
            }
            None => drop(self.consumer.handle(state, now)),
        }
        if state == NmtState::BootUp && self.startup.phase() != Phase::Off {
            if !self.client.is_idle() {
                self.quiet_until = now + QUIET_TIME;
            }
            self.drop_transfer(AbortCode::General);
        }
        let action = self.startup.handle_state(state, now);
        self.execute(action, now);
    }

    pub(super) fn handle_tpdo(&mut self, at: usize, data: &[u8]) {
        let Some(tpdo) = self.received.get(at) else {
            return;
        };
        if data.len() < tpdo.mapping.len() {
            let (number, len) = (tpdo.number, u8::try_from(data.len()).unwrap_or(0));
            self.record_fault(NodeFault::PdoShort { number, len });
            return;
        }
        // It is back; the next loss is reported again.
        let number = tpdo.number;
        let is_back = matches!(
            self.fault,
            Some(NodeFault::PdoMissing { number: n, .. } | NodeFault::PdoShort { number: n, .. })
                if n == number
        );
        if is_back && !self.pending.fault {
            self.fault = None;
        }
        tpdo.mapping.unpack(&mut self.image, data);
        let axes = tpdo.axes;
        for (n, axis) in self.axes.iter_mut().enumerate() {
            if axes >> n & 1 == 1 {
                axis.received();
            }
        }
    }

    /// One cycle: its axes, then its RPDOs.
    pub(super) fn cycle(&mut self, now: Duration, mut send: impl FnMut(Frame)) {
        if self.is_running() {
            self.run_axes(now);
        } else if self.stop_cycles > 0 {
            self.stop_cycles -= 1;
            for axis in &self.axes {
                axis.write_quick_stop(&mut self.image);
            }
            if self.stop_cycles == 0 {
                self.command = Some(NmtCommand::Stop);
            }
        } else {
            return;
        }
        for (id, mapping) in &self.sent {
            let mut data = [0; 8];
            mapping.pack(&self.image, &mut data);
            let data = data.get(..mapping.len()).unwrap_or_default();
            send(crate::canopen::message::frame(*id, data));
        }
    }

    fn run_axes(&mut self, now: Duration) {
        for at in 0..self.axes.len() {
            let axis = &mut self.axes[at];
            let homed = axis.is_homing();
            let fault = axis.fault();
            let missing = axis.cycle(&mut self.image, now);
            self.pending.homed |= homed && !axis.is_homing();
            self.pending.axis |= axis.fault() != fault;
            if missing {
                let cycles = axis.state().missing;
                let carries = |tpdo: &&Received| tpdo.axes >> at & 1 == 1;
                let number = self.received.iter().find(carries).map_or(0, |t| t.number);
                self.record_fault(NodeFault::PdoMissing { number, cycles });
            }
        }
    }

    /// Handles timeouts of heartbeat, guarding and start.
    pub(super) fn run_timers(&mut self, now: Duration) {
        let action = self.startup.poll(now);
        self.execute(action, now);
        if self.is_running() && self.consumer.poll(now) {
            let Supervision::Heartbeat(period) = self.plan.supervision else {
                return;
            };
            self.fail(NodeFault::HeartbeatLost(period * 5 / 2), now);
        }
        if let Some((guarding_request, lost)) = self.guarding.as_mut().and_then(|g| g.poll(now)) {
            self.guarding_request = Some(guarding_request);
            if lost && self.is_running() {
                self.fail(NodeFault::GuardingLost, now);
            }
        }
    }

    pub(super) fn poll_timeout(&self) -> Option<Duration> {
        if self.command.is_some() || self.guarding_request.is_some() {
            return Some(Duration::ZERO);
        }
        let sdo = if self.message.is_some() {
            Some(Duration::ZERO)
        } else {
            self.has_sdo().then_some(self.quiet_until)
        };
        let heartbeat = self.consumer.poll_timeout().filter(|_| self.is_running());
        let guarding = self.guarding.as_ref().map(Guarding::poll_timeout);
        let client = self.client.poll_timeout();
        [
            sdo,
            self.startup.poll_timeout(),
            heartbeat,
            guarding,
            client,
        ]
        .into_iter()
        .flatten()
        .min()
    }
}

/// Bit mask of the axes of a plan with their statusword in a PDO.
fn axes_of(plan: &NodePlan, mapping: &[Mapped]) -> u8 {
    let status = |axis: u8| Address::new(0x6041, 0).on_axis(axis);
    (0_u8..8)
        .zip(&plan.axes)
        .filter(|(_, axis)| mapping.iter().any(|m| Some(m.address) == status(axis.axis)))
        .fold(0, |bits, (n, _)| bits | 1 << n)
}

/// The master's process image: all objects in PDOs of a node.
fn image(plan: &NodePlan) -> Result<Dictionary, NetworkError> {
    let node = plan.id;
    let mut objects: Vec<Object> = Vec::new();
    let pdos = plan
        .rpdos
        .iter()
        .chain(&plan.tpdos)
        .map(|(_, pdo): &(u16, Parameters)| pdo);
    for mapped in pdos.flat_map(|pdo| &pdo.mapping).filter(|m| !m.is_gap()) {
        let kind = data_type(mapped).ok_or(NetworkError::Type(node, mapped.address))?;
        let value = vec![0; kind.size().unwrap_or(0)];
        let entry = Entry::of("process data", kind, Access::ReadWrite, value);
        let entry = (mapped.address.sub, entry.mappable(PdoUse::Both));
        let known = objects.iter_mut().find(|o| o.index == mapped.address.index);
        match known {
            Some(object) if object.entries.iter().any(|(sub, _)| *sub == entry.0) => {}
            Some(object) => object.entries.push(entry),
            None => {
                let mut object = Object::var(mapped.address.index, entry.1.clone());
                object.entries = vec![entry];
                objects.push(object);
            }
        }
    }
    Dictionary::new(objects).map_err(NetworkError::Image)
}

/// The type of a profile entry; for others, an unsigned type of that length.
fn data_type(mapped: &Mapped) -> Option<DataType> {
    let index = mapped.address.index;
    let of_axis = if index >= 0x6000 {
        0x6000 + (index - 0x6000) % Address::AXIS
    } else {
        index
    };
    Some(match (of_axis, mapped.bits) {
        (0x6060 | 0x6061, 8) => DataType::Integer8,
        (0x6071 | 0x6074 | 0x6077 | 0x6078 | 0x60B2, 16) => DataType::Integer16,
        (
            0x6062..=0x6064
            | 0x606B
            | 0x606C
            | 0x607A
            | 0x60B0
            | 0x60B1
            | 0x60BA..=0x60BD
            | 0x60C1
            | 0x60F4
            | 0x60FC
            | 0x60FF,
            32,
        ) => DataType::Integer32,
        (_, 1) => DataType::Boolean,
        (_, 8) => DataType::Unsigned8,
        (_, 16) => DataType::Unsigned16,
        (_, 24) => DataType::Unsigned24,
        (_, 32) => DataType::Unsigned32,
        (_, 40) => DataType::Unsigned40,
        (_, 48) => DataType::Unsigned48,
        (_, 56) => DataType::Unsigned56,
        (_, 64) => DataType::Unsigned64,
        _ => return None,
    })
}

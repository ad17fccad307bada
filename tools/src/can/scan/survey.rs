//! The survey of a bus: listens, sends queries, collects the facts of each node and the findings. It prints nothing.

use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

use takt_can::Frame;
use takt_can::canopen::lss::{Identity, Job, LssError, Master, Mode, Reply};
use takt_can::canopen::sdo::{Initiate, Request, Response};
use takt_can::canopen::{HEARTBEAT, LSS_MASTER, Message, NmtState, NodeId, SDO_REQUEST};
use takt_cia402::dictionary::{AbortCode, Address};

use crate::can::sdo_client::{SdoClient, number};
use crate::can::wire::Wire;

const DEVICE_TYPE: Address = Address::new(0x1000, 0);
const SERIAL: Address = Address::new(0x1018, 4);
/// Timeout of an LSS answer.
const LSS_TIMEOUT: Duration = Duration::from_millis(20);
/// Timeout of a node guarding answer.
const GUARD_TIMEOUT: Duration = Duration::from_millis(50);
/// Largest number of devices without a number that are identified.
const LSS_MAX: usize = 127;

/// What the survey covers.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    pub(super) nodes: Vec<NodeId>,
    pub(super) listen: Duration,
    pub(super) wait: Duration,
    pub(super) lss: bool,
}

/// Facts of a node.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Found {
    pub(super) state: Option<NmtState>,
    /// Mean time between its heartbeats.
    pub(super) heartbeat: Option<Duration>,
    /// When the first of them was read, and how many followed: two may be read at once.
    pub(super) beats: Option<(Duration, u32)>,
    /// Boot-up messages received.
    pub(super) boots: u32,
    /// 1000h
    pub(super) device_type: Option<u32>,
    /// 1018h
    pub(super) identity: [Option<u32>; 4],
    /// 1008h
    pub(super) name: Option<String>,
    /// 1001h
    pub(super) errors: Option<u8>,
    /// Largest number of answers to one query.
    pub(super) answers: usize,
}

/// A problem of the bus or of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Finding {
    /// No node was found.
    NoNodes,
    /// Several devices have one number.
    Duplicate(NodeId),
    /// It sends messages but answers no SDO.
    Mute(NodeId, Option<NmtState>),
    /// 1001h is not zero.
    Errors(NodeId, u8),
}

impl Finding {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::NoNodes => "nobody",
            Self::Duplicate(_) => "duplicate",
            Self::Mute(..) => "mute",
            Self::Errors(..) => "error-register",
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoNodes => f.write_str(
                "no node found\nhint: check the power of the nodes and the bit rate (takt can stat); --lss finds nodes \
                 without a number",
            ),
            Self::Duplicate(node) => write!(
                f,
                "several devices have number {node}\nhint: unplug all but one and give it another number"
            ),
            Self::Mute(node, Some(NmtState::Stopped)) => write!(
                f,
                "node {node} is stopped and answers no SDO\nhint: takt can nmt IFACE {node} preop"
            ),
            Self::Mute(node, _) => write!(
                f,
                "node {node} sends messages but answers no SDO\nhint: its SDO server may have other identifiers (1200h), or \
                 be busy with another master"
            ),
            Self::Errors(node, bits) => write!(
                f,
                "node {node} reports errors (1001h = {bits:02X}h)\nhint: takt can sdo IFACE {node} upload 1003:01"
            ),
        }
    }
}

/// Result of a survey.
#[derive(Clone, Debug, Default)]
pub(super) struct Report {
    pub(super) nodes: BTreeMap<NodeId, Found>,
    /// Devices without a number.
    pub(super) unconfigured: Vec<Identity>,
}

impl Report {
    pub(super) fn findings(&self) -> Vec<Finding> {
        let is_empty = self.nodes.is_empty() && self.unconfigured.is_empty();
        let mut findings: Vec<Finding> = is_empty.then_some(Finding::NoNodes).into_iter().collect();
        for (node, found) in &self.nodes {
            if found.answers > 1 {
                findings.push(Finding::Duplicate(*node));
            }
            if found.answers == 0 {
                findings.push(Finding::Mute(*node, found.state));
            }
            let errors = found.errors.filter(|bits| *bits != 0);
            findings.extend(errors.map(|bits| Finding::Errors(*node, bits)));
        }
        findings
    }

    /// Handles a message that a node sent.
    fn handle(&mut self, frame: &Frame, now: Duration) {
        let message = Message::decode(frame);
        let node = match message {
            Message::Heartbeat(node, ..)
            | Message::Emergency(node, _)
            | Message::SdoResponse(node, _) => node,
            Message::Nmt(..)
            | Message::Sync(_)
            | Message::Time(..)
            | Message::Tpdo(..)
            | Message::Rpdo(..)
            | Message::SdoRequest(..)
            | Message::Guard(_)
            | Message::Lss(..)
            | Message::Unknown => return,
        };
        let found = self.nodes.entry(node).or_default();
        let Message::Heartbeat(_, state, _) = message else {
            return;
        };
        if state == NmtState::BootUp {
            found.boots += 1;
            // After boot-up a node is pre-operational (CiA 301, figure 43) until its next heartbeat.
            found.state = Some(NmtState::PreOperational);
            found.beats = None;
            return;
        }
        found.state = Some(state);
        let (first, count) = found
            .beats
            .map_or((now, 0), |(first, count)| (first, count + 1));
        found.beats = Some((first, count));
        let mean = now.saturating_sub(first).checked_div(count);
        found.heartbeat = mean.or(found.heartbeat);
    }
}

/// Listens, queries all numbers, then reads the details of the nodes that answered.
pub(super) fn survey<W: Wire>(wire: &mut W, plan: &Plan) -> anyhow::Result<Report> {
    let mut report = Report::default();
    listen(wire, &mut report, plan.listen)?;
    let types = query_all(wire, &mut report, &plan.nodes, DEVICE_TYPE, plan.wait)?;
    let present: Vec<NodeId> = report.nodes.keys().copied().collect();
    // Two devices of one type send the same answer at once, which is one frame on the bus; their serial numbers differ.
    let serials = query_all(wire, &mut report, &present, SERIAL, plan.wait)?;
    for (node, found) in &mut report.nodes {
        let of =
            |all: &BTreeMap<NodeId, Vec<Option<u32>>>| all.get(node).cloned().unwrap_or_default();
        let (types, serials) = (of(&types), of(&serials));
        found.answers = types.len().max(serials.len());
        found.device_type = types.first().copied().flatten();
        found.identity[3] = serials.first().copied().flatten();
    }
    for (node, found) in &mut report.nodes {
        if found.answers > 0 {
            details(wire, *node, found, plan.wait)?;
        }
        if found.state.is_none() {
            found.state = guard(wire, *node)?;
        }
    }
    if plan.lss {
        report.unconfigured = fast_scan(wire)?;
    }
    Ok(report)
}

fn listen<W: Wire>(wire: &mut W, report: &mut Report, time: Duration) -> anyhow::Result<()> {
    let until = wire.now() + time;
    while wire.now() < until {
        if let Some(frame) = wire.receive_until(until)? {
            report.handle(&frame, wire.now());
        }
    }
    Ok(())
}

/// Queries all nodes at once and returns their answers. An abort is an answer too.
fn query_all<W: Wire>(
    wire: &mut W,
    report: &mut Report,
    nodes: &[NodeId],
    address: Address,
    wait: Duration,
) -> anyhow::Result<BTreeMap<NodeId, Vec<Option<u32>>>> {
    let mut answers: BTreeMap<NodeId, Vec<Option<u32>>> = BTreeMap::new();
    let mut left = nodes.iter();
    let mut until = wire.now() + wait;
    while wire.now() < until {
        // One request at a time, so that answers are received between the requests.
        if let Some(node) = left.next() {
            let request = Request::Upload { address }.encode();
            wire.send(&Frame::full(node.cob(SDO_REQUEST), request))?;
            until = wire.now() + wait;
        }
        let receive_until = if left.len() > 0 { wire.now() } else { until };
        while let Some(frame) = wire.receive_until(receive_until)? {
            report.handle(&frame, wire.now());
            if let Message::SdoResponse(node, message) = Message::decode(&frame)
                && let Some(answer) = answer(&message, address)
            {
                answers.entry(node).or_default().push(answer);
            }
        }
    }
    Ok(answers)
}

/// The number in an answer for an object; the inner `None` is an abort or a longer value.
fn answer(message: &[u8; 8], object: Address) -> Option<Option<u32>> {
    let response = Response::decode(message)?;
    if response.address() != Some(object) {
        return None;
    }
    let Response::Upload { data, .. } = response else {
        return Some(None);
    };
    Some(match data {
        Initiate::Expedited(bytes) => number(bytes.as_slice()),
        Initiate::Segmented(_) => None,
    })
}

/// Reads the identity, the name and the error register. An abort leaves a value out; a timeout ends the reading.
fn details<W: Wire>(
    wire: &mut W,
    node: NodeId,
    found: &mut Found,
    timeout: Duration,
) -> anyhow::Result<()> {
    let mut client = SdoClient::new(node, timeout);
    let mut read = |wire: &mut W, index, sub| client.read(wire, Address::new(index, sub), false);
    for sub in 1..=3_u8 {
        match read(wire, 0x1018, sub)? {
            Ok(bytes) => found.identity[usize::from(sub) - 1] = number(&bytes),
            Err(error) if error.is_timeout() => return Ok(()),
            // The identity has no further entries.
            Err(error) if error.code() == Some(AbortCode::NoSubIndex) => break,
            Err(_) => {}
        }
    }
    if let Ok(bytes) = read(wire, 0x1008, 0)? {
        let name = String::from_utf8_lossy(&bytes);
        found.name = Some(name.trim_end_matches('\0').to_owned());
    }
    if let Ok(bytes) = read(wire, 0x1001, 0)? {
        found.errors = bytes.first().copied();
    }
    Ok(())
}

/// The state of a node without heartbeat, by node guarding, which not every node supports.
fn guard<W: Wire>(wire: &mut W, node: NodeId) -> anyhow::Result<Option<NmtState>> {
    if let Ok(request) = Frame::remote(node.cob(HEARTBEAT), 1) {
        wire.send(&request)?;
    }
    let until = wire.now() + GUARD_TIMEOUT;
    while let Some(frame) = wire.receive_until(until)? {
        if let Message::Heartbeat(from, state, _) = Message::decode(&frame)
            && from == node
        {
            return Ok(Some(state));
        }
    }
    Ok(None)
}

/// Identifies all devices without a number. An identified device does not take part in the next scan; at the end all
/// are set to waiting.
fn fast_scan<W: Wire>(wire: &mut W) -> anyhow::Result<Vec<Identity>> {
    let mut found = Vec::new();
    let mut master = Master::new(LSS_TIMEOUT);
    run(wire, &mut master, Job::Switch(Mode::Waiting))?.ok();
    while found.len() < LSS_MAX {
        let Ok(Reply::Address(identity)) = run(wire, &mut master, Job::FastScan([None; 4]))? else {
            break;
        };
        found.push(identity);
    }
    run(wire, &mut master, Job::Switch(Mode::Waiting))?.ok();
    Ok(found)
}

fn run<W: Wire>(
    wire: &mut W,
    master: &mut Master,
    job: Job,
) -> anyhow::Result<Result<Reply, LssError>> {
    master.start(job);
    loop {
        if let Some(message) = master.poll_transmit(wire.now()) {
            wire.send(&Frame::full(LSS_MASTER, message))?;
        }
        if let Some(outcome) = master.take_outcome() {
            return Ok(outcome);
        }
        let until = master.poll_timeout().unwrap_or_default();
        if let Some(frame) = wire.receive_until(until)?
            && let Message::Lss(false, message) = Message::decode(&frame)
        {
            master.handle(&message);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::can::lab::{Lab, node};
    use takt_can::canopen::NmtCommand;
    use takt_can::canopen::emulator::DriveNodeConfig;

    fn plan(lss: bool) -> Plan {
        Plan {
            nodes: NodeId::all().collect(),
            listen: Duration::from_millis(300),
            wait: Duration::from_millis(100),
            lss,
        }
    }

    #[test]
    fn survey_finds_nodes_with_and_without_heartbeat() {
        let mut lab = Lab::of_drives(&[5, 127]);
        lab.add_drive(DriveNodeConfig {
            heartbeat_ms: 100,
            ..DriveNodeConfig::new(node(9))
        });
        lab.run(10);
        let report = survey(&mut lab, &plan(false)).unwrap();
        assert_eq!(report.findings(), []);
        let numbers: Vec<u8> = report.nodes.keys().map(|node| node.raw()).collect();
        assert_eq!(numbers, [5, 9, 127]);
        for (at, found) in &report.nodes {
            assert_eq!(found.state, Some(NmtState::PreOperational), "{at}");
            assert_eq!(found.device_type, Some(0x0002_0192));
            let serial = u32::from(at.raw());
            assert_eq!(
                found.identity,
                [Some(0), Some(0x402), Some(1), Some(serial)]
            );
            assert_eq!(found.name.as_deref(), Some("Takt emulated drive"));
        }
        let beat = report.nodes[&node(9)].heartbeat.unwrap().as_millis();
        assert!((99..=101).contains(&beat), "{beat}");
        assert_eq!(report.nodes[&node(5)].heartbeat, None);
    }

    #[test]
    fn survey_of_empty_bus_finds_no_nodes() {
        let report = survey(&mut Lab::new(), &plan(true)).unwrap();
        assert_eq!(report.findings(), [Finding::NoNodes]);
    }

    #[test]
    fn survey_detects_duplicate_number_by_serial_numbers() {
        let mut lab = Lab::of_drives(&[5]);
        let mut twin = DriveNodeConfig::new(node(5));
        twin.identity.serial = 99;
        lab.add_drive(twin);
        lab.run(10);
        let report = survey(&mut lab, &plan(false)).unwrap();
        assert!(report.findings().contains(&Finding::Duplicate(node(5))));
    }

    #[test]
    fn survey_reports_stopped_node_as_mute() {
        let mut lab = Lab::new();
        lab.add_drive(DriveNodeConfig {
            heartbeat_ms: 100,
            ..DriveNodeConfig::new(node(9))
        });
        lab.run(10);
        lab.send(&NmtCommand::Stop.frame(None)).unwrap();
        lab.run(10);
        let report = survey(&mut lab, &plan(false)).unwrap();
        let stopped = Finding::Mute(node(9), Some(NmtState::Stopped));
        assert_eq!(report.findings(), [stopped]);
        assert!(stopped.to_string().contains("preop"), "{stopped}");
    }

    #[test]
    fn survey_reports_node_with_errors() {
        use takt_cia402::emulator::FaultCode;
        let mut lab = Lab::of_drives(&[5]);
        lab.run(10);
        let drives = lab.drive(0).application_mut();
        drives.axis_mut(0).unwrap().fault(FaultCode::TEMPERATURE);
        lab.run(20);
        let report = survey(&mut lab, &plan(false)).unwrap();
        assert_eq!(report.findings(), [Finding::Errors(node(5), 0x09)]);
    }

    #[test]
    fn survey_identifies_devices_without_number_and_restores_them() {
        let mut lab = Lab::of_drives(&[5]);
        for serial in [7, 0x8000_0001] {
            let mut config = DriveNodeConfig::new(node(1));
            config.id = None;
            config.identity.serial = serial;
            lab.add_drive(config);
        }
        lab.run(10);
        for _ in 0..2 {
            let report = survey(&mut lab, &plan(true)).unwrap();
            let mut serials: Vec<u32> = report.unconfigured.iter().map(|id| id.serial).collect();
            serials.sort_unstable();
            assert_eq!(serials, [7, 0x8000_0001]);
            assert_eq!(report.nodes.len(), 1);
        }
        assert_eq!(lab.drive(1).id(), None);
    }
}

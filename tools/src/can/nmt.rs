//! `takt can nmt`: network management commands (CiA 301, clause 7.2.8), and whether a node executed them. It does not
//! configure nodes; starting one enables its PDOs as they are.

use std::fmt;
use std::time::Duration;

use clap::{Args, ValueEnum};
use serde_json::{Value, json};
use takt_can::Frame;
use takt_can::canopen::sdo::{Request, Response};
use takt_can::canopen::{HEARTBEAT, Message, NmtCommand, NmtState, NodeId, SDO_REQUEST};
use takt_cia402::dictionary::Address;

use super::confirm;
use super::wire::{Live, Wire};
use crate::Verdict;
use crate::output::{say, span};

/// Start, stop or reset nodes.
///
/// Exit status: 0 the command was sent, and with --timeout executed; 1 the node did not execute it; 2 it could not be
/// tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt can nmt can0 5 reset --timeout 5s
  takt can nmt can0 all stop")]
pub(crate) struct Nmt {
    /// The CAN interface.
    interface: String,
    /// The node, 1 to 127, or `all`.
    #[arg(value_parser = target)]
    node: Target,
    /// The command.
    command: Word,
    /// Wait at most this long until its heartbeat or its answer to node guarding shows the state; that of a node with
    /// neither is seen by whether it answers SDO.
    #[arg(long, alias = "wait", value_name = "TIME", value_parser = span)]
    timeout: Option<Duration>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
    /// It is safe that a machine moves.
    #[arg(long = "yes", alias = "confirm-motion")]
    confirm_motion: bool,
}

/// Addressee of a command.
#[derive(Clone, Copy, Debug)]
enum Target {
    All,
    One(NodeId),
}

fn target(text: &str) -> Result<Target, String> {
    if text == "all" {
        return Ok(Target::All);
    }
    let node = super::node(text).map_err(|error| format!("{error}, or `all`"))?;
    Ok(Target::One(node))
}

/// An NMT command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Word {
    /// Enter Operational: PDOs are active.
    Start,
    /// Enter Stopped: only network management is active.
    Stop,
    /// Enter Pre-operational: SDOs are active, PDOs are not.
    Preop,
    /// Reset the device.
    Reset,
    /// Reset the communication of the device.
    ResetComm,
}

impl Word {
    const fn command(self) -> NmtCommand {
        match self {
            Self::Start => NmtCommand::Start,
            Self::Stop => NmtCommand::Stop,
            Self::Preop => NmtCommand::EnterPreOperational,
            Self::Reset => NmtCommand::ResetNode,
            Self::ResetComm => NmtCommand::ResetCommunication,
        }
    }

    /// The state that a node reports after the command.
    const fn target_state(self) -> NmtState {
        match self {
            Self::Start => NmtState::Operational,
            Self::Stop => NmtState::Stopped,
            Self::Preop => NmtState::PreOperational,
            Self::Reset | Self::ResetComm => NmtState::BootUp,
        }
    }
}

/// Period of node guarding requests to a node without heartbeat.
const GUARD_PERIOD: Duration = Duration::from_millis(100);

/// Guarding requests without an answer after which SDO is tried, and the timeout of that.
const GUARDS: u32 = 3;
const SDO_TIMEOUT: Duration = Duration::from_millis(100);

/// Result of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Outcome {
    node: NodeId,
    wanted: NmtState,
    /// The last state that the node reported.
    shown: Option<NmtState>,
    /// Whether it answers SDO, asked only if it reports no state.
    answers_sdo: Option<bool>,
    /// Time until the node reached the state, or the time waited.
    after: Duration,
}

impl Outcome {
    /// A node that reports no state is not stopped if it answers SDO; whether its PDOs run is not visible then.
    fn is_good(self) -> bool {
        let communicates = matches!(
            self.wanted,
            NmtState::Operational | NmtState::PreOperational
        );
        match self.shown {
            Some(shown) => shown == self.wanted,
            None => communicates && self.answers_sdo == Some(true),
        }
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            node,
            wanted,
            shown,
            answers_sdo,
            after,
        } = self;
        let ms = after.as_millis();
        if self.is_good() && shown.is_none() {
            return write!(
                f,
                "node {node}: answers SDO after {ms} ms, so it is pre-operational or operational; it reports no state (1017h \
                 is 0 and it answers no guarding)"
            );
        }
        match shown {
            Some(shown) if shown == wanted => write!(f, "node {node}: {shown} after {ms} ms"),
            Some(shown) => write!(
                f,
                "node {node}: {shown} instead of {wanted} after {ms} ms\nhint: another master may command it, or an error may \
                 keep it there (1029h, takt can sdo IFACE {node} upload 1001)"
            ),
            None if *answers_sdo == Some(true) => write!(
                f,
                "node {node}: answers SDO instead of being {wanted} after {ms} ms; it reports no state\nhint: set 1017h, so \
                 that it sends heartbeats"
            ),
            None if *wanted == NmtState::Stopped => write!(
                f,
                "node {node}: no answer within {ms} ms, as from a stopped node that reports no state\nhint: set 1017h, so \
                 that it sends heartbeats; look for it with takt can scan"
            ),
            None => write!(
                f,
                "node {node}: no answer within {ms} ms\nhint: look for it with takt can scan; it may have neither \
                 heartbeat (1017h) nor node guarding"
            ),
        }
    }
}

impl Nmt {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let node = match self.node {
            Target::One(node) => Some(node),
            Target::All => None,
        };
        anyhow::ensure!(
            node.is_some() || self.timeout.is_none(),
            "--timeout needs one node\nhint: `takt can scan` shows the states of all"
        );
        let frame = self.command.command().frame(node);
        let mut wire = Live::open(&self.interface)?;
        confirm::motion(&self.interface, &[frame.into()], self.confirm_motion)?;
        let (Some(node), Some(timeout)) = (node, self.timeout) else {
            wire.send(&frame)?;
            let sent = Message::decode(&frame);
            say(&match self.json {
                true => json!({"version": 1, "sent": sent.to_string()}).to_string(),
                false => format!("{}: sent {sent}", self.interface),
            })?;
            return Ok(Verdict::Good);
        };
        let outcome = command(&mut wire, node, self.command, timeout)?;
        let text = match self.json {
            true => to_json(outcome).to_string(),
            false => outcome.to_string(),
        };
        say(&text)?;
        Ok(match outcome.is_good() {
            true => Verdict::Good,
            false => Verdict::Failed,
        })
    }
}

fn to_json(outcome: Outcome) -> Value {
    json!({
        "version": 1, "node": outcome.node.raw(), "wanted": outcome.wanted.to_string(),
        "state": outcome.shown.map(|state| state.to_string()), "obeyed": outcome.is_good(),
        "answers_sdo": outcome.answers_sdo, "after_ms": outcome.after.as_secs_f64() * 1e3,
    })
}

/// Commands a node and waits for the state.
fn command<W: Wire>(
    wire: &mut W,
    node: NodeId,
    word: Word,
    wait: Duration,
) -> anyhow::Result<Outcome> {
    let begun = wire.now();
    wire.send(&word.command().frame(Some(node)))?;
    let (end, mut next_request) = (begun + wait, begun + GUARD_PERIOD);
    let mut guards = 0;
    let mut outcome = Outcome {
        node,
        wanted: word.target_state(),
        shown: None,
        answers_sdo: None,
        after: wait,
    };
    while wire.now() < end {
        // Only the boot-up message confirms a reset.
        if wire.now() >= next_request && outcome.wanted != NmtState::BootUp {
            wire.send(&Frame::remote(node.cob(HEARTBEAT), 1)?)?;
            next_request = wire.now() + GUARD_PERIOD;
            guards += 1;
        }
        if guards > GUARDS && outcome.shown.is_none() {
            guards = 0;
            let (answers, beat) = answers_sdo(wire, node)?;
            (outcome.answers_sdo, outcome.shown) = (Some(answers), beat);
            outcome.after = wire.now().saturating_sub(begun);
            if outcome.is_good() {
                return Ok(outcome);
            }
        }
        let until = next_request.max(wire.now()).min(end);
        let until = if until > wire.now() { until } else { end };
        let Some(frame) = wire.receive_until(until)? else {
            continue;
        };
        if let Message::Heartbeat(from, state, _) = Message::decode(&frame)
            && from == node
        {
            outcome.shown = Some(state);
            outcome.after = wire.now().saturating_sub(begun);
            if outcome.is_good() {
                return Ok(outcome);
            }
        }
    }
    outcome.after = wait;
    Ok(outcome)
}

/// Whether a node answers the upload of 1000h, with a value or an abort; and the state that it reported meanwhile.
fn answers_sdo<W: Wire>(wire: &mut W, node: NodeId) -> anyhow::Result<(bool, Option<NmtState>)> {
    let address = Address::new(0x1000, 0);
    let request = Request::Upload { address }.encode();
    wire.send(&Frame::full(node.cob(SDO_REQUEST), request))?;
    let until = wire.now() + SDO_TIMEOUT;
    let (mut answers, mut shown) = (false, None);
    while let Some(frame) = wire.receive_until(until)? {
        match Message::decode(&frame) {
            Message::SdoResponse(from, message) if from == node => {
                let response = Response::decode(&message);
                answers |= response.is_some_and(|response| response.address() == Some(address));
            }
            Message::Heartbeat(from, state, _) if from == node => shown = Some(state),
            Message::Heartbeat(..)
            | Message::SdoResponse(..)
            | Message::SdoRequest(..)
            | Message::Emergency(..)
            | Message::Nmt(..)
            | Message::Sync(_)
            | Message::Time(..)
            | Message::Tpdo(..)
            | Message::Rpdo(..)
            | Message::Guard(_)
            | Message::Lss(..)
            | Message::Unknown => {}
        }
    }
    Ok((answers, shown))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::can::lab::{Lab, node};
    use takt_can::canopen::emulator::DriveNodeConfig;

    const WAIT: Duration = Duration::from_secs(1);

    #[test]
    fn nmt_command_with_and_without_heartbeat_is_confirmed() {
        let mut lab = Lab::of_drives(&[5]);
        lab.add_drive(DriveNodeConfig {
            heartbeat_ms: 50,
            ..DriveNodeConfig::new(node(6))
        });
        lab.run(10);
        for raw in [5, 6] {
            for word in Word::value_variants() {
                let outcome = command(&mut lab, node(raw), *word, WAIT).unwrap();
                assert!(outcome.is_good(), "{word:?}: {outcome}");
                assert!(outcome.after < 250 * Duration::from_millis(1), "{outcome}");
            }
        }
    }

    /// Neither heartbeat nor guarding: SDO shows that it is not stopped.
    #[test]
    fn nmt_state_without_heartbeat_and_guarding_is_seen_by_sdo() {
        let mut lab = Lab::of_drives(&[5]);
        lab.run(10);
        lab.drive(0).malfunctions_mut().no_heartbeat = true;
        for (word, is_good) in [
            (Word::Start, true),
            (Word::Stop, false),
            (Word::Preop, true),
        ] {
            let outcome = command(&mut lab, node(5), word, WAIT).unwrap();
            assert_eq!(
                (outcome.shown, outcome.is_good()),
                (None, is_good),
                "{outcome}"
            );
            assert_eq!(outcome.answers_sdo, Some(is_good), "{outcome}");
        }
        // Its boot-up is seen in any case.
        assert!(
            command(&mut lab, node(5), Word::Reset, WAIT)
                .unwrap()
                .is_good()
        );
    }

    #[test]
    fn nmt_command_to_absent_node_fails() {
        let outcome = command(&mut Lab::new(), node(5), Word::Start, WAIT).unwrap();
        assert_eq!((outcome.shown, outcome.is_good()), (None, false));
        assert!(outcome.to_string().contains("no answer within 1000 ms"));
        let outcome = command(&mut Lab::new(), node(5), Word::Reset, WAIT).unwrap();
        assert!(!outcome.is_good());
    }

    /// Another master stops the node again at once.
    #[test]
    fn nmt_command_overridden_by_another_master_fails() {
        let mut lab = Lab::of_drives(&[5]);
        lab.run(10);
        let stop = NmtCommand::Stop.frame(None);
        for ms in 1..1100 {
            lab.other_master
                .push((Duration::from_micros(10_000 + ms * 1000), stop));
        }
        let outcome = command(&mut lab, node(5), Word::Start, WAIT).unwrap();
        assert_eq!(outcome.shown, Some(NmtState::Stopped));
        assert!(outcome.to_string().contains("another master"), "{outcome}");
    }
}

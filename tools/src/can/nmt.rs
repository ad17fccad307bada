//! `takt can nmt`: commands of network management (CiA 301, clause 7.2.8), and whether a node obeyed. It does
//! not configure nodes; starting one lets its PDOs run as they are.

use std::fmt;
use std::time::Duration;

use clap::{Args, ValueEnum};
use serde_json::{Value, json};
use takt_can::Frame;
use takt_can::canopen::{HEARTBEAT, Message, NmtCommand, NmtState, NodeId};

use super::confirm;
use super::wire::{Live, Wire};
use crate::Verdict;
use crate::output::{say, span};

/// Start, stop or reset nodes.
///
/// Exit status: 0 the command was sent, and with --wait obeyed; 1 the node did not obey; 2 it could not be
/// tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt can nmt can0 5 reset --wait 5s
  takt can nmt can0 all stop")]
pub(crate) struct Nmt {
    /// The CAN interface.
    interface: String,
    /// The node, 1 to 127, or `all`.
    #[arg(value_parser = target)]
    node: Target,
    /// What it shall do.
    command: Word,
    /// Wait so long until its heartbeat, or its answer to node guarding, shows the state.
    #[arg(long, value_name = "TIME", value_parser = span)]
    wait: Option<Duration>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
    /// It is safe that a machine moves.
    #[arg(long)]
    confirm_motion: bool,
}

/// Whom a command is for.
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

/// A command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Word {
    /// To Operational: PDOs run.
    Start,
    /// To Stopped: only network management runs.
    Stop,
    /// To Pre-operational: SDOs run, PDOs do not.
    Preop,
    /// The whole device begins anew.
    Reset,
    /// Its communication begins anew.
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

    /// What a node tells that obeyed.
    const fn shown(self) -> NmtState {
        match self {
            Self::Start => NmtState::Operational,
            Self::Stop => NmtState::Stopped,
            Self::Preop => NmtState::PreOperational,
            Self::Reset | Self::ResetComm => NmtState::BootUp,
        }
    }
}

/// How often a node without heartbeat is asked.
const ASK_EVERY: Duration = Duration::from_millis(100);

/// What became of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Outcome {
    node: NodeId,
    wanted: NmtState,
    /// The last state that was told.
    shown: Option<NmtState>,
    /// Until it was as wanted, or how long was waited.
    after: Duration,
}

impl Outcome {
    fn is_good(self) -> bool {
        self.shown == Some(self.wanted)
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            node,
            wanted,
            shown,
            after,
        } = self;
        let ms = after.as_millis();
        match shown {
            Some(shown) if shown == wanted => write!(f, "node {node}: {shown} after {ms} ms"),
            Some(shown) => write!(
                f,
                "node {node}: {shown}, not {wanted}, after {ms} ms: does another master command it, or an error keep \
                 it there (1029h, takt can sdo IFACE {node} upload 1001)?"
            ),
            None => write!(
                f,
                "node {node}: says nothing within {ms} ms: is it there (takt can scan)? It may have neither heartbeat \
                 (1017h) nor node guarding"
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
            node.is_some() || self.wait.is_none(),
            "--wait needs one node; `takt can scan` shows the states of all"
        );
        let frame = self.command.command().frame(node);
        let mut wire = Live::open(&self.interface)?;
        confirm::motion(&self.interface, &[frame.into()], self.confirm_motion)?;
        let (Some(node), Some(wait)) = (node, self.wait) else {
            wire.send(&frame)?;
            let told = Message::decode(&frame);
            say(&match self.json {
                true => json!({"version": 1, "sent": told.to_string()}).to_string(),
                false => format!("{}: sent {told}", self.interface),
            })?;
            return Ok(Verdict::Good);
        };
        let outcome = command(&mut wire, node, self.command, wait)?;
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
        "after_ms": outcome.after.as_secs_f64() * 1e3,
    })
}

/// Commands a node and waits for what it tells.
fn command<W: Wire>(
    wire: &mut W,
    node: NodeId,
    word: Word,
    wait: Duration,
) -> anyhow::Result<Outcome> {
    let begun = wire.now();
    wire.send(&word.command().frame(Some(node)))?;
    let (end, mut ask) = (begun + wait, begun + ASK_EVERY);
    let mut outcome = Outcome {
        node,
        wanted: word.shown(),
        shown: None,
        after: wait,
    };
    while wire.now() < end {
        // A reset is told by the boot-up alone.
        if wire.now() >= ask && outcome.wanted != NmtState::BootUp {
            wire.send(&Frame::remote(node.cob(HEARTBEAT), 1)?)?;
            ask = wire.now() + ASK_EVERY;
        }
        let until = ask.max(wire.now()).min(end);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::can::lab::{Lab, node};
    use takt_can::canopen::emulator::DriveNodeConfig;

    const WAIT: Duration = Duration::from_secs(1);

    #[test]
    fn every_command_is_obeyed_with_and_without_heartbeat() {
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

    #[test]
    fn a_node_that_is_not_there_is_told() {
        let outcome = command(&mut Lab::new(), node(5), Word::Start, WAIT).unwrap();
        assert_eq!((outcome.shown, outcome.is_good()), (None, false));
        assert!(outcome.to_string().contains("says nothing within 1000 ms"));
        let outcome = command(&mut Lab::new(), node(5), Word::Reset, WAIT).unwrap();
        assert!(!outcome.is_good());
    }

    /// Another master takes it back at once.
    #[test]
    fn a_node_that_does_not_stay_is_told_with_its_state() {
        let mut lab = Lab::of_drives(&[5]);
        lab.run(10);
        let stop = NmtCommand::Stop.frame(None);
        for ms in 1..1100 {
            lab.stranger
                .push((Duration::from_micros(10_000 + ms * 1000), stop));
        }
        let outcome = command(&mut lab, node(5), Word::Start, WAIT).unwrap();
        assert_eq!(outcome.shown, Some(NmtState::Stopped));
        assert!(outcome.to_string().contains("another master"), "{outcome}");
    }
}

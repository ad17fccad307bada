//! `takt ecat state`: requests a state of one slave and shows how it answers, with the others in PRE-OP.

use std::time::Duration;

use clap::{Args, ValueEnum};
use serde_json::json;
use takt_ethercat::AlState;

use super::session::{Session, Wire};
use super::{REQUEST_CYCLE, Target, scan};
use crate::output::{complain, say, span};
use crate::{Verdict, confirm};

/// Request a state of one slave, and leave it there.
///
/// All other slaves are brought to PRE-OP. In OP all outputs are zero; with the end of the command the watchdog of the slave
/// expires. Exit status: 0 the slave shows the state; 1 it does not, with the reason; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat state enp2s0 3 safe-op
  takt ecat state enp2s0 3 boot
  takt ecat state enp2s0 3 op --hold 10s --yes")]
pub(crate) struct State {
    #[command(flatten)]
    target: Target,
    /// The slave: its position from 0, or its name or order code if it is unique.
    slave: String,
    /// The state.
    state: Wanted,
    /// How long to hold the state, with frames in each millisecond.
    #[arg(long, value_name = "TIME", default_value = "100ms", value_parser = span)]
    hold: Duration,
    /// It is safe that a machine moves (OP).
    #[arg(long = "yes", alias = "confirm-motion")]
    confirm_motion: bool,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Wanted {
    /// No mailbox, no process data.
    Init,
    /// Mailbox.
    PreOp,
    /// Inputs are exchanged, the slave keeps its outputs safe.
    SafeOp,
    /// The slave applies its outputs, which are zero.
    Op,
    /// The state for firmware updates.
    Boot,
}

impl From<Wanted> for AlState {
    fn from(wanted: Wanted) -> Self {
        match wanted {
            Wanted::Init => Self::Init,
            Wanted::PreOp => Self::PreOp,
            Wanted::SafeOp => Self::SafeOp,
            Wanted::Op => Self::Op,
            Wanted::Boot => Self::Boot,
        }
    }
}

impl State {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        if self.state == Wanted::Op {
            confirm::motion("OP with all outputs zero", self.confirm_motion)?;
        }
        let mut session = self.target.bring_up(AlState::PreOp, REQUEST_CYCLE)?;
        let slave = session.find(&self.slave)?;
        let shown = request(&mut session, slave, self.state.into(), self.target.timeout)?;
        session.run_for(self.hold)?;
        let shown = shown.and_then(|()| state_of(&session, slave, self.state.into()));
        let state = session.master().slave(slave).map(scan::state);
        let state = state.unwrap_or_default();
        if self.json {
            let fault = shown.as_ref().err();
            let object = json!({ "version": 1, "slave": slave, "state": state, "fault": fault });
            say(&object.to_string())?;
        } else if shown.is_ok() {
            say(&format!("slave {slave}: {state}"))?;
        }
        Ok(match shown {
            Ok(()) => Verdict::Good,
            Err(why) => {
                complain(&format!("takt: slave {slave} shows {state}: {why}"));
                Verdict::Failed
            }
        })
    }
}

/// Brings one slave to a state; the inner error is its reason.
pub(super) fn request<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    state: AlState,
    timeout: Duration,
) -> anyhow::Result<Result<(), String>> {
    session.hold(slave, state, None, timeout)?;
    Ok(state_of(session, slave, state))
}

fn state_of<W: Wire>(session: &Session<W>, slave: usize, wanted: AlState) -> Result<(), String> {
    let Some(slave) = session.master().slave(slave) else {
        return Err("it is offline".to_owned());
    };
    if let Some(fault) = slave.fault() {
        return Err(fault.to_string());
    }
    let (al, code) = slave.al();
    if al.state == wanted && !al.error {
        Ok(())
    } else {
        Err(format!("{wanted} wanted: {code}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ecat::tests::{tree, up};
    use takt_ethercat::AlStatusCode;

    #[test]
    fn state_request_reaches_one_slave_only() {
        let mut session = up(tree(), AlState::PreOp);
        for state in [AlState::SafeOp, AlState::Init, AlState::Op, AlState::PreOp] {
            let timeout = Duration::from_secs(10);
            let shown = request(&mut session, 1, state, timeout).unwrap();
            assert_eq!(shown, Ok(()), "{state}");
            let other = session.master().slave(2).unwrap().al().0.state;
            assert_eq!(other, AlState::PreOp, "{state}");
        }
    }

    #[test]
    fn state_refusal_names_the_code() {
        let mut session = up(tree(), AlState::PreOp);
        let timeout = Duration::from_secs(10);
        let boot = request(&mut session, 1, AlState::Boot, timeout).unwrap();
        let text = boot.unwrap_err();
        assert!(text.contains("(0013h)"), "{text}");
        let slave = session.wire().segment.slave(2).unwrap();
        slave.refuse(Some((AlState::SafeOp, AlStatusCode(0x001D))));
        let safe_op = request(&mut session, 1, AlState::SafeOp, timeout).unwrap();
        let text = safe_op.unwrap_err();
        assert!(text.contains("(001Dh)"), "{text}");
    }
}

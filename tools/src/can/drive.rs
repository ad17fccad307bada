//! `takt can drive`: one CiA 402 drive, enabled state by state over SDO, with the reason when it is not enabled, and
//! jogged. Start-up, monitor and shutdown are those of the drivers. It maps no PDO; nets do.

mod diagnosis;
mod facts;
mod observer;
mod session;
#[cfg(test)]
mod tests;
mod text;

use std::time::Duration;

use clap::Args;
use takt_can::canopen::NodeId;
use takt_cia402::{MasterOptions, Quirk};

use super::confirm;
use super::wire::Live;
use crate::Verdict;
use crate::output::{positive_span, say, span};
use facts::{CSP, MODES, PP, PV};
use session::{Jog, Plan, Session, Step};

/// Enable one drive, show its words as named bits, and report why it is not enabled.
///
/// Everything is sent by SDO, so nothing needs to be mapped. The drive is brought to Operation enabled, held there, and
/// switched off again as drivers do: at standstill, operation disabled before power is removed. It monitors the
/// heartbeat of this program (1016h), so that it stops by 6007h if that ends. A jog faster than 607Fh or 6080h allows is
/// rejected; a motor that runs away loses power at once. Ctrl-C brakes (quick stop). Exit status: 0 it was enabled and
/// switched off; 1 it was not, or it ended in a fault, with the reason; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt can drive can0 5 --watch
  takt can drive can0 5
  takt can drive can0 5 --axis 1 --reset --hold 5s
  takt can drive can0 5 --jog 1000 --duration 2s --yes
  takt can drive can0 5 --mode csp --jog 1000 --yes")]
pub(crate) struct Drive {
    /// The CAN interface.
    interface: String,
    /// The node, 1 to 127.
    #[arg(value_parser = super::node)]
    node: NodeId,
    /// The axis of a multi-axis drive, from 0.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..8))]
    axis: u8,
    /// Read only: show its words whenever they change, command nothing.
    #[arg(long, conflicts_with_all = ["jog", "mode", "reset"])]
    watch: bool,
    /// Mode of operation (6060h): pp, vl, pv, tq, hm, ip, csp, csv, cst, or its number.
    #[arg(long, value_name = "MODE", default_value = "pv", value_parser = mode, allow_hyphen_values = true)]
    mode: i8,
    /// Reset a fault first.
    #[arg(long)]
    reset: bool,
    /// How long to hold it in Operation enabled (or to watch it).
    #[arg(long, value_name = "TIME", value_parser = span)]
    hold: Option<Duration>,
    /// Turn it with this velocity, in the drive's velocity unit: by profile velocity (60FFh), or by --mode pp (one
    /// set-point with 6081h) or csp (smooth set-points of this largest speed over SDO and SYNC).
    #[arg(long, value_name = "VELOCITY", allow_hyphen_values = true)]
    jog: Option<i32>,
    /// How long to turn it.
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = positive_span, requires = "jog")]
    duration: Duration,
    /// Jog although the drive cannot monitor the heartbeat of this program.
    #[arg(long, requires = "jog")]
    unguarded: bool,
    /// A quirk of the drive: no_follow_bit, sod_as_0020 or mode_after_enable; may be repeated.
    #[arg(long = "quirk", value_name = "QUIRK")]
    quirks: Vec<Quirk>,
    /// Timeout of an SDO answer.
    #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = span)]
    timeout: Duration,
    /// Print one JSON object at the end.
    #[arg(long)]
    json: bool,
    /// It is safe that the machine moves; do not ask.
    #[arg(long = "yes", alias = "confirm-motion")]
    confirm_motion: bool,
}

fn mode(text: &str) -> Result<i8, String> {
    let named = MODES.iter().find(|(name, _)| *name == text);
    let number = named
        .map(|(_, number)| *number)
        .or_else(|| text.parse().ok());
    number.ok_or_else(|| {
        format!("`{text}` is no mode: write pp, vl, pv, tq, hm, ip, csp, csv, cst, or a number")
    })
}

/// How long a drive is held in Operation enabled by default.
const HOLD: Duration = Duration::from_secs(1);

impl Drive {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        anyhow::ensure!(
            self.jog.is_none() || [PP, PV, CSP].contains(&self.mode),
            "--jog turns by --mode pv, pp or csp only\nhint: omit --mode"
        );
        let mut wire = Live::open_to_stop(&self.interface)?;
        if !self.watch {
            let what = format!("enabling axis {} of node {}", self.axis, self.node);
            confirm::action(&self.interface, &what, self.confirm_motion)?;
        }
        let plan = Plan {
            node: self.node,
            axis: self.axis,
            mode: self.mode,
            reset: self.reset,
            hold: self.hold.unwrap_or(HOLD),
            jog: self.jog.map(|velocity| Jog {
                velocity,
                time: self.duration,
                unguarded: self.unguarded,
            }),
            timeout: self.timeout,
            profile: MasterOptions::default().with_quirks(&self.quirks),
        };
        let mut show = |step: &Step| match self.json {
            true => Ok(()),
            false => say(&text::step(step)),
        };
        let session = Session::new(&mut wire, plan, &mut show);
        let report = if self.watch {
            session.watch(self.hold)?
        } else {
            session.run()?
        };
        if self.json {
            say(&text::json(&report).to_string())?;
        } else {
            say(text::verdict(&report).trim_end())?;
        }
        Ok(match report.diagnosis {
            None => Verdict::Good,
            Some(_) => Verdict::Failed,
        })
    }
}

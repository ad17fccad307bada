//! `takt net`: check nets here, and load and control them in a running controller over its Unix socket or plain
//! TCP lines. Nothing here evaluates a net.

mod calibrate;
mod check;
mod dot;
mod life;
mod primitives;
pub(crate) mod server;
mod set;
mod stats;
mod tap;
mod text;
mod watch;

use clap::Subcommand;

use crate::Verdict;
use server::Server;
use text::{complain_of, read};

/// Check, load and control primitive nets.
#[derive(Debug, Subcommand)]
pub(crate) enum Net {
    /// Check a net without a controller: all faults, with their locations.
    Check(check::Check),
    /// Draw a net: an SVG on standard output, or DOT.
    Dot(dot::Dot),
    /// Measure what each primitive costs on this host.
    Calibrate(calibrate::Calibrate),
    /// Show which primitives there are, or what one of them does.
    Primitives(primitives::Primitives),
    /// Load a net and print its identifier.
    Load(life::Load),
    /// Start a net.
    Start(life::Target),
    /// Start a net in the cycle after another one.
    Schedule(life::Schedule),
    /// Request that a running net end.
    Cancel(life::Target),
    /// End a net at once; drivers brake what it moved.
    Abort(life::Target),
    /// Remove a net that does not run.
    Unload(life::Target),
    /// Write values that a net takes.
    Set(set::Set),
    /// Print the values of debug taps, each cycle.
    Tap(tap::Tap),
    /// Follow states and values of a net until it ends.
    Watch(watch::Watch),
    /// List the nets of a controller.
    List(watch::List),
    /// Show what the evaluation of nets costs: by declaration, and as it was measured.
    Stats(stats::Stats),
}

impl Net {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            Self::Check(check) => check.run(),
            Self::Dot(dot) => dot.run(),
            Self::Calibrate(calibrate) => calibrate.run(),
            Self::Primitives(primitives) => primitives.run(),
            Self::Load(load) => load.run(),
            Self::Start(target) => target.command("nest"),
            Self::Schedule(schedule) => schedule.run(),
            Self::Cancel(target) => target.command("neca"),
            Self::Abort(target) => target.command("neab"),
            Self::Unload(target) => target.command("neun"),
            Self::Set(set) => set.run(),
            Self::Tap(tap) => tap.run(),
            Self::Watch(watch) => watch.run(),
            Self::List(list) => list.run(),
            Self::Stats(stats) => stats.run(),
        }
    }
}

//! `takt net`: check nets here, and load and control them in a running controller over its Unix socket or plain
//! TCP lines. Nothing here evaluates a net.

mod calibrate;
mod check;
mod dot;
mod life;
mod primitives;
mod stats;
mod watch;

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::{Args, Subcommand};
use takt_net::Rejection;

use crate::client::Client;
use crate::output::complain;
use crate::{Verdict, token};

/// Check, load and control primitive nets.
#[derive(Debug, Subcommand)]
pub(crate) enum Net {
    /// Check a net without a controller: all faults, with their locations.
    Check(check::Check),
    /// Draw a net: an SVG on standard output.
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
            Self::Watch(watch) => watch.run(),
            Self::List(list) => list.run(),
            Self::Stats(stats) => stats.run(),
        }
    }
}

/// Maximum size of a net's text, bytes: more than a controller accepts in one message.
const NET_BYTES_MAX: u64 = 64 << 20;

/// Where the controller listens.
#[derive(Debug, Args)]
struct Server {
    /// Where the controller listens: an address, or the path of its Unix socket; else the Unix socket of this
    /// account or of the service, else 127.0.0.1:8081.
    #[arg(long, alias = "server", value_name = "HOST:PORT")]
    connect: Option<String>,
    /// File with the token that the controller asks for; else TAKT_TOKEN_FILE or TAKT_TOKEN.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

impl Server {
    fn connect(&self) -> anyhow::Result<Client> {
        let token = token::of_client(self.token_file.as_deref(), self.connect.as_deref())?;
        Client::connect(self.connect.as_deref(), token.as_ref())
    }
}

/// The text of a net, from a file or standard input.
fn read(file: &Path) -> anyhow::Result<String> {
    if file == Path::new("-") {
        let text = takt_core::files::text_of(std::io::stdin().lock(), NET_BYTES_MAX);
        return text.context("cannot read standard input");
    }
    takt_core::files::read_text(file, NET_BYTES_MAX)
        .with_context(|| format!("cannot read {}", file.display()))
}

/// Prints all faults of a net, with their locations.
fn complain_of(rejection: &Rejection, name: &str, text: &str) {
    complain(rejection.render(name, text).trim_end());
    let count = rejection.faults.len();
    let plural = if count == 1 { "" } else { "s" };
    complain(&format!("{name}: {count} fault{plural}"));
}

//! `takt scope`: values of a running controller over time, by name: live in the terminal, or into files. The controller samples
//! and finds triggers; nothing is commanded.

mod csv;
mod figures;
mod mcap;
mod names;
mod picture;
mod source;
mod store;
mod svg;
mod trigger;
mod view;
mod wire;
mod write;

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use crate::Verdict;
use crate::http::Site;
use crate::output::{check_writable, positive_span, say, span};
use crate::screen::Screen;
pub(crate) use picture::Picture;
pub(crate) use source::Source;
use trigger::Trigger;
pub(crate) use wire::{Event, Mode, Request};
#[cfg(feature = "fleet")]
pub(crate) use wire::{Frame, Group, Rejected};

/// How long the controller may take to answer.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Frames a second that are shown.
const LIVE_HZ: f64 = 20.0;
/// Frames a second that are written.
const WRITE_HZ: f64 = 10.0;

/// Show values of a running controller over time: set-points, measurements, forces, ports of nets, latencies.
///
/// On a terminal curves are drawn, a plot for each unit. Keys: q ends, Space pauses, + and - change the window, the arrows move a
/// cursor, ? explains. With --csv, --mcap, --svg or --json, or without a terminal, samples are written and figures are printed.
///
/// Exit status: 0 good; 1 a probe does not exist, or no trigger was found within --duration; 2 no controller answers, or the
/// connection was lost.
#[derive(Debug, Args)]
#[command(after_help = "Triggers:
  left.joint.6.commanded > 0.5       while the value is above
  rising left.force.z 10N            when it reaches the level from below; falling
  rising left.force.z 10N hysteresis 2N   after it was at most 8 N
  outside left.joint.0.error -0.1deg 0.1deg
  net:swing=RUNNING                  when a net or machine enters a state
  fault left, overrun nets           when a device faults, a thread misses cycles
  event left, event machine:cell     when a driver reports an event, a state changes

Examples:
  takt scope --list left
  takt scope --probe left.joint.3.commanded left.joint.3.measured
  takt scope --probe 'left.force.*' --trigger 'rising left.force.z 10N' --pre 0.2s --post 1s
  takt scope --probe 'left.joint.*.error' --duration 10s --csv error.csv --svg error.svg")]
pub(crate) struct Scope {
    /// Names of probes; * stands for any characters. Several may follow.
    #[arg(long, value_name = "NAME", num_args = 1.., required_unless_present = "list")]
    probe: Vec<String>,
    /// List the probes, or those whose names contain the text, with units and threads.
    #[arg(long, value_name = "TEXT", num_args = 0..=1, default_missing_value = "", conflicts_with = "probe")]
    list: Option<String>,
    /// What starts a capture; without it samples are shown as they come.
    #[arg(long, value_parser = trigger::parse, allow_hyphen_values = true)]
    trigger: Option<Trigger>,
    /// Time before the trigger, up to 60s.
    #[arg(long, value_name = "TIME", default_value = "0.5s", value_parser = span, requires = "trigger")]
    pre: Duration,
    /// Time after the trigger, up to 60s.
    #[arg(long, value_name = "TIME", default_value = "1.5s", value_parser = span, requires = "trigger")]
    post: Duration,
    /// What follows a capture; else auto on a terminal and single in files.
    #[arg(long, value_enum, requires = "trigger")]
    mode: Option<Mode>,
    /// Sample every n-th cycle, 1 to 1000000.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    every: u64,
    /// End after this time; else at q or Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    duration: Option<Duration>,
    /// Write the samples as CSV; - is standard output.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write the samples as a recording with messages of ROS 2, for PlotJuggler, Foxglove and Lichtblick.
    #[arg(long, value_name = "FILE")]
    mcap: Option<PathBuf>,
    /// Draw the samples, or the last capture: a plot for each unit, of the last two minutes at most.
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Print the figures as one JSON object; with --list the probes as one array.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    site: Site,
}

impl Scope {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        let http = self.site.client(TIMEOUT)?;
        if let Some(filter) = &self.list {
            return names::list(&http, filter, self.json);
        }
        for file in [&self.csv, &self.mcap, &self.svg].into_iter().flatten() {
            if file.as_os_str() != "-" {
                check_writable(file)?;
            }
        }
        let probes = match names::expanded(&http, &self.probe)? {
            Ok(probes) => probes,
            Err(cause) => {
                say(&cause)?;
                return Ok(Verdict::Failed);
            }
        };
        let is_plain = self.json || self.csv.is_some() || self.mcap.is_some() || self.svg.is_some();
        let screen = Screen::open(!is_plain);
        let mode = if screen.is_some() {
            Mode::Auto
        } else {
            Mode::Single
        };
        let request = Request {
            probes,
            every: self.every,
            trigger: self.trigger.clone(),
            pre_s: self.pre.as_secs_f64(),
            post_s: self.post.as_secs_f64(),
            mode: self.mode.unwrap_or(mode),
            rate_hz: if screen.is_some() { LIVE_HZ } else { WRITE_HZ },
        };
        let address = http.address().to_owned();
        match screen {
            Some(screen) => {
                let source = Source::start(http, request, true);
                view::show(screen, &address, self.duration, source)
            }
            None => write::write(&self, &address, http, request),
        }
    }
}

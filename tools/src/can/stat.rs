//! `takt can stat`: figures and findings of a bus, live or from a recording, with remedies. `takt_can::stat` computes
//! both.

mod text;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use takt_can::AnyFrame;
use takt_can::bits::Rates;
use takt_can::linux::{Interface, wall};
use takt_can::stat::{Finding, Limits, Meter, Report, Severity};

use super::bitrate;
use super::dbc::{Database, Ranges};
use super::feed::Feed;
use crate::Verdict;
use crate::output::{positive_span, say, share};
use crate::signal::Stop;

/// Measure a bus: load, rates and jitter, errors, heartbeats, losses; and report findings.
///
/// Exit status: 0 no failure found; 1 failures found; 2 it could not be tried. It only listens. Ctrl-C ends the
/// measurement early; the report covers the time until then.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt can stat can0
  takt can stat can0 --duration 1min --json
  takt can stat --from fault.log --bitrate 1M")]
pub(crate) struct Stat {
    /// The CAN interface.
    #[arg(required_unless_present = "from", conflicts_with = "from")]
    interface: Option<String>,
    /// Read a recording instead: candump log or text, ASC, BLF, TRC, pcap or pcapng.
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
    /// Only this interface or channel of the recording; default: that of the first frame.
    #[arg(long, value_name = "NAME", requires = "from")]
    channel: Option<String>,
    /// How long to listen.
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = positive_span, conflicts_with = "from")]
    duration: Duration,
    /// Bit rate for the load, if the interface does not report it: 500k, 1M, or bit/s.
    #[arg(long, value_name = "RATE", value_parser = bitrate)]
    bitrate: Option<u32>,
    /// Names messages, and shows the range of each signal, by this DBC file; may be given several times.
    #[arg(long, value_name = "FILE")]
    dbc: Vec<PathBuf>,
    /// Mean load that is a warning, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.6, value_parser = share)]
    load_warning: f64,
    /// Mean load that is a failure, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.9, value_parser = share)]
    load_failure: f64,
    /// Print one JSON object instead of the report.
    #[arg(long)]
    json: bool,
    /// Print the verdict only.
    #[arg(long, conflicts_with = "json")]
    quiet: bool,
}

/// Signals by DBC files.
struct Signals<'d> {
    database: &'d Database,
    ranges: Ranges<'d>,
}

impl Signals<'_> {
    fn handle(&mut self, frame: &AnyFrame) {
        self.ranges.handle(self.database, frame);
    }
}

/// Longest wait before the next check for the end.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

impl Stat {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let database = Database::open(&self.dbc)?;
        let mut signals = Signals {
            database: &database,
            ranges: Ranges::default(),
        };
        let (name, report) = match (&self.from, &self.interface) {
            (Some(file), _) => self.of_file(file, &mut signals)?,
            (None, Some(interface)) => (
                interface.clone(),
                self.of_interface(interface, &mut signals)?,
            ),
            (None, None) => anyhow::bail!("neither an interface nor a recording (--from) given"),
        };
        let limits = Limits {
            load_warning: self.load_warning,
            load_failure: self.load_failure,
            ..Limits::default()
        };
        let findings = report.findings(&limits);
        if self.json {
            say(&text::json(&name, &report, &findings, &signals).to_string())?;
        } else {
            if !self.quiet {
                say(&text::table(&name, &report, &signals))?;
            }
            for line in text::verdict(&name, &findings) {
                say(&line)?;
            }
        }
        let fails = |finding: &Finding| finding.severity() == Severity::Failure;
        Ok(if findings.iter().any(fails) {
            Verdict::Failed
        } else {
            Verdict::Good
        })
    }

    /// Reads one channel only: load and heartbeats of two buses must not be mixed.
    fn of_file(&self, file: &Path, signals: &mut Signals<'_>) -> anyhow::Result<(String, Report)> {
        let mut feed = Feed::open(&[], Some(file))?;
        let mut meter = Meter::new(self.bitrate.map(Rates::classic));
        let mut channel = self.channel.clone();
        while let Some(seen) = feed.next(POLL_INTERVAL)? {
            let channel = channel.get_or_insert_with(|| seen.interface.to_string());
            if **channel == *seen.interface {
                signals.handle(&seen.received.frame);
                meter.handle_frame(&seen.received);
            }
        }
        let report = meter.report();
        let channel = channel.unwrap_or_default();
        anyhow::ensure!(
            report.frames + report.errors.frames > 0,
            "{}: no frames of {channel}",
            file.display()
        );
        Ok((channel, report))
    }

    fn of_interface(&self, name: &str, signals: &mut Signals<'_>) -> anyhow::Result<Report> {
        let interface = Interface::open(name)?;
        let before = interface.details()?;
        let rates = self.bitrate.map(Rates::classic).or_else(|| before.rates());
        let mut feed = Feed::open(&[name.to_owned()], None)?;
        let stop = Stop::listen()?;
        let mut meter = Meter::new(rates);
        let until = Instant::now() + self.duration;
        meter.handle_time(wall());
        while Instant::now() < until && !stop.is_requested() {
            if let Some(seen) = feed.next(POLL_INTERVAL)? {
                signals.handle(&seen.received.frame);
                meter.handle_frame(&seen.received);
            }
        }
        let details = interface.details()?;
        meter.handle_time(wall());
        // A frame reports only the losses before it.
        meter.handle_dropped(feed.read_dropped());
        meter.handle_state(details.state, details.counters);
        // The counters cover all programs of this host. A counter that decreased was reset.
        let counted = |after: u64, before: u64| after.saturating_sub(before);
        meter.handle_refused(counted(details.send_dropped, before.send_dropped));
        meter.handle_lost(counted(details.receive_dropped, before.receive_dropped));
        Ok(meter.report())
    }
}

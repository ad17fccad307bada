//! `takt ecat dc`: the distributed clocks of a segment: the reference clock, the differences of the others from it, its
//! drift against the host's clock, and, with a cell whose slaves have SYNC0, the phase of the frames to SYNC0.

use std::fmt::Write as _;
use std::time::Duration;

use clap::Args;
use serde_json::{Value, json};
use takt_ethercat::AlState;
use takt_ethercat::dc::{PhaseFigures, Sample};
use takt_ethercat::master::{Master, SlaveView};

use super::controller::{self, Remote};
use super::difference::Range;
use super::finding::indented;
use super::session::{Session, Wire, phase_error};
use super::{Source, recording, scan};
use crate::Verdict;
use crate::output::{positive_span, say, span, time};

/// Watch the distributed clocks: reference, delays, differences, drift.
///
/// All slaves are brought to SAFE-OP, where outputs stay safe, and left in INIT. Exit status: 0 all clocks stay
/// within the window; 1 one does not, or there is none; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat dc enp2s0
  takt ecat dc enp2s0 --duration 1min --window 200ns --json
  takt ecat dc --controller localhost:8080    while the controller runs
  takt ecat dc --config /etc/takt/cell.toml
  takt ecat dc --from run.pcap

Differences are those of register 092Ch, positive where the slave is ahead of the reference.")]
pub(crate) struct Dc {
    #[command(flatten)]
    source: Source,
    #[command(flatten)]
    remote: Remote,
    /// How long to watch.
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = positive_span)]
    duration: Duration,
    /// Settling time of the clocks before the measurement.
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = span)]
    settle: Duration,
    /// Period of the frames; default: that of the cell, or else 1ms. A shorter period distributes the time more often.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    cycle: Option<Duration>,
    /// Largest difference that is no finding.
    #[arg(long, value_name = "TIME", default_value = "1us", value_parser = span)]
    window: Duration,
    /// Print one JSON object instead of the report.
    #[arg(long)]
    json: bool,
}

impl Dc {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        if self.remote.is_given() {
            let report = self.remote.report(self.source.interface.as_deref())?;
            let (findings, verdict) = controller::verdict(&report);
            let table = || format!("{}{findings}", controller::dc(&report));
            let shown = if self.json {
                report.to_string()
            } else {
                table()
            };
            say(shown.trim_end())?;
            return Ok(verdict);
        }
        if let Some(path) = &self.source.from {
            let read = recording::Recording::read(path)?;
            return recording::dc(&read, self.window).print(self.json, false);
        }
        let mut session = self.source.bring_up(AlState::SafeOp, self.cycle)?;
        session.run_for(self.settle)?;
        let watched = Watched::take(&mut session, self.duration)?;
        session.leave()?;
        let findings = watched.findings(session.master(), self.window);
        if self.json {
            say(&object(&session, &watched, &findings).to_string())?;
        } else {
            say(text(&session, &watched, &findings).trim_end())?;
        }
        Ok(if findings.is_empty() {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }
}

/// Figures of the clocks.
#[derive(Debug)]
pub(super) struct Watched {
    pub(super) duration: Duration,
    /// By slave; `None` where no difference was read.
    pub(super) ranges: Vec<Option<Range>>,
    /// Drift of the reference against the host, ppm, positive if the reference is faster; `None` with too few samples.
    pub(super) drift_ppm: Option<f64>,
    /// Distance of the frames from the middle between two SYNC0; empty without SYNC0.
    pub(super) phase: PhaseFigures,
}

impl Watched {
    /// Watches for a time.
    pub(super) fn take<W: Wire>(
        session: &mut Session<W>,
        duration: Duration,
    ) -> anyhow::Result<Self> {
        let mut ranges = vec![None; session.master().len()];
        let (mut first, mut last) = (None, None);
        let (mut phase, cycle) = (PhaseFigures::default(), session.master().config().cycle);
        let begin = session.now()?;
        while session.now()?.saturating_sub(begin) < duration {
            session.cycle()?;
            if let Some(sample) = session.sample() {
                first = first.or(Some(sample));
                last = Some(sample);
                if slaves(session.master()).any(|slave| slave.sync_start_ns().is_some()) {
                    phase.add(phase_error(&sample, cycle));
                }
            }
            for (number, range) in ranges.iter_mut().enumerate() {
                let slave = session.master().slave(number);
                if let Some(difference) = slave.and_then(|slave| slave.clock_difference_ns()) {
                    *range = Some(widened(*range, difference));
                }
            }
        }
        let drift_ppm = first.zip(last).and_then(|(first, last)| drift(first, last));
        Ok(Self {
            duration,
            ranges,
            drift_ppm,
            phase,
        })
    }

    /// Differences from the cell, faults, and clocks outside the window.
    pub(super) fn findings(&self, master: &Master, window: Duration) -> Vec<String> {
        let mut findings: Vec<String> = master
            .differences()
            .iter()
            .map(ToString::to_string)
            .collect();
        if master.reference().is_none() && findings.is_empty() {
            findings.push(
                "no slave has a distributed clock: SYNC0 is not available on this segment"
                    .to_owned(),
            );
        }
        for (number, range) in self.ranges.iter().enumerate() {
            let Some(slave) = master.slave(number) else {
                continue;
            };
            if let Some(fault) = slave.fault() {
                findings.push(format!("slave {number}: {fault}"));
            }
            let furthest = range.map_or(0, |range| {
                range.least.unsigned_abs().max(range.most.unsigned_abs())
            });
            if u128::from(furthest) > window.as_nanos() {
                findings.push(format!(
                    "slave {number}: its clock was up to {furthest} ns from the reference, {} ns are allowed\nhint: \
                     frames may be late or lost (`takt ecat stat`), or the cabling and its delay have changed",
                    window.as_nanos()
                ));
            }
        }
        findings
    }
}

fn widened(range: Option<Range>, difference: i32) -> Range {
    let Range { least, most, .. } = range.unwrap_or(Range {
        least: difference,
        most: difference,
        last: difference,
    });
    Range {
        least: least.min(difference),
        most: most.max(difference),
        last: difference,
    }
}

/// Drift between two samples, each at the middle between sending and receiving, ppm.
#[expect(
    clippy::cast_precision_loss,
    reason = "spans of minutes, shown with one digit"
)]
fn drift(first: Sample, last: Sample) -> Option<f64> {
    let middle = |sample: Sample| (sample.sent + sample.received) / 2;
    let host = middle(last).checked_sub(middle(first))?.as_nanos() as f64;
    let reference = last.system_ns.checked_sub(first.system_ns)? as f64;
    (host > 0.0).then(|| (reference - host) / host * 1e6)
}

fn slaves(master: &Master) -> impl Iterator<Item = SlaveView<'_>> {
    (0..master.len()).filter_map(|number| master.slave(number))
}

fn kind(master: &Master, slave: SlaveView<'_>) -> &'static str {
    let info = slave.info();
    if master.reference() == Some(slave.number()) {
        "reference"
    } else if info.has_clock() && info.clock_bits() == 64 {
        "64 bit"
    } else if info.has_clock() {
        "32 bit"
    } else if info.announces_clock() {
        "latch only"
    } else {
        "none"
    }
}

/// The report.
pub(super) fn text<W: Wire>(
    session: &Session<W>,
    watched: &Watched,
    findings: &[String],
) -> String {
    let master = session.master();
    let name = session.interface();
    let watched_for = i64::try_from(watched.duration.as_nanos()).unwrap_or(i64::MAX);
    let mut text = format!("{name}: {} slaves, {}\n", master.len(), time(watched_for));
    if let Some(ppm) = watched.drift_ppm {
        let _ = writeln!(
            text,
            "the reference runs {ppm:+.1} ppm against the host's clock"
        );
    }
    if let Some((least, most)) = watched.phase.range_ns() {
        let rms = watched.phase.rms_ns();
        let [least, most] = [least, most].map(time);
        let _ = writeln!(
            text,
            "frames pass {least} to {most} from the middle between two SYNC0, rms {rms:.0} ns"
        );
    }
    text.push_str(
        "\n slave                       clock      delay ns  difference ns: min      max     last\n",
    );
    for (slave, range) in slaves(master).zip(&watched.ranges) {
        let title: String = scan::title(slave).chars().take(20).collect();
        let number = slave.number();
        let _ = write!(
            text,
            "{number:>4}  {title:<20}  {:<9}  {:>8}",
            kind(master, slave),
            slave.delay_ns()
        );
        if let Some(range) = range {
            let Range { least, most, last } = range;
            let _ = write!(text, "  {least:>17} {most:>8} {last:>8}");
        }
        text.push('\n');
    }
    for finding in findings {
        let _ = writeln!(text, "FAIL  {}", indented(finding));
    }
    let _ = match findings.len() {
        0 => writeln!(text, "{name}: good"),
        count => writeln!(text, "{name}: {count} FAIL"),
    };
    text
}

/// The report as JSON.
pub(super) fn object<W: Wire>(
    session: &Session<W>,
    watched: &Watched,
    findings: &[String],
) -> Value {
    let master = session.master();
    let slaves: Vec<Value> = slaves(master)
        .zip(&watched.ranges)
        .map(|(slave, range)| {
            json!({
                "slave": slave.number(),
                "name": scan::title(slave),
                "clock": kind(master, slave),
                "delay_ns": slave.delay_ns(),
                "min_ns": range.map(|range| range.least),
                "max_ns": range.map(|range| range.most),
                "last_ns": range.map(|range| range.last),
            })
        })
        .collect();
    json!({
        "version": 1,
        "interface": session.interface(),
        "duration_ns": u64::try_from(watched.duration.as_nanos()).unwrap_or(u64::MAX),
        "reference": master.reference(),
        "drift_ppm": watched.drift_ppm,
        "phase": watched.phase.range_ns().map(|(least, most)| json!({
            "min_ns": least,
            "max_ns": most,
            "mean_ns": watched.phase.mean_ns(),
            "rms_ns": watched.phase.rms_ns(),
        })),
        "slaves": slaves,
        "findings": findings,
    })
}

//! `takt ecat stat`: frame losses of a segment, broken frames by port, and the cable to check. The findings follow from
//! the counters of the master and of the slaves' ports.

use std::fmt::Write as _;
use std::time::Duration;

use clap::{Args, ValueEnum};
use serde_json::{Value, json};
use takt_ethercat::AlState;
use takt_ethercat::master::{Cable, Event, Fault, FrameCounters, Master, PortCounters, SlaveView};

use super::controller::{self, Remote};
use super::finding::{Finding, nanos, percentiles, verdict, verdict_of};
use super::session::{Session, Wire};
use super::{Source, recording, scan};
use crate::output::{positive_span, say, time};
use crate::{Verdict, confirm};

/// Measure a segment: lost and late frames, working counters, errors by port; and report findings.
///
/// Exit status: 0 no failure found; 1 failures found; 2 it could not be tried. Counters of the slaves' ports count from
/// the start of the measurement; afterwards all slaves are left in INIT.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat stat enp2s0
  takt ecat stat enp2s0 --duration 1min --json
  takt ecat stat --controller localhost:8080    while the controller runs
  takt ecat stat --config /etc/takt/cell.toml --segment cell1
  takt ecat stat --from fault.pcap
  takt ecat stat enp2s0 --state op --yes    with working counters; all outputs are zero")]
pub(crate) struct Stat {
    #[command(flatten)]
    source: Source,
    #[command(flatten)]
    remote: Remote,
    /// How long to measure.
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = positive_span)]
    duration: Duration,
    /// Period of the frames; default: that of the cell, or else 1ms.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    cycle: Option<Duration>,
    /// State of the slaves during the measurement. Working counters of process data are known only in OP.
    #[arg(long, value_name = "STATE", default_value = "safe-op")]
    state: State,
    /// It is safe that a machine moves (OP).
    #[arg(long = "yes", alias = "confirm-motion")]
    confirm_motion: bool,
    /// Print one JSON object instead of the report.
    #[arg(long)]
    json: bool,
    /// Print the verdict only.
    #[arg(long, conflicts_with = "json")]
    quiet: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum State {
    /// Frames without process data.
    PreOp,
    /// Inputs are exchanged, slaves keep their outputs safe.
    SafeOp,
    /// Slaves apply their outputs, which are zero.
    Op,
}

impl Stat {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        if self.remote.is_given() {
            let report = self.remote.report(self.source.interface.as_deref())?;
            let (findings, verdict) = controller::verdict(&report);
            let table = || format!("{}{findings}", controller::stat(&report));
            let shown = if self.json {
                report.to_string()
            } else {
                table()
            };
            say(shown.trim_end())?;
            return Ok(verdict);
        }
        if let Some(path) = &self.source.from {
            let report = recording::stat(&recording::Recording::read(path)?);
            return report.print(self.json, self.quiet);
        }
        let goal = match self.state {
            State::PreOp => AlState::PreOp,
            State::SafeOp => AlState::SafeOp,
            State::Op => {
                confirm::motion("OP with all outputs zero", self.confirm_motion)?;
                AlState::Op
            }
        };
        let mut session = self.source.bring_up(goal, self.cycle)?;
        let measured = Measured::take(&mut session, self.duration)?;
        session.leave()?;
        let findings = measured.findings(session.master());
        if self.json {
            say(&object(&session, &measured, &findings).to_string())?;
        } else {
            if !self.quiet {
                say(table(&session, &measured).trim_end())?;
            }
            say(verdict(session.interface(), &findings).trim_end())?;
        }
        Ok(verdict_of(&findings))
    }
}

/// Figures of a measurement.
#[derive(Debug)]
pub(super) struct Measured {
    duration: Duration,
    frames: FrameCounters,
    /// Cycles with an unexpected working counter, by group.
    misses: Vec<u64>,
    /// Round trip times: median, 99th percentile, maximum; `None` if no frame returned.
    round_trip: Option<[Duration; 3]>,
    cables: Vec<String>,
    /// Faults of slaves that were over before the end, with their times.
    past: Vec<String>,
}

impl Measured {
    /// Measures for `duration`.
    pub(super) fn take<W: Wire>(
        session: &mut Session<W>,
        duration: Duration,
    ) -> anyhow::Result<Self> {
        read_counters(session)?;
        session.forget();
        let begin = session.now()?;
        let (before, misses) = (session.master().frames(), misses(session.master()));
        session.run_for(duration)?;
        let (after, round_trip) = (
            session.master().frames(),
            percentiles(session.round_trips()),
        );
        let since = |after: u64, before: u64| after.saturating_sub(before);
        let frames = FrameCounters {
            sent: since(after.sent, before.sent),
            answered: since(after.answered, before.answered),
            lost: since(after.lost, before.lost),
            stale: since(after.stale, before.stale),
            foreign: since(after.foreign, before.foreign),
        };
        let misses = self::misses(session.master())
            .into_iter()
            .zip(misses)
            .map(|(after, before)| since(after, before))
            .collect();
        read_counters(session)?;
        Ok(Self {
            duration,
            frames,
            misses,
            round_trip,
            cables: cut_cables(session),
            past: past_faults(session.events(), begin),
        })
    }

    /// Frames that never returned.
    const fn lost(&self) -> u64 {
        self.frames.lost.saturating_sub(self.frames.stale)
    }

    /// The findings, the worst first.
    pub(super) fn findings(&self, master: &Master) -> Vec<Finding> {
        let differences = master.differences().iter();
        let mut all: Vec<Finding> = differences
            .map(|d| Finding::Failure(d.to_string()))
            .collect();
        all.extend(self.cables.iter().cloned().map(Finding::Cut));
        let gap = master.ring_gap().map(|cable| Event::RingOpen { cable });
        let gap = gap.map(|event| event.to_string());
        all.extend(
            gap.filter(|gap| !self.cables.contains(gap))
                .map(Finding::Cut),
        );
        all.extend(master.suspects().into_iter().map(Finding::Suspect));
        all.extend(self.past.iter().cloned().map(Finding::Failure));
        for slave in slaves(master) {
            let number = slave.number();
            all.extend(slave.fault().map(|fault| Finding::Slave(number, fault)));
            let errors = slave.counters().controller;
            if errors > 0 {
                all.push(Finding::Controller(number, errors));
            }
        }
        let (lost, sent) = (self.lost(), self.frames.sent);
        let broken = all
            .iter()
            .any(|finding| matches!(finding, Finding::Cut(_) | Finding::Suspect(_)));
        if lost > 0 {
            all.push(Finding::Lost { lost, sent, broken });
        }
        let misses = self.misses.iter().sum();
        if misses > self.frames.lost {
            all.push(Finding::Misses(misses));
        }
        if self.frames.stale > 0 {
            all.push(Finding::Late(self.frames.stale));
        }
        if self.frames.foreign > 0 {
            all.push(Finding::Foreign(self.frames.foreign));
        }
        all
    }
}

/// Runs cycles until the master has read the counters of each slave: earlier errors must not count, the latest ones
/// must. It reads the counters of a slave at least every 16 cycles.
fn read_counters<W: Wire>(session: &mut Session<W>) -> anyhow::Result<()> {
    let cycles = 16 * (session.master().len() + 4);
    for _ in 0..cycles {
        session.cycle()?;
    }
    Ok(())
}

fn slaves(master: &Master) -> impl Iterator<Item = SlaveView<'_>> {
    (0..master.len()).filter_map(|number| master.slave(number))
}

fn misses(master: &Master) -> Vec<u64> {
    master.groups().iter().map(|group| group.misses).collect()
}

/// Cables that were cut during the measurement, each once. If the slave behind a cable is present and no port lost its
/// link, frames were lost but the cable was not cut.
fn cut_cables<W: Wire>(session: &Session<W>) -> Vec<String> {
    let mut cuts = Vec::new();
    for (_, event) in session.events() {
        let (Event::CableCut { cable } | Event::RingOpen { cable }) = event else {
            continue;
        };
        let text = event.to_string();
        if lost_link(session.master(), *cable) && !cuts.contains(&text) {
            cuts.push(text);
        }
    }
    cuts
}

/// Faults of slaves that began and ended in these events, with their times since `begin`.
pub(super) fn past_faults(events: &[(Duration, Event)], begin: Duration) -> Vec<String> {
    let mut open: Vec<(Duration, usize, Fault)> = Vec::new();
    let mut past = Vec::new();
    let since = |at: Duration| at.saturating_sub(begin).as_secs_f64();
    for (at, event) in events {
        if let Event::Fault { slave, fault } = event {
            open.push((*at, *slave, *fault));
        }
        let Event::Reached { slave, .. } = event else {
            continue;
        };
        let ended = open.iter().filter(|(_, it, _)| it == slave);
        past.extend(ended.map(|(from, slave, fault)| {
            let (from, to) = (since(*from), since(*at));
            format!("slave {slave} from {from:.3} s to {to:.3} s: {fault}")
        }));
        open.retain(|(_, it, _)| it != slave);
    }
    past
}

/// Whether a port at an end of a cable lost its link, or the slave behind it is offline.
fn lost_link(master: &Master, cable: Cable) -> bool {
    let links = |slave: SlaveView<'_>, port: usize| at_port(slave.counters(), port)[3] > 0;
    let far = cable.to.and_then(|to| master.slave(to));
    let near = cable
        .from
        .and_then(|(from, port)| Some((master.slave(from)?, port)));
    far.is_none_or(|slave| slave.position().is_none() || links(slave, 0))
        || near.is_some_and(|(slave, port)| links(slave, port.into()))
}

/// Everything but the verdict.
pub(super) fn table<W: Wire>(session: &Session<W>, measured: &Measured) -> String {
    let master = session.master();
    let frames = measured.frames;
    let mut text = format!(
        "{}: {} slaves, {} at a cycle of {}\nframes      {} sent, {} lost, {} late, {} foreign\n",
        session.interface(),
        master.len(),
        time(nanos(measured.duration)),
        time(nanos(master.config().cycle)),
        frames.sent,
        measured.lost(),
        frames.stale,
        frames.foreign,
    );
    if let Some([p50, p99, most]) = measured.round_trip {
        let [p50, p99, most] = [p50, p99, most].map(|trip| time(nanos(trip)));
        let _ = writeln!(text, "round trip  p50 {p50}, p99 {p99}, max {most}");
    }
    if master.config().goal == AlState::Op {
        let misses: u64 = measured.misses.iter().sum();
        let _ = writeln!(
            text,
            "counters    {misses} cycles with an unexpected working counter"
        );
    }
    text.push_str(
        "\n slave                      state        port  invalid  receive  forwarded  lost links\n",
    );
    for slave in slaves(master) {
        ports(&mut text, slave);
    }
    text
}

/// One line for each port in use, or with errors.
fn ports(text: &mut String, slave: SlaveView<'_>) {
    let counters = slave.counters();
    let name: String = scan::title(slave).chars().take(20).collect();
    let state = scan::state(slave);
    let mut head = format!("{:>4}  {name:<20}  {state:<11}", slave.number());
    for (port, seen) in slave.info().ports().iter().enumerate() {
        let [invalid, receive, forwarded, links] = at_port(counters, port);
        let errors = invalid + receive + forwarded + links;
        if !seen.open && errors == 0 {
            continue;
        }
        let _ = writeln!(
            text,
            "{head:<39} {port:>5} {invalid:>8} {receive:>8} {forwarded:>10} {links:>11}"
        );
        head.clear();
    }
}

fn at_port(counters: &PortCounters, port: usize) -> [u64; 4] {
    [
        counters.invalid,
        counters.receive,
        counters.forwarded,
        counters.lost_links,
    ]
    .map(|counts| counts.get(port).copied().unwrap_or(0))
}

/// The report as JSON.
pub(super) fn object<W: Wire>(
    session: &Session<W>,
    measured: &Measured,
    findings: &[Finding],
) -> Value {
    let master = session.master();
    let frames = measured.frames;
    let slaves: Vec<Value> = slaves(master).map(slave_object).collect();
    let findings: Vec<Value> = findings.iter().map(Finding::object).collect();
    let trip = measured.round_trip.map(|trips| {
        let [p50, p99, most] = trips.map(nanos);
        json!({ "p50_ns": p50, "p99_ns": p99, "max_ns": most })
    });
    json!({
        "version": 1,
        "interface": session.interface(),
        "duration_ns": nanos(measured.duration),
        "cycle_ns": nanos(master.config().cycle),
        "frames": {
            "sent": frames.sent,
            "answered": frames.answered,
            "lost": measured.lost(),
            "late": frames.stale,
            "foreign": frames.foreign,
        },
        "round_trip": trip,
        "working_counter_misses": measured.misses.iter().sum::<u64>(),
        "slaves": slaves,
        "findings": findings,
    })
}

fn slave_object(slave: SlaveView<'_>) -> Value {
    let counters = slave.counters();
    let (unexpected, repeated) = slave.mailbox_counters();
    json!({
        "slave": slave.number(),
        "name": scan::title(slave),
        "state": slave.al().0.to_string(),
        "fault": slave.fault().map(|fault| fault.to_string()),
        "invalid": counters.invalid,
        "receive": counters.receive,
        "forwarded": counters.forwarded,
        "lost_links": counters.lost_links,
        "processing": counters.processing,
        "controller": counters.controller,
        "mailbox_unexpected": unexpected,
        "mailbox_repeated": repeated,
    })
}

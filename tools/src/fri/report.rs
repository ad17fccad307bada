//! Figures and verdict of a live or recorded connection, as text and JSON. The verdict is that of
//! `takt_fri::diagnosis`.

use std::time::Duration;

use serde_json::{Value, json};
use takt_fri::capture::time_of_day;
use takt_fri::client::Status;
use takt_fri::diagnosis::{Change, Observed, Timeline, Verdict, judge};
use takt_rt::Nanos;
use takt_rt::stats::Summary;

use super::live::{Live, Seen};
use super::watch;
use crate::output::time;

/// Changes of a timeline that are printed; JSON has all.
const CHANGES_SHOWN: usize = 40;

/// A connection.
pub(super) struct Connection {
    pub(super) controller: String,
    pub(super) host: String,
    pub(super) generation: String,
    pub(super) observed: Observed,
    /// Figures that only the client has.
    pub(super) live: Option<Answered>,
    /// What the controller reported, of a recording.
    pub(super) timeline: Option<Timeline>,
}

/// A connection whose client is this process.
pub(super) struct Answered {
    status: Status,
    /// From the arrival of a measurement to the departure of its answer.
    latency: Summary,
    /// From the arrival of a measurement to the wake-up of this process: what this host adds.
    wake_up: Summary,
    /// Faults other than of timing.
    faults: Vec<String>,
}

fn us(span: Duration) -> f64 {
    span.as_secs_f64() * 1e6
}

#[expect(clippy::cast_precision_loss, reason = "nanoseconds of a moment")]
fn us_of(time: Nanos) -> f64 {
    time.0 as f64 * 1e-3
}

impl Connection {
    /// A connection of this process, up to now.
    pub(super) fn of_live(seen: &Seen, live: &Live) -> Self {
        let status = seen.status;
        let text = |it: Option<String>| it.unwrap_or_else(|| "?".to_owned());
        let mut faults = watch::faults(seen);
        if status.counters.silences > 0 {
            faults.push(format!(
                "the controller fell silent {} times\nhint: was FRI closed, or is the cable loose?",
                status.counters.silences
            ));
        }
        Self {
            controller: text(seen.peer.map(|it| it.to_string())),
            host: live.local.to_string(),
            generation: text(status.version.map(|it| it.to_string())),
            observed: seen.observed,
            live: Some(Answered {
                status,
                latency: live.answer_time.read().summary(),
                wake_up: live.wake_up.read().summary(),
                faults,
            }),
            timeline: None,
        }
    }

    /// Faults other than of timing.
    fn faults(&self) -> &[String] {
        self.live.as_ref().map_or(&[], |live| &live.faults)
    }

    pub(super) fn verdict(&self) -> Verdict {
        judge(&self.observed)
    }

    pub(super) fn is_good(&self) -> bool {
        self.verdict().is_good() && self.faults().is_empty()
    }

    /// Figures unless `is_quiet`, and the verdict with the remedy.
    pub(super) fn lines(&self, is_quiet: bool) -> Vec<String> {
        let mut lines = if is_quiet { Vec::new() } else { self.figures() };
        let Self {
            controller, host, ..
        } = self;
        let verdict = self.verdict();
        for fault in self.faults() {
            lines.push(format!("{controller} > {host}: {fault}"));
        }
        if !verdict.is_good() || self.faults().is_empty() {
            lines.push(format!("{controller} > {host}: {verdict}"));
        }
        if !verdict.is_good() {
            lines.push(format!("  {}", verdict.remedy()));
        }
        lines
    }

    fn figures(&self) -> Vec<String> {
        let seen = &self.observed;
        let stamps = seen.stamp_jitter;
        let stamps = stamps.map_or_else(|| "unknown".to_owned(), |it| format!("{it:.1?}"));
        let rate = seen.answer_rate;
        let rate = rate.map_or_else(|| "not reported".to_owned(), |it| format!("{it:.3}"));
        let mut lines = vec![
            format!(
                "{} from {} to {}, period {:?}",
                self.generation, self.controller, self.host, seen.period
            ),
            format!(
                "  measurements  {}, lost {}, out of order {}, restarts {}",
                seen.measurements, seen.lost, seen.disordered, seen.restarts
            ),
            format!(
                "  answers       {}, late {}, the worst after {:.1?}; in time as the controller counts: {rate}",
                seen.answers, seen.late, seen.answer_time_max
            ),
            format!(
                "  without one   {} left unanswered, {} overtaken by the next within half a period",
                seen.unanswered, seen.overtaken
            ),
            format!(
                "  network       jitter {:.1?} on arrival, {stamps} by the controller's stamps",
                seen.arrival_jitter
            ),
        ];
        if seen.behind_max > 0 {
            let behind = seen.behind_max;
            lines.push(format!(
                "  behind        an answer was {behind} measurements behind the newest"
            ));
        }
        lines.extend(self.live.iter().flat_map(Answered::figures));
        lines.extend(self.timeline.iter().flat_map(changes));
        lines
    }

    pub(super) fn json(&self) -> Value {
        let seen = &self.observed;
        let verdict = self.verdict();
        let live = self.live.as_ref();
        json!({
            "controller": self.controller,
            "host": self.host,
            "generation": self.generation,
            "period_us": us(seen.period),
            "measurements": seen.measurements,
            "lost": seen.lost,
            "disordered": seen.disordered,
            "restarts": seen.restarts,
            "answers": seen.answers,
            "late": seen.late,
            "unanswered": seen.unanswered,
            "overtaken": seen.overtaken,
            "behind_max": seen.behind_max,
            "heard": seen.acknowledged,
            "strange": seen.foreign,
            "answer_time_max_us": us(seen.answer_time_max),
            "wake_up_us": live.map(|live| quantiles(&live.wake_up)),
            "arrival_jitter_us": us(seen.arrival_jitter),
            "stamp_jitter_us": seen.stamp_jitter.map(us),
            "answer_rate": seen.answer_rate,
            "latency_us": live.map(|live| quantiles(&live.latency)),
            "state": live.and_then(|live| live.status.state).map(|it| it.to_string()),
            "quality": live.and_then(|live| live.status.quality).map(|it| it.to_string()),
            "timeline": self.timeline.as_ref().map(timeline_json),
            "faults": self.faults(),
            "good": self.is_good(),
            "verdict": verdict.to_string(),
            "remedy": verdict.remedy(),
        })
    }
}

/// The changes of a timeline, each in a line.
fn changes(timeline: &Timeline) -> Vec<String> {
    let all = timeline.changes();
    let shown = all.iter().take(CHANGES_SHOWN);
    let line = |change: &Change| format!("  {} {change}", time_of_day(change.at));
    let mut lines: Vec<_> = shown.map(line).collect();
    let rest = all.len().saturating_sub(CHANGES_SHOWN);
    let omitted = u64::try_from(rest).unwrap_or(u64::MAX) + timeline.omitted();
    if omitted > 0 {
        lines.push(format!("  and {omitted} more changes"));
    }
    lines
}

fn timeline_json(timeline: &Timeline) -> Value {
    let changes = timeline.changes().iter().map(|change| {
        json!({
            "at_s": change.at.as_secs_f64(),
            "state": change.state.to_string(),
            "quality": change.quality.to_string(),
            "power": change.has_power,
            "reason": change.reason(),
        })
    });
    changes.collect()
}

fn quantiles(times: &Summary) -> Value {
    json!({
        "p50": us_of(times.p50),
        "p99": us_of(times.p99),
        "p999": us_of(times.p999),
        "max": us_of(times.max),
    })
}

impl Answered {
    fn figures(&self) -> Vec<String> {
        let times = |of: &Summary| {
            let [p50, p99, p999, max] = [of.p50, of.p99, of.p999, of.max].map(|it| time(it.0));
            format!("p50 {p50}, p99 {p99}, p99.9 {p999}, max {max}")
        };
        let mut lines = vec![
            format!(
                "  latency       {} from arrival to answer",
                times(&self.latency)
            ),
            format!(
                "  host          {} of it until this process woke up",
                times(&self.wake_up)
            ),
        ];
        let text = |it: Option<String>| it.unwrap_or_else(|| "?".to_owned());
        let mut line = format!(
            "  controller    {}, quality {}",
            text(self.status.state.map(|it| it.to_string())),
            text(self.status.quality.map(|it| it.to_string()))
        );
        if let Some(it) = self.status.statistics {
            let (latency, jitter) = (it.latency_s * 1e3, it.jitter_s * 1e3);
            line += &format!(
                "; it counts latency {latency:.2} ms, jitter {jitter:.2} ms, missed {}",
                it.missed
            );
        }
        lines.push(line);
        lines
    }
}

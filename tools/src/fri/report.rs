//! Figures and verdict of a live or recorded connection, as text and JSON. The verdict is that of
//! `takt_fri::diagnosis`.

use std::time::Duration;

use serde_json::{Value, json};
use takt_fri::client::Status;
use takt_fri::diagnosis::{Observed, Verdict, judge};
use takt_rt::Nanos;
use takt_rt::stats::Summary;

use super::live::{Live, Seen};
use super::watch;
use crate::output::time;

/// A connection.
pub(super) struct Connection {
    pub(super) controller: String,
    pub(super) host: String,
    pub(super) generation: String,
    pub(super) observed: Observed,
    /// Figures that only the client has.
    pub(super) live: Option<Answered>,
}

/// A connection whose client is this process.
pub(super) struct Answered {
    status: Status,
    /// From the arrival of a measurement to the departure of its answer.
    latency: Summary,
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
                faults,
            }),
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
                "  jitter        {:.1?} on arrival, {stamps} by the controller's stamps",
                seen.arrival_jitter
            ),
        ];
        lines.extend(self.live.iter().flat_map(Answered::figures));
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
            "heard": seen.acknowledged,
            "strange": seen.foreign,
            "answer_time_max_us": us(seen.answer_time_max),
            "arrival_jitter_us": us(seen.arrival_jitter),
            "stamp_jitter_us": seen.stamp_jitter.map(us),
            "answer_rate": seen.answer_rate,
            "latency_us": live.map(|live| quantiles(&live.latency)),
            "state": live.and_then(|live| live.status.state).map(|it| it.to_string()),
            "quality": live.and_then(|live| live.status.quality).map(|it| it.to_string()),
            "faults": self.faults(),
            "good": self.is_good(),
            "verdict": verdict.to_string(),
            "remedy": verdict.remedy(),
        })
    }
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
        let Summary {
            p50,
            p99,
            p999,
            max,
            ..
        } = self.latency;
        let [p50, p99, p999, max] = [p50, p99, p999, max].map(|it| time(it.0));
        let mut lines = vec![format!(
            "  latency       p50 {p50}, p99 {p99}, p99.9 {p999}, max {max} from measurement to answer"
        )];
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

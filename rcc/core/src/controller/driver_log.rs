//! Events of drivers for the log and for programs: taken under the registry's lock, written after its release, and
//! limited in rate per driver. Drivers define their meaning.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use takt_rt::Nanos;

use crate::device::driver::{DriverEvent, Severity};

/// Maximum number of lines per driver and [`SPAN`]; further lines are only counted.
const LINES: u32 = 50;
const SPAN: Duration = Duration::from_secs(1);

/// Writes what a driver reports to the log.
pub(super) fn report(driver: &str, event: &DriverEvent) {
    let text = &event.text;
    match event.severity {
        Severity::Info => tracing::info!(driver, "{text}"),
        Severity::Warning => tracing::warn!(driver, "{text}"),
        Severity::Error => tracing::error!(driver, "{text}"),
    }
}

/// Maximum number of reports kept per driver or device; the oldest information is dropped first, then the oldest report.
const REPORTS_KEPT: usize = 8;

/// An event of a driver as programs see it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DriverReport {
    /// The event.
    pub event: DriverEvent,
    /// When it was reported last, on `CLOCK_MONOTONIC`.
    pub at: Nanos,
    /// How often it was reported in a row.
    pub times: u64,
}

/// How many events of each severity a driver or a device had, in the order of [`Severity::ALL`].
pub type EventCounts = [u64; 3];

/// The last events by driver or device, and their numbers.
#[derive(Debug, Default)]
pub(super) struct DriverReports(BTreeMap<String, (EventCounts, VecDeque<DriverReport>)>);

impl DriverReports {
    /// Keeps an event that was reported at that time.
    pub(super) fn note(&mut self, name: &str, event: &DriverEvent, at: Nanos) {
        let (counts, reports) = self.0.entry(name.to_owned()).or_default();
        for (severity, count) in Severity::ALL.iter().zip(counts) {
            *count += u64::from(*severity == event.severity);
        }
        if let Some(last) = reports.back_mut().filter(|last| last.event == *event) {
            (last.at, last.times) = (at, last.times + 1);
            return;
        }
        reports.push_back(DriverReport {
            event: event.clone(),
            at,
            times: 1,
        });
        if reports.len() > REPORTS_KEPT {
            // A fault stays readable behind what its recovery reports.
            let is_info = |it: &DriverReport| it.event.severity == Severity::Info;
            let mut older = reports.iter().take(REPORTS_KEPT);
            let dropped = older.position(is_info).unwrap_or(0);
            reports.remove(dropped);
        }
    }

    /// Forgets drivers and devices that were removed.
    pub(super) fn retain(&mut self, is_known: impl Fn(&str) -> bool) {
        self.0.retain(|name, _| is_known(name));
    }

    /// The last events of a driver or device, oldest first.
    pub(super) fn of(&self, name: &str) -> impl Iterator<Item = &DriverReport> {
        self.0
            .get(name)
            .into_iter()
            .flat_map(|(_, reports)| reports)
    }

    /// The number of events by driver or device.
    pub(super) fn counts(&self) -> BTreeMap<String, EventCounts> {
        let counts = self.0.iter();
        counts
            .map(|(name, (counts, _))| (name.clone(), *counts))
            .collect()
    }
}

/// Lines of a driver in the present span.
#[derive(Debug)]
struct Reported {
    since: Instant,
    lines: u32,
}

/// Rate limits of drivers' log lines, by driver name.
#[derive(Debug, Default)]
pub(super) struct DriverLog(BTreeMap<String, Reported>);

impl DriverLog {
    /// Takes the events of a driver; returns the lines for the log.
    pub(super) fn take(
        &mut self,
        driver: &str,
        events: impl Iterator<Item = DriverEvent>,
        now: Instant,
    ) -> Vec<DriverEvent> {
        let mut lines = Vec::new();
        if let Some(reported) = self.0.get(driver)
            && now.saturating_duration_since(reported.since) >= SPAN
        {
            if reported.lines > LINES {
                let left_out = reported.lines - LINES;
                lines.push(DriverEvent::warning(format!(
                    "{left_out} more lines were omitted"
                )));
            }
            self.0.remove(driver);
        }
        for line in events {
            let reported = self.0.entry(driver.to_owned());
            let reported = reported.or_insert(Reported {
                since: now,
                lines: 0,
            });
            reported.lines = reported.lines.saturating_add(1);
            if reported.lines <= LINES {
                lines.push(line);
            }
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn driver_reports_count_and_keep_last_events() {
        let mut reports = DriverReports::default();
        let silent = DriverEvent::error("no datagram arrives".into()).with_hint("check the cable");
        assert_eq!(silent.cause(), "no datagram arrives");
        assert_eq!(silent.hint(), Some("check the cable"));
        for ms in 0..100 {
            reports.note(
                "left",
                &DriverEvent::warning(ms.to_string()),
                Nanos::from_millis(ms),
            );
        }
        reports.note("left", &silent, Nanos::from_millis(200));
        reports.note("left", &silent, Nanos::from_millis(300));
        assert_eq!(reports.of("left").count(), REPORTS_KEPT);
        let last = reports.of("left").last().unwrap();
        assert_eq!((last.times, last.at), (2, Nanos::from_millis(300)));
        assert_eq!(reports.counts()["left"], [0, 100, 2]);
        reports.retain(|name| name == "right");
        assert!(reports.counts().is_empty());
    }

    #[test]
    fn driver_report_of_fault_stays_behind_its_recovery() {
        let mut reports = DriverReports::default();
        let mut note = |event| reports.note("arm", &event, Nanos(0));
        note(DriverEvent::info("slave 0: OP".into()));
        note(DriverEvent::error("slave 0 left OP".into()));
        (1..20).for_each(|n| note(DriverEvent::info(format!("slave {n}: OP"))));
        let kept: Vec<_> = reports.of("arm").map(|it| &it.event.text).collect();
        assert_eq!(kept.len(), REPORTS_KEPT);
        assert_eq!(
            (&kept[0][..], &kept[7][..]),
            ("slave 0 left OP", "slave 19: OP")
        );
    }

    #[test]
    fn driver_log_keeps_first_lines_and_counts_rest() {
        let mut log = DriverLog::default();
        let begin = Instant::now();
        let mut take = |count: u32, after: Duration| {
            let lines = (0..count).map(|n| DriverEvent::info(n.to_string()));
            let taken = log.take("bus", lines, begin + after).into_iter();
            taken.map(|event| event.text).collect::<Vec<_>>()
        };
        assert_eq!(take(2, Duration::ZERO), ["0", "1"]);
        assert_eq!(take(60, SPAN / 2).len(), 48);
        assert!(take(9, SPAN * 9 / 10).is_empty());
        assert_eq!(take(1, SPAN), ["21 more lines were omitted", "0"]);
        assert_eq!(take(0, SPAN * 3), [""; 0]);
    }
}

//! Events of drivers for the log: taken under the registry's lock, written after its release, and limited in
//! rate per driver. Drivers define their meaning.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

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

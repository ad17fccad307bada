//! What drivers tell, on its way to the log: taken under the desk's lock, to be written behind it, and at most so
//! much as people can read. What it means is the drivers' business.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::device::driver::{Notice, Severity};

/// Lines that a driver may tell in each [`SPAN`]; of the rest only the number is told.
const LINES: u32 = 50;
const SPAN: Duration = Duration::from_secs(1);

/// Writes what a driver reports to the log.
pub(super) fn report(driver: &str, notice: &Notice) {
    let text = &notice.text;
    match notice.severity {
        Severity::Info => tracing::info!(driver, "{text}"),
        Severity::Warning => tracing::warn!(driver, "{text}"),
        Severity::Error => tracing::error!(driver, "{text}"),
    }
}

/// How much a driver has told.
#[derive(Debug)]
struct Told {
    since: Instant,
    lines: u32,
}

/// How much drivers have told of late, by their names.
#[derive(Debug, Default)]
pub(super) struct News(BTreeMap<String, Told>);

impl News {
    /// Takes what a driver has to tell; returns the lines for the log.
    pub(super) fn take(
        &mut self,
        driver: &str,
        news: impl Iterator<Item = Notice>,
        now: Instant,
    ) -> Vec<Notice> {
        let mut lines = Vec::new();
        if let Some(told) = self.0.get(driver)
            && now.saturating_duration_since(told.since) >= SPAN
        {
            if told.lines > LINES {
                let left_out = told.lines - LINES;
                lines.push(Notice::warning(format!(
                    "{left_out} more lines were left out"
                )));
            }
            self.0.remove(driver);
        }
        for line in news {
            let told = self.0.entry(driver.to_owned());
            let told = told.or_insert(Told {
                since: now,
                lines: 0,
            });
            told.lines = told.lines.saturating_add(1);
            if told.lines <= LINES {
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
    fn of_much_news_the_first_lines_and_the_number_of_the_others_are_told() {
        let mut news = News::default();
        let begin = Instant::now();
        let mut take = |count: u32, after: Duration| {
            let lines = (0..count).map(|n| Notice::info(n.to_string()));
            let taken = news.take("bus", lines, begin + after).into_iter();
            taken.map(|notice| notice.text).collect::<Vec<_>>()
        };
        assert_eq!(take(2, Duration::ZERO), ["0", "1"]);
        assert_eq!(take(60, SPAN / 2).len(), 48);
        assert!(take(9, SPAN * 9 / 10).is_empty());
        assert_eq!(take(1, SPAN), ["21 more lines were left out", "0"]);
        assert_eq!(take(0, SPAN * 3), [""; 0]);
    }
}

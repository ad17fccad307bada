//! Rows as text within 80 columns, and as JSON. It knows no condition by name.

use serde::Serialize;

use super::condition::{Remedy, Status};
use super::examine::Row;
use crate::output::wrapped;

const WIDTH: usize = 80;
/// Where the text under a condition begins, after two blanks, four letters of the status and two more.
const NAMES: usize = 8;
/// Where what was read begins.
const READINGS: usize = 32;

/// How many rows have each status.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Summary {
    pub(super) ok: usize,
    pub(super) warn: usize,
    pub(super) fail: usize,
    pub(super) skip: usize,
}

impl Summary {
    pub(super) fn of(rows: &[Row]) -> Self {
        let count = |status| rows.iter().filter(|r| r.finding.status == status).count();
        Self {
            ok: count(Status::Ok),
            warn: count(Status::Warn),
            fail: count(Status::Fail),
            skip: count(Status::Skip),
        }
    }
}

/// The report: every row, or only the bad ones, and a line that sums up.
pub(super) fn text(rows: &[Row], quiet: bool) -> String {
    let mut text = String::new();
    let mut group = "";
    for row in rows {
        if quiet && !row.finding.status.is_bad() {
            continue;
        }
        if row.group != group {
            group = row.group;
            text += &format!("{group}\n");
        }
        text += &lines(row);
    }
    text + &summary(rows)
}

fn lines(row: &Row) -> String {
    let finding = &row.finding;
    let head = format!("  {:<4}  {}", finding.status.name(), row.name);
    let indent = READINGS.max(head.chars().count() + 2);
    let mut text = wrapped(&finding.read, indent, WIDTH)
        .enumerate()
        .map(|(index, line)| match index {
            0 => format!("{head:<indent$}{line}\n"),
            _ => format!("{:indent$}{line}\n", ""),
        })
        .collect::<String>();
    if finding.status.is_bad() {
        text += &block(row.why, "", "");
        text += &match &finding.remedy {
            Remedy::None => String::new(),
            Remedy::Command(text) => command(text),
            Remedy::Advice(advice) => block(advice, "> ", ""),
        };
    }
    text
}

/// A comment cannot be continued behind a backslash; where it does not fit it gets lines of its own.
fn command(text: &str) -> String {
    const MARK: &str = "$ ";
    let whole = format!("{:NAMES$}{MARK}{text}\n", "");
    match text.split_once("    # ") {
        Some((command, comment)) if whole.chars().count() > WIDTH => {
            block(command, MARK, " \\") + &block(comment, "# ", "")
        }
        Some(_) => whole,
        None => block(text, MARK, " \\"),
    }
}

/// Text under the name, its first line after `mark`; each but the last ends in `more`.
fn block(text: &str, mark: &str, more: &str) -> String {
    let indent = NAMES + mark.len();
    let all: Vec<String> = wrapped(text, indent, WIDTH - more.len()).collect();
    let last = all.len().saturating_sub(1);
    let lines = all.iter().enumerate().map(|(index, line)| {
        let mark = if index == 0 { mark } else { "" };
        let more = if index == last { "" } else { more };
        format!("{mark:>indent$}{line}{more}\n")
    });
    lines.collect()
}

fn summary(rows: &[Row]) -> String {
    let Summary {
        ok,
        warn,
        fail,
        skip,
    } = Summary::of(rows);
    let verdict = match (fail, warn) {
        (0, 0) => "fit for real time",
        (0, _) => "fit, with reservations",
        _ => "not fit for real time",
    };
    let mut text = format!("{verdict}: {ok} ok, {warn} WARN, {fail} FAIL, {skip} skip\n");
    let fixable = rows.iter().filter(|row| !row.finding.changes.is_empty());
    match fixable.count() {
        0 => {}
        n => text += &format!("takt doctor --apply can fix {n} of them until the next boot\n"),
    }
    text
}

#[derive(Debug, Serialize)]
struct Document<'a> {
    /// Version of this form; increased when readers of an older one would misread it.
    version: u32,
    conditions: Vec<Entry<'a>>,
    summary: Summary,
}

#[derive(Debug, Serialize)]
struct Entry<'a> {
    name: &'a str,
    status: &'static str,
    read: &'a str,
    why: &'a str,
    remedy: &'a str,
}

/// All rows as one JSON object on one line.
pub(super) fn json(rows: &[Row]) -> serde_json::Result<String> {
    let entries = rows.iter().map(|row| Entry {
        name: &row.name,
        status: row.finding.status.name(),
        read: &row.finding.read,
        why: row.why,
        remedy: row.finding.remedy.text(),
    });
    serde_json::to_string(&Document {
        version: 1,
        conditions: entries.collect(),
        summary: Summary::of(rows),
    })
}

#[cfg(test)]
mod tests {
    use super::super::condition::{self, Finding, advice};
    use super::*;

    fn row(name: &str, finding: Finding) -> Row {
        Row {
            group: "group",
            name: name.to_owned(),
            why: "Because.",
            finding,
        }
    }

    #[test]
    fn report_good_row_is_one_line_bad_has_remedy() {
        let rows = [
            row("first", Finding::ok("7")),
            row(
                "second eth0",
                Finding::warn("8", condition::command("echo 7")),
            ),
        ];
        let text = text(&rows, false);
        let expected = "group\n  ok    first                   7\n  WARN  second eth0             8\n        Because.\n        $ echo 7\nfit, with reservations: 1 ok, 1 WARN, 0 FAIL, 0 skip\n";
        assert_eq!(text, expected);
        assert!(!super::text(&rows, true).contains("first"));
    }

    #[test]
    fn report_comment_is_not_continued_by_backslash() {
        let text = format!("run it{}    # for {}", " x".repeat(20), "good ".repeat(8));
        let shown = command(text.trim());
        assert!(!shown.contains('\\'), "{shown}");
        assert_eq!(shown.lines().count(), 2);
        assert_eq!(command("run    # now"), "        $ run    # now\n");
    }

    #[test]
    fn report_long_texts_wrap_within_width() {
        let long = "word ".repeat(40);
        let rows = [
            row(
                "a",
                Finding::fail(long.trim(), condition::command(long.trim())),
            ),
            row("b", Finding::fail(long.trim(), advice(long.trim()))),
        ];
        let text = text(&rows, false);
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH));
        let commands: Vec<&str> = text.lines().filter(|line| line.ends_with('\\')).collect();
        assert_eq!(commands.len(), 3, "{text}");
    }
}

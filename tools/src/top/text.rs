//! The heading of the page, and the page as plain text without escape codes.

use std::fmt::Write as _;

use super::finding::Grade;
use super::report::Report;
use super::table::Section;

/// Version, address, verdict.
pub(super) fn head(report: &Report, address: &str) -> String {
    let verdict = match (report.count(Grade::Fail), report.count(Grade::Warn)) {
        (0, 0) => "good".to_owned(),
        (0, warned) => format!("good, {warned} WARN"),
        (failed, 0) => format!("{failed} FAIL"),
        (failed, warned) => format!("{failed} FAIL, {warned} WARN"),
    };
    format!("takt {} at {address}: {verdict}", report.version)
}

/// The whole page.
pub(super) fn page(head: &str, sections: &[Section]) -> String {
    let mut out = format!("{head}\n");
    for Section { head, lines } in sections.iter().filter(|it| !it.lines.is_empty()) {
        // Writing to a String cannot fail.
        let _ = writeln!(out, "\n{head}");
        for line in lines {
            let _ = writeln!(out, "{}", line.text);
        }
    }
    out
}

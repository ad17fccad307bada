//! What a measurement or a recording shows of a segment: findings, their grades, and the verdict on them.

use std::fmt::{self, Write as _};
use std::time::Duration;

use serde_json::{Value, json};
use takt_ethercat::master::{Fault, Suspect};

use crate::Verdict;

/// A failure, warning or note of a measurement or a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Finding {
    /// A cable was cut during the measurement.
    Cut(String),
    /// Errors point to a cable.
    Suspect(Suspect),
    /// A slave is not in the requested state.
    Slave(usize, Fault),
    /// Errors between the firmware of a slave and its controller.
    Controller(usize, u64),
    /// Frames did not return.
    Lost {
        lost: u64,
        sent: u64,
        /// Whether port errors explain the losses.
        broken: bool,
    },
    /// Working counters were unexpected although the frames returned.
    Misses(u64),
    /// Frames returned after the end of their cycle.
    Late(u64),
    /// Frames that this master did not send.
    Foreign(u64),
    /// A fault in a recording, or a difference of the segment from its cell.
    Failure(String),
    /// What a recording does not show.
    Note(String),
}

impl Finding {
    /// Late frames are only a warning: their cause is the host, and this tool is not real-time.
    pub(super) const fn is_failure(&self) -> bool {
        !matches!(self, Self::Late(_) | Self::Note(_))
    }
}

impl Finding {
    /// The finding as JSON.
    pub(super) fn object(&self) -> Value {
        let grade = self.grade().to_lowercase();
        json!({ "failure": self.is_failure(), "grade": grade, "text": self.to_string() })
    }

    const fn grade(&self) -> &'static str {
        if self.is_failure() {
            "FAIL"
        } else if matches!(self, Self::Note(_)) {
            "note"
        } else {
            "WARN"
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cut(text) => f.write_str(text),
            Self::Suspect(suspect) => suspect.fmt(f),
            Self::Slave(slave, fault) => write!(f, "slave {slave}: {fault}"),
            Self::Controller(slave, errors) => write!(
                f,
                "slave {slave}: {errors} errors between its firmware and its controller (030Dh): a fault of the device"
            ),
            Self::Lost {
                lost,
                sent,
                broken: true,
            } => write!(
                f,
                "{lost} of {sent} frames lost\nhint: check the cable above"
            ),
            Self::Lost {
                lost,
                sent,
                broken: false,
            } => write!(
                f,
                "{lost} of {sent} frames lost, without errors at any port\nhint: check the cable from the master to \
                 slave 0 and the frames that the host drops (`ip -s link`, `takt doctor --interface`)"
            ),
            Self::Misses(misses) => write!(
                f,
                "{misses} cycles with an unexpected working counter: a slave left OP or dropped process data\nhint: \
                 check its watchdog and the states above"
            ),
            Self::Late(late) => write!(
                f,
                "{late} frames returned after the end of their cycle: the host is late\nhint: see `takt jitter` and \
                 `ethtool -c` (rx-usecs 0), or use a longer --cycle"
            ),
            Self::Failure(text) | Self::Note(text) => f.write_str(text),
            Self::Foreign(foreign) => write!(
                f,
                "{foreign} frames of another sender: another master on this segment, or a switch in it"
            ),
        }
    }
}

/// Fails if there are failures.
pub(super) fn verdict_of(findings: &[Finding]) -> Verdict {
    if findings.iter().any(Finding::is_failure) {
        Verdict::Failed
    } else {
        Verdict::Good
    }
}

/// Aligns the lines after the first with the text of a finding.
pub(super) fn indented(finding: &str) -> String {
    finding.replace('\n', "\n      ")
}

/// The findings with their hints, and the verdict.
pub(super) fn verdict(name: &str, findings: &[Finding]) -> String {
    let mut text = String::new();
    for finding in findings {
        let lines = indented(&finding.to_string());
        let _ = writeln!(text, "{:<4}  {lines}", finding.grade());
    }
    let graded = |grade: &str| {
        let graded = findings.iter().filter(|finding| finding.grade() == grade);
        graded.count()
    };
    let _ = match (graded("FAIL"), graded("WARN")) {
        (0, 0) => writeln!(text, "{name}: good"),
        (0, warnings) => writeln!(text, "{name}: good, {warnings} WARN"),
        (failures, warnings) => writeln!(text, "{name}: {failures} FAIL, {warnings} WARN"),
    };
    text
}

pub(super) fn percentiles(round_trips: &[Duration]) -> Option<[Duration; 3]> {
    let mut sorted = round_trips.to_vec();
    sorted.sort_unstable();
    let last = sorted.len().checked_sub(1)?;
    let at = |hundredths: usize| sorted.get(last * hundredths / 100).copied();
    Some([at(50)?, at(99)?, at(100)?])
}

pub(super) fn nanos(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}

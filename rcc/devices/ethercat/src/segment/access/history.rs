//! What happened on a segment, with times: a fault that is over is still shown, with its beginning and its end.

use std::collections::VecDeque;
use std::time::{SystemTime, UNIX_EPOCH};

use serde_json::{Value, json};
use takt_core::device::driver::Severity;
use takt_ethercat::master::{Cable, Event, Fault};

use super::super::events::SegmentEvent;

/// Most entries; the oldest are dropped.
const ENTRIES_MAX: usize = 256;

/// What a later event ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Subject {
    /// The fault of a slave.
    Slave(usize),
    /// The clock of a slave.
    Clock(usize),
    /// The ring is open.
    Ring,
    /// The segment differs from the cell.
    Segment,
}

#[derive(Debug)]
struct Entry {
    begin: SystemTime,
    end: Option<SystemTime>,
    severity: Severity,
    subject: Option<Subject>,
    text: String,
}

/// The history of a segment.
#[derive(Debug, Default)]
pub(super) struct History {
    entries: VecDeque<Entry>,
    dropped: u64,
}

/// What an event begins, and what it ends.
#[expect(
    clippy::wildcard_enum_match_arm,
    reason = "most events of a master are momentary"
)]
const fn subjects(event: &SegmentEvent) -> (Option<Subject>, Option<Subject>) {
    match event {
        SegmentEvent::Event(event) => match event {
            Event::Fault { slave, .. } => (Some(Subject::Slave(*slave)), None),
            Event::Reached { slave, .. } => (None, Some(Subject::Slave(*slave))),
            Event::ClockLost { slave, .. } => (Some(Subject::Clock(*slave)), None),
            Event::ClockBack { slave } => (None, Some(Subject::Clock(*slave))),
            Event::CableCut {
                cable: Cable {
                    to: Some(slave), ..
                },
            } => (Some(Subject::Slave(*slave)), None),
            Event::RingOpen { .. } => (Some(Subject::Ring), None),
            Event::RingClosed => (None, Some(Subject::Ring)),
            _ => (None, None),
        },
        SegmentEvent::Difference(_) | SegmentEvent::TooLarge(_) => (Some(Subject::Segment), None),
        SegmentEvent::AsExpected => (None, Some(Subject::Segment)),
        SegmentEvent::Emergency(_)
        | SegmentEvent::Lack(_)
        | SegmentEvent::Axis(..)
        | SegmentEvent::Servo(..)
        | SegmentEvent::Joint(..) => (None, None),
    }
}

impl History {
    /// Adds an event, and ends what it ends.
    pub(super) fn note(&mut self, event: &SegmentEvent) {
        let now = SystemTime::now();
        let (begun, ended) = subjects(event);
        let is_lost = matches!(
            event,
            SegmentEvent::Event(Event::Fault {
                fault: Fault::Lost,
                ..
            })
        );
        for entry in &mut self.entries {
            // A slave that is lost ends its former fault.
            let over = entry.subject.is_some()
                && (entry.subject == ended || (is_lost && entry.subject == begun));
            if over && entry.end.is_none() {
                entry.end = Some(now);
            }
        }
        let reported = event.event();
        if self.entries.len() == ENTRIES_MAX {
            self.entries.pop_front();
            self.dropped += 1;
        }
        self.entries.push_back(Entry {
            begin: now,
            end: None,
            severity: reported.severity,
            subject: begun,
            text: reported.text,
        });
    }

    /// The entries, the oldest first, and the number of older ones that were dropped.
    pub(super) fn object(&self) -> Value {
        let entries: Vec<Value> = self.entries.iter().map(Entry::object).collect();
        json!({ "dropped": self.dropped, "entries": entries })
    }
}

impl Entry {
    fn object(&self) -> Value {
        let seconds = |at: SystemTime| {
            let since = at.duration_since(UNIX_EPOCH).unwrap_or_default();
            (since.as_secs_f64() * 1e3).round() / 1e3
        };
        let severity = match self.severity {
            Severity::Info => "info",
            Severity::Warning => "warning",
            Severity::Error => "error",
        };
        json!({
            "begin": seconds(self.begin),
            "end": self.end.map(seconds),
            "lasts": self.subject.is_some() && self.end.is_none(),
            "severity": severity,
            "text": self.text,
        })
    }
}

#[cfg(test)]
mod tests {
    use takt_ethercat::AlState;

    use super::*;

    #[test]
    fn history_fault_that_is_over_has_its_end() {
        let mut history = History::default();
        let fault = |slave| {
            SegmentEvent::Event(Event::Fault {
                slave,
                fault: Fault::NoClock,
            })
        };
        let state = AlState::Op;
        history.note(&fault(1));
        history.note(&fault(2));
        history.note(&SegmentEvent::Event(Event::Reached { slave: 1, state }));
        let object = history.object();
        let entry = |at: usize| &object["entries"][at];
        assert!(
            entry(0)["end"].is_f64() && entry(0)["begin"].is_f64(),
            "{object}"
        );
        assert_eq!(entry(0)["lasts"], false);
        assert_eq!(
            (&entry(1)["end"], &entry(1)["lasts"]),
            (&Value::Null, &true.into())
        );
        assert_eq!(entry(2)["severity"], "info");
    }

    #[test]
    fn history_is_bounded_and_counts_dropped_entries() {
        let mut history = History::default();
        for _ in 0..ENTRIES_MAX + 3 {
            history.note(&SegmentEvent::AsExpected);
        }
        let object = history.object();
        assert_eq!(object["dropped"], 3);
        assert_eq!(object["entries"].as_array().unwrap().len(), ENTRIES_MAX);
    }
}

//! When the machine was in which state, and within the initialization, in which part of homing its axes were.

use std::time::Duration;

use takt_core::Controller;
use takt_core::device::homing::TOUCHED;
use takt_core::device::{Part, parts};
use takt_net::device::Layout;

use crate::demo::cell::AXES;

/// The state whose parts are distinguished.
const INITIALIZATION: &str = "InitializationSequence";

/// A span of time with its name.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Span {
    pub(super) name: String,
    /// Seconds since the start of the machine.
    pub(super) from_s: f64,
    pub(super) to_s: f64,
}

/// States and parts of homing over time.
#[derive(Clone, Debug, Default)]
pub(crate) struct Trace {
    pub(super) states: Vec<Span>,
    pub(super) parts: Vec<Span>,
}

/// Adds a moment to spans: it prolongs the last one, or begins another. True if it begins one.
fn add(spans: &mut Vec<Span>, name: Option<&str>, at_s: f64) -> bool {
    if let Some(last) = spans.last_mut().filter(|last| last.to_s.is_nan()) {
        if Some(last.name.as_str()) == name {
            return false;
        }
        last.to_s = at_s;
    }
    let Some(name) = name else {
        return false;
    };
    spans.push(Span {
        name: name.to_owned(),
        from_s: at_s,
        to_s: f64::NAN,
    });
    true
}

/// What axes in these steps of homing do together.
fn part(steps: &[i32]) -> Option<&'static str> {
    let slowest = steps.iter().copied().min()?;
    Some(match slowest {
        ..=TOUCHED => "to the sensors",
        4 => "off",
        5 => "Z",
        6 => "to the start",
        _ => return None,
    })
}

impl Trace {
    /// Notes where the machine and its axes are. A line to print, if the state is another than before.
    pub(super) fn note(
        &mut self,
        at: Duration,
        state: &str,
        controller: &Controller,
    ) -> Option<String> {
        let at_s = at.as_secs_f64();
        let steps = (state == INITIALIZATION).then(|| steps(controller));
        let part = steps.as_deref().and_then(part);
        add(&mut self.parts, part, at_s);
        add(&mut self.states, Some(state), at_s).then(|| format!("{at_s:9.3} s  {state}"))
    }

    /// Ends what goes on.
    pub(super) fn end(&mut self, at: Duration) {
        let open = self.states.iter_mut().chain(&mut self.parts);
        for span in open.filter(|span| span.to_s.is_nan()) {
            span.to_s = at.as_secs_f64();
        }
    }

    /// States in their order, with their time in seconds.
    pub(crate) fn states(&self) -> impl Iterator<Item = (&str, f64)> {
        self.states
            .iter()
            .map(|span| (span.name.as_str(), span.from_s))
    }
}

/// The steps of homing of the axes.
fn steps(controller: &Controller) -> Vec<i32> {
    let Some(homing) = parts::lay(&[Part::Homing], 0, &mut Layout::default()).homing else {
        return Vec::new();
    };
    let states = AXES.iter().filter_map(|axis| controller.arm_state(axis));
    states
        .map(|state| homing.step.read(&state.signals).unwrap_or_default())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trace_spans_follow_each_other() {
        let mut spans = Vec::new();
        for (at, name) in [
            (0.0, Some("A")),
            (1.0, Some("A")),
            (2.0, Some("B")),
            (3.0, None),
            (5.0, Some("C")),
        ] {
            add(&mut spans, name, at);
        }
        let mut trace = Trace {
            states: spans,
            parts: Vec::new(),
        };
        trace.end(Duration::from_secs(6));
        let found = trace
            .states
            .iter()
            .map(|span| (span.name.as_str(), span.from_s, span.to_s));
        let found: Vec<_> = found.collect();
        assert_eq!(found, [("A", 0.0, 2.0), ("B", 2.0, 3.0), ("C", 5.0, 6.0)]);
    }

    #[test]
    fn homing_part_is_that_of_slowest_axis() {
        assert_eq!(part(&[3, 2, 0]), Some("to the sensors"));
        assert_eq!(part(&[5, 4, 6]), Some("off"));
        assert_eq!(part(&[5, 7, 6]), Some("Z"));
        assert_eq!(part(&[7, 7, 7]), None);
    }
}

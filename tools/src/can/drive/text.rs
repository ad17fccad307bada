//! Steps, verdict and JSON of `takt can drive`. It reads no wire.

use std::fmt::Write as _;

use serde_json::{Value, json};
use takt_cia402::State;

use super::session::{Report, Step};

fn state(step: &Step) -> String {
    match step.status.state() {
        Ok(state) => state.to_string(),
        Err(_) => "no state of the profile".to_owned(),
    }
}

/// A step: when, in which state, and both words.
pub(super) fn step(step: &Step) -> String {
    let mode = step
        .mode
        .map_or_else(String::new, |mode| format!(", mode {mode}"));
    format!(
        "{:>9.3} s  {}{mode}, position {}, velocity {}\n             6041h {}\n             6040h {}",
        step.at.as_secs_f64(),
        state(step),
        step.position,
        step.velocity,
        step.status,
        step.control,
    )
}

/// The result.
pub(super) fn verdict(report: &Report) -> String {
    let mut text = String::new();
    for note in &report.notes {
        let _ = writeln!(text, "note: {note}");
    }
    text + &judgement(report)
}

fn judgement(report: &Report) -> String {
    let who = format!("node {} axis {}", report.node, report.axis);
    let Some(diagnosis) = &report.diagnosis else {
        let last = report.steps.last();
        let state = last.map_or_else(|| "no state was read".to_owned(), state);
        let result = match (report.commanded, report.stopped, report.was_enabled()) {
            (false, ..) => "watched".to_owned(),
            (true, true, _) => "stopped on request".to_owned(),
            (true, false, _) => "enabled and switched off".to_owned(),
        };
        return format!("{who}: ok, {result}, now {state}");
    };
    let diagnosis_text = diagnosis.to_string().replace("\nhint", "\n        hint");
    let mut text = format!("{who}: FAIL  {diagnosis_text}\n");
    for fact in &diagnosis.facts {
        let _ = writeln!(text, "        {fact}");
    }
    if let Some(message) = diagnosis.other_master {
        let _ = writeln!(text, "        another master sends to it: {message}");
    }
    text
}

pub(super) fn json(report: &Report) -> Value {
    let steps = report.steps.iter().map(|step| {
        json!({
            "at_ms": step.at.as_secs_f64() * 1e3, "state": state(step), "status": step.status.raw(),
            "control": step.control.raw(), "mode": step.mode, "position": step.position,
            "velocity": step.velocity,
        })
    });
    let diagnosis = report.diagnosis.as_ref().map(|diagnosis| {
        json!({
            "name": diagnosis.cause.name(), "cause": diagnosis.to_string(), "facts": diagnosis.facts,
            "other_master": diagnosis.other_master.map(|message| message.to_string()),
        })
    });
    json!({
        "version": 1, "node": report.node.raw(), "axis": report.axis, "enabled": report.was_enabled(),
        "stopped": report.stopped, "notes": report.notes, "steps": steps.collect::<Vec<_>>(), "diagnosis": diagnosis,
    })
}

impl Report {
    /// Whether it was in Operation enabled.
    pub(super) fn was_enabled(&self) -> bool {
        let enabled = |step: &Step| step.status.state() == Ok(State::OperationEnabled);
        self.steps.iter().any(enabled)
    }
}

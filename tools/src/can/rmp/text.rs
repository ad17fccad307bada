//! A power base as text and as JSON. It reads no wire.

use std::fmt::Write as _;

use serde_json::{Value, json};
use takt_can::rmp::Measurement;

use super::session::{Report, View};

fn joined(names: impl Iterator<Item = &'static str>) -> String {
    let names: Vec<&str> = names.collect();
    match names.is_empty() {
        true => "-".to_owned(),
        false => names.join(", "),
    }
}

/// Its state in some lines.
pub(super) fn view(view: &View) -> String {
    let Some(measured) = &view.measured else {
        return match view.off {
            true => "the user interface is on, the power base is off\n".to_owned(),
            false => "nothing is received\n".to_owned(),
        };
    };
    let mut text = words(measured);
    let interface = view
        .interface_battery
        .map_or_else(|| "-".to_owned(), |volts| format!("{volts:.2} V"));
    let [left, right] = measured.speed;
    let [torque_left, torque_right] = measured.torque;
    let pose = view.motion.pose;
    let [forward, _, rotation] = view.motion.velocity;
    let _ = writeln!(
        text,
        "batteries  power base {:.1} V, user interface {interface}",
        measured.battery
    );
    let _ = writeln!(
        text,
        "wheels     {left:+.3} {right:+.3} m/s, torque {torque_left:+.1} {torque_right:+.1} Nm"
    );
    let _ = writeln!(
        text,
        "moves      {forward:+.3} m/s forward, {rotation:+.3} rad/s left"
    );
    let _ = writeln!(
        text,
        "odometry   x {:+.3} m, y {:+.3} m, heading {:+.3} rad, {} jumps",
        pose.x, pose.y, pose.heading, view.jumps
    );
    let [pitch, roll] = measured.attitude;
    let _ = writeln!(
        text,
        "attitude   pitch {pitch:+.3} rad, roll {roll:+.3} rad; {} cycles, {} broken",
        view.cycles, view.broken
    );
    text
}

fn words(measured: &Measurement) -> String {
    let unit = &measured.unit;
    format!(
        "mode       {}, gain schedule {}\nstatus 1   {:04X}h {}\nstatus 2   {:04X}h {}\n",
        measured.mode,
        measured.gain.raw(),
        unit.word1.0,
        joined(unit.word1.names()),
        unit.word2.0,
        joined(unit.word2.names()),
    )
}

/// The result.
pub(super) fn report(place: &str, report: &Report) -> String {
    let build = report
        .view
        .build
        .map_or_else(String::new, |build| format!(", firmware {build}"));
    let mut text = format!("{place}: {}{build}\n", report.model.name());
    text.push_str(&view(&report.view));
    for config in &report.configs {
        let _ = writeln!(
            text,
            "set        {config} (it does not acknowledge settings)"
        );
    }
    for finding in &report.findings {
        let finding = finding.to_string().replace("\nhint", "\n      hint");
        let _ = writeln!(text, "{place}: FAIL  {finding}");
    }
    if report.findings.is_empty() {
        let result = match (report.jogged, report.stopped) {
            (true, true) => "ok, stopped on request",
            (true, false) => "ok, drove and is at rest",
            (false, _) => "ok",
        };
        let _ = writeln!(text, "{place}: {result}");
    }
    text
}

pub(super) fn json(report: &Report) -> Value {
    let view = &report.view;
    let pose = view.motion.pose;
    let measured = view.measured.map(|measured| {
        json!({
            "mode": measured.mode.to_string(), "gain": measured.gain.raw(),
            "word1": measured.unit.word1.0, "word1_names": measured.unit.word1.names().collect::<Vec<_>>(),
            "word2": measured.unit.word2.0, "word2_names": measured.unit.word2.names().collect::<Vec<_>>(),
            "battery_v": measured.battery, "speed_mps": measured.speed, "yaw_rate_radps": measured.yaw_rate,
            "torque_nm": measured.torque, "attitude_rad": measured.attitude,
        })
    });
    let findings = report
        .findings
        .iter()
        .map(|finding| json!({"name": finding.name(), "cause": finding.to_string()}));
    let set = report.configs.iter().map(ToString::to_string);
    json!({
        "version": 1, "model": report.model.name(), "build": view.build, "measured": measured,
        "interface_battery_v": view.interface_battery, "cycles": view.cycles, "broken": view.broken,
        "jumps": view.jumps, "pose": {"x_m": pose.x, "y_m": pose.y, "heading_rad": pose.heading},
        "velocity": view.motion.velocity, "set": set.collect::<Vec<_>>(), "stopped": report.stopped,
        "findings": findings.collect::<Vec<_>>(),
    })
}

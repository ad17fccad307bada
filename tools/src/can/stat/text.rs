//! The report of `takt can stat` as text and as JSON. It computes nothing.

use std::fmt::Write as _;
use std::time::Duration;

use serde_json::{Value, json};
use takt_can::canopen::Message;
use takt_can::stat::{Finding, IdStat, Report, Severity};
use takt_can::{Frame, Id};
use takt_cia402::error_text;

use super::Signals;
use crate::can::dbc::Database;

/// Number of identifiers in the table, those with the most time on the bus first.
const IDS_MAX: usize = 40;

fn ms(span: Duration) -> f64 {
    span.as_secs_f64() * 1e3
}

#[expect(clippy::cast_precision_loss, reason = "shown with few digits")]
fn per_second(count: u64, span: Duration) -> f64 {
    match span.is_zero() {
        true => 0.0,
        false => count as f64 / span.as_secs_f64(),
    }
}

/// Everything but the verdict.
pub(super) fn table(name: &str, report: &Report, signals: &Signals<'_>) -> String {
    let mut text = head(name, report);
    ids(&mut text, report, signals.database);
    text.push_str(&signals.ranges.table(signals.database));
    nodes(&mut text, report);
    sdos(&mut text, report);
    text.trim_end().to_owned()
}

fn head(name: &str, report: &Report) -> String {
    let rate = per_second(report.frames, report.span);
    let mut text = format!(
        "{name}: {} frames in {:.3} s, {rate:.1} frames/s, {} identifiers\n",
        report.frames,
        report.span.as_secs_f64(),
        report.ids.len(),
    );
    match (report.load(), report.rates) {
        (Some(load), Some(rates)) => {
            let share = |busy: Duration| busy.as_secs_f64() / report.span.as_secs_f64() * 1e2;
            let (least, most) = report.busy_bounds;
            let _ = writeln!(
                text,
                "load  {:.1} % of {} kbit/s, peak {:.1} % (without stuff bits {:.1} %, at most {:.1} %)",
                load * 1e2,
                rates.nominal / 1000,
                report.peak_load * 1e2,
                share(least),
                share(most),
            );
        }
        _ => text.push_str("load  unknown without a bit rate (--bitrate)\n"),
    }
    let state = report.state.map_or("unknown", |state| state.name());
    let _ = write!(text, "state {state}");
    if let Some((transmit, receive)) = report.counters {
        let _ = write!(
            text,
            ", error counters {transmit} sending, {receive} receiving"
        );
    }
    let errors = &report.errors;
    let _ = writeln!(
        text,
        "; {} error frames, {} frames lost here, {} refused",
        errors.frames, report.dropped, report.refused
    );
    sync(&mut text, report);
    text
}

/// Period and jitter of SYNC, if it is present.
fn sync(text: &mut String, report: &Report) {
    let stat = report.ids.get(&takt_can::canopen::SYNC);
    if let (Some(jitter), Some(stat)) = (report.sync_jitter(), stat) {
        let intervals = &stat.intervals;
        let _ = writeln!(
            text,
            "SYNC  every {:.3} ms ({:.3} to {:.3} ms), jitter {:.1} %, deviation {:.3} ms",
            ms(intervals.mean()),
            ms(intervals.shortest()),
            ms(intervals.longest()),
            jitter * 1e2,
            ms(intervals.deviation()),
        );
    }
}

fn ids(text: &mut String, report: &Report, database: &Database) {
    if report.ids.is_empty() {
        return;
    }
    let mut ids: Vec<(&Id, &IdStat)> = report.ids.iter().collect();
    ids.sort_by_key(|(id, stat)| (std::cmp::Reverse((stat.busy, stat.frames)), **id));
    let _ = writeln!(
        text,
        "\n      id   frames  mean ms   min ms   max ms   dev ms  load %  meaning"
    );
    for (id, stat) in ids.iter().take(IDS_MAX) {
        let intervals = &stat.intervals;
        let load = match report.rates {
            Some(_) => per_second(1, report.span) * stat.busy.as_secs_f64() * 1e2,
            None => f64::NAN,
        };
        let load = if load.is_nan() {
            "-".to_owned()
        } else {
            format!("{load:.2}")
        };
        let _ = writeln!(
            text,
            "{:>8} {:>8} {:>8.3} {:>8.3} {:>8.3} {:>8.3} {load:>7}  {}",
            id.to_string(),
            stat.frames,
            ms(intervals.mean()),
            ms(intervals.shortest()),
            ms(intervals.longest()),
            ms(intervals.deviation()),
            database
                .message(**id)
                .map_or_else(|| kind(**id), str::to_owned),
        );
    }
    let more = ids.len().saturating_sub(IDS_MAX);
    if more > 0 || report.other_ids > 0 {
        let _ = writeln!(
            text,
            "... and {more} more, {} frames of others",
            report.other_ids
        );
    }
}

/// The CANopen use of an identifier, found by decoding example frames.
fn kind(id: Id) -> String {
    let examples: [&[u8]; 5] = [&[], &[0], &[0; 2], &[0; 6], &[0; 8]];
    for data in examples {
        let Ok(frame) = Frame::new(id, data) else {
            continue;
        };
        let node = id.raw() & 0x7F;
        return match Message::decode(&frame) {
            Message::Nmt(..) => "NMT".to_owned(),
            Message::Sync(_) => "SYNC".to_owned(),
            Message::Tpdo(_, number) => format!("node {node} TPDO{number}"),
            Message::Rpdo(_, number) => format!("node {node} RPDO{number}"),
            Message::SdoResponse(..) => format!("node {node} SDO answers"),
            Message::SdoRequest(..) => format!("node {node} SDO requests"),
            Message::Heartbeat(..) => format!("node {node} heartbeat"),
            Message::Emergency(..) => format!("node {node} EMCY"),
            Message::Lss(..) => "LSS".to_owned(),
            Message::Time(..) => "TIME".to_owned(),
            Message::Guard(_) | Message::Unknown => continue,
        };
    }
    String::new()
}

fn nodes(text: &mut String, report: &Report) {
    if report.heartbeats.is_empty() {
        return;
    }
    text.push_str("\n    node  state            heartbeat ms  late  started\n");
    for (node, beat) in &report.heartbeats {
        let silent = report.silent.iter().any(|(silent, _)| silent == node);
        let mut note = if silent { "  SILENT" } else { "" }.to_owned();
        if beat.own {
            note.push_str("  this host");
        }
        if let Some(earlier) = beat.earlier {
            let _ = write!(note, "  every {:.0} ms before", ms(earlier));
        }
        if let (times, Some(command)) = beat.resets {
            let _ = write!(note, "  {times} by NMT {command}");
        }
        let _ = writeln!(
            text,
            "{:>8}  {:<16} {:>12.0} {:>5} {:>8}{note}",
            node.raw(),
            beat.state.to_string(),
            ms(beat.period()),
            beat.gaps,
            beat.boots,
        );
    }
}

fn sdos(text: &mut String, report: &Report) {
    let transfers = || report.sdos.iter().filter(|(_, sdo)| sdo.is_sdo());
    if transfers().next().is_none() {
        return;
    }
    text.push_str("\n    node  SDO requests  answered  no answer  aborts  longest ms\n");
    for (node, sdo) in transfers() {
        let _ = writeln!(
            text,
            "{:>8}  {:>12}  {:>8}  {:>9}  {:>6}  {:>10.1}",
            node.raw(),
            sdo.requests,
            sdo.answered,
            sdo.unanswered,
            sdo.refused.0.saturating_add(sdo.given_up.0),
            ms(sdo.longest),
        );
    }
}

/// The findings with their remedies; `ok` if there are none.
pub(super) fn verdict(name: &str, findings: &[Finding]) -> Vec<String> {
    if findings.is_empty() {
        return vec![format!("{name}: ok")];
    }
    let mut lines = Vec::new();
    for finding in findings {
        let word = match finding.severity() {
            Severity::Failure => "FAIL",
            Severity::Warning => "WARN",
        };
        lines.push(format!("{name}: {word}  {finding}"));
        lines.extend(wrapped(finding.remedy()));
    }
    lines
}

/// A remedy as lines of at most 80 columns, the first of them marked by `>`.
fn wrapped(text: &str) -> Vec<String> {
    const WIDTH: usize = 70;
    let mut lines = vec![String::new()];
    for word in text.split_ascii_whitespace() {
        let last = lines
            .last_mut()
            .filter(|l| l.is_empty() || l.len() + word.len() < WIDTH);
        match last {
            Some(line) if line.is_empty() => line.push_str(word),
            Some(line) => line.extend([" ", word]),
            None => lines.push(word.to_owned()),
        }
    }
    let mark = |(number, line): (usize, String)| {
        format!("        {} {line}", if number == 0 { '>' } else { ' ' })
    };
    lines.into_iter().enumerate().map(mark).collect()
}

pub(super) fn json(
    name: &str,
    report: &Report,
    findings: &[Finding],
    signals: &Signals<'_>,
) -> Value {
    let us = |span: Duration| span.as_secs_f64() * 1e6;
    let ids = report.ids.iter().map(|(id, stat)| {
        json!({
            "id": id.raw(), "extended": id.is_extended(), "frames": stat.frames, "bytes": stat.bytes,
            "busy_us": us(stat.busy), "mean_us": us(stat.intervals.mean()),
            "min_us": us(stat.intervals.shortest()), "max_us": us(stat.intervals.longest()),
            "deviation_us": us(stat.intervals.deviation()),
        })
    });
    let nodes = report.heartbeats.iter().map(|(node, beat)| {
        let silence = report.silent.iter().find(|(silent, _)| silent == node);
        json!({
            "node": node.raw(), "state": beat.state.to_string(), "boots": beat.boots,
            "reboots": beat.reboots, "loops": beat.loops, "own": beat.own, "resets": beat.resets.0, "late": beat.gaps,
            "mean_us": us(beat.period()), "earlier_us": beat.earlier.map(us),
            "silent_us": silence.map(|(_, silence)| us(*silence)),
        })
    });
    let sdos = report.sdos.iter().filter(|(_, sdo)| sdo.is_sdo());
    let sdos = sdos.map(|(node, sdo)| {
        json!({
            "node": node.raw(), "requests": sdo.requests, "answered": sdo.answered,
            "unanswered": sdo.unanswered, "refused": sdo.refused.0, "given_up": sdo.given_up.0,
            "repeats": sdo.repeats, "unasked": sdo.unsolicited,
            "doubled": sdo.doubled, "longest_us": us(sdo.longest),
        })
    });
    let emergencies = report.emergencies.iter().flat_map(|(node, emergencies)| {
        emergencies.codes().iter().map(|seen| {
            json!({
                "node": node.raw(), "code": seen.code, "text": error_text(seen.code),
                "register": seen.register, "times": seen.times, "present": seen.is_present,
            })
        })
    });
    let found = findings.iter().map(|finding| {
        let fails = finding.severity() == Severity::Failure;
        json!({
            "name": finding.name(), "severity": if fails { "FAIL" } else { "WARN" },
            "cause": finding.to_string(), "remedy": finding.remedy(),
        })
    });
    let errors = &report.errors;
    json!({
        "version": 1, "interface": name, "span_us": us(report.span), "frames": report.frames,
        "sent": report.sent, "bitrate": report.rates.map(|rates| rates.nominal),
        "load": report.load(), "peak_load": report.rates.map(|_| report.peak_load),
        "state": report.state.map(|state| state.name()),
        "counters": report.counters.map(|(transmit, receive)| json!({"transmit": transmit, "receive": receive})),
        "errors": {
            "frames": errors.frames, "protocol": errors.protocol, "unacknowledged": errors.unacknowledged,
            "lost_arbitration": errors.lost_arbitration, "bus_off": errors.bus_off,
            "controller_overflows": errors.controller_overflows, "restarts": errors.restarts,
        },
        "dropped": report.dropped, "refused": report.refused,
        "sync_jitter": report.sync_jitter(),
        "ids": ids.collect::<Vec<_>>(), "nodes": nodes.collect::<Vec<_>>(),
        "sdos": sdos.collect::<Vec<_>>(), "emergencies": emergencies.collect::<Vec<_>>(),
        "signals": signals.ranges.json(signals.database),
        "findings": found.collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remedy_is_wrapped_at_80_columns() {
        let lines = wrapped(
            "are the nodes powered, and is this the right interface? Configured nodes send heartbeats",
        );
        assert_eq!(lines.len(), 2);
        assert!(lines.iter().all(|line| line.len() <= 80));
        assert!(lines[0].starts_with("        > are the") && lines[1].starts_with("          "));
    }

    #[test]
    fn identifier_use_is_named() {
        for (raw, name) in [
            (0x000, "NMT"),
            (0x080, "SYNC"),
            (0x085, "node 5 EMCY"),
            (0x100, "TIME"),
            (0x185, "node 5 TPDO1"),
            (0x505, "node 5 RPDO4"),
            (0x585, "node 5 SDO answers"),
            (0x605, "node 5 SDO requests"),
            (0x705, "node 5 heartbeat"),
            (0x7E5, "LSS"),
            (0x701 + 0x7F, ""),
        ] {
            assert_eq!(kind(Id::standard(raw).unwrap()), name, "{raw:X}");
        }
    }
}

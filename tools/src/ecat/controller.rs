//! `--controller`: the same reports from a running controller, which is the master of the segment, by its HTTP resource
//! `/ethercat/`. Nothing is sent on the segment but what that master reads.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{Context as _, bail};
use clap::Args;
use serde_json::Value;

use crate::Verdict;
use crate::http::Http;

/// A running controller.
#[derive(Clone, Debug, Args)]
pub(super) struct Remote {
    /// Ask this running controller, which is the master of the segment: its `websocket` address, such as
    /// `http://127.0.0.1:8080`. IFACE is then the name of its segment or an interface of it.
    #[arg(long, value_name = "URL", global = true)]
    controller: Option<String>,
    /// File with the controller's token; else TAKT_TOKEN_FILE or TAKT_TOKEN, or the file that a controller of this account made.
    #[arg(long, value_name = "FILE", requires = "controller", global = true)]
    token_file: Option<PathBuf>,
}

/// Timeout of a connection, and of a response: longer than a slave may take.
const TIMEOUT: Duration = Duration::from_secs(20);

impl Remote {
    pub(super) const fn is_given(&self) -> bool {
        self.controller.is_some()
    }

    /// The report on a segment; without a name, of the only one.
    pub(super) fn report(&self, segment: Option<&str>) -> anyhow::Result<Value> {
        if let Some(segment) = segment {
            return self.get(&format!("/ethercat/{segment}"));
        }
        let all = self.get("/ethercat/")?;
        let segments = all["segments"].as_array().cloned().unwrap_or_default();
        match &segments[..] {
            [] => bail!("the controller has no EtherCAT segment"),
            [only] if only["error"].is_string() => bail!("{}", text(&only["error"])),
            [only] => Ok(only.clone()),
            several => {
                let names: Vec<&str> = several.iter().map(|it| text(&it["segment"])).collect();
                let names = names.join(", ");
                bail!("the controller has several segments: {names}\nhint: name one as IFACE")
            }
        }
    }

    /// Reads bytes of a slave: `sdo/1018/1`, `reg/0130?len=2`.
    pub(super) fn read(&self, segment: &str, slave: &str, what: &str) -> anyhow::Result<Vec<u8>> {
        let slave = slave.replace(' ', "%20");
        let answer = self.get(&format!("/ethercat/{segment}/{slave}/{what}"))?;
        let bytes = answer["bytes"]
            .as_array()
            .context("the controller sent no bytes")?;
        let byte = |value: &Value| u8::try_from(value.as_u64()?).ok();
        let bytes: Option<Vec<u8>> = bytes.iter().map(byte).collect();
        bytes.context("the controller sent no bytes")
    }

    fn get(&self, path: &str) -> anyhow::Result<Value> {
        let url = self.controller.as_deref().unwrap_or_default();
        Http::new(url, self.token_file.as_deref(), TIMEOUT)?.get(path)
    }
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or("-")
}

fn count(value: &Value) -> u64 {
    value.as_u64().unwrap_or(0)
}

fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

fn title(report: &Value) -> String {
    format!(
        "{}: {} slaves, the master is the controller, {} cycles",
        text(&report["segment"]),
        list(&report["slaves"]).len(),
        count(&report["cycles"])
    )
}

/// The slaves with their states, identities and ports.
pub(super) fn scan(report: &Value) -> String {
    let mut out = title(report);
    out.push_str("\n pos  slave                 name in SII           state         ports  vendor    product   revision\n");
    for slave in list(&report["slaves"]) {
        let position = slave["position"]
            .as_u64()
            .map_or_else(|| "-".to_owned(), |at| at.to_string());
        let ports: String = ('0'..)
            .zip(list(&slave["ports"]))
            .map(
                |(number, port)| match (port["link"] == true, port["open"] == true) {
                    (_, true) => number,
                    (true, false) => '!',
                    (false, false) => '-',
                },
            )
            .collect();
        let _ = writeln!(
            out,
            "{position:>4}  {:<20.20}  {:<20.20}  {:<12}  {ports}   {:08X}  {:08X}  {:08X}",
            text(&slave["spec"]),
            text(&slave["name"]),
            text(&slave["state"]),
            count(&slave["vendor"]),
            count(&slave["product"]),
            count(&slave["revision"])
        );
        if let Some(fault) = slave["fault"].as_str() {
            let _ = writeln!(out, "        ! {}", fault.replace('\n', "\n          "));
        }
    }
    out
}

/// Frames, working counters, ports and history.
pub(super) fn stat(report: &Value) -> String {
    let mut out = title(report);
    let (frames, ago) = (&report["frames"], |at: &Value| {
        at.as_f64()
            .map_or_else(String::new, |s| format!(", last {s:.3} s ago"))
    });
    let _ = writeln!(
        out,
        "\nframes      {} sent, {} lost, {} late, {} foreign{}",
        count(&frames["sent"]),
        count(&frames["lost"]),
        count(&frames["late"]),
        count(&frames["foreign"]),
        ago(&frames["last_lost_ago_s"])
    );
    for group in list(&report["groups"]) {
        let _ = writeln!(
            out,
            "counters    group {}: working counter {} of {} to {}, {} misses{}",
            group["group"],
            group["counter"],
            group["expected_min"],
            group["expected_max"],
            count(&group["misses"]),
            ago(&report["last_miss_ago_s"])
        );
    }
    out.push_str("\n slave                      state        port  invalid  receive  forwarded  lost links\n");
    for slave in list(&report["slaves"]) {
        let name = format!(
            "{:>4}  {:<20.20}  {:<11}",
            count(&slave["slave"]),
            text(&slave["spec"]),
            text(&slave["state"])
        );
        let mut head = name;
        for (port, seen) in list(&slave["ports"]).iter().enumerate() {
            let kinds = ["invalid", "receive", "forwarded", "lost_links"];
            let [invalid, receive, forwarded, links] = kinds.map(|kind| count(&slave[kind][port]));
            if seen["open"] != true && invalid + receive + forwarded + links == 0 {
                continue;
            }
            let _ = writeln!(
                out,
                "{head:<39} {port:>5} {invalid:>8} {receive:>8} {forwarded:>10} {links:>11}"
            );
            head.clear();
        }
    }
    history(&mut out, &report["history"]);
    out
}

fn history(out: &mut String, history: &Value) {
    let entries = list(&history["entries"]);
    if entries.is_empty() {
        return;
    }
    out.push_str("\nhistory (UTC)\n");
    for entry in entries {
        let begin = entry["begin"].as_f64().unwrap_or(0.0);
        let span = match (entry["end"].as_f64(), entry["lasts"] == true) {
            (Some(end), _) => format!(", over after {:.3} s", end - begin),
            (None, true) => ", lasts".to_owned(),
            (None, false) => String::new(),
        };
        let line = text(&entry["text"]).replace('\n', "\n                        ");
        let _ = writeln!(out, "{}  {line}{span}", clock(begin));
    }
}

/// Date and time of day of a time since 1970, seconds.
fn clock(seconds: f64) -> String {
    let since = Duration::try_from_secs_f64(seconds).unwrap_or_default();
    let (days, rest) = (since.as_secs() / 86_400, since.as_secs() % 86_400);
    let today = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    let ago = (today.as_secs() / 86_400).saturating_sub(days);
    let day = match ago {
        0 => "today".to_owned(),
        days => format!("-{days} d"),
    };
    let (hours, minutes, seconds) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!(
        "{day:>6} {hours:02}:{minutes:02}:{seconds:02}.{:03}",
        since.subsec_millis()
    )
}

/// Reference, delays and differences of the clocks.
pub(super) fn dc(report: &Value) -> String {
    let mut out = title(report);
    out.push_str("\n slave                 clock      delay ns  difference ns  left the window\n");
    for slave in list(&report["slaves"]) {
        let number = count(&slave["slave"]);
        let kind = match (
            report["reference"].as_u64() == Some(number),
            slave["clock"] == true,
        ) {
            (true, _) => "reference",
            (false, true) if slave["sync"] == true => "SYNC0",
            (false, true) => "clock",
            (false, false) => "none",
        };
        let difference = slave["difference_ns"]
            .as_i64()
            .map_or_else(|| "-".to_owned(), |ns| ns.to_string());
        let _ = writeln!(
            out,
            "{number:>4}  {:<15.15}  {kind:<9}  {:>8}  {difference:>13}  {:>15}",
            text(&slave["spec"]),
            count(&slave["delay_ns"]),
            count(&slave["clock_violations"])
        );
    }
    out
}

/// What is wrong now, and warnings of what was.
pub(super) fn findings(report: &Value) -> (Vec<String>, Vec<String>) {
    let (mut failures, mut warnings) = (Vec::new(), Vec::new());
    for slave in list(&report["slaves"]) {
        if let Some(fault) = slave["fault"].as_str() {
            failures.push(format!(
                "slave {} ({}): {fault}",
                slave["slave"],
                text(&slave["spec"])
            ));
        }
        let kinds = ["invalid", "receive", "lost_links"];
        let errors: u64 = kinds
            .iter()
            .flat_map(|kind| list(&slave[kind]))
            .map(count)
            .sum();
        if errors > 0 {
            let number = &slave["slave"];
            warnings.push(format!(
                "slave {number}: {errors} errors at its ports since the start"
            ));
        }
    }
    if let Some(open) = report["ring_open"].as_str() {
        failures.push(open.to_owned());
    }
    if failures.is_empty() && report["operational"] != true {
        let phase = text(&report["phase"]);
        failures.push(format!(
            "the segment is not operational: {phase}\nhint: see the history and the log"
        ));
    }
    let lost = count(&report["frames"]["lost"]);
    if lost > 0 {
        warnings.push(format!("{lost} frames lost since the start"));
    }
    let misses: u64 = list(&report["groups"])
        .iter()
        .map(|group| count(&group["misses"]))
        .sum();
    if misses > 0 {
        warnings.push(format!(
            "{misses} cycles with an unexpected working counter since the start"
        ));
    }
    (failures, warnings)
}

/// The verdict, one line for each finding.
pub(super) fn verdict(report: &Value) -> (String, Verdict) {
    let (failures, warnings) = findings(report);
    let mut out = String::new();
    for (grade, all) in [("FAIL", &failures), ("WARN", &warnings)] {
        for finding in all {
            let _ = writeln!(out, "{grade}  {}", finding.replace('\n', "\n      "));
        }
    }
    let name = text(&report["segment"]);
    let _ = match (failures.len(), warnings.len()) {
        (0, 0) => writeln!(out, "{name}: good"),
        (0, warned) => writeln!(out, "{name}: good, {warned} WARN"),
        (failed, _) => writeln!(out, "{name}: {failed} FAIL"),
    };
    let verdict = if failures.is_empty() {
        Verdict::Good
    } else {
        Verdict::Failed
    };
    (out, verdict)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn report() -> Value {
        json!({
            "segment": "line", "cycles": 77, "phase": "running", "operational": true, "reference": 1,
            "frames": { "sent": 100, "lost": 2, "late": 0, "foreign": 0, "last_lost_ago_s": 1.5 },
            "groups": [{ "group": 0, "counter": 3, "expected_min": 3, "expected_max": 3, "misses": 0 }],
            "slaves": [{
                "slave": 0, "spec": "drive", "name": "TK4021 servo", "position": 0, "state": "OP",
                "vendor": 0x7A87, "product": 0x4021, "revision": 1, "fault": null,
                "ports": [{ "link": true, "open": true }, { "link": false, "open": false }],
                "invalid": [3, 0, 0, 0], "receive": [0, 0, 0, 0], "forwarded": [0, 0, 0, 0],
                "lost_links": [0, 0, 0, 0], "clock": true, "delay_ns": 300, "difference_ns": -7,
                "clock_violations": 0
            }],
            "history": { "entries": [{
                "begin": 10.0, "end": 12.5, "lasts": false, "severity": "error", "text": "slave 0: lost"
            }]}
        })
    }

    #[test]
    fn controller_report_shows_past_faults_with_times() {
        let text = stat(&report());
        for part in [
            "frames      100 sent, 2 lost, 0 late, 0 foreign, last 1.500 s ago",
            "working counter 3 of 3 to 3, 0 misses",
            "   0  drive                 OP              0        3        0          0           0",
            " 00:00:10.000  slave 0: lost, over after 2.500 s",
        ] {
            assert!(text.contains(part), "{part}\n{text}");
        }
        assert!(scan(&report()).contains("TK4021 servo          OP            0-   00007A87"));
        assert!(
            dc(&report()).contains("   0  drive            clock           300             -7")
        );
        let (text, verdict) = verdict(&report());
        assert_eq!(verdict, Verdict::Good);
        assert!(text.ends_with("line: good, 2 WARN\n"), "{text}");
    }

    #[test]
    fn controller_report_with_present_fault_fails() {
        let mut report = report();
        report["slaves"][0]["fault"] = "no answer".into();
        report["operational"] = false.into();
        let (text, verdict) = verdict(&report);
        assert_eq!(verdict, Verdict::Failed);
        assert!(
            text.starts_with("FAIL  slave 0 (drive): no answer"),
            "{text}"
        );
    }
}

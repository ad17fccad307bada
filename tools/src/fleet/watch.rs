//! `takt fleet watch`: telemetry and liveliness as they come, a line each.

use std::time::{Duration, Instant};

use clap::Args;
use serde_json::{Value, json};
use takt_fleet::config::is_cell_name;
use takt_fleet::keys::ROOT;
use takt_fleet::session::observer::Seen;

use super::link::Link;
use crate::Verdict;
use crate::output::{complain, positive_span, say};
use crate::signal::Stop;

/// How often signals and the end are looked for.
const TICK: Duration = Duration::from_millis(100);

/// End of the keys of joints.
const JOINTS: &str = "/joints";

/// Print telemetry as it comes: the newest values first, then each change; which cells, devices and sessions are alive or lost; how many
/// samples were missed.
///
/// KEY is a key of the fleet with or without `takt/` before it: CELL for all of a cell, CELL/device/left/state, `*/findings` for all
/// cells, CELL/log. Joints come in batches, 20 a second, and are shown only if KEY names them: CELL/device/left/joints. Exit status: 0 good; 1 nothing came; 2 the fleet is not reachable.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt fleet watch weld3
  takt fleet watch '*/findings' --json
  takt fleet watch weld3/log --duration 10s")]
pub(crate) struct Watch {
    /// What to watch.
    #[arg(value_name = "KEY", value_parser = key)]
    topics: String,
    /// End after this time.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    duration: Option<Duration>,
    /// End after so many lines.
    #[arg(long, value_name = "LINES", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
    /// Print each as one JSON object: key with value or alive; missed.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    link: Link,
}

/// The key expression of a user's key.
fn key(text: &str) -> Result<String, String> {
    let rest = text.strip_prefix("takt/").unwrap_or(text);
    let (cell, rest) = rest.split_once('/').unwrap_or((rest, "**"));
    if cell != "*" && cell != "**" && !is_cell_name(cell) {
        return Err(format!(
            "`{cell}` is no name of a cell\nhint: write CELL, CELL/device/left/state or '*/findings'"
        ));
    }
    if cell == "**" {
        return Ok(format!("{ROOT}/**"));
    }
    let is_key = !rest.is_empty() && rest.split('/').all(|chunk| !chunk.is_empty());
    if !is_key || rest.contains(['?', '#']) {
        return Err("has an empty part, or one of ? and #".to_owned());
    }
    Ok(format!("{ROOT}/{cell}/{rest}"))
}

impl Watch {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let fleet = self.link.open()?;
        let watch = fleet.watch(&self.topics)?;
        let stop = Stop::listen()?;
        let until = self.duration.map(|duration| Instant::now() + duration);
        let (mut count, mut missed) = (0, 0);
        while !stop.is_requested()
            && until.is_none_or(|until| Instant::now() < until)
            && self.count.is_none_or(|bound| count < bound)
        {
            if let Some(seen) = watch.next(TICK).filter(|seen| self.shows(seen)) {
                say(&self.line(&seen))?;
                count += 1;
            }
            if watch.missed() > missed {
                missed = watch.missed();
                if self.json {
                    say(&json!({ "missed": missed }).to_string())?;
                } else {
                    complain(&format!("{missed} samples missed so far"));
                }
            }
        }
        Ok(if count > 0 {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }

    fn shows(&self, seen: &Seen) -> bool {
        let is_of_joints = matches!(seen, Seen::Value { key, .. } if key.ends_with(JOINTS));
        !is_of_joints || self.topics.ends_with(JOINTS)
    }

    fn line(&self, seen: &Seen) -> String {
        match (seen, self.json) {
            (Seen::Value { key, text }, false) => format!("{key}  {text}"),
            (Seen::Value { key, text }, true) => {
                let value: Value =
                    serde_json::from_str(text).unwrap_or_else(|_| text.as_str().into());
                json!({"key": key, "value": value}).to_string()
            }
            (Seen::Alive { key }, false) => format!("{key}  alive"),
            (Seen::Lost { key }, false) => format!("{key}  lost"),
            (Seen::Alive { key }, true) => json!({"key": key, "alive": true}).to_string(),
            (Seen::Lost { key }, true) => json!({"key": key, "alive": false}).to_string(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_of_user_is_a_key_expression() {
        for (text, expected) in [
            ("weld3", "takt/weld3/**"),
            ("takt/weld3/log", "takt/weld3/log"),
            ("*/findings", "takt/*/findings"),
            ("**", "takt/**"),
            ("weld3/device/*/state", "takt/weld3/device/*/state"),
        ] {
            assert_eq!(key(text).unwrap(), expected, "{text}");
        }
        for wrong in ["a b", "", "weld3/", "weld3//log", "weld3/log?x"] {
            assert!(key(wrong).is_err(), "{wrong}");
        }
    }
}

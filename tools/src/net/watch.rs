//! `takt net watch` and `takt net list`: what nets do. Nothing is changed.

use std::time::{Duration, Instant};

use clap::Args;
use takt_client::{Message, Value};

use super::Server;
use crate::Verdict;
use crate::client::{Client, NetInfo};
use crate::output::{complain, positive_span, say, span};

/// Follow a net.
#[derive(Debug, Args)]
pub(crate) struct Watch {
    /// Its identifier, such as rpinet0.
    net: String,
    /// Shortest time between two reports of one value.
    #[arg(long, value_name = "TIME", default_value = "100ms", value_parser = span)]
    refresh: Duration,
    /// End after this time even if the net runs on.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    duration: Option<Duration>,
    #[command(flatten)]
    server: Server,
}

impl Watch {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut client = self.server.connect()?;
        client.subscribe(&self.net, self.refresh)?;
        let until = self.duration.map(|duration| Instant::now() + duration);
        loop {
            let left = until.map(|until| until.saturating_duration_since(Instant::now()));
            if left.is_some_and(|left| left.is_zero()) {
                return Ok(Verdict::Good);
            }
            let wait = left
                .unwrap_or(Duration::from_secs(1))
                .min(Duration::from_secs(1));
            if let Some(push) = client.next_push(wait)?
                && let Some(verdict) = self.print(&mut client, &push)?
            {
                return Ok(verdict);
            }
        }
    }

    /// Prints a push; returns how the net ended, if it did.
    fn print(&self, client: &mut Client, push: &Message) -> anyhow::Result<Option<Verdict>> {
        match (push.command.as_str(), push.args.first()) {
            ("ns", Some(Value::String(state))) => {
                say(state)?;
                match state.as_str() {
                    "TERMINATED" => self.print_end(client).map(Some),
                    "REJECTED" | "UNLOADED" => Ok(Some(Verdict::Failed)),
                    _ => Ok(None),
                }
            }
            ("nc", Some(Value::Map(values))) => {
                for (key, value) in values {
                    let key = key.strip_prefix("out").unwrap_or(key);
                    say(&format!("{key} {}", value.as_str().unwrap_or_default()))?;
                }
                Ok(None)
            }
            _ => Ok(None),
        }
    }

    fn print_end(&self, client: &mut Client) -> anyhow::Result<Verdict> {
        let Some(why) = client.end_of(&self.net)? else {
            return Ok(Verdict::Good);
        };
        complain(&format!("{} did not end by itself: {why}", self.net));
        Ok(Verdict::Failed)
    }
}

/// List nets.
#[derive(Debug, Args)]
pub(crate) struct List {
    /// Print one JSON array.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

impl List {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let nets = self.server.connect()?.nets()?;
        if self.json {
            let nets: Vec<_> = nets.iter().map(json).collect();
            say(&serde_json::Value::from(nets).to_string())?;
            return Ok(Verdict::Good);
        }
        if nets.is_empty() {
            say("no nets")?;
        }
        for net in nets {
            say(line(&net).trim_end())?;
        }
        Ok(Verdict::Good)
    }
}

fn json(net: &NetInfo) -> serde_json::Value {
    serde_json::json!({
        "net": net.id, "state": net.state, "description": net.description, "end": net.end,
    })
}

fn line(net: &NetInfo) -> String {
    let line = format!("{:<12} {:<11} {}", net.id, net.state, net.description);
    if net.end.is_empty() {
        line
    } else {
        format!("{line} (ended: {})", net.end)
    }
}

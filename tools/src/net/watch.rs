//! `takt net watch` and `takt net list`: what nets do. Nothing is changed.

use std::time::{Duration, Instant};

use clap::Args;
use takt_client::{Message, Value};
use takt_core::controller::STOPPED_BY_RULE;

use super::Server;
use crate::Verdict;
use crate::client::{Client, NetEnd, NetInfo};
use crate::output::{complain, positive_span, say, span};

/// Follow a net.
///
/// Prints each state, and each value whenever it changes, at most once per `--refresh`. Exit status 0 if the net ends by
/// itself, or because a scheduled net took over.
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
        let mut rejected = Rejected::default();
        let until = self.duration.map(|duration| Instant::now() + duration);
        loop {
            let left = until.map(|until| until.saturating_duration_since(Instant::now()));
            if left.is_some_and(|left| left.is_zero()) {
                return rejected.verdict(&mut client, &self.net, Verdict::Good);
            }
            let wait = left.unwrap_or(REJECTED_EVERY).min(REJECTED_EVERY);
            if let Some(push) = client.next_push(wait)?
                && let Some(verdict) = self.print(&mut client, &push)?
            {
                return rejected.verdict(&mut client, &self.net, verdict);
            }
            rejected.poll(&mut client, &self.net)?;
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
        let Some(NetEnd { why, successors }) = client.end_of(&self.net)? else {
            return Ok(Verdict::Good);
        };
        // A motion that another one takes over has done its part.
        if why == STOPPED_BY_RULE && !successors.is_empty() {
            say(&format!("taken over by {}", successors.join(", ")))?;
            return Ok(Verdict::Good);
        }
        complain(&format!("{} did not end by itself: {why}", self.net));
        let last = client.last_values(&self.net)?;
        if !last.is_empty() {
            complain(&format!(
                "last values, all at /nets/{}/last:\n{}",
                self.net,
                last.trim_end()
            ));
        }
        Ok(Verdict::Failed)
    }
}

/// Interval at which rejected set-points are asked for: they are no value of the net and are not pushed.
const REJECTED_EVERY: Duration = Duration::from_millis(500);

/// Rejected set-points that were printed.
#[derive(Debug, Default)]
struct Rejected {
    printed: usize,
    asked: Option<Instant>,
}

impl Rejected {
    fn poll(&mut self, client: &mut Client, net: &str) -> anyhow::Result<()> {
        if self
            .asked
            .is_some_and(|asked| asked.elapsed() < REJECTED_EVERY)
        {
            return Ok(());
        }
        self.asked = Some(Instant::now());
        let lines = client.rejected(net)?;
        for line in lines.iter().skip(self.printed) {
            complain(line);
        }
        self.printed = self.printed.max(lines.len());
        Ok(())
    }

    /// The verdict on a net with this one otherwise: a net whose set-points were rejected did not do what it was to.
    fn verdict(
        mut self,
        client: &mut Client,
        net: &str,
        otherwise: Verdict,
    ) -> anyhow::Result<Verdict> {
        self.asked = None;
        self.poll(client, net)?;
        Ok(if self.printed > 0 {
            Verdict::Failed
        } else {
            otherwise
        })
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

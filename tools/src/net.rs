//! `takt net`: check nets here, and load and control them in a running controller over its plain
//! TCP lines.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use clap::{Args, Subcommand};
use takt_core::CellConfig;
use takt_core::cell::DeviceConfig;
use takt_core::device::{DeviceTable, lwr};
use takt_net::{ArmBinding, Devices, JointLimits, Limits, LoadContext, load};
use takt_server::Value;

use crate::Verdict;
use crate::client::Client;
use crate::output::{complain, say, span};

/// Check, load and control primitive nets.
#[derive(Debug, Subcommand)]
pub(crate) enum Net {
    /// Check a net without a controller: all faults, with the places.
    Check(Check),
    /// Load a net and print its identifier.
    Load(Load),
    /// Start a net.
    Start(Target),
    /// Ask a running net to come to its end.
    Cancel(Target),
    /// End a net at once; drivers brake what it moved.
    Abort(Target),
    /// Forget a net that does not run.
    Unload(Target),
    /// Follow states and values of a net until it ends.
    Watch(Watch),
    /// List the nets of a controller.
    List(List),
}

impl Net {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            Self::Check(check) => check.run(),
            Self::Load(load) => load.run(),
            Self::Start(target) => target.command("nest"),
            Self::Cancel(target) => target.command("neca"),
            Self::Abort(target) => target.command("neab"),
            Self::Unload(target) => target.command("neun"),
            Self::Watch(watch) => watch.run(),
            Self::List(list) => list.run(),
        }
    }
}

/// Where the controller listens.
#[derive(Debug, Args)]
struct Server {
    /// Where the controller takes plain TCP connections.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8081")]
    server: String,
}

impl Server {
    fn connect(&self) -> anyhow::Result<Client> {
        Client::connect(&self.server)
    }
}

/// Check a net.
#[derive(Debug, Args)]
pub(crate) struct Check {
    /// The net; `-` for standard input.
    file: PathBuf,
    /// Devices are those of this cell; without it any robot is taken to exist, with 8 joints.
    #[arg(long, value_name = "cell.toml")]
    config: Option<PathBuf>,
    /// Time from one cycle of the net to the next.
    #[arg(long, default_value = "1ms", value_parser = span)]
    period: Duration,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

impl Check {
    fn run(self) -> anyhow::Result<Verdict> {
        let text = read(&self.file)?;
        let devices = self.devices()?;
        let registry = takt_core::registry();
        let context = LoadContext {
            registry: &registry,
            devices: &*devices,
            period: self.period,
            limits: Limits::default(),
        };
        let name = self.file.display().to_string();
        let checked = load(&text, &context);
        if self.json {
            say(&json(&name, &text, &checked).to_string())?;
        } else {
            match &checked {
                Ok(plan) => say(&format!("{name}: good, {} primitives", plan.primitives()))?,
                Err(rejection) => {
                    complain(rejection.render(&name, &text).trim_end());
                    complain(&format!("{name}: {} faults", rejection.faults.len()));
                }
            }
        }
        Ok(if checked.is_ok() {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }

    fn devices(&self) -> anyhow::Result<Box<dyn Devices>> {
        let Some(config) = &self.config else {
            return Ok(Box::new(AnyArm));
        };
        let mut table = DeviceTable::default();
        for DeviceConfig::Lwr(device) in CellConfig::read(config)?.devices {
            table.add_arm(lwr::describe(&device.name))?;
        }
        Ok(Box::new(table))
    }
}

fn json(
    name: &str,
    text: &str,
    checked: &Result<takt_net::Plan, takt_net::Rejection>,
) -> serde_json::Value {
    match checked {
        Ok(plan) => serde_json::json!({
            "ok": true, "file": name, "primitives": plan.primitives(), "bytes": plan.bytes(),
            "resources": plan.resources(), "faults": [],
        }),
        Err(rejection) => {
            let fault = |fault: &takt_net::Fault| {
                let (line, column) = fault.place(text);
                let (start, end) = (fault.at.start, fault.at.end);
                let what = fault.kind.to_string();
                serde_json::json!({
                    "line": line, "column": column, "start": start, "end": end, "text": what,
                })
            };
            let faults: Vec<_> = rejection.faults.iter().map(fault).collect();
            serde_json::json!({"ok": false, "file": name, "faults": faults})
        }
    }
}

/// Every robot exists, so that a net can be checked apart from its cell.
#[derive(Debug)]
struct AnyArm;

impl Devices for AnyArm {
    fn arm(&self, _name: &str) -> Option<ArmBinding> {
        let anything = JointLimits {
            position_min: f64::NEG_INFINITY,
            position_max: f64::INFINITY,
            velocity_max: f64::INFINITY,
            acceleration_max: f64::INFINITY,
        };
        let limits = Arc::from([anything; takt_core::device::ARM_JOINTS_MAX]);
        Some(ArmBinding {
            first_joint: 0,
            limits,
            kinematics: None,
        })
    }

    fn names(&self) -> Vec<String> {
        Vec::new()
    }
}

fn read(file: &Path) -> anyhow::Result<String> {
    if file == Path::new("-") {
        return std::io::read_to_string(std::io::stdin()).context("cannot read standard input");
    }
    std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))
}

/// Load a net.
#[derive(Debug, Args)]
pub(crate) struct Load {
    /// The net; `-` for standard input.
    file: PathBuf,
    /// Start it too.
    #[arg(long)]
    start: bool,
    #[command(flatten)]
    server: Server,
}

impl Load {
    fn run(self) -> anyhow::Result<Verdict> {
        let text = read(&self.file)?;
        let mut client = self.server.connect()?;
        let net = client.load(&text, &self.file.display().to_string())?;
        let faults = client.faults(&net)?;
        if !faults.is_empty() {
            for fault in &faults {
                complain(&format!("{}:{fault}", self.file.display()));
            }
            client.command("neun", &net)?;
            return Ok(Verdict::Failed);
        }
        say(&net)?;
        if self.start {
            client.command("nest", &net)?;
        }
        Ok(Verdict::Good)
    }
}

/// A loaded net.
#[derive(Debug, Args)]
pub(crate) struct Target {
    /// Its identifier, such as rpinet0.
    net: String,
    #[command(flatten)]
    server: Server,
}

impl Target {
    fn command(&self, command: &str) -> anyhow::Result<Verdict> {
        self.server.connect()?.command(command, &self.net)?;
        Ok(Verdict::Good)
    }
}

/// Follow a net.
#[derive(Debug, Args)]
pub(crate) struct Watch {
    /// Its identifier, such as rpinet0.
    net: String,
    /// Shortest time between two reports of one value.
    #[arg(long, default_value = "100ms", value_parser = span)]
    refresh: Duration,
    /// End after this time even if the net runs on.
    #[arg(long, value_parser = span)]
    duration: Option<Duration>,
    #[command(flatten)]
    server: Server,
}

impl Watch {
    fn run(self) -> anyhow::Result<Verdict> {
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
            let Some(push) = client.next_push(wait)? else {
                continue;
            };
            match (push.command.as_str(), push.args.first()) {
                ("ns", Some(Value::String(state))) => {
                    say(state)?;
                    if matches!(state.as_str(), "TERMINATED" | "REJECTED" | "UNLOADED") {
                        return Ok(Verdict::Good);
                    }
                }
                ("nc", Some(Value::Map(values))) => {
                    for (key, value) in values {
                        let text = value.as_str().unwrap_or_default();
                        say(&format!(
                            "{} {text}",
                            key.strip_prefix("out").unwrap_or(key)
                        ))?;
                    }
                }
                _ => {}
            }
        }
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
    fn run(self) -> anyhow::Result<Verdict> {
        let nets = self.server.connect()?.nets()?;
        if self.json {
            let nets: Vec<_> = nets
                .into_iter()
                .map(|net| {
                    let (id, state, description) = net;
                    serde_json::json!({"net": id, "state": state, "description": description})
                })
                .collect();
            say(&serde_json::Value::from(nets).to_string())?;
            return Ok(Verdict::Good);
        }
        if nets.is_empty() {
            say("no nets")?;
        }
        for (id, state, description) in nets {
            say(&format!("{id:<12} {state:<11} {description}"))?;
        }
        Ok(Verdict::Good)
    }
}

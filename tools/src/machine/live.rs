//! Machines of a running controller: load, start, stop, step, end, show, command and follow them. Each sends requests and
//! prints the answers; the controller steps the machine.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use clap::Args;
use takt_client::Value;

use super::{FILE_BYTES_MAX, compile, show};
use crate::Verdict;
use crate::client::Client;
use crate::net::server::Server;
use crate::output::{complain, say};

/// Interval at which a machine is polled.
const POLL_INTERVAL: Duration = Duration::from_millis(10);

/// How long a step may take to be counted; a period of a net thread is shorter.
const STEP_WITHIN: Duration = Duration::from_secs(2);

/// Load a machine.
#[derive(Debug, Args)]
pub(crate) struct Load {
    /// The machine; component files are relative to it.
    file: PathBuf,
    /// Set a parameter of the machine; may be given several times.
    #[arg(long, value_name = "NAME=VALUE")]
    param: Vec<String>,
    /// Property file of a component, TOML or `.cpf`; may be given several times.
    #[arg(long, value_name = "COMPONENT=FILE")]
    properties: Vec<String>,
    /// Start it too.
    #[arg(long)]
    start: bool,
    #[command(flatten)]
    server: Server,
}

/// A machine of a controller.
#[derive(Debug, Args)]
pub(crate) struct Target {
    /// Its name.
    machine: String,
    #[command(flatten)]
    server: Server,
}

/// Change a machine to its final state.
#[derive(Debug, Args)]
pub(crate) struct Stop {
    #[command(flatten)]
    target: Target,
    /// How long to wait for its end.
    #[arg(long, default_value = "10s", value_parser = takt_core::span::parse)]
    timeout: Duration,
}

/// Show machines.
#[derive(Debug, Args)]
pub(crate) struct State {
    /// Its name; all machines if none is given.
    machine: Option<String>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

/// Execute text commands.
#[derive(Debug, Args)]
pub(crate) struct Call {
    /// The machine.
    machine: String,
    /// Commands, executed one after the other: `servo.gain := 2`, `generator.start()`, `raise abort`.
    #[arg(required_unless_present = "script")]
    commands: Vec<String>,
    /// File of commands, one on each line; `wait 200ms` waits before the next one.
    #[arg(long, value_name = "FILE", conflicts_with = "commands")]
    script: Option<PathBuf>,
    #[command(flatten)]
    server: Server,
}

/// Follow a machine.
#[derive(Debug, Args)]
pub(crate) struct Watch {
    #[command(flatten)]
    target: Target,
    /// How long to follow it; else until it has ended.
    #[arg(long, value_parser = takt_core::span::parse)]
    duration: Option<Duration>,
}

fn read(file: &Path) -> anyhow::Result<String> {
    takt_core::files::read_text(file, FILE_BYTES_MAX)
        .with_context(|| format!("cannot read {}", file.display()))
}

fn pair(text: &str, expected: &str) -> anyhow::Result<(String, String)> {
    let pair = text.split_once('=');
    let (name, value) = pair.with_context(|| format!("`{text}`: {expected} is expected"))?;
    Ok((name.to_owned(), value.to_owned()))
}

impl Load {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let (text, compiled) = compile(&self.file)?;
        let name = self.file.display().to_string();
        // Errors are reported here, with their locations.
        let program = match compiled {
            Ok((program, _)) => program,
            Err(found) => {
                show(&found, &name, &text);
                return Ok(Verdict::Failed);
            }
        };
        let folder = self.file.parent().unwrap_or_else(|| Path::new(""));
        let mut files = BTreeMap::new();
        for member in program.members() {
            files.insert(member.file.clone(), read(&folder.join(&member.file))?);
        }
        let parameters = self.param.iter().map(|text| pair(text, "NAME=VALUE"));
        let parameters: Vec<_> = parameters.collect::<Result<_, _>>()?;
        let mut properties = Vec::new();
        for text in &self.properties {
            let (component, file) = pair(text, "COMPONENT=FILE")?;
            properties.push((component, read(Path::new(&file))?));
        }
        let mut client = self.server.connect()?;
        let args = [
            text.into(),
            Value::map_of(files),
            "s0".into(),
            Value::map_of(parameters),
            Value::map_of(properties),
        ];
        let reply = client.machine("mane", args)?;
        let loaded = reply.first().and_then(Value::as_str);
        let loaded = loaded.context("the controller gave no machine")?;
        say(loaded)?;
        if self.start {
            command(&mut client, loaded, "start")?;
        }
        Ok(Verdict::Good)
    }
}

fn command(client: &mut Client, machine: &str, text: &str) -> anyhow::Result<()> {
    client.machine("maco", [machine.into(), text.into()])?;
    Ok(())
}

/// A machine of the controller by its members.
fn described(client: &mut Client, machine: &str) -> anyhow::Result<BTreeMap<String, Value>> {
    let machines = all(client, Some(machine))?;
    let found = machines.into_iter().next().map(|(_, members)| members);
    found.with_context(|| format!("the controller did not describe {machine}"))
}

fn all(
    client: &mut Client,
    machine: Option<&str>,
) -> anyhow::Result<Vec<(String, BTreeMap<String, Value>)>> {
    let reply = client.machine("main", machine.map(Value::from))?;
    let Some(Value::Map(machines)) = reply.into_iter().next() else {
        return Ok(Vec::new());
    };
    let members = |(name, value)| match value {
        Value::Map(members) => Some((name, members)),
        Value::String(_) | Value::Integer(_) | Value::Float(_) | Value::List(_) => None,
    };
    Ok(machines.into_iter().filter_map(members).collect())
}

fn text<'m>(members: &'m BTreeMap<String, Value>, key: &str) -> &'m str {
    members.get(key).and_then(Value::as_str).unwrap_or_default()
}

/// The picture of a loaded machine, or of one inside, with its present state.
pub(super) fn graph(
    server: &Server,
    machine: &str,
    inside: Option<&str>,
) -> anyhow::Result<String> {
    let args = [machine].into_iter().chain(inside).map(Value::from);
    let reply = server.connect()?.machine("magr", args)?;
    let picture = reply.first().and_then(Value::as_str).map(str::to_owned);
    picture.context("the controller gave no picture")
}

impl Target {
    pub(super) fn command(&self, request: &str) -> anyhow::Result<Verdict> {
        command(&mut self.server.connect()?, &self.machine, request)?;
        Ok(Verdict::Good)
    }

    pub(super) fn step(&self) -> anyhow::Result<Verdict> {
        let mut client = self.server.connect()?;
        command(
            &mut client,
            &self.machine,
            &format!("{}.step()", self.machine),
        )?;
        // The step is executed once the controller counts another one.
        let begin = described(&mut client, &self.machine)?;
        let mut after = described(&mut client, &self.machine)?;
        let until = Instant::now() + STEP_WITHIN;
        while text(&after, "steps") == text(&begin, "steps") && Instant::now() < until {
            std::thread::sleep(POLL_INTERVAL);
            after = described(&mut client, &self.machine)?;
        }
        say(text(&after, "state"))?;
        Ok(Verdict::Good)
    }

    pub(super) fn end(&self) -> anyhow::Result<Verdict> {
        let name = self.machine.as_str();
        self.server.connect()?.machine("maen", [name.into()])?;
        Ok(Verdict::Good)
    }
}

impl Stop {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let name = &self.target.machine;
        let mut client = self.target.server.connect()?;
        command(&mut client, name, &format!("{name}.stop()"))?;
        let until = Instant::now() + self.timeout;
        loop {
            let now = described(&mut client, name)?;
            match text(&now, "status") {
                "finished" | "inactive" => return Ok(Verdict::Good),
                "failed" => {
                    complain(&format!("{name} failed {}", text(&now, "error")));
                    return Ok(Verdict::Failed);
                }
                _ if Instant::now() >= until => {
                    complain(&format!(
                        "{name} has not ended within {:?}; it is in state {}\nhint: `takt machine end {name}` ends it \
                         where it is",
                        self.timeout,
                        text(&now, "state")
                    ));
                    return Ok(Verdict::Failed);
                }
                _ => std::thread::sleep(POLL_INTERVAL),
            }
        }
    }
}

impl State {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut client = self.server.connect()?;
        let machines = all(&mut client, self.machine.as_deref())?;
        if self.json {
            let machines = machines.iter();
            let machines: serde_json::Map<_, _> = machines
                .map(|(name, members)| (name.clone(), json(&Value::Map(members.clone()))))
                .collect();
            say(&serde_json::Value::Object(machines).to_string())?;
            return Ok(Verdict::Good);
        }
        if machines.is_empty() {
            say("no machines")?;
        }
        for (name, members) in &machines {
            let (status, state) = (text(members, "status"), text(members, "state"));
            say(&format!("{name:<20} {status:<10} {state}"))?;
            if self.machine.is_some() {
                details(members)?;
            }
        }
        Ok(Verdict::Good)
    }
}

fn details(members: &BTreeMap<String, Value>) -> anyhow::Result<()> {
    let error = text(members, "error");
    if !error.is_empty() {
        say(&format!("last error {error}"))?;
    }
    let (cost, longest) = (
        text(members, "step_cost_us"),
        text(members, "longest_step_us"),
    );
    let components = text(members, "components_cost_us");
    say(&format!(
        "steps {}, transitions {}; a step costs up to {cost} us (longest {longest} us), its components {components} us",
        text(members, "steps"),
        text(members, "transitions"),
    ))?;
    let maps = |key: &str| members.get(key).and_then(Value::as_map);
    for (name, component) in maps("components").into_iter().flatten() {
        let part = |key: &str| {
            let part = component.as_map().and_then(|map| map.get(key));
            part.and_then(Value::as_str).unwrap_or_default().to_owned()
        };
        say(&format!(
            "  {name:<18} {:<16} {}",
            part("phase"),
            part("net")
        ))?;
    }
    for (name, value) in maps("variables").into_iter().flatten() {
        say(&format!(
            "  {name:<18} {}",
            value.as_str().unwrap_or_default()
        ))?;
    }
    Ok(())
}

fn json(value: &Value) -> serde_json::Value {
    match value {
        Value::String(text) => text.as_str().into(),
        Value::Integer(number) => (*number).into(),
        Value::Float(number) => (*number).into(),
        Value::List(items) => items.iter().map(json).collect(),
        Value::Map(map) => {
            let members = map.iter().map(|(key, value)| (key.clone(), json(value)));
            serde_json::Value::Object(members.collect())
        }
    }
}

impl Call {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut client = self.server.connect()?;
        let Some(script) = &self.script else {
            for text in &self.commands {
                command(&mut client, &self.machine, text)?;
            }
            return Ok(Verdict::Good);
        };
        for (number, line) in read(script)?.lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            let line = line.trim_end_matches(';').trim_end();
            let place = || format!("{}:{}", script.display(), number + 1);
            if let Some(time) = line.strip_prefix("wait ") {
                let time = takt_core::span::parse(time.trim());
                let time = time
                    .map_err(|why| anyhow::anyhow!("{why}"))
                    .with_context(place)?;
                std::thread::sleep(time);
            } else if !line.is_empty() {
                command(&mut client, &self.machine, line).with_context(place)?;
            }
        }
        Ok(Verdict::Good)
    }
}

impl Watch {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut client = self.target.server.connect()?;
        let name = &self.target.machine;
        let begin = Instant::now();
        let mut last = String::new();
        loop {
            let now = described(&mut client, name)?;
            let (status, state) = (text(&now, "status"), text(&now, "state"));
            let line = format!("{status:<10} {state}");
            if line != last {
                say(&format!("{:9.3} s  {line}", begin.elapsed().as_secs_f64()))?;
                last = line;
            }
            if status == "failed" {
                complain(&format!("{name} failed {}", text(&now, "error")));
                return Ok(Verdict::Failed);
            }
            let is_over = self.duration.is_some_and(|time| begin.elapsed() >= time);
            if status == "finished" || is_over {
                return Ok(Verdict::Good);
            }
            std::thread::sleep(POLL_INTERVAL);
        }
    }
}

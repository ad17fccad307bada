//! `takt machine`: check and draw machines here, without a controller; load and command them in a running one
//! ([`live`]).

mod live;

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::{Args, Subcommand};
use takt_machine::{Diagnostic, Diagnostics, Program};

use crate::Verdict;
use crate::output::{complain, say};

/// Largest file that is read, bytes: more than the compiler accepts.
const FILE_BYTES_MAX: u64 = 4 << 20;

/// Check, draw, load and command state machines.
#[derive(Debug, Subcommand)]
pub(crate) enum Machine {
    /// Check a machine and its components: all errors, with their locations.
    Check(Check),
    /// Load a machine with its components; print its name.
    Load(live::Load),
    /// Activate a machine and change it to automatic mode.
    Start(live::Target),
    /// Change a machine to its final state, and wait until it has ended.
    Stop(live::Stop),
    /// Execute one step of a machine.
    Step(live::Target),
    /// End a machine where it is, with its components; drivers brake what they moved.
    End(live::Target),
    /// Show machines: status, state, components, variables, costs.
    State(live::State),
    /// Execute text commands, such as `servo.gain := 2` or `generator.start()`.
    Call(live::Call),
    /// Follow the states of a machine until it has ended.
    Watch(live::Watch),
    /// Draw the states of a machine: an SVG on standard output, or DOT.
    Graph(Graph),
}

impl Machine {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            Self::Check(check) => check.run(),
            Self::Load(load) => load.run(),
            Self::Start(target) => target.command("start"),
            Self::Stop(stop) => stop.run(),
            Self::Step(target) => target.step(),
            Self::End(target) => target.end(),
            Self::State(state) => state.run(),
            Self::Call(call) => call.run(),
            Self::Watch(watch) => watch.run(),
            Self::Graph(graph) => graph.run(),
        }
    }
}

/// Check a machine.
#[derive(Debug, Args)]
pub(crate) struct Check {
    /// The machine; component files are relative to it.
    file: PathBuf,
    /// Exit with 1 if there are warnings.
    #[arg(long)]
    deny_warnings: bool,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// Draw a machine.
#[derive(Debug, Args)]
pub(crate) struct Graph {
    /// The machine; component files are relative to it. With `--live`, the name of a loaded one.
    file: PathBuf,
    /// Draw a machine of a controller, with its present state.
    #[arg(long, conflicts_with_all = ["state", "dot"])]
    live: bool,
    #[command(flatten)]
    server: crate::net::server::Server,
    /// Draw the machine of that name inside.
    #[arg(long, value_name = "NAME")]
    machine: Option<String>,
    /// Mark this state.
    #[arg(long, value_name = "STATE")]
    state: Option<String>,
    /// Print DOT, the language of graphviz, instead of an SVG.
    #[arg(long)]
    dot: bool,
}

type Compiled = Result<(Program, Diagnostics), Diagnostics>;

/// The text of a machine and what became of it.
fn compile(file: &Path) -> anyhow::Result<(String, Compiled)> {
    let text = takt_core::files::read_text(file, FILE_BYTES_MAX)
        .with_context(|| format!("cannot read {}", file.display()))?;
    let folder = file.parent().unwrap_or_else(|| Path::new(""));
    let library = |name: &str| {
        let read = takt_core::files::read_text(&folder.join(name), FILE_BYTES_MAX);
        read.map_err(|error| error.to_string())
    };
    let compiled = Program::compile(&text, &library);
    Ok((text, compiled))
}

fn show(found: &Diagnostics, name: &str, text: &str) {
    for diagnostic in found.all() {
        complain(diagnostic.render(name, text).trim_end());
    }
}

impl Check {
    fn run(self) -> anyhow::Result<Verdict> {
        let (text, compiled) = compile(&self.file)?;
        let name = self.file.display().to_string();
        let found = match &compiled {
            Ok((_, found)) | Err(found) => found,
        };
        if self.json {
            say(&json(&name, &text, &compiled).to_string())?;
        } else {
            show(found, &name, &text);
            match &compiled {
                Ok((program, _)) => {
                    say(&verdict_line(&name, program, found.all().len()))?;
                    let (worst, states) = (program.worst_step(), program.worst_states());
                    say(&format!(
                        "a step executes at most {worst} operations ({states})"
                    ))?;
                }
                Err(_) => complain(&format!(
                    "{name}: {}",
                    counted(found.all().len(), "finding")
                )),
            }
        }
        let is_good =
            compiled.is_ok_and(|(_, found)| !self.deny_warnings || found.all().is_empty());
        Ok(if is_good {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }
}

fn counted(count: usize, word: &str) -> String {
    format!("{count} {word}{}", if count == 1 { "" } else { "s" })
}

fn verdict_line(name: &str, program: &Program, findings: usize) -> String {
    let verdict = match findings {
        0 => "good".to_owned(),
        count => format!("no errors, {}", counted(count, "warning")),
    };
    let states: usize = (0..program.machines().count())
        .map(|m| program.states(m).count())
        .sum();
    format!(
        "{name}: {verdict}, {}, {}, {}",
        counted(program.members().len(), "component"),
        counted(states, "state"),
        counted(program.operations(), "operation"),
    )
}

fn json(name: &str, text: &str, compiled: &Compiled) -> serde_json::Value {
    let one = |found: &Diagnostic| {
        let (line, column) = found.location(text);
        serde_json::json!({
            "level": found.level.text().to_lowercase(), "line": line, "column": column,
            "start": found.at.start, "end": found.at.end, "text": found.text, "hint": found.hint,
        })
    };
    let list = |found: &Diagnostics| found.all().iter().map(one).collect::<Vec<_>>();
    match compiled {
        Err(found) => serde_json::json!({"ok": false, "file": name, "findings": list(found)}),
        Ok((program, found)) => {
            let machines = program.machines().enumerate().map(|(number, machine)| {
                serde_json::json!({"name": machine, "states": program.states(number).collect::<Vec<_>>()})
            });
            let members = program.members().iter();
            serde_json::json!({
                "ok": true, "file": name, "findings": list(found),
                "machines": machines.collect::<Vec<_>>(),
                "components": members.map(|member| member.name.as_str()).collect::<Vec<_>>(),
                "operations": program.operations(), "worst_step_operations": program.worst_step(),
            })
        }
    }
}

impl Graph {
    fn run(self) -> anyhow::Result<Verdict> {
        if self.live {
            let name = self.file.display().to_string();
            let picture = live::graph(&self.server, &name, self.machine.as_deref())?;
            say(picture.trim_end())?;
            return Ok(Verdict::Good);
        }
        let (text, compiled) = compile(&self.file)?;
        let name = self.file.display().to_string();
        let program = match compiled {
            Ok((program, _)) => program,
            Err(found) => {
                show(&found, &name, &text);
                return Ok(Verdict::Failed);
            }
        };
        let number = match &self.machine {
            None => 0,
            Some(wanted) => match program.machines().position(|machine| machine == wanted) {
                Some(number) => number,
                None => {
                    let known: Vec<&str> = program.machines().collect();
                    complain(&format!(
                        "there is no machine `{wanted}`\nhint: there are {}",
                        known.join(", ")
                    ));
                    return Ok(Verdict::Failed);
                }
            },
        };
        let state = match &self.state {
            None => None,
            Some(wanted) => match program.states(number).position(|state| state == wanted) {
                Some(state) => Some(state),
                None => {
                    let known: Vec<&str> = program.states(number).collect();
                    complain(&format!(
                        "there is no state `{wanted}`\nhint: there are {}",
                        known.join(", ")
                    ));
                    return Ok(Verdict::Failed);
                }
            },
        };
        if let Some(graph) = program.graph(number, state) {
            let picture = if self.dot { graph.dot() } else { graph.svg() };
            say(picture.trim_end())?;
        }
        Ok(Verdict::Good)
    }
}

//! `takt irl`: compile L-IRL programs, and run them: on a controller, or without one by robots that follow exactly.

mod live;
mod simulate;
mod values;
mod write;

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::{Args, Subcommand, ValueEnum};
use takt_irl::{Diagnostic, Program, System, compile, specification_of};

use crate::Verdict;
use crate::output::{complain, say};

/// Largest file that is read, bytes.
const FILE_MAX: u64 = 64 << 20;

/// Check, compile and try robot programs in L-IRL.
#[derive(Debug, Subcommand)]
pub(crate) enum Irl {
    /// Check a program: all errors, with their locations.
    Check(Check),
    /// Compile a program to object code.
    Compile(write::Compile),
    /// Print the listing of a program or of object code.
    Explain(write::Explain),
    /// Run a program or object code, in virtual time or on a controller.
    Run(Box<simulate::Simulate>),
}

impl Irl {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            Self::Check(check) => check.run(),
            Self::Compile(compile) => compile.run(),
            Self::Explain(explain) => explain.run(),
            Self::Run(simulate) => simulate.run(),
        }
    }
}

/// A program.
#[derive(Debug, Args)]
pub(crate) struct Source {
    /// The program, or its object code.
    file: PathBuf,
    /// The system specification; else the file that the program names, beside it.
    #[arg(long, value_name = "FILE")]
    spc: Option<PathBuf>,
    /// How errors and warnings of the program are written to standard error: with excerpts, or as one JSON object a line.
    #[arg(long, value_enum, value_name = "FORMAT", default_value_t = MessageFormat::Human)]
    message_format: MessageFormat,
}

/// How errors and warnings are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MessageFormat {
    /// For people.
    Human,
    /// For editors.
    Json,
}

/// Check a program.
#[derive(Debug, Args)]
pub(crate) struct Check {
    #[command(flatten)]
    source: Source,
    /// Exit with 1 if there are warnings.
    #[arg(long)]
    deny_warnings: bool,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// A program with its warnings, or the diagnostics of one with errors.
struct Checked {
    text: String,
    program: Option<Program>,
    diagnostics: Vec<Diagnostic>,
}

fn read_bytes(path: &Path) -> anyhow::Result<Vec<u8>> {
    takt_core::files::read(path, FILE_MAX)
        .with_context(|| format!("cannot read {}", path.display()))
}

impl Source {
    fn name(&self) -> String {
        self.file.display().to_string()
    }

    fn check(&self) -> anyhow::Result<Checked> {
        let bytes = read_bytes(&self.file)?;
        anyhow::ensure!(
            !bytes.starts_with(b"TIRL"),
            "{} is object code\nhint: name the source; `takt irl explain` lists object code",
            self.name()
        );
        let text = String::from_utf8(bytes)
            .with_context(|| format!("cannot read {}: it is not text in UTF-8", self.name()))?;
        let named = specification_of(&text);
        let system = match (&self.spc, &named) {
            (Some(path), _) => read_system(path)?,
            (None, None) => (System::default(), String::new()),
            (None, Some((name, at))) => {
                let folder = self.file.parent().unwrap_or_else(|| Path::new(""));
                match read_system(&folder.join(name)) {
                    Ok(system) => system,
                    // An error of the program, with its location.
                    Err(error) => {
                        let diagnostics =
                            vec![Diagnostic::specification(at.clone(), format!("{error:#}"))];
                        return Ok(Checked {
                            text,
                            program: None,
                            diagnostics,
                        });
                    }
                }
            }
        };
        let compiled = compile(&text, &system.0, &system.1);
        Ok(match compiled {
            Ok(compiled) => Checked {
                text,
                program: Some(compiled.program),
                diagnostics: compiled.warnings,
            },
            Err(rejection) => Checked {
                text,
                program: None,
                diagnostics: rejection.diagnostics,
            },
        })
    }

    /// The source text, unless the file is object code.
    fn text(&self) -> Option<String> {
        let text = takt_core::files::read_text(&self.file, FILE_MAX).ok();
        text.filter(|text| !text.starts_with("TIRL"))
    }

    /// The program; its errors have been printed if there is none.
    fn program(&self) -> anyhow::Result<Option<Program>> {
        let bytes = read_bytes(&self.file)?;
        if bytes.starts_with(b"TIRL") {
            let program = Program::decode(&bytes);
            return Ok(Some(program.with_context(|| self.name())?));
        }
        let checked = self.check()?;
        self.print(&checked);
        Ok(checked.program)
    }

    fn print(&self, checked: &Checked) {
        let name = &self.name();
        for diagnostic in &checked.diagnostics {
            match self.message_format {
                MessageFormat::Json => complain(&json_of(diagnostic, checked, name).to_string()),
                MessageFormat::Human => {
                    complain(diagnostic.render(name, &checked.text).trim_end());
                }
            }
        }
        if checked.program.is_none() && self.message_format == MessageFormat::Human {
            complain(&errors_of(checked, name));
        }
    }
}

/// A system specification and its text.
fn read_system(path: &Path) -> anyhow::Result<(System, String)> {
    let text = takt_core::files::read_text(path, FILE_MAX)
        .with_context(|| format!("cannot read {}", path.display()))?;
    let folder = path.parent().unwrap_or_else(|| Path::new(""));
    let system =
        System::read_in(&text, folder).with_context(|| format!("{} is invalid", path.display()))?;
    Ok((system, text))
}

fn errors_of(checked: &Checked, name: &str) -> String {
    let all = checked.diagnostics.iter();
    let errors = all.filter(|d| !d.code.is_warning()).count();
    let plural = if errors == 1 { "" } else { "s" };
    format!("{name}: {errors} error{plural}")
}

impl Check {
    fn run(self) -> anyhow::Result<Verdict> {
        let checked = self.source.check()?;
        let name = self.source.name();
        if self.json {
            say(&json(&checked, &name).to_string())?;
        } else {
            self.source.print(&checked);
            if let Some(program) = &checked.program {
                say(&summary(&name, program))?;
            }
        }
        let is_good = checked.diagnostics.is_empty() || !self.deny_warnings;
        Ok(if checked.program.is_some() && is_good {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }
}

fn summary(name: &str, program: &Program) -> String {
    format!(
        "{name}: good, {} instructions, {} thread{}, {} bytes of memory",
        program.instructions(),
        program.threads(),
        if program.threads() == 1 { "" } else { "s" },
        program.memory_bytes()
    )
}

/// The warning or error of a program.
fn json_of(d: &Diagnostic, checked: &Checked, name: &str) -> serde_json::Value {
    let (line, column) = d.location(&checked.text);
    serde_json::json!({
        "file": name, "code": d.code.text(), "severity": if d.code.is_warning() { "warning" } else { "error" },
        "line": line, "column": column, "start": d.at.start, "end": d.at.end,
        "text": d.text, "hint": d.hint,
    })
}

fn json(checked: &Checked, name: &str) -> serde_json::Value {
    let diagnostics = checked.diagnostics.iter();
    let diagnostics: Vec<_> = diagnostics.map(|d| json_of(d, checked, name)).collect();
    serde_json::json!({
        "ok": checked.program.is_some(), "file": name, "diagnostics": diagnostics,
        "instructions": checked.program.as_ref().map(Program::instructions),
        "threads": checked.program.as_ref().map(Program::threads),
        "bytes": checked.program.as_ref().map(Program::memory_bytes),
    })
}

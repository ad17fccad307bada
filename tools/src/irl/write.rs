//! `takt irl compile` and `explain`: what is written of a program. Nothing is executed here.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;

use super::{Source, summary};
use crate::Verdict;
use crate::output::say;

/// Compile a program.
#[derive(Debug, Args)]
pub(crate) struct Compile {
    #[command(flatten)]
    source: Source,
    /// Where the object code is written; else beside the program, with the extension `irlc`.
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
}

impl Compile {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let Some(program) = self.source.program()? else {
            return Ok(Verdict::Failed);
        };
        let beside = || self.source.file.with_extension("irlc");
        let path = self.output.clone().unwrap_or_else(beside);
        std::fs::write(&path, program.encode())
            .with_context(|| format!("cannot write {}", path.display()))?;
        say(&summary(&path.display().to_string(), &program))?;
        Ok(Verdict::Good)
    }
}

/// Print the listing of a program.
#[derive(Debug, Args)]
pub(crate) struct Explain {
    #[command(flatten)]
    source: Source,
}

impl Explain {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let Some(program) = self.source.program()? else {
            return Ok(Verdict::Failed);
        };
        say(program.listing().trim_end())?;
        Ok(Verdict::Good)
    }
}

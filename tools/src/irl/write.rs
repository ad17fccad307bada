//! `takt irl compile` and `explain`: what is written of a program. Nothing is executed here.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use takt_irl::Program;

use super::{Source, summary};
use crate::Verdict;
use crate::output::{save, say};

/// A form of object code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Form {
    /// What controllers execute.
    Code,
    /// A listing for people.
    Text,
    /// A listing for programs.
    Xml,
}

impl Form {
    fn of(self, program: &Program) -> Vec<u8> {
        match self {
            Self::Code => program.encode(),
            Self::Text => program.listing().into_bytes(),
            Self::Xml => program.listing_xml().into_bytes(),
        }
    }

    const fn extension(self) -> &'static str {
        match self {
            Self::Code => "irlc",
            Self::Text => "lst",
            Self::Xml => "xml",
        }
    }
}

/// Compile a program.
#[derive(Debug, Args)]
pub(crate) struct Compile {
    #[command(flatten)]
    source: Source,
    /// What is written: object code, or its listing.
    #[arg(long, value_enum, default_value_t = Form::Code)]
    emit: Form,
    /// Where it is written; else beside the program, with the extension `irlc`, `lst` or `xml`.
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
}

impl Compile {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let Some(program) = self.source.program()? else {
            return Ok(Verdict::Failed);
        };
        let beside = || self.source.file.with_extension(self.emit.extension());
        let path = self.output.clone().unwrap_or_else(beside);
        save(&path, self.emit.of(&program))?;
        say(&summary(&path.display().to_string(), &program))?;
        Ok(Verdict::Good)
    }
}

/// Print the listing of a program.
#[derive(Debug, Args)]
pub(crate) struct Explain {
    #[command(flatten)]
    source: Source,
    /// Print it as XML.
    #[arg(long)]
    xml: bool,
}

impl Explain {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let Some(program) = self.source.program()? else {
            return Ok(Verdict::Failed);
        };
        let listing = if self.xml {
            program.listing_xml()
        } else {
            program.listing()
        };
        say(listing.trim_end())?;
        Ok(Verdict::Good)
    }
}

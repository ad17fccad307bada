#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod bench;
mod cargo;
mod ci;
mod metadata;
mod parts;
mod test;
mod tidy;
mod tree;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Developer tasks of this workspace. Exit 0 good, 1 a check failed, 2 usage or environment.
#[derive(Debug, Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Cli {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// All that must hold before a change goes in: fmt, tidy, clippy, tests, doc, unchanged tree
    Ci,
    /// The rules of this workspace that no other tool checks
    Tidy,
    /// Tests of some parts (default all), with their doctests and loom models
    Test {
        /// Which parts
        #[arg(value_parser = parts::names())]
        parts: Vec<String>,
    },
    /// The benchmarks of one part
    Bench {
        /// Which part
        #[arg(value_parser = parts::names())]
        part: String,
        /// Print one line of JSON last
        #[arg(long)]
        json: bool,
    },
    /// Run the tests of some parts (default all) and rewrite their golden files
    Bless {
        /// Which parts
        #[arg(value_parser = parts::names())]
        parts: Vec<String>,
    },
}

fn main() -> ExitCode {
    match perform(&Cli::parse().task) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            cargo::note(&format!("error: {error:#}"));
            ExitCode::from(2)
        }
    }
}

fn perform(task: &Task) -> anyhow::Result<bool> {
    let root = cargo::workspace_root()?;
    match task {
        Task::Ci => ci::run(&root),
        Task::Tidy => tidy::run(&root),
        Task::Test { parts } => test::run(&root, parts, test::Golden::Compare),
        Task::Bench { part, json } => bench::run(&root, part, *json),
        Task::Bless { parts } => test::run(&root, parts, test::Golden::Rewrite),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_line_is_consistent() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }
}

#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod bench;
mod binaries;
mod cargo;
mod ci;
mod deb;
mod environments;
mod fuzz;
mod metadata;
mod page;
mod parts;
mod python;
mod shell;
mod soak;
mod test;
mod tidy;
mod tree;
mod vm;

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
    /// Run every input format with seeded random inputs
    ///
    /// The same functions as in `cargo xtask test`, but more inputs; from a million on in optimized code. Prints the
    /// inputs per second of each target; a failure prints its input.
    Fuzz {
        /// Only the tests whose names contain this
        #[arg(default_value = "stand")]
        filter: String,
        /// Inputs for each target
        #[arg(long, default_value_t = fuzz::COUNT)]
        count: u64,
        /// Another seed gives other inputs
        #[arg(long, default_value_t = 0)]
        seed: u64,
    },
    /// A whole emulated application many times, with random seeds and faults; prints a table
    ///
    /// An assembly takes about a minute and a half, less if a fault ends it.
    Soak(soak::Soak),
    /// The Debian package, checked by lintian where that is installed
    Deb,
    /// Run a command in a virtual machine with Debian's PREEMPT_RT kernel and this checkout
    /// Installs missing packages on Debian and derivatives if run by root. Exits with the command's status, 124 on
    /// timeout, 2 if no machine can run here.
    Vm {
        /// Timeout, s
        #[arg(long, default_value_t = 600)]
        seconds: u64,
        /// The command, with vcan0 and vcan1 up
        #[arg(required = true, trailing_var_arg = true)]
        command: Vec<String>,
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
        Ok(status) => ExitCode::from(status),
        Err(error) => {
            cargo::note(&format!("error: {error:#}"));
            ExitCode::from(2)
        }
    }
}

fn perform(task: &Task) -> anyhow::Result<u8> {
    let root = cargo::workspace_root()?;
    let good = match task {
        Task::Vm { seconds, command } => return vm::run(&root, command, *seconds),
        Task::Deb => deb::run(&root),
        Task::Ci => ci::run(&root),
        Task::Tidy => tidy::run(&root),
        Task::Test { parts } => test::run(&root, parts, test::Golden::Compare),
        Task::Fuzz {
            filter,
            count,
            seed,
        } => fuzz::run(&root, filter, *count, *seed),
        Task::Soak(soak) => soak::run(&root, soak),
        Task::Bench { part, json } => bench::run(&root, part, *json),
        Task::Bless { parts } => test::run(&root, parts, test::Golden::Rewrite),
    };
    Ok(u8::from(!good?))
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

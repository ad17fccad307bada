//! Child processes and printed lines. Each cargo line is shown before it runs, so that it can be repeated by hand.

use std::ffi::OsString;
use std::fmt;
use std::io::{self, BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::Context;

/// One cargo invocation, run in the workspace's root.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cargo {
    args: Vec<String>,
    envs: Vec<(String, String)>,
}

impl Cargo {
    /// Splits `line` at blanks; for arguments with blanks use [`Cargo::arg`].
    pub(crate) fn new(line: &str) -> Self {
        let args = line.split_whitespace().map(String::from).collect();
        Self {
            args,
            envs: Vec::new(),
        }
    }

    pub(crate) fn arg(mut self, arg: &str) -> Self {
        self.args.push(arg.to_owned());
        self
    }

    pub(crate) fn args<'a>(self, args: impl IntoIterator<Item = &'a str>) -> Self {
        args.into_iter().fold(self, Self::arg)
    }

    pub(crate) fn env(mut self, name: &str, value: &str) -> Self {
        self.envs.push((name.to_owned(), value.to_owned()));
        self
    }

    /// Runs to the end; true on success.
    pub(crate) fn succeeds(&self, root: &Path) -> anyhow::Result<bool> {
        note(&format!("+ {self}"));
        let _took = Took::from_now();
        let status = self.command(root).status().context("cannot start cargo")?;
        Ok(status.success())
    }

    /// As [`Cargo::succeeds`], passing each line of its standard output to `take`.
    pub(crate) fn lines(&self, root: &Path, mut take: impl FnMut(&str)) -> anyhow::Result<bool> {
        note(&format!("+ {self}"));
        let _took = Took::from_now();
        let mut child = self
            .command(root)
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start cargo")?;
        if let Some(stdout) = child.stdout.take() {
            for line in BufReader::new(stdout).split(b'\n') {
                take(&String::from_utf8_lossy(
                    &line.context("cannot read cargo's output")?,
                ));
            }
        }
        Ok(child.wait().context("cannot wait for cargo")?.success())
    }

    fn command(&self, root: &Path) -> Command {
        let program = std::env::var_os("CARGO").unwrap_or_else(|| OsString::from("cargo"));
        let mut command = Command::new(program);
        command.args(&self.args).current_dir(root);
        for (name, value) in &self.envs {
            command.env(name, value);
        }
        command
    }
}

impl fmt::Display for Cargo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (name, value) in &self.envs {
            write!(f, "{name}={} ", quoted(value))?;
        }
        f.write_str("cargo")?;
        for arg in &self.args {
            write!(f, " {}", quoted(arg))?;
        }
        Ok(())
    }
}

/// Quotes a word for a shell.
fn quoted(word: &str) -> String {
    if word.contains([' ', '*']) {
        format!("'{word}'")
    } else {
        word.to_owned()
    }
}

/// The root of the workspace whose xtask this is.
pub(crate) fn workspace_root() -> anyhow::Result<PathBuf> {
    let manifest = std::env::var_os("CARGO_MANIFEST_DIR")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")), PathBuf::from);
    let root = manifest
        .ancestors()
        .nth(2)
        .context("xtask is not in <root>/tools/xtask")?;
    Ok(root.to_owned())
}

/// Cargo's target directory, as an absolute path.
pub(crate) fn target_dir(root: &Path) -> PathBuf {
    root.join(std::env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| OsString::from("target")))
}

/// Notes how long a child process took, if it was long enough to matter.
#[derive(Debug)]
pub(crate) struct Took(Instant);

impl Took {
    pub(crate) fn from_now() -> Self {
        Self(Instant::now())
    }
}

impl Drop for Took {
    fn drop(&mut self) {
        let took = self.0.elapsed().as_secs();
        if took >= 5 {
            note(&format!("took {took} s"));
        }
    }
}

/// Prints a result on standard output. A closed pipe is no error.
pub(crate) fn say(line: &str) {
    let _ = writeln!(io::stdout(), "{line}");
}

/// Prints progress on standard error.
pub(crate) fn note(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cargo_line_displays_in_shell_syntax() {
        let cargo = Cargo::new("test -p takt-rt")
            .arg("fri*")
            .env("RUSTFLAGS", "--cfg loom");
        assert_eq!(
            cargo.to_string(),
            "RUSTFLAGS='--cfg loom' cargo test -p takt-rt 'fri*'"
        );
    }

    #[test]
    fn root_holds_the_workspace_manifest() {
        let root = workspace_root().unwrap();
        let manifest = std::fs::read_to_string(root.join("Cargo.toml")).unwrap();
        assert!(manifest.contains("[workspace]"));
    }

    #[test]
    fn output_comes_line_by_line() {
        let root = workspace_root().unwrap();
        let mut lines = Vec::new();
        assert!(
            Cargo::new("--version")
                .lines(&root, |line| lines.push(line.to_owned()))
                .unwrap()
        );
        assert!(lines[0].starts_with("cargo "));
    }
}

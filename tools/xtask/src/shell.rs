//! Programs other than cargo: each line is shown before it runs, so that it can be repeated by hand. Output is not
//! interpreted.

use std::ffi::{OsStr, OsString};
use std::fmt;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;

use anyhow::Context;

use crate::cargo::{Took, note};

/// Exit status on timeout, see [`Line::limited`].
pub(crate) const TIMEOUT_STATUS: u8 = 124;

/// A program with its arguments.
#[derive(Clone, Debug)]
pub(crate) struct Line {
    words: Vec<OsString>,
    env: Vec<(&'static str, String)>,
    folder: Option<PathBuf>,
    quiet: bool,
    relayed: bool,
}

impl Line {
    pub(crate) fn new(program: impl AsRef<OsStr>) -> Self {
        Self {
            words: vec![program.as_ref().to_owned()],
            env: Vec::new(),
            folder: None,
            quiet: false,
            relayed: false,
        }
    }

    pub(crate) fn arg(mut self, word: impl AsRef<OsStr>) -> Self {
        self.words.push(word.as_ref().to_owned());
        self
    }

    pub(crate) fn args<W: AsRef<OsStr>>(self, words: impl IntoIterator<Item = W>) -> Self {
        words.into_iter().fold(self, Self::arg)
    }

    pub(crate) fn env(mut self, name: &'static str, value: &str) -> Self {
        self.env.push((name, value.to_owned()));
        self
    }

    /// Hides its standard output.
    pub(crate) fn quiet(mut self) -> Self {
        self.quiet = true;
        self
    }

    /// Runs it on pipes and copies their content: for a program that opens its standard streams by name, and so would
    /// truncate files behind them.
    pub(crate) fn relayed(mut self) -> Self {
        self.relayed = true;
        self
    }

    /// Sets the working directory.
    pub(crate) fn within(mut self, folder: &Path) -> Self {
        self.folder = Some(folder.to_owned());
        self
    }

    /// Adds a timeout; the exit status is then [`TIMEOUT_STATUS`].
    pub(crate) fn limited(self, seconds: u64) -> Self {
        let mut words = vec!["timeout".into(), "--kill-after=10".into()];
        words.push(seconds.to_string().into());
        words.extend(self.words.iter().cloned());
        Self { words, ..self }
    }

    /// Runs to the end and returns the exit status; 1 if a signal ended it.
    pub(crate) fn status(&self) -> anyhow::Result<u8> {
        note(&format!("+ {self}"));
        let _took = Took::from_now();
        let mut command = self.command();
        if self.relayed {
            command.stdout(Stdio::piped());
        }
        let (mut child, errors) = self.spawn(&mut command)?;
        if let Some(stdout) = child.stdout.take() {
            relay(stdout, std::io::stdout());
        }
        end(child, errors)
    }

    /// Runs to the end; true on success.
    pub(crate) fn succeeds(&self) -> anyhow::Result<bool> {
        Ok(self.status()? == 0)
    }

    /// As [`Line::succeeds`], without showing the line: for queries.
    pub(crate) fn answers(self) -> bool {
        let mut command = self.quiet().command();
        let status = command.stderr(Stdio::null()).status();
        status.is_ok_and(|status| status.success())
    }

    /// As [`Line::status`], passing each line of its standard output to `take`.
    pub(crate) fn lines(&self, mut take: impl FnMut(&str)) -> anyhow::Result<u8> {
        note(&format!("+ {self}"));
        let _took = Took::from_now();
        let mut command = self.command();
        let (mut child, errors) = self.spawn(command.stdout(Stdio::piped()))?;
        if let Some(stdout) = child.stdout.take() {
            for line in BufReader::new(stdout).split(b'\n') {
                let line = line.context("cannot read its output")?;
                take(String::from_utf8_lossy(&line).trim_end_matches('\r'));
            }
        }
        end(child, errors)
    }

    /// Starts it, with a thread that copies its standard error if relayed.
    fn spawn(&self, command: &mut Command) -> anyhow::Result<(Child, Option<JoinHandle<()>>)> {
        if self.relayed {
            command.stderr(Stdio::piped());
        }
        let mut child = command.spawn().with_context(|| self.failure())?;
        let errors = child.stderr.take();
        let errors = errors.map(|stderr| std::thread::spawn(|| relay(stderr, std::io::stderr())));
        Ok((child, errors))
    }

    fn command(&self) -> Command {
        let mut command = Command::new(&self.words[0]);
        command.args(&self.words[1..]).stdin(Stdio::null());
        command.envs(self.env.iter().map(|(name, value)| (name, value)));
        if self.quiet {
            command.stdout(Stdio::null());
        }
        if let Some(folder) = &self.folder {
            command.current_dir(folder);
        }
        command
    }

    fn failure(&self) -> String {
        format!("cannot start {}", self.words[0].to_string_lossy())
    }
}

/// Copies until the end of the input. A closed pipe is no error.
fn relay(mut from: impl Read, mut to: impl Write) {
    let mut buffer = [0; 4096];
    while let Ok(len @ 1..) = from.read(&mut buffer) {
        let _ = to.write_all(buffer.get(..len).unwrap_or_default());
        let _ = to.flush();
    }
}

fn end(mut child: Child, errors: Option<JoinHandle<()>>) -> anyhow::Result<u8> {
    let status = child.wait().context("cannot wait for it")?;
    if let Some(errors) = errors {
        // A panic in that thread has already been reported.
        let _ = errors.join();
    }
    Ok(code(status))
}

fn code(status: std::process::ExitStatus) -> u8 {
    status
        .code()
        .and_then(|code| u8::try_from(code).ok())
        .unwrap_or(1)
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (name, value) in &self.env {
            write!(f, "{name}={} ", quoted(value))?;
        }
        for (index, word) in self.words.iter().enumerate() {
            let space = if index == 0 { "" } else { " " };
            write!(f, "{space}{}", quoted(&word.to_string_lossy()))?;
        }
        Ok(())
    }
}

/// Quotes a word for a shell.
pub(crate) fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

/// Whether a program is in the search path.
pub(crate) fn exists(program: &str) -> bool {
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path).any(|folder| folder.join(program).is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shell_words_are_quoted() {
        assert_eq!(quoted("--memory=1G"), "--memory=1G");
        assert_eq!(quoted(""), "''");
        assert_eq!(quoted("it's $HOME"), r"'it'\''s $HOME'");
        let line = Line::new("vng").arg("--").arg("echo a").limited(9);
        assert_eq!(
            line.to_string(),
            "timeout --kill-after=10 9 vng -- 'echo a'"
        );
    }

    #[test]
    fn shell_line_returns_status_and_output() {
        let line = Line::new("sh").args(["-c", "echo one; echo two; exit 7"]);
        let mut lines = Vec::new();
        assert_eq!(line.lines(|line| lines.push(line.to_owned())).unwrap(), 7);
        assert_eq!(lines, ["one", "two"]);
        let relayed = Line::new("sh").args(["-c", "echo one >&2; echo two; exit 3"]);
        assert_eq!(relayed.relayed().status().unwrap(), 3);
        let endless = Line::new("sleep").arg("60").limited(0);
        assert_eq!(Line::new("true").status().unwrap(), 0);
        assert!(endless.to_string().starts_with("timeout"));
        assert!(exists("sh") && !exists("no-such-program"));
    }
}

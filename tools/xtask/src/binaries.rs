//! Test binaries that cargo built, and their tests. It runs none: a script does, so that it can run in another environment.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::cargo::{Cargo, note};
use crate::shell::quoted;

/// A test binary that cargo built.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Binary {
    pub(crate) program: PathBuf,
    /// Folder of its package, where cargo runs it.
    pub(crate) folder: PathBuf,
}

/// Binaries built by cargo lines.
#[derive(Debug, Default)]
pub(crate) struct Built {
    pub(crate) tests: Vec<Binary>,
    /// The program `takt`, for the tests of its package.
    pub(crate) takt: Option<PathBuf>,
}

impl Built {
    /// Queries cargo for the binaries of these lines.
    pub(crate) fn by(root: &Path, lines: &[Cargo]) -> anyhow::Result<Self> {
        let mut built = Self::default();
        for line in lines {
            let line = line.clone().arg("--no-run").arg("--message-format=json");
            let good = line.lines(root, |text| built.take(text))?;
            if !good {
                note("some targets do not build and are not run in other environments");
            }
        }
        Ok(built)
    }

    fn take(&mut self, message: &str) {
        self.tests.extend(binary(message));
        self.takt = program_of(message, "takt").or_else(|| self.takt.take());
    }
}

fn program_of(message: &str, name: &str) -> Option<PathBuf> {
    let message: Value = serde_json::from_str(message).ok()?;
    let is_it = message["target"]["name"] == name
        && message["target"]["kind"][0] == "bin"
        && message["profile"]["test"] == false;
    message["executable"]
        .as_str()
        .filter(|_| is_it)
        .map(PathBuf::from)
}

fn binary(message: &str) -> Option<Binary> {
    let message: Value = serde_json::from_str(message).ok()?;
    let is_test = message["profile"]["test"] == true;
    let program = message["executable"].as_str().filter(|_| is_test)?;
    let manifest = Path::new(message["manifest_path"].as_str()?);
    Some(Binary {
        program: program.into(),
        folder: manifest.parent()?.to_owned(),
    })
}

impl Binary {
    /// Full names of its tests; empty if it does not list them as libtest does.
    pub(crate) fn tests(&self) -> Vec<String> {
        let mut list = Command::new(&self.program);
        list.args(["--list", "--format=terse"])
            .current_dir(&self.folder)
            .stdin(Stdio::null());
        let text = list.output().map(|output| output.stdout);
        let text = text.unwrap_or_default();
        let names = String::from_utf8_lossy(&text);
        let names = names.lines().filter_map(|line| line.strip_suffix(": test"));
        names.map(str::to_owned).collect()
    }
}

/// Tests of a binary to run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TestRun {
    pub(crate) binary: Binary,
    /// Full names; empty for all tests of the binary.
    pub(crate) tests: Vec<String>,
}

impl TestRun {
    /// A script line that sets the variable `bad` on failure. Selected tests run one at a time, as they share the bus.
    fn line(&self) -> String {
        let folder = quoted(&self.binary.folder.to_string_lossy());
        let program = quoted(&self.binary.program.to_string_lossy());
        let mut line = format!("cd {folder} && CARGO_MANIFEST_DIR={folder} {program}");
        if !self.tests.is_empty() {
            line.push_str(" --test-threads=1 --exact");
        }
        for test in &self.tests {
            line.push(' ');
            line.push_str(&quoted(test));
        }
        line + " || bad=1\n"
    }
}

/// The script that runs all of them in sequence; its exit status is 1 if one failed.
pub(crate) fn script(test_runs: &[TestRun], skips: &Path) -> String {
    let skips = quoted(&skips.to_string_lossy());
    let lines: String = test_runs.iter().map(TestRun::line).collect();
    format!("export TAKT_SKIPS={skips}\nbad=0\n{lines}exit $bad\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cargo_message_names_binary_and_folder() {
        let message = r#"{"reason":"compiler-artifact","manifest_path":"/c/can/Cargo.toml",
            "target":{"name":"vcan"},"profile":{"test":true},"executable":"/t/vcan-1"}"#;
        let found = binary(message).unwrap();
        assert_eq!(
            (found.program.as_path(), found.folder.as_path()),
            (Path::new("/t/vcan-1"), Path::new("/c/can"))
        );
        assert_eq!(binary(&message.replace("true", "false")), None);
        assert_eq!(binary(&message.replace("\"/t/vcan-1\"", "null")), None);
        assert_eq!(binary("running 2 tests"), None);
    }

    #[test]
    fn cargo_message_names_program() {
        let message = r#"{"reason":"compiler-artifact","manifest_path":"/c/tools/Cargo.toml",
            "target":{"name":"takt","kind":["bin"]},"profile":{"test":false},"executable":"/t/takt"}"#;
        assert_eq!(program_of(message, "takt"), Some("/t/takt".into()));
        assert_eq!(program_of(message, "other"), None);
        // The program's own test binary has the same name.
        assert_eq!(program_of(&message.replace("false", "true"), "takt"), None);
    }

    #[test]
    fn binary_lists_its_tests() {
        let this = Binary {
            program: std::env::current_exe().unwrap(),
            folder: env!("CARGO_MANIFEST_DIR").into(),
        };
        let name = "binaries::tests::binary_lists_its_tests";
        assert!(this.tests().iter().any(|test| test == name));
    }

    #[test]
    fn script_bad_binary_fails_and_hides_none() {
        let test_run = |name: &str, tests: &[&str]| TestRun {
            binary: Binary {
                program: PathBuf::from(format!("/t/{name}")),
                folder: "/c".into(),
            },
            tests: tests.iter().map(ToString::to_string).collect(),
        };
        let text = script(
            &[test_run("a", &[]), test_run("b", &["x::y", "z"])],
            Path::new("/t/s"),
        );
        assert_eq!(text.matches("|| bad=1").count(), 2);
        assert!(text.ends_with("exit $bad\n"), "{text}");
        assert!(
            text.contains("/t/b --test-threads=1 --exact x::y z ||"),
            "{text}"
        );
        assert!(text.contains("/t/a ||"), "{text}");
    }
}

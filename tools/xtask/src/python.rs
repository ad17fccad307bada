//! The Python package: its wheel is built from the tree and tested in a virtual environment of its own, with the types of
//! its stubs. What the host lacks is installed where that is possible, else the tests are skipped.

use std::path::{Path, PathBuf};

use crate::cargo::{self, Cargo, note};
use crate::shell::Line;
use crate::test::tally::Tally;
use crate::vm::{self, Unavailable};

/// The package, relative to the root.
const PACKAGE: &str = "rcc/python";
/// Pinned versions of all that the tests need.
const REQUIREMENTS: &str = include_str!("../../../rcc/python/requirements.txt");
/// Programs of the suite. They are built as the tests of the workspace are, so that nothing is compiled twice.
const PROGRAMS: &str = "build --workspace --all-features --example controller --example explain --example begin --example urdf --bin takt";
/// Longest run of the suite, s.
const SUITE_MAX: u64 = 1500;

/// Tests the package and counts its tests; each type checker is one.
pub(crate) fn test(root: &Path) -> anyhow::Result<Tally> {
    let python = match environment(root)? {
        Ok(python) => python,
        Err(Unavailable(why)) => return Ok(Tally::skipped(&format!("Python package: {why}"))),
    };
    let mut tally = Tally::default();
    if !Cargo::new(PROGRAMS).succeeds(root)? || !install(root, &python)? {
        tally.failed += 1;
        return Ok(tally);
    }
    let tool = |module: &str| {
        Line::new(&python)
            .args(["-m", module])
            .within(&root.join(PACKAGE))
            .env("PYTHONDONTWRITEBYTECODE", "1")
    };
    let suite = tool("pytest").args(["-p", "no:cacheprovider", "--tb=short", "-rfEs", "-q"]);
    let suite = suite.env(
        "CARGO_TARGET_DIR",
        &cargo::target_dir(root).to_string_lossy(),
    );
    let mut counts = run(suite.clone())?;
    for test in std::mem::take(&mut counts.failures) {
        // A host that stalls fails tests that move robots: those that pass alone, twice, have passed.
        let again = || run(suite.clone().arg(&test));
        if again()?.failed == 0 && again()?.failed == 0 {
            counts.pass_repeated(&test, 2);
        }
    }
    tally.add(counts);
    let cache = cargo::target_dir(root).join("python/mypy");
    let mypy = tool("mypy").arg("--cache-dir").arg(cache);
    let pyright = tool("pyright").arg("--pythonpath").arg(&python);
    for checker in [mypy, pyright] {
        if checker.succeeds()? {
            tally.passed += 1;
        } else {
            tally.failed += 1;
        }
    }
    Ok(tally)
}

/// Runs pytest; the failures are names that it accepts.
fn run(suite: Line) -> anyhow::Result<Tally> {
    let (mut counts, mut failures) = (Tally::default(), Vec::new());
    let status = suite.limited(SUITE_MAX).lines(|line| {
        cargo::say(line);
        if let Some(read) = summary(line) {
            counts = read;
        }
        failures.extend(failure(line));
    })?;
    // A run that crashed has no summary.
    if status != 0 && counts.failed == 0 {
        counts.failed = 1;
    }
    counts.failures = failures;
    Ok(counts)
}

/// The test of a line such as `FAILED tests/test_motion.py::test_ptp - assert 1 == 2`.
fn failure(line: &str) -> Option<String> {
    let rest = line
        .strip_prefix("FAILED ")
        .or_else(|| line.strip_prefix("ERROR "))?;
    let test = rest.split(" - ").next()?;
    test.contains("::").then(|| test.to_owned())
}

/// Builds the wheel and installs it. Cargo compiles its crates apart from those of the workspace: with the features that the
/// package requests, as a user's `pip install` does, and not those that other crates and tests add; and pyo3 once more, since
/// maturin describes the interpreter to it.
fn install(root: &Path, python: &Path) -> anyhow::Result<bool> {
    let wheels = cargo::target_dir(root).join("python/wheels");
    // A wheel of an earlier version must not be taken for the new one.
    let _ = std::fs::remove_dir_all(&wheels);
    let build = Line::new(python)
        .args(["-m", "maturin", "build", "--profile", "dev", "--out"])
        .arg(&wheels)
        .within(&root.join(PACKAGE));
    if !build.succeeds()? {
        return Ok(false);
    }
    let files = std::fs::read_dir(&wheels)?.flatten();
    let install = Line::new(python)
        .args([
            "-m",
            "pip",
            "install",
            "--quiet",
            "--force-reinstall",
            "--no-deps",
        ])
        .args(files.map(|file| file.path()));
    install.succeeds()
}

/// The Python of an environment with the requirements.
fn environment(root: &Path) -> anyhow::Result<Result<PathBuf, Unavailable>> {
    let folder = cargo::target_dir(root).join("python/venv");
    let (python, complete) = (folder.join("bin/python3"), folder.join("complete"));
    if std::fs::read_to_string(&complete).is_ok_and(|has| has == REQUIREMENTS) {
        return Ok(Ok(python));
    }
    let debian = vm::packages(&["python3", "python3-venv"])?;
    // Without Debian's packages another Python may do.
    let host = if debian.is_ok() {
        "/usr/bin/python3"
    } else {
        "python3"
    };
    let make = Line::new(host).args(["-m", "venv", "--clear"]).arg(&folder);
    if !make.succeeds().unwrap_or(false) {
        let why = || Unavailable("needs python3 with venv".to_owned());
        return Ok(Err(debian.err().unwrap_or_else(why)));
    }
    let fetch = Line::new(&python)
        .args(["-m", "pip", "install", "--quiet", "--requirement"])
        .arg(root.join(PACKAGE).join("requirements.txt"));
    if !fetch.succeeds()? {
        let why = "needs the packages of rcc/python/requirements.txt, and pip cannot install them";
        return Ok(Err(Unavailable(why.to_owned())));
    }
    std::fs::write(complete, REQUIREMENTS)?;
    note(&format!(
        "tests of the Python package use {}",
        python.display()
    ));
    Ok(Ok(python))
}

/// Reads the last line of pytest, such as `2 failed, 69 passed, 1 skipped in 51.56s`.
fn summary(line: &str) -> Option<Tally> {
    let (counts, seconds) = line.trim_matches(['=', ' ']).rsplit_once(" in ")?;
    seconds.chars().next().filter(char::is_ascii_digit)?;
    let mut tally = Tally::default();
    for part in counts.split(", ") {
        let (count, kind) = part.split_once(' ')?;
        let count: usize = count.parse().ok()?;
        match kind {
            "passed" => tally.passed += count,
            "failed" | "error" | "errors" => tally.failed += count,
            "skipped" => {
                let skip = || "a test of the Python package, as listed above".to_owned();
                tally.skips.extend(std::iter::repeat_with(skip).take(count));
            }
            _ => {}
        }
    }
    Some(tally)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(line: &str) -> Option<(usize, usize, usize)> {
        let tally = summary(line)?;
        Some((tally.passed, tally.failed, tally.skips.len()))
    }

    #[test]
    fn pytest_summary_is_counted() {
        let line = "2 failed, 69 passed, 1 skipped, 3 warnings, 1 error in 51.56s";
        assert_eq!(counts(line), Some((69, 3, 1)));
        assert_eq!(counts("===== 5 passed in 0.10s ====="), Some((5, 0, 0)));
        assert_eq!(counts("no tests ran in 0.01s"), None);
        assert_eq!(counts("3 motions in progress"), None);
        assert_eq!(counts("tests/test_motion.py ..F. [10%]"), None);
        let line = "FAILED tests/test_motion.py::test_ptp[a b] - assert 1 == 2";
        let test = "tests/test_motion.py::test_ptp[a b]";
        assert_eq!(failure(line).as_deref(), Some(test));
        assert_eq!(failure("FAILED (errors=1)"), None);
    }
}

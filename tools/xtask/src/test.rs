//! Runs tests and counts passed, failed and skipped ones. Counting reads libtest's own text (`tally`), so that only the
//! toolchain is needed; a test that cannot run here writes a line to the file named by `TAKT_SKIPS`. Goldens are
//! compared by the tests themselves.

pub(crate) mod repeat;
pub(crate) mod tally;

use std::fs;
use std::path::Path;

use anyhow::Context;

use crate::binaries::Built;
use crate::cargo::{self, Cargo, note, say};
use crate::environments;
use crate::page;
use crate::parts::{self, Part};
use crate::python;
use crate::vm;
use tally::{Reader, Tally};

/// Handling of golden files that differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Golden {
    /// Fail.
    Compare,
    /// Write the actual output.
    Rewrite,
}

/// Variables that make the golden libraries, and our own golden tests, write instead of compare.
const REWRITE: [(&str, &str); 3] = [
    ("INSTA_UPDATE", "always"),
    ("TRYCMD", "overwrite"),
    ("TAKT_BLESS", "1"),
];

/// Tests the parts (none named: all) and ends with the line that counts.
pub(crate) fn run(root: &Path, parts: &[String], golden: Golden) -> anyhow::Result<bool> {
    let tally = count(root, parts, golden)?;
    for line in tally.summary() {
        say(&line);
    }
    Ok(tally.failed == 0)
}

/// As [`run`], without the summary.
pub(crate) fn count(root: &Path, parts: &[String], golden: Golden) -> anyhow::Result<Tally> {
    let skips = cargo::target_dir(root).join(format!("xtask-skips-{}", std::process::id()));
    fs::create_dir_all(cargo::target_dir(root)).context("cannot create the target directory")?;
    fs::write(&skips, "").with_context(|| format!("cannot write {}", skips.display()))?;
    let mut tally = Tally::default();
    let lines = lines(root, parts)?;
    let named: Vec<&Part> = parts.iter().filter_map(|name| parts::find(name)).collect();
    if is_wanted(&named, "tools") {
        vm::browser()?;
    }
    for line in lines.clone() {
        let mut line = line.env("TAKT_SKIPS", &skips.to_string_lossy());
        if golden == Golden::Rewrite {
            line = REWRITE
                .iter()
                .fold(line, |line, (name, value)| line.env(name, value));
        }
        let mut reader = Reader::default();
        let good = line.lines(root, |text| {
            if reader.line(text) {
                say(text);
            }
        })?;
        tally.add(reader.finish(good));
    }
    if golden == Golden::Compare && repeat::is_wanted(&tally) {
        let built = Built::by(root, &lines)?;
        environments::repeat(root, &mut tally, &built.tests)?;
    }
    let skipped = fs::read_to_string(&skips).unwrap_or_default();
    tally.skip_passed(&skipped);
    if golden == Golden::Compare {
        let parts: Vec<&Part> = parts.iter().filter_map(|name| parts::find(name)).collect();
        match environments::test(root, &parts, &lines, &skipped) {
            Ok(there) => tally.add_environment(there),
            // The counts so far are reported all the same.
            Err(error) => {
                note(&format!("error: {error:#}"));
                tally.failed += 1;
            }
        }
        if is_wanted(&parts, "python") {
            tally.add(python::test(root)?);
        }
        if is_wanted(&parts, "server") {
            tally.add(page::test(root)?);
        }
    }
    if fs::remove_file(&skips).is_err() {
        note(&format!("could not remove {}", skips.display()));
    }
    Ok(tally)
}

/// Whether a part is among those named; none named are all.
fn is_wanted(parts: &[&Part], name: &str) -> bool {
    parts.is_empty()
        || parts
            .iter()
            .any(|part| part.name == name || part.name == "all")
}

/// The cargo lines that test these parts.
fn lines(root: &Path, names: &[String]) -> anyhow::Result<Vec<Cargo>> {
    let mut parts = Vec::new();
    for name in names {
        parts.push(parts::find(name).with_context(|| format!("no part is called {name}"))?);
    }
    let mut packages: Vec<&str> = parts
        .iter()
        .flat_map(|part| part.packages)
        .copied()
        .collect();
    packages.sort_unstable();
    packages.dedup();
    let all = parts.is_empty() || parts.iter().any(|part| part.packages.is_empty());
    let mut lines = Vec::new();
    if all {
        lines.push(Cargo::new("test --no-fail-fast --all-features --workspace"));
    } else {
        let line = Cargo::new("test --no-fail-fast --all-features");
        lines.push(
            packages
                .iter()
                .fold(line, |line, package| line.arg("-p").arg(package)),
        );
        lines.extend(cross_crate(root, &parts));
    }
    if (all || packages.contains(&"takt-rt")) && root.join("rt/tests/loom.rs").is_file() {
        lines.push(loom(root));
    }
    Ok(lines)
}

/// The loom models need a cfg for the whole tree, hence a target directory of their own, and release code to finish in
/// seconds.
fn loom(root: &Path) -> Cargo {
    let flags = std::env::var("RUSTFLAGS").unwrap_or_default();
    Cargo::new("test --no-fail-fast -p takt-rt --test loom --release --target-dir")
        .arg(&cargo::target_dir(root).join("loom").to_string_lossy())
        .env("RUSTFLAGS", format!("{flags} --cfg loom").trim())
}

/// The test target of a file, or of a folder with a `main.rs`.
fn target(path: &Path) -> Option<String> {
    let is_target =
        path.extension().is_some_and(|kind| kind == "rs") || path.join("main.rs").is_file();
    let name = path.file_stem().filter(|_| is_target)?;
    Some(name.to_str()?.to_owned())
}

/// Tests across crates belong to the part with which their file's name begins.
fn cross_crate(root: &Path, parts: &[&Part]) -> Option<Cargo> {
    let mut names: Vec<String> = fs::read_dir(root.join("tests/tests"))
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| target(&entry.path()))
        .filter(|name| {
            parts
                .iter()
                .any(|part| name.split('_').next() == Some(part.name))
        })
        .collect();
    names.sort();
    let line = Cargo::new("test --no-fail-fast --all-features -p takt-tests");
    let line = names
        .iter()
        .fold(line, |line, name| line.arg("--test").arg(name));
    (!names.is_empty()).then_some(line)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(parts: &[&str]) -> Vec<String> {
        let parts: Vec<String> = parts.iter().map(ToString::to_string).collect();
        let nowhere = Path::new("/nowhere");
        lines(nowhere, &parts)
            .unwrap()
            .iter()
            .map(ToString::to_string)
            .collect()
    }

    #[test]
    fn test_without_part_runs_all() {
        assert_eq!(
            shown(&[]),
            ["cargo test --no-fail-fast --all-features --workspace"]
        );
        assert_eq!(shown(&["fri", "all"]), shown(&[]));
    }

    #[test]
    fn test_package_in_two_parts_runs_once() {
        let expected = "cargo test --no-fail-fast --all-features \
                        -p takt-can -p takt-cia402 -p takt-device-canopen -p takt-device-drives \
                        -p takt-device-ethercat -p takt-device-rmp -p takt-devices -p takt-ethercat -p takt-tools";
        assert_eq!(shown(&["can", "ecat"]), [expected]);
    }

    #[test]
    fn test_unknown_part_is_rejected() {
        assert!(lines(Path::new("/nowhere"), &["frit".to_owned()]).is_err());
    }

    #[test]
    fn cross_crate_tests_are_files_or_folders() {
        let root = cargo::workspace_root().unwrap();
        let part = parts::find("ecat").unwrap();
        let line = cross_crate(&root, &[part]).unwrap().to_string();
        assert!(line.ends_with("-p takt-tests --test ecat_peers"), "{line}");
        let part = parts::find("net").unwrap();
        let line = cross_crate(&root, &[part]).unwrap().to_string();
        assert!(
            line.ends_with("--test net_examples --test net_findings --test net_fuzz"),
            "{line}"
        );
    }

    #[test]
    fn loom_uses_own_target_directory() {
        let line = loom(Path::new("/nowhere")).to_string();
        assert!(
            line.contains("--cfg loom") && line.ends_with("/loom"),
            "{line}"
        );
    }
}

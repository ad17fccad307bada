//! `cargo xtask deb`: the Debian package. What is in it stands in `deploy/Cargo.toml`; this builds the
//! program, its manual pages and the package, and fetches `cargo-deb` if it is not there.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;

use crate::cargo::{self, Cargo, say};
use crate::shell::{self, Line};

/// Builds the package; returns its path.
pub(crate) fn build(root: &Path) -> anyhow::Result<PathBuf> {
    let target = cargo::target_dir(root);
    let build = Cargo::new("build --release -p takt-tools");
    anyhow::ensure!(build.succeeds(root)?, "takt does not build");
    let release = target.join("release");
    let manual = release.join("manual");
    // A page of a subcommand that is gone must not stay.
    let _ = std::fs::remove_dir_all(&manual);
    let pages = Line::new(release.join("takt")).arg("manual").arg(&manual);
    anyhow::ensure!(pages.succeeds()?, "takt cannot write its manual");
    let names = std::fs::read_dir(&manual).context("no manual")?.flatten();
    let mut names: Vec<PathBuf> = names.map(|file| file.path()).collect();
    names.retain(|path| path.extension().is_some_and(|kind| kind == "1"));
    // Debian wants them packed, without the time of day.
    let packed = Line::new("gzip").args(["-9", "--no-name"]).args(&names);
    anyhow::ensure!(packed.succeeds()?, "gzip failed");
    let package = target.join("debian").join("takt.deb");
    let tool = cargo_deb(root)?;
    let deb = Line::new(tool)
        .args([
            "--no-build",
            "--quiet",
            "--package",
            "takt-deploy",
            "--output",
        ])
        .arg(&package)
        .within(root);
    anyhow::ensure!(deb.succeeds()?, "cargo-deb failed; its text above says why");
    Ok(package)
}

/// As [`build`], and says what came of it.
pub(crate) fn run(root: &Path) -> anyhow::Result<bool> {
    let package = build(root)?;
    say(&package.display().to_string());
    if !shell::exists("lintian") {
        say("not checked: lintian is not installed");
        return Ok(true);
    }
    let check = Line::new("lintian")
        .args(["--allow-root", "--fail-on", "error", "--suppress-tags"])
        .arg(UNCHECKED)
        .arg(&package);
    check.succeeds()
}

/// The bug of a first upload; and what only matters within Debian's own archive.
const UNCHECKED: &str = "initial-upload-closes-no-bugs,debian-changelog-file-missing";

/// The program `cargo-deb`, one that is installed or one of our own.
fn cargo_deb(root: &Path) -> anyhow::Result<PathBuf> {
    if shell::exists("cargo-deb") {
        return Ok(PathBuf::from("cargo-deb"));
    }
    let tools = cargo::target_dir(root).join("tools");
    let program = tools.join("bin/cargo-deb");
    if !program.is_file() {
        let install = Cargo::new("install cargo-deb --locked --root").arg(&tools.to_string_lossy());
        let fetched = install.succeeds(root).context("cannot install cargo-deb")?;
        anyhow::ensure!(fetched, "cannot install cargo-deb: is crates.io reachable?");
    }
    Ok(program)
}

/// Whether packages can be made here at all.
pub(crate) fn obstacle() -> Option<String> {
    let found = Command::new("dpkg-deb").arg("--version").output();
    found.is_err().then(|| "needs dpkg-deb".to_owned())
}

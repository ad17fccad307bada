//! `cargo xtask deb`: the Debian package. `deploy/Cargo.toml` lists its content; this builds the program, its manual
//! pages and the package, and installs `cargo-deb` if it is missing.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;

use crate::cargo::{self, Cargo, say};
use crate::shell::{self, Line};

/// Versions of `cargo-deb` that read our manifest.
const CARGO_DEB: &str = "~3.8";

/// A package to build.
#[derive(Debug)]
pub(crate) struct Package<'a> {
    /// The program `takt`.
    pub(crate) program: &'a Path,
    /// Folder for collected files and packages.
    pub(crate) folder: &'a Path,
    /// Version, if not the workspace's.
    pub(crate) version: Option<&'a str>,
    /// Best compression and a package of debug symbols, for release; otherwise fast.
    pub(crate) release: bool,
}

/// Builds the release package; lintian checks it if installed.
pub(crate) fn run(root: &Path) -> anyhow::Result<bool> {
    if !shell::exists("dpkg-deb") {
        say("skipped: needs dpkg-deb, of Debian's package dpkg");
        return Ok(false);
    }
    let build = Cargo::new("build --release -p takt-tools --features fleet");
    anyhow::ensure!(build.succeeds(root)?, "takt does not build");
    let target = cargo::target_dir(root);
    let package = Package {
        program: &target.join("release/takt"),
        folder: &target.join("debian"),
        version: None,
        release: true,
    };
    let path = package.make(root)?;
    say(&path.display().to_string());
    if !shell::exists("lintian") {
        say("not checked: lintian is not installed");
        return Ok(true);
    }
    let check = Line::new("lintian").args(["--fail-on", "error", "--suppress-tags", UNCHECKED]);
    check.arg(&path).succeeds()
}

/// Lintian tag of a first upload that closes no bug; there is none to close.
const UNCHECKED: &str = "initial-upload-closes-no-bugs";

impl Package<'_> {
    /// Builds it; returns its path.
    pub(crate) fn make(&self, root: &Path) -> anyhow::Result<PathBuf> {
        // cargo-deb reads what the manifest calls `target/release/` from below its target directory, so a folder of our
        // own can take that place.
        let files = self.folder.join("release");
        self.gather(&files)?;
        let version = self.version.unwrap_or(env!("CARGO_PKG_VERSION"));
        let path = self.folder.join(format!("takt_{version}.deb"));
        let line = Line::new(cargo_deb(root)?)
            .env("CARGO_TARGET_DIR", &self.folder.to_string_lossy())
            .args(["--no-build", "--package", "takt-deploy", "--output"])
            .arg(&path);
        let line = match self.version {
            Some(version) => line.args(["--deb-version", version]),
            None => line,
        };
        let how: &[&str] = if self.release {
            &["--dbgsym"]
        } else {
            &["--strip", "--fast"]
        };
        let made = line.args(how).quiet().within(root).succeeds()?;
        anyhow::ensure!(made, "cargo-deb failed; see its output above");
        Ok(path)
    }

    /// Collects program and manual.
    fn gather(&self, files: &Path) -> anyhow::Result<()> {
        // Pages of removed subcommands must not stay.
        let _ = fs::remove_dir_all(files);
        fs::create_dir_all(files)?;
        let program = files.join("takt");
        fs::copy(self.program, &program)
            .with_context(|| format!("no {}", self.program.display()))?;
        let manual = files.join("manual");
        let pages = Line::new(&program).arg("manual").arg(&manual);
        anyhow::ensure!(pages.succeeds()?, "takt cannot write its manual");
        // Debian requires compressed pages, without time stamps.
        let pack = "gzip -9 --no-name ./*.1";
        let packed = Line::new("sh").args(["-c", pack]).within(&manual);
        anyhow::ensure!(packed.succeeds()?, "gzip failed");
        Ok(())
    }
}

/// The program `cargo-deb`: the installed one, or one in the target directory.
fn cargo_deb(root: &Path) -> anyhow::Result<PathBuf> {
    if shell::exists("cargo-deb") {
        return Ok(PathBuf::from("cargo-deb"));
    }
    let tools = cargo::target_dir(root).join("tools");
    let program = tools.join("bin/cargo-deb");
    if !program.is_file() {
        // Unoptimized: it builds in a quarter of the time.
        let install = "install cargo-deb --quiet --locked --debug --no-default-features --version";
        let install = Cargo::new(install).args([CARGO_DEB, "--root", &tools.to_string_lossy()]);
        let fetched = install.succeeds(root).context("cannot install cargo-deb")?;
        anyhow::ensure!(
            fetched,
            "cannot install cargo-deb: check the connection to crates.io"
        );
    }
    Ok(program)
}

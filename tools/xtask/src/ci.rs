//! Everything that must hold before a change goes in, on any machine with the toolchain. All steps run even if one
//! fails, so that one run reports everything; nothing is fixed here.

use std::path::Path;
use std::process::Command;

use crate::cargo::{Cargo, note, say};
use crate::fuzz;
use crate::test::{self, Golden};
use crate::tidy;

/// Runs all steps and ends with the line that counts the tests; a failed step of another kind is named before it and
/// counted as one failure.
pub(crate) fn run(root: &Path) -> anyhow::Result<bool> {
    let before = snapshot(root);
    let mut broken = Vec::new();
    let mut step = |name: &'static str, good: bool| {
        if !good {
            broken.push(name);
        }
    };
    step("fmt", Cargo::new("fmt --all --check").succeeds(root)?);
    step("tidy", tidy::run(root)?);
    let clippy = "clippy --workspace --all-targets --all-features -- -D warnings";
    step("clippy", Cargo::new(clippy).succeeds(root)?);
    let mut tally = test::count(root, &[], Golden::Compare)?;
    step("fuzz", fuzz::run(root, "stand", fuzz::COUNT, 0)?);
    // With one example, features are those of the tests: nothing is compiled twice.
    let doc = Cargo::new("doc --workspace --all-features --no-deps --lib --bins --example begin");
    step(
        "doc",
        doc.env("RUSTDOCFLAGS", "-D warnings").succeeds(root)?,
    );
    let after = snapshot(root);
    if before.is_none() {
        note("no git here: whether the run changed a file is not checked");
    }
    let changed = changed(&before, &after);
    step("unchanged tree", changed.is_none());
    if let Some(status) = changed {
        note(&format!(
            "this run changed files; `git status` now says\n{status}"
        ));
    }
    tally.failed += broken.len();
    for name in broken {
        say(&format!("failed: {name}"));
    }
    for line in tally.summary() {
        say(&line);
    }
    Ok(tally.failed == 0)
}

/// Status and diff of git; `None` without git or repository.
type Snapshot = Option<(String, String)>;

fn snapshot(root: &Path) -> Snapshot {
    Some((
        git(root, &["status", "--porcelain"])?,
        git(root, &["diff", "HEAD"])?,
    ))
}

fn git(root: &Path, args: &[&str]) -> Option<String> {
    // A container often runs as another user than the owner of the checkout.
    let trust = ["-c", "safe.directory=*"];
    let output = Command::new("git")
        .args(trust)
        .args(args)
        .current_dir(root)
        .output()
        .ok()?;
    output
        .status
        .success()
        .then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

/// The status to report if the run changed a file.
fn changed<'a>(before: &Snapshot, after: &'a Snapshot) -> Option<&'a str> {
    let status = after
        .as_ref()
        .map_or("git no longer responds", |(status, _)| status);
    (before != after).then_some(status)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn snapshot_change_of_dirty_file_is_seen() {
        let state = |diff: &str| Some((" M a.rs\n".to_owned(), diff.to_owned()));
        assert_eq!(changed(&state("-1 +2"), &state("-1 +2")), None);
        assert_eq!(changed(&state("-1 +2"), &state("-1 +3")), Some(" M a.rs\n"));
        assert_eq!(changed(&None, &None), None);
    }

    #[test]
    fn snapshot_without_git_is_none() {
        let root = crate::cargo::workspace_root().unwrap();
        assert_eq!(git(&root, &["no-such-subcommand"]), None);
    }
}

//! Required content of the clippy.toml files. Clippy reads only the nearest file, not the root's too, so the common
//! lines are repeated in each; clippy itself checks the code.

use super::Finding;
use crate::metadata::Workspace;
use crate::tree::{File, Tree};

/// Crates whose state machines get time as an argument.
const SANS_IO: &[&str] = &[
    "takt-link",
    "takt-cia402",
    "takt-can",
    "takt-ethercat",
    "takt-fri",
    "takt-net",
    "takt-motion",
];

const BANNED: &[&str] = &[
    "std::time::Instant::now",
    "std::time::SystemTime::now",
    "std::thread::sleep",
];

pub(super) fn check(workspace: &Workspace, tree: &Tree) -> Vec<Finding> {
    let mut findings = common_lines(tree);
    for package in workspace
        .packages
        .iter()
        .filter(|p| SANS_IO.contains(&p.name.as_str()))
    {
        let path = format!("{}/clippy.toml", package.dir);
        let text = tree.text(&path).unwrap_or_default();
        for banned in BANNED.iter().filter(|banned| !bans(text, banned)) {
            let cause = format!("{} does not forbid {banned}", package.name);
            findings.push(Finding::new(
                &path,
                1,
                cause,
                "add it to disallowed-methods",
            ));
        }
    }
    findings
}

fn bans(text: &str, method: &str) -> bool {
    let entry = format!("path = \"{method}\"");
    text.lines()
        .any(|line| !line.trim_start().starts_with('#') && line.contains(&entry))
}

fn common_lines(tree: &Tree) -> Vec<Finding> {
    let Some(root) = tree.text("clippy.toml") else {
        return vec![Finding::new(
            "clippy.toml",
            1,
            "file missing",
            "write the common lines",
        )];
    };
    tree.named("clippy.toml")
        .flat_map(|file| missing_lines(root, file))
        .collect()
}

fn missing_lines(root: &str, file: &File) -> Vec<Finding> {
    let is_setting = |line: &&str| !line.trim().is_empty() && !line.starts_with('#');
    let missing = |line: &&str| !file.text.lines().any(|own| own == *line);
    let found = root.lines().filter(is_setting).filter(missing);
    found
        .map(|line| {
            let cause = format!("lacks the common line `{line}`");
            Finding::new(&file.path, 1, cause, "copy it from the root's clippy.toml")
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::{causes, package, workspace};
    use super::*;

    const BANS: &str = "a = 1\ndisallowed-methods = [\n\
        { path = \"std::time::Instant::now\" },\n{ path = \"std::time::SystemTime::now\" },\n\
        { path = \"std::thread::sleep\" },\n]\n";

    fn found(clippy: &str) -> Vec<String> {
        let tree = Tree::of(&[
            ("clippy.toml", "# why\na = 1\n"),
            ("fri/clippy.toml", clippy),
        ]);
        causes(&check(&workspace(vec![package("takt-fri")]), &tree))
    }

    #[test]
    fn bans_complete_file_passes() {
        assert!(found(BANS).is_empty());
    }

    #[test]
    fn bans_differing_common_line_is_found() {
        let found = found(&BANS.replace("a = 1", "a = 2"));
        assert_eq!(found, ["fri/clippy.toml:1 lacks the common line `a = 1`"]);
    }

    #[test]
    fn bans_missing_or_commented_ban_is_found() {
        let expected = ["fri/clippy.toml:1 takt-fri does not forbid std::thread::sleep"];
        assert_eq!(found(&BANS.replace("::sleep", "::spawn")), expected);
        let comment = BANS.replace("{ path = \"std::thread", "# { path = \"std::thread");
        assert_eq!(found(&comment), expected);
        assert_eq!(
            causes(&check(
                &workspace(vec![package("takt-can")]),
                &Tree::of(&[("clippy.toml", "")])
            ))
            .len(),
            3
        );
    }
}

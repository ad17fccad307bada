//! Form of files: a module doc, a limit on length, a README for each folder of captures, no path of a developer's
//! machine. Content is not checked.

use super::Finding;
use crate::metadata::Workspace;
use crate::tree::{File, Tree, file_name, parent};

/// Maximum lines of code in a file, without its tests.
const LINES_MAX: usize = 600;

/// Split strings, as this file is subject to its own rule.
const MACHINE_PATHS: &[&str] = &[
    concat!("/wo", "rk/"),
    concat!("/t", "mp/"),
    concat!("/ro", "ot/"),
    concat!("/ho", "me/"),
];

pub(super) fn check(_: &Workspace, tree: &Tree) -> Vec<Finding> {
    let rust = tree
        .rust_files()
        .flat_map(|file| [head(file), length(file)]);
    let texts = tree
        .files
        .iter()
        .filter(|file| file_name(&file.path) != "Cargo.lock");
    let mut findings: Vec<Finding> = rust.flatten().collect();
    findings.extend(texts.flat_map(machine_paths));
    findings.extend(captures(tree));
    findings
}

fn head(file: &File) -> Option<Finding> {
    let first = file
        .text
        .lines()
        .find(|line| !line.trim().is_empty())
        .unwrap_or_default();
    let remedy = "state in `//!` why the file exists and one thing it does not do";
    let good = first.starts_with("//!") || first.starts_with("#![");
    (!good).then(|| Finding::new(&file.path, 1, "no head", remedy))
}

/// Tests do not count, whether at the end of the file or in a file of their own.
fn length(file: &File) -> Option<Finding> {
    let is_test = file_name(&file.path) == "tests.rs" || file.path.contains("/tests/");
    let excused = file.text.contains("expect(clippy::too_many_lines")
        || file.text.contains("// tidy: long table");
    let code = file
        .text
        .lines()
        .take_while(|line| *line != "#[cfg(test)]")
        .count();
    (code > LINES_MAX && !is_test && !excused).then(|| {
        let cause = format!("{code} lines of code, more than {LINES_MAX}");
        let remedy = "split the file, or write `// tidy: long table` and why";
        Finding::new(&file.path, LINES_MAX + 1, cause, remedy)
    })
}

fn machine_paths(file: &File) -> Vec<Finding> {
    let hit = |line: &str| {
        MACHINE_PATHS
            .iter()
            .copied()
            .find(|path| begins_path(line, path))
    };
    let hits = file
        .text
        .lines()
        .enumerate()
        .filter_map(|(n, line)| Some((n + 1, hit(line)?)));
    hits.map(|(line, path)| {
        let cause = format!("path of one machine ({path})");
        Finding::new(
            &file.path,
            line,
            cause,
            "use a path of the project or std::env::temp_dir()",
        )
    })
    .collect()
}

/// True if `path` begins an absolute path, not part of a relative path or a link.
fn begins_path(line: &str, path: &str) -> bool {
    line.match_indices(path).any(|(start, _)| {
        let before = line.get(..start).and_then(|text| text.chars().next_back());
        !before.is_some_and(|c| c.is_alphanumeric() || "._-/*".contains(c))
    })
}

fn captures(tree: &Tree) -> Vec<Finding> {
    let mut folders: Vec<&str> = tree
        .files
        .iter()
        .map(|file| parent(&file.path))
        .filter(|p| file_name(p) == "captures")
        .collect();
    folders.dedup();
    let bare = folders
        .iter()
        .map(|folder| format!("{folder}/README.md"))
        .filter(|p| !tree.exists(p));
    bare.map(|readme| {
        let remedy = "write device, firmware, date and command of each capture";
        Finding::new(&readme, 1, "captures without a README", remedy)
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::causes;
    use super::*;

    fn found(path: &str, text: &str) -> Vec<String> {
        causes(&check(&Workspace::default(), &Tree::of(&[(path, text)])))
    }

    #[test]
    fn head_may_be_prose_or_attribute() {
        assert!(found("a.rs", "//! Why.\n").is_empty());
        assert!(found("a.rs", "\n#![forbid(unsafe_code)]\n").is_empty());
        assert_eq!(found("a.rs", "// Why.\n"), ["a.rs:1 no head"]);
        assert_eq!(found("a.rs", ""), ["a.rs:1 no head"]);
        assert!(found("a.txt", "").is_empty());
    }

    #[test]
    fn file_length_counts_code_only() {
        let long = format!("//! Why.\n{}", "x();\n".repeat(600));
        assert_eq!(
            found("a.rs", &long),
            ["a.rs:601 601 lines of code, more than 600"]
        );
        assert!(found("a/tests.rs", &long).is_empty());
        assert!(found("a/tests/b.rs", &long).is_empty());
        assert!(
            found(
                "a.rs",
                &format!("{long}// tidy: long table, of the standard\n")
            )
            .is_empty()
        );
        let tested = format!("//! Why.\n#[cfg(test)]\n{}", "x();\n".repeat(900));
        assert!(found("a.rs", &tested).is_empty());
    }

    #[test]
    fn machine_paths_are_found_in_any_text() {
        let path = MACHINE_PATHS[0];
        let text = format!("fine\nsee {path}notes\n");
        assert_eq!(
            found("a.md", &text),
            [format!("a.md:2 path of one machine ({path})")]
        );
        assert!(found("a.md", &format!("frame{path}x https://host{path}y\n")).is_empty());
    }

    #[test]
    fn captures_require_readme() {
        let cause = ["fri/tests/captures/README.md:1 captures without a README"];
        assert_eq!(found("fri/tests/captures/a.pcapng", ""), cause);
        let described = [("x/captures/README.md", ""), ("x/captures/a.pcapng", "")];
        assert!(check(&Workspace::default(), &Tree::of(&described)).is_empty());
    }
}

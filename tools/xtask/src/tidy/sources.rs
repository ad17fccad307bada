//! The shape of files: a head that says why, a length one can read, no folder of captures without
//! their story, no path of somebody's machine. Content is not judged.

use super::Finding;
use crate::metadata::Workspace;
use crate::tree::{File, Tree, file_name, parent};

/// Lines of code in a file, without those of its tests.
const LINES_MAX: usize = 600;

/// Written in halves, as this file is read by its own rule.
const PLACES: &[&str] = &[
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
    let remedy = "say in `//!` why the file exists and one thing it does not do";
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
        PLACES
            .iter()
            .copied()
            .find(|place| begins_path(line, place))
    };
    let hits = file
        .text
        .lines()
        .enumerate()
        .filter_map(|(n, line)| Some((n + 1, hit(line)?)));
    hits.map(|(line, place)| {
        let cause = format!("path of one machine ({place})");
        Finding::new(
            &file.path,
            line,
            cause,
            "use a path of the project or std::env::temp_dir()",
        )
    })
    .collect()
}

/// True if `place` stands at the start of an absolute path, not inside a relative one or a link.
fn begins_path(line: &str, place: &str) -> bool {
    line.match_indices(place).any(|(start, _)| {
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
    fn length_counts_code_only() {
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
    fn absolute_paths_of_a_machine_are_found_in_every_text() {
        let place = PLACES[0];
        let text = format!("fine\nsee {place}notes\n");
        assert_eq!(
            found("a.md", &text),
            [format!("a.md:2 path of one machine ({place})")]
        );
        assert!(found("a.md", &format!("frame{place}x https://host{place}y\n")).is_empty());
    }

    #[test]
    fn captures_need_their_story() {
        let cause = ["fri/tests/captures/README.md:1 captures without a README"];
        assert_eq!(found("fri/tests/captures/a.pcapng", ""), cause);
        let told = [("x/captures/README.md", ""), ("x/captures/a.pcapng", "")];
        assert!(check(&Workspace::default(), &Tree::of(&told)).is_empty());
    }
}

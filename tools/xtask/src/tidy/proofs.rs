//! Claims of documents name the tests that prove them. In every README, and in the pages of the root, a test is written
//! in backticks as `package::test`, with or without modules in between, and must exist. A row of a table under "What
//! works", and of SPECIFICATION.md, must name a test or a capture, or say `pending`. Tables of constants promise nothing
//! and need no test. Whether the test proves the row is up to the reader.

use super::{Finding, docs, manifests, markdown};
use crate::metadata::Workspace;
use crate::tree::{File, Tree};

pub(super) fn check(workspace: &Workspace, tree: &Tree) -> Vec<Finding> {
    let documents = || {
        tree.files
            .iter()
            .filter(|file| docs::is_document(&file.path))
    };
    let named = documents().flat_map(|file| missing_tests(file, workspace, tree));
    named
        .chain(documents().flat_map(|file| claims_without_proof(file, workspace)))
        .collect()
}

fn missing_tests(file: &File, workspace: &Workspace, tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (number, line) in markdown::prose(&file.text) {
        for span in markdown::code_spans(line) {
            if let Some(cause) = wrong_name(span, workspace, tree) {
                let remedy = "name the test as `package::test`";
                findings.push(Finding::new(&file.path, number, cause, remedy));
            }
        }
    }
    findings
}

/// Why a code span with the form of a test name is invalid.
fn wrong_name(span: &str, workspace: &Workspace, tree: &Tree) -> Option<String> {
    let (head, rest) = span.split_once("::")?;
    if head.ends_with(".rs") {
        return Some(format!("test {span} is named by its file"));
    }
    let Some(package) = workspace.package(head) else {
        return head
            .starts_with("takt-")
            .then(|| format!("{span}: no package {head}"));
    };
    let name = rest.rsplit("::").next().unwrap_or(rest);
    let exists = manifests::sources(package, workspace, tree).any(|text| has_test(text, name))
        || has_python_test(&package.dir, name, tree);
    (!exists).then(|| format!("{head} has no test {name}"))
}

/// True for a function of that name in a Python test of the package.
fn has_python_test(dir: &str, name: &str, tree: &Tree) -> bool {
    let opening = format!("def {name}(");
    let below = format!("{dir}/tests/");
    let mut files = tree
        .files
        .iter()
        .filter(|file| file.path.starts_with(&below) && file.path.ends_with(".py"));
    name.starts_with("test_") && files.any(|file| file.text.contains(&opening))
}

/// True for a function of that name with a test attribute directly above it.
fn has_test(text: &str, name: &str) -> bool {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let opening = format!("fn {name}(");
    let mut found = lines
        .iter()
        .enumerate()
        .filter(|(_, line)| line.contains(&opening));
    found.any(|(index, _)| {
        let above = lines.iter().take(index).rev();
        let mut above = above.take_while(|line| line.starts_with("#[") || line.starts_with("//"));
        above.any(|line| line.starts_with("#[") && line.contains("test"))
    })
}

fn claims_without_proof(file: &File, workspace: &Workspace) -> Vec<Finding> {
    let everywhere = file.path == "SPECIFICATION.md";
    let wanted = |heading: &str| {
        let heading = heading.to_lowercase();
        (everywhere && !heading.contains("constants")) || heading.contains("what works")
    };
    let rows = markdown::table_rows(&file.text, wanted);
    let bare = rows
        .into_iter()
        .filter(|(_, row)| !is_proved(row, workspace));
    bare.map(|(number, _)| {
        let remedy = "name the test (`package::test`) or write `pending`";
        Finding::new(&file.path, number, "a claim without proof", remedy)
    })
    .collect()
}

fn is_proved(row: &str, workspace: &Workspace) -> bool {
    let is_test = |span: &str| {
        span.split_once("::")
            .is_some_and(|(head, _)| workspace.package(head).is_some())
    };
    let low = row.to_lowercase();
    let honest = ["pending", "not yet", "captures/"]
        .iter()
        .any(|word| low.contains(word));
    honest || markdown::code_spans(row).any(is_test)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{causes, package, workspace};
    use super::*;

    const SOURCE: &str =
        "//! x\n    #[test]\n    // why\n    fn loss_is_counted() {}\nfn helper() {}\n";

    fn found(path: &str, text: &str) -> Vec<String> {
        let tree = Tree::of(&[(path, text), ("fri/src/session.rs", SOURCE)]);
        causes(&check(&workspace(vec![package("takt-fri")]), &tree))
    }

    #[test]
    fn proof_existing_test_passes() {
        assert!(found("README.md", "`takt-fri::loss_is_counted`").is_empty());
        assert!(
            found(
                "fri/README.md",
                "`takt-fri::session::tests::loss_is_counted`"
            )
            .is_empty()
        );
        assert!(found("fri/README.md", "`takt_fri::Session` and `Frame::LEN`").is_empty());
    }

    #[test]
    fn proof_missing_test_is_found() {
        let of = |span: &str| found("README.md", &format!("a\n`{span}`\n"));
        assert_eq!(
            of("takt-fri::none"),
            ["README.md:2 takt-fri has no test none"]
        );
        assert_eq!(
            of("takt-fri::helper"),
            ["README.md:2 takt-fri has no test helper"]
        );
        assert_eq!(
            of("takt-gone::x"),
            ["README.md:2 takt-gone::x: no package takt-gone"]
        );
        assert_eq!(
            of("session.rs::x"),
            ["README.md:2 test session.rs::x is named by its file"]
        );
    }

    #[test]
    fn proof_claim_requires_test_or_pending() {
        let page = |proof: &str| format!("## What works\n| a | b |\n|--|--|\n| loss | {proof} |\n");
        assert!(found("fri/README.md", &page("`takt-fri::loss_is_counted`")).is_empty());
        assert!(found("fri/README.md", &page("pending")).is_empty());
        let cause = ["fri/README.md:4 a claim without proof"];
        assert_eq!(found("fri/README.md", &page("surely")), cause);
        assert_eq!(
            found("SPECIFICATION.md", "| a |\n|--|\n| fast |\n").len(),
            1
        );
        assert!(found("README.md", "## Tools\n| a |\n|--|\n| fast |\n").is_empty());
    }

    #[test]
    fn table_of_constants_needs_no_test() {
        let page = |heading: &str| format!("## {heading}\n| a |\n|--|\n| 2 s |\n");
        assert!(found("SPECIFICATION.md", &page("Safety constants: stop")).is_empty());
        assert_eq!(found("SPECIFICATION.md", &page("Stop")).len(), 1);
    }
}

//! What every crate of the workspace has: workspace lints, the licence, a README as crate doc, and no unused dependency.
//! The latter is checked by name only, not by the compiler's view.

use super::{Finding, line_of};
use crate::metadata::{Dependency, Package, Workspace};
use crate::tree::Tree;

/// Licence that every crate of the workspace declares.
pub(super) const LICENCE: &str = "MIT OR Apache-2.0";

pub(super) fn check(workspace: &Workspace, tree: &Tree) -> Vec<Finding> {
    let every = workspace.packages.iter();
    every
        .flat_map(|package| check_package(package, workspace, tree))
        .collect()
}

fn check_package(package: &Package, workspace: &Workspace, tree: &Tree) -> Vec<Finding> {
    let manifest = package.manifest();
    let text = tree.text(&manifest).unwrap_or_default();
    let mut findings = Vec::new();
    let mut find = |line: usize, cause: String, remedy: &str| {
        findings.push(Finding::new(&manifest, line, cause, remedy));
    };
    if !has_workspace_lints(text) {
        find(
            1,
            "no workspace lints".to_owned(),
            "add `[lints]` with `workspace = true`",
        );
    }
    if package.licence.as_deref() != Some(LICENCE) {
        find(
            1,
            format!("licence is not {LICENCE}"),
            "add `license.workspace = true`",
        );
    }
    if !has_readme(package, tree) {
        find(
            1,
            "no README.md".to_owned(),
            "write one and name it in `readme`",
        );
    }
    for dependency in package
        .dependencies
        .iter()
        .filter(|d| !is_used(d, package, workspace, tree))
    {
        let cause = format!("{} is not used", dependency.name);
        find(
            line_of(text, &dependency.name),
            cause,
            "remove the dependency",
        );
    }
    findings.extend(doc_is_readme(package, tree));
    findings
}

fn has_workspace_lints(manifest: &str) -> bool {
    let mut lines = manifest
        .lines()
        .skip_while(|line| line.trim() != "[lints]")
        .skip(1);
    lines
        .find(|line| !line.trim().is_empty())
        .is_some_and(|line| line.trim() == "workspace = true")
}

fn has_readme(package: &Package, tree: &Tree) -> bool {
    let path = |name: &String| format!("{}/{name}", package.dir);
    package
        .readme
        .as_ref()
        .is_some_and(|name| tree.exists(&path(name)))
}

fn doc_is_readme(package: &Package, tree: &Tree) -> Option<Finding> {
    let path = format!("{}/src/lib.rs", package.dir);
    let text = tree.text(&path)?;
    let wanted = "#![doc = include_str!(\"../README.md\")]";
    let remedy = format!("begin with `{wanted}`");
    let cause = "the README is not the crate's documentation";
    (!text.contains(wanted)).then(|| Finding::new(&path, 1, cause, remedy))
}

/// True if a source of the package contains the name as a word.
fn is_used(d: &Dependency, package: &Package, workspace: &Workspace, tree: &Tree) -> bool {
    // A dev-dependency on oneself only enables features.
    let word = d.source_name.replace('-', "_");
    d.name == package.name || sources(package, workspace, tree).any(|text| has_word(text, &word))
}

/// The package's own sources, without those of a package in a subfolder.
pub(super) fn sources<'a>(
    package: &'a Package,
    workspace: &'a Workspace,
    tree: &'a Tree,
) -> impl Iterator<Item = &'a str> {
    let below = move |path: &str| {
        let mut others = workspace
            .packages
            .iter()
            .filter(|other| lies_in(&other.dir, &package.dir));
        others.any(|other| lies_in(path, &other.dir))
    };
    let own = tree
        .rust_files()
        .filter(move |file| lies_in(&file.path, &package.dir));
    own.filter(move |file| !below(&file.path))
        .map(|file| file.text.as_str())
}

fn lies_in(path: &str, dir: &str) -> bool {
    path.strip_prefix(dir)
        .is_some_and(|rest| rest.starts_with('/'))
}

fn has_word(text: &str, word: &str) -> bool {
    let part_of_word = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(word).any(|(start, _)| {
        let before = text.get(..start).and_then(|t| t.chars().next_back());
        let after = text
            .get(start + word.len()..)
            .and_then(|t| t.chars().next());
        !before.is_some_and(part_of_word) && !after.is_some_and(part_of_word)
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::{causes, package, workspace};
    use super::*;

    const LINTS: &str = "[package]\n[lints]\nworkspace = true\n";
    const LIB: &str = "#![doc = include_str!(\"../README.md\")]\nuse serde_json::Value;\n";

    fn with_dependency(name: &str) -> Package {
        let mut package = package("takt-fri");
        let (name, source_name) = (name.to_owned(), name.to_owned());
        package.dependencies = vec![Dependency {
            name,
            source_name,
            ..Dependency::default()
        }];
        package
    }

    fn found(package: Package, manifest: &str, lib: &str) -> Vec<String> {
        let files = [
            ("fri/Cargo.toml", manifest),
            ("fri/src/lib.rs", lib),
            ("fri/README.md", ""),
        ];
        causes(&check(&workspace(vec![package]), &Tree::of(&files)))
    }

    #[test]
    fn manifest_complete_crate_passes() {
        assert!(found(package("takt-fri"), LINTS, LIB).is_empty());
        assert!(found(with_dependency("serde-json"), LINTS, LIB).is_empty());
    }

    #[test]
    fn manifest_missing_lints_are_found() {
        let cause = ["fri/Cargo.toml:1 no workspace lints"];
        assert_eq!(found(package("takt-fri"), "[package]\n", LIB), cause);
        assert_eq!(
            found(
                package("takt-fri"),
                "[lints]\n\n[package]\nworkspace = true\n",
                LIB
            ),
            cause
        );
    }

    #[test]
    fn manifest_other_licence_or_missing_readme_is_found() {
        let mut package = package("takt-fri");
        package.licence = Some("GPL-3.0".to_owned());
        package.readme = Some("READ.md".to_owned());
        assert_eq!(
            found(package, LINTS, LIB),
            [
                "fri/Cargo.toml:1 licence is not MIT OR Apache-2.0",
                "fri/Cargo.toml:1 no README.md"
            ]
        );
    }

    #[test]
    fn manifest_library_without_readme_doc_is_found() {
        let cause = ["fri/src/lib.rs:1 the README is not the crate's documentation"];
        assert_eq!(found(package("takt-fri"), LINTS, "//! Own text.\n"), cause);
    }

    #[test]
    fn manifest_dependency_within_word_is_unused() {
        let manifest = format!("{LINTS}[dependencies]\njson = \"1\"\n");
        let cause = ["fri/Cargo.toml:5 json is not used"];
        assert_eq!(found(with_dependency("json"), &manifest, LIB), cause);
    }

    #[test]
    fn manifest_nested_crate_sources_do_not_count() {
        let mut inner = package("xtask");
        inner.dir = "fri/inner".to_owned();
        let workspace = workspace(vec![with_dependency("serde-json"), inner]);
        let tree = Tree::of(&[("fri/inner/src/main.rs", LIB), ("fri/src/lib.rs", "")]);
        let found = causes(&check(&workspace, &tree));
        assert!(
            found
                .iter()
                .any(|cause| cause.ends_with("serde-json is not used")),
            "{found:?}"
        );
    }
}

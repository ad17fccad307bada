//! The rules of this workspace that neither compiler nor clippy checks. All findings are reported at once, each with
//! location, cause and remedy; nothing is changed.

mod arrows;
mod bans;
mod circles;
mod docs;
mod finding;
mod licences;
mod manifests;
mod markdown;
mod proofs;
mod sources;
mod words;

use std::path::Path;

use finding::{Finding, line_of};

use crate::cargo::say;
use crate::metadata::Workspace;
use crate::tree::Tree;

/// A rule checks the whole workspace and returns its findings.
type Rule = fn(&Workspace, &Tree) -> Vec<Finding>;

const RULES: &[Rule] = &[
    arrows::check,
    bans::check,
    circles::check,
    docs::check,
    licences::check,
    manifests::check,
    proofs::check,
    sources::check,
    words::check,
];

/// Prints all findings; true if there are none.
pub(crate) fn run(root: &Path) -> anyhow::Result<bool> {
    let (workspace, tree) = (Workspace::load(root)?, Tree::load(root)?);
    let mut findings: Vec<Finding> = RULES
        .iter()
        .flat_map(|rule| rule(&workspace, &tree))
        .collect();
    findings.sort_by(|a, b| (&a.path, a.line).cmp(&(&b.path, b.line)));
    for finding in &findings {
        say(&finding.to_string());
    }
    let (files, crates) = (tree.files.len(), workspace.packages.len());
    say(&format!(
        "tidy: {} findings in {files} files of {crates} crates",
        findings.len()
    ));
    Ok(findings.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metadata::Package;

    /// A workspace of packages in folders named like them.
    pub(super) fn workspace(packages: Vec<Package>) -> Workspace {
        Workspace {
            packages,
            ..Workspace::default()
        }
    }

    /// A package without dependencies that breaks no rule of the metadata.
    pub(super) fn package(name: &str) -> Package {
        Package {
            name: name.to_owned(),
            dir: name.trim_start_matches("takt-").to_owned(),
            licence: Some(manifests::LICENCE.to_owned()),
            readme: Some("README.md".to_owned()),
            ..Package::default()
        }
    }

    /// Location and cause of each finding, in order.
    pub(super) fn causes(findings: &[Finding]) -> Vec<String> {
        findings
            .iter()
            .map(|f| format!("{}:{} {}", f.path, f.line, f.cause))
            .collect()
    }

    #[test]
    fn finding_displays_as_one_line() {
        let finding = Finding::new("rt/src/lib.rs", 3, "no head", "write one");
        assert_eq!(finding.to_string(), "rt/src/lib.rs:3: no head; write one");
    }
}

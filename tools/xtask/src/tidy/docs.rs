//! Links in documents lead to existing files. rustdoc checks links between items; links to the network are not checked.

use super::{Finding, markdown};
use crate::metadata::Workspace;
use crate::tree::{File, Tree, file_name, parent};

pub(super) fn check(_: &Workspace, tree: &Tree) -> Vec<Finding> {
    let documents = tree.files.iter().filter(|file| is_document(&file.path));
    documents
        .flat_map(|file| broken_links(file, tree))
        .collect()
}

/// READMEs everywhere, and every Markdown page of the root.
pub(super) fn is_document(path: &str) -> bool {
    path.ends_with(".md") && (file_name(path) == "README.md" || !path.contains('/'))
}

fn broken_links(file: &File, tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (number, line) in markdown::prose(&file.text) {
        for target in markdown::link_targets(line) {
            let Some(path) = linked_path(file, &target) else {
                continue;
            };
            if path.as_deref().is_none_or(|path| !tree.exists(path)) {
                let cause = format!("link to {target}, which does not exist");
                findings.push(Finding::new(
                    &file.path,
                    number,
                    cause,
                    "fix or remove the link",
                ));
            }
        }
    }
    findings
}

/// The target file of a link; `None` if it has none, `Some(None)` if it lies outside the checkout.
fn linked_path(file: &File, target: &str) -> Option<Option<String>> {
    let path = target.split('#').next().unwrap_or_default();
    let is_item = file.path.contains('/') && !path.contains(['/', '.']);
    if path.is_empty() || path.contains("::") || path.contains(':') || is_item {
        return None;
    }
    Some(resolve(parent(&file.path), path))
}

fn resolve(from: &str, path: &str) -> Option<String> {
    let mut parts: Vec<&str> = from.split('/').filter(|part| !part.is_empty()).collect();
    for part in path.split('/') {
        match part {
            ".." => drop(parts.pop()?),
            "." | "" => {}
            name => parts.push(name),
        }
    }
    Some(parts.join("/"))
}

#[cfg(test)]
mod tests {
    use super::super::tests::causes;
    use super::*;

    fn found(path: &str, text: &str) -> Vec<String> {
        let tree = Tree::of(&[(path, text), ("rt/src/lib.rs", ""), ("GUIDE.md", "")]);
        causes(&check(&Workspace::default(), &tree))
    }

    #[test]
    fn docs_valid_links_pass() {
        assert!(
            found(
                "README.md",
                "[a](rt) [b](GUIDE.md#top) [c](https://x.org/y) [d](#here)"
            )
            .is_empty()
        );
        assert!(
            found(
                "rt/README.md",
                "[a](src/lib.rs) [b](../GUIDE.md) [c](Cell) [d](cell::Cell)"
            )
            .is_empty()
        );
    }

    #[test]
    fn docs_broken_link_is_found() {
        let cause = ["rt/README.md:2 link to src/none.rs, which does not exist"];
        assert_eq!(found("rt/README.md", "x\n[a](src/none.rs)\n"), cause);
        assert_eq!(found("README.md", "[a](none)").len(), 1);
        assert_eq!(found("rt/README.md", "[a](../../GUIDE.md)").len(), 1);
    }

    #[test]
    fn docs_other_markdown_and_code_is_ignored() {
        assert!(found("rt/notes.md", "[a](none.md)").is_empty());
        assert!(found("README.md", "```\n[a](none.md)\n```\n").is_empty());
    }
}

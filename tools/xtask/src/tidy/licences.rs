//! Licences of third-party crates: only those listed. It reads each crate's declaration, not its files.

use super::{Finding, line_of};
use crate::metadata::{ThirdParty, Workspace};
use crate::tree::Tree;

/// All permissive: a binary may be distributed under the project's own terms with their notices.
const ALLOWED: &[&str] = &[
    "0BSD",
    "Apache-2.0",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "ISC",
    "MIT",
    "MIT-0",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
];

pub(super) fn check(workspace: &Workspace, tree: &Tree) -> Vec<Finding> {
    let lock = tree.text("Cargo.lock").unwrap_or_default();
    let bad = workspace
        .third_party
        .iter()
        .filter(|package| !is_allowed(package));
    bad.map(|package| {
        let ThirdParty {
            name,
            version,
            licence,
        } = package;
        let licence = licence.as_deref().unwrap_or("no licence");
        let cause = format!("{name} {version} declares {licence}");
        let line = line_of(lock, &format!("name = \"{name}\""));
        Finding::new(
            "Cargo.lock",
            line,
            cause,
            "take another crate or argue for the licence",
        )
    })
    .collect()
}

fn is_allowed(package: &ThirdParty) -> bool {
    package.licence.as_deref().is_some_and(expression_allowed)
}

/// An SPDX expression. The old `/` means OR; AND binds tighter than OR; an exception (WITH) only adds rights. Text that
/// is no expression is not allowed.
fn expression_allowed(expression: &str) -> bool {
    let spaced = expression
        .replace('/', " OR ")
        .replace('(', " ( ")
        .replace(')', " ) ");
    let words: Vec<&str> = spaced.split_whitespace().collect();
    let mut rest = words.as_slice();
    either(&mut rest) == Some(true) && rest.is_empty()
}

fn either(words: &mut &[&str]) -> Option<bool> {
    let mut allowed = both(words)?;
    while next_is(words, "OR") {
        allowed |= both(words)?;
    }
    Some(allowed)
}

fn both(words: &mut &[&str]) -> Option<bool> {
    let mut allowed = one(words)?;
    while next_is(words, "AND") {
        allowed &= one(words)?;
    }
    Some(allowed)
}

fn one(words: &mut &[&str]) -> Option<bool> {
    let (first, rest) = words.split_first()?;
    *words = rest;
    if *first == "(" {
        let allowed = either(words)?;
        return next_is(words, ")").then_some(allowed);
    }
    if next_is(words, "WITH") {
        *words = words.split_first()?.1;
    }
    Some(ALLOWED.contains(first))
}

fn next_is(words: &mut &[&str], wanted: &str) -> bool {
    match words.split_first() {
        Some((first, rest)) if *first == wanted => {
            *words = rest;
            true
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn licence_expressions_follow_spdx() {
        for good in [
            "MIT",
            "MIT/Apache-2.0",
            "GPL-3.0 OR MIT",
            "(MIT OR Apache-2.0) AND Unicode-3.0",
            "Apache-2.0 WITH LLVM-exception OR GPL-2.0",
            "GPL-3.0 AND MIT OR ISC",
        ] {
            assert!(expression_allowed(good), "{good}");
        }
        for bad in [
            "GPL-3.0",
            "MIT AND GPL-3.0",
            "(MIT",
            "MIT)",
            "",
            "MIT MIT",
            "MIT OR",
            "custom",
        ] {
            assert!(!expression_allowed(bad), "{bad}");
        }
    }

    #[test]
    fn licence_finding_points_to_lock_file() {
        let package = |name: &str, licence: Option<&str>| ThirdParty {
            name: name.to_owned(),
            version: "1.0.0".to_owned(),
            licence: licence.map(String::from),
        };
        let third_party = vec![
            package("a", Some("MIT")),
            package("b", None),
            package("c", Some("GPL-3.0")),
        ];
        let workspace = Workspace {
            third_party,
            ..Workspace::default()
        };
        let tree = Tree::of(&[("Cargo.lock", "name = \"b\"\n\nname = \"c\"\n")]);
        assert_eq!(
            super::super::tests::causes(&check(&workspace, &tree)),
            [
                "Cargo.lock:1 b 1.0.0 declares no licence",
                "Cargo.lock:3 c 1.0.0 declares GPL-3.0"
            ]
        );
    }
}

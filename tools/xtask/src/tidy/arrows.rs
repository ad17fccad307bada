//! Allowed dependencies between crates. The table does not cover third-party crates.

use super::{Finding, line_of};
use crate::metadata::{Dependency, Package, Workspace};
use crate::tree::Tree;

/// Every crate except the two developer crates.
const ALL: &[&str] = &["*"];

/// Each crate and its allowed dependencies. A dev-dependency may use any crate that these arrows reach, as tests may
/// cross layers, and the shared test crate.
const ALLOWED: &[(&str, &[&str])] = &[
    ("takt-rt", &[]),
    ("takt-link", &["takt-rt"]),
    ("takt-cia402", &[]),
    ("takt-can", &["takt-cia402", "takt-link"]),
    ("takt-ethercat", &["takt-cia402", "takt-link"]),
    ("takt-fri", &["takt-link"]),
    ("takt-world", &[]),
    ("takt-net", &[]),
    ("takt-motion", &["takt-net"]),
    ("takt-machine", &["takt-net"]),
    ("takt-irl", &["takt-net", "takt-motion"]),
    (
        "takt-core",
        &[
            "takt-net",
            "takt-motion",
            "takt-machine",
            "takt-irl",
            "takt-rt",
        ],
    ),
    (
        "takt-device-drives",
        &[
            "takt-core",
            "takt-motion",
            "takt-net",
            "takt-rt",
            "takt-cia402",
        ],
    ),
    (
        "takt-device-fri",
        &[
            "takt-core",
            "takt-motion",
            "takt-net",
            "takt-rt",
            "takt-fri",
        ],
    ),
    (
        "takt-device-ethercat",
        &[
            "takt-core",
            "takt-motion",
            "takt-net",
            "takt-rt",
            "takt-cia402",
            "takt-device-drives",
            "takt-ethercat",
        ],
    ),
    (
        "takt-device-canopen",
        &[
            "takt-core",
            "takt-net",
            "takt-rt",
            "takt-device-drives",
            "takt-can",
        ],
    ),
    (
        "takt-device-rmp",
        &["takt-core", "takt-net", "takt-rt", "takt-can"],
    ),
    ("takt-device-wsg", &["takt-core", "takt-net", "takt-rt"]),
    (
        "takt-devices",
        &[
            "takt-core",
            "takt-device-fri",
            "takt-device-ethercat",
            "takt-device-canopen",
            "takt-device-rmp",
            "takt-device-wsg",
        ],
    ),
    ("takt-client", &[]),
    ("takt-server", &["takt-client", "takt-core"]),
    ("takt-fleet", &["takt-client", "takt-core"]),
    (
        "takt-embedded",
        &[
            "takt-client",
            "takt-core",
            "takt-devices",
            "takt-ethercat",
            "takt-fri",
            "takt-rt",
            "takt-server",
            "takt-world",
        ],
    ),
    (
        "takt-api",
        &[
            "takt-client",
            "takt-devices",
            "takt-embedded",
            "takt-fleet",
            "takt-motion",
            "takt-net",
        ],
    ),
    ("takt-python", &["takt-api"]),
    ("takt-deploy", &[]),
    ("takt-tools", ALL),
    ("takt-tests", ALL),
    ("xtask", &[]),
];

pub(super) fn check(workspace: &Workspace, tree: &Tree) -> Vec<Finding> {
    workspace
        .packages
        .iter()
        .flat_map(|package| check_package(package, tree))
        .collect()
}

fn check_package(package: &Package, tree: &Tree) -> Vec<Finding> {
    let manifest = package.manifest();
    let name = &package.name;
    if arrows(name).is_none() {
        let cause = format!("crate {name} is not in the table of arrows");
        return vec![Finding::new(
            &manifest,
            1,
            cause,
            "add it to tools/xtask/src/tidy/arrows.rs",
        )];
    }
    let text = tree.text(&manifest).unwrap_or_default();
    let bad = package
        .dependencies
        .iter()
        .filter(|d| d.local && !is_allowed(name, d));
    bad.map(|dependency| {
        let cause = format!("{name} may not use {}", dependency.name);
        let remedy = "move the code to a crate that both may use, or remove the dependency";
        Finding::new(&manifest, line_of(text, &dependency.name), cause, remedy)
    })
    .collect()
}

fn is_allowed(from: &str, dependency: &Dependency) -> bool {
    let to = dependency.name.as_str();
    let direct = arrows(from).unwrap_or_default();
    let developers = matches!(to, "xtask" | "takt-tests");
    let by_arrow = direct.contains(&to) || (direct == ALL && !developers);
    by_arrow || (dependency.dev && (reaches(from, to) || to == "takt-tests"))
}

/// True for the crate itself, too: a dev-dependency on oneself enables features for tests.
fn reaches(from: &str, to: &str) -> bool {
    from == to
        || arrows(from)
            .unwrap_or_default()
            .iter()
            .any(|next| reaches(next, to))
}

fn arrows(name: &str) -> Option<&'static [&'static str]> {
    ALLOWED
        .iter()
        .find(|(from, _)| *from == name)
        .map(|(_, to)| *to)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{causes, package, workspace};
    use super::*;

    fn arrow(from: &str, to: &str, dev: bool) -> Vec<String> {
        let (name, source_name) = (to.to_owned(), to.to_owned());
        let mut package = package(from);
        package.dependencies = vec![Dependency {
            name,
            source_name,
            dev,
            local: true,
        }];
        let manifest = format!("[dependencies]\n{to}.workspace = true\n");
        let tree = Tree::of(&[(&package.manifest(), &manifest)]);
        causes(&check(&workspace(vec![package]), &tree))
    }

    #[test]
    fn arrows_in_table_are_allowed() {
        assert!(arrow("takt-can", "takt-cia402", false).is_empty());
        assert!(arrow("takt-tools", "takt-deploy", false).is_empty());
        assert!(arrow("takt-tests", "takt-tools", false).is_empty());
    }

    #[test]
    fn arrows_outside_table_are_found() {
        let expected = ["fri/Cargo.toml:2 takt-fri may not use takt-rt"];
        assert_eq!(arrow("takt-fri", "takt-rt", false), expected);
        assert_eq!(arrow("takt-net", "takt-motion", false).len(), 1);
        assert_eq!(arrow("takt-tools", "takt-tests", false).len(), 1);
        assert_eq!(arrow("takt-server", "takt-net", false).len(), 1);
    }

    #[test]
    fn arrows_dev_may_skip_layers_not_reverse() {
        assert!(arrow("takt-server", "takt-net", true).is_empty());
        assert!(arrow("takt-fri", "takt-fri", true).is_empty());
        assert!(arrow("takt-can", "takt-tests", true).is_empty());
        assert_eq!(arrow("takt-net", "takt-core", true).len(), 1);
    }

    #[test]
    fn arrows_unknown_crate_is_found() {
        let found = check(&workspace(vec![package("takt-new")]), &Tree::default());
        assert_eq!(
            causes(&found),
            ["new/Cargo.toml:1 crate takt-new is not in the table of arrows"]
        );
    }

    #[test]
    fn arrows_table_has_no_cycle() {
        for (from, to) in ALLOWED {
            assert!(
                to.iter().all(|next| !reaches(next, from)),
                "{from} reaches itself"
            );
        }
    }
}

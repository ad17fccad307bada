//! Short names for groups of packages that are tested and measured together. The packages may change; these names do not.

/// A part and its packages; an empty list is the whole workspace.
#[derive(Debug)]
pub(crate) struct Part {
    pub(crate) name: &'static str,
    pub(crate) packages: &'static [&'static str],
}

const fn part(name: &'static str, packages: &'static [&'static str]) -> Part {
    Part { name, packages }
}

/// In the order of the workspace, lowest crates first.
const PARTS: &[Part] = &[
    part("all", &[]),
    part("rt", &["takt-rt"]),
    part("link", &["takt-link"]),
    part("host", &["takt-rt", "takt-tools", "takt-deploy"]),
    part("cia402", &["takt-cia402"]),
    part(
        "can",
        &[
            "takt-cia402",
            "takt-can",
            "takt-device-drives",
            "takt-device-canopen",
            "takt-device-rmp",
            "takt-devices",
            "takt-tools",
        ],
    ),
    part(
        "ecat",
        &[
            "takt-cia402",
            "takt-ethercat",
            "takt-device-drives",
            "takt-device-ethercat",
            "takt-devices",
            "takt-tools",
        ],
    ),
    part(
        "fri",
        &["takt-fri", "takt-device-fri", "takt-devices", "takt-tools"],
    ),
    part(
        "devices",
        &[
            "takt-device-drives",
            "takt-device-fri",
            "takt-device-ethercat",
            "takt-device-canopen",
            "takt-device-rmp",
            "takt-device-wsg",
            "takt-devices",
        ],
    ),
    part("world", &["takt-world", "takt-embedded"]),
    part("net", &["takt-net", "takt-motion", "takt-core"]),
    part("motion", &["takt-motion"]),
    part("machine", &["takt-machine"]),
    part("irl", &["takt-irl"]),
    part("core", &["takt-core"]),
    part("server", &["takt-client", "takt-server"]),
    part("fleet", &["takt-fleet"]),
    part(
        "api",
        &["takt-client", "takt-embedded", "takt-api", "takt-tests"],
    ),
    part("python", &["takt-python"]),
    part("tools", &["takt-tools", "xtask"]),
    part("deploy", &["takt-deploy"]),
    part("tests", &["takt-tests"]),
];

/// Names that the command line accepts.
pub(crate) fn names() -> Vec<&'static str> {
    PARTS.iter().map(|part| part.name).collect()
}

pub(crate) fn find(name: &str) -> Option<&'static Part> {
    PARTS.iter().find(|part| part.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{cargo, metadata::Workspace};

    #[test]
    fn parts_cover_existing_packages() {
        let workspace = Workspace::load(&cargo::workspace_root().unwrap()).unwrap();
        let named: Vec<&str> = PARTS
            .iter()
            .flat_map(|part| part.packages)
            .copied()
            .collect();
        for package in &workspace.packages {
            assert!(
                named.contains(&package.name.as_str()),
                "{} is in no part",
                package.name
            );
        }
        for name in named {
            assert!(workspace.package(name).is_some(), "{name} does not exist");
        }
    }
}

//! `cargo metadata` of the workspace, reduced to what the tasks need. [`crate::tree`] reads the sources.

use std::path::Path;

use anyhow::Context;
use serde_json::Value;

use crate::cargo::Cargo;

/// The workspace's own packages, and third-party ones.
#[derive(Debug, Default)]
pub(crate) struct Workspace {
    pub(crate) packages: Vec<Package>,
    pub(crate) third_party: Vec<ThirdParty>,
}

#[derive(Debug, Default)]
pub(crate) struct Package {
    pub(crate) name: String,
    /// Relative to the root, `/` between parts, without one at the end.
    pub(crate) dir: String,
    pub(crate) licence: Option<String>,
    pub(crate) readme: Option<String>,
    /// Names of the bench targets.
    pub(crate) benches: Vec<String>,
    pub(crate) dependencies: Vec<Dependency>,
}

#[derive(Debug, Default)]
pub(crate) struct Dependency {
    pub(crate) name: String,
    /// Name in the package's sources: the new name of a renamed dependency.
    pub(crate) source_name: String,
    pub(crate) dev: bool,
    /// True for a path dependency, that is, a package of this workspace.
    pub(crate) local: bool,
}

#[derive(Debug)]
pub(crate) struct ThirdParty {
    pub(crate) name: String,
    pub(crate) version: String,
    pub(crate) licence: Option<String>,
}

impl Workspace {
    /// Runs cargo. Only packages built for this host are listed: others need not be downloaded.
    pub(crate) fn load(root: &Path) -> anyhow::Result<Self> {
        let cargo = Cargo::new("metadata --format-version 1 --filter-platform").arg(&host());
        let mut text = String::new();
        let good = cargo.lines(root, |line| text.push_str(line))?;
        anyhow::ensure!(good, "cargo metadata failed; see its output above");
        Self::parse(&serde_json::from_str(&text).context("cargo metadata is not JSON")?)
    }

    fn parse(metadata: &Value) -> anyhow::Result<Self> {
        let root = metadata["workspace_root"]
            .as_str()
            .context("no workspace_root")?;
        let mut workspace = Self::default();
        for package in list(&metadata["packages"]) {
            if package["source"].is_null() {
                workspace.packages.push(own(package, root)?);
            } else {
                workspace.third_party.push(ThirdParty {
                    name: text(&package["name"]),
                    version: text(&package["version"]),
                    licence: package["license"].as_str().map(String::from),
                });
            }
        }
        Ok(workspace)
    }

    pub(crate) fn package(&self, name: &str) -> Option<&Package> {
        self.packages.iter().find(|package| package.name == name)
    }
}

impl Package {
    pub(crate) fn manifest(&self) -> String {
        format!("{}/Cargo.toml", self.dir)
    }
}

fn own(package: &Value, root: &str) -> anyhow::Result<Package> {
    let manifest = package["manifest_path"]
        .as_str()
        .context("no manifest_path")?;
    let dir = manifest
        .strip_prefix(root)
        .and_then(|path| path.strip_suffix("/Cargo.toml"))
        .context("a package lies outside the workspace")?;
    let has_kind = |target: &&Value, kind: &str| list(&target["kind"]).any(|k| k == kind);
    Ok(Package {
        name: text(&package["name"]),
        dir: dir.trim_start_matches('/').to_owned(),
        licence: package["license"].as_str().map(String::from),
        readme: package["readme"].as_str().map(String::from),
        benches: list(&package["targets"])
            .filter(|target| has_kind(target, "bench"))
            .map(|target| text(&target["name"]))
            .collect(),
        dependencies: list(&package["dependencies"]).map(dependency).collect(),
    })
}

fn dependency(value: &Value) -> Dependency {
    let name = text(&value["name"]);
    Dependency {
        source_name: value["rename"]
            .as_str()
            .map_or_else(|| name.clone(), String::from),
        name,
        dev: value["kind"] == "dev",
        local: value["path"].is_string(),
    }
}

fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}

fn text(value: &Value) -> String {
    value.as_str().unwrap_or_default().to_owned()
}

/// The target triple of this xtask, close enough for a dependency list.
fn host() -> String {
    let env = if cfg!(target_env = "musl") {
        "musl"
    } else {
        "gnu"
    };
    format!("{}-unknown-linux-{env}", std::env::consts::ARCH)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAMPLE: &str = r#"{"workspace_root": "/w", "packages": [
        {"name": "takt-a", "source": null, "manifest_path": "/w/x/a/Cargo.toml", "license": "MIT",
         "readme": "README.md", "targets": [{"name": "a", "kind": ["lib"]}, {"name": "cycle", "kind": ["bench"]}],
         "dependencies": [{"name": "takt-b", "kind": "dev", "rename": null, "path": "/w/b"},
                          {"name": "serde_yaml", "kind": null, "rename": "yaml"}]},
        {"name": "serde", "version": "1.2.3", "source": "registry+x", "license": "MIT"}]}"#;

    #[test]
    fn metadata_keeps_required_fields() {
        let workspace = Workspace::parse(&serde_json::from_str(SAMPLE).unwrap()).unwrap();
        let package = workspace.package("takt-a").unwrap();
        assert_eq!(package.manifest(), "x/a/Cargo.toml");
        assert_eq!(package.benches, ["cycle"]);
        let [b, yaml] = &package.dependencies[..] else {
            panic!("two dependencies")
        };
        assert!(b.dev && b.local && !yaml.dev && !yaml.local);
        assert_eq!(
            (yaml.name.as_str(), yaml.source_name.as_str()),
            ("serde_yaml", "yaml")
        );
        assert_eq!(workspace.third_party[0].version, "1.2.3");
    }

    #[test]
    fn metadata_package_outside_root_is_rejected() {
        let text = SAMPLE.replace("/w/x/a", "/elsewhere/a");
        assert!(Workspace::parse(&serde_json::from_str(&text).unwrap()).is_err());
    }
}

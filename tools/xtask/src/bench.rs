//! Runs the benchmarks of a part. It checks no value: shared machines differ too much for a bound.

use std::path::Path;

use anyhow::Context;
use serde_json::{Map, Value};

use crate::cargo::{Cargo, note, say};
use crate::metadata::Workspace;
use crate::parts::{self, Part};

/// Runs every bench binary of the part (`harness = false`). With `json`, the last line of output is
/// one object with all figures that the binaries printed as lines of JSON.
pub(crate) fn run(root: &Path, name: &str, json: bool) -> anyhow::Result<bool> {
    let part = parts::find(name).with_context(|| format!("no part is called {name}"))?;
    let lines = lines(part, &Workspace::load(root)?, json);
    anyhow::ensure!(!lines.is_empty(), "part {name} has no benchmark");
    let mut good = true;
    let mut results = Map::new();
    for line in lines {
        good &= line.lines(root, |text| match serde_json::from_str(text) {
            Ok(Value::Object(result)) => results.extend(result),
            Ok(_) | Err(_) => say(text),
        })?;
    }
    if !results.is_empty() {
        say(&Value::Object(results).to_string());
    } else if json {
        note("the benchmark printed no line of JSON");
        good = false;
    }
    Ok(good)
}

/// One cargo line per bench binary. Each is named, as `cargo bench` alone would pass `--json` to the unit tests too,
/// which reject it.
fn lines(part: &Part, workspace: &Workspace, json: bool) -> Vec<Cargo> {
    let wanted = |name: &str| part.packages.is_empty() || part.packages.contains(&name);
    let mut lines = Vec::new();
    for package in workspace
        .packages
        .iter()
        .filter(|package| wanted(&package.name))
    {
        for bench in &package.benches {
            let line = Cargo::new("bench --all-features -p").arg(&package.name);
            let line = line.arg("--bench").arg(bench);
            lines.push(if json {
                line.arg("--").arg("--json")
            } else {
                line
            });
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metadata::Package;

    #[test]
    fn bench_line_names_binary_and_passes_json() {
        let package = |name: &str, benches: &[&str]| Package {
            name: name.to_owned(),
            benches: benches.iter().map(ToString::to_string).collect(),
            ..Package::default()
        };
        let packages = vec![
            package("takt-net", &["step"]),
            package("takt-rt", &["cell"]),
        ];
        let workspace = Workspace {
            packages,
            ..Workspace::default()
        };
        let shown = |part: &str, json: bool| -> Vec<String> {
            let lines = lines(parts::find(part).unwrap(), &workspace, json);
            lines.iter().map(ToString::to_string).collect()
        };
        let expected = "cargo bench --all-features -p takt-net --bench step -- --json";
        assert_eq!(shown("net", true), [expected]);
        assert_eq!(shown("all", false).len(), 2);
        assert!(shown("fri", false).is_empty());
    }
}

//! Runs the fuzz tests with more inputs than `cargo test` has time for; large counts in optimized code that keeps its
//! checks.
//! Each crate defines what must hold of its formats; `takt_tests::fuzz` generates the inputs.

use std::path::Path;

use crate::cargo::Cargo;

/// Default number of inputs for each target.
pub(crate) const COUNT: u64 = 100_000;

/// From this count on, optimized code saves more time than building it takes.
const MANY: u64 = 1_000_000;

/// Crates that process the inputs. Third-party crates are optimized in test builds anyway, so that only these must be
/// built again.
const OPTIMIZED: [&str; 11] = [
    "takt-can",
    "takt-cia402",
    "takt-core",
    "takt-fri",
    "takt-irl",
    "takt-link",
    "takt-machine",
    "takt-motion",
    "takt-net",
    "takt-server",
    "takt-tests",
];

/// Runs each target whose test contains `filter`; true if all succeeded.
pub(crate) fn run(root: &Path, filter: &str, count: u64, seed: u64) -> anyhow::Result<bool> {
    line(filter, count, seed).succeeds(root)
}

/// Packages and features are those of the other tests, so that they are built already.
fn line(filter: &str, count: u64, seed: u64) -> Cargo {
    let line =
        Cargo::new("test --no-fail-fast --all-features --workspace --test net_fuzz --test fuzz");
    let optimized = OPTIMIZED.iter().filter(|_| count >= MANY);
    let line = optimized.fold(line, |line, package| {
        let option = format!("profile.dev.package.{package}.opt-level=1");
        line.arg("--config").arg(&option)
    });
    line.args([filter, "--", "--nocapture"])
        .env("TAKT_FUZZ_COUNT", &count.to_string())
        .env("TAKT_FUZZ_SEED", &seed.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fuzz_line_names_targets_count_and_seed() {
        let begin = |count| {
            format!(
                "TAKT_FUZZ_COUNT={count} TAKT_FUZZ_SEED=3 cargo test --no-fail-fast --all-features --workspace \
                 --test net_fuzz --test fuzz "
            )
        };
        let few = line("eds", 7, 3).to_string();
        assert_eq!(few, begin(7) + "eds -- --nocapture");
        let many = line("eds", MANY, 3).to_string();
        let optimized = begin(MANY) + "--config profile.dev.package.takt-can.opt-level=1 ";
        assert!(many.starts_with(&optimized), "{many}");
    }

    #[test]
    fn fuzz_tests_exist() {
        let root = crate::cargo::workspace_root().unwrap();
        for path in ["tests/tests/net_fuzz.rs", "can/tests/fuzz.rs"] {
            let text = std::fs::read_to_string(root.join(path)).unwrap();
            assert!(text.contains("stand"), "{path}");
        }
    }
}

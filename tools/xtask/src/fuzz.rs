//! Runs the fuzz tests with more inputs than `cargo test` has time for, in code that is optimized but keeps its checks.
//! What must hold of each format stands with the crates; the inputs are made by `takt_tests::fuzz`.

use std::path::Path;

use crate::cargo::Cargo;

/// Inputs for each target if nothing else is said.
pub(crate) const COUNT: u64 = 100_000;

/// Where the fuzz tests are: package and test target.
const TESTS: [(&str, &str); 2] = [("takt-tests", "net_fuzz"), ("takt-can", "fuzz")];

/// Crates that the inputs go through. Those that others wrote are optimized in test builds too, so that nothing but
/// these has to be built again.
const OPTIMIZED: [&str; 7] = [
    "takt-can",
    "takt-cia402",
    "takt-core",
    "takt-fri",
    "takt-net",
    "takt-server",
    "takt-tests",
];

/// Feeds each target whose test contains `filter`; true if all promises were kept.
pub(crate) fn run(root: &Path, filter: &str, count: u64, seed: u64) -> anyhow::Result<bool> {
    line(filter, count, seed).succeeds(root)
}

fn line(filter: &str, count: u64, seed: u64) -> Cargo {
    let line = Cargo::new("test --no-fail-fast");
    let line = OPTIMIZED.iter().fold(line, |line, package| {
        let option = format!("profile.dev.package.{package}.opt-level=1");
        line.arg("--config").arg(&option)
    });
    let line = TESTS.iter().fold(line, |line, (package, target)| {
        line.args(["-p", package, "--test", target])
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
        let line = line("eds", 7, 3).to_string();
        let begin = "TAKT_FUZZ_COUNT=7 TAKT_FUZZ_SEED=3 cargo test --no-fail-fast --config \
                     profile.dev.package.takt-can.opt-level=1 ";
        assert!(line.starts_with(begin), "{line}");
        let end = "-p takt-tests --test net_fuzz -p takt-can --test fuzz eds -- --nocapture";
        assert!(line.ends_with(end), "{line}");
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

//! Runs a whole emulated application many times, with random seeds and faults, and prints a table. It judges nothing itself: each run
//! reports its own verdict, in simulated time, so that a host that stalls fails none.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context as _;
use clap::{Args, ValueEnum};
use serde_json::Value;

use crate::cargo::{Cargo, note, say, target_dir};

/// What can be run.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Scene {
    /// Two arms assemble a workpiece
    Assembly,
}

/// Faults of the assembly, as `takt demo --fault` names them; as many runs have none.
const FAULTS: [&str; 12] = [
    "docks-beside",
    "stays-beside",
    "slips",
    "stays-slippery",
    "no-peg",
    "jams",
    "stays-jammed",
    "cross-threads",
    "stays-askew",
    "arm-lost",
    "program-killed",
    "controller-killed",
];
/// Figures of the report in the table.
const FIGURES: [&str; 6] = [
    "cycle_s",
    "internal_force_n_max",
    "grasp_distance_mm_max",
    "peg_force_n_max",
    "contact_to_braking_ms",
    "screw_torque_nm_max",
];

/// What is run.
#[derive(Debug, Args)]
pub(crate) struct Soak {
    /// Which application
    #[arg(value_enum)]
    scene: Scene,
    /// How many times
    #[arg(long, default_value_t = 10)]
    runs: u32,
    /// Another seed gives other seeds and faults
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How fast simulated time runs while the host keeps up
    #[arg(long, default_value_t = 1.0)]
    real_time_factor: f64,
    /// Then run it once with and once without blending, and print the ratio of the cycle times
    #[arg(long)]
    ratio: bool,
}

/// Runs of a scene; true if all were good.
pub(crate) fn run(root: &Path, soak: &Soak) -> anyhow::Result<bool> {
    let Soak {
        scene: Scene::Assembly,
        runs,
        ..
    } = *soak;
    // As users run it: without optimization, two processors are busy with the cell alone.
    let build = "build --release --package takt-tools --features fleet --bin takt";
    if !Cargo::new(build).succeeds(root)? {
        return Ok(false);
    }
    let target = target_dir(root);
    let folder = target.join("soak");
    std::fs::create_dir_all(&folder).context("cannot make a folder for pictures")?;
    say(
        "run  seed        fault              verdict  cycle, s  internal, N  hands, mm  peg, N  braking, ms  screw, Nm",
    );
    let takt = target.join("release/takt");
    let factor = soak.real_time_factor.to_string();
    let one = |seed: u64, options: &[&str]| {
        let timed = ["--real-time-factor", &factor];
        one(&takt, &folder, seed, &[&timed, options].concat())
    };
    let (mut state, mut failed) = (soak.seed, 0);
    for number in 1..=runs {
        let seed = next(&mut state) >> 32;
        let chosen = usize::try_from(next(&mut state) >> 33).unwrap_or(0) % (2 * FAULTS.len());
        let fault = FAULTS.get(chosen).copied();
        let options = fault.map(|fault| ["--fault", fault]);
        let report = one(seed, options.as_slice().as_flattened())?;
        let is_good = report["ok"] == true;
        say(&line(number, seed, fault, &report));
        for key in ["error", "faults"] {
            if !is_good && !report[key].is_null() {
                say(&format!("     {key}: {}", report[key]));
            }
        }
        failed += u32::from(!is_good);
    }
    say(&format!("{} of {runs} runs good", runs - failed));
    let mut is_good = failed == 0;
    if soak.ratio {
        let text = ratio(&one(soak.seed, &[])?, &one(soak.seed, &["--stopping"])?);
        is_good &= text.is_some();
        say(&text.unwrap_or_else(|| {
            "no ratio: a run with or without blending did not come to its end".to_owned()
        }));
    }
    Ok(is_good)
}

/// The cycle time of a run against one that stops after each motion; `None` if one did not come to its end.
fn ratio(blended: &Value, stopping: &Value) -> Option<String> {
    let cycle = |report: &Value| {
        let ended = report["error"].is_null();
        report["cycle_s"].as_f64().filter(|it| ended && *it > 0.0)
    };
    let (with, without) = (cycle(blended)?, cycle(stopping)?);
    let share = 100.0 * with / without;
    Some(format!(
        "cycle {with:.1} s with blending, {share:.0} % of {without:.1} s without"
    ))
}

/// The report of a run.
fn one(takt: &Path, folder: &Path, seed: u64, options: &[&str]) -> anyhow::Result<Value> {
    let path = |name: &str| -> PathBuf { folder.join(name) };
    let mut command = Command::new(takt);
    command
        .args(["demo", "--cell", "assembly", "--json", "--seed"])
        .arg(seed.to_string())
        .arg("--svg")
        .arg(path("assembly.svg"))
        .arg("--record")
        .arg(path("assembly.mcap"))
        .args(options);
    let output = command.output().context("cannot start takt")?;
    let text = String::from_utf8_lossy(&output.stdout);
    let report = text
        .lines()
        .find_map(|line| serde_json::from_str(line).ok());
    Ok(report.unwrap_or_else(|| {
        let error = String::from_utf8_lossy(&output.stderr);
        note(&error);
        serde_json::json!({ "ok": false, "error": error.lines().last() })
    }))
}

fn line(number: u32, seed: u64, fault: Option<&str>, report: &Value) -> String {
    let verdict = if report["ok"] == true { "ok" } else { "FAILED" };
    let figure = |key: &str| match report[key].as_f64() {
        Some(value) if value > 0.0 => format!("{value:.2}"),
        _ => "-".to_owned(),
    };
    let [cycle, internal, hands, peg, braking, screw] = FIGURES.map(figure);
    format!(
        "{number:3}  {seed:10}  {:17}  {verdict:7}  {cycle:>8}  {internal:>11}  {hands:>9}  {peg:>6}  {braking:>11}  {screw:>9}",
        fault.unwrap_or("none")
    )
}

/// The next number of a sequence (SplitMix64).
const fn next(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mixed = (*state ^ (*state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    mixed ^ (mixed >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn soak_line_has_figures_and_verdict() {
        let report = serde_json::json!({ "ok": true, "cycle_s": 71.25, "peg_force_n_max": 17.0 });
        let expected = "  2           7  jams               ok          71.25            -          -   17.00            -          -";
        assert_eq!(line(2, 7, Some("jams"), &report), expected);
    }

    #[test]
    fn soak_ratio_needs_two_whole_runs() {
        let whole = |cycle_s: f64| serde_json::json!({ "error": null, "cycle_s": cycle_s });
        let text = ratio(&whole(60.0), &whole(80.0)).unwrap();
        assert_eq!(text, "cycle 60.0 s with blending, 75 % of 80.0 s without");
        let broken = serde_json::json!({ "error": "no peg", "cycle_s": 12.0 });
        assert_eq!(ratio(&broken, &whole(80.0)), None);
    }

    #[test]
    fn soak_faults_are_those_of_assembly() {
        let root = crate::cargo::workspace_root().unwrap();
        let text = std::fs::read_to_string(root.join("rcc/embedded/src/faults.rs")).unwrap();
        for fault in FAULTS {
            assert!(text.contains(&format!("\"{fault}\"")), "{fault}");
        }
    }
}

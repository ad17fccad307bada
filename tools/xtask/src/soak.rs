//! Runs a whole emulated application many times, with random seeds and faults, and prints a table. It judges nothing itself: each run
//! reports its own verdict. A run that failed while the host stalled is repeated with the same seed and fault.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context as _;
use clap::ValueEnum;
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
/// How often a run is tried on a host that stalls.
const ATTEMPTS: u32 = 4;
/// A net thread that is woken so late has missed two cycles of the arms, ms.
const STALL_MS: f64 = 4.0;
/// Figures of the report in the table.
const FIGURES: [&str; 5] = [
    "cycle_s",
    "internal_force_n_max",
    "peg_force_n_max",
    "contact_to_braking_ms",
    "screw_torque_nm_max",
];

/// Runs of a scene; true if all were good.
pub(crate) fn run(
    root: &Path,
    scene: Scene,
    runs: u32,
    seed: u64,
    with_ratio: bool,
) -> anyhow::Result<bool> {
    let Scene::Assembly = scene;
    // As users run it: without optimization, two processors are busy with the cell alone.
    let build = "build --release --package takt-tools --features fleet --bin takt";
    if !Cargo::new(build).succeeds(root)? {
        return Ok(false);
    }
    let target = target_dir(root);
    let folder = target.join("soak");
    std::fs::create_dir_all(&folder).context("cannot make a folder for pictures")?;
    say(
        "run  seed        fault              verdict  cycle, s  internal, N  peg, N  braking, ms  screw, Nm",
    );
    let takt = target.join("release/takt");
    let (mut state, mut failed, mut repeated) = (seed, 0, 0);
    for number in 1..=runs {
        let seed = next(&mut state) >> 32;
        let chosen = usize::try_from(next(&mut state) >> 33).unwrap_or(0) % (2 * FAULTS.len());
        let fault = FAULTS.get(chosen).copied();
        let fault = fault.map(|fault| ["--fault", fault]);
        let mut attempt = 1;
        let is_good = loop {
            let report = one(&takt, &folder, seed, fault.as_slice().as_flattened())?;
            let is_good = report["ok"] == true;
            say(&line(number, seed, fault.map(|[_, fault]| fault), &report));
            for key in ["error", "faults"] {
                if !is_good && !report[key].is_null() {
                    say(&format!("     {key}: {}", report[key]));
                }
            }
            let stall_ms = stall_ms(&report).filter(|it| *it >= STALL_MS);
            let Some(stall_ms) = stall_ms.filter(|_| !is_good && attempt < ATTEMPTS) else {
                break is_good;
            };
            say(&format!(
                "     attempt {attempt}: the host stalled for {stall_ms:.1} ms; trying again"
            ));
            attempt += 1;
            repeated += 1;
        };
        failed += u32::from(!is_good);
    }
    say(&format!(
        "{} of {runs} runs good, {repeated} repeated because the host stalled",
        runs - failed
    ));
    let mut is_good = failed == 0;
    if with_ratio {
        let cycle = |options: &[&str]| one(&takt, &folder, seed, options);
        let text = ratio(&cycle(&[])?, &cycle(&["--stopping"])?);
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

/// How late a net thread was woken at most.
fn stall_ms(report: &Value) -> Option<f64> {
    let late_ns = report["controller"]["woken_late_ns_max"].as_f64()?;
    Some(late_ns * 1e-6)
}

fn line(number: u32, seed: u64, fault: Option<&str>, report: &Value) -> String {
    let verdict = if report["ok"] == true { "ok" } else { "FAILED" };
    let figure = |key: &str| match report[key].as_f64() {
        Some(value) if value > 0.0 => format!("{value:.1}"),
        _ => "-".to_owned(),
    };
    let [cycle, internal, peg, braking, screw] = FIGURES.map(figure);
    format!(
        "{number:3}  {seed:10}  {:17}  {verdict:7}  {cycle:>8}  {internal:>11}  {peg:>6}  {braking:>11}  {screw:>9}",
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
        let expected = "  2           7  jams               ok           71.2            -    17.0            -          -";
        assert_eq!(line(2, 7, Some("jams"), &report), expected);
    }

    #[test]
    fn soak_stall_is_that_of_controller() {
        let stalled = serde_json::json!({ "controller": { "woken_late_ns_max": 6_500_000 } });
        assert!((stall_ms(&stalled).unwrap() - 6.5).abs() < 1e-9);
        assert_eq!(stall_ms(&serde_json::json!({ "ok": false })), None);
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

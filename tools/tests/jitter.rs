//! `takt jitter` as its users run it: exit status, interruption, break, load, comparison, files read
//! back. How late this host is, is not asked.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;

use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Child, Output, Stdio};
use std::time::{Duration, Instant};

use common::{Folder, alone, complaint, expect_status, run, takt};
use serde_json::Value;
use takt_tests::skip;

/// A file kept beside this test.
fn kept(name: &str) -> String {
    format!("{}/tests/jitter/{name}", env!("CARGO_MANIFEST_DIR"))
}

/// A report in JSON, the whole output.
#[track_caller]
fn json(output: &Output, status: i32) -> Value {
    let text = expect_status(output, status);
    assert_eq!(text.lines().count(), 1, "{text}");
    serde_json::from_str(&text).unwrap()
}

/// Waits until something is so; far longer than anything takes on a busy host.
#[track_caller]
fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let until = Instant::now() + Duration::from_secs(60);
    while !is_so() {
        assert!(Instant::now() < until, "{what} did not come about");
        std::thread::yield_now();
    }
}

/// Whether a process has a thread that measures.
fn measures(child: &Child) -> bool {
    let tasks = std::fs::read_dir(format!("/proc/{}/task", child.id()));
    tasks.is_ok_and(|tasks| {
        tasks.flatten().any(|task| {
            let name = std::fs::read_to_string(task.path().join("comm"));
            // Not the name of a test, which its child has until it executes the program.
            name.is_ok_and(|name| name.trim() == "jitter" || name.starts_with("jitter-"))
        })
    })
}

fn signal(name: &str, process: u32) {
    let kill = format!("kill -{name} {process}");
    let status = std::process::Command::new("sh")
        .args(["-c", &kill])
        .status();
    assert!(status.unwrap().success());
}

#[test]
fn jitter_report_has_promised_keys() {
    let _alone = alone();
    let folder = Folder::new();
    let svg = folder.file("jitter.svg");
    let args = ["jitter", "--duration", "300ms", "--cpu", "all", "--json"];
    let report = json(&run(&[&args[..], &["--svg", &svg]].concat()), 0);
    assert_eq!(report["schema"], "takt-jitter/1");
    assert_eq!(report["verdict"], "none");
    assert_eq!(report["period_ns"], 1_000_000);
    assert_eq!(report["rt_allocations"], 0);
    assert!(report["smi_count"].is_u64() || report["smi_unknown"].is_string());
    let warnings = report["warnings"].to_string();
    assert!(warnings.contains("short-run"), "{warnings}");
    for thread in report["threads"].as_array().unwrap() {
        let count = |key: &str| thread[key].as_u64().unwrap();
        assert!(count("cycles") + count("missed_cycles") >= 300, "{thread}");
        let latency = ["min", "p50", "p99", "p999", "max"];
        let latency = latency.map(|q| thread["latency_ns"][q].as_u64().unwrap());
        assert!(latency.is_sorted(), "{latency:?}");
        let usage = &thread["usage"];
        assert!(usage["context_switches_voluntary"].as_u64().unwrap() > 0);
        // Where memory could be locked, a cycle never faults.
        if !warnings.contains("memory lock") {
            assert_eq!(usage["page_faults_minor"], 0, "{thread}");
            assert_eq!(usage["page_faults_major"], 0, "{thread}");
        }
    }
    assert!(std::fs::read_to_string(&svg).unwrap().ends_with("</svg>\n"));

    // What was written is read back as it was.
    let file = folder.write("jitter.json", &report.to_string());
    let again = json(&run(&["jitter", "--from", &file, "--json"]), 0);
    assert_eq!(again, report);
}

#[test]
fn jitter_budget_sets_exit_status() {
    let _alone = alone();
    let judged = |budget| {
        let args = ["jitter", "--duration", "50ms", "--quiet", "--budget"];
        run(&[&args[..], &[budget]].concat())
    };
    let good = expect_status(&judged("1h"), 0);
    assert!(
        good.starts_with("OK, worst ") && good.lines().count() == 1,
        "{good}"
    );
    let bad = expect_status(&judged("1ns"), 1);
    assert!(bad.starts_with("FAILED, worst "), "{bad}");
    let report = [
        "jitter",
        "--from",
        &kept("takt.json"),
        "--quiet",
        "--budget",
    ];
    expect_status(&run(&[&report[..], &["10s"]].concat()), 0);
    expect_status(&run(&[&report[..], &["1us"]].concat()), 1);
}

#[test]
fn jitter_impossible_measurement_is_refused_with_hint() {
    for (args, remedy) in [
        (&["--cpu", "1023"][..], "those that can are"),
        (&["--cpu", "x"], "no list of processors"),
        (&["--period", "1us"], "--period 1ms"),
        (&["--duration", "1us"], "--duration 10s"),
        (&["--priority", "99"], "99"),
        (&["--slices", "3"], "--compare"),
        (&["--from", "nowhere.json"], "cannot read nowhere.json"),
        (
            &["--from", "Cargo.toml"],
            "no report of `takt jitter --json`",
        ),
    ] {
        let output = run(&[&["jitter"], args].concat());
        expect_status(&output, 2);
        assert!(
            complaint(&output).contains(remedy),
            "{}",
            complaint(&output)
        );
    }
}

#[test]
fn jitter_break_prints_flight_recorder() {
    let _alone = alone();
    let output = run(&["jitter", "--duration", "1h", "--break", "1ns"]);
    let text = expect_status(&output, 1);
    for part in [
        "trace      ",
        "  0 jitter: latency_ns ",
        "cycle 0 broke the run",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(
        text.lines()
            .last()
            .unwrap()
            .starts_with("FAILED, broken off at ")
    );
}

#[test]
fn jitter_interrupted_run_keeps_figures() {
    let _alone = alone();
    for (name, budget, status) in [("INT", "1h", 0), ("TERM", "1ns", 1)] {
        let args = ["jitter", "--duration", "1h", "--json", "--budget", budget];
        let child = takt(&args)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        wait_until("the measurement", || measures(&child));
        signal(name, child.id());
        let report = json(&child.wait_with_output().unwrap(), status);
        assert_eq!(report["interrupted"], true);
        assert!(report["threads"][0]["cycles"].as_u64().unwrap() > 0);
    }
}

#[test]
fn jitter_load_ends_when_measurement_is_killed() {
    let _alone = alone();
    let args = ["jitter", "--duration", "1h", "--load", "2", "--json"];
    let mut child = takt(&args)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    wait_until("the measurement", || measures(&child));
    let id = child.id();
    let workers = std::fs::read_to_string(format!("/proc/{id}/task/{id}/children")).unwrap();
    let workers: Vec<_> = workers.split_whitespace().map(str::to_owned).collect();
    assert_eq!(workers.len(), 2);
    child.kill().unwrap();
    child.wait().unwrap();
    let is_gone = |worker: &String| {
        let stat = std::fs::read_to_string(format!("/proc/{worker}/stat")).unwrap_or_default();
        // Ended and reaped, or a zombie.
        stat.rsplit(')')
            .next()
            .is_none_or(|rest| rest.trim_start().starts_with('Z'))
            || stat.is_empty()
    };
    wait_until("the end of the load", || workers.iter().all(is_gone));
}

/// A folder with a program called cyclictest that says `text` and ends with `status`. It keeps its
/// arguments in a file beside it.
fn fake(text: &str, status: i32) -> Folder {
    let folder = Folder::new();
    let said = folder.write("said", text);
    let kept = folder.file("arguments");
    let script = format!("#!/bin/sh\necho \"$@\" > {kept}\n/bin/cat {said}\nexit {status}\n");
    let program = folder.write("cyclictest", &script);
    std::fs::set_permissions(program, std::fs::Permissions::from_mode(0o755)).unwrap();
    folder
}

/// Compares with what is called cyclictest in that folder.
fn compare(folder: &Path) -> Output {
    let args = [
        "jitter",
        "--compare",
        "cyclictest",
        "--slices",
        "2",
        "--json",
    ];
    takt(&[&args[..], &["--duration", "300ms", "--cpu", "0"]].concat())
        .env("PATH", folder)
        .output()
        .unwrap()
}

fn folder_of(folder: &Folder) -> std::path::PathBuf {
    Path::new(&folder.file("")).to_path_buf()
}

#[test]
fn jitter_comparison_gives_ratios() {
    let _alone = alone();
    let output = std::fs::read_to_string(kept("cyclictest.json")).unwrap();
    let folder = fake(&output, 0);
    let report = json(&compare(&folder_of(&folder)), 0);
    for quantile in ["p50", "p99", "p999", "max"] {
        assert!(
            report["ratio"][quantile].as_f64().unwrap() > 0.0,
            "{report}"
        );
    }
    assert_eq!(report["compare"]["tool"], "cyclictest 2.40");
    assert_eq!(report["compare"]["slices"].as_array().unwrap().len(), 2);
    let arguments = std::fs::read_to_string(folder.file("arguments")).unwrap();
    for part in [
        "--mlockall",
        "--priority=80",
        "--interval=1000",
        "--loops=150",
        "--affinity=0",
    ] {
        assert!(arguments.contains(part), "{arguments}");
    }
}

#[test]
fn jitter_failed_comparison_names_cause() {
    let _alone = alone();
    let nothing = Folder::new();
    let absent = compare(&folder_of(&nothing));
    expect_status(&absent, 2);
    assert!(complaint(&absent).contains("apt install rt-tests"));
    for (text, status, why) in [
        ("no figures\n", 0, "not understood"),
        ("{\n \"thread\": {}\n}\n", 0, "not understood"),
        ("", 3, "exit status: 3"),
    ] {
        let folder = fake(text, status);
        let output = compare(&folder_of(&folder));
        expect_status(&output, 2);
        assert!(complaint(&output).contains(why), "{}", complaint(&output));
    }
}

#[test]
fn jitter_reads_real_cyclictest() {
    let _alone = alone();
    let path = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&path).any(|folder| folder.join("cyclictest").exists());
    let args = [
        "jitter",
        "--compare",
        "cyclictest",
        "--slices",
        "2",
        "--json",
    ];
    let output = run(&[&args[..], &["--duration", "400ms"]].concat());
    let is_refused = complaint(&output).contains("cyclictest ended with");
    if !found || is_refused {
        let test = "jitter_reads_real_cyclictest";
        return skip(test, "needs cyclictest (rt-tests)");
    }
    let report = json(&output, 0);
    assert!(report["ratio"]["p50"].as_f64().unwrap() > 0.0, "{report}");
    assert_eq!(report["compare"]["threads"][0]["cycles"], 400);
}

/// The picture and the JSON of a kept report; `TRYCMD=overwrite` writes the picture again.
#[test]
fn jitter_pictures_match_goldens() {
    let folder = Folder::new();
    for name in ["takt", "compare"] {
        let file = kept(&format!("{name}.json"));
        let drawn = folder.file("drawn.svg");
        let output = run(&["jitter", "--from", &file, "--json", "--svg", &drawn]);
        let report = json(&output, 0);
        let text = std::fs::read_to_string(&file).unwrap();
        assert_eq!(report, serde_json::from_str::<Value>(&text).unwrap());
        let golden = kept(&format!("{name}.svg"));
        let drawn = std::fs::read_to_string(drawn).unwrap();
        if std::env::var_os("TRYCMD").is_some_and(|mode| mode == "overwrite") {
            std::fs::write(golden, drawn).unwrap();
            continue;
        }
        let kept = std::fs::read_to_string(golden).unwrap();
        let differs = kept.lines().zip(drawn.lines()).find(|(a, b)| a != b);
        assert!(kept == drawn, "{name}.svg differs: {differs:?}");
    }
}

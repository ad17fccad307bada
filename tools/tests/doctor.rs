//! `takt doctor` as it is called: reports of two whole hosts, JSON, writing and taking back, saving this host.
//!
//! What each condition finds is tested beside the conditions.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value;

fn doctor(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_takt"));
    let command = command.arg("doctor").args(arguments).stdin(Stdio::null());
    command.output().unwrap()
}

fn text(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn host(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/doctor")
        .join(name)
}

/// A path of this test's own that does not exist.
fn fresh(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&path);
    path
}

/// Every file below a folder, with what it says.
fn files(folder: &Path) -> BTreeMap<PathBuf, String> {
    let mut found = BTreeMap::new();
    for item in fs::read_dir(folder).unwrap() {
        let path = item.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else if !path.is_symlink() {
            let text = fs::read_to_string(&path).unwrap();
            found.insert(path, text);
        }
    }
    found
}

/// A copy of the bad host, to be written to.
fn patient(name: &str) -> PathBuf {
    let (from, to) = (host("bad"), fresh(name));
    for (path, text) in files(&from) {
        let copy = to.join(path.strip_prefix(&from).unwrap());
        fs::create_dir_all(copy.parent().unwrap()).unwrap();
        fs::write(copy, text).unwrap();
    }
    to
}

#[test]
fn doctor_reports_match_goldens() {
    let package = env!("CARGO_MANIFEST_DIR");
    std::env::set_current_dir(format!("{package}/..")).unwrap();
    trycmd::TestCases::new().case(format!("{package}/tests/doctor/*.trycmd"));
}

#[test]
fn reports_fit_a_terminal_of_80_columns() {
    for name in ["good", "bad"] {
        let output = doctor(&["--root", host(name).to_str().unwrap()]);
        for line in text(&output).lines() {
            assert!(line.chars().count() <= 80, "{line}");
        }
    }
}

#[test]
fn json_has_exactly_the_promised_keys() {
    let output = doctor(&["--json", "--root", host("bad").to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    let object: Value = serde_json::from_slice(&output.stdout).unwrap();
    let conditions = object["conditions"].as_array().unwrap();
    assert!(conditions.len() >= 20);
    for condition in conditions {
        let keys: Vec<&String> = condition.as_object().unwrap().keys().collect();
        assert_eq!(keys, ["name", "read", "remedy", "status", "why"]);
        let status = condition["status"].as_str().unwrap();
        assert!(["ok", "WARN", "FAIL", "skip"].contains(&status), "{status}");
    }
    let fails = conditions.iter().filter(|c| c["status"] == "FAIL").count();
    assert_eq!(object["summary"]["fail"], fails);
    assert_eq!(object["version"], 1);
}

#[test]
fn doctor_apply_writes_listed_changes_undo_restores_them() {
    let root = patient("doctor-apply");
    let root_text = root.to_str().unwrap();
    let before = files(&root);

    let output = doctor(&["--root", root_text, "--apply"]);
    assert_eq!(output.status.code(), Some(2), "no terminal");
    assert_eq!(files(&root), before);

    let output = doctor(&["--root", root_text, "--apply", "--yes", "--quiet"]);
    assert_eq!(output.status.code(), Some(1), "not all can be fixed so");
    let printed = text(&output);
    let listed: BTreeMap<PathBuf, (String, String)> = printed
        .lines()
        .filter_map(|line| line.split_once(" -> "))
        .map(|(head, new)| {
            let (path, old) = head.trim().split_once(": ").unwrap();
            let path = root.join(path.trim_start_matches('/'));
            (path, (old.to_owned(), new.to_owned()))
        })
        .collect();
    assert!(listed.len() >= 20, "{printed}");
    let mut after = files(&root);
    after.retain(|path, _| !path.ends_with("var/lib/takt/doctor-undo.json"));
    let changed: Vec<&PathBuf> = after
        .iter()
        .filter(|(path, text)| before.get(*path) != Some(*text))
        .map(|(path, _)| path)
        .collect();
    assert_eq!(changed, listed.keys().collect::<Vec<_>>());
    for (path, (old, new)) in &listed {
        assert!(before[path].contains(old.as_str()), "{}", path.display());
        assert_eq!(after[path].trim(), new);
    }
    assert!(!printed.contains("swappiness  "), "fixed: {printed}");

    // Another program changes a setting meanwhile.
    let opinion = root.join("proc/sys/vm/stat_interval");
    fs::write(&opinion, "42\n").unwrap();
    let output = doctor(&["--root", root_text, "--undo"]);
    assert_eq!(output.status.code(), Some(0));
    let undone = files(&root);
    for (path, (old, _)) in &listed {
        let expected = if *path == opinion { "42" } else { old };
        assert_eq!(undone[path].trim(), expected, "{}", path.display());
    }
    assert_eq!(undone.len(), before.len(), "the undo file is removed");
    let output = doctor(&["--root", root_text, "--undo"]);
    assert_eq!(text(&output), "nothing to undo\n");
}

#[test]
fn doctor_undo_after_two_writes_restores_first_value() {
    let root = patient("doctor-twice");
    let setting = root.join("proc/sys/vm/swappiness");
    let apply = ["--root", root.to_str().unwrap(), "--apply", "--yes"];
    doctor(&apply);
    doctor(&apply);
    assert_eq!(fs::read_to_string(&setting).unwrap(), "10\n");
    doctor(&["--root", root.to_str().unwrap(), "--undo"]);
    assert_eq!(fs::read_to_string(&setting).unwrap(), "60\n");
}

#[test]
fn doctor_unwritable_undo_file_writes_nothing() {
    let root = patient("doctor-no-undo");
    fs::write(root.join("var"), "a file in the way of the folder").unwrap();
    let before = files(&root);
    let output = doctor(&["--root", root.to_str().unwrap(), "--apply", "--yes"]);
    assert_eq!(output.status.code(), Some(2));
    assert_eq!(files(&root), before);
}

#[test]
fn doctor_save_of_this_host_gives_same_report() {
    let names = |output: &Output| -> Vec<String> {
        let object: Value = serde_json::from_slice(&output.stdout).unwrap();
        let conditions = object["conditions"].as_array().unwrap().iter();
        conditions
            .map(|c| c["name"].as_str().unwrap().to_owned())
            .collect()
    };
    let live = doctor(&["--json"]);
    assert!(matches!(live.status.code(), Some(0 | 1)));
    let saved = fresh("doctor-saved");
    let saved = saved.to_str().unwrap();
    assert_eq!(doctor(&["--save", saved]).status.code(), Some(0));
    let again = doctor(&["--json", "--root", saved]);
    assert_eq!(names(&again), names(&live));
    let onto_itself = doctor(&["--save", saved]);
    assert_eq!(onto_itself.status.code(), Some(2), "not over another tree");
}

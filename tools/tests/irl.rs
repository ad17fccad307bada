//! `takt irl check`, `compile`, `explain`, and `run` in virtual time: what they print and write, and their exit status. What programs
//! do is tested in takt-irl, runs on controllers in `irl_run`.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;

use std::path::Path;

use common::{Folder, complaint, expect_status, run};
use serde_json::Value;

fn example(name: &str) -> String {
    format!("{}/../examples/irl/{name}", env!("CARGO_MANIFEST_DIR"))
}

const SPEC: &str = "[[robot]]\nname = 'axis'\njoints = [{ min = -90, max = 90, speed = 90, acceleration = 360, jerk = 3600 }]\n\
    [[signal]]\nname = 'ready'\ndirection = 'in'\nkind = 'digital'\nchannel = 0\n\
    [[signal]]\nname = 'count'\ndirection = 'out'\nkind = 'binary'\nchannel = 0\nbits = 4\n";

const GOOD: &str = "program good;\nsystem_specification \"axis.spc\";\nvar n: int; signal in ready = \"ready\"; out count = \"count\";\n\
    begin\n  move ptp mainjoint(45) speed_ptp := 0.5;\n  wait for ready timeout 1;\n  n := 1;\n  if timed_out then n := 0; endif;\n\
    \x20 count := 2 div n;\nendprogram;\n";

const BAD: &str = "program bad;\nsystem_specification \"axis.spc\";\nvar n: int;\nbegin\n  n := ;\n  m := 1;\nendprogram;\n";

/// A folder with a specification, a program, and one with errors.
fn folder() -> (Folder, String, String) {
    let folder = Folder::new();
    folder.write("axis.spc", SPEC);
    let good = folder.write("good.irl", GOOD);
    let bad = folder.write("bad.irl", BAD);
    (folder, good, bad)
}

fn objects(text: &str) -> Vec<Value> {
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[test]
fn irl_check_names_each_error_with_location() {
    let (_folder, good, bad) = folder();
    let out = expect_status(&run(&["irl", "check", &good]), 0);
    assert!(out.starts_with(&format!("{good}: good, ")), "{out}");

    let checked = run(&["irl", "check", &bad]);
    assert_eq!(expect_status(&checked, 1), "");
    let text = complaint(&checked);
    assert!(text.contains("Error[E0102]: "), "{text}");
    assert!(text.contains(&format!("--> {bad}:5:8\n")), "{text}");
    assert!(text.contains("Error[E0201]: "), "{text}");
    assert!(text.contains('^') && text.contains("\nhint: "), "{text}");
    assert!(text.ends_with(&format!("{bad}: 2 errors\n")), "{text}");
}

#[test]
fn irl_message_format_json_is_a_line_each() {
    let (folder, good, bad) = folder();
    for command in ["check", "compile", "explain", "run"] {
        let found = run(&["irl", command, &bad, "--message-format", "json"]);
        assert_eq!(expect_status(&found, 1), "");
        let found = objects(&complaint(&found));
        let of = |d: &Value| {
            let number = |key: &str| d[key].as_u64().unwrap();
            let code = d["code"].as_str().unwrap().to_owned();
            (code, number("line"), number("column"))
        };
        let places: Vec<_> = found.iter().map(of).collect();
        let expected = [("E0102".to_owned(), 5, 8), ("E0201".to_owned(), 6, 3)];
        assert_eq!(places, expected, "{command}");
        assert_eq!(found[0]["file"], bad.as_str());
        assert_eq!(found[0]["severity"], "error");
        assert!(found[0]["end"].as_u64() > found[0]["start"].as_u64());
    }
    let checked = run(&["irl", "check", &good, "--message-format", "json"]);
    expect_status(&checked, 0);
    assert_eq!(complaint(&checked), "");
    let one = run(&["irl", "check", &bad, "--json"]);
    let one = &objects(&expect_status(&one, 1))[0];
    assert_eq!(one["ok"], false);
    assert_eq!(one["diagnostics"].as_array().unwrap().len(), 2);

    let text = GOOD.replace("mainjoint(45)", "robtarget(pose(), 4, 0)");
    let warned = folder.write("warned.irl", &text);
    let warned = run(&["irl", "check", &warned, "--message-format", "json"]);
    assert!(!objects(&complaint(&warned)).is_empty());
}

#[test]
fn irl_check_deny_warnings_fails() {
    let folder = Folder::new();
    let text = "program t; move ptp robtarget(pose((600, 0, 300), orivang(position(0, 1, 0), 180)), 4) act_rob := \"tx90\"; endprogram;";
    let file = folder.write("warned.irl", text);
    let spc = example("two.spc");
    let checked = run(&["irl", "check", &file, "--spc", &spc]);
    let out = expect_status(&checked, 0);
    assert!(out.contains(": good, "), "{out}");
    assert!(complaint(&checked).contains("Warning[W0901]"));
    let denied = run(&["irl", "check", &file, "--spc", &spc, "--deny-warnings"]);
    expect_status(&denied, 1);
}

#[test]
fn irl_specification_faults_have_status_and_cause() {
    let (folder, good, _) = folder();
    // What the program names is an error of the program, what the command line names one of the command line.
    folder.write("axis.spc", &SPEC.replacen("max = 90", "max = -91", 1));
    let invalid = run(&["irl", "check", &good]);
    expect_status(&invalid, 1);
    let text = complaint(&invalid);
    assert!(text.contains("Error[E0501]: "), "{text}");
    assert!(text.contains(&format!("{good}:2:22\n")), "{text}");
    assert!(text.contains("joint 1: min must be below max"), "{text}");
    std::fs::remove_file(folder.file("axis.spc")).unwrap();
    let missing = run(&["irl", "run", &good, "--message-format=json"]);
    expect_status(&missing, 1);
    let found = objects(&complaint(&missing));
    assert_eq!(found[0]["code"], "E0501");
    assert!(found[0]["text"].as_str().unwrap().contains("cannot read"));

    let other = folder.file("other.spc");
    let missing = run(&["irl", "check", &good, "--spc", &other]);
    expect_status(&missing, 2);
    assert!(complaint(&missing).contains("No such file"));
    for (text, cause) in [
        (
            SPEC.replace("bits = 4", "bits = 40"),
            "bits is 40; binary signals have 1 to 31",
        ),
        (
            SPEC.replace("channel = 0", "channel = 0\nio = 'io'"),
            "`io` is not DEVICE:PORT",
        ),
        (
            SPEC.replace("bits = 4", "io = 'io:1'"),
            "signal `count`: io:1 is digital; give the signal its `bits`",
        ),
        (
            SPEC.replace("bits = 4", "bits = 4\nio = 'io:65533'"),
            "io:65533 leaves no ports for its bits",
        ),
    ] {
        folder.write("other.spc", &text);
        let refused = run(&["irl", "check", &good, "--spc", &other]);
        expect_status(&refused, 2);
        let found = complaint(&refused);
        assert!(
            found.contains("other.spc is invalid") && found.contains(cause),
            "{found}"
        );
    }
}

#[test]
fn irl_check_unusable_file_is_named() {
    let (folder, good, _) = folder();
    let code = folder.file("good.irlc");
    expect_status(&run(&["irl", "compile", &good]), 0);
    let missing = folder.file("missing.irl");
    let binary = folder.file("binary.irl");
    std::fs::write(&binary, [0xFF, 0xFE, 0x00]).unwrap();
    for (file, cause) in [
        (&missing, "No such file"),
        (&code, "is object code\nhint: name the source"),
        (&binary, "it is not text in UTF-8"),
    ] {
        let refused = run(&["irl", "check", file]);
        expect_status(&refused, 2);
        let text = complaint(&refused);
        assert!(
            text.contains(file.as_str()) && text.contains(cause),
            "{text}"
        );
    }
}

#[test]
fn irl_compile_writes_code_text_and_xml() {
    let (folder, good, bad) = folder();
    let out = expect_status(&run(&["irl", "compile", &good]), 0);
    let code = folder.file("good.irlc");
    assert!(out.starts_with(&format!("{code}: good, ")), "{out}");
    assert!(std::fs::read(&code).unwrap().starts_with(b"TIRL"));
    for (form, extension) in [("text", "lst"), ("xml", "xml")] {
        // From the source, and from object code.
        let listing = |file: &str| {
            expect_status(&run(&["irl", "compile", file, "--emit", form]), 0);
            let written = folder.file(&format!("good.{extension}"));
            let text = std::fs::read_to_string(&written).unwrap();
            std::fs::remove_file(written).unwrap();
            text
        };
        let of_source = listing(&good);
        assert_eq!(of_source, listing(&code));
        let xml = if form == "xml" {
            "--xml"
        } else {
            "--message-format=human"
        };
        let explained = expect_status(&run(&["irl", "explain", &code, xml]), 0);
        assert_eq!(explained, of_source);
        let signal = if form == "xml" {
            "bits=\"4\""
        } else {
            "signal count: Out Binary 0, 4 bits"
        };
        assert!(of_source.contains(signal), "{of_source}");
    }
    let xml = expect_status(&run(&["irl", "explain", &good, "--xml"]), 0);
    assert!(
        xml.starts_with("<?xml ") && xml.ends_with("</program>\n"),
        "{xml}"
    );

    let elsewhere = folder.file("elsewhere");
    expect_status(&run(&["irl", "compile", &good, "-o", &elsewhere]), 0);
    assert_eq!(
        std::fs::read(&elsewhere).unwrap(),
        std::fs::read(&code).unwrap()
    );
    let nowhere = folder.file("no/where");
    let refused = run(&["irl", "compile", &good, "-o", &nowhere]);
    expect_status(&refused, 2);
    assert!(
        complaint(&refused).contains("cannot write"),
        "{}",
        complaint(&refused)
    );
    expect_status(&run(&["irl", "compile", &bad]), 1);
    assert!(!Path::new(&folder.file("bad.irlc")).exists());
}

#[test]
fn irl_changed_object_code_is_refused() {
    let (folder, good, _) = folder();
    expect_status(&run(&["irl", "compile", &good]), 0);
    let code = folder.file("good.irlc");
    let bytes = std::fs::read(&code).unwrap();
    for (at, cause) in [(4, "version"), (40, "the object code is damaged")] {
        let mut changed = bytes.clone();
        changed[at] ^= 0x20;
        std::fs::write(&code, changed).unwrap();
        for command in ["compile", "explain", "run"] {
            let refused = run(&["irl", command, &code]);
            expect_status(&refused, 2);
            let text = complaint(&refused);
            assert!(text.contains(cause) && text.contains("\nhint: "), "{text}");
        }
    }
}

#[test]
fn irl_run_in_virtual_time_reports_end_or_fault() {
    let (folder, good, bad) = folder();
    let ended = run(&["irl", "run", &good, "--input", "ready=1"]);
    let out = expect_status(&ended, 0);
    assert!(out.contains("axis: at 45.000 deg\n"), "{out}");
    assert!(out.contains(": ended after "), "{out}");

    let failed = run(&["irl", "run", &good, "--input", "ready=0"]);
    expect_status(&failed, 1);
    let text = complaint(&failed);
    assert!(
        text.contains(&format!("{good}:9:12: division by zero")),
        "{text}"
    );
    let failed = run(&["irl", "run", &good, "--input", "ready=0", "--json"]);
    let object = &objects(&expect_status(&failed, 1))[0];
    assert_eq!(
        (&object["ok"], &object["fault"]["code"]),
        (&false.into(), &1.into())
    );
    assert_eq!(object["fault"]["line"], 9);

    let csv = folder.file("path.csv");
    expect_status(
        &run(&[
            "irl", "run", &good, "--input", "ready=1", "--csv", &csv, "--period", "2ms",
        ]),
        0,
    );
    let rows = std::fs::read_to_string(&csv).unwrap();
    assert!(rows.starts_with("time_s,axis.1_deg\n0.002000,"), "{rows}");
    assert!(rows.ends_with(",45.000000\n"), "{rows}");

    let text = GOOD.replace(" timeout 1", "");
    let endless = folder.write("endless.irl", &text);
    let late = run(&[
        "irl",
        "run",
        &endless,
        "--input",
        "ready=0",
        "--duration",
        "2s",
    ]);
    expect_status(&late, 1);
    let text = complaint(&late);
    assert!(
        text.contains(":6: did not end within 2.000 s\nhint: "),
        "{text}"
    );
    expect_status(&run(&["irl", "run", &bad]), 1);
}

#[test]
fn irl_run_refuses_wrong_inputs_and_options() {
    let (_folder, good, _) = folder();
    let cases: [(&[&str], &str); 9] = [
        (&["--input", "ready"], "`ready` is not SIGNAL=VALUE"),
        (
            &["--input", "redy=1"],
            "the program has no signal `redy`\nhint: its signals are ready, count",
        ),
        (
            &["--input", "ready=2"],
            "`2` is not a value of signal `ready`: give 0 or 1",
        ),
        (&["--input", "count=2"], "`count` is an output"),
        (&["--steps", "1"], "16..=100000"),
        (&["--period", "5"], "--period"),
        (
            &["--connect", "127.0.0.1:1", "--period", "1ms"],
            "cannot be used with",
        ),
        (
            &["--connect", "127.0.0.1:1", "--input", "ready=1"],
            "127.0.0.1:1",
        ),
        (
            &["--override", "2", "--emulated", "two_lwr"],
            "must be 0 to 1",
        ),
    ];
    for (args, cause) in cases {
        let refused = run(&[&["irl", "run", &good], args].concat());
        expect_status(&refused, 2);
        let text = complaint(&refused);
        assert!(text.contains(cause), "{args:?}: {text}");
    }
}

#[test]
fn irl_examples_run_in_virtual_time() {
    let inputs: [(&str, &[&str]); 7] = [
        ("lola15", &[]),
        ("palletize", &[]),
        ("lwr", &[]),
        ("iiwa", &["--input", "part_present=1"]),
        ("tx90", &[]),
        ("youbot", &[]),
        ("station", &["--input", "start=1", "--input", "order=2"]),
    ];
    for (name, inputs) in inputs {
        let file = example(&format!("{name}.irl"));
        let out = expect_status(&run(&[&["irl", "run", &file], inputs].concat()), 0);
        assert!(out.contains(": ended after "), "{out}");
    }
}

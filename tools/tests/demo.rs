//! `takt demo` as its users run it: report, recording, replay, lost datagrams. How good the
//! figures are is not asked: that is the host's matter.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;

use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use common::{Folder, Process, alone, complaint, expect_status, run, run_with_input};
use serde_json::Value;
use takt_tests::{skip, steady};

/// A demo's report, and whether the demo held it for good.
fn demo(args: &[&str]) -> (Value, bool) {
    let folder = Folder::new();
    let svg = folder.file("demo.svg");
    let basics = ["demo", "--duration", "2s", "--json", "--svg", &svg];
    let output = run(&[&basics, args].concat());
    let good = output.status.success();
    let report = expect_status(&output, if good { 0 } else { 1 });
    assert_eq!(report.lines().count(), 1, "{report}");
    assert!(std::fs::read_to_string(&svg).unwrap().ends_with("</svg>\n"));
    (serde_json::from_str(&report).unwrap(), good)
}

/// A demo fails on a host that stalls; such a run is no evidence about Takt.
fn good_demo(args: &[&str]) -> Value {
    steady(|| {
        let (report, good) = demo(args);
        assert!(good, "{}", report["faults"]);
        report
    })
}

#[test]
fn demo_reports_what_was_promised() {
    let _alone = alone();
    let report = good_demo(&[]);
    assert_eq!(report["ok"], true);
    assert_eq!(report["faults"], serde_json::json!([]));
    assert!(report["realtime"].is_boolean());
    // The motion alone takes 2,000 cycles; those that were missed count.
    let cycles = report["cycles"].as_u64().unwrap() + report["overruns"].as_u64().unwrap();
    assert!(cycles >= 2000, "{report}");
    assert_eq!(report["rt_allocations"], 0);
    if report["memory_locked"] == true {
        assert_eq!(report["rt_page_faults"], 0);
    }
    assert!(report["sync_error_ns_max"].as_i64().unwrap() > 0);
    let quantiles = ["p50", "p99", "p999", "max"];
    let latency = quantiles.map(|q| report["latency_ns"][q].as_i64().unwrap());
    assert!(latency.is_sorted(), "{latency:?}");
    let phase = quantiles.map(|q| report["phase_error_ns"][q].as_i64().unwrap());
    assert!(phase.is_sorted(), "{phase:?}");
    let known = report["phase_known"].as_u64().unwrap();
    assert!(known > 1000, "the robot's clock was hardly known: {known}");
    let robots = report["robots"].as_array().unwrap();
    let names: Vec<_> = robots.iter().map(|robot| &robot["name"]).collect();
    assert_eq!(names, ["left", "right"]);
    for robot in robots {
        assert_eq!(robot["protocol"], "fri1");
        assert_eq!(robot["period_ns"], 1_000_000);
        assert!(robot["datagrams"].as_u64().unwrap() > 1000, "{robot}");
        assert!(
            robot["lost"].is_u64() && robot["quality"].is_string(),
            "{robot}"
        );
        let error = robot["tracking_error_rad_max"].as_f64().unwrap();
        assert!(error > 0.0 && error < 0.5, "{robot}");
    }
}

#[test]
fn demo_lola_passes_all_states_and_replays() {
    let _alone = alone();
    let folder = Folder::new();
    let recording = folder.file("lola.mcap");
    let simulated = ["--time", "simulated"];
    let report = good_demo(&[&["--cell", "lola", "--record", &recording], &simulated[..]].concat());
    let states = report["states"].as_array().unwrap();
    let names: Vec<_> = states.iter().map(|state| state[0].clone()).collect();
    let expected = [
        "StartRobot",
        "CalibrateOffsets",
        "InitializationSequence",
        "MoveRobot",
        "StopRobot",
    ];
    assert_eq!(names, expected);
    let times: Vec<f64> = states
        .iter()
        .filter_map(|state| state[1].as_f64())
        .collect();
    assert!(times.is_sorted() && times.len() == 5, "{times:?}");
    assert_eq!(report["rt_allocations"], 0);
    // From the switches to the program's 45 degrees.
    let moved = report["robots"][0]["moved_rad_max"].as_f64().unwrap();
    assert!(moved > 2.0, "{report}");
    let replay = run(&["demo", "--from", &recording]);
    let text = expect_status(&replay, 0);
    assert!(text.contains("every byte as recorded"), "{text}");
    let info = expect_status(&run(&["record", "info", &recording]), 0);
    assert!(info.contains("/rosout "), "the log is missing: {info}");
}

#[test]
fn demo_factory_moves_two_lwrs_tx90_and_youbot() {
    let _alone = alone();
    let report = good_demo(&["--robots", "factory", "--time", "simulated"]);
    let robots = report["robots"].as_array().unwrap();
    let of = |key: &str| -> Vec<_> { robots.iter().map(|robot| robot[key].clone()).collect() };
    assert_eq!(of("name"), ["left", "right", "tx90", "arm", "base"]);
    assert_eq!(
        of("protocol"),
        ["fri1", "fri1", "ethercat", "ethercat", "ethercat"]
    );
    assert_eq!(
        of("period_ns"),
        [1_000_000, 1_000_000, 2_000_000, 2_000_000, 2_000_000]
    );
    let moved = of("moved_rad_max");
    assert!(
        moved.iter().all(|moved| moved.as_f64().unwrap() > 0.05),
        "{report}"
    );
    assert!(robots[2]["frames"].as_u64().unwrap() > 500, "{report}");
    assert_eq!(report["rt_allocations"], 0);
}

/// Waits until the demo requested the motion of a device again.
fn wait_for_motion(demo: &mut Process, device: &str) {
    demo.wait_until(&format!("motion of {device} requested again"), |line| {
        line.starts_with("motion is requested again for") && line.contains(device)
    });
}

/// The report of a factory demo whose devices `upset` gives faults, each recovered with a stall for its cause, and all it
/// printed.
fn factory_after(upset: impl Fn(&mut Process)) -> (Value, String) {
    let folder = Folder::new();
    let svg = folder.file("demo.svg");
    let args = ["demo", "--robots", "factory", "--json", "--svg", &svg];
    let mut demo = Process::start(&[&args[..], &["--duration", "20s"]].concat());
    demo.wait_for("the motion begins");
    upset(&mut demo);
    let (lines, status) = demo.end();
    let all = lines.join("\n");
    let report = lines.iter().find(|line| line.starts_with('{')).unwrap();
    let report: Value = serde_json::from_str(report).unwrap();
    assert_eq!(report["faults"], serde_json::json!([]), "{all}");
    assert_eq!((&report["ok"], status), (&Value::Bool(true), Some(0)));
    let devices = report["devices"].as_array().unwrap();
    let names: Vec<_> = devices
        .iter()
        .map(|it| it["name"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["left", "right", "tx90", "base", "arm", "hand"]);
    for (device, name) in devices.iter().zip(names) {
        let keys = ["faults", "recovered", "without_stall"];
        let [faults, recovered, without] = keys.map(|key| device[key].as_u64().unwrap());
        assert_eq!((faults, 0), (recovered, without), "{name}\n{all}");
        // A line for each when it came, with its cause.
        let of_device = |line: &&String| line.contains(&format!("{name} stopped following"));
        let reported: Vec<_> = lines.iter().filter(of_device).collect();
        assert!(reported.len() as u64 <= faults, "{all}");
        assert_eq!(reported.is_empty(), faults == 0, "{all}");
        let caused = |line: &&String| line.contains("this host stalled for");
        assert!(reported.iter().all(caused), "{all}");
    }
    assert_eq!(report["interrupted"], report["requested_again"], "{all}");
    (report, all)
}

/// Whether this process may start one above all drivers.
fn may_take_a_processor() -> bool {
    let may = |command: &mut Command| command.output().is_ok_and(|it| it.status.success());
    may(Command::new("chrt").args(["-f", "97", "true"]))
        && may(Command::new("taskset").args(["-p", "1"]))
}

fn faults(report: &Value, device: &str) -> u64 {
    let devices = report["devices"].as_array().unwrap();
    let found = devices.iter().find(|it| it["name"] == device).unwrap();
    found["faults"].as_u64().unwrap()
}

#[test]
fn stopped_factory_demo_recovers_and_moves_again() {
    let _alone = alone();
    steady(|| {
        let (report, all) = factory_after(|demo| {
            for stall_ms in [150, 400, 150] {
                demo.stall(Duration::from_millis(stall_ms));
                wait_for_motion(demo, "left and right");
                wait_for_motion(demo, "tx90");
            }
        });
        assert!(report["interrupted"].as_u64().unwrap() >= 6, "{all}");
        for device in ["left", "right", "tx90"] {
            assert!(faults(&report, device) >= 3, "{device}\n{all}");
        }
        let longest = report["longest_stall_ns"].as_u64().unwrap();
        assert!(longest >= 400_000_000, "it was stopped for so long: {all}");
        assert!(report["memory_end_kib"].as_u64().unwrap() > 0);
    });
}

#[test]
fn stalled_bus_thread_is_named_and_youbot_recovers() {
    if !may_take_a_processor() {
        return skip(
            "stalled_bus_thread_is_named_and_youbot_recovers",
            "needs chrt, taskset and the right to SCHED_FIFO",
        );
    }
    let _alone = alone();
    steady(|| {
        let (report, all) = factory_after(|demo| {
            for _ in 0..2 {
                demo.stall_thread("takt-youbot", Duration::from_millis(150));
                wait_for_motion(demo, "base");
            }
        });
        for device in ["arm", "base"] {
            assert!(faults(&report, device) >= 2, "{device}\n{all}");
        }
        let named = |line: &str| line.contains("base stopped") && line.contains("thread youbot");
        assert!(all.lines().any(named), "{all}");
    });
}

#[test]
fn demo_replayed_gives_every_byte_as_recorded() {
    let _alone = alone();
    let folder = Folder::new();
    let recording = folder.file("demo.mcap");
    // A demo that failed is replayed just the same, if its net ran at all.
    steady(|| assert!(demo(&["--record", &recording]).0["cycles"].is_u64()));
    let replay = run(&["demo", "--from", &recording]);
    let text = expect_status(&replay, 0);
    assert!(text.contains("every byte as recorded"), "{text}");

    let mut bytes = std::fs::read(&recording).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&recording, bytes).unwrap();
    let replay = run(&["demo", "--from", &recording]);
    assert!(!replay.status.success(), "a changed recording passes");
    assert!(
        complaint(&replay).contains("demo.mcap"),
        "{}",
        complaint(&replay)
    );
}

#[test]
fn demo_killed_leaves_readable_recording() {
    let _alone = alone();
    steady(|| {
        let folder = Folder::new();
        let (recording, svg) = (folder.file("demo.mcap"), folder.file("demo.svg"));
        let arguments = ["demo", "--record", &recording, "--svg", &svg];
        let mut demo = Process::start(&[&arguments[..], &["--duration", "60s"]].concat());
        demo.wait_for("the motion begins");
        let len = || std::fs::metadata(&recording).map_or(0, |file| file.len());
        // Two chunks.
        for _ in 0..2 {
            let before = len();
            while len() == before {
                std::thread::sleep(Duration::from_millis(20));
            }
        }
        demo.kill();
        let replayed = run(&["demo", "--from", &recording]);
        let output = expect_status(&replayed, 0);
        let cycles: u64 = output.split([' ', ',']).nth(1).unwrap().parse().unwrap();
        assert!(cycles > 0, "{output}");
        assert!(
            complaint(&replayed).contains("the recording is cut off"),
            "{}",
            complaint(&replayed)
        );
    });
}

#[test]
fn demo_interrupted_reports_what_was_measured() {
    let _alone = alone();
    steady(|| {
        let folder = Folder::new();
        let (recording, svg) = (folder.file("demo.mcap"), folder.file("demo.svg"));
        let arguments = ["demo", "--json", "--record", &recording, "--svg", &svg];
        let mut demo = Process::start(&[&arguments[..], &["--duration", "60s"]].concat());
        demo.wait_for("the motion begins");
        std::thread::sleep(Duration::from_secs(1));
        demo.signal("INT");
        let (lines, status) = demo.end();
        assert_eq!(status, Some(1), "{lines:?}");
        let report = lines.iter().find(|line| line.starts_with('{')).unwrap();
        let report: Value = serde_json::from_str(report).unwrap();
        let faults = report["faults"].to_string();
        assert!(
            faults.contains("a signal stopped the motion after "),
            "{faults}"
        );
        assert!(report["cycles"].as_u64().unwrap() > 500, "{report}");
        assert!(std::fs::read_to_string(&svg).unwrap().ends_with("</svg>\n"));
        let replayed = run(&["demo", "--from", &recording]);
        expect_status(&replayed, 0);
        assert_eq!(complaint(&replayed), "", "the recording is complete");
    });
}

#[test]
fn demo_unwritable_picture_is_reported_before_the_run() {
    let output = run(&[
        "demo",
        "--duration",
        "60s",
        "--svg",
        "/nonexistent/demo.svg",
    ]);
    expect_status(&output, 2);
    let error = complaint(&output);
    assert!(
        error.contains("cannot write /nonexistent/demo.svg: No such file or directory"),
        "{error}"
    );
    assert!(!error.contains("the motion begins"), "{error}");
}

#[test]
fn demo_goes_on_or_names_the_fault_at_five_percent_loss() {
    let _alone = alone();
    let (report, good) = steady(|| demo(&["--drop", "0.05"]));
    let faults = report["faults"].as_array().unwrap();
    assert_eq!(good, faults.is_empty(), "{report}");
    assert!(
        faults
            .iter()
            .all(|fault| fault.as_str().is_some_and(|f| !f.is_empty()))
    );
    if good {
        let lost = |robot: &Value| robot["lost"].as_u64().unwrap();
        let robots = report["robots"].as_array().unwrap();
        assert!(robots.iter().all(|robot| lost(robot) > 20), "{report}");
    }
}

#[test]
fn net_of_the_demo_is_an_ordinary_net() {
    let net = expect_status(&run(&["demo", "--print-net"]), 0);
    assert_eq!(
        net,
        common::net("demo"),
        "tests/nets/demo is not the demo's net any more"
    );
    let check = run_with_input(&["net", "check", "-"], &net);
    assert!(expect_status(&check, 0).contains("good"));
}

#[test]
fn guarded_demo_survives() {
    let _alone = alone();
    // The process would end at the first allocation in a real-time thread, with a signal.
    let (report, _) = steady(|| demo(&["--guard"]));
    assert!(report["faults"].is_array());
}

#[test]
fn picture_of_a_net_shows_every_primitive() {
    let net = common::net("demo");
    let svg = expect_status(&run_with_input(&["net", "dot", "-"], &net), 0);
    let boxes = svg.matches("rx=\"4\"").count();
    let check = run_with_input(&["net", "check", "--json", "-"], &net);
    let check: Value = serde_json::from_str(&expect_status(&check, 0)).unwrap();
    assert_eq!(check["primitives"], boxes - 1, "one box ends the net");
    assert!(svg.ends_with("</svg>\n"));
    let broken = run_with_input(&["net", "dot", "-"], "{a=Core::Clock(");
    expect_status(&broken, 1);
}

/// The report of a good assembly. It runs in simulated time: no host is its excuse.
fn assembly(options: &[&str]) -> Value {
    let folder = Folder::new();
    let recording = folder.file("assembly.mcap");
    let args = ["--cell", "assembly", "--record", &recording];
    let (report, good) = demo(&[&args[..], options].concat());
    assert!(good, "{options:?}: {report:#}");
    assert_eq!(report["controller"]["overruns"], 0, "{report:#}");
    report
}

/// None, and all faults that no other test switches on, each with places and dockings of its own; two runs at once.
#[test]
fn demo_assembly_meets_each_fault_as_documented() {
    let _alone = alone();
    let runs = [
        ("", 1_000),
        ("stays-beside", 1_003),
        ("stays-slippery", 1_004),
        ("stays-jammed", 1_005),
        ("stays-askew", 1_006),
        ("controller-killed", 1_007),
    ];
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while let Some((faults, seed)) = runs.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let seed = seed.to_string();
                    let mut options = vec!["--seed", &seed];
                    if !faults.is_empty() {
                        options.extend(["--fault", faults]);
                    }
                    // Those that concern the parts need no boxes from the base.
                    if ["stays-jammed", "stays-askew"].contains(faults) {
                        options.push("--unloaded");
                    }
                    assembly(&options);
                }
            });
        }
    });
}

#[test]
fn demo_assembly_peg_missing_ends_contained() {
    let _alone = alone();
    let missing = assembly(&["--fault", "no-peg", "--unloaded"]);
    let error = missing["error"].as_str().unwrap();
    assert!(error.contains("box 1 has no peg"), "{missing}");
    assert!(error.contains("hint:"), "{missing}");
    assert_eq!(missing["held"], serde_json::json!(["socket"]), "{missing}");
    assert_eq!(missing["dropped"], 0);
    // The first state is too short to be seen.
    let states = missing["states"].as_array().unwrap().iter();
    let states = states.map(|state| state[0].as_str().unwrap());
    let states: Vec<_> = states.filter(|state| *state != "Start").collect();
    assert_eq!(states, ["Home", "Work", "Fault", "Recover", "Stop"]);
}

/// The program is a process of its own here.
#[test]
fn demo_assembly_program_killed_ends_contained() {
    let _alone = alone();
    expect_box_in_both_hands(&assembly(&["--fault", "program-killed"]));
}

fn expect_box_in_both_hands(report: &Value) {
    let error = report["error"].as_str().unwrap();
    assert!(error.contains("signal: 9"), "{report}");
    assert_eq!(report["held"], serde_json::json!(["box_1"]), "{report}");
    assert_eq!(report["dropped"], 0);
    assert_eq!(report["controller"]["rt_allocations"], 0);
    let internal = report["internal_force_n_max"].as_f64().unwrap();
    assert!(internal > 0.0 && internal <= 15.0, "{report}");
}

#[test]
fn demo_real_time_factor_out_of_range_or_in_real_time_is_refused() {
    for (options, why) in [
        (["assembly", "simulated", "0.01"], "0.1 to 10 times"),
        (["assembly", "simulated", "NaN"], "0.1 to 10 times"),
        (["pair", "real", "2"], "hint: add --time simulated"),
    ] {
        let [cell, time, factor] = options;
        let clock = ["--time", time, "--real-time-factor", factor];
        let output = run(&[&["demo", "--cell", cell][..], &clock].concat());
        expect_status(&output, 2);
        let error = complaint(&output);
        assert!(error.contains(why), "{error}");
    }
}

#[test]
fn demo_faults_of_assembly_are_refused_elsewhere() {
    let output = run(&["demo", "--cell", "pair", "--fault", "jams"]);
    expect_status(&output, 2);
    let error = complaint(&output);
    assert!(error.contains("hint: add --cell assembly"), "{error}");
    let output = run(&["demo", "--cell", "assembly", "--fault", "rain"]);
    expect_status(&output, 2);
    let error = complaint(&output);
    assert!(error.contains("the faults are docks-beside"), "{error}");
}

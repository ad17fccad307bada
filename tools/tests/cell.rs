//! A controller, an emulated arm and clients, each in a process of its own, as in a real cell. What
//! a robot does in detail is shown elsewhere.

mod common;

use common::{Cell, Folder, alone, complaint, expect_status, net, run, run_with_input};
use takt_tests::steady;

/// `tests/nets/swing`, so slow that it does not end while a test looks at it.
fn slow_swing() -> String {
    net("swing")
        .replace("Max='1'", "Max='60'")
        .replace("Second='1'", "Second='60'")
}

/// The values of a key among the lines of a watch.
fn values(lines: &[String], key: &str) -> Vec<f64> {
    let of_key = |line: &String| line.strip_prefix(key)?.trim().parse().ok();
    lines.iter().filter_map(of_key).collect()
}

#[test]
fn net_loaded_by_hand_moves_an_arm_in_a_third_process() {
    steady(|| {
        let _alone = alone();
        let mut cell = Cell::start();
        let _arm = cell.arm();
        let id = cell.load(&net("swing"));
        let mut watch = cell.watch(&id);
        watch.wait_for("READY");
        expect_status(&cell.net(&["start", &id]), 0);
        watch.wait_for("RUNNING");
        let (lines, status) = watch.end();
        assert_eq!(status, Some(0), "{lines:#?}");
        assert_eq!(lines.last().map(String::as_str), Some("TERMINATED"));
        let measured = values(&lines, "measured");
        let (first, last) = (measured[0], measured[measured.len() - 1]);
        assert!((last - first - 0.5).abs() < 0.05, "{measured:?}");
        assert!(lines.contains(&"done true".to_owned()), "{lines:#?}");
    });
}

#[test]
fn killed_robot_ends_its_net_and_the_controller_goes_on() {
    steady(|| {
        let _alone = alone();
        let mut cell = Cell::start();
        let mut arm = cell.arm();
        let bystander = cell.load("{cancel=Cancel(), outTerminate=cancel.outCancel}");
        expect_status(&cell.net(&["start", &bystander]), 0);
        let id = cell.load(&slow_swing());
        let mut watch = cell.watch(&id);
        expect_status(&cell.net(&["start", &id]), 0);
        watch.wait_for("RUNNING");
        watch.wait_for("measured");
        arm.kill();
        let (lines, status) = watch.end();
        assert_eq!(status, Some(1), "{lines:#?}");
        let why = lines
            .iter()
            .find(|line| line.contains("did not end by itself"))
            .unwrap();
        assert!(why.contains("left"), "{why}");

        let list = expect_status(&cell.net(&["list"]), 0);
        let line = |id: &str| {
            list.lines()
                .find(|line| line.starts_with(id))
                .unwrap()
                .to_owned()
        };
        assert!(line(&bystander).contains("RUNNING"), "{list}");
        assert!(
            line(&id).contains("TERMINATED") && line(&id).contains("left"),
            "{list}"
        );
        let next = cell.load(&net("swing"));
        let refused = cell.net(&["start", &next]);
        expect_status(&refused, 1);
        assert!(
            complaint(&refused).contains("left"),
            "{}",
            complaint(&refused)
        );

        let _another = cell.arm();
        expect_status(&cell.net(&["start", &next]), 0);
        let (lines, status) = cell.watch(&next).end();
        assert_eq!(status, Some(0), "{lines:#?}");
    });
}

#[test]
fn net_is_cancelled_and_aborted_by_hand() {
    let _alone = alone();
    let cell = Cell::start();
    let id = cell.load("{cancel=Cancel(), outTerminate=cancel.outCancel}");
    expect_status(&cell.net(&["start", &id]), 0);
    expect_status(&cell.net(&["cancel", &id]), 0);
    let (lines, status) = cell.watch(&id).end();
    assert_eq!(status, Some(0), "{lines:#?}");
    expect_status(&cell.net(&["unload", &id]), 0);
    assert_eq!(expect_status(&cell.net(&["list"]), 0), "no nets\n");

    let id = cell.load("{stays=Core::BooleanValue(Value='false'), outTerminate=stays.outValue}");
    expect_status(&cell.net(&["start", &id]), 0);
    expect_status(&cell.net(&["abort", &id]), 0);
    let (lines, status) = cell.watch(&id).end();
    assert_eq!(status, Some(1), "{lines:#?}");
    assert!(
        lines.iter().any(|line| line.contains("abort")),
        "{lines:#?}"
    );
}

#[test]
fn net_is_scheduled_after_another() {
    let _alone = alone();
    let cell = Cell::start();
    let first = cell.load(
        "{clock=Core::Clock(), late=Core::DoubleGreater(inFirst=clock.outValue, Second='0.05'),
          outTerminate=late.outValue}",
    );
    let second = cell.load("{cancel=Cancel(), outTerminate=cancel.outCancel}");
    let rule = expect_status(&cell.net(&["schedule", &second, "--after", &first]), 0);
    assert!(rule.starts_with("rule "), "{rule}");
    let mut watch = cell.watch(&second);
    watch.wait_for("SCHEDULED");
    expect_status(&cell.net(&["start", &first]), 0);
    watch.wait_for("RUNNING");

    let third = cell.load("{cancel=Cancel(), outTerminate=cancel.outCancel}");
    let when = ["schedule", &third, "--after", &second, "--when", "t"];
    expect_status(&cell.net(&when), 0);
    cell.watch(&third).wait_for("RUNNING");
    let (lines, status) = watch.end();
    assert_eq!(status, Some(0), "taken over by the rule: {lines:#?}");

    let nonsense = cell.net(&["schedule", &third, "--after", &second, "--when", "a b c"]);
    expect_status(&nonsense, 1);
}

#[test]
fn nets_outlive_their_watching_clients() {
    let _alone = alone();
    let cell = Cell::start();
    let id = cell.load("{cancel=Cancel(), outTerminate=cancel.outCancel}");
    expect_status(&cell.net(&["start", &id]), 0);
    let mut watch = cell.watch(&id);
    watch.wait_for("RUNNING");
    watch.kill();
    let list = expect_status(&cell.net(&["list", "--json"]), 0);
    let nets: serde_json::Value = serde_json::from_str(&list).unwrap();
    assert_eq!(nets[0]["net"], *id);
    assert_eq!(nets[0]["state"], "RUNNING");
}

#[test]
fn watch_reports_lost_controller() {
    let _alone = alone();
    let mut cell = Cell::start();
    let id = cell.load("{cancel=Cancel(), outTerminate=cancel.outCancel}");
    let mut watch = cell.watch(&id);
    watch.wait_for("READY");
    cell.process.kill();
    let (lines, status) = watch.end();
    assert_eq!(status, Some(2), "{lines:#?}");
    assert!(
        lines
            .iter()
            .any(|line| line.contains("closed the connection")),
        "{lines:#?}"
    );
}

#[test]
fn run_sigterm_ends_all_nets() {
    let _alone = alone();
    let cell = Cell::start();
    let id = cell.load("{cancel=Cancel(), outTerminate=cancel.outCancel}");
    expect_status(&cell.net(&["start", &id]), 0);
    let mut watch = cell.watch(&id);
    watch.wait_for("RUNNING");
    cell.process.terminate();
    let (lines, status) = watch.end();
    assert_eq!(status, Some(0), "{lines:#?}");
    let (lines, status) = cell.process.end();
    assert_eq!(status, Some(0), "{lines:#?}");
}

#[test]
fn load_invalid_net_is_refused_with_faults() {
    let _alone = alone();
    let cell = Cell::start();
    let load = |text: &str| run_with_input(&["net", "load", "-", "--connect", &cell.tcp], text);
    let cases = [
        ("{clock=Core::Clock(,}", "-:1:20"),
        (
            "{clock=Core::Clok(),\n outTerminate=clock.outValue}",
            "did you mean `Core::Clock`",
        ),
        (
            &net("swing").replace("'left'", "'middle'"),
            "there is no robot arm `middle`",
        ),
        ("", "fault"),
    ];
    for (text, fault) in cases {
        let output = load(text);
        expect_status(&output, 1);
        assert!(
            complaint(&output).contains(fault),
            "{text}: {}",
            complaint(&output)
        );
    }
    assert_eq!(
        expect_status(&cell.net(&["list"]), 0),
        "no nets\n",
        "what was refused is gone"
    );
    for command in ["start", "cancel", "abort", "unload", "watch"] {
        let output = cell.net(&[command, "rpinet77"]);
        expect_status(&output, 1);
        assert!(
            complaint(&output).contains("there is no net rpinet77"),
            "{}",
            complaint(&output)
        );
    }
}

#[test]
fn missing_environment_is_named() {
    let unused = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let unused = unused.to_string();
    let cases: [(&[&str], &str); 4] = [
        (
            &["net", "list", "--connect", &unused],
            "hint: start the controller with `takt run`",
        ),
        (&["net", "check", "/nowhere.net"], "/nowhere.net"),
        (&["demo", "--from", "/nowhere.mcap"], "/nowhere.mcap"),
        (&["demo", "--duration", "5"], "unit"),
    ];
    for (args, what) in cases {
        let output = run(args);
        expect_status(&output, 2);
        assert!(
            complaint(&output).contains(what),
            "{args:?}: {}",
            complaint(&output)
        );
    }
}

/// What a service manager starts again, and what not.
#[test]
fn run_wrong_cell_exits_78_missing_address_2() {
    let folder = Folder::new();
    // An address of the documentation, which no host has.
    let missing = "[[device]]\nname = 'left'\ntype = 'kuka_lwr_fri'\nlisten = '192.0.2.1:49938'\n";
    let bus = "[[canopen]]\nname = 'bus'\ninterface = 'nocan7'\n";
    for (text, status, what) in [
        ("nonsense", 78, "nonsense"),
        ("[[device]]\nname = 'a'\ntype = 'teapot'\n", 78, "teapot"),
        ("[controller]\nfollow = 'missing'\n", 78, "missing"),
        (missing, 2, "left"),
        (bus, 2, "nocan7"),
    ] {
        let path = folder.file("cell.toml");
        std::fs::write(&path, text).unwrap();
        let output = run(&["run", "--config", &path]);
        assert_eq!(output.status.code(), Some(status), "{}", complaint(&output));
        assert!(complaint(&output).contains(what), "{}", complaint(&output));
    }
    expect_status(&run(&["run", "--config", "/nowhere.toml"]), 78);
}

#[test]
fn watch_names_rejected_set_points_and_fails() {
    let _alone = alone();
    let mut cell = Cell::start();
    let _arm = cell.arm();
    let far = "{v=Core::DoubleValue(Value='30'),c=Cancel(),outTerminate=c.outCancel,
        j=RobotArm::JointPosition(inPosition=v.outValue,Robot='left',Axis='4')}";
    let id = cell.load(far);
    let mut watch = cell.watch(&id);
    expect_status(&cell.net(&["start", &id]), 0);
    watch.wait_for("left joint 4 rejects set-points of rpinet0");
    watch.wait_for("30.00 degrees are 0.5236 rad");
    // It ends as `rejected_ends_after` says.
    watch.wait_for("rejected for 5s: left joint 4");
    watch.wait_for("all at /nets/rpinet0/last");
    watch.wait_for("j4 measured");
    let (lines, status) = watch.end();
    assert_eq!(status, Some(1), "{lines:#?}");
    cell.process.wait_for("left joint 4 rejects set-points");
}

#[test]
fn taken_socket_names_its_owner() {
    let folder = Folder::new();
    let (taken, free, path) = ("taken.sock", "free.sock", folder.file("cell.toml"));
    let [taken, free] = [taken, free].map(|name| folder.file(name));
    let _listener = std::os::unix::net::UnixListener::bind(&taken).unwrap();
    let ports = "websocket = '127.0.0.1:0'\ntcp = '127.0.0.1:0'\nstop = '127.0.0.1:0'\n";
    for [socket, stop] in [[&taken, &free], [&free, &taken]] {
        let text = format!("[controller]\n{ports}socket = '{socket}'\nstop_socket = '{stop}'\n");
        std::fs::write(&path, text).unwrap();
        let output = run(&["run", "--config", &path]);
        expect_status(&output, 2);
        let owner = format!("(process {})", std::process::id());
        let why = complaint(&output);
        assert!(why.contains("taken by `") && why.contains(&owner), "{why}");
        assert!(why.contains(&taken), "{why}");
    }
}

#[test]
fn taken_port_of_server_names_its_owner() {
    let folder = Folder::new();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = taken.local_addr().map(|address| (taken, address)).unwrap();
    let (stop, path) = (folder.file("stop.sock"), folder.file("cell.toml"));
    for key in ["websocket", "tcp", "stop"] {
        let free = ["websocket", "tcp", "stop"]
            .into_iter()
            .filter(|it| *it != key);
        let free: String = free.map(|it| format!("{it} = '127.0.0.1:0'\n")).collect();
        let text = format!(
            "[controller]\n{free}{key} = '{}'\nsocket = ''\nstop_socket = '{stop}'\n",
            taken.1
        );
        std::fs::write(&path, text).unwrap();
        let output = run(&["run", "--config", &path]);
        expect_status(&output, 2);
        let owner = format!("(process {})", std::process::id());
        let port = format!("TCP port {} is taken by `", taken.1.port());
        let why = complaint(&output);
        assert!(why.contains(&port) && why.contains(&owner), "{key}: {why}");
    }
}

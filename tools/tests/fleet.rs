//! Two `takt run` in one fleet over loopback, and `takt fleet` beside them: what it lists, reads, commands and watches, what a link
//! without right gets, and how a killed cell and a lost router are noticed.

#![cfg(feature = "fleet")]
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;
#[path = "common/network.rs"]
mod network;

use std::io::{Read as _, Write as _};
use std::net::TcpListener;
use std::process::Output;

use common::{Folder, Process, alone, complaint, expect_status, run, takt};
use serde_json::Value;

/// A net that runs until it is cancelled.
const ENDLESS: &str = "{x=Cancel(),outTerminate=x.outCancel}";

/// A tool waits so long for slow answers of a busy host.
const TIMEOUT: [&str; 2] = ["--timeout", "20s"];

fn free_endpoint() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    format!("tcp/{}", listener.local_addr().unwrap())
}

/// A controller with a simulated arm, in a fleet.
struct Member {
    process: Process,
    _folder: Folder,
}

impl Member {
    fn start(fleet: &str) -> Self {
        Self::start_by(takt(&[]), fleet)
    }

    /// Starts it by a command, such as one in another network.
    fn start_by(mut command: std::process::Command, fleet: &str) -> Self {
        let folder = Folder::new();
        let stop = folder.file("stop.sock");
        let config = format!(
            "[controller]\nwebsocket = \"127.0.0.1:0\"\ntcp = \"127.0.0.1:0\"\nsocket = \"\"\nstop_socket = \"{stop}\"\n\
             flight_recorder = \"\"\n[[device]]\nname = \"left\"\ntype = \"arm_sim\"\nmodel = \"kuka_lwr4\"\n[fleet]\n{fleet}"
        );
        let config = folder.write("cell.toml", &config);
        command.args(["run", "--config", &config]);
        Self {
            process: Process::spawn(command),
            _folder: folder,
        }
    }

    fn joined_by(command: std::process::Command, fleet: &str) -> Self {
        let mut member = Self::start_by(command, fleet);
        member.process.wait_for("in the fleet as `");
        member
    }

    /// Starts it and waits until it is in the fleet.
    fn joined(fleet: &str) -> Self {
        let mut member = Self::start(fleet);
        member.process.wait_for("in the fleet as `");
        member
    }
}

/// The cell at which tools and the other cell arrive; tools may command it.
fn router(endpoint: &str) -> Member {
    Member::joined(&format!(
        "cell = \"cell-a\"\nmode = \"router\"\nlisten = [\"{endpoint}\"]\nallow = [{{ rights = [\"read\", \"command\"] }}]"
    ))
}

/// A cell that may be read only.
fn other(endpoint: &str) -> Member {
    Member::joined(&format!("cell = \"cell-b\"\nconnect = [\"{endpoint}\"]"))
}

/// Two cells that start nets together.
fn partners(endpoint: &str) -> [Member; 2] {
    let allow = "allow = [{ rights = [\"command\", \"start\"] }]";
    [
        Member::joined(&format!(
            "cell = \"cell-a\"\nmode = \"router\"\nlisten = [\"{endpoint}\"]\n{allow}"
        )),
        Member::joined(&format!(
            "cell = \"cell-b\"\nconnect = [\"{endpoint}\"]\n{allow}"
        )),
    ]
}

fn fleet(endpoint: &str, args: &[&str]) -> Output {
    run(&[&["fleet"], args, &["--connect", endpoint], &TIMEOUT].concat())
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

/// Lists until so many cells answer: links between cells are made meanwhile.
fn list(endpoint: &str, count: usize) -> Value {
    loop {
        let output = fleet(endpoint, &["list", "--json"]);
        let cells = json(&String::from_utf8(output.stdout).unwrap());
        let answering = cells.as_array().unwrap().iter();
        let answering =
            answering.filter(|cell| cell["alive"] == true && !cell["summary"].is_null());
        if answering.count() == count {
            return cells;
        }
    }
}

#[test]
fn fleet_lists_reads_commands_and_watches_two_cells() {
    let _alone = alone();
    let endpoint = free_endpoint();
    let _a = router(&endpoint);
    let mut b = other(&endpoint);
    let cells = list(&endpoint, 2);
    for (cell, name) in cells.as_array().unwrap().iter().zip(["cell-a", "cell-b"]) {
        assert_eq!(cell["cell"], name);
        assert_eq!(cell["boots"].as_array().unwrap().len(), 1);
        assert_eq!(cell["info"]["devices"][0]["name"], "left");
        assert_eq!(cell["summary"]["devices"], 1);
        assert!(cell["clock"]["state"].is_string(), "{cell}");
        assert!(cell["answer_ns"].as_u64().unwrap() > 0);
    }
    let text = expect_status(&fleet(&endpoint, &["list"]), 0);
    assert!(text.starts_with("CELL    STATE"), "{text}");
    let top = fleet(&endpoint, &["top", "--once"]);
    let text = String::from_utf8(top.stdout).unwrap();
    assert!(text.contains("\ncell-b"), "{text}");

    resources_are_read(&endpoint);
    command_is_executed_and_watched(&endpoint);
    joints_come_in_batches(&endpoint);
    // The right to command is the cell's own to give.
    let denied = run(&[
        "fleet",
        "call",
        "cell-b",
        "run",
        "nin",
        "--connect",
        &endpoint,
    ]);
    expect_status(&denied, 2);
    assert!(
        complaint(&denied).contains("no right to command"),
        "{}",
        complaint(&denied)
    );

    // A killed cell is noticed by its tokens.
    let watch = ["fleet", "watch", "cell-b", "--json", "--connect", &endpoint];
    let mut watch = Process::start(&watch);
    // In any order.
    let mut missing = vec![
        "{\"alive\":true,\"key\":\"takt/cell-b/alive\"}",
        "{\"alive\":true,\"key\":\"takt/cell-b/device/left/alive\"}",
        "{\"key\":\"takt/cell-b/log\"",
    ];
    while !missing.is_empty() {
        let line = watch.wait_for("takt/cell-b/");
        missing.retain(|part| !line.contains(part));
    }
    b.process.kill();
    watch.wait_for("{\"alive\":false,\"key\":\"takt/cell-b/alive\"}");
    assert_eq!(list(&endpoint, 1)[0]["cell"], "cell-a");
}

fn resources_are_read(endpoint: &str) {
    // A resource of a cell behind the router, one that does not exist, and the key of the stop channel, which is not shown.
    let text = expect_status(&fleet(endpoint, &["call", "cell-b", "get", "devices"]), 0);
    assert_eq!(json(&text)["device"][0]["name"], "left");
    let none = fleet(endpoint, &["call", "cell-b", "get", "nonsense"]);
    expect_status(&none, 1);
    assert!(
        complaint(&none).contains("Resources: "),
        "{}",
        complaint(&none)
    );
    let stop = expect_status(&fleet(endpoint, &["call", "cell-a", "get", "stop"]), 0);
    assert_eq!(json(&stop)["stopped"], false);
    assert!(json(&stop)["key"].is_null(), "{stop}");
}

fn command_is_executed_and_watched(endpoint: &str) {
    // Watched before the command, from another process.
    let watch = [
        "fleet",
        "watch",
        "*/net/*/state",
        "--json",
        "--connect",
        endpoint,
    ];
    let mut watch = Process::start(&watch);
    let body = format!("\"{ENDLESS}\",\"s0\",\"of the fleet\"");
    let load = ["call", "cell-a", "run", "nene", &body];
    let refused = fleet(endpoint, &load);
    expect_status(&refused, 2);
    assert!(
        complaint(&refused).contains("--yes"),
        "{}",
        complaint(&refused)
    );
    let text = expect_status(&fleet(endpoint, &[&load[..], &["--yes"]].concat()), 0);
    assert_eq!(text.trim(), "f=ok(\"rpinet0\")");
    let start = ["call", "cell-a", "run", "nest", "\"rpinet0\"", "--yes"];
    expect_status(&fleet(endpoint, &start), 0);
    let seen = watch.wait_until("a net that runs", |line| line.contains("\"RUNNING\""));
    assert_eq!(json(&seen)["key"], "takt/cell-a/net/rpinet0/state");
    let wrong = ["call", "cell-a", "run", "nest", "\"rpinet7\"", "--yes"];
    let text = expect_status(&fleet(endpoint, &wrong), 1);
    assert!(text.starts_with("f=err("), "{text}");
}

fn joints_come_in_batches(endpoint: &str) {
    // Joints of a cell behind the router, in batches: time, measured and commanded positions.
    let watch = [
        "watch",
        "cell-b/device/left/joints",
        "--count",
        "2",
        "--json",
    ];
    let text = expect_status(&fleet(endpoint, &watch), 0);
    let batch = json(text.lines().last().unwrap());
    let rows = batch["value"]["rows"].as_array().unwrap();
    assert!(rows.len() > 1, "{text}");
    let positions = rows[0][1].as_array().unwrap();
    assert!(positions.len() == 7 && positions[0].is_f64(), "{text}");
    let of = |row: usize| rows[row][0].as_f64().unwrap();
    assert!(
        (of(1) - of(0) - 0.002).abs() < 1e-6,
        "500 Hz of 1 kHz: {text}"
    );
}

#[test]
fn program_commands_cells_by_their_names() {
    let _alone = alone();
    let endpoint = free_endpoint();
    let _a = router(&endpoint);
    let allow = "allow = [{ rights = [\"command\"] }]";
    let mut b = Member::joined(&format!(
        "cell = \"cell-b\"\nconnect = [\"{endpoint}\"]\n{allow}"
    ));
    let _c = Member::joined(&format!("cell = \"cell-c\"\nconnect = [\"{endpoint}\"]"));
    list(&endpoint, 3);
    let line = takt_api::Fleet::connect([endpoint.as_str()]).unwrap();
    assert_eq!(line.cells().unwrap(), ["cell-a", "cell-b", "cell-c"]);
    let none = line.cell("cell-d").unwrap_err().to_string();
    assert!(none.contains("there is no cell `cell-d`"), "{none}");
    assert!(none.contains("cell-a, cell-b, cell-c"), "{none}");
    assert!(none.contains("tools/tests/fleet.rs"), "{none}");
    let wrong = line.cell("cell d").unwrap_err().to_string();
    assert!(wrong.contains("is no name of a cell"), "{wrong}");
    let denied = line.cell("cell-c").unwrap_err().to_string();
    assert!(denied.contains("no right to command"), "{denied}");

    // Both arms move at once; one motion takes over from the other without a rest, and a listener sees it.
    let [a, b_cell] = ["cell-a", "cell-b"].map(|name| line.cell(name).unwrap());
    drop(line);
    let [left, other] = [&a, &b_cell].map(|cell| cell.arm("left").unwrap());
    let (sender, seen) = std::sync::mpsc::channel();
    let listener = b_cell.on_change(&other.joint(0), move |angle| {
        // No one waits any more once the goal was seen.
        let _ = sender.send(angle);
    });
    let goal = |angle: f64| vec![angle, 0.5, 0.0, -1.0, 0.0, 0.5, 0.0];
    let first = other.ptp(goal(0.2)).speed(0.3).begin().unwrap();
    let second = other.ptp(goal(0.4)).speed(0.3).queue().unwrap();
    left.ptp(goal(-0.2)).run().unwrap();
    first.wait().unwrap();
    assert_eq!(second.wait().unwrap(), takt_api::Outcome::Completed);
    let within = std::time::Duration::from_secs(20);
    while !matches!(seen.recv_timeout(within).unwrap(), Some(angle) if (angle - 0.4).abs() < 1e-3) {
    }
    drop(listener);
    let refused = a.arm("right").unwrap_err().to_string();
    assert!(refused.contains("the controller has left"), "{refused}");

    // A motion on a killed cell ends with an error, and nothing else does.
    let slow = other.ptp(goal(-1.5)).speed(0.01).begin().unwrap();
    b.process.kill();
    let lost = slow.wait().unwrap_err().to_string();
    assert!(
        lost.contains("the connection to the controller is lost"),
        "{lost}"
    );
    left.ptp(goal(0.0)).run().unwrap();
    a.close().unwrap();
}

#[test]
fn page_of_a_cell_lists_its_fleet() {
    let _alone = alone();
    let endpoint = free_endpoint();
    let _a = router(&endpoint);
    let _b = other(&endpoint);
    let cells = list(&endpoint, 2);
    // The cell is no router: it sees what the others are and how.
    let address = cells[1]["info"]["http"].as_str().unwrap();
    let mut page = std::net::TcpStream::connect(address).unwrap();
    let request = format!("GET /fleet/ HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    page.write_all(request.as_bytes()).unwrap();
    let mut text = String::new();
    page.read_to_string(&mut text).unwrap();
    let cells = json(text.split_once("\r\n\r\n").unwrap().1);
    assert_eq!(cells["own"], "cell-b");
    let seen = cells["cells"].as_array().unwrap();
    assert_eq!(seen.len(), 2, "{cells}");
    for (cell, name) in seen.iter().zip(["cell-a", "cell-b"]) {
        assert_eq!(
            (&cell["cell"], &cell["alive"]),
            (&name.into(), &true.into())
        );
        assert_eq!(cell["summary"]["devices"], 1, "{cell}");
    }
}

#[test]
fn fleet_doctor_judges_links_clocks_and_names() {
    let _alone = alone();
    let endpoint = free_endpoint();
    let _a = router(&endpoint);
    list(&endpoint, 1);
    let output = fleet(&endpoint, &["doctor"]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("reachable, linked in "), "{text}");
    assert!(text.contains("ok    cell-a: answers in "), "{text}");
    assert!(text.contains("cell-a: clock "), "{text}");
    let unused = free_endpoint();
    let failed = fleet(&unused, &["doctor", "--json"]);
    let rows = json(&expect_status(&failed, 1));
    assert_eq!(rows["rows"][0]["grade"], "FAIL");
    assert_eq!(rows["rows"][0]["subject"], unused.as_str());
    let output = fleet(&unused, &["list"]);
    expect_status(&output, 2);
    assert!(complaint(&output).contains("hint: start the controller with [fleet]"));
}

#[test]
fn fleet_second_cell_of_a_name_and_lost_router_are_logged_once() {
    let _alone = alone();
    let endpoint = free_endpoint();
    let mut a = router(&endpoint);
    let allow = "allow = [{ rights = [\"read\", \"command\"] }]";
    let mut twin = Member::start(&format!(
        "cell = \"cell-a\"\nconnect = [\"{endpoint}\"]\n{allow}"
    ));
    twin.process
        .wait_for("another controller of this fleet has the name `cell-a`");
    // The controller runs all the same, and joins when the name is free.
    a.process.kill();
    twin.process.wait_for("in the fleet as `cell-a`");
    let line = twin.process.wait_for("the fleet is not reachable at");
    assert!(line.contains(&endpoint), "{line}");
    let router = |cell: &str| {
        Member::joined(&format!(
            "cell = \"{cell}\"\nmode = \"router\"\nlisten = [\"{endpoint}\"]\n{allow}"
        ))
    };
    let first = router("cell-c");
    twin.process.wait_for("the fleet is reachable again");
    // A net of the cell runs on while its router is replaced.
    let cells = list(&endpoint, 2);
    let call = |args: &[&str]| fleet(&endpoint, &[&["call", "cell-a"], args].concat());
    let body = format!("\"{ENDLESS}\",\"s0\",\"it runs on\"");
    let text = expect_status(&call(&["run", "nene", &body, "--yes"]), 0);
    let net = text.split('"').nth(1).unwrap();
    expect_status(&call(&["run", "nest", &format!("\"{net}\""), "--yes"]), 0);
    first.process.terminate();
    twin.process.wait_for("the fleet is not reachable at");
    let (_, status) = first.process.end();
    assert_eq!(status, Some(0));
    let _second = router("cell-d");
    twin.process.wait_for("the fleet is reachable again");
    assert_eq!(list(&endpoint, 2)[0]["boots"], cells[0]["boots"]);
    let nets = expect_status(&call(&["get", "nets"]), 0);
    assert!(nets.contains("RUNNING"), "{nets}");
    twin.process.terminate();
    let (lines, status) = twin.process.end();
    assert_eq!(status, Some(0), "{lines:?}");
    let count = |part: &str| lines.iter().filter(|line| line.contains(part)).count();
    assert_eq!(count("another controller of this fleet"), 1, "{lines:?}");
    assert_eq!(count("the fleet is not reachable at"), 2, "{lines:?}");
}

/// Moves joint 0 of the arm there and back within a second, then ends by itself.
const SWING: &str = "{clock=Core::Clock(),
    there=Core::Interval(inValue=clock.outValue,Max='0.5'),away=Core::DoubleBezier(inValue=there.outValue,To='0.2'),
    back=Core::Interval(inValue=clock.outValue,Min='0.5',Max='1'),home=Core::DoubleBezier(inValue=back.outValue,To='0.2'),
    swing=Core::DoubleSubtract(inFirst=away.outValue,inSecond=home.outValue),
    joint=RobotArm::JointPosition(inPosition=swing.outValue,Robot='left',Axis='0'),
    done=Core::DoubleGreater(inFirst=clock.outValue,Second='1.1'),outTerminate=done.outValue}";

/// Holds joint 0 of the arm where it is commanded until it is cancelled.
const HOLD: &str = "{here=RobotArm::JointMonitor(Robot='left',Axis='0'),
    joint=RobotArm::JointPosition(inPosition=here.outCommandedPosition,Robot='left',Axis='0'),
    x=Cancel(),outTerminate=x.outCancel}";

/// Attempts for as long as a very busy host may need.
fn attempts() -> impl Iterator<Item = ()> {
    let until = std::time::Instant::now() + std::time::Duration::from_secs(120);
    std::iter::repeat(()).take_while(move |()| std::time::Instant::now() < until)
}

/// Why a start on a host that stalls begins nowhere.
const STALLED: [&str; 8] = [
    "no answer from",
    "stalled",
    " ns late",
    "no keep-alive arrived in time",
    "armed in time",
    "did not answer in time",
    "too late",
    "is lost",
];

/// Starts both nets until the host lets them: each refusal must be one of a host that stalls.
fn start_together(endpoint: &str, file: &str) -> Value {
    let (a, b) = (format!("cell-a={file}"), format!("cell-b={file}"));
    let args = ["start", &a, &b, "--lead", "1s", "--on-loss", "continue"];
    let report = attempts().find_map(|()| {
        let output = fleet(endpoint, &[&args[..], &["--yes", "--json"]].concat());
        if output.status.success() {
            return Some(json(&String::from_utf8(output.stdout).unwrap()));
        }
        let why = complaint(&output);
        assert!(STALLED.iter().any(|part| why.contains(part)), "{why}");
        None
    });
    report.expect("the host stalled at each start")
}

/// A cell says so where keep-alives came too late, over a slow network or on a host that stalls.
const SESSION_LOST: &str = "the session that prepared it has ended";

/// A `takt fleet start` whose nets run. Those that a stall prevented are killed, whereupon their cells end what had begun.
fn begun(args: &[&str]) -> Process {
    let begun = attempts().find_map(|()| {
        let mut started = Process::start(args);
        let line = started.wait_until("how it went", |line| {
            line.contains("begun on 2 cells")
                || line.starts_with("takt: ")
                || line.contains("nothing begins")
                || line.contains(SESSION_LOST)
                || STALLED.iter().any(|part| line.contains(part))
        });
        line.contains("begun on 2 cells").then_some(started)
    });
    begun.expect("the host stalled at each start")
}

#[test]
fn fleet_start_begins_on_two_controllers_in_one_cycle() {
    let _alone = alone();
    let endpoint = free_endpoint();
    let mut partners = partners(&endpoint);
    list(&endpoint, 2);
    let folder = Folder::new();
    let (swing, hold) = (
        folder.write("swing.net", SWING),
        folder.write("hold.net", HOLD),
    );

    let report = start_together(&endpoint, &swing);
    let instant = report["start_tai_ns"].as_i64().unwrap();
    let cells = report["cells"].as_array().unwrap();
    let began: Vec<_> = cells.iter().map(|cell| &cell["status"]["began"]).collect();
    for began in &began {
        let (begin, period) = (began["begin_tai_ns"].as_i64(), began["period_ns"].as_i64());
        assert_eq!(period, Some(1_000_000));
        assert!((begin.unwrap() - instant).abs() <= 500_000, "{report}");
    }
    assert_eq!(began.len(), 2);
    let spread = report["spread_ns"].as_i64().unwrap();
    assert!(spread <= 1_000_000, "{report}");
    println!("spread of two controllers: {spread} ns; {report}");

    // The arm of one is held by another net: nothing begins, and the other one's is free again.
    let command = |command: &str, body: &str| {
        let call = ["call", "cell-b", "run", command, body, "--yes"];
        expect_status(&fleet(&endpoint, &call), 0)
    };
    let quoted = HOLD.replace('\n', " ");
    let text = command("nene", &format!("\"{quoted}\",\"s0\",\"it holds the arm\""));
    let held = text.split('"').nth(1).unwrap().to_owned();
    command("nest", &format!("\"{held}\""));
    let (a, b) = (format!("cell-a={hold}"), format!("cell-b={hold}"));
    let why = attempts().find_map(|()| {
        let output = fleet(&endpoint, &["start", &a, &b, "--yes"]);
        let why = complaint(&output);
        if STALLED.iter().any(|part| why.contains(part)) {
            return None;
        }
        expect_status(&output, 1);
        Some(why)
    });
    let why = why.expect("the host stalled at each start");
    assert!(
        why.contains("nothing begins: cell-b: ") && why.contains(&held),
        "{why}"
    );
    command("neab", &format!("\"{held}\""));
    start_together(&endpoint, &swing);

    // A partner that is lost while both run ends the net of the other, by the policy of the session.
    let start = [
        "fleet",
        "start",
        &a,
        &b,
        "--yes",
        "--lead",
        "1s",
        "--connect",
        &endpoint,
    ];
    let started = begun(&[&start[..], &TIMEOUT].concat());
    partners[1].process.kill();
    // Of the starts before, whose policy was another, a stall may have left such lines.
    partners[0].process.wait_until("the loss", |line| {
        let is_lost = line.contains("cell cell-b of coordinated start");
        is_lost && line.contains("the nets are cancelled")
    });
    let (lines, status) = started.end();
    assert_eq!(status, Some(2), "{lines:?}");
    // A cell that is not there.
    let output = fleet(&endpoint, &["start", &a, "cell-x=rpinet0", "--yes"]);
    expect_status(&output, 2);
    assert!(complaint(&output).contains("no answer from cell-x"));
}

/// Runs openssl in a folder; false if there is none.
fn openssl(folder: &Folder, args: &str) -> bool {
    let mut command = std::process::Command::new("openssl");
    let command = command.args(args.split(' ')).current_dir(folder.file(""));
    match command.output() {
        Ok(output) => {
            assert!(output.status.success(), "{args}: {output:?}");
            true
        }
        Err(_) => false,
    }
}

/// An authority, and a certificate of it for each name, as docs/fleet.md makes them; false if there is no openssl.
fn certificates(folder: &Folder, authority: &str, names: &[&str]) -> bool {
    certificates_of(folder, "DNS:localhost", authority, names)
}

/// The same, for a host of that name or address.
fn certificates_of(folder: &Folder, host: &str, authority: &str, names: &[&str]) -> bool {
    let key = "-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes";
    let extensions = format!("subjectAltName={host}\nextendedKeyUsage=serverAuth,clientAuth\n");
    folder.write("ext", &extensions);
    let is_there = openssl(
        folder,
        &format!(
            "req -x509 {key} -days 2 -subj /CN={authority} -keyout {authority}.key -out {authority}.pem"
        ),
    );
    is_there
        && names.iter().all(|name| {
            openssl(
                folder,
                &format!("req {key} -subj /CN={name} -keyout {name}.key -out {name}.csr"),
            ) && openssl(
                folder,
                &format!(
                    "x509 -req -in {name}.csr -CA {authority}.pem -CAkey {authority}.key -CAcreateserial -days 2 -extfile ext -out {name}.pem"
                ),
            )
        })
}

#[test]
fn fleet_certificates_give_rights_by_name_and_nothing_without() {
    let _alone = alone();
    let folder = Folder::new();
    if !certificates(&folder, "line", &["weld3", "panel", "stranger"])
        || !certificates(&folder, "foreign", &["intruder"])
    {
        println!("skipped: needs openssl");
        return;
    }
    let endpoint = free_endpoint().replace("tcp/127.0.0.1", "tls/localhost");
    let file = |name: &str| folder.file(name);
    let (ca, certificate, key) = (file("line.pem"), file("weld3.pem"), file("weld3.key"));
    let _cell = Member::joined(&format!(
        "cell = \"weld3\"\nmode = \"router\"\nlisten = [\"{endpoint}\"]\nca = \"{ca}\"\ncertificate = \"{certificate}\"\n\
         key = \"{key}\"\nallow = [{{ certificates = [\"panel\"], rights = [\"command\"] }}]"
    ));
    let by = |authority: &str, name: &str, args: &[&str]| {
        let (ca, certificate) = (
            file(&format!("{authority}.pem")),
            file(&format!("{name}.pem")),
        );
        let key = file(&format!("{name}.key"));
        let files = ["--ca", &ca, "--certificate", &certificate, "--key", &key];
        fleet(&endpoint, &[args, &files].concat())
    };
    let listed = json(&expect_status(&by("line", "panel", &["list", "--json"]), 0));
    assert_eq!(listed[0]["cell"], "weld3");
    let text = expect_status(&by("line", "panel", &["call", "weld3", "run", "nin"]), 0);
    assert_eq!(text.trim(), "f=ok({})");
    // A certificate of the same authority that no rule names sees nothing.
    let text = expect_status(&by("line", "stranger", &["list"]), 1);
    assert!(text.starts_with("no cell is alive"), "{text}");
    let denied = by("line", "stranger", &["call", "weld3", "get", "nets"]);
    expect_status(&denied, 2);
    // One of another authority has no link.
    let intruder = by("foreign", "intruder", &["list"]);
    expect_status(&intruder, 2);
    assert!(
        complaint(&intruder).contains("no cell or router answers"),
        "{}",
        complaint(&intruder)
    );
    let without = fleet(&endpoint, &["list"]);
    expect_status(&without, 2);
    assert!(
        complaint(&without).contains("needs certificates"),
        "{}",
        complaint(&without)
    );
}

/// Another network namespace, at the other end of a cable; it ends with the process that holds it.
struct Far(std::process::Child);

impl Drop for Far {
    fn drop(&mut self) {
        // It only sleeps: if it is gone already, so is the namespace.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Far {
    /// Moves `near` of the cable into this thread's namespace and `far` into another one.
    fn new() -> Self {
        let mut sleep = std::process::Command::new("unshare");
        let child = sleep.args(["--net", "sleep", "600"]).spawn().unwrap();
        let far = Self(child);
        let own = std::fs::read_link("/proc/thread-self/ns/net").unwrap();
        while std::fs::read_link(far.path()).map_or(true, |other| other == own) {
            std::thread::yield_now();
        }
        assert!(network::ip(&format!("link set far netns {}", far.0.id())));
        for line in [
            "link set lo up",
            "addr add 192.0.2.2/24 dev far",
            "link set far up",
        ] {
            far.ip(line);
        }
        far
    }

    /// Runs `ip` there with these arguments.
    fn ip(&self, arguments: &str) {
        let mut ip = self.command("ip");
        let status = ip.args(arguments.split(' ')).status().unwrap();
        assert!(status.success(), "{arguments}");
    }

    fn path(&self) -> String {
        format!("/proc/{}/ns/net", self.0.id())
    }

    fn command(&self, program: &str) -> std::process::Command {
        let mut command = std::process::Command::new("nsenter");
        command.arg(format!("--net={}", self.path())).arg(program);
        command
    }

    /// A command whose `CLOCK_MONOTONIC` is a day ahead of that here, as on another host, if the kernel has namespaces of time.
    fn command_a_day_ahead(&self, program: &str) -> std::process::Command {
        if !std::path::Path::new("/proc/self/ns/time").exists() {
            return self.command(program);
        }
        let mut command = self.command("unshare");
        command.args(["--time", "--monotonic", "86400", "--kill-child", program]);
        command
    }
}

/// A relay on this side of the cable: what comes from one end arrives at the other later, as over a long way. Its threads end with the
/// process.
fn delay(listen: &str, to: &'static str, by: std::time::Duration) {
    let listener = TcpListener::bind(listen).unwrap();
    // A thread inherits the namespace of the one that starts it.
    std::thread::spawn(move || {
        for near in listener.incoming().map_while(Result::ok) {
            let Ok(far) = std::net::TcpStream::connect(to) else {
                continue;
            };
            // An end that has gone already has no use for it.
            let _ = near.set_nodelay(true).and_then(|()| far.set_nodelay(true));
            for (from, to) in [(&near, &far), (&far, &near)] {
                let (from, to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                pass_on(from, to, by);
            }
        }
    });
}

/// Passes on what is read, each piece after its delay; the end of one side ends the other.
fn pass_on(mut from: std::net::TcpStream, mut to: std::net::TcpStream, by: std::time::Duration) {
    let (sender, pieces) = std::sync::mpsc::channel::<(std::time::Instant, Vec<u8>)>();
    std::thread::spawn(move || {
        for (due, piece) in pieces {
            std::thread::sleep(due.saturating_duration_since(std::time::Instant::now()));
            if to.write_all(&piece).is_err() {
                break;
            }
        }
        // Both are closed already if this fails.
        let _ = to.shutdown(std::net::Shutdown::Both);
    });
    std::thread::spawn(move || {
        let mut piece = [0; 65536];
        while let Ok(count @ 1..) = from.read(&mut piece) {
            if sender
                .send((std::time::Instant::now() + by, piece[..count].to_vec()))
                .is_err()
            {
                break;
            }
        }
    });
}

const CABLE: [&str; 4] = [
    "link set lo up",
    "link add near type veth peer name far",
    "addr add 192.0.2.1/24 dev near",
    "link set near up",
];

/// Lets the cable lose everything for 40 ms in 200 until it is dropped.
struct Loss(
    std::sync::Arc<std::sync::atomic::AtomicBool>,
    Option<std::thread::JoinHandle<()>>,
);

impl Loss {
    fn begin() -> Self {
        use std::sync::atomic::{AtomicBool, Ordering};
        use std::time::Duration;
        let ends = std::sync::Arc::new(AtomicBool::new(false));
        let ended = std::sync::Arc::clone(&ends);
        // A thread inherits the namespace of the one that starts it.
        let thread = std::thread::spawn(move || {
            while !ended.load(Ordering::Relaxed) {
                assert!(network::ip("rule add pref 0 iif near blackhole"));
                std::thread::sleep(Duration::from_millis(40));
                assert!(network::ip("rule del pref 0 iif near blackhole"));
                std::thread::sleep(Duration::from_millis(160));
            }
        });
        Self(ends, Some(thread))
    }
}

impl Drop for Loss {
    fn drop(&mut self) {
        self.0.store(true, std::sync::atomic::Ordering::Relaxed);
        if let Some(thread) = self.1.take() {
            // Its panic shows as that of another thread.
            let _ = thread.join();
        }
    }
}

#[test]
#[expect(clippy::too_many_lines, reason = "one network for all of it")]
fn fleet_start_over_slow_lossy_and_split_network() {
    let test = "fleet_start_over_slow_lossy_and_split_network";
    let folder = Folder::new();
    let names = ["weld3", "glue1", "panel"];
    if !certificates_of(&folder, "IP:192.0.2.1", "line", &names) {
        takt_tests::skip(test, "needs openssl");
        return;
    }
    let Some(()) = network::network(test, "needs veth", &CABLE) else {
        return;
    };
    let _alone = alone();
    let far = Far::new();
    let endpoint = "tls/192.0.2.1:7447";
    let file = |name: &str| folder.file(name);
    let tls = |name: &str| {
        let (ca, certificate, key) = (
            file("line.pem"),
            file(&format!("{name}.pem")),
            file(&format!("{name}.key")),
        );
        format!("ca = \"{ca}\"\ncertificate = \"{certificate}\"\nkey = \"{key}\"\n")
    };
    let allow = |names: &str| {
        format!("allow = [{{ certificates = [{names}], rights = [\"command\", \"start\"] }}]")
    };
    let mut weld = Member::joined(&format!(
        "cell = \"weld3\"\nmode = \"router\"\nlisten = [\"{endpoint}\"]\n{}{}",
        tls("weld3"),
        allow("\"panel\", \"glue1\"")
    ));
    delay(
        "192.0.2.1:7448",
        "192.0.2.1:7447",
        std::time::Duration::from_millis(25),
    );
    let mut glue = Member::joined_by(
        far.command_a_day_ahead(env!("CARGO_BIN_EXE_takt")),
        &format!(
            "cell = \"glue1\"\nconnect = [\"tls/192.0.2.1:7448\"]\n{}{}",
            tls("glue1"),
            allow("\"weld3\"")
        ),
    );
    let (ca, certificate, key) = (file("line.pem"), file("panel.pem"), file("panel.key"));
    let files = ["--ca", &ca, "--certificate", &certificate, "--key", &key];
    let by_panel = |args: &[&str]| fleet(endpoint, &[args, &files].concat());
    while !String::from_utf8_lossy(&by_panel(&["list"]).stdout).contains("glue1") {}

    let (swing, hold) = (
        folder.write("swing.net", SWING),
        folder.write("hold.net", HOLD),
    );
    let (a, b) = (format!("weld3={swing}"), format!("glue1={swing}"));
    let args = [
        "start",
        &a,
        &b,
        "--lead",
        "2s",
        "--on-loss",
        "continue",
        "--yes",
        "--json",
    ];
    let start = || {
        let output = by_panel(&args);
        if output.status.success() {
            let report = json(&String::from_utf8(output.stdout).unwrap());
            let spread_ns = report["spread_ns"].as_i64().unwrap();
            assert!(spread_ns <= 1_000_000, "{report}");
            return Some(());
        }
        let why = complaint(&output);
        let is_session_lost = why.contains(SESSION_LOST);
        let is_stalled = STALLED.iter().any(|part| why.contains(part));
        assert!(is_stalled || is_session_lost, "{why}");
        None
    };
    let begun_late = attempts().find_map(|()| start());
    begun_late.expect("the host stalled at each start");
    // While packets are lost, a start is together or not at all: on a busy host, all may be refused.
    let loss = Loss::begin();
    let _begun = (0..5).find_map(|_| start());
    drop(loss);
    // Connections recover from the loss, and starts begin again.
    let recovered = attempts().find_map(|()| start());
    recovered.expect("no start after the loss");

    // Split in motion: both sides end their nets by the policy, and nothing begins again when the network is back.
    let (a, b) = (format!("weld3={hold}"), format!("glue1={hold}"));
    let args = [
        "fleet",
        "start",
        &a,
        &b,
        "--lead",
        "1s",
        "--yes",
        "--connect",
        endpoint,
    ];
    let _started = begun(&[&args[..], &files, &TIMEOUT].concat());
    far.ip("link set far down");
    for (member, partner) in [(&mut weld, "glue1"), (&mut glue, "weld3")] {
        let lost = format!("cell {partner} of coordinated start");
        member.process.wait_until("the loss", |line| {
            line.contains(&lost) && line.contains("the nets are cancelled")
        });
    }
    glue.process.wait_for("the fleet is not reachable at");
    far.ip("link set far up");
    glue.process.wait_for("the fleet is reachable again");
    for cell in ["weld3", "glue1"] {
        let nets = loop {
            let output = by_panel(&["call", cell, "get", "nets"]);
            if output.status.success() {
                break String::from_utf8(output.stdout).unwrap();
            }
        };
        assert!(!nets.contains("RUNNING"), "{cell}: {nets}");
    }
}

#[test]
fn fleet_table_wrong_ends_run_with_line_and_remedy() {
    let folder = Folder::new();
    let config = folder.write(
        "cell.toml",
        "[fleet]\ncell = \"a\"\nlisten = [\"tcp/0.0.0.0:7447\"]\n",
    );
    let output = takt(&["run", "--config", &config]).output().unwrap();
    expect_status(&output, 78);
    let why = complaint(&output);
    assert!(
        why.contains("line 3") && why.contains("beyond loopback and not protected"),
        "{why}"
    );
}

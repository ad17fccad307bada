//! Two `takt run` in one fleet over loopback, and `takt fleet` beside them: what it lists, reads, commands and watches, what a link
//! without right gets, and how a killed cell and a lost router are noticed.

#![cfg(feature = "fleet")]
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;

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
        let folder = Folder::new();
        let stop = folder.file("stop.sock");
        let config = format!(
            "[controller]\nwebsocket = \"127.0.0.1:0\"\ntcp = \"127.0.0.1:0\"\nsocket = \"\"\nstop_socket = \"{stop}\"\n\
             flight_recorder = \"\"\n[[device]]\nname = \"left\"\ntype = \"arm_sim\"\nmodel = \"kuka_lwr4\"\n[fleet]\n{fleet}"
        );
        let config = folder.write("cell.toml", &config);
        Self {
            process: Process::start(&["run", "--config", &config]),
            _folder: folder,
        }
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
    let mut twin = Member::start(&format!("cell = \"cell-a\"\nconnect = [\"{endpoint}\"]"));
    twin.process
        .wait_for("another controller of this fleet has the name `cell-a`");
    // The controller runs all the same, and joins when the name is free.
    a.process.kill();
    twin.process.wait_for("in the fleet as `cell-a`");
    let line = twin.process.wait_for("the fleet is not reachable at");
    assert!(line.contains(&endpoint), "{line}");
    let _a = Member::joined(&format!(
        "cell = \"cell-c\"\nmode = \"router\"\nlisten = [\"{endpoint}\"]"
    ));
    twin.process.wait_for("the fleet is reachable again");
    twin.process.terminate();
    let (lines, status) = twin.process.end();
    assert_eq!(status, Some(0), "{lines:?}");
    let count = |part: &str| lines.iter().filter(|line| line.contains(part)).count();
    assert_eq!(count("another controller of this fleet"), 1, "{lines:?}");
    assert_eq!(count("the fleet is not reachable at"), 1, "{lines:?}");
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
    let key = "-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes";
    let extensions = "subjectAltName=DNS:localhost\nextendedKeyUsage=serverAuth,clientAuth\n";
    folder.write("ext", extensions);
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

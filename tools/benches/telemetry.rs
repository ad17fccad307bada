//! What telemetry of a fleet costs a controller with four simulated arms that move: share of a processor of all threads of the fleet, with
//! a subscriber to the joints at 500 Hz and all else, and without one. Rounds in turns; the subscriber is a process of its own.
//! `cargo bench -p takt-tools --features fleet --bench telemetry -- --json`; on a quiet host.
#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a benchmark prints its result and ends where it cannot go on"
)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::net::TcpListener;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use common::{Folder, Process};
use serde_json::json;

/// Arms of the cell, each with seven joints.
const ARMS: [&str; 4] = ["a", "b", "c", "d"];
/// Pairs of phases, without a subscriber and with it, and the length of a phase.
const PAIRS: usize = 3;
const PHASE: Duration = Duration::from_secs(10);
/// What follows a change is not measured.
const SETTLED: Duration = Duration::from_secs(2);
/// Names of the threads of the fleet, and of zenoh's runtimes, begin so.
const THREADS: [&str; 6] = ["fleet-", "acc-", "app-", "net-", "rx-", "tx-"];

fn main() {
    let folder = Folder::new();
    let endpoint = {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        format!("tcp/{}", listener.local_addr().unwrap())
    };
    let stop = folder.file("stop.sock");
    let devices = ARMS.map(|name| {
        format!("[[device]]\nname = \"{name}\"\ntype = \"arm_sim\"\nmodel = \"kuka_lwr4\"\n")
    });
    let cell = format!(
        "[controller]\nwebsocket = \"127.0.0.1:0\"\ntcp = \"127.0.0.1:0\"\nsocket = \"\"\nstop_socket = \"{stop}\"\n\
         flight_recorder = \"\"\n{}[fleet]\ncell = \"bench\"\nmode = \"router\"\nlisten = [\"{endpoint}\"]\njoints_hz = 500\n\
         allow = [{{ rights = [\"read\", \"command\"] }}]\n",
        devices.concat()
    );
    let cell = folder.write("cell.toml", &cell);
    let mut controller = Command::new(env!("CARGO_BIN_EXE_takt"));
    controller.args(["run", "--config", &cell]);
    let mut controller = Process::spawn(controller);
    controller.wait_for("in the fleet as `");
    let call = |name: &str, body: &str| {
        let args = ["fleet", "call", "bench", "run", name, body, "--yes"];
        let output = common::run(&[&args[..], &["--connect", &endpoint]].concat());
        common::expect_status(&output, 0)
    };
    let answer = call(
        "nene",
        &format!("\"{}\",\"s0\",\"all joints swing\"", net()),
    );
    let number = answer.split('"').nth(1).unwrap().to_owned();
    call("nest", &format!("\"{number}\""));
    let (mut without, mut with) = (Vec::new(), Vec::new());
    for _ in 0..PAIRS {
        without.push(share(controller.id()));
        let mut subscriber = Command::new(env!("CARGO_BIN_EXE_takt"));
        subscriber.args(["fleet", "watch", "takt/bench/**", "--connect", &endpoint]);
        let mut subscriber = subscriber.stdout(Stdio::null()).spawn().unwrap();
        with.push(share(controller.id()));
        subscriber.kill().unwrap();
        subscriber.wait().unwrap();
    }
    let [without, with] = [without, with].map(median);
    if std::env::args().any(|arg| arg == "--json") {
        let figures = json!({ "arms": ARMS.len(), "joints_hz": 500, "share": with, "share_unsubscribed": without });
        println!("{}", json!({ "telemetry": figures }));
        return;
    }
    println!(
        "threads of the fleet: {:.2} % of a processor with a subscriber to {} arms at 500 Hz, {:.2} % without",
        100.0 * with,
        ARMS.len(),
        100.0 * without
    );
}

/// A net in which all joints of all arms swing, until it is cancelled.
fn net() -> String {
    let joints = ARMS.iter().flat_map(|arm| {
        (0..7).map(move |joint| {
            format!("{arm}{joint}=RobotArm::JointPosition(inPosition=part.outValue,Robot='{arm}',Axis='{joint}'),")
        })
    });
    format!(
        "{{clock=Core::Clock(),wave=Core::DoubleSin(inValue=clock.outValue),tenth=Core::DoubleValue(Value='0.1'),\
         part=Core::DoubleMultiply(inFirst=wave.outValue,inSecond=tenth.outValue),{}x=Cancel(),outTerminate=x.outCancel}}",
        joints.collect::<String>()
    )
}

/// Share of a processor of the threads of the fleet in a phase.
fn share(process: u32) -> f64 {
    let used = || {
        let is_of_fleet = |name: &str| THREADS.iter().any(|begin| name.starts_with(begin));
        common::processor_seconds(process, is_of_fleet).unwrap()
    };
    std::thread::sleep(SETTLED);
    let (begin, before) = (Instant::now(), used());
    std::thread::sleep(PHASE);
    (used() - before) / begin.elapsed().as_secs_f64()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

//! Flight files of a running controller: what a file around a failed net holds.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use takt_core::controller::{FlightSettings, LoadRequest, MachineRequest};
use takt_core::record::contents;
use takt_core::{CellConfig, Controller, NetId, SessionId};

/// A time within which a file is complete even on a busy host.
const LONG: Duration = Duration::from_secs(60);

fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("flights-{name}"));
    let _ = std::fs::remove_dir_all(&path);
    path
}

/// A controller with an arm, a base and a flight recorder; nets that are rejected for 100 ms end.
fn cell(directory: &Path) -> Controller {
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    cell.controller.rejected_ends_after = Duration::from_millis(100);
    let controller = Controller::start(&cell).unwrap();
    let list = |value: f64| format!("{:?}", vec![value; 7]);
    let limits = [
        ("min_joint", -2.0),
        ("max_joint", 2.0),
        ("max_vel", 2.0),
        ("max_acc", 4.0),
        ("home_joint", 0.04),
    ];
    let limits: BTreeMap<_, _> = limits.map(|(key, v)| (key.to_owned(), list(v))).into();
    controller
        .add_device("left", "kuka_lwr_sim", &limits)
        .unwrap();
    let none = BTreeMap::new();
    controller
        .add_device("base", "kuka_youbot_base_sim", &none)
        .unwrap();
    let settings = FlightSettings {
        directory: directory.to_owned(),
        bytes_max: 64 << 20,
        cell: Some("# the cell\n".to_owned()),
    };
    let log = controller.record_flights(settings).unwrap();
    log.line_of(tracing::Level::INFO, "tests", "the test has begun");
    controller
}

fn start(controller: &Controller, position: &str) -> NetId {
    let text = format!(
        "{{v=Core::DoubleValue(Value='{position}'),\
         j=RobotArm::JointPosition(inPosition=v.outValue,Robot='left',Axis='4'),\
         t=Core::Clock(),o=Core::DoubleNetcommOut(inValue=t.outValue,Key='t'),c=Cancel(),outTerminate=c.outCancel}}"
    );
    let id = controller
        .load(LoadRequest {
            text,
            session: SessionId::NONE,
            description: String::new(),
            period: None,
        })
        .unwrap();
    controller.start_net(id).unwrap();
    id
}

/// A machine that changes its state after 20 ms.
fn start_machine(controller: &Controller) {
    let machine = MachineRequest {
        text: "machine M { initial state A { entry { wait 20ms; } transition to B; }\
               state B { transition if false to C; } final state C { } }"
            .to_owned(),
        ..MachineRequest::default()
    };
    let machine = controller.load_machine(&machine).unwrap();
    controller.start_machine(&machine).unwrap();
}

fn wait(what: &str, mut done: impl FnMut() -> bool) {
    let until = Instant::now() + LONG;
    while !done() {
        assert!(Instant::now() < until, "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The only flight file, once it is complete.
fn file(controller: &Controller) -> PathBuf {
    wait("no file is complete", || {
        controller.flights().iter().any(|file| file.is_complete)
    });
    let files = controller.flights();
    assert_eq!(files.len(), 1, "{files:?}");
    files[0].path.clone()
}

#[test]
fn failed_net_writes_flight_file_with_everything() {
    let directory = folder("net");
    let controller = cell(&directory);
    start_machine(&controller);
    // Far outside of what the arm can follow at once: rejected.
    let net = start(&controller, "1.0");
    wait("the net does not end", || {
        controller.net(net).is_some_and(|net| net.end.is_some())
    });
    // What was unloaded meanwhile is in the file all the same.
    controller.unload(net).unwrap();
    let path = file(&controller);
    let name = path.file_name().unwrap().to_str().unwrap();
    assert!(name.ends_with(&format!("-{net}.mcap")), "{name}");
    let found = contents(&path).unwrap();
    assert!(!found.is_cut);
    let topics: BTreeSet<_> = found.topics.keys().map(String::as_str).collect();
    let values = format!("/takt/nets/{net}");
    for topic in [
        "/left/joint_states",
        "/left/set_points",
        "/takt/thread",
        "/diagnostics",
        "/tf",
        "/rosout",
        "/takt/net_events",
        "/takt/machine_events",
        &values,
    ] {
        assert!(topics.contains(topic), "{topic} is missing in {topics:?}");
    }
    let states = found.topics["/left/joint_states"].messages;
    let cycles = found.topics["/takt/thread"].messages;
    // The second after the fault, and what was before.
    assert!(
        states >= 500 && (states..states + 1000).contains(&cycles),
        "{states} {cycles}"
    );
    assert!(found.topics[&values].messages >= 50);
    let about = takt_core::record::about(&path).unwrap();
    assert!(about["cause"].contains(&net.to_string()), "{about:?}");
    let bytes = std::fs::read(&path).unwrap();
    damage_end(&path.with_extension("damaged"), &bytes);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let names = summary.attachment_indexes.iter().map(|it| it.name.clone());
    let names: Vec<_> = names.collect();
    let texts = [
        "cell.toml".to_owned(),
        format!("nets/{net}.net"),
        "machines/M.machine".to_owned(),
    ];
    assert_eq!(names, texts);
    let happened = |topic: &str, word: &str| {
        let mut messages = mcap::MessageStream::new(&bytes)
            .unwrap()
            .map(Result::unwrap);
        let has = |data: &[u8]| data.windows(word.len()).any(|part| part == word.as_bytes());
        messages.any(|message| message.channel.topic == topic && has(&message.data))
    };
    for (topic, word) in [
        ("/takt/net_events", "started"),
        ("/takt/net_events", "ended"),
        ("/takt/machine_events", "added"),
        ("/takt/machine_events", "B\0"),
    ] {
        assert!(happened(topic, word), "{topic}: {word}");
    }
    // In the order of time, as viewers expect them.
    let messages = mcap::MessageStream::new(&bytes).unwrap();
    let times = messages.map(|message| message.unwrap().log_time);
    let times: Vec<_> = times.collect();
    assert!(times.is_sorted());
    drop(controller);
    std::fs::remove_dir_all(directory).unwrap();
}

/// A damaged or cut end is an error or nothing, never a panic.
fn damage_end(path: &Path, whole: &[u8]) {
    for at in 1..400 {
        let mut bytes = whole.to_vec();
        let place = bytes.len() - at;
        bytes[place] ^= 0xff;
        std::fs::write(path, &bytes).unwrap();
        // Which of both depends on what is damaged.
        let _ = takt_core::record::about(path);
        std::fs::write(path, &whole[..place]).unwrap();
        assert_eq!(takt_core::record::about(path).unwrap().len(), 0);
    }
}

#[test]
fn flight_request_joins_file_of_fault() {
    let directory = folder("request");
    let controller = cell(&directory);
    let first = controller.request_flight("the test").unwrap();
    assert_eq!(controller.request_flight("the test again").unwrap(), first);
    // A controller that ends completes its file at once.
    drop(controller);
    assert!(!contents(&first).unwrap().is_cut);
    std::fs::remove_dir_all(directory).unwrap();
}

#[test]
fn second_flight_recorder_is_rejected() {
    let directory = folder("second");
    let controller = cell(&directory);
    let settings = FlightSettings {
        directory: directory.clone(),
        bytes_max: 64 << 20,
        cell: None,
    };
    let error = controller.record_flights(settings).unwrap_err();
    assert!(error.to_string().contains("already"), "{error}");
    drop(controller);
    std::fs::remove_dir_all(directory).unwrap();
}

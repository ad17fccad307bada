//! Flight files of a controller with emulated arms on the real wire: what the file around a device fault holds.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use common::{Cell, swing};
use takt_core::controller::FlightSettings;
use takt_core::record::contents;
use takt_tests::{pass, simulate_time};

/// Messages by topic, each with its Unix time, ns, and its data; texts by name.
#[derive(Debug, Default)]
struct Flight {
    messages: BTreeMap<String, Vec<(u64, Vec<u8>)>>,
    texts: BTreeMap<String, String>,
}

fn read(path: &Path) -> Flight {
    assert!(!contents(path).unwrap().is_cut);
    let bytes = std::fs::read(path).unwrap();
    let mut flight = Flight::default();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let topic = message.channel.topic.clone();
        let data = message.data.into_owned();
        flight
            .messages
            .entry(topic)
            .or_default()
            .push((message.log_time, data));
    }
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    for index in &summary.attachment_indexes {
        let attachment = mcap::read::attachment(&bytes, index).unwrap();
        let text = String::from_utf8(attachment.data.into_owned()).unwrap();
        flight.texts.insert(attachment.name, text);
    }
    flight
}

fn has(data: &[u8], text: &str) -> bool {
    data.windows(text.len()).any(|part| part == text.as_bytes())
}

/// The only flight file, once it is complete.
fn file(cell: &Cell) -> PathBuf {
    cell.wait("the flight file", |controller| {
        controller.flights().iter().any(|file| file.is_complete)
    });
    let files = cell.controller.flights();
    assert_eq!(files.len(), 1, "{files:?}");
    files[0].path.clone()
}

#[test]
fn lwr_fault_writes_flight_of_eleven_seconds() {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("flights-of-fault");
    simulate_time(1.0);
    let _ = std::fs::remove_dir_all(&directory);
    let mut cell = Cell::new(&["left", "right"]);
    let settings = FlightSettings {
        directory: directory.clone(),
        bytes_max: 64 << 20,
        cell: Some("# the cell\n".to_owned()),
    };
    let log = cell.controller.record_flights(settings).unwrap();
    let net = cell.load(&swing("left", 40.0));
    cell.controller.start_net(net).unwrap();
    pass(Duration::from_millis(10_500));
    assert!(cell.controller.flights().is_empty(), "no fault yet");
    log.line_of(
        tracing::Level::WARN,
        "tests",
        "the robot is switched off now",
    );
    cell.robots[0].kill();
    let end = cell.wait_for_end(net).end.unwrap();
    assert!(end.contains("left stopped following commands"), "{end}");
    let path = file(&cell);
    assert!(path.to_str().unwrap().ends_with("-left.mcap"), "{path:?}");

    let flight = read(&path);
    // The cause of the end, in the cycle of the fault.
    let events = &flight.messages["/takt/net_events"];
    let is_end = |(_, data): &&(u64, Vec<u8>)| has(data, "ended") && has(data, "fault of left");
    let (fault, _) = events.iter().find(is_end).unwrap();
    for topic in ["/left/joint_states", "/right/joint_states", "/takt/thread"] {
        let messages = &flight.messages[topic];
        let (first, last) = (messages[0].0, messages[messages.len() - 1].0);
        let (before, after) = (fault - first, last - fault);
        assert!(
            (9_900_000_000..10_100_000_000).contains(&before),
            "{topic}: {before}"
        );
        assert!(
            (900_000_000..1_100_000_000).contains(&after),
            "{topic}: {after}"
        );
    }
    let lines = &flight.messages["/rosout"];
    assert!(
        lines
            .iter()
            .any(|(_, data)| has(data, "the robot is switched off now"))
    );
    assert!(flight.messages["/left/set_points"].len() > 9_000);
    assert_eq!(flight.texts["cell.toml"], "# the cell\n");
    assert_eq!(
        flight.texts[&format!("nets/{net}.net")],
        swing("left", 40.0)
    );
    std::fs::remove_dir_all(directory).unwrap();
}

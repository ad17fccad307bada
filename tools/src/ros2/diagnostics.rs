//! `/diagnostics`: devices with their faults and remedies, threads with their missed cycles, once a second.

use std::time::{Duration, Instant};

use serde_json::Value;
use takt_fleet::ros::keys::Qos;
use takt_fleet::ros::messages::{self, Level, Status};
use takt_fleet::ros::node::{Node, NodeError, now};
use takt_fleet::ros::types::DIAGNOSTIC_ARRAY;

use crate::http::Http;
use crate::output::{chain, complain};
use crate::signal::Stop;

const PERIOD: Duration = Duration::from_secs(1);
/// How often the end of the command is looked for.
const TICK: Duration = Duration::from_millis(100);

/// Starts the thread.
pub(super) fn start(node: &Node, http: &Http, stop: &Stop) -> Result<(), NodeError> {
    let publisher = node.publisher("/diagnostics", &DIAGNOSTIC_ARRAY, Qos::TOPIC)?;
    let (http, stop) = (http.clone(), stop.clone());
    std::thread::spawn(move || {
        let mut is_lost = false;
        let mut last: Option<Instant> = None;
        while !stop.is_requested() {
            if last.is_some_and(|at| at.elapsed() < PERIOD) {
                std::thread::sleep(TICK);
                continue;
            }
            last = Some(Instant::now());
            let statuses = match http.get("/devices/") {
                Ok(devices) => {
                    is_lost = false;
                    of_devices(http.address(), &devices)
                }
                Err(why) => {
                    if !is_lost {
                        complain(&format!("takt: diagnostics: {}", chain(&why)));
                    }
                    is_lost = true;
                    vec![lost(http.address())]
                }
            };
            // Fails only when the session is closed.
            let _ = publisher.publish(messages::diagnostics(now(), &statuses));
        }
    });
    Ok(())
}

fn lost(address: &str) -> Status {
    Status {
        level: Level::Error,
        name: "takt: controller".to_owned(),
        message: "the controller does not answer".to_owned(),
        hardware: address.to_owned(),
        values: Vec::new(),
    }
}

/// A status for each device of the resource.
fn of_devices(address: &str, devices: &Value) -> Vec<Status> {
    let all = devices["device"].as_array().map(Vec::as_slice);
    let mut statuses: Vec<_> = all.unwrap_or_default().iter().map(of_device).collect();
    statuses.push(Status {
        level: Level::Ok,
        name: "takt: controller".to_owned(),
        message: format!("{} devices", statuses.len()),
        hardware: address.to_owned(),
        values: Vec::new(),
    });
    statuses
}

fn of_device(device: &Value) -> Status {
    let text = |key: &str| {
        let value = &device[key];
        let text = value.as_str().map(str::to_owned);
        let other = || {
            if value.is_null() {
                String::new()
            } else {
                value.to_string()
            }
        };
        text.unwrap_or_else(other)
    };
    let (name, state) = (text("name"), text("state"));
    let (level, message) = match state.as_str() {
        "op" => (Level::Ok, "operational"),
        "safeop" => (Level::Warn, "in contact, does not follow commands"),
        "off" => (Level::Error, "offline"),
        other => (Level::Stale, other),
    };
    let kept = ["type", "age", "faults", "recoveries"];
    let values = kept.iter().map(|key| ((*key).to_owned(), text(key)));
    Status {
        level,
        name: format!("takt: {name}"),
        message: message.to_owned(),
        hardware: name,
        values: values.filter(|(_, value)| !value.is_empty()).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn device_state_is_its_level() {
        let devices = serde_json::json!({"device": [
            {"name": "left", "state": "op", "type": "kuka_lwr_fri", "faults": 2},
            {"name": "right", "state": "off"},
            {"name": "base", "state": "safeop"},
        ]});
        let found = of_devices("robot:8080", &devices);
        let levels: Vec<_> = found.iter().map(|it| it.level).collect();
        assert_eq!(levels, [Level::Ok, Level::Error, Level::Warn, Level::Ok]);
        let values = &found[0].values;
        assert!(
            values.contains(&("faults".to_owned(), "2".to_owned())),
            "{values:?}"
        );
        assert_eq!(found[3].message, "3 devices");
    }
}

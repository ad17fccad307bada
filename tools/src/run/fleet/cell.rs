//! A controller as a cell of a fleet: telemetry and resources, read from its own HTTP as any client reads them, out values and the log
//! from where they are. Commands are [`commands`](super::commands).

use std::fmt::Write as _;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::{Map, Value, json};
use takt_client::Token;
use takt_core::tai::{Tai, TaiState, TaiWatch};
use takt_core::{Controller, Nanos, monotonic, read_tai};
use takt_fleet::command::{LossPolicy, Lost};
use takt_fleet::keys::chunk;
use takt_fleet::session::member::{Cell, Held, Topic};
use takt_server::LogBook;

use super::commands::Commands;
use super::joints::{Arm, Joints};
use super::starts::HeldNets;
use crate::http::Http;
use crate::output::chain;
use crate::top::finding::Grade;
use crate::top::report::{Device, Report};

/// How long the own server may take: far longer than it does.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Least time between two readings of the host's clock that count for its quality.
const READING_PAUSE: Nanos = Nanos::from_millis(200);

/// What all cells of this host have in common: the number of this run of its kernel, whose clock they share.
const CLOCK_ID: &str = "/proc/sys/kernel/random/boot_id";

/// Most out values of nets that are published.
const VALUES_MAX: usize = 512;

/// How the fleet reaches the controller of this process.
#[derive(Debug, Default)]
pub(super) struct Ways {
    /// Where it serves HTTP.
    pub(super) http: Option<String>,
    /// Where it takes DirectIO lines.
    pub(super) lines: Option<String>,
    pub(super) token: Option<Token>,
}

/// A controller in a fleet.
#[derive(Debug)]
pub(super) struct FleetCell {
    controller: Controller,
    http: Option<Http>,
    book: LogBook,
    commands: Commands,
    /// Highest rate of joints, 1/s.
    joints_hz: u32,
    joints: Mutex<Joints>,
    state: Mutex<State>,
}

/// What was read last.
#[derive(Debug)]
struct State {
    report: Report,
    /// Why there is no newer report.
    failure: Option<String>,
    clock: TaiWatch,
    arms: Vec<Arm>,
}

impl FleetCell {
    pub(super) fn new(controller: Controller, ways: Ways, book: LogBook, joints_hz: u32) -> Self {
        let Ways { http, lines, token } = ways;
        Self {
            controller,
            http: http.map(|address| Http::with_token(address, token.clone(), TIMEOUT)),
            book,
            commands: Commands::new(lines, token),
            joints_hz,
            joints: Mutex::default(),
            state: Mutex::new(State {
                report: Report::default(),
                failure: None,
                clock: TaiWatch::new(Nanos::ZERO),
                arms: Vec::new(),
            }),
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn get(&self, path: &str) -> Result<Value, String> {
        let http = self.http.as_ref().ok_or("the controller serves no HTTP")?;
        http.get(path).map_err(|error| chain(&error))
    }

    /// Reads the report again.
    pub(super) fn read(&self) {
        let before = self.state().report.clone();
        let read = self
            .http
            .as_ref()
            .map(|http| Report::read(http, Some(&before)));
        self.read_clock();
        let mut state = self.state();
        match read {
            Some(Ok(report)) => {
                let arms = devices(&report);
                let arms =
                    arms.filter_map(|it| Arm::of(&self.controller, &it.name, self.joints_hz));
                state.arms = arms.collect();
                state.report = report;
                if state.failure.take().is_some() {
                    tracing::info!("telemetry of the fleet is up to date again");
                }
            }
            Some(Err(error)) => {
                let why = chain(&error);
                if state.failure.is_none() {
                    tracing::warn!("telemetry of the fleet is stale: {why}");
                }
                state.failure = Some(why);
            }
            None => {}
        }
    }

    /// Reads the host's clock; the offset is that of now, its quality is judged over readings with pauses.
    fn read_clock(&self) -> Tai {
        let reading = read_tai();
        let mut state = self.state();
        let Ok(reading) = reading else {
            return state.clock.now();
        };
        let last = state.clock.now();
        if reading.after - last.at >= READING_PAUSE {
            return state.clock.handle(reading);
        }
        Tai {
            at: reading.after,
            offset: reading.offset(),
            ..last
        }
    }

    fn values(&self) -> Vec<Topic> {
        let nets = self.controller.nets().into_iter();
        let values = nets.flat_map(|net| {
            let values = self.controller.out_values(net).into_iter();
            values.map(move |(key, text)| {
                let topic = format!("net/{net}/value/{}", chunk(&key));
                (topic, crate::output::json_of(&text))
            })
        });
        values.take(VALUES_MAX).collect()
    }
}

impl Cell for FleetCell {
    fn now(&self) -> Nanos {
        monotonic()
    }

    fn info(&self) -> Map<String, Value> {
        let state = self.state();
        let report = &state.report;
        let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        let periods = report.threads.iter().map(|thread| thread.period_ns);
        let periods: Vec<_> = periods.collect();
        let devices = devices(report);
        let devices = devices.map(|device| json!({"name": device.name, "type": device.kind}));
        let devices: Vec<_> = devices.collect();
        let info = json!({
            "schema": "takt-fleet/1",
            "version": env!("CARGO_PKG_VERSION"),
            "host": host.trim_end(),
            "http": self.http.as_ref().map(Http::address),
            "periods_ns": periods,
            "devices": devices,
        });
        match info {
            Value::Object(info) => info,
            Value::Null
            | Value::Bool(_)
            | Value::Number(_)
            | Value::String(_)
            | Value::Array(_) => Map::new(),
        }
    }

    fn telemetry(&self) -> Vec<Topic> {
        self.read();
        let values = self.values();
        let state = self.state();
        let mut topics = topics(&state.report);
        topics.push(("summary".to_owned(), summary(&state)));
        topics.push(("clock".to_owned(), clock(&state.clock.now())));
        topics.extend(values);
        topics
    }

    fn devices(&self) -> Vec<String> {
        let state = self.state();
        let answering = devices(&state.report).filter(|device| device.state != "off");
        answering.map(|device| device.name.clone()).collect()
    }

    fn arms(&self) -> Vec<String> {
        self.state()
            .arms
            .iter()
            .map(|arm| arm.name.clone())
            .collect()
    }

    fn joints(&self, devices: &[String]) -> Vec<(String, Value)> {
        let arms = self.state().arms.clone();
        let wanted: Vec<_> = arms
            .iter()
            .filter(|arm| devices.contains(&arm.name))
            .collect();
        let mut joints = self.joints.lock().unwrap_or_else(PoisonError::into_inner);
        joints.read(&self.controller, &wanted)
    }

    fn log(&self, from: u64) -> (Vec<String>, u64) {
        let (lines, next) = self.book.lines(from, "");
        (lines.into_iter().map(|(_, line)| line).collect(), next)
    }

    fn resource(&self, path: &str) -> Result<Value, String> {
        match path {
            // Those of this program.
            "summary" => Ok(summary(&self.state())),
            "clock" => Ok(clock(&self.state().clock.now())),
            "report" => serde_json::to_value(&self.state().report).map_err(|why| why.to_string()),
            _ => {
                let mut value = self.get(&format!("/{}/", escaped(path)))?;
                if path == "stop" {
                    // The key stops the controller: it is for its own page.
                    let is_shown = |key: &str| key == "stopped" || key == "by";
                    if let Value::Object(stop) = &mut value {
                        stop.retain(|key, _| is_shown(key));
                    }
                }
                Ok(value)
            }
        }
    }

    fn opened(&self, session: u32, client: &str, on_loss: LossPolicy) {
        self.commands.open(session, client, on_loss);
    }

    fn execute(&self, session: u32, line: &str) -> Vec<String> {
        self.commands.execute(session, line)
    }

    fn notifications(&self, session: u32, wait: Duration) -> Result<Vec<String>, String> {
        self.commands.notifications(session, wait)
    }

    fn closed(&self, session: u32) {
        self.commands.close(session);
    }

    fn lost(&self, lost: Lost) {
        self.commands.lose(lost);
    }

    fn clock_id(&self) -> String {
        let id = std::fs::read_to_string(CLOCK_ID).unwrap_or_default();
        id.trim_end().to_owned()
    }

    fn tai(&self) -> Tai {
        self.read_clock()
    }

    fn prepare_start(&self, nets: &[String]) -> Result<Box<dyn Held>, String> {
        Ok(Box::new(HeldNets::prepare(&self.controller, nets)?))
    }
}

/// A path for a request line: what is not usual in a path is escaped, so that no path ends the line.
fn escaped(path: &str) -> String {
    let mut out = String::with_capacity(path.len());
    for byte in path.bytes() {
        if byte.is_ascii_alphanumeric() || b"-_.~/%".contains(&byte) {
            out.push(char::from(byte));
        } else {
            // Writing to a String cannot fail.
            let _ = write!(out, "%{byte:02X}");
        }
    }
    out
}

/// Topics of a report. What changes in each reading without a meaning, such as ages, is left out.
fn topics(report: &Report) -> Vec<Topic> {
    let devices = report.devices.iter().map(|device| {
        let event = device.event.as_ref();
        let event =
            event.map(|it| json!({"severity": it.severity, "cause": it.cause, "hint": it.hint}));
        let state = json!({
            "type": device.kind, "state": device.state, "faults": device.faults,
            "quality": device.quality, "event": event,
        });
        (format!("device/{}/state", chunk(&device.name)), state)
    });
    let nets = report.nets.iter().map(|net| {
        let state = json!({"state": net.state, "description": net.description, "end": net.end});
        (format!("net/{}/state", chunk(&net.name)), state)
    });
    let machines = report.machines.iter().map(|machine| {
        let state =
            json!({"status": machine.status, "state": machine.state, "error": machine.error});
        (format!("machine/{}/state", chunk(&machine.name)), state)
    });
    let threads = report.threads.iter().map(|thread| {
        let text = serde_json::to_value(thread).unwrap_or_default();
        (format!("thread/{}", chunk(&thread.name)), text)
    });
    let findings = serde_json::to_value(&report.findings).unwrap_or_default();
    devices
        .chain(nets)
        .chain(machines)
        .chain(threads)
        .chain([("findings".to_owned(), findings)])
        .collect()
}

/// The devices, without the controller itself, which is listed as one.
fn devices(report: &Report) -> impl Iterator<Item = &Device> {
    report.devices.iter().filter(|device| device.kind != "rcc")
}

/// A cell in one line: what `takt fleet list` and `top` show.
fn summary(state: &State) -> Value {
    let report = &state.report;
    let (count, operational) = (
        devices(report).count(),
        devices(report).filter(|it| it.state == "op").count(),
    );
    let running = report
        .nets
        .iter()
        .filter(|it| it.state == "RUNNING")
        .count();
    let missed: u64 = report.threads.iter().map(|thread| thread.missed).sum();
    let latest = report
        .threads
        .iter()
        .map(|thread| thread.latency.max_ns)
        .max();
    let (failed, warned) = (report.count(Grade::Fail), report.count(Grade::Warn));
    let worst = report
        .findings
        .first()
        .map(|finding| finding.cause.as_str());
    let word = if state.failure.is_some() {
        "stale"
    } else if report.stopped_by.is_some() {
        "stopped"
    } else if failed > 0 {
        "fail"
    } else if warned > 0 {
        "warn"
    } else {
        "good"
    };
    json!({
        "state": word,
        "failure": state.failure,
        "stopped_by": report.stopped_by,
        "devices": count, "operational": operational,
        "nets": report.nets.len(), "running": running,
        "machines": report.machines.len(),
        "missed": missed, "latency_ns_max": latest,
        "fail": failed, "warn": warned, "worst": worst,
    })
}

/// TAI of the host, as [`Tai`] has it.
fn clock(tai: &Tai) -> Value {
    let cause = (tai.state == TaiState::Free).then(|| tai.cause.to_string());
    json!({
        "state": tai.state.as_str(),
        "cause": cause,
        "tai_minus_monotonic_ns": tai.offset.0,
        "uncertainty_ns": tai.uncertainty.0,
        "tai_utc_s": tai.tai_utc_s,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::top::report::Net;

    #[test]
    fn path_cannot_end_the_request_line() {
        assert_eq!(escaped("devices/left%20arm"), "devices/left%20arm");
        assert_eq!(escaped("a b\r\nx"), "a%20b%0D%0Ax");
        assert_eq!(
            escaped("nets?format=xml"),
            "nets%3Fformat=xml".replace('=', "%3D")
        );
    }

    #[test]
    fn topics_have_no_ages_and_one_chunk_for_each_name() {
        let device = |name: &str, age_ns| Device {
            name: name.to_owned(),
            state: "op".to_owned(),
            age_ns: Some(age_ns),
            ..Device::default()
        };
        let report = |age_ns| Report {
            devices: vec![device("a/b", age_ns)],
            nets: vec![Net {
                name: "rpinet0".to_owned(),
                state: "RUNNING".to_owned(),
                ..Net::default()
            }],
            ..Report::default()
        };
        let first = topics(&report(1));
        assert_eq!(first, topics(&report(2)));
        let keys: Vec<_> = first.iter().map(|(key, _)| key.as_str()).collect();
        assert_eq!(
            keys,
            ["device/a%2Fb/state", "net/rpinet0/state", "findings"]
        );
        let state = State {
            report: report(1),
            failure: None,
            clock: TaiWatch::new(Nanos::ZERO),
            arms: Vec::new(),
        };
        let summary = summary(&state);
        assert_eq!(summary["state"], "good");
        assert_eq!(
            (&summary["operational"], &summary["running"]),
            (&json!(1), &json!(1))
        );
    }
}

//! What a controller reports of itself, read from its HTTP resources. Nothing is judged here.

use serde::Serialize;
use serde_json::Value;

use super::finding::{Finding, Grade, judge};
use crate::http::Http;

/// The state of a controller. Times are in ns.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Report {
    /// Of this object; it changes when readers of the old form would misread it.
    pub(crate) schema: &'static str,
    pub(crate) version: String,
    /// Who stopped everything; `None` if nothing is stopped.
    pub(crate) stopped_by: Option<String>,
    /// Allocations in real-time threads.
    pub(crate) allocations: u64,
    pub(crate) usage: Vec<Usage>,
    pub(crate) threads: Vec<Thread>,
    pub(crate) devices: Vec<Device>,
    /// Buses whose load is measured.
    pub(crate) buses: Vec<Bus>,
    pub(crate) nets: Vec<Net>,
    pub(crate) machines: Vec<Machine>,
    /// What is wrong, the worst first.
    pub(crate) findings: Vec<Finding>,
}

/// How much of a bounded resource is in use.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Usage {
    pub(crate) name: String,
    pub(crate) used: u64,
    pub(crate) bound: u64,
}

/// A net thread; times since its start.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Thread {
    pub(crate) name: String,
    pub(crate) period_ns: i64,
    pub(crate) cycles: u64,
    pub(crate) missed: u64,
    /// Cycles missed since the report before; `None` in the first.
    pub(crate) missed_now: Option<u64>,
    pub(crate) latency: Times,
    pub(crate) execution: Times,
    /// `None` if it runs on the host's clock.
    pub(crate) clock: Option<Clock>,
}

/// Distribution of a time, ns.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct Times {
    pub(crate) p99_ns: i64,
    pub(crate) max_ns: i64,
}

/// The clock that a thread follows.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Clock {
    pub(crate) device: String,
    pub(crate) state: String,
    pub(crate) phase_error: Times,
}

/// A device.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Device {
    pub(crate) name: String,
    #[serde(rename = "type")]
    pub(crate) kind: String,
    /// `op`, `safeop` or `off`.
    pub(crate) state: String,
    /// Since its last measurement; `None` if there was none.
    pub(crate) age_ns: Option<i64>,
    /// How often it stopped following commands.
    pub(crate) faults: u64,
    /// Quality of its FRI session, as its driver names it; `None` for all else.
    pub(crate) quality: Option<String>,
    pub(crate) event: Option<Event>,
}

/// A bus.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Bus {
    pub(crate) name: String,
    /// Bit rate, bit/s; `None` if it is not known.
    pub(crate) bit_rate: Option<u64>,
    /// Bits of frames within the last second, bit/s, and within the fullest one.
    pub(crate) bits: u64,
    pub(crate) bits_max: u64,
    /// The same as parts of the bit rate, 0 to 1.
    pub(crate) load: Option<f64>,
    pub(crate) load_max: Option<f64>,
}

/// The last event of a device.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Event {
    pub(crate) severity: String,
    pub(crate) ago_ns: i64,
    pub(crate) times: u64,
    pub(crate) cause: String,
    pub(crate) hint: Option<String>,
}

/// A net.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Net {
    pub(crate) name: String,
    pub(crate) state: String,
    pub(crate) description: String,
    /// Why it ended, if not by itself.
    pub(crate) end: Option<String>,
    pub(crate) figures: Option<Figures>,
    /// Set-points that are or were rejected.
    pub(crate) rejected: Vec<Rejected>,
}

/// What the evaluation of a net costs.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct Figures {
    /// Declared cost bound.
    pub(crate) cost_ns: i64,
    /// The time that nets of its thread may take together.
    pub(crate) budget_ns: i64,
    pub(crate) longest_ns: i64,
    /// Cycles of its thread that were late while it ran.
    pub(crate) overruns: u64,
    /// Cycles in which it took longer than declared.
    pub(crate) over_cost: u64,
}

/// Set-points of a net that a device or primitive rejected.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Rejected {
    pub(crate) device: String,
    pub(crate) part: String,
    pub(crate) cause: String,
    pub(crate) hint: String,
    pub(crate) lasts: bool,
}

/// A state machine.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Machine {
    pub(crate) name: String,
    pub(crate) status: String,
    pub(crate) state: String,
    pub(crate) error: String,
}

impl Report {
    /// Reads it; `before` is the report that was read last.
    pub(crate) fn read(http: &Http, before: Option<&Self>) -> anyhow::Result<Self> {
        let status = http.get("/status/")?;
        let rest = Rest {
            stop: http.get("/stop/")?,
            devices: http.get("/devices/")?,
            nets: http.get("/nets/")?,
            stats: http.get("/stats/")?,
            machines: http.get("/machines/")?,
        };
        Ok(Self::of(&status, &rest, before))
    }

    /// From the resources.
    pub(crate) fn of(status: &Value, rest: &Rest, before: Option<&Self>) -> Self {
        let stop = &rest.stop;
        let by = text(&stop["by"]);
        let by = if by.is_empty() {
            "an unknown client"
        } else {
            by
        };
        let mut report = Self {
            schema: "takt-top/1",
            version: text(&status["version"]).to_owned(),
            stopped_by: (stop["stopped"] == true).then(|| by.to_owned()),
            allocations: count(&status["allocations"]),
            usage: list(&status["count"]).iter().map(Usage::of).collect(),
            threads: list(&status["thread"])
                .iter()
                .map(|thread| Thread::of(thread, before))
                .collect(),
            devices: list(&rest.devices["device"])
                .iter()
                .map(Device::of)
                .collect(),
            buses: list(&rest.devices["bus"]).iter().map(Bus::of).collect(),
            nets: list(&rest.nets["net"])
                .iter()
                .map(|net| Net::of(net, list(&rest.stats["net"])))
                .collect(),
            machines: list(&rest.machines["machine"])
                .iter()
                .map(Machine::of)
                .collect(),
            findings: Vec::new(),
        };
        report.findings = judge(&report);
        report
    }

    /// Whether something fails.
    pub(crate) fn fails(&self) -> bool {
        self.count(Grade::Fail) > 0
    }

    /// Number of findings of a grade.
    pub(crate) fn count(&self, grade: Grade) -> usize {
        self.findings.iter().filter(|it| it.grade == grade).count()
    }
}

/// The resources beside `/status/`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rest {
    pub(crate) stop: Value,
    pub(crate) devices: Value,
    pub(crate) nets: Value,
    pub(crate) stats: Value,
    pub(crate) machines: Value,
}

impl Usage {
    fn of(value: &Value) -> Self {
        Self {
            name: owned(&value["name"]),
            used: count(&value["used"]),
            bound: count(&value["bound"]),
        }
    }
}

impl Times {
    fn of(value: &Value) -> Self {
        Self {
            p99_ns: ns(&value["p99"]).unwrap_or(0),
            max_ns: ns(&value["max"]).unwrap_or(0),
        }
    }
}

impl Thread {
    fn of(value: &Value, before: Option<&Report>) -> Self {
        let (name, missed) = (owned(&value["name"]), count(&value["missed"]));
        let same = |it: &&Self| it.name == name && it.cycles <= count(&value["cycles"]);
        let before = before.and_then(|report| report.threads.iter().find(same));
        let clock = list(&value["phaseerror"]).first().map(|clock| Clock {
            device: owned(&clock["device"]),
            state: owned(&clock["state"]),
            phase_error: Times::of(clock),
        });
        Self {
            missed_now: before.map(|before| missed.saturating_sub(before.missed)),
            name,
            missed,
            period_ns: ns(&value["period"]).unwrap_or(0),
            cycles: count(&value["cycles"]),
            latency: Times::of(&value["latency"][0]),
            execution: Times::of(&value["execution"][0]),
            clock,
        }
    }
}

impl Device {
    fn of(value: &Value) -> Self {
        let event = |event: &Value| Event {
            severity: owned(&event["severity"]),
            ago_ns: ns(&event["ago"]).unwrap_or(0),
            times: count(&event["times"]),
            cause: owned(&event["cause"]),
            hint: event["hint"].as_str().map(str::to_owned),
        };
        let mut figures = list(&value["figure"]).iter();
        let quality = figures.find(|figure| figure["name"] == "quality");
        Self {
            name: owned(&value["name"]),
            kind: owned(&value["type"]),
            state: owned(&value["state"]),
            age_ns: ns(&value["age"]),
            faults: count(&value["faults"]),
            quality: quality.map(|figure| owned(&figure["value"])),
            event: list(&value["event"]).last().map(event),
        }
    }
}

impl Bus {
    fn of(value: &Value) -> Self {
        Self {
            name: owned(&value["name"]),
            bit_rate: value["bitrate"].as_u64(),
            bits: count(&value["bits"]),
            bits_max: count(&value["bitsmax"]),
            load: value["load"].as_f64(),
            load_max: value["loadmax"].as_f64(),
        }
    }
}

impl Net {
    fn of(value: &Value, stats: &[Value]) -> Self {
        let uri = text(&value["uri"]);
        let stats = stats.iter().find(|it| text(&it["uri"]) == uri);
        let figures = stats.map(|it| &it["stats"][0]).map(|it| Figures {
            cost_ns: ns(&it["cost"]).unwrap_or(0),
            budget_ns: ns(&it["budget"]).unwrap_or(0),
            longest_ns: ns(&it["exec"][0]["max"]).unwrap_or(0),
            overruns: count(&it["overruns"]),
            over_cost: count(&it["overbudget"]),
        });
        let rejected = list(&value["rejected"]).iter().map(|it| Rejected {
            device: owned(&it["device"]),
            part: owned(&it["part"]),
            cause: owned(&it["cause"]),
            hint: owned(&it["hint"]),
            lasts: it["lasted"].is_null(),
        });
        Self {
            name: uri
                .trim_matches('/')
                .rsplit('/')
                .next()
                .map(str::to_owned)
                .unwrap_or_default(),
            state: owned(&value["status"]),
            description: owned(&value["desc"]),
            end: value["end"].as_str().map(str::to_owned),
            figures,
            rejected: rejected.collect(),
        }
    }
}

impl Machine {
    fn of(value: &Value) -> Self {
        Self {
            name: owned(&value["name"]),
            status: owned(&value["status"]),
            state: owned(&value["state"]),
            error: owned(&value["error"]),
        }
    }
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}

fn owned(value: &Value) -> String {
    text(value).to_owned()
}

fn count(value: &Value) -> u64 {
    value.as_u64().unwrap_or(0)
}

fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// A time in ms as ns.
#[expect(clippy::cast_possible_truncation, reason = "the conversion saturates")]
fn ns(value: &Value) -> Option<i64> {
    value.as_f64().map(|ms| (ms * 1e6).round() as i64)
}

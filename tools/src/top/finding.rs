//! What is wrong with a controller, by its report: cause, and remedy. It reads no controller.

use serde::Serialize;

use takt_can::stat::Limits;

use super::report::{Bus, Device, Machine, Net, Report, Thread, Usage};
use crate::output::time;

/// How bad something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Grade {
    Good,
    Warn,
    Fail,
}

/// Of what a finding is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Subject {
    Controller,
    Thread(String),
    Device(String),
    Bus(String),
    Net(String),
    Machine(String),
}

/// Something that is wrong.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Finding {
    pub(crate) grade: Grade,
    pub(crate) subject: Subject,
    pub(crate) cause: String,
    pub(crate) hint: Option<String>,
}

/// Events longer ago are history, ns.
const RECENT_NS: i64 = 60_000_000_000;

/// Age of a measurement above which it is stale, ns; longer than any cycle of a device.
const STALE_NS: i64 = 500_000_000;

impl Finding {
    fn new(grade: Grade, subject: Subject, cause: impl Into<String>) -> Self {
        Self {
            grade,
            subject,
            cause: cause.into(),
            hint: None,
        }
    }

    fn hint(self, hint: impl Into<String>) -> Self {
        let hint = hint.into();
        Self {
            hint: (!hint.is_empty()).then_some(hint),
            ..self
        }
    }
}

/// All findings, the worst first.
pub(crate) fn judge(report: &Report) -> Vec<Finding> {
    let mut found = of_controller(report);
    found.extend(report.threads.iter().flat_map(of_thread));
    found.extend(report.devices.iter().flat_map(of_device));
    found.extend(report.buses.iter().filter_map(of_bus));
    found.extend(report.machines.iter().flat_map(of_machine));
    found.extend(report.nets.iter().flat_map(of_net));
    found.extend(report.usage.iter().filter_map(of_usage));
    found.sort_by_key(|finding| std::cmp::Reverse(finding.grade));
    found
}

fn of_controller(report: &Report) -> Vec<Finding> {
    let mut found = Vec::new();
    if let Some(by) = &report.stopped_by {
        let cause = format!("everything is stopped, by {by}");
        let hint = "`takt stop --release` when it is safe; it starts nothing";
        found.push(Finding::new(Grade::Fail, Subject::Controller, cause).hint(hint));
    }
    if report.allocations > 0 {
        let cause = format!("{} allocations in real-time threads", report.allocations);
        let hint = "run `takt run --guard` to find the first, and report it";
        found.push(Finding::new(Grade::Fail, Subject::Controller, cause).hint(hint));
    }
    found
}

fn of_thread(thread: &Thread) -> Vec<Finding> {
    let subject = || Subject::Thread(thread.name.clone());
    let name = &thread.name;
    let mut found = Vec::new();
    if let Some(now @ 1..) = thread.missed_now {
        let cause = format!("thread {name} misses cycles: {now} since the last reading");
        let hint = "see `takt doctor`; the nets below with the highest cost; `takt jitter`";
        found.push(Finding::new(Grade::Fail, subject(), cause).hint(hint));
    } else if thread.missed > 0 {
        let (missed, cycles) = (thread.missed, thread.cycles);
        let cause = format!("thread {name} missed {missed} of {cycles} cycles since its start");
        let hint = "`takt doctor` examines this host, `takt jitter` measures it";
        found.push(Finding::new(Grade::Warn, subject(), cause).hint(hint));
    }
    if thread.latency.p99_ns > thread.period_ns / 2 {
        let (late, period) = (time(thread.latency.p99_ns), time(thread.period_ns));
        let cause = format!("thread {name}: 1 % of cycles begin later than {late} of {period}");
        let hint = "`takt doctor` examines this host";
        found.push(Finding::new(Grade::Warn, subject(), cause).hint(hint));
    }
    if let Some(clock) = &thread.clock
        && !["locked", "stable"].contains(&clock.state.as_str())
    {
        let (device, state) = (&clock.device, &clock.state);
        let cause = format!("thread {name} follows the clock of {device}, which is {state}");
        let hint = "see the state of that device below";
        found.push(Finding::new(Grade::Warn, subject(), cause).hint(hint));
    }
    found
}

fn of_device(device: &Device) -> Option<Finding> {
    let subject = Subject::Device(device.name.clone());
    let name = &device.name;
    let event = device.event.as_ref();
    let grade = match device.state.as_str() {
        "op" => Grade::Good,
        "safeop" => Grade::Warn,
        _ => Grade::Fail,
    };
    let why = event.map_or_else(String::new, |event| format!(": {}", event.cause));
    let hint = event.and_then(|event| event.hint.clone());
    if grade > Grade::Good {
        let state = if grade == Grade::Fail {
            "is offline"
        } else {
            "follows no commands"
        };
        let hint = hint.unwrap_or_else(|| "see the log of the controller".to_owned());
        let cause = format!("{name} {state}{why}");
        return Some(Finding::new(grade, subject, cause).hint(hint));
    }
    if let Some(age) = device.age_ns.filter(|age| *age > STALE_NS) {
        let cause = format!("{name}: its last measurement is {} old", time(age));
        let hint = "its driver stands still; see the log of the controller";
        return Some(Finding::new(Grade::Fail, subject, cause).hint(hint));
    }
    let event = event.filter(|event| event.severity != "info" && event.ago_ns < RECENT_NS)?;
    let cause = format!("{name}: {}, {} ago", event.cause, ago(event.ago_ns));
    Some(Finding::new(Grade::Warn, subject, cause).hint(hint.unwrap_or_default()))
}

/// A bus that is nearly full: with the limits of `takt can stat`.
fn of_bus(bus: &Bus) -> Option<Finding> {
    let limits = Limits::default();
    let load = bus.load?;
    let grade = match load {
        _ if load >= limits.load_failure => Grade::Fail,
        _ if load >= limits.load_warning => Grade::Warn,
        _ => return None,
    };
    let name = &bus.name;
    let cause = format!(
        "{name}: frames are on the bus for {:.0} % of its time",
        load * 100.0
    );
    let hint = format!(
        "`takt can stat {name}` shows whose; a longer cycle or a higher bit rate leaves room"
    );
    Some(Finding::new(grade, Subject::Bus(name.clone()), cause).hint(hint))
}

fn of_net(net: &Net) -> Vec<Finding> {
    let subject = || Subject::Net(net.name.clone());
    let name = &net.name;
    let mut found = Vec::new();
    for rejected in net.rejected.iter().rev().take(1) {
        let grade = if rejected.lasts {
            Grade::Fail
        } else {
            Grade::Warn
        };
        let finding = Finding::new(grade, subject(), rejected.cause.as_str());
        found.push(finding.hint(rejected.hint.as_str()));
    }
    if let Some(end) = &net.end {
        let (cause, hint) = end.split_once("\nhint: ").unwrap_or((end, ""));
        let finding = Finding::new(Grade::Warn, subject(), format!("{name} ended: {cause}"));
        let default = format!("`takt net list`; its last values: /nets/{name}/last");
        found.push(finding.hint(if hint.is_empty() { &default } else { hint }));
    }
    if net.state == "REJECTED" {
        let hint = format!("its faults: /nets/{name}/; `takt net check FILE` prints them");
        let cause = format!("{name} was rejected when it was loaded");
        found.push(Finding::new(Grade::Warn, subject(), cause).hint(hint));
    }
    if let Some(figures) = net.figures.filter(|figures| figures.over_cost > 0) {
        let (longest, cost) = (time(figures.longest_ns), time(figures.cost_ns));
        let cycles = figures.over_cost;
        let cause = format!(
            "{name} took longer than its cost bound of {cost} in {cycles} cycles, at most {longest}"
        );
        let hint = "`takt net calibrate` measures the bounds of this host";
        found.push(Finding::new(Grade::Warn, subject(), cause).hint(hint));
    }
    found
}

fn of_machine(machine: &Machine) -> Option<Finding> {
    let failed = machine.status == "failed";
    failed.then(|| {
        let (name, state) = (&machine.name, &machine.state);
        let cause = format!("machine {name} failed in state {state}: {}", machine.error);
        let hint =
            format!("`takt machine state {name}`; `takt machine start {name}` begins it again");
        Finding::new(Grade::Fail, Subject::Machine(name.clone()), cause).hint(hint)
    })
}

fn of_usage(usage: &Usage) -> Option<Finding> {
    let is_scarce = usage.used.saturating_mul(10) >= usage.bound.saturating_mul(9);
    (is_scarce && usage.bound > 0).then(|| {
        let Usage { name, used, bound } = usage;
        let cause = format!("{used} of {bound} {name} are in use");
        let hint = format!("end {name} that are no longer needed");
        Finding::new(Grade::Warn, Subject::Controller, cause).hint(hint)
    })
}

/// A time that has passed: `12 s`, `3 min`, `5 h`.
pub(crate) fn ago(ns: i64) -> String {
    let seconds = ns / 1_000_000_000;
    match seconds {
        ..1 => time(ns),
        1..120 => format!("{seconds} s"),
        120..7_200 => format!("{} min", seconds / 60),
        _ => format!("{} h", seconds / 3_600),
    }
}

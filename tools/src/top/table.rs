//! The tables of the page: findings, threads, devices, nets, machines, each a list of lines, the worst first. The screen and the
//! plain page show the same lines.

use super::finding::{Finding, Grade, Subject, ago};
use super::report::{Bus, Device, Machine, Net, Report, Thread};
use crate::output::{time, wrapped};

/// The order of lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Order {
    /// What has the worst finding first, then what is active.
    #[default]
    Worst,
    /// What takes most time first.
    Cost,
    Name,
}

impl Order {
    pub(super) const fn next(self) -> Self {
        match self {
            Self::Worst => Self::Cost,
            Self::Cost => Self::Name,
            Self::Name => Self::Worst,
        }
    }

    pub(super) const fn word(self) -> &'static str {
        match self {
            Self::Worst => "worst first",
            Self::Cost => "by cost",
            Self::Name => "by name",
        }
    }
}

/// A table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Section {
    /// Its name, and the heads of its columns.
    pub(super) head: String,
    pub(super) lines: Vec<Line>,
}

/// A line of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Line {
    pub(super) grade: Grade,
    pub(super) text: String,
}

/// All tables, at most so wide where they break lines.
pub(super) fn sections(report: &Report, order: Order, columns: usize) -> Vec<Section> {
    let mut all = vec![
        Section {
            head: "FINDINGS".to_owned(),
            lines: findings(&report.findings, columns),
        },
        threads(report, order),
        devices(report, order),
        nets(report, order),
        machines(report, order),
    ];
    // Few cells have such a bus.
    if !report.buses.is_empty() {
        all.insert(3, buses(report, order));
    }
    all
}

/// Columns before the text of a finding.
const INDENT: usize = 6;

fn findings(findings: &[Finding], columns: usize) -> Vec<Line> {
    if findings.is_empty() {
        let (grade, text) = (Grade::Good, "none".to_owned());
        return vec![Line { grade, text }];
    }
    let lines = |finding: &Finding| {
        let word = match finding.grade {
            Grade::Fail => "FAIL",
            Grade::Warn => "WARN",
            Grade::Good => "ok",
        };
        let hint = finding.hint.as_ref().map(|hint| format!("hint: {hint}"));
        let texts = [Some(finding.cause.clone()), hint].into_iter().flatten();
        let texts: Vec<String> = texts
            .flat_map(|text| {
                let text = one_line(&text);
                wrapped(&text, INDENT, columns).collect::<Vec<_>>()
            })
            .collect();
        let line = |(number, text): (usize, String)| Line {
            grade: finding.grade,
            text: format!("{:<INDENT$}{text}", if number == 0 { word } else { "" }),
        };
        texts.into_iter().enumerate().map(line).collect::<Vec<_>>()
    };
    findings.iter().flat_map(lines).collect()
}

/// Sorts entries into lines.
fn sorted<T>(
    entries: &[T],
    order: Order,
    of: impl Fn(&T) -> Entry,
    line: impl Fn(&T) -> String,
) -> Vec<Line> {
    let mut all: Vec<_> = entries.iter().map(|it| (of(it), it)).collect();
    all.sort_by(|(a, _), (b, _)| {
        let name = || natural(&a.name).cmp(&natural(&b.name));
        match order {
            Order::Worst => (b.grade, b.activity)
                .cmp(&(a.grade, a.activity))
                .then_with(name),
            Order::Cost => b.cost_ns.cmp(&a.cost_ns).then_with(name),
            Order::Name => name(),
        }
    });
    let line = |(entry, it): (Entry, &T)| Line {
        grade: entry.grade,
        text: one_line(line(it).trim_end()),
    };
    all.into_iter().map(line).collect()
}

/// What the order of an entry depends on.
struct Entry {
    grade: Grade,
    /// How much it does: what runs is above what is over.
    activity: u8,
    cost_ns: i64,
    name: String,
}

/// A name in its natural order: `rpinet9` before `rpinet10`.
fn natural(name: &str) -> (usize, &str) {
    let digits = name.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    if digits < name.len() {
        (name.len(), name)
    } else {
        (0, name)
    }
}

/// The worst grade of a subject.
fn grade_of(report: &Report, subject: &Subject) -> Grade {
    let own = report.findings.iter().filter(|it| it.subject == *subject);
    own.map(|it| it.grade).max().unwrap_or(Grade::Good)
}

fn threads(report: &Report, order: Order) -> Section {
    let line = |thread: &Thread| {
        let Thread {
            name,
            period_ns,
            missed,
            latency,
            execution,
            ..
        } = thread;
        let clock = thread.clock.as_ref().map_or_else(
            || "host".to_owned(),
            |clock| {
                let error = time(clock.phase_error.p99_ns);
                format!("{} {} {error}", clock.device, clock.state)
            },
        );
        format!(
            "{:<10} {:>8} {:>9} {:>9} {:>9} {:>9} {missed:>7}  {clock}",
            cut(name, 10),
            time(*period_ns),
            time(latency.p99_ns),
            time(latency.max_ns),
            time(execution.p99_ns),
            time(execution.max_ns),
        )
    };
    let of = |thread: &Thread| Entry {
        grade: grade_of(report, &Subject::Thread(thread.name.clone())),
        activity: 0,
        cost_ns: thread.execution.max_ns,
        name: thread.name.clone(),
    };
    Section {
        head: "THREADS      period  late p99       max  exec p99       max  missed  clock"
            .to_owned(),
        lines: sorted(&report.threads, order, of, line),
    }
}

fn devices(report: &Report, order: Order) -> Section {
    let line = |device: &Device| {
        let event = device.event.as_ref().map_or_else(String::new, |event| {
            let times = if event.times > 1 {
                format!(", {} times", event.times)
            } else {
                String::new()
            };
            format!("{} ago: {}{times}", ago(event.ago_ns), event.cause)
        });
        let quality = device.quality.as_ref();
        let quality = quality.map_or_else(String::new, |it| format!("quality {it}  "));
        let age = device.age_ns.map_or_else(|| "-".to_owned(), ago);
        let Device {
            name,
            kind,
            state,
            faults,
            ..
        } = device;
        format!(
            "{:<12} {:<18} {state:<6} {age:>8} {faults:>6}  {quality}{event}",
            cut(name, 12),
            cut(kind, 18)
        )
    };
    let of = |device: &Device| Entry {
        grade: grade_of(report, &Subject::Device(device.name.clone())),
        activity: 0,
        cost_ns: device.age_ns.unwrap_or(i64::MAX),
        name: device.name.clone(),
    };
    Section {
        head: "DEVICES      type               state       age faults  last event".to_owned(),
        lines: sorted(&report.devices, order, of, line),
    }
}

fn buses(report: &Report, order: Order) -> Section {
    let part = |load: Option<f64>| {
        load.map_or_else(|| "-".to_owned(), |it| format!("{:.1} %", it * 100.0))
    };
    let kilo = |bits: u64| format!("{:.1}", bits as f64 / 1e3);
    let line = |bus: &Bus| {
        let rate = bus
            .bit_rate
            .map_or_else(|| "-".to_owned(), |rate| (rate / 1000).to_string());
        format!(
            "{:<16} {rate:>12} {:>8} {:>8} {:>10} {:>12}",
            cut(&bus.name, 16),
            part(bus.load),
            part(bus.load_max),
            kilo(bus.bits),
            kilo(bus.bits_max),
        )
    };
    let of = |bus: &Bus| Entry {
        grade: grade_of(report, &Subject::Bus(bus.name.clone())),
        activity: 0,
        cost_ns: i64::try_from(bus.bits).unwrap_or(i64::MAX),
        name: bus.name.clone(),
    };
    Section {
        head: "BUSES            rate, kbit/s     load      max     kbit/s  max, kbit/s".to_owned(),
        lines: sorted(&report.buses, order, of, line),
    }
}

fn nets(report: &Report, order: Order) -> Section {
    let line = |net: &Net| {
        let mut figures = [const { String::new() }; 4];
        if let Some(it) = net.figures {
            figures = [
                time(it.cost_ns),
                time(it.longest_ns),
                it.overruns.to_string(),
                it.over_cost.to_string(),
            ];
        }
        let [cost, longest, overruns, over] = figures;
        let rejected = net.rejected.len();
        format!(
            "{:<12} {:<10} {cost:>8} {longest:>8} {overruns:>8} {over:>5} {rejected:>8}  {}",
            cut(&net.name, 12),
            net.state,
            net.description
        )
    };
    let of = |net: &Net| Entry {
        grade: grade_of(report, &Subject::Net(net.name.clone())),
        activity: activity(net),
        cost_ns: net.figures.map_or(-1, |figures| figures.longest_ns),
        name: net.name.clone(),
    };
    Section {
        head: "NETS         state          cost  longest overruns  over rejected  description"
            .to_owned(),
        lines: sorted(&report.nets, order, of, line),
    }
}

fn activity(net: &Net) -> u8 {
    match net.state.as_str() {
        "RUNNING" | "CANCELLING" => 3,
        "SCHEDULED" => 2,
        "LOADING" | "READY" => 1,
        _ => 0,
    }
}

fn machines(report: &Report, order: Order) -> Section {
    let line = |machine: &Machine| {
        let Machine {
            name,
            status,
            state,
            error,
        } = machine;
        format!("{:<16} {status:<10} {state:<22} {error}", cut(name, 16))
    };
    let of = |machine: &Machine| Entry {
        grade: grade_of(report, &Subject::Machine(machine.name.clone())),
        activity: u8::from(machine.status == "active"),
        cost_ns: 0,
        name: machine.name.clone(),
    };
    Section {
        head: "MACHINES         status     state                  error".to_owned(),
        lines: sorted(&report.machines, order, of, line),
    }
}

/// A text in one line without control characters: names and descriptions are those of clients.
fn one_line(text: &str) -> String {
    text.replace('\n', " ")
        .chars()
        .filter(|c| !c.is_control())
        .collect()
}

/// A name, of at most so many characters.
fn cut(name: &str, width: usize) -> String {
    let text = one_line(name);
    if text.chars().count() <= width {
        return text;
    }
    let kept: String = text.chars().take(width.saturating_sub(1)).collect();
    format!("{kept}…")
}

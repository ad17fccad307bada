//! Losses of a recording, and the cable that its error counters point to. Values that the recorded master did not read
//! are reported as unknown.

use std::fmt::Write as _;
use std::time::Duration;

use serde_json::{Value, json};
use takt_ethercat::Command;
use takt_ethercat::master::{Cable, Suspect};
use takt_ethercat::topology::Topology;

use super::Recording;
use super::slave::RecordedSlave;
use crate::Verdict;
use crate::ecat::finding::{Finding, nanos, percentiles, verdict, verdict_of};
use crate::output::{say, time};

/// The report on a recording.
#[derive(Debug)]
pub(in crate::ecat) struct Report {
    pub(super) name: String,
    pub(super) table: String,
    pub(super) object: Value,
    pub(super) findings: Vec<Finding>,
}

impl Report {
    /// Prints the report.
    pub(in crate::ecat) fn print(mut self, json: bool, quiet: bool) -> anyhow::Result<Verdict> {
        if json {
            let findings: Vec<Value> = self.findings.iter().map(Finding::object).collect();
            if let Value::Object(object) = &mut self.object {
                object.insert("findings".to_owned(), findings.into());
            }
            say(&self.object.to_string())?;
        } else {
            if !quiet {
                say(self.table.trim_end())?;
            }
            say(verdict(&self.name, &self.findings).trim_end())?;
        }
        Ok(verdict_of(&self.findings))
    }
}

/// The loss report of a recording.
pub(in crate::ecat) fn stat(recording: &Recording) -> Report {
    let findings = findings(recording);
    Report {
        name: recording.name.clone(),
        table: table(recording),
        object: object(recording),
        findings,
    }
}

/// Times of unexpected working counters.
fn misses(recording: &Recording) -> Vec<Duration> {
    let groups = recording.groups.values();
    let mut all: Vec<Duration> = groups
        .flat_map(|series| series.misses(recording.down))
        .collect();
    all.sort_unstable();
    all
}

/// Largest time between a miss and its cause: after a miss the master checks the slaves one by one.
const CAUSE_WINDOW: Duration = Duration::from_millis(50);

/// Misses at which a slave did not answer or was not in OP.
fn misses_of(slave: &RecordedSlave, misses: &[Duration]) -> usize {
    let near = |at: &Duration, miss: &Duration| at.abs_diff(*miss) <= CAUSE_WINDOW;
    let falls = || slave.falls.iter().map(|(at, ..)| at);
    let blamed = |miss: &&Duration| {
        slave.was_down(**miss)
            || falls().any(|at| near(at, miss))
            || slave.silent.iter().any(|at| near(at, miss))
    };
    misses.iter().filter(blamed).count()
}

/// The topology from the links that were read, and whether they were; otherwise a line.
fn topology(ring: &[(u16, &RecordedSlave)]) -> (Topology, bool) {
    let open: Option<Vec<[bool; 4]>> = ring.iter().map(|(_, slave)| slave.open()).collect();
    open.map_or_else(
        || (Topology::line(ring.len()), false),
        |open| (Topology::new(&open), true),
    )
}

fn suspects(ring: &[(u16, &RecordedSlave)]) -> Vec<Suspect> {
    let (tree, _) = topology(ring);
    let errors = |number: usize, port: usize| {
        let slave = ring.get(number).map(|(_, slave)| slave.at_port(port));
        let [invalid, receive, _, links] = slave.unwrap_or_default();
        (invalid + receive, links)
    };
    let mut all = Vec::new();
    for number in 0..ring.len() {
        let (mut broken, mut lost_links) = errors(number, 0);
        let above = tree.parent(number);
        if let Some((parent, port)) = above {
            let (more, links) = errors(parent, port);
            broken += more;
            lost_links = lost_links.max(links);
        }
        if broken > 0 || lost_links > 0 {
            let from = above.map(|(parent, port)| (parent, u8::try_from(port).unwrap_or(0)));
            all.push(Suspect {
                cable: Cable {
                    from,
                    to: Some(number),
                },
                errors: broken,
                lost_links,
            });
        }
    }
    all.sort_by_key(|suspect| std::cmp::Reverse((suspect.lost_links, suspect.errors)));
    all
}

fn findings(recording: &Recording) -> Vec<Finding> {
    let ring = recording.ring();
    let suspects = suspects(&ring);
    let misses = misses(recording);
    let broken = !suspects.is_empty();
    let mut all: Vec<Finding> = suspects.into_iter().map(Finding::Suspect).collect();
    for (number, (_, slave)) in ring.iter().enumerate() {
        for (at, al, code) in slave.falls.iter().take(3) {
            let at = since(recording, *at);
            all.push(Finding::Failure(format!(
                "slave {number}: {al} at {at}: {code}"
            )));
        }
        let blamed = misses_of(slave, &misses);
        if blamed > 0 {
            all.push(Finding::Failure(format!(
                "slave {number}: no answer or not in OP at {blamed} of {} missed working counters",
                misses.len()
            )));
        }
        if slave.controller_errors() > 0 {
            all.push(Finding::Controller(number, slave.controller_errors()));
        }
    }
    let frames = recording.frames;
    all.extend(silence(recording));
    if frames.lost > 0 && frames.answered > 0 {
        all.push(Finding::Lost {
            lost: frames.lost,
            sent: frames.sent,
            broken,
        });
    }
    if !misses.is_empty() {
        all.push(Finding::Misses(
            u64::try_from(misses.len()).unwrap_or(u64::MAX),
        ));
    }
    if frames.stale > 0 {
        all.push(Finding::Late(frames.stale));
    }
    let foreign = recording.foreign();
    if foreign > 0 {
        all.push(Finding::Foreign(foreign));
    }
    if recording.broken > 0 {
        let broken = recording.broken;
        all.push(Finding::Failure(format!(
            "{broken} frames of the recording cannot be decoded"
        )));
    }
    if recording.corrupt > 0 {
        all.push(Finding::Failure(format!(
            "{} frames had a wrong checksum at the probe\nhint: check the cable before it",
            recording.corrupt
        )));
    }
    all.extend(notes(recording).into_iter().map(Finding::Note));
    all
}

/// The finding if no frame returned.
fn silence(recording: &Recording) -> Option<Finding> {
    let frames = recording.frames;
    if frames.answered > 0 || frames.sent == 0 {
        return None;
    }
    let duration = since(recording, recording.end);
    Some(if frames.lost > 0 {
        Finding::Failure(format!(
            "no answer to {} frames in {duration}\nhint: check the cable to slave 0, its IN port and its supply, and \
             whether both directions were recorded",
            frames.sent
        ))
    } else {
        Finding::Note(format!(
            "the recording ends {duration} after its first frame, before an answer"
        ))
    })
}

/// What the recording does not show.
fn notes(recording: &Recording) -> Vec<String> {
    let mut notes = recording.notes.clone();
    let unmatched = recording.unmatched;
    if unmatched.searches > 0 {
        notes.push(format!(
            "{} answers to broadcasts of a sender without other frames: a master that probes its interfaces, or one whose \
             earlier frames were not recorded",
            unmatched.searches
        ));
    }
    if recording.frames.sent == 0 {
        notes.push(
            "only answers were recorded, so losses are unknown\nhint: record both directions at the master".to_owned(),
        );
    }
    if unmatched.early > 0 {
        notes.push(format!(
            "{} answers at the start belong to frames sent before the recording",
            unmatched.early
        ));
    }
    if recording.open > 0 && recording.frames.answered > 0 {
        notes.push(format!(
            "{} frames were still under way when the recording ended",
            recording.open
        ));
    }
    notes
}

/// A time since the start of the recording.
fn since(recording: &Recording, at: Duration) -> String {
    time(nanos(at.saturating_sub(recording.begin)))
}

fn slaves(count: usize) -> String {
    let ending = if count == 1 { "" } else { "s" };
    format!("{count} slave{ending}")
}

fn table(recording: &Recording) -> String {
    let ring = recording.ring();
    let frames = recording.frames;
    let cycle = recording.cycle.map_or_else(String::new, |cycle| {
        format!(" at a cycle of {}", time(nanos(cycle)))
    });
    let mut text = format!(
        "{}: {}, {}{cycle}\nframes      {} sent, {} lost, {} late, {} foreign\n",
        recording.name,
        slaves(recording.slave_count()),
        since(recording, recording.end),
        frames.sent,
        frames.lost,
        frames.stale,
        recording.foreign()
    );
    let trips: Vec<Duration> = recording.trips.iter().map(|trip| trip.took).collect();
    if let Some(trips) = percentiles(&trips) {
        let [p50, p99, most] = trips.map(|trip| time(nanos(trip)));
        let _ = writeln!(text, "round trip  p50 {p50}, p99 {p99}, max {most}");
    }
    for ((command, address, len), series) in &recording.groups {
        let _ = writeln!(
            text,
            "counters    {} {address:08X}h, {len} bytes: {} expected, {} of {} missed",
            Command::from(*command),
            series.expected(),
            series.misses(recording.down).len(),
            series.counters.len()
        );
    }
    if ring.is_empty() {
        return text;
    }
    if !topology(&ring).1 {
        text.push_str("topology    not in the recording: assumed to be a line\n");
    }
    let misses = misses(recording);
    text.push_str(
        "\n slave  station  state      misses  port  invalid  receive  forwarded  lost links\n",
    );
    for (number, (station, slave)) in ring.iter().enumerate() {
        let state = slave
            .al
            .map_or_else(|| "?".to_owned(), |(al, _)| al.to_string());
        let state: String = state.chars().take(9).collect();
        let blamed = misses_of(slave, &misses);
        let mut head = format!("{number:>6}   {station:04X}h   {state:<9} {blamed:>7}");
        if !slave.counted {
            let _ = writeln!(text, "{head}  error counters were not read");
            continue;
        }
        let open = slave.open().unwrap_or([true, false, false, false]);
        for (port, open) in open.iter().enumerate() {
            let [invalid, receive, forwarded, links] = slave.at_port(port);
            if !open && invalid + receive + forwarded + links == 0 {
                continue;
            }
            let _ = writeln!(
                text,
                "{head:<34} {port:>5} {invalid:>8} {receive:>8} {forwarded:>10} {links:>11}"
            );
            head.clear();
        }
    }
    text
}

fn object(recording: &Recording) -> Value {
    let frames = recording.frames;
    let misses = misses(recording);
    let ring = recording.ring();
    let slaves: Vec<Value> = ring
        .iter()
        .enumerate()
        .map(|(number, (station, slave))| {
            let ports: Vec<[u64; 4]> = (0..4).map(|port| slave.at_port(port)).collect();
            let column = |at: usize| -> Vec<u64> {
                ports
                    .iter()
                    .filter_map(|port| port.get(at).copied())
                    .collect()
            };
            json!({
                "slave": number,
                "station": station,
                "state": slave.al.map(|(al, _)| al.to_string()),
                "misses": misses_of(slave, &misses),
                "silent": slave.silent.len(),
                "counted": slave.counted,
                "invalid": column(0),
                "receive": column(1),
                "forwarded": column(2),
                "lost_links": column(3),
                "controller": slave.controller_errors(),
            })
        })
        .collect();
    let trips: Vec<Duration> = recording.trips.iter().map(|trip| trip.took).collect();
    let trip = percentiles(&trips).map(|trips| {
        let [p50, p99, most] = trips.map(nanos);
        json!({ "p50_ns": p50, "p99_ns": p99, "max_ns": most })
    });
    json!({
        "version": 1,
        "recording": recording.name,
        "duration_ns": nanos(recording.end.saturating_sub(recording.begin)),
        "cycle_ns": recording.cycle.map(nanos),
        "frames": {
            "sent": frames.sent,
            "answered": frames.answered,
            "lost": frames.lost,
            "late": frames.stale,
            "foreign": recording.foreign(),
            "open": recording.open,
            "unseen": recording.unmatched.searches + recording.unmatched.answers + recording.unmatched.early,
        },
        "round_trip": trip,
        "working_counter_misses": misses.len(),
        "slaves": slaves,
    })
}

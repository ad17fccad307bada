//! Samples as CSV (RFC 4180): a column for the time and one for each probe, with units. Rows of probes of several threads are in the
//! order of their times; a probe without a sample at a time has an empty field.

use std::collections::VecDeque;
use std::io::{self, Write};

use super::wire::{Frame, Setup, Triggered};

/// Rows of a group that wait for another one, which may have none.
const WAITING_MAX: usize = 10_000;

/// Writes samples.
#[derive(Debug)]
pub(super) struct Csv<W> {
    out: W,
    /// Rows by group, not written yet.
    waiting: Vec<VecDeque<(f64, Vec<f64>)>>,
    /// Number of columns by group.
    columns: Vec<usize>,
    /// Time of the trigger; `None` in a stream.
    trigger_s: Option<f64>,
    captures: u64,
    has_trigger: bool,
}

impl<W: Write> Csv<W> {
    /// Writes the heads of the columns. With a trigger, rows also have the number of the capture and the time from the trigger.
    pub(super) fn begin(mut out: W, setup: &Setup, has_trigger: bool) -> io::Result<Self> {
        let time = if has_trigger {
            "capture,time (s),from trigger (s)"
        } else {
            "time (s)"
        };
        write!(out, "{time}")?;
        for probe in setup.groups.iter().flat_map(|group| &group.probes) {
            let head = match probe.unit.as_str() {
                "" => probe.name.clone(),
                unit => format!("{} ({unit})", probe.name),
            };
            write!(out, ",{}", field(&head))?;
        }
        out.write_all(b"\n")?;
        Ok(Self {
            out,
            waiting: setup.groups.iter().map(|_| VecDeque::new()).collect(),
            columns: setup.groups.iter().map(|it| it.probes.len()).collect(),
            trigger_s: None,
            captures: 0,
            has_trigger,
        })
    }

    /// Another capture.
    pub(super) fn trigger(&mut self, triggered: &Triggered) -> io::Result<()> {
        self.flush()?;
        self.trigger_s = Some(triggered.time_s);
        self.captures += 1;
        Ok(())
    }

    pub(super) fn add(&mut self, frame: &Frame) -> io::Result<()> {
        let Some(waiting) = self.waiting.get_mut(frame.group) else {
            return Ok(());
        };
        for (time, values) in frame.rows() {
            waiting.push_back((time, values.to_vec()));
        }
        self.write(false)
    }

    /// Writes what is known to be complete: up to the time that every group has reached.
    fn write(&mut self, all: bool) -> io::Result<()> {
        loop {
            let is_behind = self.waiting.iter().any(VecDeque::is_empty);
            let is_full = self.waiting.iter().any(|it| it.len() > WAITING_MAX);
            if is_behind && !is_full && !all {
                return Ok(());
            }
            let times = self.waiting.iter().filter_map(|it| it.front());
            let Some(time) = times.map(|(time, _)| *time).min_by(f64::total_cmp) else {
                return Ok(());
            };
            self.row(time)?;
        }
    }

    fn row(&mut self, time: f64) -> io::Result<()> {
        if self.has_trigger {
            write!(self.out, "{},", self.captures)?;
        }
        write!(self.out, "{time:.9}")?;
        if self.has_trigger {
            match self.trigger_s {
                Some(trigger) => write!(self.out, ",{:.9}", time - trigger)?,
                None => self.out.write_all(b",")?,
            }
        }
        for (waiting, columns) in self.waiting.iter_mut().zip(&self.columns) {
            let row = waiting.pop_front_if(|(at, _)| at.total_cmp(&time).is_eq());
            let values = row.map(|(_, values)| values).unwrap_or_default();
            for number in 0..*columns {
                match values.get(number).filter(|value| !value.is_nan()) {
                    Some(value) => write!(self.out, ",{value}")?,
                    None => self.out.write_all(b",")?,
                }
            }
        }
        self.out.write_all(b"\n")
    }

    /// Writes the rest.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.write(true)?;
        self.out.flush()
    }
}

/// A field, in quotation marks if it has to be.
fn field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::super::wire::{Group, Probe};
    use super::*;

    fn setup() -> Setup {
        let group = |names: &[(&str, &str)]| Group {
            probes: names
                .iter()
                .map(|(name, unit)| Probe {
                    name: (*name).to_owned(),
                    unit: (*unit).to_owned(),
                    ..Probe::default()
                })
                .collect(),
            ..Group::default()
        };
        Setup {
            version: 1,
            groups: vec![
                group(&[("a.x", "m"), ("net:a, b/c.d", "")]),
                group(&[("t.latency", "s")]),
            ],
            rejected: Vec::new(),
        }
    }

    #[test]
    fn csv_merges_groups_by_time_with_units() {
        let mut csv = Csv::begin(Vec::new(), &setup(), false).unwrap();
        csv.add(&Frame::of(
            0,
            2,
            &[1.0, 0.5, 2.0, 1.001, 0.25, f64::NAN, 1.002, 0.0, 1.0],
        ))
        .unwrap();
        // The second group may still have rows before.
        assert_eq!(csv.out.iter().filter(|it| **it == b'\n').count(), 1);
        csv.add(&Frame::of(1, 1, &[1.0, 5e-5, 1.002, 6e-5]))
            .unwrap();
        csv.flush().unwrap();
        let text = String::from_utf8(csv.out).unwrap();
        assert_eq!(
            text,
            "time (s),a.x (m),\"net:a, b/c.d\",t.latency (s)\n\
             1.000000000,0.5,2,0.00005\n\
             1.001000000,0.25,,\n\
             1.002000000,0,1,0.00006\n"
        );
    }

    #[test]
    fn csv_of_captures_has_time_from_trigger() {
        let mut setup = setup();
        setup.groups.pop();
        let mut csv = Csv::begin(Vec::new(), &setup, true).unwrap();
        for (time_s, at) in [(2.0, 1.5), (4.0, 4.25)] {
            let cause = String::new();
            csv.trigger(&Triggered { time_s, cause }).unwrap();
            csv.add(&Frame::of(0, 2, &[at, 1.0, 0.0])).unwrap();
        }
        csv.flush().unwrap();
        let text = String::from_utf8(csv.out).unwrap();
        assert_eq!(
            text,
            "capture,time (s),from trigger (s),a.x (m),\"net:a, b/c.d\"\n\
             1,1.500000000,-0.500000000,1,0\n2,4.250000000,0.250000000,1,0\n"
        );
    }

    #[test]
    fn csv_of_a_silent_group_waits_boundedly() {
        let mut csv = Csv::begin(Vec::new(), &setup(), false).unwrap();
        for number in 0..3 * WAITING_MAX {
            #[expect(clippy::cast_precision_loss, reason = "small")]
            let time = number as f64 * 1e-3;
            csv.add(&Frame::of(0, 2, &[time, 0.0, 0.0])).unwrap();
            // Nothing is written for groups that are not there.
            csv.add(&Frame::of(7, 1, &[time, 0.0])).unwrap();
            assert!(csv.waiting[0].len() <= WAITING_MAX + 1);
        }
    }
}

//! Figures of the probes of a run: samples, extremes, mean. No sample is kept.

use serde_json::{Value, json};

use super::wire::{Frame, Setup};

/// Figures of all probes.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Figures {
    groups: Vec<Vec<Column>>,
    pub(super) captures: u64,
    pub(super) lost: u64,
    first_s: Option<f64>,
    last_s: f64,
}

/// Figures of a probe.
#[derive(Clone, Debug, PartialEq)]
struct Column {
    name: String,
    unit: String,
    samples: u64,
    nulls: u64,
    min: f64,
    max: f64,
    sum: f64,
    last: Option<f64>,
}

impl Figures {
    /// Begins with what is sampled; the figures of probes that are still sampled go on.
    pub(super) fn begin(&mut self, setup: &Setup) {
        let column = |probe: &super::wire::Probe| Column {
            name: probe.name.clone(),
            unit: probe.unit.clone(),
            samples: 0,
            nulls: 0,
            min: f64::INFINITY,
            max: f64::NEG_INFINITY,
            sum: 0.0,
            last: None,
        };
        let groups = setup.groups.iter();
        self.groups = groups
            .map(|group| group.probes.iter().map(column).collect())
            .collect();
    }

    /// Takes samples. What a capture lost is also reported beside it.
    pub(super) fn add(&mut self, frame: &Frame) {
        if self.captures == 0 {
            self.lost = self.lost.saturating_add(frame.lost);
        }
        let Some(columns) = self.groups.get_mut(frame.group) else {
            return;
        };
        for (time, values) in frame.rows() {
            self.first_s = Some(self.first_s.map_or(time, |first| first.min(time)));
            self.last_s = self.last_s.max(time);
            for (column, value) in columns.iter_mut().zip(values) {
                column.samples += 1;
                if value.is_nan() {
                    (column.nulls, column.last) = (column.nulls + 1, None);
                    continue;
                }
                column.min = column.min.min(*value);
                column.max = column.max.max(*value);
                column.sum += value;
                column.last = Some(*value);
            }
        }
    }

    /// Time from the first to the last sample, s.
    pub(super) fn span_s(&self) -> f64 {
        self.last_s - self.first_s.unwrap_or(self.last_s)
    }

    fn columns(&self) -> impl Iterator<Item = &Column> {
        self.groups.iter().flatten()
    }

    /// A table, with its heads.
    pub(super) fn text(&self) -> String {
        let width = self.columns().map(|it| it.name.chars().count()).max();
        let width = width.unwrap_or(0).max(10);
        let mut out = format!(
            "{:<width$} {:<6} {:>8} {:>6} {:>11} {:>11} {:>11} {:>11}\n",
            "probe", "unit", "samples", "null", "min", "max", "mean", "last"
        );
        for column in self.columns() {
            let [min, max, mean] = column.extremes().map(number);
            let last = number(column.last);
            let Column {
                name,
                unit,
                samples,
                nulls,
                ..
            } = column;
            out.push_str(&format!(
                "{name:<width$} {unit:<6} {samples:>8} {nulls:>6} {min:>11} {max:>11} {mean:>11} {last:>11}\n"
            ));
        }
        out
    }

    pub(super) fn json(&self) -> Value {
        let probe = |column: &Column| {
            let [min, max, mean] = column.extremes();
            json!({
                "name": column.name, "unit": column.unit, "samples": column.samples,
                "null": column.nulls, "min": min, "max": max, "mean": mean, "last": column.last,
            })
        };
        json!({
            "schema": "takt-scope/1", "span_s": self.span_s(), "captures": self.captures,
            "lost": self.lost, "probes": self.columns().map(probe).collect::<Vec<_>>(),
        })
    }
}

impl Column {
    /// Least, greatest and mean value.
    #[expect(clippy::cast_precision_loss, reason = "counters below 2^53 are exact")]
    fn extremes(&self) -> [Option<f64>; 3] {
        let count = self.samples - self.nulls;
        if count == 0 {
            return [None; 3];
        }
        [
            Some(self.min),
            Some(self.max),
            Some(self.sum / count as f64),
        ]
    }
}

/// A number of at most 11 characters; `-` if there is none.
pub(super) fn number(value: Option<f64>) -> String {
    let Some(value) = value else {
        return "-".to_owned();
    };
    let size = value.abs();
    if size != 0.0 && !(1e-4..1e7).contains(&size) {
        format!("{value:.3e}")
    } else if size >= 100.0 {
        format!("{value:.3}")
    } else {
        format!("{value:.6}")
    }
}

#[cfg(test)]
mod tests {
    use super::super::wire::{Group, Probe};
    use super::*;

    #[test]
    fn figures_count_nulls_and_losses() {
        let probe = |name: &str| Probe {
            name: name.to_owned(),
            unit: "rad".to_owned(),
            ..Probe::default()
        };
        let mut figures = Figures::default();
        figures.begin(&Setup {
            groups: vec![Group {
                probes: vec![probe("a.b"), probe("a.c")],
                ..Group::default()
            }],
            ..Setup::default()
        });
        let frame = Frame {
            lost: 4,
            ..Frame::of(0, 2, &[1.0, 2.0, f64::NAN, 1.5, -4.0, f64::NAN])
        };
        figures.add(&frame);
        figures.add(&Frame::of(9, 1, &[0.0, 0.0]));
        let json = figures.json();
        assert_eq!(json["lost"], 4);
        assert_eq!(json["span_s"], 0.5);
        assert_eq!(json["probes"][0]["mean"], -1.0);
        assert_eq!(json["probes"][1]["null"], 2);
        assert_eq!(json["probes"][1]["max"], Value::Null);
        assert_eq!(
            figures.text(),
            "probe      unit    samples   null         min         max        mean        last\n\
             a.b        rad           2      0   -4.000000    2.000000   -1.000000   -4.000000\n\
             a.c        rad           2      2           -           -           -           -\n"
        );
    }

    #[test]
    fn numbers_have_at_most_11_characters() {
        for (value, text) in [
            (0.0, "0.000000"),
            (-123_456.789_1, "-123456.789"),
            (1.0e-9, "1.000e-9"),
            (-1.234e200, "-1.234e200"),
        ] {
            assert_eq!(number(Some(value)), text);
            assert!(text.len() <= 11);
        }
    }
}

//! The samples that are shown: the last ones of a stream, or a capture. What leaves the window is dropped.

use std::collections::VecDeque;

use super::wire::{Event, Frame, Setup, Triggered};

/// Most samples that are kept of a group, values and times together.
const VALUES_MAX: usize = 2_000_000;

/// Longest window, s.
pub(super) const WINDOW_MAX_S: f64 = 120.0;

/// A point of a curve: time, s, and value.
pub(super) type Point = (f64, f64);

/// A probe with its place.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Curve {
    pub(super) name: String,
    pub(super) unit: String,
    /// For states: their names, by number.
    pub(super) states: Vec<String>,
    group: usize,
    column: usize,
}

/// Samples by group.
#[derive(Debug, Default)]
pub(super) struct Store {
    groups: Vec<VecDeque<(f64, Vec<f64>)>>,
    pub(super) curves: Vec<Curve>,
    /// The trigger of the capture that is shown; `None` in a stream.
    pub(super) trigger: Option<Triggered>,
    /// Groups that have their frame of this capture.
    is_filled: Vec<bool>,
    pub(super) captures: u64,
    pub(super) lost: u64,
    /// Latest time, s.
    pub(super) end_s: f64,
    /// What happened last that is not a sample.
    pub(super) note: Option<String>,
    /// Whether samples older than the longest window are kept.
    keeps_all: bool,
}

impl Store {
    /// A store that keeps all samples.
    pub(super) fn whole() -> Self {
        Self {
            keeps_all: true,
            ..Self::default()
        }
    }

    /// Takes what the controller reported.
    pub(super) fn handle(&mut self, event: &Event) {
        match event {
            Event::Setup(setup) => self.begin(setup),
            Event::Triggered(triggered) => {
                self.trigger = Some(triggered.clone());
                self.captures += 1;
                self.is_filled = vec![false; self.groups.len()];
            }
            Event::Ended(ended) => self.note = Some(format!("{}: {}", ended.probe, ended.cause)),
            Event::Lost { samples, .. } => self.lost = self.lost.saturating_add(*samples),
            Event::Frame(frame) => self.add(frame),
            Event::Done | Event::Refused(_) | Event::Closed(_) => {}
        }
    }

    fn begin(&mut self, setup: &Setup) {
        let curves = setup.groups.iter().enumerate().flat_map(|(group, info)| {
            let curves = info.probes.iter().enumerate();
            curves.map(move |(column, probe)| Curve {
                name: probe.name.clone(),
                unit: probe.unit.clone(),
                states: probe.states.clone(),
                group,
                column,
            })
        });
        *self = Self {
            curves: curves.collect(),
            groups: setup.groups.iter().map(|_| VecDeque::new()).collect(),
            is_filled: vec![false; setup.groups.len()],
            captures: self.captures,
            lost: self.lost,
            keeps_all: self.keeps_all,
            ..Self::default()
        };
        let rejected = setup.rejected.iter();
        let rejected: Vec<_> = rejected
            .map(|it| format!("{}: {}", it.probe, it.cause))
            .collect();
        self.note = (!rejected.is_empty()).then(|| rejected.join("; "));
    }

    fn add(&mut self, frame: &Frame) {
        // What a capture lost is also reported beside it.
        if self.trigger.is_none() {
            self.lost = self.lost.saturating_add(frame.lost);
        }
        let Some(rows) = self.groups.get_mut(frame.group) else {
            return;
        };
        // The first frame of a group in a capture replaces the capture before.
        let filled = self.is_filled.get_mut(frame.group);
        if self.trigger.is_some() && filled.is_some_and(|filled| !std::mem::replace(filled, true)) {
            rows.clear();
        }
        for (time, values) in frame.rows() {
            // A controller that was started again counts from 0.
            if rows.back().is_some_and(|(last, _)| time < *last) {
                rows.clear();
            }
            rows.push_back((time, values.to_vec()));
            let most = VALUES_MAX / (values.len() + 1);
            let is_left = |first: &(f64, Vec<f64>)| first.0 < time - WINDOW_MAX_S;
            let keeps_all = self.keeps_all;
            while !keeps_all && (rows.len() > most || rows.front().is_some_and(is_left)) {
                rows.pop_front();
            }
        }
        let ends = self.groups.iter().filter_map(|rows| rows.back());
        self.end_s = ends.map(|(time, _)| *time).fold(0.0, f64::max);
    }

    /// The points of a curve from one time to another, in pieces between nulls.
    pub(super) fn pieces(&self, curve: &Curve, from: f64, to: f64) -> Vec<Vec<Point>> {
        let Some(rows) = self.groups.get(curve.group) else {
            return Vec::new();
        };
        let begin = rows.partition_point(|(time, _)| *time < from);
        let rows = rows.range(begin..).take_while(|(time, _)| *time <= to);
        let mut pieces: Vec<Vec<Point>> = vec![Vec::new()];
        for (time, values) in rows {
            match values.get(curve.column).filter(|value| value.is_finite()) {
                Some(value) => {
                    if let Some(piece) = pieces.last_mut() {
                        piece.push((*time, *value));
                    }
                }
                None if pieces.last().is_some_and(|piece| !piece.is_empty()) => {
                    pieces.push(Vec::new());
                }
                None => {}
            }
        }
        pieces.retain(|piece| !piece.is_empty());
        pieces
    }

    /// The value of a curve at a time: of the last sample not after it; `None` if it is null, or there is none.
    pub(super) fn value(&self, curve: &Curve, time: f64) -> Option<f64> {
        let rows = self.groups.get(curve.group)?;
        let behind = rows.partition_point(|(at, _)| *at <= time);
        let (_, values) = rows.get(behind.checked_sub(1)?)?;
        values
            .get(curve.column)
            .copied()
            .filter(|it| it.is_finite())
    }

    /// From the first to the last sample, s.
    pub(super) fn span(&self) -> (f64, f64) {
        let begins = self.groups.iter().filter_map(|rows| rows.front());
        let begin = begins.map(|(time, _)| *time).fold(f64::INFINITY, f64::min);
        (begin.min(self.end_s), self.end_s)
    }
}

/// A curve of many points by the least and greatest of each of at most so many parts: what is drawn looks the same.
pub(super) fn thinned(points: &[Point], parts: usize) -> Vec<Point> {
    let size = points.len().div_ceil(parts.max(1)).max(1);
    if size <= 2 {
        return points.to_vec();
    }
    let of_part = |part: &[Point]| {
        let by_value = |a: &&Point, b: &&Point| a.1.total_cmp(&b.1);
        let ends = [part.iter().min_by(by_value), part.iter().max_by(by_value)];
        let mut ends: Vec<Point> = ends.into_iter().flatten().copied().collect();
        ends.sort_by(|a, b| a.0.total_cmp(&b.0));
        ends
    };
    points.chunks(size).flat_map(of_part).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::wire::{Group, Probe};
    use super::*;

    /// A setup with groups of probes, each a name and a unit.
    pub(in crate::scope) fn setup(groups: &[&[(&str, &str)]]) -> Setup {
        let group = |names: &&[(&str, &str)]| Group {
            thread: "nets".to_owned(),
            period_s: 0.001,
            probes: names
                .iter()
                .map(|(name, unit)| Probe {
                    name: (*name).to_owned(),
                    unit: (*unit).to_owned(),
                    ..Probe::default()
                })
                .collect(),
        };
        Setup {
            version: 1,
            groups: groups.iter().map(group).collect(),
            rejected: Vec::new(),
        }
    }

    #[test]
    fn store_drops_what_left_the_window() {
        let mut store = Store::default();
        store.handle(&Event::Setup(setup(&[&[("a", "m")]])));
        for time in 0..1000 {
            store.handle(&Event::Frame(Frame::of(0, 1, &[f64::from(time), 1.0])));
        }
        assert_eq!(store.groups[0].len(), 121);
        assert_eq!(store.span(), (879.0, 999.0));
        // Started again.
        store.handle(&Event::Frame(Frame::of(0, 1, &[1.0, 2.0])));
        assert_eq!(store.span(), (1.0, 1.0));
    }

    #[test]
    fn capture_replaces_the_one_before() {
        let mut store = Store::default();
        store.handle(&Event::Setup(setup(&[&[("a", "m")], &[("b", "")]])));
        for begin in [1.0, 5.0] {
            let (time_s, cause) = (begin + 1.0, String::new());
            store.handle(&Event::Triggered(Triggered { time_s, cause }));
            store.handle(&Event::Frame(Frame::of(
                0,
                1,
                &[begin, 1.0, begin + 2.0, 2.0],
            )));
            store.handle(&Event::Frame(Frame::of(1, 1, &[begin, 3.0])));
        }
        assert_eq!(store.captures, 2);
        assert_eq!(store.span(), (5.0, 7.0));
        let curve = store.curves[0].clone();
        assert_eq!(store.value(&curve, 6.9), Some(1.0));
        assert_eq!(store.value(&curve, 4.9), None);
    }

    #[test]
    fn curve_with_nulls_is_in_pieces() {
        let mut store = Store::default();
        store.handle(&Event::Setup(setup(&[&[("a", "m")]])));
        let values = [f64::NAN, 1.0, 2.0, f64::NAN, f64::NAN, 3.0];
        for (time, value) in (0_u32..).zip(values) {
            store.handle(&Event::Frame(Frame::of(0, 1, &[f64::from(time), value])));
        }
        let pieces = store.pieces(&store.curves[0], 0.0, 9.0);
        assert_eq!(pieces, [vec![(1.0, 1.0), (2.0, 2.0)], vec![(5.0, 3.0)]]);
        assert_eq!(store.value(&store.curves[0], 3.5), None);
    }

    #[test]
    fn thinned_curve_keeps_extremes() {
        let points: Vec<Point> = (0..10_000)
            .map(|n| (f64::from(n), if n == 5_001 { 7.0 } else { 0.0 }))
            .collect();
        let thin = thinned(&points, 100);
        assert!(thin.len() <= 200);
        assert!(thin.contains(&(5_001.0, 7.0)));
        assert_eq!(thinned(&points[..150], 100), points[..150]);
    }
}

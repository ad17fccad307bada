//! A picture of values that are read from elsewhere, drawn as those of a scope are.

use std::collections::HashMap;

use super::store::{Point, Store};
use super::svg::svg;
use super::wire::{Event, Frame, Group, Probe, Setup};

/// Values over time by name.
#[derive(Debug, Default)]
pub(crate) struct Picture {
    places: HashMap<String, usize>,
    curves: Vec<(String, &'static str, Vec<Point>)>,
}

impl Picture {
    /// Whether there is a curve of that name.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.places.contains_key(name)
    }

    /// Number of curves.
    pub(crate) fn len(&self) -> usize {
        self.curves.len()
    }

    /// Adds a point, time in s, to the curve of that name.
    pub(crate) fn add(&mut self, name: &str, unit: &'static str, point: Point) {
        let place = self.places.get(name).copied().unwrap_or_else(|| {
            self.places.insert(name.to_owned(), self.curves.len());
            self.curves.push((name.to_owned(), unit, Vec::new()));
            self.curves.len() - 1
        });
        if let Some((_, _, points)) = self.curves.get_mut(place) {
            points.push(point);
        }
    }

    /// The picture, a plot for each unit.
    pub(crate) fn svg(&self) -> anyhow::Result<String> {
        let groups = self.curves.iter().map(|(name, unit, _)| Group {
            thread: String::new(),
            period_s: 0.0,
            probes: vec![Probe {
                name: name.clone(),
                unit: (*unit).to_owned(),
                states: Vec::new(),
            }],
        });
        let mut store = Store::whole();
        store.handle(&Event::Setup(Setup {
            version: 1,
            groups: groups.collect(),
            rejected: Vec::new(),
        }));
        for (group, (_, _, points)) in self.curves.iter().enumerate() {
            let values = points.iter().flat_map(|(time, value)| [*time, *value]);
            store.handle(&Event::Frame(Frame {
                group,
                columns: 1,
                lost: 0,
                values: values.collect(),
            }));
        }
        svg(&store)
    }
}

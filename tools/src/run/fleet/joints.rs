//! Joints of a controller's devices for a fleet: a scope for each device that is subscribed to, as any other reader of probes. Without
//! subscribers nothing is sampled.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use takt_core::Controller;
use takt_core::probe::{Frame, Probe, Scope, ScopeEvent, ScopeRequest};

/// Batches of a device, 1/s.
const BATCHES_HZ: f64 = 20.0;

/// A device with joints: its probes, and each how-many-th sample is taken.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Arm {
    pub(super) name: String,
    joints: usize,
    every: u64,
}

impl Arm {
    /// A device, if it has joints; at most `rate_hz` samples of them are taken per second.
    pub(super) fn of(controller: &Controller, name: &str, rate_hz: u32) -> Option<Self> {
        let probes = controller.probes(&format!("{name}.joint.")).probes;
        Self::of_probes(&probes, name, rate_hz)
    }

    fn of_probes(probes: &[Probe], name: &str, rate_hz: u32) -> Option<Self> {
        let named = |what: &str, n: usize| {
            let wanted = format!("{name}.joint.{n}.{what}");
            probes.iter().find(|probe| probe.name == wanted)
        };
        let joints = (0..)
            .take_while(|n| named("measured", *n).is_some())
            .count();
        let period = named("measured", 0)?.period;
        let least = Duration::from_secs(1).checked_div(rate_hz)?;
        let every = least.as_nanos().div_ceil(period.as_nanos().max(1));
        Some(Self {
            name: name.to_owned(),
            joints,
            every: u64::try_from(every).unwrap_or(u64::MAX).max(1),
        })
    }

    fn request(&self) -> ScopeRequest {
        let names = |what: &str| {
            let names = (0..self.joints).map(|n| format!("{}.joint.{n}.{what}", self.name));
            names.collect::<Vec<_>>()
        };
        ScopeRequest {
            probes: [names("measured"), names("commanded")].concat(),
            every: self.every,
            rate_hz: BATCHES_HZ,
            ..ScopeRequest::default()
        }
    }
}

/// The scopes of the devices that are subscribed to.
#[derive(Debug)]
pub(super) struct Joints {
    begin: Instant,
    scopes: BTreeMap<String, Scope>,
}

impl Default for Joints {
    fn default() -> Self {
        Self {
            begin: Instant::now(),
            scopes: BTreeMap::new(),
        }
    }
}

impl Joints {
    /// The samples of these devices since the last call; what is not wanted is sampled no longer.
    pub(super) fn read(
        &mut self,
        controller: &Controller,
        wanted: &[&Arm],
    ) -> Vec<(String, Value)> {
        self.scopes
            .retain(|name, _| wanted.iter().any(|arm| arm.name == *name));
        for arm in wanted {
            if let Entry::Vacant(free) = self.scopes.entry(arm.name.clone()) {
                match controller.scope(&arm.request()) {
                    Ok(scope) => {
                        free.insert(scope);
                    }
                    // Too many scopes, or the device has just gone: tried again with the next batch.
                    Err(why) => tracing::debug!("no joints of {} for the fleet: {why}", arm.name),
                }
            }
        }
        let now = self.begin.elapsed();
        let mut batches = Vec::new();
        let mut ended = Vec::new();
        for (name, scope) in &mut self.scopes {
            scope.read(now);
            let mut lost = 0;
            while let Some(event) = scope.poll_event() {
                match event {
                    ScopeEvent::Frame(frame) => {
                        batches.push((name.clone(), batch(&frame, lost)));
                        lost = 0;
                    }
                    ScopeEvent::Lost { samples, .. } => lost += samples,
                    ScopeEvent::Ended { .. } => ended.push(name.clone()),
                    ScopeEvent::Triggered { .. } => {}
                }
            }
        }
        for name in ended {
            self.scopes.remove(&name);
        }
        batches
    }
}

/// Rows as columns of JSON; null is a value that is none.
fn batch(frame: &Frame, lost: u64) -> Value {
    let rows = frame.iter().map(|(time_s, values)| {
        let (measured, commanded) = values.split_at(values.len() / 2);
        json!([time_s, measured, commanded])
    });
    json!({
        "columns": ["time_s", "measured_rad", "commanded_rad"],
        "lost": frame.lost.saturating_add(lost),
        "rows": rows.collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arm_of_probes_has_joints_and_rate() {
        let probe = |name: &str| Probe {
            name: name.to_owned(),
            unit: "rad".to_owned(),
            thread: "nets".to_owned(),
            period: Duration::from_millis(1),
            source: "left".to_owned(),
            states: [].into(),
        };
        let names = [
            "left.joint.0.measured",
            "left.joint.1.measured",
            "other.left.joint.2.measured",
        ];
        let probes = names.map(probe);
        let every =
            |rate_hz| Arm::of_probes(&probes, "left", rate_hz).map(|arm| (arm.joints, arm.every));
        assert_eq!(every(500), Some((2, 2)));
        assert_eq!(every(300), Some((2, 4)));
        assert_eq!(every(5000), Some((2, 1)));
        assert_eq!(every(0), None);
        assert_eq!(Arm::of_probes(&probes, "right", 500), None);
    }

    #[test]
    fn batch_has_null_for_values_that_are_none() {
        let frame = Frame {
            columns: 2,
            lost: 1,
            values: vec![0.5, 1.0, f64::NAN],
            ..Frame::default()
        };
        let batch = batch(&frame, 2);
        assert_eq!(batch["lost"], 3);
        assert_eq!(batch["rows"], json!([[0.5, [1.0], [null]]]));
    }
}

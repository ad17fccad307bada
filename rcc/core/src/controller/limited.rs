//! Limiting by the last stages of devices: counters by name, and one log line per onset. The limits are
//! applied in the drivers, cycle by cycle.

use std::collections::BTreeMap;

use crate::device::last_stage::{Limited, Unit};
use crate::device::{ARM_JOINTS_MAX, Device, DeviceTable};

/// Limiting by the last stage of one part of a device.
#[derive(Clone, Debug, PartialEq)]
pub struct LimitedInfo {
    /// `joint 3`, `floor` or `turning` of a base, `fingers` of a gripper.
    pub part: String,
    /// Counters and the last excess.
    pub limited: Limited,
    /// The unit of its position.
    pub unit: Unit,
}

/// The parts of a device with a last stage each, in the order of `DeviceState::limited`.
fn parts(device: &Device) -> Vec<(String, Unit)> {
    let joint = |n| (format!("joint {n}"), Unit::Angle);
    if !device.limits.is_empty() {
        (0..device.limits.len()).map(joint).collect()
    } else if device.interfaces.base.is_some() {
        vec![
            ("floor".to_owned(), Unit::Length),
            ("turning".to_owned(), Unit::Angle),
        ]
    } else if device.interfaces.gripper.is_some() {
        vec![("fingers".to_owned(), Unit::Length)]
    } else {
        Vec::new()
    }
}

/// The log line.
fn line(part: &str, unit: Unit, limited: &Limited, onsets: u64) -> String {
    let why = limited.last.map(|excess| excess.text(unit));
    let times = if onsets > 1 {
        format!(" ({onsets} times since the last line)")
    } else {
        String::new()
    };
    if limited.is_exceeded {
        return format!(
            "{part}: {}{times}; it followed, as a simulation without strict limits does\nhint: a real arm is limited or \
             rejects such set-points; make the device with limits=strict to see that",
            why.unwrap_or_default()
        );
    }
    format!(
        "{part} was limited by its last stage: {}{times}; slow the motion, or give set-points that change less at once",
        why.unwrap_or_default()
    )
}

/// Limiting by the last stages of a device, part by part.
pub(super) fn infos(device: &Device) -> Vec<LimitedInfo> {
    let parts = parts(device).into_iter().zip(device.limited());
    let info = |((part, unit), limited)| LimitedInfo {
        part,
        limited,
        unit,
    };
    parts.map(info).collect()
}

/// What was reported of limiting and of position jumps.
#[derive(Debug, Default)]
pub(super) struct MotionReports {
    /// Number of reported onsets of limiting, by device and part.
    onsets: BTreeMap<String, [u64; ARM_JOINTS_MAX]>,
    /// Number of reported position jumps, by device.
    jumps: BTreeMap<String, u64>,
}

impl MotionReports {
    /// Log lines on limiting and position jumps since the last call, with the devices' names.
    pub(super) fn poll(&mut self, devices: &DeviceTable) -> Vec<(String, String)> {
        let mut lines = self.poll_limits(devices);
        lines.extend(self.poll_jumps(devices));
        lines
    }

    fn poll_limits(&mut self, devices: &DeviceTable) -> Vec<(String, String)> {
        let mut lines = Vec::new();
        self.onsets.retain(|name, _| devices.find(name).is_some());
        for (_, device) in devices.all() {
            let limited = device.limited();
            if limited.iter().all(|limited| limited.onsets == 0) {
                // Also a new device under the name of a removed one.
                self.onsets.remove(&device.name);
                continue;
            }
            let reported = self.onsets.entry(device.name.clone()).or_default();
            for (n, (part, unit)) in parts(device).into_iter().enumerate() {
                let (Some(limited), Some(reported)) = (limited.get(n), reported.get_mut(n)) else {
                    continue;
                };
                let onsets = limited.onsets.saturating_sub(*reported);
                *reported = limited.onsets;
                if onsets > 0 {
                    lines.push((device.name.clone(), line(&part, unit, limited, onsets)));
                }
            }
        }
        lines
    }

    fn poll_jumps(&mut self, devices: &DeviceTable) -> Vec<(String, String)> {
        let mut lines = Vec::new();
        self.jumps.retain(|name, _| devices.find(name).is_some());
        for (_, device) in devices.all() {
            let jumped = device.jumped();
            let name = &device.name;
            let before = self.jumps.insert(name.clone(), jumped.count);
            if jumped.count > before.unwrap_or(0) {
                lines.push((name.clone(), jumped.to_string()));
            }
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use takt_net::JointLimits;

    use super::*;
    use crate::device::last_stage::LastStage;

    #[test]
    fn line_names_part_excess_and_remedy() {
        let mut stage = LastStage::new(JointLimits {
            position_min: -1.0,
            position_max: 1.0,
            velocity_max: 2.0,
            acceleration_max: 4.0,
        });
        stage.track(0.001, 0.0, 1e-3);
        let text = line("joint 3", Unit::Angle, stage.limited(), 2);
        assert_eq!(
            text,
            "joint 3 was limited by its last stage: acceleration 1000.0000 rad/s² commanded, limit 4.0000 rad/s² \
             (2 times since the last line); slow the motion, or give set-points that change less at once"
        );
    }
}

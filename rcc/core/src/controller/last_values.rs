//! The last second of values of a device or a net before a fault: copied from the flight recorder when the fault is detected, formatted
//! when it is asked for.

use std::collections::VecDeque;
use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Duration;

use takt_net::device::Interfaces;
use takt_net::netcomm::{Directory, OutStatus};
use takt_net::value::{Twist, Vector};

use crate::device::Device;
use crate::executor::flight::{DEVICE_BEGIN, FlightReader, HEAD, JOINT_WORDS};
use crate::ids::NetId;

/// Maximum number of failed nets and of faulted devices whose last values are kept; the oldest are dropped first.
const KEPT: usize = 16;
/// How long before the end the rows of a short table are, ns.
const SHOWN_NS: [i64; 6] = [
    1_000_000_000,
    100_000_000,
    10_000_000,
    2_000_000,
    1_000_000,
    0,
];

/// Time that they cover, ns.
const SPAN_NS: i64 = 1_000_000_000;

/// When they begin, if they end now, ns on `CLOCK_MONOTONIC`.
fn since() -> i64 {
    takt_rt::monotonic().0 - SPAN_NS
}

/// The values of a device in a row.
#[derive(Clone, Debug)]
struct DeviceRows {
    device: Arc<Device>,
    rows: Vec<Vec<u64>>,
}

/// The out values of a net, as they changed.
#[derive(Clone, Debug)]
struct NetRows {
    directory: Arc<Directory>,
    rows: Vec<(i64, Vec<u64>)>,
}

/// What was recorded of a device, or of a net and the devices that it commanded.
#[derive(Clone, Debug)]
pub struct LastValues {
    devices: Vec<DeviceRows>,
    net: Option<NetRows>,
}

impl LastValues {
    /// The values of these devices up to now.
    pub(super) fn of_devices(devices: impl Iterator<Item = Arc<Device>>) -> Self {
        let since = since();
        let rows = |device: Arc<Device>| {
            let rows = device.flight.get()?.rows_since(since, DEVICE_BEGIN);
            Some(DeviceRows { device, rows })
        };
        Self {
            devices: devices.filter_map(rows).collect(),
            net: None,
        }
    }

    /// The same with the out values of a net up to now.
    pub(super) fn with_net(
        mut self,
        net: NetId,
        directory: &Arc<Directory>,
        flight: &FlightReader,
    ) -> Self {
        let rows = flight.rows_of_net(net.0, directory.words(), since());
        let directory = Arc::clone(directory);
        self.net = Some(NetRows { directory, rows });
        self
    }

    /// When the last row was recorded, ns on `CLOCK_MONOTONIC`.
    fn end_ns(&self) -> i64 {
        let devices = self.devices.iter().filter_map(|it| it.rows.last());
        let devices = devices.map(|row| begin_ns(row));
        let nets = self.net.iter().filter_map(|it| it.rows.last());
        devices.chain(nets.map(|row| row.0)).max().unwrap_or(0)
    }

    /// All rows as CSV, a block for each device and one for the net: times in s before the end, empty fields for unknown
    /// values.
    #[must_use]
    pub fn csv(&self) -> String {
        let end = self.end_ns();
        let mut text = String::new();
        for DeviceRows { device, rows } in &self.devices {
            let names = columns(device);
            let head = names.iter().map(|name| format!("{} {name}", device.name));
            let head: Vec<_> = head.collect();
            let _ = writeln!(text, "time s,{}", head.join(","));
            for row in rows {
                let fields: Vec<_> = values(device, row).into_iter().map(field).collect();
                let _ = writeln!(
                    text,
                    "{},{}",
                    seconds(begin_ns(row) - end),
                    fields.join(",")
                );
            }
        }
        if let Some(NetRows { directory, rows }) = &self.net {
            let shown = || {
                directory
                    .entries()
                    .iter()
                    .filter(|entry| !entry.is_hidden())
            };
            let head: Vec<_> = shown().map(|entry| entry.key.as_str()).collect();
            let _ = writeln!(text, "time s,{}", head.join(","));
            for (begin, words) in rows {
                let fields = shown().map(|entry| {
                    let mut value = String::new();
                    if entry.status(words) == OutStatus::Current {
                        entry.format(words, &mut value);
                    }
                    if value.contains(',') {
                        format!("\"{value}\"")
                    } else {
                        value
                    }
                });
                let fields: Vec<_> = fields.collect();
                let _ = writeln!(text, "{},{}", seconds(begin - end), fields.join(","));
            }
        }
        text
    }

    /// A few rows as a table: what arms and bases were commanded and measured 1 s, 100 ms, 10 ms, and some cycles before the
    /// end.
    #[must_use]
    pub fn table(&self) -> String {
        let end = self.end_ns();
        let mut text = String::new();
        for DeviceRows { device, rows } in &self.devices {
            if rows.is_empty() {
                continue;
            }
            let shown = few(rows, end);
            let times = shown.iter().map(|row| {
                let ms = Duration::from_nanos((end - begin_ns(row)).unsigned_abs()).as_millis();
                format!("{:>12}", format!("-{ms} ms"))
            });
            let _ = writeln!(text, "{:<16}{}", device.name, times.collect::<String>());
            let values: Vec<_> = shown.iter().map(|row| values(device, row)).collect();
            for (number, name) in columns(device).iter().enumerate() {
                let of_name: Vec<f64> = values
                    .iter()
                    .map(|row| row.get(number).copied().unwrap_or(f64::NAN))
                    .collect();
                // What was never commanded, and errors that never were, say nothing.
                let is_blank = |value: &f64| value.is_nan() || *value == 0.0;
                let quiet = !name.ends_with("measured") && of_name.iter().all(is_blank);
                if is_shown(name) && !quiet {
                    let fields = of_name.iter().map(|value| format!("{:>12}", field(*value)));
                    let _ = writeln!(text, "{name:<16}{}", fields.collect::<String>());
                }
            }
        }
        text
    }
}

/// The last rows before each of the shown times, without repetition.
fn few(rows: &[Vec<u64>], end: i64) -> Vec<&Vec<u64>> {
    let mut numbers: Vec<usize> = SHOWN_NS
        .iter()
        .filter_map(|ago| rows.iter().rposition(|row| begin_ns(row) <= end - ago))
        .chain([0])
        .collect();
    numbers.sort_unstable();
    numbers.dedup();
    numbers.into_iter().map(|number| &rows[number]).collect()
}

fn begin_ns(row: &[u64]) -> i64 {
    row.get(1).copied().unwrap_or(0).cast_signed()
}

#[expect(clippy::cast_precision_loss, reason = "some seconds")]
fn seconds(ns: i64) -> String {
    format!("{:.6}", ns as f64 * 1e-9)
}

fn field(value: f64) -> String {
    if value.is_nan() {
        String::new()
    } else {
        format!("{value:.6}")
            .trim_end_matches('0')
            .trim_end_matches('.')
            .to_owned()
    }
}

/// Whether a column is in the short table.
fn is_shown(column: &str) -> bool {
    ["set-point", "measured", "error"]
        .iter()
        .any(|word| column.ends_with(word))
}

const PLANAR: [&str; 3] = ["x", "y", "turn"];

/// The names of the values of a row.
fn columns(device: &Device) -> Vec<String> {
    let mut names = vec!["cycle".to_owned(), "status".to_owned()];
    for joint in 0..device.place.joints {
        let of_joint = ["set-point", "commanded", "measured", "velocity", "error"];
        names.extend(of_joint.map(|name| format!("j{joint} {name}")));
    }
    let Interfaces {
        base, io, torques, ..
    } = &device.own;
    if base.is_some() {
        names.extend(PLANAR.map(|axis| format!("{axis} commanded")));
        names.extend(PLANAR.map(|axis| format!("{axis} measured")));
        names.extend(["x", "y", "heading"].map(str::to_owned));
        names.push("error".to_owned());
    }
    let count = torques.as_ref().map_or(0, |torques| torques.len());
    names.extend((0..count).map(|n| format!("j{n} torque")));
    if let Some(io) = io {
        names.extend((0..io.bool_in.len()).map(|n| format!("digin {n}")));
        names.extend((0..io.bool_out.len()).map(|n| format!("digout {n}")));
        names.extend((0..io.real_in.len()).map(|n| format!("anin {n}")));
        names.extend((0..io.real_out.len()).map(|n| format!("anout {n}")));
    }
    names
}

/// The values of a row; not a number where it is not known.
#[expect(clippy::cast_precision_loss, reason = "cycles and states")]
fn values(device: &Device, row: &[u64]) -> Vec<f64> {
    let word = |n: usize| row.get(n).copied().unwrap_or(0);
    let mut values = vec![word(0) as f64, word(2) as f64];
    let joints = device.place.joints * JOINT_WORDS;
    values.extend((HEAD..HEAD + joints).map(|n| f64::from_bits(word(n))));
    let signals = row.get(HEAD + joints..).unwrap_or_default();
    let Interfaces {
        base, io, torques, ..
    } = &device.own;
    let or_nan = |value: Option<f64>| value.unwrap_or(f64::NAN);
    if let Some(base) = base {
        for twist in [base.commanded, base.velocity] {
            let twist = twist.read(signals);
            values.extend(planar(twist));
        }
        let pose = base.pose.read(signals);
        let ahead = pose.map(|pose| pose.rotation * Vector::x());
        values.extend([
            or_nan(pose.map(|pose| pose.translation.x)),
            or_nan(pose.map(|pose| pose.translation.y)),
            or_nan(ahead.map(|ahead| ahead.y.atan2(ahead.x))),
            or_nan(base.error.read(signals).map(f64::from)),
        ]);
    }
    for torque in torques.iter().flat_map(|torques| torques.iter()) {
        values.push(or_nan(torque.measured.read(signals)));
    }
    if let Some(io) = io {
        let bit = |value: Option<bool>| or_nan(value.map(|on| f64::from(u8::from(on))));
        values.extend(io.bool_in.iter().map(|it| bit(it.read(signals))));
        values.extend(io.bool_out.iter().map(|it| bit(it.state.read(signals))));
        values.extend(io.real_in.iter().map(|it| or_nan(it.read(signals))));
        values.extend(io.real_out.iter().map(|it| or_nan(it.state.read(signals))));
    }
    values
}

fn planar(twist: Option<Twist>) -> [f64; 3] {
    twist.map_or([f64::NAN; 3], |it| [it.vel.x, it.vel.y, it.rot.z])
}

/// The last values before the last faults.
#[derive(Debug, Default)]
pub(super) struct Flights {
    devices: VecDeque<(String, Arc<LastValues>)>,
    nets: VecDeque<(NetId, Arc<LastValues>)>,
}

impl Flights {
    /// Keeps those before a device's fault.
    pub(super) fn keep_device(&mut self, device: &Arc<Device>) -> Arc<LastValues> {
        let kept = Arc::new(LastValues::of_devices(std::iter::once(Arc::clone(device))));
        self.devices.retain(|(name, _)| *name != device.name);
        self.devices
            .push_back((device.name.clone(), Arc::clone(&kept)));
        if self.devices.len() > KEPT {
            self.devices.pop_front();
        }
        kept
    }

    /// Keeps those before a net's failure.
    pub(super) fn keep_net(&mut self, net: NetId, values: LastValues) -> Arc<LastValues> {
        let kept = Arc::new(values);
        self.nets.push_back((net, Arc::clone(&kept)));
        if self.nets.len() > KEPT {
            self.nets.pop_front();
        }
        kept
    }

    pub(super) fn of_device(&self, device: &str) -> Option<Arc<LastValues>> {
        let found = self.devices.iter().find(|(name, _)| name == device);
        found.map(|(_, values)| Arc::clone(values))
    }

    pub(super) fn of_net(&self, net: NetId) -> Option<Arc<LastValues>> {
        let found = self.nets.iter().rev().find(|(id, _)| *id == net);
        found.map(|(_, values)| Arc::clone(values))
    }
}

//! The columns of the rings that net threads write, with their names and units.

use std::sync::Arc;

use takt_net::device::{Interfaces, Signal};
use takt_net::ports::{NULL, Port, components};
use takt_net::{Element, Value};

use super::{Column, Pick};
use crate::device::{Device, DeviceStatus};
use crate::executor::flight::{self, JOINT_WORDS, MACHINES_AT, STATES_MAX};
use crate::executor::machines::state_word;
use crate::executor::sampler;
use crate::ids::NetState;

const NULL_VALUE: f64 = f64::from_bits(NULL);

/// The columns of a device while they are collected.
struct Columns {
    device: String,
    /// First word of its signals in a row.
    signals: usize,
    all: Vec<Column>,
}

impl Columns {
    fn add(
        &mut self,
        name: &str,
        unit: &str,
        pick: impl Fn(&[u64]) -> f64 + Send + Sync + 'static,
    ) {
        self.all.push(Column {
            name: format!("{}.{name}", self.device),
            unit: unit.to_owned(),
            states: Arc::default(),
            pick: Arc::new(pick),
        });
    }

    /// A value that a driver reports, each of its numbers. `unit` is that of types that define none.
    fn signal<T: Value>(&mut self, name: &str, unit: &str, signal: Signal<T>) {
        let signals = self.signals;
        for (number, (suffix, dimension)) in components(T::ELEMENT).iter().enumerate() {
            let own = dimension.map(|it| it.to_string());
            let unit = own.unwrap_or_else(|| unit.to_owned());
            self.add(&format!("{name}{suffix}"), &unit, move |row| {
                let value = signal.read(row.get(signals..).unwrap_or_default());
                value.map_or(NULL_VALUE, |value| component(value, number))
            });
        }
    }
}

/// One number of a value.
#[expect(clippy::cast_precision_loss, reason = "times below 104 days are exact")]
fn component<T: Value>(value: T, number: usize) -> f64 {
    let mut found = 0;
    value.put(|at, word| {
        if at == number {
            found = word;
        }
    });
    match T::ELEMENT {
        Element::Bool => f64::from(u8::from(found != 0)),
        Element::Int => f64::from(i32::take(|_| found)),
        Element::Nanos => found.cast_signed() as f64 * 1e-9,
        Element::Double
        | Element::Vector
        | Element::Rotation
        | Element::Frame
        | Element::Twist
        | Element::Wrench => f64::from_bits(found),
    }
}

fn word(row: &[u64], at: usize) -> u64 {
    row.get(at).copied().unwrap_or(NULL)
}

fn float(row: &[u64], at: usize) -> f64 {
    f64::from_bits(word(row, at))
}

#[expect(clippy::cast_precision_loss, reason = "counters below 2^53 are exact")]
fn count(row: &[u64], at: usize) -> f64 {
    word(row, at) as f64
}

#[expect(clippy::cast_precision_loss, reason = "spans below 104 days are exact")]
fn span(row: &[u64], at: usize) -> f64 {
    word(row, at).cast_signed() as f64 * 1e-9
}

/// The columns of a device's ring.
pub(crate) fn device_columns(device: &Device) -> Vec<Column> {
    let joints = flight::HEAD..flight::HEAD + device.place.joints * JOINT_WORDS;
    let mut columns = Columns {
        device: device.name.clone(),
        signals: joints.end,
        all: Vec::new(),
    };
    for (number, first) in joints.step_by(JOINT_WORDS).enumerate() {
        let of_joint = [
            ("set_point", "rad"),
            ("commanded", "rad"),
            ("measured", "rad"),
            ("velocity", "rad/s"),
            ("error", ""),
        ];
        for (at, (name, unit)) in (first..).zip(of_joint) {
            let name = format!("joint.{number}.{name}");
            columns.add(&name, unit, move |row| float(row, at));
        }
        let name = format!("joint.{number}.following_error");
        columns.add(&name, "rad", move |row| {
            let (commanded, measured) = (float(row, first + 1), float(row, first + 2));
            if commanded.is_nan() || measured.is_nan() {
                NULL_VALUE
            } else {
                commanded - measured
            }
        });
    }
    columns.interfaces(&device.own);
    columns.add("status", "", |row| count(row, 2));
    if let Some(status) = columns.all.last_mut() {
        let all = [
            DeviceStatus::Offline,
            DeviceStatus::SafeOperational,
            DeviceStatus::Operational,
        ];
        status.states = all.map(|status| status.word().to_owned()).into();
    }
    columns.add("faults", "", |row| count(row, 3));
    columns.add("cycle", "", |row| count(row, 0));
    columns.add("cycle_age", "s", |row| {
        let age = word(row, 1).wrapping_sub(word(row, 4));
        if word(row, 4) == 0 {
            NULL_VALUE
        } else {
            span(&[age], 0)
        }
    });
    columns.all
}

impl Columns {
    fn interfaces(&mut self, has: &Interfaces) {
        for (n, torque) in has.torques.iter().flat_map(|it| it.iter()).enumerate() {
            self.signal(&format!("joint.{n}.torque"), "Nm", torque.measured);
            self.signal(
                &format!("joint.{n}.external_torque"),
                "Nm",
                torque.estimated,
            );
        }
        if let Some(base) = &has.base {
            self.signal("base.commanded", "", base.commanded);
            self.signal("base.velocity", "", base.velocity);
            self.signal("base.pose", "", base.pose);
            self.signal("base.error", "", base.error);
            for (n, wheel) in base.wheels.iter().enumerate() {
                self.signal(&format!("wheel.{n}.position"), "rad", wheel.position);
                self.signal(&format!("wheel.{n}.velocity"), "rad/s", wheel.velocity);
            }
        }
        if let Some(tool) = &has.cartesian {
            self.signal("cartesian.commanded", "", tool.commanded_position);
            self.signal("cartesian.commanded_velocity", "", tool.commanded_velocity);
            self.signal("cartesian.measured", "", tool.measured_position);
            self.signal("cartesian.measured_velocity", "", tool.measured_velocity);
            self.signal("cartesian.error", "", tool.error);
        }
        if let Some(wrench) = has.wrench {
            self.signal("force", "", wrench);
        }
        if let Some(io) = &has.io {
            for (n, input) in io.bool_in.iter().enumerate() {
                self.signal(&format!("digin.{n}"), "", *input);
            }
            for (n, output) in io.bool_out.iter().enumerate() {
                self.signal(&format!("digout.{n}"), "", output.state);
            }
            for (n, input) in io.real_in.iter().enumerate() {
                self.signal(&format!("anin.{n}"), "", *input);
            }
            for (n, output) in io.real_out.iter().enumerate() {
                self.signal(&format!("anout.{n}"), "", output.state);
            }
        }
        if let Some(gripper) = &has.gripper {
            self.signal("gripper.distance", "m", gripper.distance);
        }
        if let Some(gripper) = &has.servo_gripper {
            self.signal("gripper.ready", "", gripper.ready);
            self.signal("gripper.width", "m", gripper.width);
            self.signal("gripper.speed", "m/s", gripper.speed);
            self.signal("gripper.force", "N", gripper.force);
            self.signal("gripper.grasping", "", gripper.grasping);
        }
        if let Some(homing) = &has.homing {
            self.signal("homing.homed", "", homing.homed);
            self.signal("homing.active", "", homing.homing);
            self.signal("homing.step", "", homing.step);
            self.signal("homing.failure", "", homing.failure);
        }
        for (n, flags) in has.drives.iter().flat_map(|it| it.iter()).enumerate() {
            self.signal(&format!("drive.{n}.flags"), "", *flags);
        }
        for figure in has.figures.iter() {
            self.signal(&figure.name, &figure.unit, figure.place);
            if let Some(column) = self.all.last_mut() {
                column.states = Arc::clone(&figure.states);
            }
        }
    }
}

/// The columns of a thread's ring.
pub(crate) fn thread_columns(thread: &str) -> Vec<Column> {
    let column = |name: &str, unit: &str, pick: Pick| Column {
        name: format!("thread:{thread}.{name}"),
        unit: unit.to_owned(),
        states: Arc::default(),
        pick,
    };
    vec![
        column("latency", "s", Arc::new(|row| span(row, 2))),
        column("execution", "s", Arc::new(|row| span(row, 3))),
        column(
            "phase_error",
            "s",
            Arc::new(|row| match word(row, 4) {
                flight::UNKNOWN => NULL_VALUE,
                _ => span(row, 4),
            }),
        ),
        column("missed", "", Arc::new(|row| count(row, 5))),
        column("cycle", "", Arc::new(|row| count(row, 0))),
    ]
}

/// The state of a machine, or of the one of that number inside, in its thread's ring: of these names, null while it is
/// inactive.
pub(crate) fn machine_column(
    name: &str,
    (id, number): (u32, usize),
    states: Arc<[String]>,
) -> Column {
    let own = state_word(id, number) >> 16;
    Column {
        name: format!("machine:{name}.state"),
        unit: String::new(),
        states,
        pick: Arc::new(move |row| {
            let words = row.iter().skip(MACHINES_AT).take(STATES_MAX);
            let mut states = words.filter(|word| **word >> 16 == own);
            let state = states.next().map_or(0, |word| word & u64::from(u16::MAX));
            match state.checked_sub(1) {
                Some(state) => count(&[state], 0),
                None => NULL_VALUE,
            }
        }),
    }
}

/// The state of a net in the rows of a sampler.
pub(crate) fn net_state_column(net: &str) -> Column {
    Column {
        name: format!("net:{net}.state"),
        unit: String::new(),
        states: NetState::ALL.map(|state| state.word().to_owned()).into(),
        pick: Arc::new(|row| count(row, 1)),
    }
}

/// The numbers of a port in the rows of a sampler, whose first word is number `at` of its ports.
pub(crate) fn port_columns(net: &str, port: &Port, at: usize) -> Vec<Column> {
    let column = |(number, part): (usize, takt_net::ports::PortPart)| {
        let at = sampler::HEAD + at + number;
        Column {
            name: format!("net:{net}/{}{}", port.name, part.suffix),
            unit: part.unit,
            states: Arc::default(),
            pick: Arc::new(move |row: &[u64]| float(row, at)),
        }
    };
    port.parts().enumerate().map(column).collect()
}

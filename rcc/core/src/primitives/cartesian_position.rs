//! `CartesianPosition::*`: devices commanded by the pose of their tool or of themselves.

use std::sync::Arc;

use takt_net::definition::port;
use takt_net::device::CartesianPosition as Device;
use takt_net::set_points::SetPointCounters;
use takt_net::{Build, Cycle, Definition, Fault, Frame, In, NullRule, Out, Primitive, Twist};

use super::{count, error, first_error};

const ROBOT: &str = "name of the device";
const ERROR: &str = "0 none, 1 offline, 2 not enabled or no number, 3 set-points refused by the \
                     driver, -1 concurrent access";

fn device(b: &mut Build<'_, '_>) -> Result<Device, Fault> {
    b.interface("Robot", "device with a Cartesian position", |has| {
        has.cartesian.clone()
    })
}

struct Position {
    position: In<Frame>,
    device: Device,
    counters: Arc<SetPointCounters>,
    error: Out<i32>,
    concurrent: Out<bool>,
    failed: Out<bool>,
    illegal: Out<bool>,
}

/// Whether all parts of a frame are numbers.
fn is_finite(frame: &Frame) -> bool {
    let position = frame.translation.vector.iter();
    position
        .chain(frame.rotation.coords.iter())
        .all(|v| v.is_finite())
}

impl Primitive for Position {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let position = self.position.get(cycle);
        let concurrent = self.device.command.is_taken(cycle);
        let failed = self.device.error.get(cycle.image).unwrap_or(1);
        let invalid = position.is_some_and(|position| !is_finite(&position));
        let illegal = if invalid { error::INVALID } else { 0 };
        let error = first_error(concurrent, failed, illegal);
        if let (0, Some(position)) = (error, position) {
            self.device.command.give(cycle, position);
        }
        let reported = position.map(|_| f64::NAN);
        count(&self.counters, reported, concurrent, failed, illegal);
        self.error.set(cycle, error);
        self.concurrent.set(cycle, concurrent);
        self.failed.set(cycle, !concurrent && failed != 0);
        self.illegal.set(cycle, illegal != 0);
    }
}

fn position(b: &mut Build<'_, '_>) -> Result<Position, Fault> {
    let device = device(b)?;
    let robot = b.text("Robot").to_owned();
    b.claim(&robot, format!("{robot}_CartesianPosition"));
    // A base cannot be commanded by pose and velocity at once.
    let interfaces = b.devices().interfaces(&robot);
    if interfaces.is_some_and(|has| has.base.is_some()) {
        b.claim(&robot, format!("{robot}_Base"));
    }
    b.commands(device.command.target());
    let range = [f64::NEG_INFINITY, f64::INFINITY];
    let counters = b.set_points(&robot, "pose".to_owned(), "m", range);
    Ok(Position {
        position: b.input("inPosition")?,
        device,
        counters,
        error: b.output("outError"),
        concurrent: b.output("outErrorConcurrentAccess"),
        failed: b.output("outErrorDeviceFailed"),
        illegal: b.output("outErrorIllegalPosition"),
    })
}

struct Monitor {
    device: Device,
    commanded_position: Out<Frame>,
    commanded_velocity: Out<Twist>,
    measured_position: Out<Frame>,
    measured_velocity: Out<Twist>,
    error: Out<i32>,
}

impl Primitive for Monitor {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let (image, device) = (cycle.image, &self.device);
        self.commanded_position
            .set(cycle, device.commanded_position.get(image));
        self.commanded_velocity
            .set(cycle, device.commanded_velocity.get(image));
        self.measured_position
            .set(cycle, device.measured_position.get(image));
        self.measured_velocity
            .set(cycle, device.measured_velocity.get(image));
        self.error.set(cycle, device.error.get(image).unwrap_or(1));
    }
}

fn monitor(b: &mut Build<'_, '_>) -> Result<Monitor, Fault> {
    Ok(Monitor {
        device: device(b)?,
        commanded_position: b.output("outCommandedPosition"),
        commanded_velocity: b.output("outCommandedVelocity"),
        measured_position: b.output("outMeasuredPosition"),
        measured_velocity: b.output("outMeasuredVelocity"),
        error: b.output("outError"),
    })
}

pub(super) fn table() -> Vec<Definition> {
    vec![
        Definition::new(
            "CartesianPosition::CartesianPosition",
            "Commands where a device is to be. On any error nothing is commanded in this cycle, and \
             the driver stops the device.",
            position,
        )
        .input::<Frame>(port("inPosition", "position, m").required())
        .text("Robot", ROBOT)
        .output::<i32>("outError", ERROR)
        .output::<bool>(
            "outErrorConcurrentAccess",
            "another primitive commands the device",
        )
        .output::<bool>(
            "outErrorDeviceFailed",
            "the device does not follow commands",
        )
        .output::<bool>("outErrorIllegalPosition", "the position is no number")
        .null(NullRule::Own(
            "A null position commands nothing and is no error.",
        )),
        Definition::new(
            "CartesianPosition::CartesianMonitor",
            "Where a device was commanded and is, as its driver last reported.",
            monitor,
        )
        .text("Robot", ROBOT)
        .output::<Frame>("outCommandedPosition", "commanded position, m")
        .output::<Twist>("outCommandedVelocity", "commanded velocity, m/s and rad/s")
        .output::<Frame>("outMeasuredPosition", "measured position, m")
        .output::<Twist>("outMeasuredVelocity", "measured velocity, m/s and rad/s")
        .output::<i32>("outError", ERROR)
        .null(NullRule::Own(
            "Null while the driver does not know the value; an unknown error is 1.",
        )),
    ]
}

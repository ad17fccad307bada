//! `RobotArm::*`: joints of any robot arm.

use takt_net::definition::port;
use takt_net::device::{JointCommand, JointLimits, JointState};
use takt_net::{ArmBinding, Build, Cycle, Definition, Fault, In, NullRule, Out, Primitive};

/// Values of `outError` beside those of `takt_net::device::JointError`.
mod error {
    /// Another primitive of the net commands the joint in this cycle.
    pub(super) const CONCURRENT: i32 = -1;
    /// The position is outside the joint's range.
    pub(super) const RANGE: i32 = 1;
    /// The position is not a number.
    pub(super) const INVALID: i32 = 2;
}

struct JointPosition {
    position: In<f64>,
    joint: usize,
    limits: JointLimits,
    error: Out<i32>,
    concurrent: Out<bool>,
    failed: Out<bool>,
    illegal: Out<bool>,
}

impl JointPosition {
    fn check(&self, position: f64) -> i32 {
        if position.is_nan() {
            error::INVALID
        } else if position < self.limits.position_min || position > self.limits.position_max {
            error::RANGE
        } else {
            0
        }
    }
}

impl Primitive for JointPosition {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let joint = &cycle.image.joints[self.joint];
        let position = self.position.get(cycle);
        let concurrent = joint.command.get().cycle == cycle.moment.cycle;
        let failed = joint.state.get().error;
        let illegal = position.map_or(0, |p| self.check(p));
        let error = match (concurrent, failed) {
            (true, _) => error::CONCURRENT,
            (false, 0) => illegal,
            (false, failed) => failed,
        };
        if let (0, Some(position)) = (error, position) {
            joint.command.set(JointCommand {
                cycle: cycle.moment.cycle,
                every: cycle.moment.every.max(1),
                position,
            });
        }
        self.error.set(cycle, error);
        self.concurrent.set(cycle, concurrent);
        self.failed.set(cycle, !concurrent && failed != 0);
        self.illegal.set(cycle, illegal != 0);
    }
}

/// The joint that parameters `Robot` and `Axis` name.
fn joint(b: &mut Build<'_, '_>) -> Result<(ArmBinding, usize), Fault> {
    let arm = b.arm("Robot")?;
    let axis = b.number("Axis", 0..=arm.limits.len() - 1)?;
    Ok((arm, axis))
}

fn joint_position(b: &mut Build<'_, '_>) -> Result<JointPosition, Fault> {
    let (arm, axis) = joint(b)?;
    let robot = b.text("Robot").to_owned();
    b.claim(&robot, format!("{robot}_Joint_{axis}"));
    b.claim(&robot, format!("{robot}_ToolParam_{axis}"));
    Ok(JointPosition {
        position: b.input("inPosition")?,
        joint: arm.first_joint + axis,
        limits: arm.limits[axis],
        error: b.output("outError"),
        concurrent: b.output("outErrorConcurrentAccess"),
        failed: b.output("outErrorJointFailed"),
        illegal: b.output("outErrorIllegalPosition"),
    })
}

/// Picks one value of a joint's state.
type Pick = fn(&JointState) -> Option<f64>;

struct JointMonitor {
    joint: usize,
    values: [(Out<f64>, Pick); 6],
    error: Out<i32>,
}

impl Primitive for JointMonitor {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let state = cycle.image.joints[self.joint].state.get();
        for (out, value) in &self.values {
            out.set(cycle, value(&state));
        }
        self.error.set(cycle, state.error);
    }
}

fn joint_monitor(b: &mut Build<'_, '_>) -> Result<JointMonitor, Fault> {
    let (arm, axis) = joint(b)?;
    Ok(JointMonitor {
        joint: arm.first_joint + axis,
        values: [
            (b.output("outCommandedPosition"), |s| s.commanded_position),
            (b.output("outCommandedVelocity"), |s| s.commanded_velocity),
            (b.output("outCommandedAcceleration"), |s| {
                s.commanded_acceleration
            }),
            (b.output("outMeasuredPosition"), |s| s.measured_position),
            (b.output("outMeasuredVelocity"), |s| s.measured_velocity),
            (b.output("outMeasuredAcceleration"), |s| {
                s.measured_acceleration
            }),
        ],
        error: b.output("outError"),
    })
}

const ROBOT: &str = "name of the robot arm";
const AXIS: &str = "which joint, from 0";
const ERROR: &str = "0 none, 1 offline or out of range, 2 not enabled or no number, 3 set-points \
                     refused by the driver, -1 concurrent access";

pub(super) fn table() -> Vec<Definition> {
    vec![
        Definition::new(
            "RobotArm::JointPosition",
            "Commands a joint's position. On any error nothing is commanded in this cycle, and \
             the driver brakes the joint.",
            joint_position,
        )
        .active()
        .input::<f64>(port("inPosition", "position, rad"))
        .text("Robot", ROBOT)
        .parameter::<i32>("Axis", "0", AXIS)
        .output::<i32>("outError", ERROR)
        .output::<bool>(
            "outErrorConcurrentAccess",
            "another primitive commands the joint",
        )
        .output::<bool>("outErrorJointFailed", "the joint does not follow commands")
        .output::<bool>(
            "outErrorIllegalPosition",
            "the position is out of range or no number",
        )
        .null(NullRule::Own(
            "A null position commands nothing and is no error.",
        )),
        Definition::new(
            "RobotArm::JointMonitor",
            "What a joint was commanded and does, as its driver last told.",
            joint_monitor,
        )
        .text("Robot", ROBOT)
        .parameter::<i32>("Axis", "0", AXIS)
        .output::<f64>("outCommandedPosition", "rad")
        .output::<f64>("outCommandedVelocity", "rad/s")
        .output::<f64>("outCommandedAcceleration", "rad/s²")
        .output::<f64>("outMeasuredPosition", "rad")
        .output::<f64>("outMeasuredVelocity", "rad/s")
        .output::<f64>("outMeasuredAcceleration", "rad/s²")
        .output::<i32>("outError", ERROR)
        .null(NullRule::Own(
            "Null while the driver does not know the value.",
        )),
    ]
}

//! `RobotArm::*`: joints of any robot arm.

use std::sync::Arc;

use takt_net::definition::port;
use takt_net::device::{Commanded, JointCommand, JointLimits, JointState, Order, Target, Tool};
use takt_net::set_points::SetPointCounters;
use takt_net::{
    ArmBinding, Build, Cycle, Definition, Fault, Frame, In, NullRule, Out, Primitive, Vector,
};

use super::order::Standing;
use super::{count, error, first_error};

struct JointPosition {
    position: In<f64>,
    joint: usize,
    limits: JointLimits,
    /// Period of the net, s.
    period_s: f64,
    counters: Arc<SetPointCounters>,
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
        let error = first_error(concurrent, failed, illegal);
        if let (0, Some(position)) = (error, position) {
            let command = JointCommand {
                cycle: cycle.moment.cycle,
                every: cycle.moment.every.max(1),
                position,
                net: Some(cycle.moment.net),
            };
            joint.command.set(command);
            let state = joint.state.get();
            let reported = [state.commanded_velocity, state.commanded_acceleration];
            let first = Commanded::first(command.cycle, command.every, position, reported);
            joint
                .trail
                .set(joint.trail.get().with(first, self.period_s));
        }
        count(&self.counters, position, concurrent, failed, illegal);
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
    b.commands(Target::Joint(arm.first_joint + axis));
    let limits = arm.limits[axis];
    b.expects("inPosition", limits.position_min..=limits.position_max);
    let range = [limits.position_min, limits.position_max];
    let counters = b.set_points(&robot, format!("joint {axis}"), "rad", range);
    Ok(JointPosition {
        position: b.input("inPosition")?,
        joint: arm.first_joint + axis,
        limits,
        period_s: b.period_s(),
        counters,
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
    limits: JointLimits,
    values: [(Out<f64>, Pick); 6],
    error: Out<i32>,
}

impl Primitive for JointMonitor {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let joint = &cycle.image.joints[self.joint];
        let mut state = joint.state.get();
        let trail = joint.trail.get();
        let (now, every) = (cycle.moment.cycle, cycle.moment.every.max(1));
        let limits = &self.limits;
        // In a cycle that the thread skipped, no net could command.
        let last = trail
            .before(now, every + cycle.image.skipped(now))
            .filter(|motion| motion.keeps(limits.velocity_max, limits.acceleration_max));
        // A joint that follows its set-points goes on from the last one, not from where its driver, which plays them with
        // a delay, has come with them. Steps are smoothed by the driver: there, what it reports counts.
        if let (0, Some(motion)) = (state.error, last) {
            state.commanded_position = Some(motion.position);
            state.commanded_velocity = Some(motion.velocity);
            state.commanded_acceleration = Some(motion.acceleration);
        }
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
        limits: arm.limits[axis],
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

/// Sets an arm's load, once per change.
pub(super) struct SetTool<C> {
    pub(super) mass: In<f64>,
    pub(super) com: In<C>,
    pub(super) moi: In<Vector>,
    pub(super) tcp: In<Frame>,
    tool: Standing<Tool>,
    completed: Out<bool>,
    error: Out<i32>,
}

/// Centre of mass: a position, or a frame with the axes of inertia.
pub(super) trait CentreOfMass: takt_net::Value {
    fn frame(self) -> Frame;
}

impl CentreOfMass for Vector {
    fn frame(self) -> Frame {
        Frame::from_parts(self.into(), takt_net::Rotation::identity())
    }
}

impl CentreOfMass for Frame {
    fn frame(self) -> Frame {
        self
    }
}

impl<C: CentreOfMass> SetTool<C> {
    /// The tool, unless a part of it is null.
    fn tool(&self, cycle: &Cycle<'_>) -> Option<Tool> {
        Some(Tool {
            mass: self.mass.get(cycle)?,
            com: self.com.get(cycle)?.frame(),
            moi: self.moi.get(cycle)?,
            tcp: self.tcp.get(cycle)?,
        })
    }
}

impl<C: CentreOfMass> Primitive for SetTool<C> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let Some(tool) = self.tool(cycle) else {
            self.completed.set(cycle, None);
            self.error.set(cycle, None);
            return;
        };
        if let error @ 1.. = check_tool(&tool) {
            self.completed.set(cycle, false);
            self.error.set(cycle, error);
            return;
        }
        let outcome = self.tool.give(cycle, tool);
        self.completed.set(cycle, outcome.is_done());
        self.error.set(cycle, outcome.error);
    }
}

fn check_tool(tool: &Tool) -> i32 {
    let frames = [&tool.com, &tool.tcp];
    let lengths = frames.iter().flat_map(|f| f.translation.vector.iter());
    let turns = frames.iter().flat_map(|f| f.rotation.coords.iter());
    let mut all = lengths.chain(turns).chain(tool.moi.iter());
    if !tool.mass.is_finite() || !all.all(|v| v.is_finite()) {
        error::INVALID
    } else if tool.mass < 0.0 || tool.moi.min() < 0.0 {
        error::RANGE
    } else {
        0
    }
}

/// Builds the primitive that sets the tool behind the last joint of the arm of that parameter.
pub(super) fn set_tool<C: CentreOfMass + takt_net::value::text::TextValue>(
    b: &mut Build<'_, '_>,
    robot: &'static str,
    tcp: In<Frame>,
) -> Result<SetTool<C>, Fault> {
    let order: Order<Tool> =
        b.interface(robot, "robot arm with a configurable tool", |has| has.tool)?;
    let joints = b.arm(robot)?.limits.len();
    let name = b.text(robot).to_owned();
    b.hold(format!("{name}_ToolParam_{}", joints.saturating_sub(1)));
    b.commands(order.command.target());
    Ok(SetTool {
        mass: b.input("inMass")?,
        com: b.input("inCOM")?,
        moi: b.input("inMOI")?,
        tcp,
        tool: Standing::new(order),
        completed: b.output("outCompleted"),
        error: b.output("outError"),
    })
}

fn tool_parameters(b: &mut Build<'_, '_>) -> Result<SetTool<Vector>, Fault> {
    let (arm, axis) = joint(b)?;
    let last = arm.limits.len() - 1;
    if axis != last {
        let why = format!("axis {axis} carries the next one; a tool is set for axis {last}");
        return Err(b.parameter_fault("Axis", why));
    }
    let flange = b.constant(Frame::identity());
    set_tool(b, "Robot", flange)
}

const ROBOT: &str = "name of the robot arm";
const AXIS: &str = "which joint, from 0";
const ERROR: &str = "0 none, 1 offline or out of range, 2 not enabled or no number, 3 set-points \
                     refused by the driver, -1 concurrent access";

pub(super) const TOOL_ERROR: &str = "0 none, 1 no such tool, 2 no number, no contact or drives without power, 3 the arm moves or is not where it \
     is commanded, 4 the robot's program cannot take it, 5 it did not, -1 concurrent access";

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
            "What a joint was commanded and does. Commanded is the set-point of a net in the cycle before, if there was \
             one, else what the driver last reported.",
            joint_monitor,
        )
        .text("Robot", ROBOT)
        .parameter::<i32>("Axis", "0", AXIS)
        .output::<f64>("outCommandedPosition", "commanded position, rad")
        .output::<f64>("outCommandedVelocity", "commanded velocity, rad/s")
        .output::<f64>(
            "outCommandedAcceleration",
            "commanded acceleration, rad/s²; 0 while the driver brakes the joint or leads it to its set-points",
        )
        .output::<f64>("outMeasuredPosition", "measured position, rad")
        .output::<f64>("outMeasuredVelocity", "measured velocity, rad/s")
        .output::<f64>("outMeasuredAcceleration", "measured acceleration, rad/s²")
        .output::<i32>("outError", ERROR)
        .null(NullRule::Own(
            "Null while the driver does not know the value.",
        )),
        Definition::new(
            "RobotArm::ToolParameters",
            "Sets the load of an arm's last joint, again after each change.",
            tool_parameters,
        )
        .active()
        .input::<f64>(port("inMass", "mass, kg").or("Mass", "0"))
        .input::<Vector>(
            port("inCOM", "centre of mass in the flange, m").or("COM", "{x:0,y:0,z:0}"),
        )
        .input::<Vector>(
            port(
                "inMOI",
                "moments of inertia about axes along those of the flange, kg m²",
            )
            .or("MOI", "{x:0,y:0,z:0}"),
        )
        .text("Robot", ROBOT)
        .parameter::<i32>("Axis", "0", "which joint, from 0; it must be the last")
        .output::<bool>("outCompleted", "the arm has accepted it")
        .output::<i32>("outError", TOOL_ERROR)
        .null(NullRule::Own(
            "While an input is null nothing is set, and the outputs are null.",
        )),
    ]
}

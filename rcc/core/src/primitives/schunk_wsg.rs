//! `schunkwsg::*`: commands to a gripper that executes them by itself, one after the other, and its values. A command is
//! given once, when its primitive becomes active, and again after a reset. The gripper's protocol is its driver's.

use takt_net::device::{GripperCommand, Order, ServoGripper, Signal};
use takt_net::{Build, Cycle, Definition, Fault, In, NullRule, Out, Primitive};

/// Numbers of commands, as in the gripper's protocol.
mod command {
    pub(super) const HOMING: i32 = 0x20;
    pub(super) const PREPOSITION: i32 = 0x21;
    pub(super) const STOP: i32 = 0x22;
    pub(super) const GRASP: i32 = 0x25;
    pub(super) const RELEASE: i32 = 0x26;
    pub(super) const SET_ACCELERATION: i32 = 0x30;
    pub(super) const SET_FORCE_LIMIT: i32 = 0x32;
    pub(super) const SET_SOFT_LIMITS: i32 = 0x34;
    pub(super) const CLEAR_SOFT_LIMITS: i32 = 0x36;
}

/// Status codes; those below 31 are the gripper's own.
mod status {
    /// Another command took its place.
    pub(super) const ABORTED: i32 = 19;
    /// The gripper does not execute commands.
    pub(super) const NOT_OPERATIONAL: i32 = 31;
    /// A command is being executed.
    pub(super) const CONCURRENT: i32 = 32;
}

const DEVICE: &str = "name of the gripper";
const STATUS: &str = "0 success, 19 another command took its place, 31 the gripper is not operational, 32 it executes \
                      another command, others as in the gripper's manual; null until it is finished";
const UNKNOWN: NullRule = NullRule::Own("Null while the driver does not know the value.");
const PENDING: NullRule = NullRule::Own("The status is null until the command is finished.");

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Progress {
    /// Not given yet.
    New,
    /// Given in this cycle.
    Given(u64),
    /// Finished with this status.
    Finished(i32),
}

struct Action {
    command: GripperCommand,
    reset: In<bool>,
    ready: Signal<bool>,
    order: Order<GripperCommand>,
    progress: Progress,
    finished: Out<bool>,
    status: Option<Out<i32>>,
}

impl Action {
    fn begin(&self, cycle: &Cycle<'_>) -> Progress {
        let is_ready = self.ready.get(cycle.image) == Some(true);
        let may_interrupt = self.command.id == command::STOP;
        if !is_ready {
            Progress::Finished(status::NOT_OPERATIONAL)
        } else if self.order.command.is_taken(cycle) && !may_interrupt {
            Progress::Finished(status::CONCURRENT)
        } else {
            self.order.command.give(cycle, self.command);
            Progress::Given(cycle.moment.cycle)
        }
    }

    fn proceed(&self, cycle: &Cycle<'_>, given: u64) -> Progress {
        let answer = self.order.answer.get(cycle.image);
        match answer.filter(|answer| answer.order >= given) {
            Some(answer) if answer.order == given => Progress::Finished(answer.error),
            Some(_) => Progress::Finished(status::ABORTED),
            None => {
                self.order.command.hold(cycle);
                Progress::Given(given)
            }
        }
    }
}

impl Primitive for Action {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.progress = Progress::New;
        }
        self.progress = match self.progress {
            Progress::New => self.begin(cycle),
            Progress::Given(given) => self.proceed(cycle, given),
            Progress::Finished(status) => Progress::Finished(status),
        };
        let status = match self.progress {
            Progress::Finished(status) => Some(status),
            Progress::New | Progress::Given(_) => None,
        };
        self.finished.set(cycle, Some(status.is_some()));
        if let Some(out) = &self.status {
            out.set(cycle, status);
        }
    }
}

fn device(b: &mut Build<'_, '_>) -> Result<ServoGripper, Fault> {
    b.interface("Device", "gripper with commands of its own", |has| {
        has.servo_gripper
    })
}

/// A parameter that is a finite number from 0, or any finite number.
fn number(b: &Build<'_, '_>, name: &'static str, may_be_negative: bool) -> Result<f64, Fault> {
    let value: f64 = b.value(name)?;
    if value.is_finite() && (may_be_negative || value >= 0.0) {
        return Ok(value);
    }
    let wanted = if may_be_negative {
        "a finite number"
    } else {
        "a finite number from 0"
    };
    Err(b.parameter_fault(name, format!("{value} is not {wanted}")))
}

fn action(
    b: &mut Build<'_, '_>,
    command: GripperCommand,
    has_status: bool,
) -> Result<Action, Fault> {
    let device = device(b)?;
    let name = b.text("Device").to_owned();
    b.claim(&name, format!("{name}_Gripper"));
    b.commands(device.order.command.target());
    Ok(Action {
        command,
        reset: b.input("inReset")?,
        ready: device.ready,
        order: device.order,
        progress: Progress::New,
        finished: b.output("outFinished"),
        status: has_status.then(|| b.output("outStatusCode")),
    })
}

/// The command of a type, from its parameters.
type Command = fn(&Build<'_, '_>) -> Result<GripperCommand, Fault>;

const fn plain(id: i32) -> GripperCommand {
    GripperCommand {
        id,
        first: 0.0,
        second: 0.0,
        options: 0,
    }
}

fn homing(b: &Build<'_, '_>) -> Result<GripperCommand, Fault> {
    let opens: bool = b.value("Direction")?;
    let options = if opens { 1 } else { 2 };
    Ok(GripperCommand {
        options,
        ..plain(command::HOMING)
    })
}

fn prepositioning(b: &Build<'_, '_>) -> Result<GripperCommand, Fault> {
    let relative: bool = b.value("RelativeMotion")?;
    let stop_on_block: bool = b.value("StopOnBlock")?;
    Ok(GripperCommand {
        first: number(b, "Width", relative)?,
        second: number(b, "Speed", false)?,
        options: i32::from(relative) | i32::from(stop_on_block) << 1,
        ..plain(command::PREPOSITION)
    })
}

fn grasping(b: &Build<'_, '_>) -> Result<GripperCommand, Fault> {
    Ok(GripperCommand {
        first: number(b, "Width", false)?,
        second: number(b, "Speed", false)?,
        ..plain(command::GRASP)
    })
}

fn releasing(b: &Build<'_, '_>) -> Result<GripperCommand, Fault> {
    Ok(GripperCommand {
        first: number(b, "OpenWidth", false)?,
        second: number(b, "Speed", false)?,
        ..plain(command::RELEASE)
    })
}

fn set_acceleration(b: &Build<'_, '_>) -> Result<GripperCommand, Fault> {
    Ok(GripperCommand {
        first: number(b, "Acceleration", false)?,
        ..plain(command::SET_ACCELERATION)
    })
}

fn set_force_limit(b: &Build<'_, '_>) -> Result<GripperCommand, Fault> {
    Ok(GripperCommand {
        first: number(b, "Force", false)?,
        ..plain(command::SET_FORCE_LIMIT)
    })
}

fn set_soft_limits(b: &Build<'_, '_>) -> Result<GripperCommand, Fault> {
    Ok(GripperCommand {
        first: number(b, "Inner", false)?,
        second: number(b, "Outer", false)?,
        ..plain(command::SET_SOFT_LIMITS)
    })
}

fn definition(name: &str, doc: &'static str, command: Command) -> Definition {
    let build = move |b: &mut Build<'_, '_>| {
        let command = command(b)?;
        action(b, command, true)
    };
    Definition::new(format!("schunkwsg::{name}"), doc, build)
        .stateful()
        .text("Device", DEVICE)
        .output::<bool>(
            "outFinished",
            "the command is finished, with or without success",
        )
        .output::<i32>("outStatusCode", STATUS)
        .null(PENDING)
}

struct Monitor {
    device: ServoGripper,
    width: Out<f64>,
    speed: Out<f64>,
    force: Out<f64>,
    grasping: Out<f64>,
}

impl Primitive for Monitor {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let (device, image) = (&self.device, cycle.image);
        self.width.set(cycle, device.width.get(image));
        self.speed.set(cycle, device.speed.get(image));
        self.force.set(cycle, device.force.get(image));
        let grasping = device.grasping.get(image);
        self.grasping.set(cycle, grasping.map(f64::from));
    }
}

fn monitor(b: &mut Build<'_, '_>) -> Result<Monitor, Fault> {
    Ok(Monitor {
        device: device(b)?,
        width: b.output("outOpeningWidth"),
        speed: b.output("outSpeed"),
        force: b.output("outForce"),
        grasping: b.output("outGraspingState"),
    })
}

/// Commands that move the fingers.
fn motions() -> Vec<Definition> {
    let speed =
        |d: Definition| d.parameter::<f64>("Speed", "0", "relative speed of the fingers, m/s");
    vec![
        definition(
            "Homing",
            "Finds an end stop, from which the gripper counts; needed before other motions.",
            homing,
        )
        .parameter::<bool>(
            "Direction",
            "true",
            "true towards open, false towards closed",
        ),
        speed(
            definition(
                "Prepositioning",
                "Moves the fingers to a width without a part.",
                prepositioning,
            )
            .parameter::<f64>("Width", "0", "width, or its change, m"),
        )
        .parameter::<bool>("RelativeMotion", "true", "the width is a change")
        .parameter::<bool>(
            "StopOnBlock",
            "false",
            "stops where the fingers are blocked, instead of pressing with the force limit",
        ),
        speed(
            definition(
                "Grasping",
                "Closes the fingers on a part of a width; fails if there is none.",
                grasping,
            )
            .parameter::<f64>("Width", "0", "expected width of the part, m"),
        ),
        speed(
            definition(
                "Releasing",
                "Opens the fingers and releases the part.",
                releasing,
            )
            .parameter::<f64>("OpenWidth", "0", "width to open to, m"),
        ),
        Definition::new(
            "schunkwsg::StopDevice",
            "Stops the fingers, whatever the gripper executes.",
            |b: &mut Build<'_, '_>| action(b, plain(command::STOP), false),
        )
        .stateful()
        .text("Device", DEVICE)
        .output::<bool>(
            "outFinished",
            "the fingers are stopped, or the gripper is not operational",
        )
        .null(PENDING),
    ]
}

pub(super) fn table() -> Vec<Definition> {
    let mut all = motions();
    all.extend([
        definition(
            "SetAcceleration",
            "Sets the acceleration of the fingers; the gripper limits it to its capabilities.",
            set_acceleration,
        )
        .parameter::<f64>("Acceleration", "0", "acceleration, m/s²"),
        definition(
            "SetForceLimit",
            "Sets the largest gripping force; the gripper limits it to its capabilities.",
            set_force_limit,
        )
        .parameter::<f64>("Force", "0", "force, N"),
        definition(
            "SetSoftLimits",
            "Sets the range of widths within which the fingers move.",
            set_soft_limits,
        )
        .parameter::<f64>("Inner", "0", "smallest width, m")
        .parameter::<f64>("Outer", "0", "largest width, m"),
        definition(
            "ClearSoftLimits",
            "Removes the range of widths: only the end stops remain.",
            |_| Ok(plain(command::CLEAR_SOFT_LIMITS)),
        ),
        Definition::new(
            "schunkwsg::Monitor",
            "Values of a gripper, as its driver last reported.",
            monitor,
        )
        .text("Device", DEVICE)
        .output::<f64>("outOpeningWidth", "distance between the fingers, m")
        .output::<f64>("outSpeed", "relative speed of the fingers, m/s")
        .output::<f64>("outForce", "gripping force, N")
        .output::<f64>(
            "outGraspingState",
            "0 idle, 1 grasping, 2 no part found, 3 part lost, 4 holding, 5 releasing, 6 positioning, 7 error",
        )
        .null(UNKNOWN),
    ]);
    all
}

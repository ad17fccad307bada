//! `KUKA::youBot::*`: strategies and impedance of the arm, its gripper, flags of its drives, and the
//! frames that its five joints can reach.

mod projection;

use takt_net::definition::port;
use takt_net::device::{Gripper as Device, JointImpedance, Signal};
use takt_net::{Build, Cycle, Definition, Fault, Frame, In, NullRule, Out, Primitive};

use super::lwr::{joint_impedance, strategy};
use super::order::Standing;

const ROBOT: &str = "name of the youBot";
const GRIPPER: &str = "name of the gripper";

struct ArmControlStrategy {
    controller: In<i32>,
    order: Standing<i32>,
    success: Out<bool>,
}

impl Primitive for ArmControlStrategy {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let controller = self.controller.get(cycle);
        let done = controller.map(|controller| self.order.give(cycle, controller).is_done());
        self.success.set(cycle, done);
    }
}

fn arm_control_strategy(b: &mut Build<'_, '_>) -> Result<ArmControlStrategy, Fault> {
    Ok(ArmControlStrategy {
        controller: b.input("inController")?,
        order: strategy(b)?,
        success: b.output("outSuccess"),
    })
}

struct JointImpParameters {
    stiffness: In<f64>,
    damping: In<f64>,
    torque: In<f64>,
    torque_max: In<f64>,
    order: Standing<JointImpedance>,
    success: Out<bool>,
}

impl Primitive for JointImpParameters {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let wanted = JointImpedance {
            stiffness: self.stiffness.get(cycle),
            damping: self.damping.get(cycle),
            torque: self.torque.get(cycle),
            torque_max: self.torque_max.get(cycle),
        };
        let outcome = self.order.repeat(cycle, wanted);
        self.success.set(cycle, outcome.is_done());
    }
}

fn joint_imp_parameters(b: &mut Build<'_, '_>) -> Result<JointImpParameters, Fault> {
    Ok(JointImpParameters {
        stiffness: b.input("inStiffness")?,
        damping: b.input("inDamping")?,
        torque: b.input("inAddTorque")?,
        torque_max: b.input("inMaxTorque")?,
        order: joint_impedance(b, "JointIndex")?,
        success: b.output("outSuccess"),
    })
}

fn device(b: &mut Build<'_, '_>) -> Result<Device, Fault> {
    b.interface("Robot", "gripper", |has| has.gripper.clone())
}

struct Gripper {
    distance: f64,
    order: Standing<f64>,
    completed: Out<bool>,
}

impl Primitive for Gripper {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let outcome = self.order.give(cycle, self.distance);
        self.completed.set(cycle, outcome.is_done());
    }
}

fn gripper(b: &mut Build<'_, '_>) -> Result<Gripper, Fault> {
    let device = device(b)?;
    let distance: f64 = b.value("Distance")?;
    let widest = device.distance_max;
    if !(0.0..=widest).contains(&distance) {
        let why = format!("{distance} m is not between 0 and {widest} m");
        return Err(b.parameter_fault("Distance", why));
    }
    let robot = b.text("Robot").to_owned();
    b.claim(&robot, format!("{robot}_Gripper"));
    b.commands(device.order.command.target());
    Ok(Gripper {
        distance,
        order: Standing::new(device.order),
        completed: b.output("outCompleted"),
    })
}

struct GripperMonitor {
    distance: Signal<f64>,
    out: Out<f64>,
}

impl Primitive for GripperMonitor {
    fn step(&mut self, cycle: &Cycle<'_>) {
        self.out.set(cycle, self.distance.get(cycle.image));
    }
}

fn gripper_monitor(b: &mut Build<'_, '_>) -> Result<GripperMonitor, Fault> {
    Ok(GripperMonitor {
        distance: device(b)?.distance,
        out: b.output("outDistance"),
    })
}

/// Reported flags of a drive, by bit, with their meaning.
const FLAGS: [(u32, &str, &str); 14] = [
    (0, "bit0", "over-current"),
    (1, "bit1", "under-voltage"),
    (2, "bit2", "over-voltage"),
    (3, "bit3", "over-temperature"),
    (4, "bit4", "the motor rests"),
    (5, "bit5", "fault of the Hall sensors"),
    (8, "bit8", "PWM mode"),
    (9, "bit9", "velocity mode"),
    (10, "bit10", "position mode"),
    (11, "bit11", "torque mode"),
    (14, "bit14", "the position is reached"),
    (15, "bit15", "the drive is initialized"),
    (16, "bit16", "the drive missed its master's frames"),
    (17, "bit17", "too much current for too long (I²t)"),
];

struct SlaveError {
    flags: Signal<i32>,
    out: [Out<bool>; FLAGS.len()],
}

impl Primitive for SlaveError {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let flags = self.flags.get(cycle.image);
        for ((bit, ..), out) in FLAGS.iter().zip(&self.out) {
            out.set(cycle, flags.map(|flags| flags >> bit & 1 != 0));
        }
    }
}

fn slave_error(b: &mut Build<'_, '_>) -> Result<SlaveError, Fault> {
    let kind = "device whose drives report flags";
    let drives = b.interface("Robot", kind, |has| {
        has.drives.clone().filter(|drives| !drives.is_empty())
    })?;
    let number = b.number("Port", 0..=drives.len() - 1)?;
    Ok(SlaveError {
        flags: drives[number],
        out: FLAGS.map(|(_, name, _)| b.output(name)),
    })
}

/// Projects a frame to one that the arm can reach.
struct Project {
    flange: In<Frame>,
    motion_center: In<Frame>,
    project: fn(&Frame, &Frame) -> Option<Frame>,
    out: Out<Frame>,
}

impl Primitive for Project {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let frames = self.flange.get(cycle).zip(self.motion_center.get(cycle));
        let projected = frames.and_then(|(flange, center)| (self.project)(&flange, &center));
        self.out.set(cycle, projected);
    }
}

fn projection(
    name: &'static str,
    doc: &'static str,
    project: fn(&Frame, &Frame) -> Option<Frame>,
) -> Definition {
    let build = move |b: &mut Build<'_, '_>| -> Result<Project, Fault> {
        let motion_center = if b.is_linked("inMotionCenter") {
            b.input("inMotionCenter")?
        } else {
            b.constant(Frame::identity())
        };
        Ok(Project {
            flange: b.input("inFlange")?,
            motion_center,
            project,
            out: b.output("outValue"),
        })
    };
    Definition::new(name, doc, build)
        .input::<Frame>(port("inFlange", "flange in the base of the arm, m").required())
        .input::<Frame>(port(
            "inMotionCenter",
            "motion centre in the flange, m; unconnected it is the flange",
        ))
        .output::<Frame>("outValue", "flange in the base of the arm, m")
        .null(NullRule::Own(
            "Null if a frame is null or no number, or if there is none to be reached.",
        ))
        .cost_ns(200)
}

fn of_arm() -> [Definition; 2] {
    [
        Definition::new(
            "KUKA::youBot::ArmControlStrategy",
            "Switches how the arm is controlled. It must be at rest where it is commanded. Stiffness with which it would \
             swing at the cycle of its segment is refused; a shorter cycle admits more.",
            arm_control_strategy,
        )
        .active()
        .input::<i32>(
            port(
                "inController",
                "0 position, 1 joint impedance, 2 Cartesian impedance, along the axes of the flange, as \
                 KUKA::LWR::CartImpParameters says",
            )
            .or("Controller", "0"),
        )
        .text("Robot", ROBOT)
        .output::<bool>("outSuccess", "the strategy is in force")
        .null(NullRule::Own(
            "A null controller changes nothing, and outSuccess is null.",
        )),
        Definition::new(
            "KUKA::youBot::JointImpParameters",
            "Sets how a joint gives way in joint impedance. What it adds ends with the net; the rest \
             stays. Stiffness with which the joint would swing at the cycle of its segment is refused.",
            joint_imp_parameters,
        )
        .active()
        .input::<f64>(port("inStiffness", "stiffness, Nm/rad, from 0").or("Stiffness", "0"))
        .input::<f64>(port("inDamping", "damping ratio, 0 to 1").or("Damping", "0"))
        .input::<f64>(port("inAddTorque", "torque to add, Nm").or("AddTorque", "0"))
        .input::<f64>(
            port(
                "inMaxTorque",
                "largest torque of the impedance, Nm; unlimited up to 0",
            )
            .or("MaxTorque", "0"),
        )
        .text("Robot", ROBOT)
        .parameter::<i32>("JointIndex", "0", "which joint, from 0")
        .output::<bool>("outSuccess", "the parameters are in force")
        .null(NullRule::Own(
            "A null input keeps the present value; a null inAddTorque adds nothing.",
        )),
    ]
}

pub(super) fn table() -> Vec<Definition> {
    let mut all = Vec::from(of_arm());
    let flags = Definition::new(
        "KUKA::youBot::SlaveError",
        "Flags of a drive, as last reported.",
        slave_error,
    )
    .text("Robot", ROBOT)
    .parameter::<i32>("Port", "0", "which drive, from 0")
    .null(NullRule::Own("Null while the driver does not know them."));
    let with_flag = |d: Definition, (_, name, doc): &(u32, &'static str, &'static str)| {
        d.output::<bool>(name, doc)
    };
    all.extend([
        FLAGS.iter().fold(flags, with_flag),
        Definition::new(
            "KUKA::youBot::Gripper",
            "Moves the fingers of a gripper to a distance, once.",
            gripper,
        )
        .active()
        .parameter::<f64>("Distance", "0", "distance between the fingers, m")
        .text("Robot", GRIPPER)
        .output::<bool>("outCompleted", "the fingers are there"),
        Definition::new(
            "KUKA::youBot::GripperMonitor",
            "The distance between the fingers of a gripper, as its driver last reported.",
            gripper_monitor,
        )
        .text("Robot", GRIPPER)
        .output::<f64>("outDistance", "distance between the fingers, m")
        .null(NullRule::Own(
            "Null while the driver does not know the value.",
        )),
        projection(
            "KUKA::youBot::PalletizingProject",
            "Turns the motion centre where it is so that its z axis is vertical, up or down, \
             whichever is nearer, and keeps the heading of its x axis.",
            projection::palletize,
        ),
        projection(
            "KUKA::youBot::PositionPreservingProject",
            "Turns the motion centre where it is about the vertical, as little as possible, so that \
             the arm, whose joints but the first and last lie in one vertical plane, can reach it.",
            projection::keep_position,
        ),
    ]);
    all
}

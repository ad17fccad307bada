//! `KUKA::LWR::*` and `KUKA::IIWA::*`: functions of lightweight robots beside joints: control strategies, impedances,
//! tools, torques and forces. Kinematics is in `takt-motion`.

use takt_net::definition::port;
use takt_net::device::{
    CartesianImpedance, CartesianSine, JointImpedance, JointTorque, Order, Signal,
};
use takt_net::{
    Build, Cycle, Definition, Fault, Frame, In, NullRule, Out, Primitive, Vector, Wrench,
};

use super::order::Standing;
use super::robot_arm::{SetTool, TOOL_ERROR, set_tool};

const ROBOT: &str = "name of the robot arm";
const AXIS: &str = "which joint, from 0";
const UNKNOWN: NullRule = NullRule::Own("Null while the driver does not know the value.");
/// Outcome of an impedance order.
const TAKEN: &str = "the arm has accepted the orders of this primitive";
const REFUSED: &str = "0 none, 1 out of range or no number, 2 no contact to the arm, 4 the strategy in force or the \
                       robot's program does not take it, 6 not before command mode is entered again, \
                       or the addition requested again, -1 concurrent access";
const KEEPS: NullRule = NullRule::Own(
    "A null stiffness or damping keeps the present value; a null addition adds nothing.",
);

struct ControlStrategy {
    strategy: In<i32>,
    order: Standing<i32>,
    completed: Out<bool>,
    error: Out<i32>,
}

impl Primitive for ControlStrategy {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let strategy = self.strategy.get(cycle);
        let outcome = strategy.map(|strategy| self.order.give(cycle, strategy));
        self.completed.set(cycle, outcome.map(|o| o.is_done()));
        self.error.set(cycle, outcome.map(|o| o.error));
    }
}

/// The order for the control strategy of the arm of parameter `Robot`. It is held for this net, but the
/// net does not end with the robot: switching interrupts commanding for a while.
pub(super) fn strategy(b: &mut Build<'_, '_>) -> Result<Standing<i32>, Fault> {
    let kind = "robot arm with control strategies";
    let order: Order<i32> = b.interface("Robot", kind, |has| has.strategy)?;
    let robot = b.text("Robot").to_owned();
    b.hold(format!("{robot}_ControlStrategy"));
    b.commands(order.command.target());
    Ok(Standing::new(order))
}

fn control_strategy(b: &mut Build<'_, '_>) -> Result<ControlStrategy, Fault> {
    Ok(ControlStrategy {
        strategy: b.input("inStrategy")?,
        order: strategy(b)?,
        completed: b.output("outCompleted"),
        error: b.output("outError"),
    })
}

struct JointImpParameters {
    stiffness: In<f64>,
    damping: In<f64>,
    torque: In<f64>,
    order: Standing<JointImpedance>,
    completed: Out<bool>,
    error: Out<i32>,
}

impl Primitive for JointImpParameters {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let wanted = JointImpedance {
            stiffness: self.stiffness.get(cycle),
            damping: self.damping.get(cycle),
            torque: self.torque.get(cycle),
            torque_max: None,
        };
        let outcome = self.order.repeat(cycle, wanted);
        self.completed.set(cycle, outcome.is_done());
        self.error.set(cycle, outcome.error);
    }
}

/// The order for the impedance of a joint of the arm of parameter `Robot`.
pub(super) fn joint_impedance(
    b: &mut Build<'_, '_>,
    axis: &'static str,
) -> Result<Standing<JointImpedance>, Fault> {
    let kind = "robot arm with joint impedance";
    let orders = b.interface("Robot", kind, |has| has.joint_impedance.clone())?;
    let axis = b.number(axis, 0..=orders.len().saturating_sub(1))?;
    let robot = b.text("Robot").to_owned();
    b.hold(format!("{robot}_JointImp_{axis}"));
    b.commands(orders[axis].command.target());
    Ok(Standing::new(orders[axis]))
}

fn joint_imp_parameters(b: &mut Build<'_, '_>) -> Result<JointImpParameters, Fault> {
    Ok(JointImpParameters {
        stiffness: b.input("inStiffness")?,
        damping: b.input("inDamping")?,
        torque: b.input("inAddTorque")?,
        order: joint_impedance(b, "Axis")?,
        completed: b.output("outCompleted"),
        error: b.output("outError"),
    })
}

struct CartImpParameters {
    stiffness: In<Wrench>,
    damping: In<Wrench>,
    wrench: In<Wrench>,
    order: Standing<CartesianImpedance>,
    completed: Out<bool>,
    error: Out<i32>,
}

impl Primitive for CartImpParameters {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let wanted = CartesianImpedance {
            stiffness: self.stiffness.get(cycle),
            damping: self.damping.get(cycle),
            wrench: self.wrench.get(cycle),
        };
        let outcome = self.order.repeat(cycle, wanted);
        self.completed.set(cycle, outcome.is_done());
        self.error.set(cycle, outcome.error);
    }
}

fn cart_imp_parameters(b: &mut Build<'_, '_>) -> Result<CartImpParameters, Fault> {
    let kind = "robot arm with Cartesian impedance";
    let order = b.interface("Robot", kind, |has| has.cartesian_impedance)?;
    let robot = b.text("Robot").to_owned();
    b.hold(format!("{robot}_CartImp"));
    b.commands(order.command.target());
    Ok(CartImpParameters {
        stiffness: b.input("inStiffness")?,
        damping: b.input("inDamping")?,
        wrench: b.input("inAddTorque")?,
        order: Standing::new(order),
        completed: b.output("outCompleted"),
        error: b.output("outError"),
    })
}

/// Without outputs, as in the original: the values that the arm takes are seen in its motion.
struct CartSinImpParameters {
    amplitude: In<Wrench>,
    frequency: In<Wrench>,
    order: Standing<CartesianSine>,
}

impl Primitive for CartSinImpParameters {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let wanted = CartesianSine {
            amplitude: self.amplitude.get(cycle),
            frequency: self.frequency.get(cycle),
        };
        self.order.repeat(cycle, wanted);
    }
}

fn cart_sin_imp_parameters(b: &mut Build<'_, '_>) -> Result<CartSinImpParameters, Fault> {
    let kind = "robot arm whose tool can oscillate in Cartesian impedance";
    let order = b.interface("Robot", kind, |has| has.cartesian_sine)?;
    let robot = b.text("Robot").to_owned();
    b.hold(format!("{robot}_CartSinImp"));
    b.commands(order.command.target());
    Ok(CartSinImpParameters {
        amplitude: b.input("inAmplitude")?,
        frequency: b.input("inFrequency")?,
        order: Standing::new(order),
    })
}

fn tool_parameters(b: &mut Build<'_, '_>) -> Result<SetTool<Frame>, Fault> {
    let tcp = b.input("inTCP")?;
    set_tool(b, "robot", tcp)
}

/// Force and torque at the tool, one out port each.
struct Forces {
    wrench: Signal<Wrench>,
    out: [Out<f64>; 6],
}

impl Forces {
    fn new(b: &mut Build<'_, '_>) -> Result<Self, Fault> {
        let kind = "robot arm that knows the force at its tool";
        Ok(Self {
            wrench: b.interface("Robot", kind, |has| has.wrench)?,
            out: FORCES.map(|(name, _)| b.output(name)),
        })
    }
}

impl Primitive for Forces {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let wrench = self.wrench.get(cycle.image);
        let values = |w: Wrench| {
            [
                w.force.x, w.force.y, w.force.z, w.torque.x, w.torque.y, w.torque.z,
            ]
        };
        let values = wrench.map(values);
        for (i, out) in self.out.iter().enumerate() {
            out.set(cycle, values.map(|values| values[i]));
        }
    }
}

/// Torques at one joint.
struct Torques {
    torque: JointTorque,
    estimated: Out<f64>,
    measured: Out<f64>,
}

impl Primitive for Torques {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let JointTorque {
            estimated,
            measured,
        } = self.torque;
        self.estimated.set(cycle, estimated.get(cycle.image));
        self.measured.set(cycle, measured.get(cycle.image));
    }
}

const TORQUES: &str = "robot arm that knows torques at its joints";

fn t_monitor(b: &mut Build<'_, '_>) -> Result<Torques, Fault> {
    let joints = b.interface("Robot", TORQUES, |has| has.torques.clone())?;
    let axis = b.number("Axis", 0..=joints.len().saturating_sub(1))?;
    Ok(Torques {
        torque: joints[axis],
        estimated: b.output("outEst"),
        measured: b.output("outMsr"),
    })
}

struct FtMonitor {
    joints: Vec<Torques>,
    forces: Forces,
}

impl Primitive for FtMonitor {
    fn step(&mut self, cycle: &Cycle<'_>) {
        self.joints.iter_mut().for_each(|joint| joint.step(cycle));
        self.forces.step(cycle);
    }
}

fn ft_monitor(b: &mut Build<'_, '_>) -> Result<FtMonitor, Fault> {
    let kind = "robot arm that knows torques at seven joints";
    let torques = b.interface("Robot", kind, |has| {
        has.torques
            .clone()
            .filter(|joints| joints.len() >= ESTIMATED.len())
    })?;
    let names = ESTIMATED.iter().zip(MEASURED);
    let joints = torques.iter().zip(names);
    let joints = joints.map(|(torque, ((estimated, _), (measured, _)))| Torques {
        torque: *torque,
        estimated: b.output(estimated),
        measured: b.output(measured),
    });
    Ok(FtMonitor {
        joints: joints.collect(),
        forces: Forces::new(b)?,
    })
}

const FORCES: [(&str, &str); 6] = [
    ("outTcpFx", "force along x at the tool, N"),
    ("outTcpFy", "force along y at the tool, N"),
    ("outTcpFz", "force along z at the tool, N"),
    ("outTcpTx", "torque about x at the tool, Nm"),
    ("outTcpTy", "torque about y at the tool, Nm"),
    ("outTcpTz", "torque about z at the tool, Nm"),
];
const ESTIMATED: [(&str, &str); 7] = [
    ("outEstJ1", "estimated external torque at joint 1, Nm"),
    ("outEstJ2", "estimated external torque at joint 2, Nm"),
    ("outEstJ3", "estimated external torque at joint 3, Nm"),
    ("outEstJ4", "estimated external torque at joint 4, Nm"),
    ("outEstJ5", "estimated external torque at joint 5, Nm"),
    ("outEstJ6", "estimated external torque at joint 6, Nm"),
    ("outEstJ7", "estimated external torque at joint 7, Nm"),
];
const MEASURED: [(&str, &str); 7] = [
    ("outMsrJ1", "measured torque at joint 1, Nm"),
    ("outMsrJ2", "measured torque at joint 2, Nm"),
    ("outMsrJ3", "measured torque at joint 3, Nm"),
    ("outMsrJ4", "measured torque at joint 4, Nm"),
    ("outMsrJ5", "measured torque at joint 5, Nm"),
    ("outMsrJ6", "measured torque at joint 6, Nm"),
    ("outMsrJ7", "measured torque at joint 7, Nm"),
];

fn with_outputs(definition: Definition, ports: &[(&'static str, &'static str)]) -> Definition {
    let ports = ports.iter();
    ports.fold(definition, |d, (name, doc)| d.output::<f64>(name, doc))
}

/// Two spellings of one name are known.
fn tool_definition(name: &'static str) -> Definition {
    Definition::new(
        name,
        "Sets an arm's load and tool, again after each change.",
        tool_parameters,
    )
    .active()
    .input::<f64>(port("inMass", "mass, kg"))
    .input::<Frame>(port(
        "inCOM",
        "centre of mass in the flange, m, and the axes of inertia",
    ))
    .input::<Vector>(port(
        "inMOI",
        "moments of inertia about the axes of inCOM, kg m²",
    ))
    .input::<Frame>(port("inTCP", "tool centre point in the flange, m"))
    .text("robot", ROBOT)
    .output::<bool>("outCompleted", "the arm has accepted it")
    .output::<i32>("outError", TOOL_ERROR)
    .null(NullRule::Own(
        "While an input is null nothing is set, and the outputs are null.",
    ))
}

fn monitors() -> Vec<Definition> {
    let forces = Definition::new(
        "KUKA::LWR::FMonitor",
        "Force and torque at the tool of an arm, as its driver last reported.",
        Forces::new,
    )
    .text("Robot", ROBOT)
    .null(UNKNOWN);
    let all = Definition::new(
        "KUKA::LWR::FTMonitor",
        "Torques at all joints of an arm, and force and torque at its tool, as its driver last reported.",
        ft_monitor,
    )
    .text("Robot", ROBOT)
    .null(UNKNOWN)
    .cost_ns(120);
    vec![
        with_outputs(forces, &FORCES),
        with_outputs(
            with_outputs(with_outputs(all, &ESTIMATED), &MEASURED),
            &FORCES,
        ),
        Definition::new(
            "KUKA::LWR::TMonitor",
            "Torques at a joint of an arm, as its driver last reported.",
            t_monitor,
        )
        .text("Robot", ROBOT)
        .parameter::<i32>("Axis", "0", AXIS)
        .output::<f64>("outEst", "estimated external torque, Nm")
        .output::<f64>("outMsr", "measured torque, Nm")
        .null(UNKNOWN),
    ]
}

pub(super) fn table() -> Vec<Definition> {
    let mut all = monitors();
    all.extend([
        Definition::new(
            "KUKA::LWR::ControlStrategy",
            "Switches how an arm is controlled. The arm must be at rest where it is commanded.",
            control_strategy,
        )
        .active()
        .input::<i32>(port(
            "inStrategy",
            "1 position, 2 Cartesian impedance, 3 joint impedance; 0 takes an arm whose program can do \
             that out of command mode",
        ))
        .text("Robot", ROBOT)
        .output::<bool>("outCompleted", "the strategy is in force")
        .output::<i32>(
            "outError",
            "0 none, 1 no such strategy, 2 no contact or drives without power, 3 the arm moves or is \
             not where it is commanded, 4 the robot's program cannot switch it, 5 it did not, -1 \
             concurrent access",
        )
        .null(NullRule::Own(
            "A null strategy changes nothing, and the outputs are null.",
        )),
        Definition::new(
            "KUKA::LWR::JointImpParameters",
            "Sets how a joint gives way in joint impedance. What it adds ends with the net; stiffness \
             and damping stay.",
            joint_imp_parameters,
        )
        .active()
        .input::<f64>(port("inStiffness", "stiffness, Nm/rad, from 0"))
        .input::<f64>(port("inDamping", "damping ratio, 0 to 1"))
        .input::<f64>(port("inAddTorque", "torque to add, Nm"))
        .text("Robot", ROBOT)
        .parameter::<i32>("Axis", "0", AXIS)
        .output::<bool>("outCompleted", TAKEN)
        .output::<i32>("outError", REFUSED)
        .null(KEEPS),
        Definition::new(
            "KUKA::LWR::CartImpParameters",
            "Sets how the tool gives way in Cartesian impedance. What it adds ends with the net; \
             stiffness and damping stay.",
            cart_imp_parameters,
        )
        .active()
        .input::<Wrench>(port("inStiffness", "stiffness, N/m and Nm/rad, from 0"))
        .input::<Wrench>(port("inDamping", "damping ratio, 0 to 1"))
        .input::<Wrench>(port("inAddTorque", "force and torque to add, N and Nm"))
        .text("Robot", ROBOT)
        .output::<bool>("outCompleted", TAKEN)
        .output::<i32>("outError", REFUSED)
        .null(KEEPS),
        Definition::new(
            "KUKA::IIWA::CartSinImpParameters",
            "Sets how the tool of an arm oscillates in Cartesian impedance.",
            cart_sin_imp_parameters,
        )
        .active()
        .input::<Wrench>(port("inAmplitude", "amplitude, N and Nm, from 0"))
        .input::<Wrench>(port("inFrequency", "frequency, Hz, from 0"))
        .text("Robot", ROBOT)
        .null(NullRule::Own("A null input keeps the present value.")),
        tool_definition("KUKA::LWR::ToolParameters"),
        tool_definition("KUKA:LWR::ToolParameters"),
    ]);
    all
}

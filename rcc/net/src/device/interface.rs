//! The interfaces that devices can offer to nets beside joints, and where their values are in the
//! image. How a device executes commands is its driver's business.

use std::sync::Arc;

use super::signal::record;
use super::{Command, Layout, Signal};
use crate::value::{Frame, Twist, Vector, Wrench};

record! {
    /// The result of an order, which unlike a set-point is given once.
    Answer {
        /// The cycle in which it was given.
        order: u64,
        /// 0 if it was executed.
        error: i32,
    }
}

record! {
    /// A tool, or another load at the flange.
    Tool {
        /// Mass, kg.
        mass: f64,
        /// Centre of mass in the flange frame, m; its axes are those of `moi`.
        com: Frame,
        /// Moments of inertia about the axes of `com`, kg m².
        moi: Vector,
        /// Tool centre point in the flange frame, m.
        tcp: Frame,
    }
}

record! {
    /// Compliance of a joint. `None` keeps the present value.
    JointImpedance {
        /// Stiffness, Nm/rad, from 0.
        stiffness: Option<f64>,
        /// Damping ratio, 0 to 1.
        damping: Option<f64>,
        /// Torque added to that of the spring, Nm; withdrawn when its net ends.
        torque: Option<f64>,
        /// Largest spring torque, Nm; no limit at 0 or below.
        torque_max: Option<f64>,
    }
}

record! {
    /// Compliance of the tool, by axis of the frame that the robot's program chose. `None` keeps
    /// the present value.
    CartesianImpedance {
        /// Stiffness, N/m and Nm/rad, from 0.
        stiffness: Option<Wrench>,
        /// Damping ratio, 0 to 1.
        damping: Option<Wrench>,
        /// Force and torque added, N and Nm; withdrawn when its net ends.
        wrench: Option<Wrench>,
    }
}

record! {
    /// Oscillation of the tool in Cartesian impedance, by axis. `None` keeps the present value.
    CartesianSine {
        /// Amplitude, N and Nm, from 0.
        amplitude: Option<Wrench>,
        /// Frequency, Hz, from 0.
        frequency: Option<Wrench>,
    }
}

record! {
    /// A command to a gripper that executes it by itself.
    GripperCommand {
        /// Number of the command in the gripper's protocol.
        id: i32,
        /// First value: a width (m), force (N), acceleration (m/s²), or 0.
        first: f64,
        /// Second value: a width (m), speed (m/s), or 0.
        second: f64,
        /// Options of the command, bits of its protocol.
        options: i32,
    }
}

/// A mobile base.
#[derive(Clone, Debug)]
pub struct Base {
    /// 0 if it follows commands, else as [`super::JointError`].
    pub error: Signal<i32>,
    /// Last commanded velocity, in the base frame.
    pub commanded: Signal<Twist>,
    /// Pose by odometry, in the frame of its start, m.
    pub pose: Signal<Frame>,
    /// Measured velocity, in the base frame.
    pub velocity: Signal<Twist>,
    /// Its wheels.
    pub wheels: Arc<[Wheel]>,
    /// Commanded velocity, in the base frame; x, y and the rotation about z are used.
    pub command: Command<Twist>,
    /// Largest speed, m/s.
    pub velocity_max: f64,
    /// Largest rotational speed, rad/s.
    pub rotation_max: f64,
    /// Largest acceleration, m/s².
    pub acceleration_max: f64,
    /// Largest rotational acceleration, rad/s².
    pub rotation_acceleration_max: f64,
}

/// A wheel of a base.
#[derive(Clone, Copy, Debug)]
pub struct Wheel {
    /// Angle since the start, rad.
    pub position: Signal<f64>,
    /// Speed, rad/s.
    pub velocity: Signal<f64>,
}

impl Base {
    /// A base with that number of wheels, its largest speeds (m/s and rad/s) and accelerations (m/s² and rad/s²).
    pub fn new(
        layout: &mut Layout,
        wheels: usize,
        [velocity_max, rotation_max]: [f64; 2],
        [acceleration_max, rotation_acceleration_max]: [f64; 2],
    ) -> Self {
        let wheel = |layout: &mut Layout| Wheel {
            position: layout.signal(),
            velocity: layout.signal(),
        };
        Self {
            error: layout.signal(),
            commanded: layout.signal(),
            pose: layout.signal(),
            velocity: layout.signal(),
            wheels: (0..wheels).map(|_| wheel(layout)).collect(),
            command: layout.command(),
            velocity_max,
            rotation_max,
            acceleration_max,
            rotation_acceleration_max,
        }
    }
}

/// An output: its command and its state.
#[derive(Clone, Copy, Debug)]
pub struct Output<T> {
    /// The commanded value. It stays when its net ends.
    pub command: Command<T>,
    /// The present value.
    pub state: Signal<T>,
}

/// Digital and analogue inputs and outputs, each kind numbered from 0.
#[derive(Clone, Debug)]
pub struct Io {
    /// Digital inputs.
    pub bool_in: Arc<[Signal<bool>]>,
    /// Digital outputs.
    pub bool_out: Arc<[Output<bool>]>,
    /// Analogue inputs.
    pub real_in: Arc<[Signal<f64>]>,
    /// Analogue outputs.
    pub real_out: Arc<[Output<f64>]>,
}

impl Io {
    /// Interfaces with that number of digital inputs, digital outputs, analogue inputs and analogue
    /// outputs.
    pub fn new(layout: &mut Layout, counts: [usize; 4]) -> Self {
        let [bool_in, bool_out, real_in, real_out] = counts;
        fn output<T: super::Words>(layout: &mut Layout) -> Output<T> {
            Output {
                command: layout.command(),
                state: layout.signal(),
            }
        }
        Self {
            bool_in: (0..bool_in).map(|_| layout.signal()).collect(),
            bool_out: (0..bool_out).map(|_| output(layout)).collect(),
            real_in: (0..real_in).map(|_| layout.signal()).collect(),
            real_out: (0..real_out).map(|_| output(layout)).collect(),
        }
    }
}

/// A device that is commanded by tool positions.
#[derive(Clone, Debug)]
pub struct CartesianPosition {
    /// 0 if it follows commands, else as [`super::JointError`].
    pub error: Signal<i32>,
    /// Last commanded position, m.
    pub commanded_position: Signal<Frame>,
    /// Velocity of the commanded position.
    pub commanded_velocity: Signal<Twist>,
    /// Measured position, m.
    pub measured_position: Signal<Frame>,
    /// Measured velocity.
    pub measured_velocity: Signal<Twist>,
    /// Commanded position, m.
    pub command: Command<Frame>,
}

impl CartesianPosition {
    /// A device with this interface.
    pub fn new(layout: &mut Layout) -> Self {
        Self {
            error: layout.signal(),
            commanded_position: layout.signal(),
            commanded_velocity: layout.signal(),
            measured_position: layout.signal(),
            measured_velocity: layout.signal(),
            command: layout.command(),
        }
    }
}

/// An order to a device, and its result.
#[derive(Clone, Copy, Debug)]
pub struct Order<T> {
    /// The order. When its net ends it is withdrawn, see [`super::Given::is_withdrawn`]: settings
    /// stay, a motion stops, and what has not begun does not begin.
    pub command: Command<T>,
    /// The result of the last order; null before any.
    pub answer: Signal<Answer>,
}

impl<T: super::Words> Order<T> {
    /// An order of that type.
    pub fn new(layout: &mut Layout) -> Self {
        Self {
            command: layout.command(),
            answer: layout.signal(),
        }
    }
}

/// A gripper with parallel fingers.
#[derive(Clone, Debug)]
pub struct Gripper {
    /// Distance between its fingers, m.
    pub distance: Signal<f64>,
    /// Commanded distance, m.
    pub order: Order<f64>,
    /// Largest distance, m.
    pub distance_max: f64,
}

impl Gripper {
    /// A gripper that opens up to that distance, m.
    pub fn new(layout: &mut Layout, distance_max: f64) -> Self {
        Self {
            distance: layout.signal(),
            order: Order::new(layout),
            distance_max,
        }
    }
}

/// A gripper that executes commands by itself and answers each with a status.
#[derive(Clone, Copy, Debug)]
pub struct ServoGripper {
    /// Whether it executes commands.
    pub ready: Signal<bool>,
    /// Distance between its fingers, m.
    pub width: Signal<f64>,
    /// Speed of its fingers relative to each other, m/s.
    pub speed: Signal<f64>,
    /// Gripping force, N.
    pub force: Signal<f64>,
    /// State of grasping, by the numbers of its protocol.
    pub grasping: Signal<i32>,
    /// The command; its answer has the status of the gripper's protocol.
    pub order: Order<GripperCommand>,
}

impl ServoGripper {
    /// A gripper with this interface.
    pub fn new(layout: &mut Layout) -> Self {
        Self {
            ready: layout.signal(),
            width: layout.signal(),
            speed: layout.signal(),
            force: layout.signal(),
            grasping: layout.signal(),
            order: Order::new(layout),
        }
    }
}

/// An axis that its driver homes.
#[derive(Clone, Copy, Debug)]
pub struct Homing {
    /// Whether its zero is known.
    pub homed: Signal<bool>,
    /// Whether homing is under way.
    pub homing: Signal<bool>,
    /// Where homing is: 0 not begun, 1 off the switch on which it began, 2 to the switch, 3 on the switch until it may leave, 4 off
    /// the switch, 5 to the index pulse, 6 to its start, 7 done, 8 failed or cancelled.
    pub step: Signal<i32>,
    /// Number of the last failure, 0 without one.
    pub failure: Signal<i32>,
    /// Homes while it is given; the value permits to leave the proximity switch. Taken back before the end, the axis brakes.
    pub home: Command<bool>,
}

impl Homing {
    /// An axis with this interface.
    pub fn new(layout: &mut Layout) -> Self {
        Self {
            homed: layout.signal(),
            homing: layout.signal(),
            step: layout.signal(),
            failure: layout.signal(),
            home: layout.command(),
        }
    }
}

/// Torques at a joint.
#[derive(Clone, Copy, Debug)]
pub struct JointTorque {
    /// Estimated external torque, Nm.
    pub estimated: Signal<f64>,
    /// Torque measured by the joint's sensor, Nm.
    pub measured: Signal<f64>,
}

/// A number that a driver reports about its drives or its wire. It is for people to look at: no primitive reads it.
#[derive(Clone, Debug)]
pub struct Figure {
    /// Its name within the device, such as `joint.0.statusword`.
    pub name: Arc<str>,
    /// SI unit; empty if it has none.
    pub unit: Arc<str>,
    /// If it is the number of a state: the names of all, by number.
    pub states: Arc<[String]>,
    /// Where it is.
    pub place: Signal<f64>,
}

/// The interfaces of a device beside joints, as found by its name during loading.
#[derive(Clone, Debug, Default)]
pub struct Interfaces {
    /// It is a mobile base.
    pub base: Option<Base>,
    /// It has inputs and outputs.
    pub io: Option<Io>,
    /// It follows tool positions.
    pub cartesian: Option<CartesianPosition>,
    /// It grips.
    pub gripper: Option<Gripper>,
    /// It grips by itself.
    pub servo_gripper: Option<ServoGripper>,
    /// Its driver homes it.
    pub homing: Option<Homing>,
    /// Its load can be set.
    pub tool: Option<Order<Tool>>,
    /// It has more than one control strategy.
    pub strategy: Option<Order<i32>>,
    /// Its joints have adjustable compliance, by joint.
    pub joint_impedance: Option<Arc<[Order<JointImpedance>]>>,
    /// Its tool has adjustable compliance.
    pub cartesian_impedance: Option<Order<CartesianImpedance>>,
    /// Its tool can oscillate in Cartesian impedance.
    pub cartesian_sine: Option<Order<CartesianSine>>,
    /// It reports torques, by joint.
    pub torques: Option<Arc<[JointTorque]>>,
    /// It reports force (N) and torque (Nm) at its tool.
    pub wrench: Option<Signal<Wrench>>,
    /// Its drives report flags, by drive.
    pub drives: Option<Arc<[Signal<i32>]>>,
    /// What its driver reports about its drives and its wire.
    pub figures: Arc<[Figure]>,
}

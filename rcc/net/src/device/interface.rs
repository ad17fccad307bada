//! What devices can offer nets beside joints: for each interface, where its values lie in the
//! image. How a device does what it is told is its driver's business.

use std::sync::Arc;

use super::signal::record;
use super::{Command, Layout, Signal};
use crate::value::{Frame, Twist, Vector, Wrench};

record! {
    /// What became of an order, which unlike a set-point is given once.
    Answer {
        /// The cycle in which it was given.
        order: u64,
        /// 0 if it was carried out.
        error: i32,
    }
}

record! {
    /// A tool, or another load at the flange.
    Tool {
        /// Mass, kg.
        mass: f64,
        /// Centre of mass in the flange, m; its axes are those of `moi`.
        com: Frame,
        /// Moments of inertia about the axes of `com`, kg m².
        moi: Vector,
        /// Tool centre point in the flange, m.
        tcp: Frame,
    }
}

record! {
    /// How a joint is to give way. `None` leaves what is in force.
    JointImpedance {
        /// Stiffness, Nm/rad, from 0.
        stiffness: Option<f64>,
        /// Damping ratio, 0 to 1.
        damping: Option<f64>,
        /// Torque added to that of the spring, Nm; none when its net ends.
        torque: Option<f64>,
        /// Largest torque of the spring, Nm; none up to 0.
        torque_max: Option<f64>,
    }
}

record! {
    /// How the tool is to give way, by axis of the frame that the robot's program chose. `None` leaves
    /// what is in force.
    CartesianImpedance {
        /// Stiffness, N/m and Nm/rad, from 0.
        stiffness: Option<Wrench>,
        /// Damping ratio, 0 to 1.
        damping: Option<Wrench>,
        /// Force and torque added, N and Nm; none when its net ends.
        wrench: Option<Wrench>,
    }
}

/// A mobile base.
#[derive(Clone, Debug)]
pub struct Base {
    /// 0 if it follows commands, else as [`super::JointError`].
    pub error: Signal<i32>,
    /// Velocity the driver last commanded, in the base's own frame.
    pub commanded: Signal<Twist>,
    /// Pose by odometry, in the frame in which it started, m.
    pub pose: Signal<Frame>,
    /// Measured velocity, in the base's own frame.
    pub velocity: Signal<Twist>,
    /// Its wheels.
    pub wheels: Arc<[Wheel]>,
    /// Wanted velocity, in the base's own frame; x, y and the rotation about z matter.
    pub command: Command<Twist>,
    /// Largest speed, m/s.
    pub velocity_max: f64,
    /// Largest rotational speed, rad/s.
    pub rotation_max: f64,
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
    /// A base with so many wheels.
    #[must_use]
    pub fn new(layout: &mut Layout, wheels: usize, velocity_max: f64, rotation_max: f64) -> Self {
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
        }
    }
}

/// An output: what it is told and what it is.
#[derive(Clone, Copy, Debug)]
pub struct Output<T> {
    /// What it is to be. It stays when its net ends.
    pub command: Command<T>,
    /// What it is.
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
    /// So many of each: digital in, digital out, analogue in, analogue out.
    #[must_use]
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

/// A device that is commanded by where its tool is to be.
#[derive(Clone, Debug)]
pub struct CartesianPosition {
    /// 0 if it follows commands, else as [`super::JointError`].
    pub error: Signal<i32>,
    /// Position the driver last commanded, m.
    pub commanded_position: Signal<Frame>,
    /// Velocity of the commanded position.
    pub commanded_velocity: Signal<Twist>,
    /// Measured position, m.
    pub measured_position: Signal<Frame>,
    /// Measured velocity.
    pub measured_velocity: Signal<Twist>,
    /// Wanted position, m.
    pub command: Command<Frame>,
}

impl CartesianPosition {
    /// One such device.
    #[must_use]
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

/// Something a device is ordered to be or to have, and what became of it.
#[derive(Clone, Copy, Debug)]
pub struct Order<T> {
    /// What is wanted. When its net ends it is withdrawn, see [`super::Given::is_withdrawn`]: what is in force stays,
    /// what moves stops, what was not begun is not begun.
    pub command: Command<T>,
    /// What became of the last order; null before any.
    pub answer: Signal<Answer>,
}

impl<T: super::Words> Order<T> {
    /// One kind of order.
    #[must_use]
    pub fn new(layout: &mut Layout) -> Self {
        Self {
            command: layout.command(),
            answer: layout.signal(),
        }
    }
}

/// A gripper of parallel fingers.
#[derive(Clone, Debug)]
pub struct Gripper {
    /// Distance between its fingers, m.
    pub distance: Signal<f64>,
    /// Wanted distance, m.
    pub order: Order<f64>,
    /// Largest distance, m.
    pub distance_max: f64,
}

impl Gripper {
    /// One that opens so far, m.
    #[must_use]
    pub fn new(layout: &mut Layout, distance_max: f64) -> Self {
        Self {
            distance: layout.signal(),
            order: Order::new(layout),
            distance_max,
        }
    }
}

/// Torques at a joint.
#[derive(Clone, Copy, Debug)]
pub struct JointTorque {
    /// Estimate of what acts from outside, Nm.
    pub estimated: Signal<f64>,
    /// What the joint's sensor measures, Nm.
    pub measured: Signal<f64>,
}

/// What a device offers beside joints, as found by its name while loading.
#[derive(Clone, Debug, Default)]
pub struct Interfaces {
    /// It is a mobile base.
    pub base: Option<Base>,
    /// It has inputs and outputs.
    pub io: Option<Io>,
    /// It follows positions of its tool.
    pub cartesian: Option<CartesianPosition>,
    /// It grips.
    pub gripper: Option<Gripper>,
    /// It can be told what it carries.
    pub tool: Option<Order<Tool>>,
    /// It has more than one control strategy.
    pub strategy: Option<Order<i32>>,
    /// Its joints give way as told, by joint.
    pub joint_impedance: Option<Arc<[Order<JointImpedance>]>>,
    /// Its tool gives way as told.
    pub cartesian_impedance: Option<Order<CartesianImpedance>>,
    /// It knows torques, by joint.
    pub torques: Option<Arc<[JointTorque]>>,
    /// It knows force (N) and torque (Nm) at its tool.
    pub wrench: Option<Signal<Wrench>>,
    /// Its drives tell flags, by drive.
    pub drives: Option<Arc<[Signal<i32>]>>,
}

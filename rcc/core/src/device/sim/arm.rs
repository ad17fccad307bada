//! Simulated arms: they are at their set-points, within their limits, and their joints deflect under an external load
//! in joint impedance. There is no gravity, no mass and no friction; in Cartesian impedance they accept the
//! parameters, but hold their joints stiff.
//!
//! Parameters: `min_joint`, `max_joint` (rad), `max_vel` (rad/s), `max_acc` (rad/s²), and if wanted
//! `home_joint` (rad), lists with a number for each joint. An LWR and an iiwa have the ranges and velocities of their data
//! sheets where they are not given, and reach a velocity within 0.25 s. The load from outside: `external_torque`
//! (Nm), a list by joint, and `external_wrench`, [Fx, Fy, Fz, Tx, Ty, Tz] (N, Nm) at the flange
//! along the axes of the arm's base. `limits` is `strict`, or `range` for an arm that is wherever its set-points
//! are within its range, and only reports speeds beyond `max_vel`.
//!
//! A youBot counts its joints from the upright arm, as the Robotics API does; with `zero=folded` from their stops, as its
//! vendor does.
//!
//! An `arm_sim` has a `model` beside: the name of one that Takt knows, or the chain of joints that a cell made of a URDF. Ranges
//! and velocities are those of the URDF where they are not given.
//!
//! An LWR also has 8 digital inputs, 8 digital and 8 analogue outputs; each input has the value of the output with
//! its number.

use std::sync::Arc;

use takt_motion::Model;
use takt_net::device::{Answer, Interfaces, Kinematics, Layout, Order, Tool};
use takt_net::value::{Twist, Vector, Wrench};
use takt_net::{JointLimits, JointState};
use takt_rt::Nanos;

use super::compliance::Compliance;
use super::io::loop_back;
use super::sheet::Sheet;
use super::{Made, Parameters, Simulated, seconds};
use crate::device::on_end::OutputsOnEnd;
use crate::device::setpoint::Joint;
use crate::device::{
    ARM_JOINTS_MAX, ArmDescription, DeviceCommand, DeviceState, DeviceStatus, JointSetPoints,
    LEAST, Part, parts,
};
use crate::error::Error;

/// Position control takes over only within this position error, rad.
const SWITCH_DISTANCE: f64 = 0.01;
/// A joint faster than this is not at rest, rad/s.
const RESTING: f64 = 1e-3;
/// Drive flags: motor at rest, position control, initialized.
const DRIVE_FLAGS: [i32; 3] = [1 << 4, 1 << 10, 1 << 15];

/// Error values of answers.
mod error {
    /// Unknown strategy or tool.
    pub(super) const RANGE: i32 = 1;
    /// A joint moves, or is not at its commanded position.
    pub(super) const MOVES: i32 = 3;
    /// Its net ended before the order was started.
    pub(super) const WITHDRAWN: i32 = 7;
}

/// Properties of an arm type.
struct Type {
    joints: usize,
    model: Model,
    parts: Vec<Part>,
    strategies: Strategies,
    /// Range and velocity of each joint, where they need not be given.
    sheet: Option<Sheet>,
}

/// Acceleration to velocity of a joint without a given acceleration, 1/s.
const SHEET_ACCELERATION: f64 = 4.0;

/// Numbers of control strategies.
#[derive(Clone, Copy, Debug)]
struct Strategies {
    position: i32,
    joint_impedance: i32,
    cartesian_impedance: Option<i32>,
}

const LIGHTWEIGHT: [Part; 6] = [
    Part::Tool,
    Part::Strategy,
    Part::JointImpedance,
    Part::CartesianImpedance,
    Part::Torques,
    Part::Wrench,
];
/// Those of an LWR controller.
const LWR_IO: Part = Part::Io {
    bool_in: 8,
    bool_out: 8,
    real_in: 0,
    real_out: 8,
};
const LIGHTWEIGHT_STRATEGIES: Strategies = Strategies {
    position: 1,
    joint_impedance: 3,
    cartesian_impedance: Some(2),
};

pub(super) fn lwr(parameters: &Parameters<'_>, kind: &'static str) -> Result<Made, Error> {
    let model = Type {
        joints: 7,
        model: "kuka_lwr4".into(),
        parts: LIGHTWEIGHT.into_iter().chain([LWR_IO]).collect(),
        strategies: LIGHTWEIGHT_STRATEGIES,
        sheet: Some(Sheet::lwr()),
    };
    make(parameters, kind, &model)
}

pub(super) fn iiwa(parameters: &Parameters<'_>, kind: &'static str) -> Result<Made, Error> {
    let model = Type {
        joints: 7,
        model: "kuka_iiwa7".into(),
        parts: LIGHTWEIGHT
            .into_iter()
            .chain([Part::CartesianSine])
            .collect(),
        strategies: LIGHTWEIGHT_STRATEGIES,
        sheet: Some(Sheet::iiwa()),
    };
    make(parameters, kind, &model)
}

pub(super) fn youbot(parameters: &Parameters<'_>, kind: &'static str) -> Result<Made, Error> {
    let parts = vec![
        Part::Strategy,
        Part::JointImpedance,
        Part::Torques,
        Part::Drives { count: 5 },
    ];
    let zeros = [
        ("upright", "kuka_youbot_upright"),
        ("folded", "kuka_youbot"),
    ];
    let model = Type {
        joints: 5,
        model: parameters.choice("zero", zeros)?.into(),
        parts,
        strategies: Strategies {
            position: 0,
            joint_impedance: 1,
            cartesian_impedance: None,
        },
        sheet: None,
    };
    make(parameters, kind, &model)
}

/// An arm of the model that is given.
pub(super) fn any(parameters: &Parameters<'_>, kind: &'static str) -> Result<Made, Error> {
    let parts = LIGHTWEIGHT.into_iter();
    let parts = parts.filter(|part| *part != Part::CartesianImpedance);
    let text = parameters.texts.get("model");
    let text = text.ok_or_else(|| parameters.wrong("model is missing".to_owned()))?;
    let model: Result<Model, _> = text.trim().parse();
    let model = model.map_err(|error| parameters.wrong(format!("model: {error}")))?;
    let kinematics = model.unlimited().ok_or_else(|| {
        let name = model.name().escape_debug();
        parameters.wrong(format!(
            "there is no model `{name}`\nhint: name one that Takt knows, or a file: `urdf:arm.urdf` in a cell file"
        ))
    })?;
    let sheet = match (model.arm(), model.name()) {
        (Some(arm), _) => Some(Sheet::of_arm(arm)),
        (None, "kuka_lwr4") => Some(Sheet::lwr()),
        (None, "kuka_iiwa7") => Some(Sheet::iiwa()),
        (None, _) => None,
    };
    let any = Type {
        joints: kinematics.joints(),
        model,
        parts: parts.collect(),
        strategies: Strategies {
            cartesian_impedance: None,
            ..LIGHTWEIGHT_STRATEGIES
        },
        sheet,
    };
    make(parameters, kind, &any)
}

/// Checks limits against those of the file of an arm: they may be narrower, not wider.
fn check_within(
    parameters: &Parameters<'_>,
    model: &Model,
    limits: &[JointLimits],
) -> Result<(), Error> {
    let Some(arm) = model.arm() else {
        return Ok(());
    };
    let joints = arm.joints.iter().zip(limits).enumerate();
    for (number, (joint, limits)) in joints {
        if let Some(why) = joint.exceeded_by(limits) {
            let (file, line) = (&arm.file, joint.line);
            let what = format!("joint {number}: {why} of `{}` ({file}:{line})", joint.name);
            return Err(parameters.wrong(what));
        }
    }
    Ok(())
}

fn make(parameters: &Parameters<'_>, kind: &'static str, model: &Type) -> Result<Made, Error> {
    let limits = limits(parameters, model)?;
    let home = parameters.list("home_joint", model.joints)?;
    check_within(parameters, &model.model, &limits)?;
    // As a jog would bring it there.
    let rest = |limits: &JointLimits| match limits {
        JointLimits {
            position_min,
            position_max,
            ..
        } if *position_min > 0.0 || *position_max < 0.0 => 0.5 * (position_min + position_max),
        _ => 0.0,
    };
    let home = home.unwrap_or_else(|| match model.model.arm() {
        Some(_) => limits.iter().map(rest).collect(),
        None => vec![0.0; model.joints],
    });
    let torque = parameters.list("external_torque", model.joints)?;
    let wrench = parameters.list("external_wrench", 6)?;
    let description = ArmDescription {
        name: parameters.name.to_owned(),
        kind,
        limits,
        model: model.model.clone(),
    }
    .with(&model.parts);
    let mut layout = Layout::default();
    let interfaces = parts::lay(&model.parts, model.joints, &mut layout);
    let outputs = interfaces.io.as_ref();
    let outputs = outputs.map_or((0, 0), |io| (io.bool_out.len(), io.real_out.len()));
    let on_end = parameters.on_end(outputs.0, outputs.1)?;
    let mut state = DeviceState::new(layout.signals);
    state.status = DeviceStatus::Operational;
    let is_strict = parameters.choice("limits", [("strict", true), ("range", false)])?;
    let joint = |(limits, home): (&JointLimits, &f64)| {
        let mut joint = Joint::new(*limits);
        if !is_strict {
            joint = joint.following_all();
        }
        joint.rest_at(*home, &JointSetPoints::default());
        joint
    };
    let joints = description.limits.iter().zip(&home).map(joint).collect();
    let mut arm = SimulatedArm {
        joints,
        limits: description.limits.clone(),
        measured: home.iter().map(|home| Motion::at(*home)).collect(),
        compliance: vec![Compliance::default(); model.joints],
        strategies: model.strategies,
        strategy: model.strategies.position,
        answers: Answers::default(),
        load: Load {
            torque: torque.unwrap_or_else(|| vec![0.0; model.joints]),
            wrench: wrench.map(|w| Wrench {
                force: Vector::new(w[0], w[1], w[2]),
                torque: Vector::new(w[3], w[4], w[5]),
            }),
        },
        kinematics: description.model.limited(&description.limits),
        interfaces,
        state,
        on_end,
    };
    // Programs may read it before its first cycle.
    arm.retract(&DeviceCommand::new(layout.commands));
    arm.publish([0.0; ARM_JOINTS_MAX]);
    Ok((description, Box::new(arm)))
}

fn limits(parameters: &Parameters<'_>, model: &Type) -> Result<Vec<JointLimits>, Error> {
    let joints = model.joints;
    let given = |key, of_sheet: fn(&Sheet) -> Vec<f64>| {
        let default = model.sheet.as_ref().map(of_sheet);
        match default.filter(|values| values.iter().all(|it| !it.is_nan())) {
            Some(default) => Ok(parameters.list(key, joints)?.unwrap_or(default)),
            None => parameters.needed(key, joints),
        }
    };
    let min = given("min_joint", |sheet| sheet.min.clone())?;
    let max = given("max_joint", |sheet| sheet.max.clone())?;
    let velocity = given("max_vel", |sheet| sheet.velocity.clone())?;
    let acceleration = given("max_acc", |sheet| {
        let velocities = sheet.velocity.iter();
        velocities.map(|it| it * SHEET_ACCELERATION).collect()
    })?;
    let mut limits = Vec::with_capacity(joints);
    for i in 0..joints {
        let moves = velocity[i] >= LEAST && acceleration[i] >= LEAST;
        if min[i] > max[i] || !moves {
            let what = format!(
                "the limits of joint {i} leave it no motion: min_joint is above max_joint, or max_vel or \
                 max_acc below {LEAST:e}"
            );
            return Err(parameters.wrong(what));
        }
        limits.push(JointLimits {
            position_min: min[i],
            position_max: max[i],
            velocity_max: velocity[i],
            acceleration_max: acceleration[i],
        });
    }
    Ok(limits)
}

/// Position and motion of a joint: rad, rad/s, rad/s².
#[derive(Clone, Copy, Debug)]
struct Motion {
    position: f64,
    velocity: f64,
    acceleration: f64,
}

impl Motion {
    const fn at(position: f64) -> Self {
        Self {
            position,
            velocity: 0.0,
            acceleration: 0.0,
        }
    }

    fn move_to(&mut self, position: f64, dt_s: f64) {
        let velocity = (position - self.position) / dt_s;
        self.acceleration = (velocity - self.velocity) / dt_s;
        (self.position, self.velocity) = (position, velocity);
    }
}

/// External load.
#[derive(Debug)]
struct Load {
    /// By joint, Nm.
    torque: Vec<f64>,
    /// At the flange.
    wrench: Option<Wrench>,
}

/// Answers to the last orders.
#[derive(Debug, Default)]
struct Answers {
    tool: Option<Answer>,
    strategy: Option<Answer>,
    cartesian_impedance: Option<Answer>,
    cartesian_sine: Option<Answer>,
}

#[derive(Debug)]
struct SimulatedArm {
    joints: Vec<Joint>,
    limits: Vec<JointLimits>,
    measured: Vec<Motion>,
    compliance: Vec<Compliance>,
    strategies: Strategies,
    /// The strategy in force.
    strategy: i32,
    answers: Answers,
    load: Load,
    kinematics: Option<Arc<dyn Kinematics>>,
    interfaces: Interfaces,
    state: DeviceState,
    on_end: OutputsOnEnd,
}

impl Simulated for SimulatedArm {
    fn step(&mut self, command: &DeviceCommand, dt: Nanos) {
        self.state.stamp = command.time;
        let dt_s = seconds(dt);
        if dt_s <= 0.0 {
            return;
        }
        self.apply(command);
        self.retract(command);
        let torques = self.load_torques();
        let compliant = self.strategy == self.strategies.joint_impedance;
        for (i, joint) in self.joints.iter_mut().enumerate() {
            let set_points = &command.joints[i];
            // Between two set-points of a slower net it interpolates without corners: that needs half a period more.
            // This thread is never late for itself.
            let period = set_points.period;
            let more = if joint.is_sparse(period) {
                period.0 / 2
            } else {
                0
            };
            let behind = Nanos(period.0 + more) - dt;
            let behind = behind.max(Nanos::ZERO);
            let position = joint.sample(set_points, true, command.time - behind, dt_s);
            let compliance = &mut self.compliance[i];
            if compliant {
                compliance.yield_to(torques[i], dt_s);
                let limits = &self.limits[i];
                let (min, max) = (limits.position_min, limits.position_max);
                compliance.keep_within(min - position, max - position);
            } else {
                compliance.hold();
            }
            self.measured[i].move_to(position + compliance.deflection(), dt_s);
        }
        self.publish(torques);
    }

    fn retract(&mut self, command: &DeviceCommand) {
        if let Some(io) = &self.interfaces.io {
            loop_back(io, &self.on_end, command, &mut self.state);
        }
    }

    fn state(&self) -> &DeviceState {
        &self.state
    }
}

impl SimulatedArm {
    /// Applies orders of nets.
    fn apply(&mut self, command: &DeviceCommand) {
        let words = &command.words;
        let rests = self.rests();
        let Answers {
            tool,
            strategy,
            cartesian_impedance,
            cartesian_sine,
        } = &mut self.answers;
        if let Some(order) = &self.interfaces.strategy {
            answer(order, words, strategy, |wanted| {
                let known = [
                    Some(self.strategies.position),
                    Some(self.strategies.joint_impedance),
                    self.strategies.cartesian_impedance,
                ];
                if !known.contains(&Some(wanted)) {
                    error::RANGE
                } else if wanted != self.strategy && !rests {
                    error::MOVES
                } else {
                    self.strategy = wanted;
                    0
                }
            });
        }
        if let Some(order) = &self.interfaces.tool {
            answer(order, words, tool, |wanted| check_tool(&wanted));
        }
        if let Some(order) = &self.interfaces.cartesian_impedance {
            // Parameters are checked where they are ordered.
            answer(order, words, cartesian_impedance, |_| 0);
        }
        if let Some(order) = &self.interfaces.cartesian_sine {
            answer(order, words, cartesian_sine, |_| 0);
        }
        let signals = &mut self.state.signals;
        let orders = self.interfaces.joint_impedance.iter();
        let orders = orders.flat_map(|orders| orders.iter());
        for (order, compliance) in orders.zip(&mut self.compliance) {
            compliance.apply(order, words, command.cycle, signals);
        }
    }

    /// Whether all joints rest at their commanded positions.
    fn rests(&self) -> bool {
        let joints = self.joints.iter().zip(&self.measured);
        joints.into_iter().all(|(joint, measured)| {
            let away = (measured.position - joint.motion().0).abs();
            measured.velocity.abs() < RESTING && away < SWITCH_DISTANCE
        })
    }

    /// Joint torques of the load, Nm.
    fn load_torques(&self) -> [f64; ARM_JOINTS_MAX] {
        let mut torques = [0.0; ARM_JOINTS_MAX];
        for (torque, load) in torques.iter_mut().zip(&self.load.torque) {
            *torque = *load;
        }
        if let (Some(wrench), Some(kinematics)) = (&self.load.wrench, &self.kinematics) {
            let mut angles = [0.0; ARM_JOINTS_MAX];
            for (angle, motion) in angles.iter_mut().zip(&self.measured) {
                *angle = motion.position;
            }
            let count = self.joints.len();
            let mut columns = [Twist::default(); ARM_JOINTS_MAX];
            kinematics.jacobian(&angles[..count], &mut columns[..count]);
            for (torque, column) in torques.iter_mut().zip(&columns[..count]) {
                // Virtual work: the torque is the work of the wrench per joint angle.
                *torque += wrench.force.dot(&column.vel) + wrench.torque.dot(&column.rot);
            }
        }
        torques
    }

    fn publish(&mut self, torques: [f64; ARM_JOINTS_MAX]) {
        let joints = self.joints.iter().zip(&self.measured);
        for (reported, (joint, measured)) in self.state.joints.iter_mut().zip(joints) {
            let (position, velocity, acceleration) = joint.continued();
            *reported = JointState {
                commanded_position: Some(position),
                commanded_velocity: Some(velocity),
                commanded_acceleration: Some(acceleration),
                measured_position: Some(measured.position),
                measured_velocity: Some(measured.velocity),
                measured_acceleration: Some(measured.acceleration),
                error: joint.error() as i32,
            };
        }
        for (limited, joint) in self.state.limited.iter_mut().zip(&self.joints) {
            *limited = *joint.limited();
        }
        for (rejected, joint) in self.state.rejected.iter_mut().zip(&self.joints) {
            *rejected = *joint.rejected();
        }
        let has = &self.interfaces;
        let signals = &mut self.state.signals;
        if let Some(order) = &has.strategy {
            order.answer.report(signals, self.answers.strategy);
        }
        if let Some(order) = &has.tool {
            order.answer.report(signals, self.answers.tool);
        }
        if let Some(order) = &has.cartesian_impedance {
            order
                .answer
                .report(signals, self.answers.cartesian_impedance);
        }
        if let Some(order) = &has.cartesian_sine {
            order.answer.report(signals, self.answers.cartesian_sine);
        }
        // Without mass a joint's sensor measures the external torque.
        for (place, torque) in has.torques.iter().flat_map(|t| t.iter()).zip(torques) {
            place.estimated.report(signals, Some(torque));
            place.measured.report(signals, Some(torque));
        }
        if let Some(place) = &has.wrench {
            place.report(signals, Some(self.load.wrench.unwrap_or_default()));
        }
        let [halted, position_mode, initialized] = DRIVE_FLAGS;
        let drives = has.drives.iter().flat_map(|drives| drives.iter());
        for (place, motion) in drives.zip(&self.measured) {
            let rests = motion.velocity.abs() < RESTING;
            let halted = if rests { halted } else { 0 };
            place.report(signals, Some(halted | position_mode | initialized));
        }
    }
}

/// Answers an order once; `decide` executes it and returns the error.
fn answer<T: takt_net::device::Words>(
    order: &Order<T>,
    words: &[u64],
    last: &mut Option<Answer>,
    decide: impl FnOnce(T) -> i32,
) {
    if let Some(given) = order.command.read(words)
        && last.is_none_or(|last| last.order != given.cycle)
    {
        // An order that was not started when its net ended is dropped.
        let error = if given.is_withdrawn() {
            error::WITHDRAWN
        } else {
            decide(given.value)
        };
        *last = Some(Answer {
            order: given.cycle,
            error,
        });
    }
}

fn check_tool(tool: &Tool) -> i32 {
    let parts = [tool.mass, tool.moi.x, tool.moi.y, tool.moi.z];
    let possible = parts.iter().all(|v| v.is_finite() && *v >= 0.0);
    if possible { 0 } else { error::RANGE }
}

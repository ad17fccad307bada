//! `ArmKinematics::*` for any arm with known geometry, and `KUKA::LWR::*` with the arm angle. They
//! compute only; they neither command nor read devices.

#[cfg(test)]
mod tests;

use std::sync::Arc;

use takt_net::definition::port;
use takt_net::device::{Kinematics, Unreachable};
use takt_net::{
    ArrayIn, ArrayOut, Build, Cycle, Definition, Fault, FaultKind, Frame, In, NullRule, Out,
    Primitive, Twist,
};

use super::{Srs, ranges};

const ROBOT: &str = "name of the robot arm";
const ERROR: &str =
    "0 none, 1 out of reach, 2 only beyond joint limits, 3 frame or hint not finite";

/// Whether all parts of a frame are finite.
fn is_finite(frame: &Frame) -> bool {
    let position = frame.translation.vector.iter();
    position
        .chain(frame.rotation.coords.iter())
        .all(|v| v.is_finite())
}

/// An array in port with as many elements as the arm has joints.
fn joints_input(
    b: &mut Build<'_, '_>,
    name: &str,
    kinematics: &dyn Kinematics,
) -> Result<ArrayIn<f64>, Fault> {
    let port = b.array_input::<f64>(name)?;
    if port.len() != kinematics.joints() {
        let (found, wanted) = (port.len(), kinematics.joints());
        let message = format!("{name} carries {found} elements, but the arm has {wanted} joints");
        return Err(b.fault(FaultKind::ArraySize(message)));
    }
    Ok(port)
}

/// Copies the array of this cycle; `None` if it is null.
fn copy(port: &ArrayIn<f64>, cycle: &Cycle<'_>, values: &mut [f64]) -> Option<()> {
    for (value, cell) in values.iter_mut().zip(port.get(cycle)?) {
        *value = cell.get();
    }
    Some(())
}

struct Kin {
    kinematics: Arc<dyn Kinematics>,
    joints: ArrayIn<f64>,
    values: Box<[f64]>,
    frame: Out<Frame>,
}

impl Primitive for Kin {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let joints = copy(&self.joints, cycle, &mut self.values);
        let frame = joints.map(|()| self.kinematics.forward(&self.values));
        self.frame.set(cycle, frame.filter(is_finite));
    }
}

fn kin() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<Kin, Fault> {
        let kinematics = b.kinematics("Robot")?;
        Ok(Kin {
            joints: joints_input(b, "inJoints", &*kinematics)?,
            values: vec![0.0; kinematics.joints()].into(),
            frame: b.output("outFrame"),
            kinematics,
        })
    };
    Definition::new(
        "ArmKinematics::Kin",
        "The flange frame of an arm at given joint positions.",
        build,
    )
    .active()
    .array_input::<f64>(port("inJoints", "joint positions, rad").required())
    .text("Robot", ROBOT)
    .output::<Frame>("outFrame", "flange in the base of the arm, m")
    .null(NullRule::Own(
        "Null if a joint position is null or not a number.",
    ))
}

struct InvKin {
    kinematics: Arc<dyn Kinematics>,
    frame: In<Frame>,
    hint: ArrayIn<f64>,
    near: Box<[f64]>,
    values: Box<[f64]>,
    joints: ArrayOut<f64>,
    error: Out<i32>,
}

impl Primitive for InvKin {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let inputs = copy(&self.hint, cycle, &mut self.near).zip(self.frame.get(cycle));
        let solved = inputs.map(|((), frame)| {
            let joints = &mut self.values;
            self.kinematics.inverse(&frame, &self.near, joints)
        });
        match solved {
            Some(Ok(())) => self.joints.set(cycle, self.values.iter().copied()),
            Some(Err(_)) | None => self.joints.set_null(cycle),
        }
        self.error.set(cycle, solved.map(number));
    }
}

fn number<T>(solved: Result<T, Unreachable>) -> i32 {
    solved.map_or_else(|why| why as i32, |_| 0)
}

fn inv_kin() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<InvKin, Fault> {
        let kinematics = b.kinematics("Robot")?;
        let joints = kinematics.joints();
        Ok(InvKin {
            frame: b.input("inFrame")?,
            hint: joints_input(b, "inHintJoints", &*kinematics)?,
            near: vec![0.0; joints].into(),
            values: vec![0.0; joints].into(),
            joints: b.array_output("outJoints", joints)?,
            error: b.output("outError"),
            kinematics,
        })
    };
    Definition::new(
        "ArmKinematics::InvKin",
        "Joint positions within their limits that bring the flange to a frame: of all solutions the \
         one nearest to the hint.",
        build,
    )
    .active()
    .input::<Frame>(port("inFrame", "flange in the base of the arm, m").required())
    .array_input::<f64>(port("inHintJoints", "hint: prefer the solution nearest to these joint positions, rad").required())
    .text("Robot", ROBOT)
    .array_output::<f64>("outJoints", "joint positions, rad")
    .output::<i32>("outError", ERROR)
    .null(NullRule::Own(
        "Null in gives null out. Without a solution outJoints is null; outError is the reason.",
    ))
}

const JOINTS: [&str; 7] = ["inJ1", "inJ2", "inJ3", "inJ4", "inJ5", "inJ6", "inJ7"];
const VELOCITIES: [&str; 7] = ["inV1", "inV2", "inV3", "inV4", "inV5", "inV6", "inV7"];
const OUT: [&str; 7] = [
    "outJ1", "outJ2", "outJ3", "outJ4", "outJ5", "outJ6", "outJ7",
];
const HINT: [&str; 7] = [
    "inHintJ1", "inHintJ2", "inHintJ3", "inHintJ4", "inHintJ5", "inHintJ6", "inHintJ7",
];
const NULLSPACE: [&str; 7] = [
    "inNullspaceJ1",
    "inNullspaceJ2",
    "inNullspaceJ3",
    "inNullspaceJ4",
    "inNullspaceJ5",
    "inNullspaceJ6",
    "inNullspaceJ7",
];

/// Seven scalar in ports, one for each joint.
#[derive(Clone, Copy)]
struct Seven([In<f64>; 7]);

impl Seven {
    fn new(b: &mut Build<'_, '_>, names: [&str; 7]) -> Result<Self, Fault> {
        let mut ports = Vec::with_capacity(names.len());
        for name in names {
            ports.push(b.input(name)?);
        }
        Ok(Self(std::array::from_fn(|i| ports[i])))
    }

    /// Their values; `None` if one is null.
    fn get(self, cycle: &Cycle<'_>) -> Option<[f64; 7]> {
        let values = self.0.map(|port| port.get(cycle));
        values
            .iter()
            .all(Option::is_some)
            .then(|| values.map(Option::unwrap_or_default))
    }

    /// Their values; null ones are replaced by those of `others`.
    fn get_or(self, cycle: &Cycle<'_>, others: [f64; 7]) -> [f64; 7] {
        std::array::from_fn(|i| self.0[i].get(cycle).unwrap_or(others[i]))
    }
}

fn with_seven(definition: Definition, names: [&'static str; 7], doc: &'static str) -> Definition {
    let add = |d: Definition, name| d.input::<f64>(port(name, doc).required());
    names.into_iter().fold(definition, add)
}

/// An LWR with the joint limits of the arm named by `Robot`.
fn lwr(b: &mut Build<'_, '_>) -> Result<Srs, Fault> {
    let limits = b.arm("Robot")?.limits;
    let ranges = ranges(&limits).ok_or_else(|| {
        let why = format!("an LWR has 7 joints, this arm has {}", limits.len());
        b.arm_fault("Robot", why)
    })?;
    Ok(Srs::kuka_lwr4().within(ranges))
}

struct LwrKin {
    arm: Srs,
    joints: Seven,
    frame: Out<Frame>,
    alpha: Out<f64>,
}

impl Primitive for LwrKin {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let joints = self.joints.get(cycle);
        let solution = joints.map(|joints| self.arm.forward_alpha(&joints));
        let solution = solution.filter(|(frame, _)| is_finite(frame));
        self.frame.set(cycle, solution.map(|(frame, _)| frame));
        self.alpha.set(cycle, solution.map(|(_, alpha)| alpha));
    }
}

fn lwr_kin() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<LwrKin, Fault> {
        Ok(LwrKin {
            arm: lwr(b)?,
            joints: Seven::new(b, JOINTS)?,
            frame: b.output("outFrame"),
            alpha: b.output("outAlpha"),
        })
    };
    let definition = Definition::new(
        "KUKA::LWR::Kin",
        "The flange frame and the arm angle of an LWR at given joint positions.",
        build,
    )
    .active();
    with_seven(definition, JOINTS, "joint position, rad")
        .text("Robot", ROBOT)
        .output::<Frame>("outFrame", "flange in the base of the arm, m")
        .output::<f64>("outAlpha", "arm angle, rad")
        .null(NullRule::Own(
            "Null if a joint position is null or not a number.",
        ))
}

/// The source of the arm angle of an inverse: the values of parameter `Strategy`.
#[derive(Clone, Copy, PartialEq)]
enum Strategy {
    /// The arm angle of the null-space joints.
    Keep,
    /// From there towards the joint positions nearest to the hint.
    Approach,
}

/// Upper bound on the steps of an approach.
const APPROACH_STEPS: u32 = 5;
/// Step by which an approach measures slope and curvature, rad.
const PROBE: f64 = 1e-3;
/// Longest step of an approach, rad.
const LONGEST: f64 = 0.1;

fn distance(a: &[f64; 7], b: &[f64; 7]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum()
}

/// Moves the arm angle by a bounded number of steps towards joint positions nearer to the hint.
fn approach(arm: &Srs, frame: &Frame, mut alpha: f64, hint: &[f64; 7], joints: &mut [f64; 7]) {
    let at = |alpha| arm.inverse_alpha(frame, alpha, hint).ok();
    for _ in 0..APPROACH_STEPS {
        let (Some(below), Some(above)) = (at(alpha - PROBE), at(alpha + PROBE)) else {
            return;
        };
        let here = distance(joints, hint);
        let (below, above) = (distance(&below, hint), distance(&above, hint));
        let slope = (above - below) / (2.0 * PROBE);
        let curvature = (above - 2.0 * here + below) / (PROBE * PROBE);
        let step = if curvature > 0.0 {
            -slope / curvature
        } else {
            -LONGEST.copysign(slope)
        };
        let next = alpha + step.clamp(-LONGEST, LONGEST);
        match at(next) {
            Some(nearer) if distance(&nearer, hint) < here => *joints = nearer,
            _ => return,
        }
        alpha = next;
    }
}

struct LwrInvKin {
    arm: Srs,
    strategy: Strategy,
    frame: In<Frame>,
    hint: Seven,
    nullspace: Seven,
    joints: [Out<f64>; 7],
    error: Out<i32>,
}

impl LwrInvKin {
    fn solve(
        &self,
        frame: &Frame,
        hint: &[f64; 7],
        nullspace: &[f64; 7],
    ) -> Result<[f64; 7], Unreachable> {
        let (_, alpha) = self.arm.forward_alpha(nullspace);
        let bent_alike = (hint[3] >= 0.0) == (nullspace[3] >= 0.0);
        let half_turn = if bent_alike {
            0.0
        } else {
            std::f64::consts::PI
        };
        let alpha = alpha + half_turn;
        let mut joints = self.arm.inverse_alpha(frame, alpha, hint)?;
        if self.strategy == Strategy::Approach {
            approach(&self.arm, frame, alpha, hint, &mut joints);
        }
        Ok(joints)
    }
}

impl Primitive for LwrInvKin {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let inputs = self.hint.get(cycle).zip(self.frame.get(cycle));
        let solved = inputs.map(|(hint, frame)| {
            let nullspace = self.nullspace.get_or(cycle, hint);
            self.solve(&frame, &hint, &nullspace)
        });
        let joints = solved.and_then(Result::ok);
        for (i, out) in self.joints.iter().enumerate() {
            out.set(cycle, joints.map(|joints| joints[i]));
        }
        self.error.set(cycle, solved.map(number));
    }
}

fn lwr_inv_kin() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<LwrInvKin, Fault> {
        let strategy = match b.number("Strategy", 0..=1)? {
            0 => Strategy::Keep,
            _ => Strategy::Approach,
        };
        Ok(LwrInvKin {
            arm: lwr(b)?,
            strategy,
            frame: b.input("inFrame")?,
            hint: Seven::new(b, HINT)?,
            nullspace: Seven::new(b, NULLSPACE)?,
            joints: OUT.map(|name| b.output(name)),
            error: b.output("outError"),
        })
    };
    let definition = Definition::new(
        "KUKA::LWR::InvKin",
        "Joint positions of an LWR within their limits that bring its flange to a frame, at the arm \
         angle of the null-space joints as far as limits allow.",
        build,
    )
    .active()
    .input::<Frame>(port("inFrame", "flange in the base of the arm, m").required());
    let definition = with_seven(
        definition,
        HINT,
        "hint: prefer the solution nearest to this joint position, rad",
    );
    let nullspace = "joint position that sets the arm angle, rad; the hint if null";
    let add = |d: Definition, name| d.input::<f64>(port(name, nullspace));
    let definition = NULLSPACE
        .into_iter()
        .fold(definition, add)
        .parameter::<i32>(
            "Strategy",
            "1",
            "0 keeps the arm angle, 1 moves it to where the joints are nearer to the hint",
        );
    let add = |d: Definition, name| d.output::<f64>(name, "joint position, rad");
    OUT.into_iter()
        .fold(definition.text("Robot", ROBOT), add)
        .output::<i32>("outError", ERROR)
        .null(NullRule::Own(
            "Null in gives null out. Without a solution the joints are null; outError is the reason.",
        ))
}

struct LwrVelKin {
    arm: Srs,
    joints: Seven,
    velocities: Seven,
    twist: Out<Twist>,
    alpha: Out<f64>,
}

impl Primitive for LwrVelKin {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let inputs = self.joints.get(cycle).zip(self.velocities.get(cycle));
        let moving = inputs.map(|(joints, velocities)| self.arm.velocity(&joints, &velocities));
        let is_number = |twist: &Twist| twist.vel.iter().chain(&twist.rot).all(|v| v.is_finite());
        let moving = moving.filter(|(twist, _)| is_number(twist));
        self.twist.set(cycle, moving.map(|(twist, _)| twist));
        self.alpha.set(cycle, moving.and_then(|(_, alpha)| alpha));
    }
}

fn lwr_vel_kin() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<LwrVelKin, Fault> {
        Ok(LwrVelKin {
            arm: lwr(b)?,
            joints: Seven::new(b, JOINTS)?,
            velocities: Seven::new(b, VELOCITIES)?,
            twist: b.output("outTwist"),
            alpha: b.output("outVAlpha"),
        })
    };
    let definition = Definition::new(
        "KUKA::LWR::VelKin",
        "The velocities of the flange and of the arm angle of an LWR at given joint velocities.",
        build,
    )
    .active();
    let definition = with_seven(definition, JOINTS, "joint position, rad");
    with_seven(definition, VELOCITIES, "joint velocity, rad/s")
        .text("Robot", ROBOT)
        .output::<Twist>(
            "outTwist",
            "velocity of the flange in the base, m/s and rad/s",
        )
        .output::<f64>("outVAlpha", "velocity of the arm angle, rad/s")
        .null(NullRule::Own(
            "Null if an input is null or not a number; outVAlpha also where the arm angle has no \
             derivative: stretched, or the wrist on axis 1.",
        ))
}

struct VelKin {
    kinematics: Arc<dyn Kinematics>,
    joints: ArrayIn<f64>,
    velocities: ArrayIn<f64>,
    accelerations: Option<ArrayIn<f64>>,
    tool: Frame,
    values: Box<[f64]>,
    rates: [Box<[f64]>; 2],
    columns: Box<[Twist]>,
    twist: Out<Twist>,
    acceleration: Out<Twist>,
}

impl VelKin {
    /// Velocity and acceleration of the tool at the copied joints.
    fn motion(&mut self) -> [Twist; 2] {
        self.kinematics.jacobian(&self.values, &mut self.columns);
        let [velocities, accelerations] = &self.rates;
        let (mut velocity, mut acceleration) = (Twist::default(), Twist::default());
        for ((column, rate), change) in self.columns.iter().zip(velocities).zip(accelerations) {
            // The axes before this one turn it and its lever; so do they with its share of what moves further out.
            let turning = velocity.rot * 2.0 + column.rot * *rate;
            acceleration.vel += column.vel * *change + turning.cross(&column.vel) * *rate;
            acceleration.rot += column.rot * *change + velocity.rot.cross(&column.rot) * *rate;
            velocity.vel += column.vel * *rate;
            velocity.rot += column.rot * *rate;
        }
        if self.tool.translation.vector.norm_squared() > 0.0 {
            let flange = self.kinematics.forward(&self.values);
            let lever = flange.rotation * self.tool.translation.vector;
            let around = velocity.rot.cross(&lever);
            velocity.vel += around;
            acceleration.vel += acceleration.rot.cross(&lever) + velocity.rot.cross(&around);
        }
        [velocity, acceleration]
    }
}

impl Primitive for VelKin {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let [rates, changes] = &mut self.rates;
        let joints = copy(&self.joints, cycle, &mut self.values);
        let moving = joints.and_then(|()| copy(&self.velocities, cycle, rates));
        let changing = self
            .accelerations
            .as_ref()
            .is_none_or(|port| copy(port, cycle, changes).is_some());
        let motion = moving.map(|()| self.motion());
        let is_number = |twist: &Twist| twist.vel.iter().chain(&twist.rot).all(|v| v.is_finite());
        let velocity = motion.map(|[velocity, _]| velocity).filter(is_number);
        let acceleration = motion.filter(|_| changing).map(|[_, rate]| rate);
        self.twist.set(cycle, velocity);
        self.acceleration.set(cycle, acceleration.filter(is_number));
    }
}

fn vel_kin() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<VelKin, Fault> {
        let kinematics = b.kinematics("Robot")?;
        let joints = kinematics.joints();
        let tool: Frame = b.value("Tool")?;
        if !is_finite(&tool) {
            let why = "the numbers of this frame are not finite".to_owned();
            return Err(b.parameter_fault("Tool", why));
        }
        let accelerations = b.is_linked("inAccelerations").then_some("inAccelerations");
        let accelerations = accelerations.map(|name| joints_input(b, name, &*kinematics));
        Ok(VelKin {
            joints: joints_input(b, "inJoints", &*kinematics)?,
            velocities: joints_input(b, "inVelocities", &*kinematics)?,
            accelerations: accelerations.transpose()?,
            tool,
            values: vec![0.0; joints].into(),
            rates: [vec![0.0; joints].into(), vec![0.0; joints].into()],
            columns: vec![Twist::default(); joints].into(),
            twist: b.output("outTwist"),
            acceleration: b.output("outAcceleration"),
            kinematics,
        })
    };
    Definition::new(
        "ArmKinematics::VelKin",
        "The velocity and acceleration of the flange of an arm, or of a tool at it, at given rates of its joints.",
        build,
    )
    .active()
    .array_input::<f64>(port("inJoints", "joint positions, rad").required())
    .array_input::<f64>(port("inVelocities", "joint velocities, rad/s").required())
    .array_input::<f64>(port(
        "inAccelerations",
        "joint accelerations, rad/s²; 0 if not connected",
    ))
    .text("Robot", ROBOT)
    .parameter::<Frame>("Tool", "{}", "frame in the flange whose motion it is, m")
    .output::<Twist>(
        "outTwist",
        "velocity of the flange or the tool in the base, m/s and rad/s",
    )
    .output::<Twist>("outAcceleration", "its acceleration, m/s² and rad/s²")
    .null(NullRule::Own(
        "Null if an input is null or not a number; inAccelerations concerns outAcceleration only.",
    ))
}

/// Cost bound of a forward solution.
const FORWARD_NS: u32 = 3_000;
/// Cost bound of an inverse: seven axes where limits force the arm angle.
const INVERSE_NS: u32 = 60_000;
/// Cost bound of an inverse that searches for a better arm angle: up to 16 of the simple ones, of
/// which few reach the limits.
const APPROACH_NS: u32 = 150_000;

pub(crate) fn table() -> Vec<Definition> {
    vec![
        kin().cost_ns(FORWARD_NS),
        inv_kin().cost_ns(INVERSE_NS),
        vel_kin().cost_ns(FORWARD_NS),
        lwr_kin().cost_ns(FORWARD_NS),
        lwr_inv_kin().cost_ns(APPROACH_NS),
        lwr_vel_kin().cost_ns(FORWARD_NS),
    ]
}

//! `Motion::Ptp`: all joints from one position to another, synchronised. The path of the flange is
//! not considered.

use takt_net::definition::port;
use takt_net::{
    ArrayIn, ArrayOut, Build, Cycle, Definition, Fault, FaultKind, NullRule, Primitive,
};

use super::bounds::{Bounds, State};
use super::course::{Course, Departure, Geometry, Group, MOSTLY, Progress, WHOLE, stopping_ways};
use super::lead::Lead;
use super::runner::{Runner, with_ports};
use super::{joint_bounds, joint_positions, slowed, speed, with_joint_limits};

/// A straight line in joint space.
#[derive(Clone, Debug)]
pub(super) struct JointLine {
    pub(super) from: Box<[f64]>,
    pub(super) to: Box<[f64]>,
    pub(super) bounds: Box<[Bounds]>,
    /// Bounds of what brakes.
    braking: Box<[Bounds]>,
    /// Deviations at the beginning.
    off: Box<[State]>,
    /// How far they move until they are at rest, rad.
    ways: Box<[f64]>,
}

/// Rounds in which a line is found that begins where the motion beside it ends: its direction depends on where that is.
const ROUNDS: usize = 4;

impl JointLine {
    /// A line of as many joints as each of these has, with bounds at a part of the speed.
    pub(super) fn new(from: Box<[f64]>, to: Box<[f64]>, bounds: Box<[Bounds]>, speed: f64) -> Self {
        Self {
            braking: bounds.iter().map(|bounds| bounds.braking(speed)).collect(),
            off: vec![State::default(); to.len()].into(),
            ways: vec![0.0; to.len()].into(),
            from,
            to,
            bounds,
        }
    }

    fn distances(&self) -> impl Iterator<Item = f64> {
        let ends = self.from.iter().zip(&self.to);
        ends.map(|(from, to)| to - from)
    }

    /// Begins a course in these states: on a line that begins where what does not move along it comes to rest, so that
    /// no joint needs a way back. Joints that are beyond the bounds of a slower motion brake into them within the whole limits.
    pub(super) fn begin(&mut self, course: &mut Course, joints: &[State], speed: f64) {
        let mut pairs = self.bounds.iter().zip(joints);
        let are_beyond = pairs.any(|(bounds, joint)| bounds.are_exceeded(*joint));
        if course.speed() < 1.0 && are_beyond {
            std::mem::swap(&mut self.bounds, &mut self.braking);
            self.begin_within(course, joints, speed, true);
            std::mem::swap(&mut self.bounds, &mut self.braking);
        } else {
            self.begin_within(course, joints, speed, false);
        }
    }

    fn begin_within(
        &mut self,
        course: &mut Course,
        joints: &[State],
        speed: f64,
        are_beyond: bool,
    ) {
        let (mut off, mut ways) = (
            std::mem::take(&mut self.off),
            std::mem::take(&mut self.ways),
        );
        ways.fill(0.0);
        for _ in 0..ROUNDS {
            self.start_beside(joints, &ways);
            let along = self.depart(joints, &mut off);
            stopping_ways(
                self,
                &Departure {
                    along,
                    off: &off,
                    join: None,
                },
                &mut ways,
            );
        }
        self.start_beside(joints, &ways);
        let along = self.depart(joints, &mut off);
        let departure = Departure {
            along,
            off: &off,
            join: None,
        };
        if are_beyond {
            let (_, gentle) = self.along_within(&self.braking, WHOLE);
            course.begin_beyond(self, &departure, speed, gentle);
        } else {
            course.begin(self, &departure, speed);
        }
        (self.off, self.ways) = (off, ways);
    }

    fn start_beside(&mut self, joints: &[State], ways: &[f64]) {
        for ((start, state), way) in self.from.iter_mut().zip(joints).zip(ways) {
            *start = state.position + way;
        }
    }

    /// The motion along the line, and the deviations from it, of joints in these states: along the line as fast as
    /// fits the joints best, relative to their limits.
    fn depart(&self, joints: &[State], off: &mut [State]) -> State {
        let (length, along) = self.along(WHOLE);
        let is_line = length > 0.0;
        let (mut forwards, mut speed, mut lasting, mut acceleration) = (0.0, 0.0, 0.0, 0.0);
        for ((distance, bounds), joint) in self.distances().zip(&self.bounds).zip(joints) {
            let weight = distance / length / bounds.velocity.powi(2);
            let gained = joint.acceleration * joint.acceleration.abs() / (2.0 * bounds.jerk);
            forwards += distance / length * weight;
            speed += joint.velocity * weight;
            lasting += (joint.velocity + gained) * weight;
            acceleration += joint.acceleration * weight;
        }
        // A joint that moves against the line deviates by more than its own velocity, but not by more than its limit.
        let against = |((distance, bounds), joint): ((f64, &Bounds), &State)| {
            let part = distance / length;
            let gained = joint.acceleration.powi(2) / bounds.jerk;
            let rest = (bounds.velocity - joint.velocity.abs() - gained).max(0.0);
            if part * joint.velocity < 0.0 {
                rest / part.abs()
            } else {
                f64::INFINITY
            }
        };
        let pairs = || self.distances().zip(&self.bounds).zip(joints);
        let most = pairs().map(against).fold(along.velocity, f64::min);
        let along = if is_line {
            let along_line = acceleration / forwards;
            let beside = |((distance, bounds), joint): ((f64, &Bounds), &State)| {
                (joint.acceleration - distance / length * along_line).abs() / bounds.acceleration
            };
            let rest = pairs().map(beside).fold(0.0, f64::max);
            let is_mostly_along =
                speed > 0.0 && rest <= MOSTLY * along_line.abs() / along.acceleration;
            // Where less than most of it is along the line, the deviation gets all of the acceleration: one of the two
            // needs the jerk. With it, the deviation gets the velocity that ends with the acceleration.
            let (speed, acceleration) = if is_mostly_along {
                (speed, along_line)
            } else {
                (lasting, 0.0)
            };
            State {
                position: 0.0,
                velocity: (speed / forwards).max(0.0).min(most),
                acceleration,
            }
        } else {
            State::default()
        };
        for (((distance, start), joint), off) in
            self.distances().zip(&self.from).zip(joints).zip(off)
        {
            let part = if is_line { distance / length } else { 0.0 };
            *off = State {
                position: joint.position - start,
                velocity: joint.velocity - part * along.velocity,
                acceleration: joint.acceleration - part * along.acceleration,
            };
        }
        along
    }

    /// The length is measured by the joint with the longest distance, rad.
    fn along_within(&self, bounds: &[Bounds], parts: [f64; 2]) -> (f64, Bounds) {
        let distances = || self.distances().map(f64::abs);
        let length = distances().fold(0.0, f64::max);
        let along = distances()
            .zip(bounds)
            .filter(|(distance, _)| *distance > 0.0);
        let along = along.map(|(distance, bounds)| bounds.slower(parts).scaled(length / distance));
        (length, along.reduce(Bounds::and).unwrap_or(bounds[0]))
    }

    /// The state of a joint.
    pub(super) fn at(&self, joint: usize, progress: Progress, lead: Option<&Lead>) -> State {
        let (from, to) = (self.from[joint], self.to[joint]);
        let off = lead.map_or_else(State::default, |lead| lead.now(joint));
        State {
            position: from * (1.0 - progress.part) + to * progress.part + off.position,
            velocity: (to - from) * progress.rate + off.velocity,
            acceleration: (to - from) * progress.acceleration + off.acceleration,
        }
    }
}

impl Geometry for JointLine {
    fn along(&self, parts: [f64; 2]) -> (f64, Bounds) {
        self.along_within(&self.bounds, parts)
    }

    fn groups(&self) -> usize {
        self.bounds.len()
    }

    fn group(&self, number: usize) -> Group {
        Group {
            first: number,
            axes: 1,
            bounds: self.bounds[number],
        }
    }

    fn speed(&self, _part: f64, rate: f64, off: &[f64]) -> f64 {
        let joints = self.distances().zip(off).zip(&self.bounds);
        let speeds =
            joints.map(|((distance, off), bounds)| (distance * rate + off).abs() / bounds.velocity);
        speeds.fold(0.0, f64::max)
    }
}

/// In ports of the state in which joints begin.
pub(super) struct JointsFrom {
    position: ArrayIn<f64>,
    velocity: Option<ArrayIn<f64>>,
    acceleration: Option<ArrayIn<f64>>,
    pub(super) states: Box<[State]>,
}

impl JointsFrom {
    /// `None` if `inFrom` is not connected.
    pub(super) fn new(b: &mut Build<'_, '_>) -> Result<Option<Self>, Fault> {
        let rates = ["inFromVelocity", "inFromAcceleration"];
        if !b.is_linked("inFrom") {
            return match rates.into_iter().find(|name| b.is_linked(name)) {
                Some(name) => Err(b.parameter_fault("From", incomplete(name))),
                None => Ok(None),
            };
        }
        let position = b.array_input::<f64>("inFrom")?;
        let joints = position.len();
        let mut rate = |name: &'static str| -> Result<Option<ArrayIn<f64>>, Fault> {
            let port = b.is_linked(name).then(|| b.array_input::<f64>(name));
            let port = port.transpose()?;
            if let Some(found) = port.as_ref().map(ArrayIn::len).filter(|len| *len != joints) {
                let message =
                    format!("{name} carries {found} elements, but inFrom carries {joints}");
                return Err(b.fault(FaultKind::ArraySize(message)));
            }
            Ok(port)
        };
        let [velocity, acceleration] = rates;
        Ok(Some(Self {
            position,
            velocity: rate(velocity)?,
            acceleration: rate(acceleration)?,
            states: vec![State::default(); joints].into(),
        }))
    }

    /// Whether they fit a motion of that many joints.
    pub(super) fn fits(&self, b: &Build<'_, '_>, joints: usize) -> Result<(), Fault> {
        let found = self.states.len();
        if found == joints {
            return Ok(());
        }
        let message =
            format!("inFrom carries {found} elements, but the motion has {joints} joints");
        Err(b.fault(FaultKind::ArraySize(message)))
    }

    /// Reads the state of this cycle; returns whether it is one.
    pub(super) fn read(&mut self, cycle: &Cycle<'_>) -> bool {
        let Some(positions) = self.position.get(cycle) else {
            return false;
        };
        for (state, position) in self.states.iter_mut().zip(positions) {
            *state = State::at_rest(position.get());
        }
        if let Some(port) = &self.velocity {
            let Some(values) = port.get(cycle) else {
                return false;
            };
            for (state, value) in self.states.iter_mut().zip(values) {
                state.velocity = value.get();
            }
        }
        if let Some(port) = &self.acceleration {
            let Some(values) = port.get(cycle) else {
                return false;
            };
            for (state, value) in self.states.iter_mut().zip(values) {
                state.acceleration = value.get();
            }
        }
        self.states.iter().all(|state| state.is_sensible())
    }
}

/// Why a motion cannot begin with this port and without `inFrom`.
pub(super) fn incomplete(port: &str) -> String {
    format!("{port} is connected, inFrom is not: a motion begins in a whole state")
}

/// Adds the in ports of the state in which joints begin.
pub(super) fn with_joints_from(definition: Definition) -> Definition {
    definition
        .array_input::<f64>(port(
            "inFrom",
            "position of each joint in the previous cycle, rad; taken in the first active cycle, instead of From",
        ))
        .array_input::<f64>(port(
            "inFromVelocity",
            "velocity of each joint there, rad/s; at rest if not connected",
        ))
        .array_input::<f64>(port(
            "inFromAcceleration",
            "acceleration of each joint there, rad/s²; 0 if not connected",
        ))
}

struct Ptp {
    runner: Runner,
    line: JointLine,
    from: Option<JointsFrom>,
    position: ArrayOut<f64>,
    velocity: ArrayOut<f64>,
    acceleration: ArrayOut<f64>,
}

impl Ptp {
    /// Begins in the state at the ports; returns whether the motion has begun.
    fn begin(&mut self, cycle: &Cycle<'_>, speed: f64) -> bool {
        let Some(from) = &mut self.from else {
            return true;
        };
        if !from.read(cycle) {
            return false;
        }
        self.line
            .begin(&mut self.runner.course, &from.states, speed);
        true
    }
}

impl Primitive for Ptp {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if let Some(speed) = self.runner.begins(cycle)
            && !self.begin(cycle, speed)
        {
            self.runner.wait(cycle);
            for out in [&self.position, &self.velocity, &self.acceleration] {
                out.set_null(cycle);
            }
            return;
        }
        let progress = self.runner.step(cycle);
        let lead = self.runner.course.lead();
        let states = || (0..self.line.to.len()).map(|joint| self.line.at(joint, progress, lead));
        self.position
            .set(cycle, states().map(|state| state.position));
        self.velocity
            .set(cycle, states().map(|state| state.velocity));
        self.acceleration
            .set(cycle, states().map(|state| state.acceleration));
    }
}

fn build(b: &mut Build<'_, '_>) -> Result<Ptp, Fault> {
    let given = |b: &Build<'_, '_>, parameter| b.array::<f64>(parameter).map(|values| values.len());
    let from = JointsFrom::new(b)?;
    let present = from.as_ref().map_or(0, |from| from.states.len());
    let joints = given(b, "From")?.max(given(b, "To")?).max(present);
    if joints == 0 {
        return Err(b.parameter_fault("From", "a motion needs at least one joint".to_owned()));
    }
    let speed = speed(b)?;
    let bounds = joint_bounds(b, joints)?;
    let bounds = bounds
        .into_iter()
        .map(|bounds| slowed(b, bounds, speed))
        .collect::<Result<_, _>>()?;
    let line = JointLine::new(
        joint_positions(b, "From", joints)?.into(),
        joint_positions(b, "To", joints)?.into(),
        bounds,
        speed,
    );
    if let Some(from) = &from {
        from.fits(b, joints)?;
    }
    Ok(Ptp {
        runner: Runner::new(
            b,
            line.along(WHOLE),
            speed,
            from.is_some().then_some(joints),
        )?,
        line,
        from,
        position: b.array_output("outPosition", joints)?,
        velocity: b.array_output("outVelocity", joints)?,
        acceleration: b.array_output("outAcceleration", joints)?,
    })
}

pub(super) fn definition() -> Definition {
    let definition = Definition::new(
        "Motion::Ptp",
        "Moves joints from one position to another along a straight line in the space of the \
         joints, as fast as the limits of all of them allow; they start and arrive together. It may begin in motion.",
        build,
    )
    .array_parameter::<f64>("From", "[0]", "position of each joint at the start, rad")
    .array_parameter::<f64>("To", "[0]", "position of each joint at the end, rad")
    .array_output::<f64>("outPosition", "position of each joint, rad")
    .array_output::<f64>("outVelocity", "velocity of each joint, rad/s")
    .array_output::<f64>("outAcceleration", "acceleration of each joint, rad/s²");
    let definition = with_joints_from(with_joint_limits(definition));
    with_ports(definition).null(NullRule::Own(
        "Never null while active, once begun; a null override holds the motion. It begins when inFrom and the ports of \
         its rates, where connected, are numbers.",
    ))
}

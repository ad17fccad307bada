//! `Motion::Trajectory`: joints along a table of points with times, as planners such as MoveIt 2 make them. It brakes on its path,
//! and compares what is measured with what is commanded in each cycle. Whether a table suits an arm is checked by
//! [`plan`] before, not here.

mod table;
#[cfg(test)]
mod tests;

use takt_net::definition::port;
use takt_net::{ArrayIn, ArrayOut, Build, Cycle, Definition, Fault, In, NullRule, Out, Primitive};

pub use table::{Excess, Planned, Quantity, Table, TrajectoryError, Waypoint, plan};

use super::bounds::{Bounds, State};
use super::profile::Profile;
use super::ptp::{JointsFrom, with_joints_from};
use super::{joint_bounds, with_joint_limits};

/// Why a trajectory ended, at `outCode`; those of `control_msgs/FollowJointTrajectory`, and two of its own.
pub mod code {
    /// It goes on, or is at its end.
    pub const NONE: i32 = 0;
    /// It was stopped.
    pub const STOPPED: i32 = 1;
    /// The joints were elsewhere when it began, or moved otherwise.
    pub const ELSEWHERE: i32 = 2;
    /// Too far from the trajectory on the way.
    pub const PATH: i32 = -4;
    /// Too far from the goal at the end.
    pub const GOAL: i32 = -5;
}

/// Deviation of positions at the beginning that is rounding, rad.
const SAME: f64 = 1e-6;
/// Deviation of velocities at the beginning that is rounding, rad/s: they are known from differences of set-points.
const SAME_VELOCITY: f64 = 1e-3;
/// Rate of the trajectory's time below which it stands.
const STANDS: f64 = 1e-6;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Until the state at the ports is known.
    Waiting,
    Following,
    /// On the path, to rest.
    Braking,
    /// Beside the path, to rest.
    Stray,
    /// At the end, until the measured positions are there.
    Settling,
    Ended,
}

/// Why it ends.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Cause {
    code: i32,
    joint: i32,
    amount: f64,
}

struct Trajectory {
    table: Table,
    bounds: Box<[Bounds]>,
    /// Deviations at the beginning, or the way to rest beside the path.
    off: Box<[Profile]>,
    from: Option<JointsFrom>,
    measured: Option<ArrayIn<f64>>,
    stop: In<bool>,
    reset: In<bool>,
    path: Box<[f64]>,
    goal: Box<[f64]>,
    goal_time: f64,
    start: f64,
    /// Whether it also begins in motion, or elsewhere.
    joins: bool,
    period_s: f64,
    phase: Phase,
    /// Along the table, s.
    time: f64,
    /// Seconds of the table per second, and its change.
    rate: f64,
    slowing: f64,
    /// Since the end of the table, s.
    over: f64,
    cause: Cause,
    /// What was commanded last.
    states: Box<[State]>,
    outs: Outs,
}

struct Outs {
    position: ArrayOut<f64>,
    velocity: ArrayOut<f64>,
    acceleration: ArrayOut<f64>,
    time: Out<f64>,
    following: Out<bool>,
    done: Out<bool>,
    code: Out<i32>,
    joint: Out<i32>,
    deviation: Out<f64>,
}

fn number(joint: usize) -> i32 {
    i32::try_from(joint).unwrap_or(-1)
}

impl Trajectory {
    fn restart(&mut self) {
        self.phase = Phase::Waiting;
        (self.time, self.rate, self.slowing, self.over) = (0.0, 1.0, 0.0, 0.0);
        self.cause = Cause::default();
        for (joint, (off, state)) in self.off.iter_mut().zip(&mut self.states).enumerate() {
            off.reset(0.0);
            *state = State::at_rest(self.table.start(joint).position);
        }
    }

    /// Begins in the state at the ports; returns whether that is known.
    fn begin(&mut self, cycle: &Cycle<'_>) -> bool {
        self.phase = Phase::Following;
        let Some(from) = &mut self.from else {
            return true;
        };
        if !from.read(cycle) {
            self.phase = Phase::Waiting;
            return false;
        }
        let (mut most, mut worst) = (0.0, 0);
        let mut moves = false;
        for (joint, (state, bounds)) in from.states.iter().zip(&self.bounds).enumerate() {
            let wanted = self.table.start(joint);
            let deviation = (state.position - wanted.position).abs();
            if deviation > most {
                (most, worst) = (deviation, joint);
            }
            let slack = 2.0 * bounds.acceleration * self.period_s + SAME_VELOCITY;
            moves |= (state.velocity - wanted.velocity).abs() > slack;
        }
        if self.joins && self.table.join(&from.states, &self.bounds).is_ok() {
            return true;
        }
        if most > self.start || moves {
            self.phase = Phase::Stray;
            self.cause = Cause {
                code: code::ELSEWHERE,
                joint: number(worst),
                amount: most,
            };
            for (off, state) in self.off.iter_mut().zip(&from.states) {
                off.start(*state);
            }
        } else if most > SAME {
            for (joint, (off, state)) in self.off.iter_mut().zip(&from.states).enumerate() {
                let deviation = state.position - self.table.start(joint).position;
                off.begin(State::at_rest(deviation), 0.0, 1.0);
            }
        }
        true
    }

    /// The joint that deviates most in relation to its tolerance, if that is exceeded.
    fn exceeded(&self, cycle: &Cycle<'_>, tolerances: &[f64]) -> Option<(i32, f64)> {
        let measured = self.measured.as_ref()?.get(cycle)?;
        let pairs = self.states.iter().zip(measured).zip(tolerances);
        let mut found: Option<(usize, f64, f64)> = None;
        for (joint, ((wanted, measured), tolerance)) in pairs.enumerate() {
            let deviation = (measured.get() - wanted.position).abs();
            let share = deviation / tolerance;
            if *tolerance > 0.0 && share > 1.0 && found.is_none_or(|(_, _, most)| share > most) {
                found = Some((joint, deviation, share));
            }
        }
        found.map(|(joint, deviation, _)| (number(joint), deviation))
    }

    fn brake(&mut self, cause: Cause) {
        self.phase = Phase::Braking;
        self.cause = cause;
    }

    fn follow(&mut self, cycle: &Cycle<'_>) {
        if self.stop.get(cycle) == Some(true) {
            self.brake(Cause {
                code: code::STOPPED,
                joint: -1,
                amount: 0.0,
            });
        } else if let Some((joint, amount)) = self.exceeded(cycle, &self.path) {
            let code = code::PATH;
            self.brake(Cause {
                code,
                joint,
                amount,
            });
        }
    }

    /// How fast the time may slow down now, 1/s, so that no joint exceeds its acceleration, and 1/s² how fast that may change.
    fn strongest(&self) -> (f64, f64) {
        let piece = self.table.piece_at(self.time);
        let (mut most, mut jerk) = (f64::INFINITY, f64::INFINITY);
        for (joint, bounds) in self.bounds.iter().enumerate() {
            let state = self.table.in_piece(piece, joint, self.time);
            let speed = state.velocity.abs();
            if speed < 1e-9 {
                continue;
            }
            let curve = state.acceleration * self.rate * self.rate;
            // The joint decelerates by speed times this, beside what the path itself takes.
            let along = curve * state.velocity.signum();
            most = most.min((bounds.acceleration + along).max(0.0) / speed);
            jerk = jerk.min(bounds.jerk / speed);
        }
        (most, jerk)
    }

    /// A cycle of braking: the time of the table runs slower, until it stands.
    fn slow_down(&mut self) {
        let (most, jerk) = self.strongest();
        if most.is_infinite() {
            // No joint moves.
            (self.rate, self.slowing) = (0.0, 0.0);
            return;
        }
        let dt = self.period_s;
        let ends = (2.0 * jerk * self.rate).sqrt();
        let wanted = most.min(ends).min(self.slowing + jerk * dt);
        let next = (self.rate - wanted * dt).max(0.0);
        self.time += (self.rate + next) / 2.0 * dt;
        self.slowing = (self.rate - next) / dt;
        self.rate = next;
        if self.rate < STANDS {
            (self.rate, self.slowing) = (0.0, 0.0);
        }
    }

    fn advance(&mut self) {
        match self.phase {
            Phase::Following => self.time += self.period_s,
            Phase::Braking => self.slow_down(),
            Phase::Settling => self.over += self.period_s,
            Phase::Waiting | Phase::Stray | Phase::Ended => {}
        }
        if self.phase != Phase::Ended {
            self.off.iter_mut().for_each(Profile::advance);
        }
        let is_over = self.time >= self.table.duration() - self.period_s * 1e-6;
        let rests = self.off.iter().all(Profile::is_at_rest);
        let stands = is_over || self.rate <= 0.0;
        let next = match self.phase {
            Phase::Following => is_over.then_some(Phase::Settling),
            Phase::Braking => (stands && rests).then_some(Phase::Ended),
            Phase::Stray => rests.then_some(Phase::Ended),
            Phase::Waiting | Phase::Settling | Phase::Ended => None,
        };
        self.phase = next.unwrap_or(self.phase);
    }

    /// A cycle at the end.
    fn settle(&mut self, cycle: &Cycle<'_>) {
        if self.stop.get(cycle) == Some(true) {
            self.cause.code = code::STOPPED;
            self.phase = Phase::Ended;
            return;
        }
        let rests = self.off.iter().all(Profile::is_at_rest);
        // An arm that reports no position is not known to be there.
        let matters = self.goal.iter().any(|tolerance| *tolerance > 0.0);
        let is_null = |it: &ArrayIn<f64>| it.get(cycle).is_none();
        let is_unknown = matters && self.measured.as_ref().is_some_and(is_null);
        let missed = self.exceeded(cycle, &self.goal);
        let missed = missed.or_else(|| is_unknown.then_some((-1, 0.0)));
        match missed {
            None if rests => self.phase = Phase::Ended,
            Some((joint, amount)) if self.goal_time >= 0.0 && self.over > self.goal_time => {
                self.cause = Cause {
                    code: code::GOAL,
                    joint,
                    amount,
                };
                self.phase = Phase::Ended;
            }
            _ => {}
        }
    }

    fn state(&self, piece: usize, joint: usize) -> State {
        let off = self
            .off
            .get(joint)
            .map_or_else(State::default, Profile::now);
        if self.cause.code == code::ELSEWHERE {
            return off;
        }
        let on = self.table.in_piece(piece, joint, self.time);
        State {
            position: on.position + off.position,
            velocity: on.velocity * self.rate + off.velocity,
            acceleration: on.acceleration * self.rate * self.rate - on.velocity * self.slowing
                + off.acceleration,
        }
    }

    fn write(&mut self, cycle: &Cycle<'_>) {
        let piece = self.table.piece_at(self.time);
        for joint in 0..self.states.len() {
            let now = self.state(piece, joint);
            if let Some(state) = self.states.get_mut(joint) {
                *state = now;
            }
        }
        let (outs, states) = (&self.outs, &self.states);
        outs.position
            .set(cycle, states.iter().map(|it| it.position));
        outs.velocity
            .set(cycle, states.iter().map(|it| it.velocity));
        outs.acceleration
            .set(cycle, states.iter().map(|it| it.acceleration));
        outs.time.set(cycle, self.time.min(self.table.duration()));
        let rests = self.off.iter().all(Profile::is_at_rest);
        let follows = self.phase == Phase::Following && rests;
        outs.following.set(cycle, follows);
        outs.done.set(cycle, self.phase == Phase::Ended);
        outs.code.set(cycle, self.cause.code);
        outs.joint.set(cycle, self.cause.joint);
        outs.deviation.set(cycle, self.cause.amount);
    }
}

impl Primitive for Trajectory {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.restart();
        }
        if self.phase == Phase::Waiting && !self.begin(cycle) {
            let outs = &self.outs;
            for out in [&outs.position, &outs.velocity, &outs.acceleration] {
                out.set_null(cycle);
            }
            outs.time.set(cycle, None);
            outs.following.set(cycle, false);
            outs.done.set(cycle, false);
            outs.code.set(cycle, code::NONE);
            outs.joint.set(cycle, -1);
            outs.deviation.set(cycle, 0.0);
            return;
        }
        if self.phase == Phase::Following {
            self.follow(cycle);
        }
        if self.phase == Phase::Settling {
            self.settle(cycle);
        }
        self.advance();
        self.write(cycle);
    }
}

fn tolerances(
    b: &Build<'_, '_>,
    parameter: &'static str,
    joints: usize,
) -> Result<Box<[f64]>, Fault> {
    let mut values: Vec<f64> = b.array(parameter)?;
    if let [all] = *values {
        values.resize(joints, all);
    }
    if values.len() == joints && values.iter().all(|value| value.is_finite()) {
        return Ok(values.into());
    }
    let why = format!("one tolerance for each of {joints} joints, or one for all");
    Err(b.parameter_fault(parameter, why))
}

fn build(b: &mut Build<'_, '_>) -> Result<Trajectory, Fault> {
    let joints = b.number("Joints", 1..=table::JOINTS_MAX)?;
    let table = Table::parse(b.text("Table"), joints)
        .map_err(|error| b.parameter_fault("Table", error.to_string()))?;
    b.take_memory(table.bytes())?;
    let bounds = joint_bounds(b, joints)?;
    let from = JointsFrom::new(b)?;
    if let Some(from) = &from {
        from.fits(b, joints)?;
    }
    let measured = if b.is_linked("inMeasured") {
        let measured = b.array_input::<f64>("inMeasured")?;
        if measured.len() != joints {
            let why = format!("inMeasured has {} values", measured.len());
            return Err(b.parameter_fault("Joints", why));
        }
        Some(measured)
    } else {
        None
    };
    let period_s = b.period_s();
    let profile = |bounds: &Bounds| Profile::new(0.0, *bounds, period_s);
    let mut trajectory = Trajectory {
        off: bounds.iter().map(profile).collect(),
        bounds: bounds.into(),
        from,
        measured,
        stop: b.input("inStop")?,
        reset: b.input("inReset")?,
        path: tolerances(b, "PathTolerance", joints)?,
        goal: tolerances(b, "GoalTolerance", joints)?,
        goal_time: b.value("GoalTime")?,
        start: b.value("StartTolerance")?,
        joins: b.value("Join")?,
        period_s,
        phase: Phase::Waiting,
        time: 0.0,
        rate: 1.0,
        slowing: 0.0,
        over: 0.0,
        cause: Cause::default(),
        states: vec![State::default(); joints].into(),
        outs: Outs {
            position: b.array_output("outPosition", joints)?,
            velocity: b.array_output("outVelocity", joints)?,
            acceleration: b.array_output("outAcceleration", joints)?,
            time: b.output("outTime"),
            following: b.output("outFollowing"),
            done: b.output("outDone"),
            code: b.output("outCode"),
            joint: b.output("outJoint"),
            deviation: b.output("outDeviation"),
        },
        table,
    };
    trajectory.restart();
    Ok(trajectory)
}

pub(super) fn definition() -> Definition {
    let definition = Definition::new(
        "Motion::Trajectory",
        "Moves joints along points with times, by quintic or cubic polynomials between them. A stop, or a deviation beyond \
         a tolerance, brakes on the path within the limits of acceleration. It may begin in motion.",
        build,
    )
    .stateful()
    .input::<bool>(port(
        "inStop",
        "true ends the motion: it brakes on its path and stays at rest until inReset",
    ))
    .array_input::<f64>(port(
        "inMeasured",
        "measured position of each joint, rad; without it no tolerance is checked",
    ))
    .parameter::<i32>("Joints", "1", "number of joints, 1 to 64")
    .text_with_default(
        "Table",
        "0 0 0/1 0 0",
        "up to 10,001 points divided by /: time (s) from 0 on, positions (rad), velocities (rad/s) and, if any, accelerations (rad/s²) of all joints",
    )
    .array_parameter::<f64>(
        "PathTolerance",
        "[0]",
        "largest deviation on the way by joint, or one for all, rad; 0 for any",
    )
    .array_parameter::<f64>(
        "GoalTolerance",
        "[0]",
        "largest deviation at the end by joint, or one for all, rad; 0 for any",
    )
    .parameter::<f64>("GoalTime", "1", "how long after the end the goal may be reached, s; below 0 as long as it takes")
    .parameter::<f64>(
        "StartTolerance",
        "0.01",
        "largest deviation of a joint at rest from the first point, rad; it is made up for on the way",
    )
    .parameter::<bool>(
        "Join",
        "false",
        "leads from any state at inFrom, at rest or in motion, to the second point by quintic polynomials, if velocity and acceleration \
         permit; else, and where they do not, a deviation beyond StartTolerance and an unplanned velocity end it",
    )
    .array_output::<f64>("outPosition", "position of each joint, rad")
    .array_output::<f64>("outVelocity", "velocity of each joint, rad/s")
    .array_output::<f64>("outAcceleration", "acceleration of each joint, rad/s²")
    .output::<f64>("outTime", "time along the table, s")
    .output::<bool>("outFollowing", "exactly on the table, at its speed")
    .output::<bool>("outDone", "at rest at the end, or after a stop or deviation")
    .output::<i32>(
        "outCode",
        "0 none, 1 stopped, 2 the joints were elsewhere at the beginning, -4 too far from the path, -5 too far from the goal",
    )
    .output::<i32>("outJoint", "the joint that deviated, from 0; -1 for none")
    .output::<f64>("outDeviation", "how far it deviated, rad");
    let mut definition = with_joints_from(with_joint_limits(definition)).cost_ns(2_000);
    // Eight arrays or so have an element for each joint; braking beside the path is planned joint by joint.
    definition.cost.element_ns = 1_500.0;
    definition.null(NullRule::Own(
        "Never null while active, once begun. It begins when inFrom and the ports of its rates, where connected, are numbers.",
    ))
}

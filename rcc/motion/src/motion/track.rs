//! `Motion::Track`: joints that follow changing goals, each joint independently. Each goal is
//! approached to come to rest there; a goal that moves steadily is followed with a lag.

use takt_net::definition::port;
use takt_net::{ArrayIn, ArrayOut, Build, Cycle, Definition, Fault, In, NullRule, Out, Primitive};

use super::bounds::{Bounds, State};
use super::course::HOLD_BELOW;
use super::profile::Profile;
use super::ptp::{JointsFrom, with_joints_from};
use super::runner::OVERRIDE;
use super::{
    is_sensible, joint_bounds, joint_positions, slowed, speed, with_joint_limits, with_speed,
};

struct Joint {
    profile: Profile,
    start: f64,
    goal: f64,
    /// Part of the velocity limit for which the plan is made.
    part: f64,
}

impl Joint {
    /// Plans for a new goal or a new part of the velocity limit. A goal that is not a number, or cannot be planned for,
    /// changes nothing.
    fn aim_at(&mut self, goal: f64, part: f64) {
        let same = |a: f64, b: f64| a.to_bits() == b.to_bits();
        let is_new = !(same(goal, self.goal) && same(part, self.part));
        if is_new && is_sensible(goal) && self.profile.go_to(goal, part) {
            (self.goal, self.part) = (goal, part);
        }
    }

    /// Brakes, and plans again for its goal afterwards.
    fn hold(&mut self) {
        self.brake();
        self.part = 0.0;
    }

    fn brake(&mut self) {
        if !self.profile.is_at_rest() && !self.profile.is_braking() {
            self.profile.brake();
        }
    }

    fn reset(&mut self) {
        self.profile.reset(self.start);
        self.goal = self.start;
        self.part = 1.0;
    }

    /// Begins in a state of motion, towards rest.
    fn begin(&mut self, state: State) {
        self.profile.start(state);
        // The first goal is a new one.
        self.goal = f64::NAN;
    }
}

struct Track {
    joints: Box<[Joint]>,
    goal: ArrayIn<f64>,
    from: Option<JointsFrom>,
    speed: In<f64>,
    stop: In<bool>,
    reset: In<bool>,
    has_started: bool,
    is_stopped: bool,
    position: ArrayOut<f64>,
    velocity: ArrayOut<f64>,
    acceleration: ArrayOut<f64>,
    done: Out<bool>,
}

impl Track {
    /// Begins in the state at the ports, if they are connected; returns whether the motion has begun.
    fn begin(&mut self, cycle: &Cycle<'_>) -> bool {
        if self.reset.get(cycle) == Some(true) {
            self.joints.iter_mut().for_each(Joint::reset);
            (self.has_started, self.is_stopped) = (false, false);
        }
        let (false, Some(from)) = (self.has_started, &mut self.from) else {
            return true;
        };
        if !from.read(cycle) {
            return false;
        }
        for (joint, state) in self.joints.iter_mut().zip(&from.states) {
            joint.begin(*state);
        }
        self.has_started = true;
        true
    }

    fn aim(&mut self, cycle: &Cycle<'_>) {
        self.is_stopped |= self.stop.get(cycle) == Some(true);
        let part = self.speed.get(cycle).unwrap_or(0.0).min(1.0);
        let holds = part.is_nan() || part < HOLD_BELOW;
        if self.is_stopped {
            self.joints.iter_mut().for_each(Joint::brake);
        } else if holds {
            self.joints.iter_mut().for_each(Joint::hold);
        } else if let Some(goals) = self.goal.get(cycle) {
            for (joint, goal) in self.joints.iter_mut().zip(goals) {
                joint.aim_at(goal.get(), part);
            }
        } else {
            // The previous goals, at the present part.
            for joint in &mut self.joints {
                joint.aim_at(joint.goal, part);
            }
        }
    }
}

impl Primitive for Track {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if !self.begin(cycle) {
            for out in [&self.position, &self.velocity, &self.acceleration] {
                out.set_null(cycle);
            }
            self.done.set(cycle, false);
            return;
        }
        self.aim(cycle);
        if self.has_started {
            for joint in &mut self.joints {
                joint.profile.advance();
            }
        }
        self.has_started = true;
        let now = || self.joints.iter().map(|joint| joint.profile.now());
        self.position.set(cycle, now().map(|state| state.position));
        self.velocity.set(cycle, now().map(|state| state.velocity));
        self.acceleration
            .set(cycle, now().map(|state| state.acceleration));
        let is_done = self.joints.iter().all(|joint| joint.profile.is_at_rest());
        self.done.set(cycle, is_done);
    }
}

fn build(b: &mut Build<'_, '_>) -> Result<Track, Fault> {
    let goal = b.array_input::<f64>("inGoal")?;
    let bounds = joint_bounds(b, goal.len())?;
    let from = joint_positions(b, "From", goal.len())?;
    let present = JointsFrom::new(b)?;
    if let Some(present) = &present {
        present.fits(b, goal.len())?;
    }
    let period_s = b.period_s();
    let speed = speed(b)?;
    for bounds in &bounds {
        slowed(b, *bounds, speed)?;
    }
    let joint = |(start, bounds): (f64, Bounds)| {
        let mut profile = Profile::new(start, bounds, period_s);
        let bounds = bounds.at_speed(speed);
        profile.set_bounds([bounds, bounds.braking(speed)]);
        Joint {
            profile,
            start,
            goal: start,
            part: 1.0,
        }
    };
    Ok(Track {
        joints: from.into_iter().zip(bounds).map(joint).collect(),
        from: present,
        speed: b.input("inOverride")?,
        stop: b.input("inStop")?,
        reset: b.input("inReset")?,
        has_started: false,
        is_stopped: false,
        position: b.array_output("outPosition", goal.len())?,
        velocity: b.array_output("outVelocity", goal.len())?,
        acceleration: b.array_output("outAcceleration", goal.len())?,
        done: b.output("outDone"),
        goal,
    })
}

pub(super) fn definition() -> Definition {
    let definition = Definition::new(
        "Motion::Track",
        "Moves each joint to its goal as fast as its limits allow; goals may change in every cycle. \
         It may begin in motion.",
        build,
    )
    .stateful()
    .array_input::<f64>(
        port("inGoal", "goal of each joint, rad; null or not a number keeps the previous one").required(),
    )
    .input::<f64>(OVERRIDE)
    .input::<bool>(port(
        "inStop",
        "true ends the motion: every joint brakes and stays at rest until inReset",
    ))
    .array_parameter::<f64>(
        "From",
        "[0]",
        "position by joint at the start, or one for all, rad",
    )
    .array_output::<f64>("outPosition", "position of each joint, rad")
    .array_output::<f64>("outVelocity", "velocity of each joint, rad/s")
    .array_output::<f64>("outAcceleration", "acceleration of each joint, rad/s²")
    .output::<bool>("outDone", "all joints are at rest, at their goals or stopped");
    // A new goal is planned for within the cycle in which it arrives, joint by joint.
    let mut definition = with_joints_from(with_speed(with_joint_limits(definition))).cost_ns(1_000);
    // Four arrays or more have an element for each joint.
    definition.cost.element_ns = 1_500.0;
    definition.null(NullRule::Own(
        "Never null while active, once begun; a null goal keeps the previous one. It begins when inFrom and the ports \
         of its rates, where connected, are numbers.",
    ))
}

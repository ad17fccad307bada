//! The motion of one coordinate: planned with bounded velocity, acceleration and jerk, sampled once
//! a cycle, and replanned from its present state. If planning fails, the previous plan stays.
//! Neither planning nor sampling allocates. The owner of a profile checks the limits.

use rsruckig::prelude::{DataArrayOrVec, Trajectory};

use super::bounds::{Bounds, State, stopping};
use super::planner::{Planner, Target};

/// Rounding tolerance of a way to rest, relative to it and to the way in a second.
const STOPS: f64 = 1e-6;

/// The motion of a coordinate.
pub(super) struct Profile {
    planner: Planner,
    plan: Trajectory<1>,
    spare: Trajectory<1>,
    bounds: Bounds,
    /// Limits of what brakes: a stop, and the way back into `bounds`.
    braking: Bounds,
    /// Velocity limit of a plan that brakes into `bounds`, and then goes on within them.
    entering: Option<f64>,
    /// Whether it moves forwards only.
    forward_only: bool,
    /// Whether the state in which it began requires it to move backwards nevertheless.
    returns: bool,
    period_s: f64,
    now: State,
    /// Where the plan ends; `None` if it only brakes.
    goal: Option<f64>,
    /// Cycles since planning; `None` when the plan has ended.
    cycles: Option<u32>,
}

impl Profile {
    /// The same coordinate, restricted to forward motion.
    pub(super) fn forward_only(mut self) -> Self {
        self.forward_only = true;
        self
    }

    /// A coordinate at rest at `position`.
    pub(super) fn new(position: f64, bounds: Bounds, period_s: f64) -> Self {
        Self {
            planner: Planner::new(),
            plan: Trajectory::new(None),
            spare: Trajectory::new(None),
            bounds,
            braking: bounds,
            entering: None,
            forward_only: false,
            returns: false,
            period_s,
            now: State {
                position,
                ..State::default()
            },
            goal: Some(position),
            cycles: None,
        }
    }

    pub(super) const fn now(&self) -> State {
        self.now
    }

    /// Whether the plan has ended: the coordinate is at rest.
    pub(super) const fn is_at_rest(&self) -> bool {
        self.cycles.is_none()
    }

    /// Whether the plan leads to standstill at any position.
    pub(super) const fn is_braking(&self) -> bool {
        self.goal.is_none()
    }

    /// Puts the coordinate to rest at `position`, from one cycle to the next.
    pub(super) fn reset(&mut self, position: f64) {
        self.now = State {
            position,
            ..State::default()
        };
        self.goal = Some(position);
        self.cycles = None;
        self.entering = None;
        self.returns = false;
    }

    /// Replaces the limits, and those of what brakes, which are not lower; they apply from the next plan on.
    pub(super) const fn set_bounds(&mut self, [bounds, braking]: [Bounds; 2]) {
        (self.bounds, self.braking) = (bounds, braking);
    }

    /// Whether a plan may lead backwards.
    pub(super) const fn may_return(&self) -> bool {
        !self.forward_only || self.returns
    }

    /// Begins in a state of motion, and plans to come to rest at `goal` as [`Self::go_to`] does. Where the coordinate
    /// cannot stop before its goal it passes it and returns. Without a plan it brakes, and without that it rests.
    /// Returns whether there is a plan for the goal.
    pub(super) fn begin(&mut self, state: State, goal: f64, part: f64) -> bool {
        self.now = state;
        self.cycles = None;
        self.returns = false;
        // A deceleration turns the coordinate back before jerk can end it.
        let jerk = if self.bounds.are_exceeded(state) {
            self.braking.jerk
        } else {
            self.bounds.jerk
        };
        let lost = state.acceleration.min(0.0).powi(2) / (2.0 * jerk);
        if state.velocity >= lost && self.go_to(goal, part) {
            return true;
        }
        self.returns = true;
        if self.go_to(goal, part) {
            return true;
        }
        self.start(state);
        false
    }

    /// Begins in a state of motion, and brakes; without a plan for that it rests.
    pub(super) fn start(&mut self, state: State) {
        self.now = state;
        self.cycles = None;
        self.returns = false;
        if !self.brake() {
            self.reset(state.position);
        }
    }

    /// Duration of the plan, s; 0 at rest.
    pub(super) fn duration(&self) -> f64 {
        self.cycles.map_or(0.0, |_| self.plan.get_duration())
    }

    /// The state at a time after the beginning of the plan, s.
    pub(super) fn peek(&self, time: f64) -> State {
        match self.cycles {
            Some(_) => sample(&self.plan, time.min(self.plan.get_duration())),
            None => self.now,
        }
    }

    /// Where the coordinate would come to rest if it braked two cycles from now.
    pub(super) fn rest(&self) -> f64 {
        let Some(cycles) = self.cycles else {
            return self.now.position;
        };
        let state = self.peek(f64::from(cycles.saturating_add(2)) * self.period_s);
        state.position + stopping(state, self.braking)
    }

    /// Plans to come to rest at `goal`, at most at `part` (0 to 1) of the velocity limit. A state beyond the limits, or one
    /// that cannot stop before the goal within them, brakes within those of a stop. Returns whether there is such a plan.
    pub(super) fn go_to(&mut self, goal: f64, part: f64) -> bool {
        let velocity = self.bounds.velocity * part;
        let gentle = Bounds {
            velocity,
            ..self.bounds
        };
        if self.braking.jerk <= self.bounds.jerk {
            return self.make_plan(Some(goal), gentle);
        }
        // One that moves forwards only has no gentle plan where it cannot stop.
        let fits = self.goes_on_within(gentle);
        if fits && self.make_plan(Some(goal), gentle) {
            self.entering = None;
            return true;
        }
        if fits {
            return self.come_down(goal, velocity);
        }
        // Within the limits of a stop it brakes, but does not speed up.
        let hard = Bounds {
            velocity: velocity.min(self.carried()),
            ..self.braking
        };
        if self.make_plan(Some(goal), hard) {
            self.entering = Some(velocity);
            return true;
        }
        self.come_down(goal, velocity) || self.make_plan(Some(goal), gentle)
    }

    /// The velocity at which it goes on if its acceleration ends as fast as it can.
    fn carried(&self) -> f64 {
        let State {
            velocity,
            acceleration,
            ..
        } = self.now;
        let gained = acceleration * acceleration.abs() / (2.0 * self.braking.jerk);
        (velocity + gained).abs()
    }

    /// Brakes as a stop does until it can go on to its goal within the limits: a plan for the goal within the limits of a stop
    /// would speed up first. Returns whether it stops before the goal.
    fn come_down(&mut self, goal: f64, velocity: f64) -> bool {
        let stops = self.may_return() || stops_before(self.now, goal, self.braking);
        if !stops || !self.make_plan(None, self.braking) {
            return false;
        }
        (self.goal, self.entering) = (Some(goal), Some(velocity));
        true
    }

    /// Goes to the same goal within the limits of a stop, at the same velocity.
    pub(super) fn hurry(&mut self) {
        let Some(goal) = self.goal.filter(|_| !self.is_at_rest()) else {
            return;
        };
        let hard = Bounds {
            velocity: self.bounds.velocity,
            ..self.braking
        };
        if self.braking.jerk > self.bounds.jerk && self.make_plan(Some(goal), hard) {
            self.entering = None;
        }
    }

    /// Plans to come to rest as soon as possible. Returns whether there is such a plan.
    pub(super) fn brake(&mut self) -> bool {
        let is_planned = self.make_plan(None, self.braking);
        if is_planned {
            self.entering = None;
        }
        is_planned
    }

    fn make_plan(&mut self, goal: Option<f64>, bounds: Bounds) -> bool {
        let velocity = bounds.velocity;
        let is_number = goal.is_none_or(f64::is_finite) && self.now.is_finite() && velocity > 0.0;
        if !is_number {
            return false;
        }
        let target = goal.map_or(Target::Anywhere, Target::Position);
        let lowest = if self.may_return() { -velocity } else { 0.0 };
        let plan = &mut self.spare;
        let is_planned = self.planner.plan(self.now, target, bounds, lowest, plan);
        if is_planned {
            std::mem::swap(&mut self.plan, &mut self.spare);
            self.goal = goal;
            self.cycles = Some(0);
            if self.plan.get_duration() <= 0.0 {
                self.reset(goal.unwrap_or(self.now.position));
            }
        }
        is_planned
    }

    /// Whether the state keeps the bounds, and a deceleration ends within them before it turns the coordinate back.
    fn goes_on_within(&self, bounds: Bounds) -> bool {
        let lost = self.now.acceleration.min(0.0).powi(2) / (2.0 * bounds.jerk);
        let turns_back = !self.may_return() && self.now.velocity < lost;
        !bounds.are_exceeded(self.now) && !turns_back
    }

    /// Goes on within the limits, once a plan that brakes into them has come there.
    fn enter(&mut self) {
        let (Some(velocity), Some(goal)) = (self.entering, self.goal) else {
            return;
        };
        let gentle = Bounds {
            velocity,
            ..self.bounds
        };
        let is_within = self.goes_on_within(gentle) && stops_before(self.now, goal, gentle);
        if is_within && self.make_plan(Some(goal), gentle) {
            self.entering = None;
        }
    }

    /// Advances by one cycle.
    pub(super) fn advance(&mut self) {
        let Some(cycles) = &mut self.cycles else {
            return;
        };
        *cycles = cycles.saturating_add(1);
        let time = f64::from(*cycles) * self.period_s;
        let has_ended = time >= self.plan.get_duration();
        let sample = sample(&self.plan, time.min(self.plan.get_duration()));
        if !sample.is_finite() {
            return;
        }
        self.now = sample;
        if has_ended && self.entering.is_some() {
            self.now = State::at_rest(sample.position);
            self.enter();
            if self.entering.take().is_some() {
                self.reset(sample.position);
            }
        } else if has_ended {
            // The end of the plan has a rounding error.
            self.reset(self.goal.unwrap_or(sample.position));
        } else {
            self.enter();
        }
    }
}

/// Whether a coordinate in this state can stop within these bounds without passing its goal.
fn stops_before(now: State, goal: f64, bounds: Bounds) -> bool {
    let (left, needed) = (goal - now.position, stopping(now, bounds));
    needed * left <= 0.0 || needed.abs() <= left.abs() * (1.0 + STOPS) + STOPS * bounds.velocity
}

/// The state of a trajectory at `time`, s.
fn sample(plan: &Trajectory<1>, time: f64) -> State {
    let mut values = [(); 3].map(|()| DataArrayOrVec::<f64, 1>::new(None, 0.0));
    let [position, velocity, acceleration] = &mut values;
    plan.at_time(
        time,
        &mut Some(position),
        &mut Some(velocity),
        &mut Some(acceleration),
        &mut None,
        &mut None,
    );
    State {
        position: values[0][0],
        velocity: values[1][0],
        acceleration: values[2][0],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shortest time of a motion from rest to rest over `distance`, in closed form.
    fn shortest(distance: f64, bounds: Bounds) -> f64 {
        let Bounds {
            velocity: v,
            acceleration: a,
            jerk: j,
        } = bounds;
        // Time to reach a velocity from rest.
        let ramp = |v: f64| {
            if v * j >= a * a {
                v / a + a / j
            } else {
                2.0 * (v / j).sqrt()
            }
        };
        if distance >= v * ramp(v) {
            return distance / v + ramp(v);
        }
        let peak = ((a / j).mul_add(a / j, 4.0 * distance / a).sqrt() - a / j) * a / 2.0;
        if peak * j >= a * a {
            2.0 * ramp(peak)
        } else {
            4.0 * (distance / (2.0 * j)).cbrt()
        }
    }

    fn series() -> impl FnMut(f64, f64) -> f64 {
        let mut seed = 0x2545_f491_4f6c_dd1d_u64;
        move |from: f64, to: f64| {
            seed ^= seed << 13;
            seed ^= seed >> 7;
            seed ^= seed << 17;
            let unit = f64::from(u32::try_from(seed >> 32).expect("32 bits"));
            10.0_f64.powf(from + (to - from) * unit / f64::from(u32::MAX))
        }
    }

    #[test]
    fn rest_to_rest_plan_takes_shortest_time() {
        let mut draw = series();
        for number in 0..5000 {
            let bounds = Bounds {
                velocity: draw(-3.0, 3.0),
                acceleration: draw(-3.0, 3.0),
                jerk: draw(-3.0, 3.0),
            };
            let distance = draw(-6.0, 2.0);
            let mut profile = Profile::new(0.0, bounds, 1e-3);
            assert!(
                profile.go_to(distance, 1.0),
                "{number}: {distance} {bounds:?}"
            );
            let (found, known) = (profile.plan.get_duration(), shortest(distance, bounds));
            let off = (found - known).abs();
            assert!(
                off < 1e-6 * known + 1e-9,
                "{number}: {found} {known} {distance} {bounds:?}"
            );
            let end = sample(&profile.plan, found).position;
            assert!((end - distance).abs() < 1e-8, "{number}: {end} {distance}");
        }
    }

    #[test]
    fn braking_never_passes_goal() {
        let mut draw = series();
        for number in 0..300 {
            let bounds = Bounds {
                velocity: draw(-1.0, 0.5),
                acceleration: draw(-0.5, 1.0),
                jerk: draw(0.5, 2.0),
            };
            let distance = draw(-2.0, 0.5);
            let mut profile = Profile::new(0.0, bounds, 1e-3).forward_only();
            assert!(profile.go_to(distance, 1.0));
            let until = profile.plan.get_duration() * draw(-2.0, 0.0);
            let mut time = 0.0;
            while time < until {
                profile.advance();
                time += 1e-3;
            }
            assert!(profile.is_at_rest() || profile.brake(), "{number}");
            let mut last = profile.now().position;
            while !profile.is_at_rest() {
                profile.advance();
                let position = profile.now().position;
                assert!(
                    position >= last - 1e-12 && position <= distance + 1e-9,
                    "{number}: {last} {position} of {distance}"
                );
                last = position;
            }
        }
    }

    #[test]
    fn rest_is_where_braking_ends() {
        let mut draw = series();
        for number in 0..300 {
            let bounds = Bounds {
                velocity: draw(-1.0, 0.5),
                acceleration: draw(-0.5, 1.0),
                jerk: draw(0.5, 2.0),
            };
            let mut profile = Profile::new(0.0, bounds, 1e-3).forward_only();
            assert!(profile.go_to(draw(-2.0, 0.5), 1.0));
            let until = profile.plan.get_duration() * draw(-2.0, 0.0);
            let mut time = 0.0;
            while time < until {
                profile.advance();
                time += 1e-3;
            }
            let expected = profile.rest();
            profile.advance();
            profile.advance();
            assert!(profile.is_at_rest() || profile.brake(), "{number}");
            while !profile.is_at_rest() {
                profile.advance();
            }
            let found = profile.now().position;
            assert!(
                (found - expected).abs() < 1e-6,
                "{number}: {found} {expected}"
            );
        }
    }

    #[test]
    fn failed_plan_keeps_previous_plan() {
        let bounds = Bounds {
            velocity: 1.0,
            acceleration: 1.0,
            jerk: 1.0,
        };
        let mut profile = Profile::new(0.0, bounds, 1e-3);
        assert!(profile.go_to(1e-3, 1.0));
        assert!(!profile.go_to(f64::NAN, 1.0));
        while !profile.is_at_rest() {
            profile.advance();
        }
        assert_eq!(profile.now().position.to_bits(), 1e-3_f64.to_bits());
    }

    /// Goals that change at any instant, among them far, near and equal ones, with limits of all
    /// allowed sizes: planning rarely fails, and samples are always finite and in bounds.
    #[test]
    fn random_goals_are_planned_or_ignored() {
        let mut draw = series();
        let (mut failed, mut all) = (0, 0);
        for _ in 0..2_000 {
            let bounds = Bounds {
                velocity: draw(-6.0, 6.0),
                acceleration: draw(-6.0, 6.0),
                jerk: draw(-6.0, 6.0),
            };
            let mut profile = Profile::new(0.0, bounds, 1e-3);
            for _ in 0..20 {
                let sign = if draw(-1.0, 1.0) > 1.0 { 1.0 } else { -1.0 };
                let planned = profile.go_to(sign * draw(-9.0, 6.0), 1.0);
                (all, failed) = (all + 1, failed + u32::from(!planned));
                let mut cycles = draw(0.0, 2.0);
                while cycles > 0.0 {
                    profile.advance();
                    let now = profile.now;
                    assert!(
                        now.is_finite()
                            && now.velocity.abs() <= bounds.velocity * (1.0 + 1e-6)
                            && now.acceleration.abs() <= bounds.acceleration * (1.0 + 1e-6),
                        "{now:?} {bounds:?}"
                    );
                    cycles -= 1.0;
                }
                if draw(-1.0, 1.0) > 5.0 && !profile.is_at_rest() {
                    let planned = profile.brake();
                    (all, failed) = (all + 1, failed + u32::from(!planned));
                }
            }
        }
        assert!(failed * 1_000 < all, "{failed} of {all}");
    }
}

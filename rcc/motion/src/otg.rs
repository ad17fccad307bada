//! Online trajectory generation: in every cycle one step towards a goal that may move, with bounded
//! velocity and acceleration. The step is the time-optimal one among those that last a whole cycle
//! at constant acceleration, so that a goal at rest is reached exactly, without oscillation. Jerk
//! is not bounded.

use takt_net::definition::port;
use takt_net::{Build, Cycle, Definition, Fault, In, NullRule, Out, Primitive};

/// The largest velocity after a cycle from which braking with `delta_v` per cycle still ends on the
/// goal. `distance` is the distance to the goal per cycle length, less half the present velocity (m/s,
/// not negative).
///
/// Braking takes n cycles; for a known n the distance is linear in the velocity, and n follows from
/// the longest distance that n cycles of braking can cover, n (n + 1) / 2 · `delta_v`.
pub(crate) fn approach(distance: f64, delta_v: f64) -> f64 {
    let cycles = ((1.0 + 8.0 * distance / delta_v).sqrt() / 2.0 - 0.5).ceil();
    let cycles = cycles.max(1.0);
    distance / cycles + delta_v * (cycles - 1.0) / 2.0
}

/// Position (m or rad) and velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct State {
    pub(crate) pos: f64,
    pub(crate) vel: f64,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub(crate) velocity: f64,
    pub(crate) acceleration: f64,
}

impl Limits {
    fn are_valid(self) -> bool {
        let valid = |limit: f64| limit >= 0.0 && limit.is_finite();
        valid(self.velocity) && valid(self.acceleration)
    }
}

/// Advances by one cycle: returns the new state and the acceleration that led to it. `None` if an
/// input is not finite or a limit is negative.
pub(crate) fn step(now: State, goal: State, limits: Limits, period_s: f64) -> Option<(State, f64)> {
    let delta_v = limits.acceleration * period_s;
    let wanted = if delta_v > 0.0 {
        // Relative to the goal, which was one period of its velocity back when `now` was reached.
        let distance = goal.pos - goal.vel * period_s - now.pos;
        let remaining = distance / period_s - (now.vel - goal.vel) / 2.0;
        goal.vel + approach(remaining.abs(), delta_v).copysign(remaining)
    } else {
        now.vel
    };
    if !limits.are_valid() || !wanted.is_finite() {
        return None;
    }
    let allowed = wanted.clamp(-limits.velocity, limits.velocity);
    let vel = allowed.clamp(now.vel - delta_v, now.vel + delta_v);
    let pos = now.pos + (now.vel + vel) / 2.0 * period_s;
    let next = State { pos, vel };
    let is_finite = pos.is_finite() && vel.is_finite();
    is_finite.then_some((next, (vel - now.vel) / period_s))
}

/// In ports of the present state; unconnected ones are replaced by the last output.
struct Present {
    pos: Option<In<f64>>,
    vel: Option<In<f64>>,
    last: Option<State>,
}

impl Present {
    fn new(b: &mut Build<'_, '_>) -> Result<Self, Fault> {
        let pos = b.is_linked("inCurPos").then(|| b.input("inCurPos"));
        let vel = b.is_linked("inCurVel").then(|| b.input("inCurVel"));
        Ok(Self {
            pos: pos.transpose()?,
            vel: vel.transpose()?,
            last: None,
        })
    }

    /// The present state; at the start, if not connected, at rest at `goal`.
    fn read(&self, cycle: &Cycle<'_>, goal: f64) -> Option<State> {
        let last = self.last.unwrap_or(State {
            pos: goal,
            vel: 0.0,
        });
        Some(State {
            pos: self.pos.map_or(Some(last.pos), |p| p.get(cycle))?,
            vel: self.vel.map_or(Some(last.vel), |v| v.get(cycle))?,
        })
    }
}

struct LimitPorts {
    velocity: In<f64>,
    acceleration: In<f64>,
}

impl LimitPorts {
    fn new(b: &mut Build<'_, '_>) -> Result<Self, Fault> {
        Ok(Self {
            velocity: b.input("inMaxVel")?,
            acceleration: b.input("inMaxAcc")?,
        })
    }

    fn read(&self, cycle: &Cycle<'_>) -> Option<Limits> {
        Some(Limits {
            velocity: self.velocity.get(cycle)?,
            acceleration: self.acceleration.get(cycle)?,
        })
    }
}

/// The source of the goal's velocity.
enum GoalVelocity {
    Port(In<f64>),
    /// From this goal and that of the previous cycle.
    Difference(Option<f64>),
}

struct Generator {
    present: Present,
    goal: In<f64>,
    goal_velocity: GoalVelocity,
    limits: LimitPorts,
    pos: Out<f64>,
    vel: Out<f64>,
    acc: Out<f64>,
    period_s: f64,
}

impl Generator {
    fn new(
        b: &mut Build<'_, '_>,
        goal: &'static str,
        goal_velocity: GoalVelocity,
    ) -> Result<Self, Fault> {
        Ok(Self {
            present: Present::new(b)?,
            goal: b.input(goal)?,
            goal_velocity,
            limits: LimitPorts::new(b)?,
            pos: b.output("outPos"),
            vel: b.output("outVel"),
            acc: b.output("outAcc"),
            period_s: b.period_s(),
        })
    }

    fn goal(&mut self, cycle: &Cycle<'_>) -> Option<State> {
        let pos = self.goal.get(cycle);
        let vel = match &mut self.goal_velocity {
            GoalVelocity::Port(vel) => vel.get(cycle),
            GoalVelocity::Difference(before) => {
                let change = pos.zip(*before).map(|(pos, before)| pos - before);
                *before = pos;
                Some(change.map_or(0.0, |change| change / self.period_s))
            }
        };
        pos.zip(vel).map(|(pos, vel)| State { pos, vel })
    }

    fn next(&mut self, cycle: &Cycle<'_>) -> Option<(State, f64)> {
        let goal = self.goal(cycle)?;
        let now = self.present.read(cycle, goal.pos)?;
        let next = step(now, goal, self.limits.read(cycle)?, self.period_s)?;
        self.present.last = Some(next.0);
        Some(next)
    }
}

impl Primitive for Generator {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let next = self.next(cycle);
        self.pos.set(cycle, next.map(|(state, _)| state.pos));
        self.vel.set(cycle, next.map(|(state, _)| state.vel));
        self.acc.set(cycle, next.map(|(_, acc)| acc));
    }
}

fn with_ports(definition: Definition) -> Definition {
    definition
        .active()
        .input::<f64>(port(
            "inCurPos",
            "present position; if not connected, the last output",
        ))
        .input::<f64>(port(
            "inCurVel",
            "present velocity, per second; if not connected, the last output",
        ))
        .input::<f64>(
            port(
                "inMaxVel",
                "velocity limit, in the unit of the position per second",
            )
            .or("maxVel", "0"),
        )
        .input::<f64>(
            port(
                "inMaxAcc",
                "acceleration limit, in the unit of the position per second squared",
            )
            .or("maxAcc", "0"),
        )
        .output::<f64>("outPos", "position of this cycle")
        .output::<f64>("outVel", "velocity at its end, per second")
        .output::<f64>("outAcc", "acceleration during it, per second squared")
        .null(NullRule::Own(
            "Null if a connected input is null or not finite, or a bound is negative; the state \
             then stays.",
        ))
}

pub(crate) fn table() -> Vec<Definition> {
    let otg = |b: &mut Build<'_, '_>| -> Result<Generator, Fault> {
        let vel = if b.is_linked("inDestVel") {
            b.input("inDestVel")?
        } else {
            b.constant(0.0)
        };
        Generator::new(b, "inDestPos", GoalVelocity::Port(vel))
    };
    let otg2 = |b: &mut Build<'_, '_>| -> Result<Generator, Fault> {
        Generator::new(b, "inDesPos", GoalVelocity::Difference(None))
    };
    vec![
        with_ports(Definition::new(
            "Core::OTG",
            "One step a cycle towards a goal, as fast as the limits of velocity and acceleration \
             allow. Where the present state is not connected it starts at rest at the goal.",
            otg,
        ))
        .input::<f64>(port(
            "inCurAcc",
            "not used: acceleration may change at once",
        ))
        .input::<f64>(port("inDestPos", "the goal").required())
        .input::<f64>(port(
            "inDestVel",
            "velocity of the goal, per second; 0 if not connected",
        )),
        with_ports(Definition::new(
            "Core::OTG2",
            "Like OTG for a goal that moves: its velocity is taken from successive goals.",
            otg2,
        ))
        .input::<f64>(port("inDesPos", "the goal").required()),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::series;

    const LIMITS: Limits = Limits {
        velocity: 1.0,
        acceleration: 2.0,
    };
    const PERIOD_S: f64 = 1e-3;

    /// Runs to a goal at rest; returns the number of cycles and the final state.
    fn run(mut now: State, goal: f64, limits: Limits) -> (u32, State) {
        let goal = State {
            pos: goal,
            vel: 0.0,
        };
        for cycle in 0..100_000 {
            if (now.pos - goal.pos).abs() < 1e-12 && now.vel.abs() < 1e-9 {
                return (cycle, now);
            }
            let (next, acc) = step(now, goal, limits, PERIOD_S).unwrap();
            assert!(acc.abs() <= limits.acceleration * (1.0 + 1e-9), "{acc}");
            let fastest = limits.velocity.max(now.vel.abs()) * (1.0 + 1e-12);
            assert!(next.vel.abs() <= fastest, "{}", next.vel);
            now = next;
        }
        panic!("never arrived: {now:?}");
    }

    #[test]
    fn otg_takes_least_time() {
        let rest = State { pos: 0.0, vel: 0.0 };
        // Triangle: 2·sqrt(d/a); trapezoid: d/v + v/a. Whole cycles add at most a few.
        for (goal, least) in [(0.02, 200), (-0.02, 200), (2.0, 2500), (-5.0, 5500)] {
            let (cycles, _) = run(rest, goal, LIMITS);
            assert!((least..=least + 3).contains(&cycles), "{goal}: {cycles}");
        }
    }

    #[test]
    fn otg_from_any_state_arrives_with_least_overshoot() {
        for (pos, vel) in [
            (0.0, 1.0),
            (0.0, -1.0),
            (0.999, 1.0),
            (1.2, 0.3),
            (0.0, 5.0),
        ] {
            let (_, end) = run(State { pos, vel }, 1.0, LIMITS);
            assert!((end.pos - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn otg_from_rest_never_overshoots() {
        let goal = State {
            pos: 0.3141,
            vel: 0.0,
        };
        let mut now = State { pos: 0.0, vel: 0.0 };
        for _ in 0..2000 {
            now = step(now, goal, LIMITS, PERIOD_S).unwrap().0;
            assert!(now.pos <= goal.pos + 1e-12);
        }
    }

    #[test]
    fn otg_follows_moving_goal_without_lag() {
        let mut now = State { pos: 0.0, vel: 0.0 };
        for cycle in 1..=3000 {
            let goal = State {
                pos: 0.1 + 0.5 * PERIOD_S * f64::from(cycle),
                vel: 0.5,
            };
            now = step(now, goal, LIMITS, PERIOD_S).unwrap().0;
            if cycle > 2000 {
                assert!(
                    (now.pos - goal.pos).abs() < 1e-9,
                    "{cycle}: {now:?} {goal:?}"
                );
            }
        }
    }

    #[test]
    fn otg_with_invalid_input_is_none() {
        let state = |pos, vel| State { pos, vel };
        let numbers = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
        for bad in numbers {
            for (now, goal) in [
                (state(bad, 0.0), state(1.0, 0.0)),
                (state(0.0, bad), state(1.0, 0.0)),
                (state(0.0, 0.0), state(bad, 0.0)),
                (state(0.0, 0.0), state(1.0, bad)),
            ] {
                assert_eq!(step(now, goal, LIMITS, PERIOD_S), None, "{now:?} {goal:?}");
            }
        }
        for (velocity, acceleration) in [(-1.0, 1.0), (1.0, -1.0), (f64::NAN, 1.0)] {
            let limits = Limits {
                velocity,
                acceleration,
            };
            let result = step(state(0.0, 0.0), state(1.0, 0.0), limits, PERIOD_S);
            assert_eq!(result, None, "{limits:?}");
        }
    }

    #[test]
    fn otg_without_acceleration_changes_nothing() {
        let limits = Limits {
            velocity: 1.0,
            acceleration: 0.0,
        };
        let now = State { pos: 1.0, vel: 0.0 };
        let goal = State { pos: 2.0, vel: 0.0 };
        assert_eq!(step(now, goal, limits, PERIOD_S), Some((now, 0.0)));
    }

    #[test]
    fn otg_primitives_step_towards_goal() {
        let net = "g=Core::DoubleValue(Value='1'),z=Core::DoubleValue(),\
                   p=Core::DoublePre(inValue=o.outPos),n=Core::DoubleIsNull(inValue=p.outValue),\
                   c=Core::DoubleConditional(inCondition=n.outValue,inTrue=z.outValue,\
                   inFalse=p.outValue),\
                   o=Core::OTG(inDestPos=g.outValue,inCurPos=c.outValue,maxVel='1',maxAcc='500')";
        let pos = series(net, "Core::Double", "o.outPos", 1010);
        assert_eq!(pos[..2], ["0.00025", "0.001"]);
        assert_eq!(pos[1009], "1");
        let net = "c=Core::Clock(),o=Core::OTG2(inDesPos=c.outValue,maxVel='2',maxAcc='100')";
        let pos = series(net, "Core::Double", "o.outPos", 200);
        assert_eq!(pos[0], "0.001");
        let last: f64 = pos[199].parse().unwrap();
        assert!((last - 0.2).abs() < 1e-9, "{last}");
    }
}

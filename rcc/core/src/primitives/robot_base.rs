//! `RobotBase::*`: mobile bases, commanded by a velocity in their own frame.

use std::sync::Arc;

use takt_net::definition::port;
use takt_net::device::{Base, Wheel};
use takt_net::set_points::SetPointCounters;
use takt_net::{
    Build, Cycle, Definition, Fault, Frame, In, NullRule, Out, Primitive, Twist, Vector,
};

use super::{count, error, first_error};

const ROBOT: &str = "name of the base";
const ERROR: &str = "0 none, 1 offline or too fast, 2 not enabled or no number, 3 refused by the \
                     driver, -1 concurrent access";

fn base(b: &mut Build<'_, '_>) -> Result<Base, Fault> {
    b.interface("Robot", "robot base", |has| has.base.clone())
}

struct BaseVelocity {
    velocity: In<Twist>,
    base: Base,
    counters: Arc<SetPointCounters>,
    error: Out<i32>,
    concurrent: Out<bool>,
    failed: Out<bool>,
    illegal: Out<bool>,
}

impl BaseVelocity {
    /// The larger share of its largest speeds.
    fn share(&self, velocity: &Twist) -> f64 {
        let planar = velocity.vel.xy().norm() / self.base.velocity_max;
        planar.max(velocity.rot.z.abs() / self.base.rotation_max)
    }

    fn check(&self, velocity: &Twist) -> i32 {
        let (planar, turn) = (velocity.vel.xy().norm(), velocity.rot.z.abs());
        if planar.is_nan() || turn.is_nan() {
            error::INVALID
        } else if planar > self.base.velocity_max || turn > self.base.rotation_max {
            error::RANGE
        } else {
            0
        }
    }
}

impl Primitive for BaseVelocity {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let velocity = self.velocity.get(cycle);
        let concurrent = self.base.command.is_taken(cycle);
        let failed = self.base.error.get(cycle.image).unwrap_or(1);
        let illegal = velocity.map_or(0, |velocity| self.check(&velocity));
        let error = first_error(concurrent, failed, illegal);
        if let (0, Some(velocity)) = (error, velocity) {
            self.base.command.give(cycle, velocity);
        }
        let share = velocity.map(|velocity| self.share(&velocity));
        count(&self.counters, share, concurrent, failed, illegal);
        self.error.set(cycle, error);
        self.concurrent.set(cycle, concurrent);
        self.failed.set(cycle, !concurrent && failed != 0);
        self.illegal.set(cycle, illegal != 0);
    }
}

fn base_velocity(b: &mut Build<'_, '_>) -> Result<BaseVelocity, Fault> {
    let base = base(b)?;
    let robot = b.text("Robot").to_owned();
    b.claim(&robot, format!("{robot}_Base"));
    b.commands(base.command.target());
    let counters = b.set_points(
        &robot,
        "base".to_owned(),
        "times its largest speed",
        [0.0, 1.0],
    );
    Ok(BaseVelocity {
        velocity: b.input("inVel")?,
        base,
        counters,
        error: b.output("outError"),
        concurrent: b.output("outErrorConcurrentAccess"),
        failed: b.output("outErrorBaseFailed"),
        illegal: b.output("outErrorIllegalVelocity"),
    })
}

struct BaseMonitor {
    base: Base,
    pose: Out<Frame>,
    velocity: Out<Twist>,
    commanded: Out<Twist>,
    error: Out<i32>,
}

/// A base whose speed may differ further from what was commanded than by what it gains in this time, s, at the largest
/// change of its speed, has been given a step, which its driver smooths.
const STEP_S: f64 = 0.25;

impl BaseMonitor {
    /// The velocity from which a net goes on: the one that a net commanded in the cycle before, not the one that the driver,
    /// whose cycles are longer, has come to with it. A base whose driver smooths a step goes on from what the driver reports.
    fn commanded(&self, cycle: &Cycle<'_>) -> Option<Twist> {
        let reported = self.base.commanded.get(cycle.image);
        let follows = self.base.error.get(cycle.image) == Some(0);
        let Some(recent) = self.base.command.recent(cycle).filter(|_| follows) else {
            return reported;
        };
        let off = reported.unwrap_or_default();
        let is_step = (recent.vel - off.vel).xy().norm() > STEP_S * self.base.velocity_max
            || (recent.rot.z - off.rot.z).abs() > STEP_S * self.base.rotation_max;
        if is_step { reported } else { Some(recent) }
    }
}

impl Primitive for BaseMonitor {
    fn step(&mut self, cycle: &Cycle<'_>) {
        self.pose.set(cycle, self.base.pose.get(cycle.image));
        self.velocity
            .set(cycle, self.base.velocity.get(cycle.image));
        self.commanded.set(cycle, self.commanded(cycle));
        let error = self.base.error.get(cycle.image);
        self.error.set(cycle, error.unwrap_or(1));
    }
}

fn base_monitor(b: &mut Build<'_, '_>) -> Result<BaseMonitor, Fault> {
    Ok(BaseMonitor {
        base: base(b)?,
        pose: b.output("outPos"),
        velocity: b.output("outVel"),
        commanded: b.output("outCmdVel"),
        error: b.output("outError"),
    })
}

struct WheelMonitor {
    wheel: Wheel,
    position: Out<f64>,
    velocity: Out<f64>,
}

impl Primitive for WheelMonitor {
    fn step(&mut self, cycle: &Cycle<'_>) {
        self.position
            .set(cycle, self.wheel.position.get(cycle.image));
        self.velocity
            .set(cycle, self.wheel.velocity.get(cycle.image));
    }
}

fn wheel_monitor(b: &mut Build<'_, '_>) -> Result<WheelMonitor, Fault> {
    let wheels = b.interface("Robot", "robot base with wheels", |has| {
        let base = has.base.as_ref()?;
        (!base.wheels.is_empty()).then(|| base.wheels.clone())
    })?;
    let wheel = b.number("Wheel", 0..=wheels.len() - 1)?;
    Ok(WheelMonitor {
        wheel: wheels[wheel],
        position: b.output("outPos"),
        velocity: b.output("outVel"),
    })
}

/// Tolerance of the destination in every direction, m and rad.
const ARRIVED: f64 = 0.01;

struct Controller {
    destination: In<Frame>,
    position: In<Frame>,
    velocity: In<Twist>,
    /// In x and y of the reference frame and about z: gain (1/s), and maximum speed, which is also
    /// the maximum change of speed per second.
    gain: [f64; 3],
    speed: [f64; 3],
    period_s: f64,
    completed: Out<bool>,
    out: Out<Twist>,
}

/// The heading of a frame, rad.
fn heading(frame: &Frame) -> f64 {
    let ahead = frame.rotation * Vector::x();
    ahead.y.atan2(ahead.x)
}

impl Controller {
    /// The velocity in the base's own frame, and whether it has arrived.
    fn control(&self, to: &Frame, at: &Frame) -> ([f64; 3], bool) {
        let way = to.translation.vector - at.translation.vector;
        let turn = heading(to) - heading(at);
        let tau = std::f64::consts::TAU;
        let way = [way.x, way.y, turn - tau * (turn / tau).round()];
        if way.iter().all(|part| part.abs() < ARRIVED) {
            return ([0.0; 3], true);
        }
        let wanted: [f64; 3] = std::array::from_fn(|i| self.gain[i] * way[i]);
        // One factor for all, so that the path stays straight.
        let excess = wanted.iter().zip(&self.speed).map(|(v, max)| v.abs() / max);
        let slower = excess.fold(1.0, f64::max);
        let [x, y, turn] = wanted.map(|v| v / slower);
        let (sin, cos) = heading(at).sin_cos();
        ([cos * x + sin * y, cos * y - sin * x, turn], false)
    }
}

impl Primitive for Controller {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let frames = self.destination.get(cycle).zip(self.position.get(cycle));
        let Some((to, at)) = frames else {
            self.out.set(cycle, None);
            self.completed.set(cycle, None);
            return;
        };
        let (mut wanted, completed) = self.control(&to, &at);
        if let Some(now) = self.velocity.get(cycle) {
            let now = [now.vel.x, now.vel.y, now.rot.z];
            for (i, wanted) in wanted.iter_mut().enumerate() {
                let change = self.speed[i] * self.period_s;
                // NaN is passed on: the commanding primitive reports it.
                *wanted = wanted.min(now[i] + change).max(now[i] - change);
            }
        }
        let [x, y, turn] = wanted;
        self.out.set(
            cycle,
            Twist {
                vel: Vector::new(x, y, 0.0),
                rot: Vector::new(0.0, 0.0, turn),
            },
        );
        self.completed.set(cycle, completed);
    }
}

fn controller(b: &mut Build<'_, '_>) -> Result<Controller, Fault> {
    let positive = |b: &Build<'_, '_>, name| -> Result<f64, Fault> {
        let value: f64 = b.value(name)?;
        if value > 0.0 && value.is_finite() {
            return Ok(value);
        }
        Err(b.parameter_fault(name, format!("{value} is not above zero")))
    };
    Ok(Controller {
        destination: b.input("inDest")?,
        position: b.input("inPos")?,
        velocity: b.input("inVel")?,
        gain: [positive(b, "pX")?, positive(b, "pY")?, positive(b, "pYaw")?],
        speed: [
            positive(b, "velX")?,
            positive(b, "velY")?,
            positive(b, "velYaw")?,
        ],
        period_s: b.period_s(),
        completed: b.output("outCompleted"),
        out: b.output("outVel"),
    })
}

#[expect(clippy::too_many_lines, reason = "a table")]
pub(super) fn table() -> Vec<Definition> {
    vec![
        Definition::new(
            "RobotBase::BaseVelocity",
            "Commands a base's velocity. On any error nothing is commanded in this cycle, and the \
             driver brakes the base.",
            base_velocity,
        )
        .active()
        .input::<Twist>(
            port(
                "inVel",
                "velocity in the base's own frame, m/s and rad/s; x, y and the turn about z matter",
            )
            .required(),
        )
        .text("Robot", ROBOT)
        .output::<i32>("outError", ERROR)
        .output::<bool>(
            "outErrorConcurrentAccess",
            "another primitive commands the base",
        )
        .output::<bool>("outErrorBaseFailed", "the base does not follow commands")
        .output::<bool>(
            "outErrorIllegalVelocity",
            "the velocity is beyond the base's limits or no number",
        )
        .null(NullRule::Own(
            "A null velocity commands nothing and is no error.",
        )),
        Definition::new(
            "RobotBase::BaseMonitor",
            "Where a base is and how it moves, as its driver last reported, and what was commanded.",
            base_monitor,
        )
        .text("Robot", ROBOT)
        .output::<Frame>("outPos", "pose in the frame in which it started, m")
        .output::<Twist>("outVel", "velocity in its own frame, m/s and rad/s")
        .output::<Twist>(
            "outCmdVel",
            "velocity that a net commanded in the cycle before, where one did and the base follows, else the one that the \
             driver reports, in its own frame, m/s and rad/s",
        )
        .output::<i32>("outError", ERROR)
        .null(NullRule::Own(
            "Null while the driver does not know the value; an unknown error is 1.",
        )),
        Definition::new(
            "RobotBase::WheelMonitor",
            "What a wheel of a base does, as its driver last reported.",
            wheel_monitor,
        )
        .text("Robot", ROBOT)
        .parameter::<i32>("Wheel", "0", "which wheel, from 0")
        .output::<f64>("outPos", "angle since the start, rad")
        .output::<f64>("outVel", "speed, rad/s")
        .null(NullRule::Own(
            "Null while the driver does not know the value.",
        )),
        Definition::new(
            "RobotBase::OmnidirectionalBaseController",
            "The velocity that brings a base straight to a pose, proportional to what is left. With \
             inVel it changes by the largest speed in a second at most.",
            controller,
        )
        .input::<Frame>(port("inDest", "pose to reach in the reference frame, m"))
        .input::<Frame>(port("inPos", "pose of the base in the reference frame, m"))
        .input::<Twist>(port(
            "inVel",
            "velocity of the base in its own frame, m/s and rad/s",
        ))
        .parameter::<f64>("velX", "0.25", "largest speed in x of the reference frame, m/s")
        .parameter::<f64>("velY", "0.25", "largest speed in y of the reference frame, m/s")
        .parameter::<f64>("velYaw", "0.3", "largest rotational speed, rad/s")
        .parameter::<f64>("pX", "3", "speed for each metre left in x, 1/s")
        .parameter::<f64>("pY", "3", "speed for each metre left in y, 1/s")
        .parameter::<f64>("pYaw", "3", "rotational speed for each radian left, 1/s")
        .output::<bool>(
            "outCompleted",
            "less than 0.01 m and 0.01 rad are left in each direction",
        )
        .output::<Twist>("outVel", "velocity in the base's own frame, m/s and rad/s")
        .null(NullRule::Own(
            "Null if one of the poses is; a null inVel does not limit the change.",
        ))
        .cost_ns(150),
    ]
}

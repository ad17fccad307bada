//! `Motion::Lin`, `Motion::Circ` and `Motion::Spline`: a frame along a line, an arc or a smooth curve. Whether an arm can
//! follow is decided by its kinematics.

use nalgebra::{UnitQuaternion, Vector3};
use takt_net::definition::port;
use takt_net::{Build, Cycle, Definition, Fault, Frame, In, NullRule, Out, Primitive, Twist};

use super::bounds::{Bounds, State};
use super::course::{Departure, Geometry, WHOLE, stopping_ways};
use super::frame_path::{FramePath, FrameState, is_sensible};
use super::path::Path;
use super::ptp::incomplete;
use super::runner::{Runner, with_ports};
use super::spline::Spline;
use super::{ACCELERATION, JERK, VELOCITY, limit, slowed, speed};

const ROT_VELOCITY: &str = "RotVelocity";
const ROT_ACCELERATION: &str = "RotAcceleration";
const ROT_JERK: &str = "RotJerk";
/// Most points of a spline.
const POINTS_MAX: usize = 1000;

/// In ports of the state in which a frame begins.
struct FrameFrom {
    frame: In<Frame>,
    velocity: Option<In<Twist>>,
    acceleration: Option<In<Twist>>,
}

impl FrameFrom {
    /// `None` if `inFrom` is not connected.
    fn new(b: &mut Build<'_, '_>, parameter: &'static str) -> Result<Option<Self>, Fault> {
        let rates = ["inFromVelocity", "inFromAcceleration"];
        if !b.is_linked("inFrom") {
            return match rates.into_iter().find(|name| b.is_linked(name)) {
                Some(name) => Err(b.parameter_fault(parameter, incomplete(name))),
                None => Ok(None),
            };
        }
        let [velocity, acceleration] = rates.map(|name| b.is_linked(name).then_some(name));
        Ok(Some(Self {
            frame: b.input("inFrom")?,
            velocity: velocity.map(|name| b.input(name)).transpose()?,
            acceleration: acceleration.map(|name| b.input(name)).transpose()?,
        }))
    }

    /// The state of this cycle, if it is one.
    fn read(&self, cycle: &Cycle<'_>) -> Option<FrameState> {
        let rate = |port: Option<In<Twist>>| match port {
            Some(port) => port.get(cycle),
            None => Some(Twist::default()),
        };
        let state = FrameState {
            frame: self.frame.get(cycle)?,
            velocity: rate(self.velocity)?,
            acceleration: rate(self.acceleration)?,
        };
        state.is_sensible().then_some(state)
    }
}

struct Cartesian {
    runner: Runner,
    path: FramePath,
    /// The end of a line that begins where the frame is.
    to: Option<Frame>,
    from: Option<FrameFrom>,
    /// Part of the path at which a motion that begins beside it is on it.
    join: Option<f64>,
    position: Out<Frame>,
    velocity: Out<Twist>,
    rest: Out<Frame>,
}

impl Cartesian {
    /// Begins in the state at the ports; returns whether the motion has begun.
    fn begin(&mut self, cycle: &Cycle<'_>, speed: f64) -> bool {
        let Some(from) = &self.from else {
            return true;
        };
        let Some(state) = from.read(cycle) else {
            return false;
        };
        begin(
            &mut self.path,
            &mut self.runner.course,
            &state,
            (self.to, self.join),
            speed,
        );
        true
    }
}

/// Rounds in which a line is found that begins where the motion across it ends: its direction depends on where that is.
const ROUNDS: usize = 4;

/// Begins a course in a state: on a line to `to`, or else beside the path, to be on it at `join` at the latest. A line to
/// `to` begins where what does not move along it comes to rest, so that a frame in motion needs no way back.
///
/// A frame beyond the bounds of a slower motion brakes into them within the whole limits.
pub(super) fn begin(
    path: &mut FramePath,
    course: &mut super::course::Course,
    state: &FrameState,
    aim: (Option<Frame>, Option<f64>),
    speed: f64,
) {
    let bounds = [path.translation, path.rotation];
    let [translation, rotation] = bounds;
    let twists = [
        (state.velocity.vel, state.acceleration.vel, translation),
        (state.velocity.rot, state.acceleration.rot, rotation),
    ];
    let are_beyond = twists.iter().any(|(velocity, acceleration, bounds)| {
        bounds.are_exceeded(State {
            position: 0.0,
            velocity: velocity.norm(),
            acceleration: acceleration.norm(),
        })
    });
    if course.speed() >= 1.0 || !are_beyond {
        begin_within(path, course, state, aim, (speed, None));
        return;
    }
    [path.translation, path.rotation] = bounds.map(|bounds| bounds.braking(course.speed()));
    begin_within(path, course, state, aim, (speed, Some(bounds)));
    [path.translation, path.rotation] = bounds;
}

/// Begins within the bounds of the path, or within those of a stop with these `gentle` ones to come to.
fn begin_within(
    path: &mut FramePath,
    course: &mut super::course::Course,
    state: &FrameState,
    (to, join): (Option<Frame>, Option<f64>),
    (speed, gentle): (f64, Option<[Bounds; 2]>),
) {
    let mut off = [State::default(); 6];
    if let Some(to) = to {
        path.path = path.path.starting_at(state.frame, &to);
        for _ in 0..ROUNDS {
            let along = path.depart(state, 0.0, &mut off);
            let mut ways = [0.0; 6];
            let departure = Departure {
                along,
                off: &off,
                join,
            };
            stopping_ways(path, &departure, &mut ways);
            let [x, y, z, a, b, c] = ways;
            let at = state.frame.translation.vector + Vector3::new(x, y, z);
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(a, b, c));
            let start = Frame::from_parts(at.into(), turn * state.frame.rotation);
            path.path = path.path.starting_at(start, &to);
        }
    }
    let nearest = || path.path.nearest(&state.frame.translation.vector);
    let part = join
        .and_then(|join| Some(nearest()?.min(join)))
        .unwrap_or(0.0);
    let along = path.depart(state, part, &mut off);
    let departure = Departure {
        along,
        off: &off,
        join,
    };
    if let Some([translation, rotation]) = gentle {
        let (_, gentle) = path.path.bounds(translation, rotation);
        course.begin_beyond(path, &departure, speed, gentle);
    } else {
        course.begin(path, &departure, speed);
    }
}

impl Primitive for Cartesian {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if let Some(speed) = self.runner.begins(cycle)
            && !self.begin(cycle, speed)
        {
            self.runner.wait(cycle);
            self.position.set(cycle, None);
            self.velocity.set(cycle, None);
            self.rest.set(cycle, None);
            return;
        }
        let progress = self.runner.step(cycle);
        let (frame, velocity) = self.path.at(progress, self.runner.course.lead());
        self.position.set(cycle, frame);
        self.velocity.set(cycle, velocity);
        let rest = self.path.path.at(self.runner.course.rest());
        self.rest.set(cycle, rest);
    }
}

fn bounds(b: &Build<'_, '_>, names: [&'static str; 3]) -> Result<Bounds, Fault> {
    let value = |name| limit(b, name, b.value(name)?);
    let [velocity, acceleration, jerk] = names;
    Ok(Bounds {
        velocity: value(velocity)?,
        acceleration: value(acceleration)?,
        jerk: value(jerk)?,
    })
}

fn sensible(b: &Build<'_, '_>, parameter: &'static str, frame: Frame) -> Result<Frame, Fault> {
    if is_sensible(&frame) {
        return Ok(frame);
    }
    let why = "this frame is invalid: its numbers are not finite or too large".to_owned();
    Err(b.parameter_fault(parameter, why))
}

fn frame_parameter(b: &Build<'_, '_>, parameter: &'static str) -> Result<Frame, Fault> {
    sensible(b, parameter, b.value(parameter)?)
}

fn motion(
    b: &mut Build<'_, '_>,
    path: Path,
    start: &'static str,
    (to, join): (Option<Frame>, Option<f64>),
) -> Result<Cartesian, Fault> {
    let speed = speed(b)?;
    let path = FramePath {
        path,
        translation: slowed(b, bounds(b, [VELOCITY, ACCELERATION, JERK])?, speed)?,
        rotation: slowed(
            b,
            bounds(b, [ROT_VELOCITY, ROT_ACCELERATION, ROT_JERK])?,
            speed,
        )?,
    };
    let from = FrameFrom::new(b, start)?;
    Ok(Cartesian {
        runner: Runner::new(b, path.along(WHOLE), speed, from.is_some().then_some(6))?,
        path,
        to,
        from,
        join,
        position: b.output("outPosition"),
        velocity: b.output("outVelocity"),
        rest: b.output("outRest"),
    })
}

/// Adds the limits, the ports of the start and the outputs of all.
fn with_rest(definition: Definition) -> Definition {
    let definition = definition
        .input::<Frame>(port(
            "inFrom",
            "the frame in the previous cycle, m; taken in the first active cycle, in which the motion begins there",
        ))
        .input::<Twist>(port(
            "inFromVelocity",
            "its velocity in the base there, m/s and rad/s; at rest if not connected",
        ))
        .input::<Twist>(port(
            "inFromAcceleration",
            "its acceleration in the base there, m/s² and rad/s²; 0 if not connected",
        ))
        .parameter::<f64>(VELOCITY, "0.1", "largest speed of the position, m/s")
        .parameter::<f64>(
            ACCELERATION,
            "0.5",
            "largest acceleration of the position, m/s²",
        )
        .parameter::<f64>(JERK, "5", "largest jerk of the position, m/s³")
        .parameter::<f64>(
            ROT_VELOCITY,
            "0.5",
            "largest speed of the orientation, rad/s",
        )
        .parameter::<f64>(
            ROT_ACCELERATION,
            "2.5",
            "largest acceleration of the orientation, rad/s²",
        )
        .parameter::<f64>(ROT_JERK, "25", "largest jerk of the orientation, rad/s³")
        .output::<Frame>("outPosition", "the frame, m")
        .output::<Twist>("outVelocity", "its velocity in the base, m/s and rad/s")
        .output::<Frame>(
            "outRest",
            "where it comes to rest if it is stopped in two cycles, m: a net that stops it while an arm cannot reach \
             this frame leaves the path nowhere",
        );
    with_ports(definition).null(NullRule::Own(
        "Never null while active, once begun; a null override holds the motion. It begins when inFrom and the ports of \
         its rates, where connected, are numbers.",
    ))
}

const FROM: &str = "frame at the start, m";
const TO: &str = "frame at the end, m";

pub(super) fn lin() -> Definition {
    let build = |b: &mut Build<'_, '_>| {
        let (from, to) = (frame_parameter(b, "From")?, frame_parameter(b, "To")?);
        let join = b.double("Join", 0.0..=1.0)?;
        let ends = if join > 0.0 {
            (None, Some(join))
        } else {
            (Some(to), None)
        };
        motion(b, Path::line(from, &to), "From", ends)
    };
    let definition = Definition::new(
        "Motion::Lin",
        "Moves a frame along a straight line and turns it by the shortest rotation, as fast as the limits \
         of both allow; they start and arrive together. It may begin in motion, and beside its line.",
        build,
    )
    .parameter::<Frame>("From", "{}", FROM)
    .parameter::<Frame>("To", "{}", TO)
    .parameter::<f64>(
        "Join",
        "0",
        "where a motion that begins at inFrom is on the line From to To at the latest, as part of the line, 0 to 1; at 0 \
         the line begins at inFrom",
    );
    with_rest(definition)
}

pub(super) fn circ() -> Definition {
    let build = |b: &mut Build<'_, '_>| {
        let (from, via, to) = (
            frame_parameter(b, "From")?,
            frame_parameter(b, "Via")?,
            frame_parameter(b, "To")?,
        );
        let path = Path::arc(from, &via, &to).ok_or_else(|| {
            let why = "From, Via and To lie on one line, or two of them are one point: no arc leads \
                       through them";
            b.parameter_fault("Via", why.to_owned())
        });
        motion(b, path?, "From", (None, None))
    };
    let definition = Definition::new(
        "Motion::Circ",
        "Moves a frame along the arc through an auxiliary point and turns it by the shortest rotation, as \
         fast as the limits of both allow; the change of direction counts. It may begin in motion, and beside its arc.",
        build,
    )
    .parameter::<Frame>("From", "{}", FROM)
    .parameter::<Frame>("Via", "{}", "frame whose position is on the path, m")
    .parameter::<Frame>("To", "{}", TO);
    with_rest(definition)
}

fn spline_path(b: &Build<'_, '_>) -> Result<Path, Fault> {
    let points: Vec<Frame> = b.array("Points")?;
    if points.len() > POINTS_MAX {
        let why = format!(
            "{} points, but a spline has at most {POINTS_MAX}",
            points.len()
        );
        return Err(b.parameter_fault("Points", why));
    }
    let checked = points.iter().map(|frame| sensible(b, "Points", *frame));
    let points = checked.collect::<Result<Vec<_>, _>>()?;
    let tangents: Vec<Twist> = b.array("Tangents")?;
    let is_number = |twist: &Twist| {
        let mut values = twist.vel.iter().chain(&twist.rot);
        values.all(|value| super::is_sensible(*value))
    };
    if !tangents.is_empty() && tangents.len() != points.len() {
        let (found, wanted) = (tangents.len(), points.len());
        let why = format!("{found} tangents for {wanted} points; set one for each or none");
        return Err(b.parameter_fault("Tangents", why));
    }
    if !tangents.iter().all(is_number) {
        let why = "this tangent is invalid: its numbers are not finite or too large".to_owned();
        return Err(b.parameter_fault("Tangents", why));
    }
    let spline = Spline::new(&points, &tangents).ok_or_else(|| {
        let why = "a spline needs at least two points, and neighbours that differ";
        b.parameter_fault("Points", why.to_owned())
    })?;
    Ok(Path::spline(spline, points[0]))
}

pub(super) fn spline() -> Definition {
    let build = |b: &mut Build<'_, '_>| {
        let path = spline_path(b)?;
        motion(b, path, "Points", (None, None))
    };
    let definition = Definition::new(
        "Motion::Spline",
        "Moves a frame along a smooth curve through points, as fast as the limits of position and orientation allow \
         where the curve bends most. It may begin in motion, and beside its curve.",
        build,
    )
    .array_parameter::<Frame>(
        "Points",
        "[{},{pos:{x:0.1}}]",
        "frames on the curve, the first one at the start, m",
    )
    .array_parameter::<Twist>(
        "Tangents",
        "[]",
        "direction at each point, m and rad per unit of the curve's length, no unit; 0 or none: as the neighbours suggest",
    );
    with_rest(definition)
}

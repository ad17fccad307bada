//! `Motion::Lin` and `Motion::Circ`: a frame along a line or an arc. Whether an arm can follow is
//! decided by its kinematics.

use takt_net::{Build, Cycle, Definition, Fault, Frame, NullRule, Out, Primitive, Twist};

use super::path::Path;
use super::profile::Bounds;
use super::runner::{Runner, with_ports};
use super::{ACCELERATION, JERK, VELOCITY, is_sensible, limit};

const ROT_VELOCITY: &str = "RotVelocity";
const ROT_ACCELERATION: &str = "RotAcceleration";
const ROT_JERK: &str = "RotJerk";

struct Cartesian {
    runner: Runner,
    path: Path,
    position: Out<Frame>,
    velocity: Out<Twist>,
}

impl Primitive for Cartesian {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let progress = self.runner.step(cycle);
        let (part, rate) = (progress.part, progress.rate);
        self.position.set(cycle, self.path.at(part));
        self.velocity.set(cycle, self.path.velocity(part, rate));
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

fn frame_parameter(b: &Build<'_, '_>, parameter: &'static str) -> Result<Frame, Fault> {
    let frame: Frame = b.value(parameter)?;
    let position = frame.translation.vector.iter();
    let mut values = position.chain(frame.rotation.coords.iter());
    if values.all(|v| is_sensible(*v)) {
        return Ok(frame);
    }
    let why = "this frame is invalid: its numbers are not finite or too large".to_owned();
    Err(b.parameter_fault(parameter, why))
}

fn motion(b: &mut Build<'_, '_>, path: Path) -> Result<Cartesian, Fault> {
    let translation = bounds(b, [VELOCITY, ACCELERATION, JERK])?;
    let rotation = bounds(b, [ROT_VELOCITY, ROT_ACCELERATION, ROT_JERK])?;
    let (length, along) = path.bounds(translation, rotation);
    Ok(Cartesian {
        runner: Runner::new(b, length, along)?,
        path,
        position: b.output("outPosition"),
        velocity: b.output("outVelocity"),
    })
}

/// Adds the limits and outputs of both.
fn with_rest(definition: Definition) -> Definition {
    let definition = definition
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
        .output::<Twist>("outVelocity", "its velocity in the base, m/s and rad/s");
    with_ports(definition).null(NullRule::Own(
        "Never null while active; a null override holds the motion.",
    ))
}

const FROM: &str = "frame at the start, m";
const TO: &str = "frame at the end, m";

pub(super) fn lin() -> Definition {
    let build = |b: &mut Build<'_, '_>| {
        let path = Path::line(frame_parameter(b, "From")?, &frame_parameter(b, "To")?);
        motion(b, path)
    };
    let definition = Definition::new(
        "Motion::Lin",
        "Moves a frame along a straight line and turns it by the shortest rotation, as fast as the limits \
         of both allow; they start and arrive together.",
        build,
    )
    .parameter::<Frame>("From", "{}", FROM)
    .parameter::<Frame>("To", "{}", TO);
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
        motion(b, path?)
    };
    let definition = Definition::new(
        "Motion::Circ",
        "Moves a frame along the arc through an auxiliary point and turns it by the shortest rotation, as \
         fast as the limits of both allow; the change of direction counts.",
        build,
    )
    .parameter::<Frame>("From", "{}", FROM)
    .parameter::<Frame>("Via", "{}", "frame whose position is on the path, m")
    .parameter::<Frame>("To", "{}", TO);
    with_rest(definition)
}

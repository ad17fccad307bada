//! Paths of frames: lines, arcs and curves, as plans and as primitives; and the kinematics between frames and joints.

use std::time::Duration;

use takt_motion::plan::{self, FrameSample, FrameState, PlanError, plan_frame_at};

use super::{ArmDescription, CartesianLimits};
use crate::error::ErrorKind;
use crate::net::{Argument, Net, Port};
use crate::pose::Pose;

/// Most points of a curve.
const POINTS_MAX: usize = 63;

/// A path of a frame, from where it is.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Route {
    /// Straight.
    Line(Pose),
    /// Along the arc through `via` to `to`; the orientation of `via` is not used.
    Arc { via: Pose, to: Pose },
    /// Along a smooth curve through points.
    Spline(Vec<Pose>),
}

/// Ports of a motion of joints.
pub(crate) struct Course {
    pub(crate) joints: Port,
    pub(crate) progress: Port,
    pub(crate) done: Port,
}

/// Ports of a motion of a frame.
pub(crate) struct Moved {
    pub(crate) position: Port,
    /// Where it comes to rest if it stops now.
    pub(crate) rest: Port,
    pub(crate) progress: Port,
    pub(crate) done: Port,
}

impl Moved {
    pub(crate) fn course(self, joints: Port) -> Course {
        Course {
            joints,
            progress: self.progress,
            done: self.done,
        }
    }
}

/// A frame in motion: where it is, its velocity and its acceleration.
pub(crate) struct InMotion {
    pub(crate) frame: Port,
    pub(crate) velocity: Port,
    pub(crate) acceleration: Port,
}

impl Route {
    pub(crate) fn check(&self, name: &str) -> Result<(), ErrorKind> {
        let not_finite = |what: &str| Err(ErrorKind::not_finite(name, what));
        match self {
            Self::Line(to) if !to.is_finite() => not_finite("the pose"),
            Self::Arc { via, to } if !(via.is_finite() && to.is_finite()) => {
                not_finite("a pose of the arc")
            }
            Self::Spline(points) if !points.iter().all(Pose::is_finite) => {
                not_finite("a point of the curve")
            }
            Self::Spline(points) if !(1..=POINTS_MAX).contains(&points.len()) => {
                let count = points.len();
                let text = format!("{name}: {count} points; a curve has 1 to {POINTS_MAX}");
                Err(ErrorKind::Invalid(text))
            }
            Self::Line(_) | Self::Arc { .. } | Self::Spline(_) => Ok(()),
        }
    }

    /// Whether it leads from its start; a line leads from anywhere.
    pub(crate) const fn needs_start(&self) -> bool {
        matches!(self, Self::Arc { .. } | Self::Spline(_))
    }

    /// The same path in a frame whose reference is at `by`.
    pub(crate) fn moved(&self, by: &Pose) -> Self {
        match self {
            Self::Line(to) => Self::Line(*by * *to),
            Self::Arc { via, to } => Self::Arc {
                via: *by * *via,
                to: *by * *to,
            },
            Self::Spline(points) => Self::Spline(points.iter().map(|p| *by * *p).collect()),
        }
    }

    /// Plans it from rest at a start, at a part of the speed.
    pub(crate) fn plan(
        &self,
        start: &Pose,
        (limits, speed): (&CartesianLimits, f64),
        period: Duration,
    ) -> Result<plan::Plan<FrameSample>, PlanError> {
        let from = *start.isometry();
        let route = match self {
            Self::Line(to) => plan::Route::Line { to: *to.isometry() },
            Self::Arc { via, to } => plan::Route::Arc {
                from,
                via: *via.isometry(),
                to: *to.isometry(),
            },
            Self::Spline(points) => {
                let points = points.iter().map(|point| *point.isometry());
                plan::Route::Spline {
                    points: std::iter::once(from).chain(points).collect(),
                    tangents: Vec::new(),
                }
            }
        };
        plan_frame_at(
            &FrameState::at_rest(from),
            &route,
            limits.bounds(),
            speed,
            period,
        )
    }

    /// Writes the primitive that moves the frame, from where it is in motion, else from `start`; `None` if the path needs
    /// to know its start and does not.
    pub(crate) fn write(
        &self,
        net: &mut Net,
        (stop, (limits, speed)): (&Port, (&CartesianLimits, f64)),
        from: Option<&InMotion>,
        start: Option<&Pose>,
    ) -> Option<Moved> {
        let over = net.override_in();
        let mut arguments: Vec<(&str, Argument)> =
            vec![("inStop", stop.into()), ("inOverride", (&over).into())];
        if let Some(from) = from {
            arguments.push(("inFrom", (&from.frame).into()));
            arguments.push(("inFromVelocity", (&from.velocity).into()));
            arguments.push(("inFromAcceleration", (&from.acceleration).into()));
        }
        let kind = match self {
            // Without its own start, a line begins where the frame is.
            Self::Line(to) => {
                match from {
                    Some(_) => arguments.push(("Join", "0".into())),
                    None => arguments.push(("From", start?.text().into())),
                }
                arguments.push(("To", to.text().into()));
                "Motion::Lin"
            }
            Self::Arc { via, to } => {
                arguments.push(("From", start?.text().into()));
                arguments.push(("Via", via.text().into()));
                arguments.push(("To", to.text().into()));
                "Motion::Circ"
            }
            Self::Spline(points) => {
                let points = std::iter::once(start?).chain(points);
                let texts: Vec<_> = points.map(Pose::text).collect();
                arguments.push(("Points", format!("[{}]", texts.join(",")).into()));
                "Motion::Spline"
            }
        };
        arguments.extend(limits.arguments(speed));
        let motion = net.add_with(kind, &arguments);
        Some(Moved {
            position: motion.out("outPosition"),
            rest: motion.out("outRest"),
            progress: motion.out("outProgress"),
            done: motion.out("outDone"),
        })
    }
}

/// Where a motion centre is commanded, which is at `tool` in the flange, in the base of its arm.
pub(crate) fn centre_of(net: &mut Net, arm: &ArmDescription, tool: &Pose) -> Port {
    let positions = arm.joint_array(net, "outCommandedPosition");
    let flange = [
        ("inJoints", (&positions).into()),
        ("Robot", Argument::from(arm.name.as_str())),
    ];
    let flange = net.add("ArmKinematics::Kin", flange).out("outFrame");
    net.transform(&flange, tool)
}

/// The commanded state of a motion centre, which is at `tool` in the flange.
pub(crate) fn commanded(net: &mut Net, arm: &ArmDescription, tool: &Pose) -> InMotion {
    let positions = arm.joint_array(net, "outCommandedPosition");
    let velocities = arm.joint_array(net, "outCommandedVelocity");
    let accelerations = arm.joint_array(net, "outCommandedAcceleration");
    let frame = centre_of(net, arm, tool);
    let twist = [
        ("inJoints", (&positions).into()),
        ("inVelocities", (&velocities).into()),
        ("inAccelerations", (&accelerations).into()),
        ("Robot", Argument::from(arm.name.as_str())),
        ("Tool", tool.text().into()),
    ];
    let moved = net.add("ArmKinematics::VelKin", twist);
    InMotion {
        frame,
        velocity: moved.out("outTwist"),
        acceleration: moved.out("outAcceleration"),
    }
}

/// The same for a motion centre of an arm whose base is at `base`, in the reference of the base's pose.
pub(crate) fn commanded_in(
    net: &mut Net,
    arm: &ArmDescription,
    base: &Pose,
    tool: &Pose,
) -> InMotion {
    let moved = commanded(net, arm, tool);
    if *base == Pose::IDENTITY {
        return moved;
    }
    let base = net.frame(base);
    let frame = net.of_two("World::FrameTransform", &base, &moved.frame);
    let rotation = [("inValue", (&base).into())];
    let rotation = net.add("World::FrameToPosRot", rotation).out("outRotation");
    let mut turned = |twist: &Port| {
        let turned = [("inValue", twist.into()), ("inRot", (&rotation).into())];
        net.add("World::TwistRotate", turned).out("outValue")
    };
    let [velocity, acceleration] = [&moved.velocity, &moved.acceleration].map(&mut turned);
    InMotion {
        frame,
        velocity,
        acceleration,
    }
}

/// The joints that bring the flange to a frame, next to those that are commanded; and whether there are none.
pub(crate) fn inverse(net: &mut Net, arm: &ArmDescription, flange: &Port) -> (Port, Port) {
    let positions = arm.joint_array(net, "outCommandedPosition");
    let arguments = [
        ("inFrame", flange.into()),
        ("inHintJoints", (&positions).into()),
        ("Robot", arm.name.as_str().into()),
    ];
    let joints = net.add("ArmKinematics::InvKin", arguments).out("outJoints");
    let none = net.of("Core::DoubleArrayIsNull", &joints);
    let moves = net.of("World::FrameIsNull", flange);
    let moves = net.of("Core::BooleanNot", &moves);
    let unreachable = net.of_two("Core::BooleanAnd", &none, &moves);
    (joints, unreachable)
}

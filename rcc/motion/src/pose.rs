//! Motions between poses: interpolation of frames and rotations, and the online generator for
//! frames. Joint limits and reachability are not known here.

use takt_net::definition::{Port, port};
use takt_net::{
    Build, Cycle, Definition, Fault, Frame, In, NullRule, Out, Primitive, Rotation, Twist, Vector,
    function,
};

use crate::otg::approach;
use crate::shape::{bezier, hermite};

/// The frame at part `amount` between two frames; the orientation turns by the shorter rotation
/// about one axis.
fn lerp(from: Frame, to: Frame, amount: f64) -> Frame {
    let (a, b) = (from.translation.vector, to.translation.vector);
    let turn = (from.rotation.inverse() * to.rotation).scaled_axis();
    let rotation = from.rotation * Rotation::from_scaled_axis(turn * amount);
    Frame::from_parts((a + (b - a) * amount).into(), rotation)
}

fn numbers(rotation: Rotation) -> [f64; 4] {
    rotation.into_inner().coords.into()
}

/// Derivative of the quaternion of `rotation` while it turns with `velocity`.
fn change(rotation: Rotation, velocity: Vector) -> [f64; 4] {
    let velocity = nalgebra::Quaternion::from_imag(velocity);
    (velocity * rotation.into_inner() * 0.5).coords.into()
}

/// The cubic curve through quaternions, normalized. Of the two quaternions of the goal, the one
/// nearer to the start is used, or else the curve would take the longer rotation. `None` where the
/// curve passes zero or an input is not finite.
fn rotation_bezier(from: (Rotation, Vector), to: (Rotation, Vector), t: f64) -> Option<Rotation> {
    let (p, p_change) = (numbers(from.0), change(from.0, from.1));
    let (q, q_change) = (numbers(to.0), change(to.0, to.1));
    let dot: f64 = p.iter().zip(&q).map(|(p, q)| p * q).sum();
    let sign = if dot < 0.0 { -1.0 } else { 1.0 };
    let curve = |i: usize| {
        bezier(
            t,
            hermite(p[i], sign * q[i], p_change[i], sign * q_change[i]),
        )
    };
    let point = nalgebra::Vector4::from_fn(|i, _| curve(i));
    Rotation::try_new(nalgebra::Quaternion::from_vector(point), 1e-9)
}

#[derive(Clone, Copy, Debug)]
struct Limits {
    velocity: f64,
    acceleration: f64,
}

/// One part of a motion, translation or rotation, relative to the goal.
#[derive(Clone, Copy, Debug)]
struct Part {
    /// Remaining distance.
    distance: Vector,
    /// Present velocity.
    now: Vector,
    /// Velocity of the goal.
    goal: Vector,
    limits: Limits,
}

impl Part {
    /// The wanted velocity of the next cycle, relative to the goal.
    fn wanted(&self, period_s: f64) -> Vector {
        let distance = self.distance / period_s - (self.now - self.goal) / 2.0;
        let length = distance.norm();
        let delta_v = self.limits.acceleration * period_s;
        if length > 0.0 && delta_v > 0.0 {
            let speed = approach(length, delta_v).min(self.limits.velocity);
            distance * (speed / length)
        } else {
            Vector::zeros()
        }
    }

    /// The time to the goal at the velocity `wanted`; less than that if it still accelerates.
    fn time(&self, wanted: Vector) -> f64 {
        let speed = wanted.norm();
        if speed > 0.0 {
            self.distance.norm() / speed
        } else {
            0.0
        }
    }

    /// The next velocity: the wanted one as far as the limits allow.
    fn velocity(&self, wanted: Vector, period_s: f64) -> Vector {
        let wanted = shortened(self.goal + wanted, self.limits.velocity);
        self.now + shortened(wanted - self.now, self.limits.acceleration * period_s)
    }
}

fn shortened(vector: Vector, length: f64) -> Vector {
    let norm = vector.norm();
    if norm > length {
        vector * (length / norm)
    } else {
        vector
    }
}

/// A pose and its velocity.
#[derive(Clone, Copy, Debug)]
struct State {
    pos: Frame,
    vel: Twist,
}

impl State {
    fn is_finite(&self) -> bool {
        let (pos, vel) = (&self.pos, &self.vel);
        let numbers = pos
            .translation
            .vector
            .iter()
            .chain(pos.rotation.coords.iter());
        let mut numbers = numbers.chain(vel.vel.iter()).chain(vel.rot.iter());
        numbers.all(|n| n.is_finite())
    }
}

/// Advances by one cycle. Translation and rotation arrive together: the part that would be earlier
/// is slowed down, so that a path between two frames does not depend on the limits. `None` if an
/// input is not finite or a limit is negative.
fn step(now: State, goal: State, trans: Limits, rot: Limits, period_s: f64) -> Option<State> {
    let before = moved(goal.pos, goal.vel, -period_s);
    let translation = Part {
        distance: before.translation.vector - now.pos.translation.vector,
        now: now.vel.vel,
        goal: goal.vel.vel,
        limits: trans,
    };
    let rotation = Part {
        distance: (before.rotation * now.pos.rotation.inverse()).scaled_axis(),
        now: now.vel.rot,
        goal: goal.vel.rot,
        limits: rot,
    };
    let bounds = [
        trans.velocity,
        trans.acceleration,
        rot.velocity,
        rot.acceleration,
    ];
    let bounds_are_valid = bounds.iter().all(|b| *b >= 0.0 && b.is_finite());
    if !bounds_are_valid || !now.is_finite() || !goal.is_finite() {
        return None;
    }
    let (mut t, mut r) = (translation.wanted(period_s), rotation.wanted(period_s));
    let times = (translation.time(t), rotation.time(r));
    if times.0 < times.1 {
        t *= times.0 / times.1;
    } else if times.1 < times.0 {
        r *= times.1 / times.0;
    }
    let vel = Twist {
        vel: translation.velocity(t, period_s),
        rot: rotation.velocity(r, period_s),
    };
    let mean = Twist {
        vel: (now.vel.vel + vel.vel) / 2.0,
        rot: (now.vel.rot + vel.rot) / 2.0,
    };
    let pos = moved(now.pos, mean, period_s);
    Some(State { pos, vel }).filter(State::is_finite)
}

/// The frame after a motion with `twist` for `span_s`.
fn moved(frame: Frame, twist: Twist, span_s: f64) -> Frame {
    let position = frame.translation.vector + twist.vel * span_s;
    let mut rotation = Rotation::from_scaled_axis(twist.rot * span_s) * frame.rotation;
    rotation.renormalize();
    Frame::from_parts(position.into(), rotation)
}

struct FrameOtg {
    cur_pos: Option<In<Frame>>,
    cur_vel: Option<In<Twist>>,
    dest_pos: In<Frame>,
    dest_vel: In<Twist>,
    /// Limits of velocity and acceleration of translation, then of rotation.
    bounds: [In<f64>; 4],
    pos: Out<Frame>,
    vel: Out<Twist>,
    last: Option<State>,
    period_s: f64,
}

impl FrameOtg {
    fn new(b: &mut Build<'_, '_>) -> Result<Self, Fault> {
        let cur_pos = b.is_linked("inCurPos").then(|| b.input("inCurPos"));
        let cur_vel = b.is_linked("inCurVel").then(|| b.input("inCurVel"));
        let dest_vel = if b.is_linked("inDestVel") {
            b.input("inDestVel")?
        } else {
            b.constant(Twist::default())
        };
        Ok(Self {
            cur_pos: cur_pos.transpose()?,
            cur_vel: cur_vel.transpose()?,
            dest_pos: b.input("inDestPos")?,
            dest_vel,
            bounds: [
                b.input("inMaxTransVel")?,
                b.input("inMaxTransAcc")?,
                b.input("inMaxRotVel")?,
                b.input("inMaxRotAcc")?,
            ],
            pos: b.output("outPos"),
            vel: b.output("outVel"),
            last: None,
            period_s: b.period_s(),
        })
    }

    fn next(&self, cycle: &Cycle<'_>) -> Option<State> {
        let goal = State {
            pos: self.dest_pos.get(cycle)?,
            vel: self.dest_vel.get(cycle)?,
        };
        let last = self.last.unwrap_or_else(|| State {
            pos: goal.pos,
            vel: Twist::default(),
        });
        let now = State {
            pos: self.cur_pos.map_or(Some(last.pos), |p| p.get(cycle))?,
            vel: self.cur_vel.map_or(Some(last.vel), |v| v.get(cycle))?,
        };
        let limits = |velocity: In<f64>, acceleration: In<f64>| {
            Some(Limits {
                velocity: velocity.get(cycle)?,
                acceleration: acceleration.get(cycle)?,
            })
        };
        let [tv, ta, rv, ra] = self.bounds;
        step(now, goal, limits(tv, ta)?, limits(rv, ra)?, self.period_s)
    }
}

impl Primitive for FrameOtg {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let next = self.next(cycle);
        self.last = next.or(self.last);
        self.pos.set(cycle, next.map(|state| state.pos));
        self.vel.set(cycle, next.map(|state| state.vel));
    }
}

fn frame_otg() -> Definition {
    let bound = |name, doc, parameter| port(name, doc).or(parameter, "1");
    Definition::new(
        "World::FrameOTG",
        "One step a cycle towards a frame, within bounds on velocity and acceleration of \
         translation and rotation, which arrive together. Where the present state is not \
         connected it starts at rest at the goal.",
        FrameOtg::new,
    )
    .cost_ns(3_000)
    .active()
    .input::<Frame>(port(
        "inCurPos",
        "present frame; if not connected, the last output",
    ))
    .input::<Twist>(port(
        "inCurVel",
        "present twist; if not connected, the last output",
    ))
    .input::<Frame>(port("inDestPos", "the goal").required())
    .input::<Twist>(port(
        "inDestVel",
        "twist of the goal; none if not connected",
    ))
    .input::<f64>(bound("inMaxTransVel", "velocity limit, m/s", "MaxTransVel"))
    .input::<f64>(bound(
        "inMaxTransAcc",
        "acceleration limit, m/s²",
        "MaxTransAcc",
    ))
    .input::<f64>(bound(
        "inMaxRotVel",
        "rotational velocity limit, rad/s",
        "MaxRotVel",
    ))
    .input::<f64>(bound(
        "inMaxRotAcc",
        "rotational acceleration limit, rad/s²",
        "MaxRotAcc",
    ))
    .output::<Frame>("outPos", "frame of this cycle")
    .output::<Twist>("outVel", "twist at its end")
    .null(NullRule::Own(
        "Null if a connected input is null or not finite, or a bound is negative; the state then \
         stays.",
    ))
}

const fn needed(name: &'static str, doc: &'static str) -> Port {
    port(name, doc).required()
}

pub(crate) fn table() -> Vec<Definition> {
    vec![
        function(
            "World::FrameLerp",
            "A frame between two frames: its position on the straight line, its orientation \
             turned by the shorter rotation about one axis.",
            &[
                needed("inFrom", "start"),
                needed("inTo", "goal"),
                needed(
                    "inAmount",
                    "part of the path; 0 is From, 1 is To, others extrapolate",
                ),
            ],
            &[("outValue", "the frame")],
            |(from, to, amount): (Frame, Frame, f64)| Some((lerp(from, to, amount),)),
        )
        .active(),
        function(
            "World::RotationBezier",
            "The smooth turn between two rotations with given rotational velocities at its ends. \
             Null where there is none because the ends are opposite.",
            &[
                needed("inFrom", "start"),
                needed(
                    "inFromVel",
                    "velocity at the start, rad per unit of inValue",
                ),
                needed("inTo", "goal"),
                needed("inToVel", "velocity at the goal, rad per unit of inValue"),
                needed("inValue", "parameter of the curve, 0 at From to 1 at To"),
            ],
            &[("outValue", "the rotation")],
            |(from, from_vel, to, to_vel, t): (Rotation, Vector, Rotation, Vector, f64)| {
                Some((rotation_bezier((from, from_vel), (to, to_vel), t)?,))
            },
        ),
        frame_otg(),
    ]
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::bench::series;

    fn about_z(angle: f64) -> Rotation {
        Rotation::from_euler_angles(0.0, 0.0, angle)
    }

    fn frame(x: f64, turn: f64) -> Frame {
        Frame::from_parts(Vector::new(x, 0.0, 0.0).into(), about_z(turn))
    }

    #[test]
    fn lerp_takes_shorter_rotation() {
        let half = lerp(frame(1.0, 3.0), frame(3.0, -3.0), 0.5);
        assert!((half.translation.vector.x - 2.0).abs() < 1e-12);
        assert!(half.rotation.angle_to(&about_z(PI)) < 1e-9);
        let end = lerp(frame(1.0, 0.1), frame(3.0, 2.0), 1.0);
        assert!(end.rotation.angle_to(&about_z(2.0)) < 1e-12);
    }

    #[test]
    fn rotation_bezier_keeps_ends_and_velocities() {
        let (from, to) = (
            (about_z(3.0), Vector::z()),
            (about_z(-3.0), Vector::z() * 0.5),
        );
        let at = |t: f64| rotation_bezier(from, to, t).unwrap();
        assert!(at(0.0).angle_to(&from.0) < 1e-12 && at(1.0).angle_to(&to.0) < 1e-12);
        let h = 1e-5;
        let start = (at(h) * at(0.0).inverse()).scaled_axis() / h;
        assert!((start - from.1).norm() < 1e-3, "{start}");
        let end = (at(1.0) * at(1.0 - h).inverse()).scaled_axis() / h;
        assert!((end - to.1).norm() < 1e-3, "{end}");
        for i in 0..=100 {
            let angle = at(f64::from(i) / 100.0).angle_to(&about_z(PI));
            assert!(angle < 0.3, "the curve passes π, not 0: {angle}");
        }
        // The other quaternion of the same rotation makes no difference.
        let other = Rotation::new_unchecked(-to.0.into_inner());
        let same = rotation_bezier(from, (other, to.1), 0.3).unwrap();
        assert!(same.angle_to(&at(0.3)) < 1e-12);
        assert_eq!(rotation_bezier(from, to, f64::NAN), None);
    }

    fn limits(velocity: f64, acceleration: f64) -> Limits {
        Limits {
            velocity,
            acceleration,
        }
    }

    const REST: Twist = Twist {
        vel: Vector::new(0.0, 0.0, 0.0),
        rot: Vector::new(0.0, 0.0, 0.0),
    };

    /// From rest to rest within 5 s; both parts must have the same progress in between.
    fn arrives(trans: Limits, rot: Limits) {
        let (pos, turned) = (frame(0.4, 1.0), about_z(1.0));
        let goal = State { pos, vel: REST };
        let mut now = State {
            pos: frame(0.0, 0.0),
            vel: REST,
        };
        let check = |name: &str, before: Vector, after: Vector, limits: Limits| {
            let acc = (after - before).norm() / 1e-3;
            assert!(acc < limits.acceleration + 1e-9, "{name}: {acc}");
            assert!(after.norm() < limits.velocity + 1e-12, "{name}: {after}");
        };
        for cycle in 0..5000 {
            let next = step(now, goal, trans, rot, 1e-3).unwrap();
            check("translation", now.vel.vel, next.vel.vel, trans);
            check("rotation", now.vel.rot, next.vel.rot, rot);
            now = next;
            if cycle == 2000 {
                let ahead = now.pos.translation.vector.x / 0.4 - now.pos.rotation.angle();
                assert!(ahead.abs() < 0.03, "translation is ahead by {ahead}");
            }
        }
        assert!((now.pos.translation.vector.x - 0.4).abs() < 1e-9, "{now:?}");
        assert!(now.pos.rotation.angle_to(&turned) < 1e-7, "{now:?}");
    }

    #[test]
    fn frame_otg_arrives_synchronously_within_limits() {
        arrives(limits(0.5, 2.0), limits(0.25, 1.0));
        arrives(limits(0.1, 1.0), limits(2.0, 5.0));
    }

    #[test]
    fn frame_otg_from_any_state_arrives() {
        let goal = State {
            pos: Frame::from_parts(
                Vector::new(0.1, -0.2, 0.3).into(),
                Rotation::from_euler_angles(1.0, -0.5, 2.0),
            ),
            vel: REST,
        };
        let spin = Twist {
            vel: Vector::new(0.3, 0.0, -0.2),
            rot: Vector::new(0.5, 1.0, 0.0),
        };
        let mut now = State {
            pos: Frame::identity(),
            vel: spin,
        };
        for _ in 0..8000 {
            now = step(now, goal, limits(0.5, 2.0), limits(1.0, 3.0), 1e-3).unwrap();
        }
        assert!((now.pos.translation.vector - goal.pos.translation.vector).norm() < 1e-9);
        assert!(
            now.pos.rotation.angle_to(&goal.pos.rotation) < 1e-7,
            "{now:?}"
        );
    }

    #[test]
    fn frame_otg_with_invalid_input_is_none() {
        let rest = State {
            pos: frame(0.0, 0.0),
            vel: REST,
        };
        let away = State {
            pos: frame(f64::NAN, 0.0),
            vel: REST,
        };
        let one = limits(1.0, 1.0);
        assert!(step(rest, away, one, one, 1e-3).is_none());
        assert!(step(away, rest, one, one, 1e-3).is_none());
        assert!(step(rest, rest, limits(-1.0, 1.0), one, 1e-3).is_none());
        assert!(step(rest, rest, one, limits(1.0, f64::NAN), 1e-3).is_none());
    }

    #[test]
    fn pose_primitives_compute_their_functions() {
        let net = "a=World::FrameFromPosRot(X='1'),b=World::FrameFromPosRot(X='3'),\
                   h=Core::DoubleValue(Value='0.5'),\
                   l=World::FrameLerp(inFrom=a.outValue,inTo=b.outValue,inAmount=h.outValue)";
        let net = format!("{net},p=World::FrameToPosRot(inValue=l.outValue)");
        let position = series(&net, "World::Vector", "p.outPosition", 1);
        assert_eq!(position, ["{x:2,y:0,z:0}"]);
        let net = "g=World::FrameFromPosRot(X='1'),s=World::FrameFromPosRot(),\
                   o=World::FrameOTG(inDestPos=g.outValue,inCurPos=s.outValue)";
        let twist = "{vel:{x:0.001,y:0,z:0},rot:{x:0,y:0,z:0}}";
        assert_eq!(series(net, "World::Twist", "o.outVel", 1), [twist]);
    }
}

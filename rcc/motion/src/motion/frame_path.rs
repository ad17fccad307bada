//! A path of a frame with its limits, and how a frame in any state of motion comes onto it.

use nalgebra::{UnitQuaternion, Vector3};
use takt_net::{Frame, Twist};

use super::bounds::{Bounds, State};
use super::course::{Geometry, Group, MOSTLY, Progress, WHOLE};
use super::lead::Lead;
use super::path::Path;
use super::spline::{turned, turning};

/// Square of a velocity per part of the path below which it has no direction.
const STILL: f64 = 1e-18;

/// A frame in motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameState {
    /// The frame in the base, m.
    pub frame: Frame,
    /// Its velocity in the base, m/s and rad/s.
    pub velocity: Twist,
    /// Its acceleration in the base, m/s² and rad/s².
    pub acceleration: Twist,
}

impl FrameState {
    /// At rest at this frame.
    pub fn at_rest(frame: Frame) -> Self {
        Self {
            frame,
            ..Self::default()
        }
    }

    pub(super) fn is_sensible(&self) -> bool {
        let rates = [self.velocity, self.acceleration];
        let rates = rates
            .iter()
            .flat_map(|twist| twist.vel.iter().chain(&twist.rot));
        is_sensible(&self.frame) && rates.copied().all(super::is_sensible)
    }
}

/// Whether a frame consists of plausible numbers.
pub(super) fn is_sensible(frame: &Frame) -> bool {
    let position = frame.translation.vector.iter();
    let mut values = position.chain(frame.rotation.coords.iter());
    values.all(|value| super::is_sensible(*value))
}

/// A path with limits of translation and rotation.
#[derive(Clone, Debug)]
pub(super) struct FramePath {
    pub(super) path: Path,
    /// In m.
    pub(super) translation: Bounds,
    /// In rad.
    pub(super) rotation: Bounds,
}

/// The part of `of` along `direction`, relative to its length; `None` if that is zero.
fn along(of: &Vector3<f64>, direction: &Vector3<f64>) -> Option<f64> {
    let square = direction.norm_squared();
    (square > STILL).then(|| of.dot(direction) / square)
}

/// The part of `of` along a twist; its rotation counts only where it has no translation.
fn share(of: &Twist, direction: &Twist) -> f64 {
    let rotation = || along(&of.rot, &direction.rot);
    along(&of.vel, &direction.vel)
        .or_else(rotation)
        .unwrap_or(0.0)
}

/// The largest rate along a direction that leaves not more than `limit` of a velocity beside it.
fn most_rate(velocity: &Vector3<f64>, direction: &Vector3<f64>, limit: f64) -> f64 {
    let square = direction.norm_squared();
    if square <= STILL {
        return f64::INFINITY;
    }
    let along = velocity.dot(direction);
    let rest = limit.max(0.0).powi(2) - velocity.norm_squared();
    (along + (along * along + square * rest).max(0.0).sqrt()).max(0.0) / square
}

/// The same half of a velocity, of a direction and of an acceleration.
type Halves = (Vector3<f64>, Vector3<f64>, Vector3<f64>);

/// What a velocity gains until its acceleration has ended.
fn gained(acceleration: &Vector3<f64>, bounds: Bounds) -> Vector3<f64> {
    acceleration * (acceleration.norm() / (2.0 * bounds.jerk))
}

impl FramePath {
    /// The rate of the path (1/s) that fits a velocity best, for a frame in that state. What moves against the path
    /// deviates by more than its own velocity, but not by more than the limit.
    fn rate(&self, now: &FrameState, velocity: &Twist, direction: &Twist) -> f64 {
        let (length, bounds) = self.along(WHOLE);
        let rate = share(velocity, direction).clamp(0.0, bounds.velocity / length);
        let vel = (now.velocity.vel, direction.vel, now.acceleration.vel);
        let rot = (now.velocity.rot, direction.rot, now.acceleration.rot);
        let limits = [(vel, self.translation), (rot, self.rotation)];
        let most = |((velocity, direction, acceleration), bounds): &(Halves, Bounds)| {
            let limit = bounds.velocity - acceleration.norm_squared() / bounds.jerk;
            most_rate(velocity, direction, limit)
        };
        limits.iter().map(most).fold(rate, f64::min)
    }

    /// The motion along the path from `part` on, and the deviations from it, of a frame in that state.
    pub(super) fn depart(&self, now: &FrameState, part: f64, off: &mut [State; 6]) -> State {
        let (length, bounds) = self.along(WHOLE);
        let direction = self.path.velocity(part, 1.0);
        let (mut rate, mut acceleration) = (0.0, 0.0);
        if length > 0.0 {
            rate = self.rate(now, &now.velocity, &direction);
            let inwards = self.path.acceleration(part, rate, 0.0);
            let rest = Twist {
                vel: now.acceleration.vel - inwards.vel,
                rot: now.acceleration.rot - inwards.rot,
            };
            let most = bounds.acceleration / length;
            let forwards = share(&rest, &direction).clamp(-most, most);
            let beside = [
                (rest.vel - direction.vel * forwards).norm() / self.translation.acceleration,
                (rest.rot - direction.rot * forwards).norm() / self.rotation.acceleration,
            ];
            if rate > 0.0 && beside[0].max(beside[1]) <= MOSTLY * forwards.abs() / most {
                acceleration = forwards;
            } else {
                // Where less than most of it is along the path, the deviation gets all of the acceleration: one of the
                // two needs the jerk. With it, the deviation gets the velocity that ends with the acceleration.
                let lasting = Twist {
                    vel: now.velocity.vel + gained(&now.acceleration.vel, self.translation),
                    rot: now.velocity.rot + gained(&now.acceleration.rot, self.rotation),
                };
                rate = self.rate(now, &lasting, &direction);
            }
        }
        let (here, velocity, whole) = (
            self.path.at(part),
            self.path.velocity(part, rate),
            self.path.acceleration(part, rate, acceleration),
        );
        let at = now.frame.translation.vector - here.translation.vector;
        let vel = now.velocity.vel - velocity.vel;
        let acc = now.acceleration.vel - whole.vel;
        let tilt = now.frame.rotation * here.rotation.inverse();
        let turn = tilt.scaled_axis();
        let spin = turning(&turn, &(now.velocity.rot - tilt * velocity.rot));
        let rest = now.acceleration.rot - tilt * whole.rot - spin.cross(&(tilt * velocity.rot));
        let spin_rate = turning(&turn, &rest);
        for axis in 0..3 {
            let state = |[position, velocity, acceleration]: [&Vector3<f64>; 3]| State {
                position: position[axis],
                velocity: velocity[axis],
                acceleration: acceleration[axis],
            };
            off[axis] = state([&at, &vel, &acc]);
            off[axis + 3] = state([&turn, &spin, &spin_rate]);
        }
        State {
            position: part * length,
            velocity: rate * length,
            acceleration: acceleration * length,
        }
    }

    /// The frame and its velocity.
    pub(super) fn at(&self, progress: Progress, lead: Option<&Lead>) -> (Frame, Twist) {
        let frame = self.path.at(progress.part);
        let velocity = self.path.velocity(progress.part, progress.rate);
        let Some(lead) = lead.filter(|lead| !lead.is_over()) else {
            return (frame, velocity);
        };
        let off = |first: usize, value: fn(State) -> f64| {
            Vector3::from_fn(|axis, _| value(lead.now(first + axis)))
        };
        let turn = off(3, |s| s.position);
        let tilt = UnitQuaternion::from_scaled_axis(turn);
        let at = frame.translation.vector + off(0, |s| s.position);
        let velocity = Twist {
            vel: velocity.vel + off(0, |s| s.velocity),
            rot: turned(&turn, &off(3, |s| s.velocity)) + tilt * velocity.rot,
        };
        (
            Frame::from_parts(at.into(), tilt * frame.rotation),
            velocity,
        )
    }

    /// The acceleration of the frame; while it comes onto its path, without the coupling of its rotations.
    pub(super) fn acceleration(&self, progress: Progress, lead: Option<&Lead>) -> Twist {
        let Progress {
            part,
            rate,
            acceleration,
            ..
        } = progress;
        let mut whole = self.path.acceleration(part, rate, acceleration);
        if let Some(lead) = lead.filter(|lead| !lead.is_over()) {
            let off = |first: usize, value: fn(State) -> f64| {
                Vector3::from_fn(|axis, _| value(lead.now(first + axis)))
            };
            let turn = off(3, |s| s.position);
            whole.vel += off(0, |s| s.acceleration);
            whole.rot = UnitQuaternion::from_scaled_axis(turn) * whole.rot
                + turned(&turn, &off(3, |s| s.acceleration));
        }
        whole
    }
}

impl Geometry for FramePath {
    fn along(&self, parts: [f64; 2]) -> (f64, Bounds) {
        let (translation, rotation) = (self.translation.slower(parts), self.rotation.slower(parts));
        self.path.bounds(translation, rotation)
    }

    fn groups(&self) -> usize {
        2
    }

    fn group(&self, number: usize) -> Group {
        Group {
            first: number * 3,
            axes: 3,
            bounds: [self.translation, self.rotation][number],
        }
    }

    fn speed(&self, part: f64, rate: f64, off: &[f64]) -> f64 {
        let &[x, y, z, a, b, c] = off else {
            return 0.0;
        };
        let velocity = self.path.velocity(part, rate);
        let translation = (velocity.vel + Vector3::new(x, y, z)).norm();
        // The deviation is taken for small: it turns the rotation of the path a little.
        let rotation = (velocity.rot + Vector3::new(a, b, c)).norm();
        (translation / self.translation.velocity).max(rotation / self.rotation.velocity)
    }
}

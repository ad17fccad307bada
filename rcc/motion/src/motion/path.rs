//! Paths of a frame in space: a straight line or an arc for the position, the shortest rotation for
//! the orientation. The speed is decided elsewhere, but an arc limits it.

use nalgebra::{UnitQuaternion, Vector3};
use takt_net::{Frame, Twist};

use super::bounds::Bounds;
use super::spline::Spline;

/// Sine of the angle between the sides to the auxiliary point and to the end below which three
/// points count as collinear.
const COLLINEAR: f64 = 1e-6;
/// Distance below which points count as one, m.
const SAME: f64 = 1e-9;

#[derive(Clone, Debug)]
enum Curve {
    Line {
        displacement: Vector3<f64>,
    },
    Arc {
        /// From the centre to the start.
        x: Vector3<f64>,
        /// From the centre to the point a quarter turn further.
        y: Vector3<f64>,
        /// Angle of the arc, rad.
        angle: f64,
    },
    /// Position and orientation.
    Spline(Spline),
}

/// A path of a frame, from part 0 to part 1.
#[derive(Clone, Debug)]
pub(super) struct Path {
    from: Frame,
    curve: Curve,
    /// Axis times angle of the whole rotation, in the base, rad.
    turn: Vector3<f64>,
}

fn turn(from: &Frame, to: &Frame) -> Vector3<f64> {
    (to.rotation * from.rotation.inverse()).scaled_axis()
}

impl Path {
    /// The straight line.
    pub(super) fn line(from: Frame, to: &Frame) -> Self {
        let displacement = to.translation.vector - from.translation.vector;
        Self {
            from,
            curve: Curve::Line { displacement },
            turn: turn(&from, to),
        }
    }

    /// The arc through the position of `via`, whose orientation is ignored; `None` if the three
    /// points are collinear or two of them are one point. Three equal points are a path without
    /// length.
    pub(super) fn arc(from: Frame, via: &Frame, to: &Frame) -> Option<Self> {
        let start = from.translation.vector;
        let (a, b) = (
            via.translation.vector - start,
            to.translation.vector - start,
        );
        if a.norm() < SAME && b.norm() < SAME {
            return Some(Self::line(from, to));
        }
        let normal = a.cross(&b);
        let is_arc = (b - a).norm() >= SAME && normal.norm() > COLLINEAR * a.norm() * b.norm();
        if !is_arc {
            return None;
        }
        let to_centre = (b * a.norm_squared() - a * b.norm_squared()).cross(&normal)
            / (2.0 * normal.norm_squared());
        let x = -to_centre;
        let y = normal.normalize().cross(&x);
        let end = b - to_centre;
        let angle = end
            .dot(&y)
            .atan2(end.dot(&x))
            .rem_euclid(std::f64::consts::TAU);
        Some(Self {
            from,
            curve: Curve::Arc { x, y, angle },
            turn: turn(&from, to),
        })
    }

    /// The smooth curve through points.
    pub(super) const fn spline(spline: Spline, from: Frame) -> Self {
        Self {
            from,
            curve: Curve::Spline(spline),
            turn: Vector3::new(0.0, 0.0, 0.0),
        }
    }

    /// The part of a line nearest to a position, and the line's length, m; `None` if the position does not change.
    pub(super) fn nearest(&self, position: &Vector3<f64>) -> Option<f64> {
        let Curve::Line { displacement } = &self.curve else {
            return None;
        };
        let square = displacement.norm_squared();
        let from = position - self.from.translation.vector;
        (square > SAME * SAME).then(|| from.dot(displacement) / square)
    }

    /// The same line from another frame.
    pub(super) fn starting_at(&self, from: Frame, to: &Frame) -> Self {
        match self.curve {
            Curve::Line { .. } => Self::line(from, to),
            Curve::Arc { .. } | Curve::Spline(_) => self.clone(),
        }
    }

    /// Length of the path of the position, m.
    pub(super) fn translation_length(&self) -> f64 {
        match &self.curve {
            Curve::Line { displacement } => displacement.norm(),
            Curve::Arc { x, angle, .. } => x.norm() * angle,
            Curve::Spline(spline) => spline.length(),
        }
    }

    /// Angle of the whole rotation of a line or an arc, rad.
    pub(super) fn angle(&self) -> f64 {
        self.turn.norm()
    }

    /// The length by which progress is measured (m or rad, the larger one), and the bounds along it
    /// that keep those of translation and rotation.
    pub(super) fn bounds(&self, translation: Bounds, rotation: Bounds) -> (f64, Bounds) {
        let (distance, angle) = (self.translation_length(), self.turn.norm());
        let length = distance.max(angle);
        let translation = match &self.curve {
            Curve::Line { .. } => translation,
            Curve::Arc { x, .. } => on_arc(translation, x.norm()),
            Curve::Spline(spline) => return (length, spline.bounds(translation, rotation)),
        };
        let along = match (distance > 0.0, angle > 0.0) {
            (true, true) => {
                let rotation = rotation.scaled(length / angle);
                translation.scaled(length / distance).and(rotation)
            }
            (false, true) => rotation,
            (_, false) => translation,
        };
        (length, along)
    }

    /// The frame at this part of the path.
    pub(super) fn at(&self, part: f64) -> Frame {
        let offset = match &self.curve {
            Curve::Spline(spline) => return spline.at(part, &self.from),
            Curve::Line { displacement } => displacement * part,
            Curve::Arc { x, y, angle } => {
                let (sin, cos) = (angle * part).sin_cos();
                x * (cos - 1.0) + y * sin
            }
        };
        let turned = UnitQuaternion::from_scaled_axis(self.turn * part) * self.from.rotation;
        let position = self.from.translation.vector + offset;
        Frame::from_parts(position.into(), turned)
    }

    /// The velocity of the frame at this part of the path, where the part changes by `rate` (1/s).
    pub(super) fn velocity(&self, part: f64, rate: f64) -> Twist {
        let vel = match &self.curve {
            Curve::Spline(spline) => return spline.velocity(part, rate),
            Curve::Line { displacement } => displacement * rate,
            Curve::Arc { x, y, angle } => {
                let (sin, cos) = (angle * part).sin_cos();
                (y * cos - x * sin) * (angle * rate)
            }
        };
        Twist {
            vel,
            rot: self.turn * rate,
        }
    }

    /// The acceleration of the frame at this part of the path, where the part changes by `rate` (1/s) and that by
    /// `acceleration` (1/s²).
    pub(super) fn acceleration(&self, part: f64, rate: f64, acceleration: f64) -> Twist {
        let mut along = self.velocity(part, acceleration);
        match &self.curve {
            Curve::Line { .. } => {}
            Curve::Arc { x, y, angle } => {
                let (sin, cos) = (angle * part).sin_cos();
                along.vel -= (x * cos + y * sin) * (angle * rate).powi(2);
            }
            Curve::Spline(spline) => {
                let bend = spline.bend(part);
                along.vel += bend.vel * rate * rate;
                along.rot += bend.rot * rate * rate;
            }
        }
        along
    }
}

/// The bounds along an arc of that radius (m) that keep bounds in space. The change of direction
/// needs v²/r of the acceleration, and of the jerk 3·v·a/r across and v³/r² along the arc. The
/// velocity is reduced until the rest suffices to accelerate.
fn on_arc(bounds: Bounds, radius: f64) -> Bounds {
    let Bounds {
        velocity,
        acceleration,
        jerk,
    } = bounds;
    let velocity = velocity
        .min((acceleration * radius * std::f64::consts::FRAC_1_SQRT_2).sqrt())
        .min(jerk * radius / (6.0 * acceleration))
        .min((jerk * radius * radius / 4.0).cbrt());
    let inwards = velocity * velocity / radius;
    let along = (acceleration * acceleration - inwards * inwards).sqrt();
    let across = 3.0 * velocity * along / radius;
    let rest = (jerk * jerk - across * across).sqrt();
    Bounds {
        velocity,
        acceleration: along,
        jerk: rest - velocity.powi(3) / (radius * radius),
    }
}

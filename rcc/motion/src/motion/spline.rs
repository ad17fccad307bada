//! A smooth curve through frames: position, and orientation as a rotation vector from the first frame, are polynomials
//! of fifth order between points, with continuous first and second derivatives, so that a motion along it has bounded
//! jerk. The limits hold along the whole curve: its sharpest bend decides.

use nalgebra::{SVector, UnitQuaternion, Vector3};
use takt_net::{Frame, Twist};

use super::bounds::Bounds;

/// Position (m) and rotation vector (rad).
type Point = SVector<f64, 6>;

/// Samples of each piece for its largest derivatives.
const SAMPLES: u32 = 64;
/// What derivatives between two samples may exceed those at them by.
const BETWEEN: f64 = 1.02;
/// Shortest piece, m or rad.
const SHORTEST: f64 = 1e-6;

/// One polynomial, over the coordinate from 0 to its width.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// Coordinate at its beginning.
    start: f64,
    width: f64,
    coefficients: [Point; 6],
}

impl Piece {
    /// The polynomial between two points with their first and second derivatives.
    fn new(start: f64, width: f64, [from, to]: [[Point; 3]; 2]) -> Self {
        let [p0, v0, a0] = from;
        let [p1, v1, a1] = to;
        let w = width;
        // What is left for the higher orders, at the end.
        let p = (p1 - p0 - v0 * w - a0 * (w * w / 2.0)) / w.powi(3);
        let v = (v1 - v0 - a0 * w) / w.powi(2);
        let a = (a1 - a0) / w;
        let coefficients = [
            p0,
            v0,
            a0 / 2.0,
            p * 10.0 - v * 4.0 + a * 0.5,
            (p * -15.0 + v * 7.0 - a) / w,
            (p * 6.0 - v * 3.0 + a * 0.5) / (w * w),
        ];
        Self {
            start,
            width,
            coefficients,
        }
    }

    /// The derivative of that order (0 to 3) at a coordinate of the curve.
    fn derivative(&self, order: u32, coordinate: f64) -> Point {
        let x = coordinate - self.start;
        let mut sum = Point::zeros();
        for power in (order..6).rev() {
            let factor: f64 = (0..order).map(|k| f64::from(power - k)).product();
            sum = sum * x + self.coefficients[power as usize] * factor;
        }
        sum
    }
}

/// Largest derivatives along the curve.
#[derive(Clone, Copy, Debug, Default)]
struct Bends {
    first: f64,
    second: f64,
    third: f64,
}

impl Bends {
    fn add(&mut self, [first, second, third]: [f64; 3]) {
        self.first = self.first.max(first * BETWEEN);
        self.second = self.second.max(second * BETWEEN);
        self.third = self.third.max(third * BETWEEN);
    }

    /// Bounds of the coordinate that keep these bounds in space: a third of acceleration and jerk for each of the ways
    /// in which they arise.
    fn bounds(self, space: Bounds) -> Option<Bounds> {
        let Self {
            first,
            second,
            third,
        } = self;
        if first <= 0.0 {
            return None;
        }
        let most = |limit: f64, bend: f64| {
            if bend > 0.0 {
                limit / bend
            } else {
                f64::INFINITY
            }
        };
        let velocity = (space.velocity / first)
            .min(most(space.acceleration / 2.0, second).sqrt())
            .min(most(space.jerk / 3.0, third).cbrt());
        let inwards = second * velocity * velocity;
        let acceleration =
            ((space.acceleration - inwards) / first).min(most(space.jerk / 9.0, second * velocity));
        let jerk = space.jerk - third * velocity.powi(3) - 3.0 * second * velocity * acceleration;
        Some(Bounds {
            velocity,
            acceleration,
            jerk: jerk / first,
        })
    }
}

/// A smooth curve.
#[derive(Clone, Debug)]
pub(super) struct Spline {
    pieces: Box<[Piece]>,
    length: f64,
    translation: Bends,
    rotation: Bends,
}

/// A point of the curve: the rotation vector nearest to that of the previous point.
fn points(frames: &[Frame]) -> Vec<Point> {
    let first = frames.first().copied().unwrap_or_default();
    let mut before = Vector3::zeros();
    let point = |frame: &Frame| {
        let mut turn = (frame.rotation * first.rotation.inverse()).scaled_axis();
        let other = turn
            .try_normalize(1e-9)
            .map(|axis| turn - axis * std::f64::consts::TAU);
        if let Some(other) = other
            && (other - before).norm() < (turn - before).norm()
        {
            turn = other;
        }
        before = turn;
        let at = frame.translation.vector;
        Point::from([at.x, at.y, at.z, turn.x, turn.y, turn.z])
    };
    frames.iter().map(point).collect()
}

fn halves(point: &Point) -> (Vector3<f64>, Vector3<f64>) {
    let [x, y, z, a, b, c]: [f64; 6] = (*point).into();
    (Vector3::new(x, y, z), Vector3::new(a, b, c))
}

impl Spline {
    /// The curve through these frames. `tangents` are the directions at the points, in m and rad per unit of the curve's
    /// length: none, or one for each point; a direction of zero is chosen as without.
    /// `None` if there are less than two frames, or two neighbours are one.
    pub(super) fn new(frames: &[Frame], tangents: &[Twist]) -> Option<Self> {
        let points = points(frames);
        let width = |pair: &[Point]| {
            let (at, turn) = halves(&(pair[1] - pair[0]));
            at.norm().max(turn.norm())
        };
        let widths: Vec<f64> = points.windows(2).map(width).collect();
        if widths.is_empty() || widths.iter().any(|width| *width < SHORTEST) {
            return None;
        }
        let slopes: Vec<Point> = (points.windows(2).zip(&widths))
            .map(|(pair, width)| (pair[1] - pair[0]) / *width)
            .collect();
        let firsts: Vec<Point> = (0..points.len())
            .map(|i| first(i, &slopes, &widths, tangents.get(i)))
            .collect();
        let seconds: Vec<Point> = (0..points.len())
            .map(|i| second(i, &points, &firsts, &widths))
            .collect();
        let mut length = 0.0;
        let mut pieces = Vec::with_capacity(widths.len());
        for (i, width) in widths.iter().enumerate() {
            let at = |i: usize| [points[i], firsts[i], seconds[i]];
            pieces.push(Piece::new(length, *width, [at(i), at(i + 1)]));
            length += width;
        }
        let mut spline = Self {
            pieces: pieces.into(),
            length,
            translation: Bends::default(),
            rotation: Bends::default(),
        };
        spline.measure();
        Some(spline)
    }

    fn measure(&mut self) {
        for piece in &self.pieces {
            for sample in 0..=SAMPLES {
                let x = piece.start + piece.width * f64::from(sample) / f64::from(SAMPLES);
                let [first, second, third] =
                    [1, 2, 3].map(|order| halves(&piece.derivative(order, x)));
                self.translation
                    .add([first.0.norm(), second.0.norm(), third.0.norm()]);
                // A rotation vector that changes turns its own derivatives, too.
                let [v, a, j] = [first.1.norm(), second.1.norm(), third.1.norm()];
                self.rotation
                    .add([v, a + v * v / 2.0, j + 1.5 * v * a + v.powi(3)]);
            }
        }
    }

    /// Length of its coordinate, m or rad: the sum of the distances of its points.
    pub(super) const fn length(&self) -> f64 {
        self.length
    }

    /// The bounds of the coordinate that keep those of translation and rotation.
    pub(super) fn bounds(&self, translation: Bounds, rotation: Bounds) -> Bounds {
        let (at, turn) = (
            self.translation.bounds(translation),
            self.rotation.bounds(rotation),
        );
        match (at, turn) {
            (Some(at), Some(turn)) => at.and(turn),
            (Some(bounds), None) | (None, Some(bounds)) => bounds,
            (None, None) => translation,
        }
    }

    /// The derivative of that order by the part of the curve.
    fn derivative(&self, order: u32, part: f64) -> (Vector3<f64>, Vector3<f64>) {
        let coordinate = part * self.length;
        let after = self
            .pieces
            .partition_point(|piece| piece.start <= coordinate);
        let piece = &self.pieces[after.saturating_sub(1)];
        let scale = (0..order).map(|_| self.length).product::<f64>();
        halves(&(piece.derivative(order, coordinate) * scale))
    }

    /// The frame at this part.
    pub(super) fn at(&self, part: f64, first: &Frame) -> Frame {
        let (at, turn) = self.derivative(0, part);
        Frame::from_parts(
            at.into(),
            UnitQuaternion::from_scaled_axis(turn) * first.rotation,
        )
    }

    /// The velocity of the frame where the part changes by `rate` (1/s).
    pub(super) fn velocity(&self, part: f64, rate: f64) -> Twist {
        let (_, turn) = self.derivative(0, part);
        let (vel, turning) = self.derivative(1, part);
        Twist {
            vel: vel * rate,
            rot: turned(&turn, &turning) * rate,
        }
    }

    /// The second derivative by the part; of the orientation in its first approximation.
    pub(super) fn bend(&self, part: f64) -> Twist {
        let (_, turn) = self.derivative(0, part);
        let (vel, bend) = self.derivative(2, part);
        Twist {
            vel,
            rot: turned(&turn, &bend),
        }
    }
}

/// First derivative at point `i`: the given one, or that of the parabola through it and its neighbours, at the ends the
/// slope.
fn first(i: usize, slopes: &[Point], widths: &[f64], tangent: Option<&Twist>) -> Point {
    if let Some(Twist { vel, rot }) = tangent
        && (*vel, *rot) != (Vector3::zeros(), Vector3::zeros())
    {
        return Point::from([vel.x, vel.y, vel.z, rot.x, rot.y, rot.z]);
    }
    match (i.checked_sub(1).map(|i| slopes[i]), slopes.get(i).copied()) {
        (Some(before), Some(after)) => {
            let (left, right) = (widths[i - 1], widths[i]);
            (before * right + after * left) / (left + right)
        }
        (Some(only), None) | (None, Some(only)) => only,
        (None, None) => Point::zeros(),
    }
}

/// Second derivative at point `i`: the mean of those that cubic pieces on both sides have there, at the ends that of one.
fn second(i: usize, points: &[Point], firsts: &[Point], widths: &[f64]) -> Point {
    let left = (i > 0).then(|| {
        let (w, step) = (widths[i - 1], points[i] - points[i - 1]);
        (firsts[i] * 4.0 + firsts[i - 1] * 2.0) / w - step * (6.0 / (w * w))
    });
    let right = widths.get(i).map(|w| {
        let step = points[i + 1] - points[i];
        step * (6.0 / (w * w)) - (firsts[i] * 4.0 + firsts[i + 1] * 2.0) / *w
    });
    match (left, right) {
        (Some(left), Some(right)) => (left + right) / 2.0,
        (Some(one), None) | (None, Some(one)) => one,
        (None, None) => Point::zeros(),
    }
}

/// The angular velocity, in the base, of a rotation vector that changes at that rate.
pub(super) fn turned(turn: &Vector3<f64>, rate: &Vector3<f64>) -> Vector3<f64> {
    let square = turn.norm_squared();
    let angle = square.sqrt();
    let (first, second) = if angle < 1e-4 {
        (0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0)
    } else {
        (
            (1.0 - angle.cos()) / square,
            (angle - angle.sin()) / (square * angle),
        )
    };
    let across = turn.cross(rate);
    rate + across * first + turn.cross(&across) * second
}

/// The rate of a rotation vector that causes that angular velocity: the inverse of [`turned`].
pub(super) fn turning(turn: &Vector3<f64>, velocity: &Vector3<f64>) -> Vector3<f64> {
    let square = turn.norm_squared();
    let angle = square.sqrt();
    let second = if angle < 1e-4 {
        1.0 / 12.0 + square / 720.0
    } else {
        1.0 / square - (1.0 + angle.cos()) / (2.0 * angle * angle.sin())
    };
    let across = turn.cross(velocity);
    velocity - across / 2.0 + turn.cross(&across) * second
}

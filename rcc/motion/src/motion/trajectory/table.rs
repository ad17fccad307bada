//! A table of points with times, and the polynomials between them: quintic where both ends have accelerations, else cubic. It is
//! checked against limits when it is planned; it reads no clock and holds no arm.

use takt_net::JointLimits;

use super::super::bounds::{Bounds, State};

/// Most points of a table.
pub(super) const POINTS_MAX: usize = 10_001;
/// Most joints of a table.
pub(super) const JOINTS_MAX: usize = 64;
/// Longest table, s.
pub(super) const DURATION_MAX: f64 = 3_700.0;
/// Samples of each piece that are compared with limits.
const SAMPLES: u32 = 12;
/// What rounding may exceed a limit by, relative to it.
const ROUNDING: f64 = 1e-3;
/// What rounding may exceed the range of a joint by, rad.
const ROUNDED: f64 = 1e-6;
/// Points that are tried as the one from which on a motion follows the table.
const JOINS_MAX: usize = 256;

/// Where joints are to be at a time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Waypoint {
    /// From the start, s.
    pub time: f64,
    /// rad.
    pub positions: Vec<f64>,
    /// rad/s; without elements they follow from the points beside it.
    pub velocities: Vec<f64>,
    /// rad/s²; without elements there are none.
    pub accelerations: Vec<f64>,
}

impl Waypoint {
    /// Joints in these states at time 0.
    #[must_use]
    pub fn start(states: &[State]) -> Self {
        let of = |pick: fn(&State) -> f64| states.iter().map(pick).collect();
        Self {
            time: 0.0,
            positions: of(|state| state.position),
            velocities: of(|state| state.velocity),
            accelerations: of(|state| state.acceleration),
        }
    }

    fn values(&self) -> impl Iterator<Item = &f64> {
        let rates = self.velocities.iter().chain(&self.accelerations);
        self.positions.iter().chain(rates)
    }
}

/// Why points are no table, or not one for an arm.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TrajectoryError {
    /// The text has something else than numbers.
    #[error("`{0}` is no number")]
    Text(String),
    /// Too few or too many points.
    #[error("{0} points; a trajectory has 2 to {POINTS_MAX}")]
    Points(usize),
    /// A point has the wrong number of values.
    #[error(
        "point {0} has not one position and one velocity for each joint, or accelerations of some only"
    )]
    Values(usize),
    /// Times do not increase from 0.
    #[error("the times do not increase from 0 to at most {DURATION_MAX} s at point {0}")]
    Times(usize),
    /// A value is not a number, or too large.
    #[error("point {0} has a value that is not a number or too large")]
    Number(usize),
    /// It does not end at rest.
    #[error("joint {joint} moves at {velocity} rad/s at the end")]
    End {
        /// Number of the joint, from 0.
        joint: usize,
        /// rad/s.
        velocity: f64,
    },
    /// A limit is exceeded.
    #[error(transparent)]
    Excess(#[from] Excess),
    /// No point of it can be reached within the limits from the present motion.
    #[error("the trajectory cannot be joined within the limits: {0}")]
    Unjoined(Excess),
}

/// A limit that a trajectory exceeds.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("joint {joint} at {time:.3} s: {what} {value:.4}, limit {limit:.4}")]
pub struct Excess {
    /// Number of the joint, from 0.
    pub joint: usize,
    /// From the start, s.
    pub time: f64,
    /// The value.
    pub what: Quantity,
    /// Its value, rad, rad/s or rad/s².
    pub value: f64,
    /// What it exceeds.
    pub limit: f64,
}

/// What is limited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// rad.
    Position,
    /// rad/s.
    Velocity,
    /// rad/s².
    Acceleration,
}

impl std::fmt::Display for Quantity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Acceleration => "acceleration",
        })
    }
}

/// The polynomial of one joint over the time of a piece.
type Coefficients = [f64; 6];

/// A trajectory of joints over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    joints: usize,
    /// Times of the points, s.
    times: Box<[f64]>,
    /// By piece, then by joint.
    pieces: Box<[Coefficients]>,
    points: Vec<Waypoint>,
}

fn piece(width: f64, [from, to]: [State; 2], is_quintic: bool) -> Coefficients {
    let w = width;
    let (p, v) = (to.position - from.position, from.velocity);
    if !is_quintic {
        let slope = p / w;
        return [
            from.position,
            v,
            (3.0 * slope - 2.0 * v - to.velocity) / w,
            (v + to.velocity - 2.0 * slope) / (w * w),
            0.0,
            0.0,
        ];
    }
    let half = from.acceleration / 2.0;
    // What is left for the higher orders, at the end.
    let p = (p - v * w - half * w * w) / w.powi(3);
    let v = (to.velocity - v - from.acceleration * w) / w.powi(2);
    let a = (to.acceleration - from.acceleration) / w;
    [
        from.position,
        from.velocity,
        half,
        10.0 * p - 4.0 * v + 0.5 * a,
        (-15.0 * p + 7.0 * v - a) / w,
        (6.0 * p - 3.0 * v + 0.5 * a) / (w * w),
    ]
}

fn evaluate(coefficients: &Coefficients, x: f64) -> State {
    let [c0, c1, c2, c3, c4, c5] = *coefficients;
    State {
        position: ((((c5 * x + c4) * x + c3) * x + c2) * x + c1) * x + c0,
        velocity: (((5.0 * c5 * x + 4.0 * c4) * x + 3.0 * c3) * x + 2.0 * c2) * x + c1,
        acceleration: ((20.0 * c5 * x + 12.0 * c4) * x + 6.0 * c3) * x + 2.0 * c2,
    }
}

/// The state of a joint at a point.
fn state(point: &Waypoint, joint: usize) -> State {
    let of = |list: &[f64]| list.get(joint).copied().unwrap_or(0.0);
    State {
        position: of(&point.positions),
        velocity: of(&point.velocities),
        acceleration: of(&point.accelerations),
    }
}

impl Table {
    /// The table through points with positions and velocities.
    ///
    /// # Errors
    /// If they are none.
    pub fn new(points: Vec<Waypoint>, joints: usize) -> Result<Self, TrajectoryError> {
        if !(2..=POINTS_MAX).contains(&points.len()) || !(1..=JOINTS_MAX).contains(&joints) {
            return Err(TrajectoryError::Points(points.len()));
        }
        let mut before = None;
        for (number, point) in points.iter().enumerate() {
            let is_whole = point.positions.len() == joints
                && point.velocities.len() == joints
                && [0, joints].contains(&point.accelerations.len());
            if !is_whole {
                return Err(TrajectoryError::Values(number));
            }
            let follows = match before {
                None => point.time == 0.0,
                Some(before) => point.time > before && point.time <= DURATION_MAX,
            };
            if !follows {
                return Err(TrajectoryError::Times(number));
            }
            if !point
                .values()
                .all(|value| super::super::is_sensible(*value))
            {
                return Err(TrajectoryError::Number(number));
            }
            before = Some(point.time);
        }
        let mut pieces = Vec::with_capacity((points.len() - 1) * joints);
        for pair in points.windows(2) {
            let [from, to] = pair else { continue };
            let is_quintic = !(from.accelerations.is_empty() || to.accelerations.is_empty());
            pieces.extend((0..joints).map(|joint| {
                let ends = [state(from, joint), state(to, joint)];
                piece(to.time - from.time, ends, is_quintic)
            }));
        }
        Ok(Self {
            joints,
            times: points.iter().map(|point| point.time).collect(),
            pieces: pieces.into(),
            points,
        })
    }

    /// Reads points divided by `/`; each is its time, then positions, velocities and, if it has any, accelerations.
    ///
    /// # Errors
    /// If they are no table.
    pub fn parse(text: &str, joints: usize) -> Result<Self, TrajectoryError> {
        let mut points = Vec::new();
        for (number, point) in text.split('/').enumerate() {
            if number >= POINTS_MAX {
                return Err(TrajectoryError::Points(number + 1));
            }
            let mut values = Vec::with_capacity(3 * joints + 1);
            for word in point.split_ascii_whitespace().take(3 * joints + 2) {
                let value = word.parse::<f64>();
                values.push(value.map_err(|_| {
                    TrajectoryError::Text(word.chars().take(32).collect::<String>())
                })?);
            }
            let is_whole = [2 * joints + 1, 3 * joints + 1].contains(&values.len());
            let Some((time, values)) = values.split_first().filter(|_| is_whole) else {
                return Err(TrajectoryError::Values(number));
            };
            let mut lists = values.chunks(joints.max(1)).map(<[f64]>::to_vec);
            points.push(Waypoint {
                time: *time,
                positions: lists.next().unwrap_or_default(),
                velocities: lists.next().unwrap_or_default(),
                accelerations: lists.next().unwrap_or_default(),
            });
        }
        Self::new(points, joints)
    }

    /// The text that [`Self::parse`] reads.
    #[must_use]
    pub fn text(&self) -> String {
        let point = |point: &Waypoint| {
            let mut text = point.time.to_string();
            for value in point.values() {
                text.push(' ');
                text.push_str(&value.to_string());
            }
            text
        };
        self.points.iter().map(point).collect::<Vec<_>>().join("/")
    }

    /// Number of joints.
    #[must_use]
    pub const fn joints(&self) -> usize {
        self.joints
    }

    /// Its points.
    #[must_use]
    pub fn points(&self) -> &[Waypoint] {
        &self.points
    }

    /// Memory that it takes, bytes.
    pub(super) fn bytes(&self) -> usize {
        let point = size_of::<Waypoint>() + 3 * size_of::<f64>() * self.joints;
        size_of_val(&*self.pieces) + self.times.len() * (point + size_of::<f64>())
    }

    /// Time of the last point, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.times.last().copied().unwrap_or(0.0)
    }

    /// Number of the piece at a time; of the last one after the end.
    pub(super) fn piece_at(&self, time: f64) -> usize {
        let after = self.times.partition_point(|start| *start <= time);
        after
            .saturating_sub(1)
            .min(self.times.len().saturating_sub(2))
    }

    /// The state of a joint at a time, in the piece at that time; after the end, at rest there.
    pub(super) fn in_piece(&self, piece: usize, joint: usize, time: f64) -> State {
        let coefficients = self.pieces.get(piece * self.joints + joint);
        let start = self.times.get(piece).copied().unwrap_or(0.0);
        let Some(coefficients) = coefficients else {
            return State::default();
        };
        let end = self.duration();
        let state = evaluate(coefficients, time.clamp(0.0, end) - start);
        if time < end {
            state
        } else {
            State::at_rest(state.position)
        }
    }

    /// The state of a joint at a time.
    #[must_use]
    pub fn at(&self, joint: usize, time: f64) -> State {
        self.in_piece(self.piece_at(time), joint, time)
    }

    /// The state of a joint at the first point, as it was planned.
    pub(super) fn start(&self, joint: usize) -> State {
        self.points
            .first()
            .map_or_else(State::default, |point| state(point, joint))
    }

    /// Lets joints come from these states: the first piece leads from there to its end.
    ///
    /// # Errors
    /// The joint that would exceed its bounds; the table is what it was then.
    pub(super) fn join(&mut self, from: &[State], bounds: &[Bounds]) -> Result<(), usize> {
        for (joint, (from, bounds)) in from.iter().zip(bounds).enumerate() {
            let (width, coefficients) = self.joining(joint, *from);
            for sample in 1..=SAMPLES {
                let time = width * f64::from(sample) / f64::from(SAMPLES);
                let at = evaluate(&coefficients, time);
                // Also what is not a number.
                let is_within = at.velocity.abs() <= bounds.velocity * (1.0 + ROUNDING)
                    && at.acceleration.abs() <= bounds.acceleration * (1.0 + ROUNDING);
                if !is_within {
                    return Err(joint);
                }
            }
        }
        for (joint, from) in from.iter().enumerate() {
            let (_, coefficients) = self.joining(joint, *from);
            if let Some(piece) = self.pieces.get_mut(joint) {
                *piece = coefficients;
            }
        }
        Ok(())
    }

    /// The first piece of a joint from another state, with its length, s.
    fn joining(&self, joint: usize, from: State) -> (f64, Coefficients) {
        let width = self.times.get(1).copied().unwrap_or(0.0);
        let to = match self.pieces.get(self.joints + joint) {
            Some(next) => evaluate(next, 0.0),
            None => self.at(joint, width),
        };
        (width, piece(width, [from, to], true))
    }

    /// Checks limits along pieces, and rest at the end.
    fn check_pieces(
        &self,
        pieces: std::ops::Range<usize>,
        limits: &[JointLimits],
    ) -> Result<(), Excess> {
        for piece in pieces {
            let at = |number: usize| self.times.get(number).copied().unwrap_or(0.0);
            let (start, end) = (at(piece), at(piece + 1));
            for (joint, limits) in limits.iter().enumerate() {
                for sample in 0..=SAMPLES {
                    let part = f64::from(sample) / f64::from(SAMPLES);
                    let time = start + (end - start) * part;
                    let Some(it) = self.pieces.get(piece * self.joints + joint) else {
                        continue;
                    };
                    exceeds(&evaluate(it, time - start), limits, (joint, time))?;
                }
            }
        }
        Ok(())
    }

    /// Checks the limits of joints along the whole table, and that it ends at rest.
    ///
    /// # Errors
    /// The first limit that is exceeded.
    pub fn check(&self, limits: &[JointLimits]) -> Result<(), TrajectoryError> {
        if let Some(last) = self.points.last() {
            let moving = last.velocities.iter().position(|v| v.abs() > 1e-6);
            if let Some(joint) = moving {
                let velocity = state(last, joint).velocity;
                return Err(TrajectoryError::End { joint, velocity });
            }
        }
        let pieces = 0..self.times.len().saturating_sub(1);
        Ok(self.check_pieces(pieces, limits)?)
    }
}

fn exceeds(state: &State, limits: &JointLimits, (joint, time): (usize, f64)) -> Result<(), Excess> {
    let excess = |what, value, limit| Excess {
        joint,
        time,
        what,
        value,
        limit,
    };
    let State {
        position,
        velocity,
        acceleration,
    } = *state;
    let bounds = [
        (
            position,
            limits.position_min - ROUNDED,
            limits.position_max + ROUNDED,
            Quantity::Position,
        ),
        (
            velocity,
            -limits.velocity_max,
            limits.velocity_max,
            Quantity::Velocity,
        ),
        (
            acceleration,
            -limits.acceleration_max,
            limits.acceleration_max,
            Quantity::Acceleration,
        ),
    ];
    for (value, min, max, what) in bounds {
        let more = if what == Quantity::Position {
            0.0
        } else {
            ROUNDING
        };
        let [low, high] = [min, max].map(|limit| limit * (1.0 + more));
        if value < low {
            return Err(excess(what, value, min));
        }
        // Also what is not a number.
        if value > high || value.is_nan() {
            return Err(excess(what, value, max));
        }
    }
    Ok(())
}

/// Velocities of points that have none: zero at the end and where the direction changes, else the slope to the points beside it.
fn with_velocities(points: &mut [Waypoint], start: &Waypoint) {
    let all: Vec<(f64, Vec<f64>)> = std::iter::once(start)
        .chain(&*points)
        .map(|point| (point.time, point.positions.clone()))
        .collect();
    for (number, point) in points.iter_mut().enumerate() {
        if !point.velocities.is_empty() {
            continue;
        }
        let velocity = |joint: usize| {
            let at = |number: usize| {
                let (time, positions) = all.get(number)?;
                Some((*time, *positions.get(joint)?))
            };
            let slope = |from: Option<(f64, f64)>, to: Option<(f64, f64)>| {
                let ((from_time, from), (time, to)) = (from?, to?);
                Some((to - from) / (time - from_time))
            };
            // Point `number` is the one after it among all.
            let (before, after) = (
                slope(at(number), at(number + 1)),
                slope(at(number + 1), at(number + 2)),
            );
            match (before, after) {
                (Some(before), Some(after)) if before * after > 0.0 => {
                    // The harmonic mean: no overshoot between the points.
                    2.0 * before * after / (before + after)
                }
                _ => 0.0,
            }
        };
        point.velocities = (0..point.positions.len()).map(velocity).collect();
    }
}

/// A planned trajectory, and which of the requested points is the first that it passes.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    /// From the present motion on.
    pub table: Table,
    /// Number of the point with which it joins the requested trajectory.
    pub joined: usize,
}

/// Plans a trajectory from a state of joints, which may move, through points (s from now). It joins the points at the first one
/// that can be reached within the limits; points at time 0 are where the joints should be, and are not passed.
///
/// # Errors
/// If the points are no trajectory, exceed the limits, or cannot be joined.
pub fn plan(
    from: &[State],
    points: &[Waypoint],
    limits: &[JointLimits],
) -> Result<Planned, TrajectoryError> {
    let first = points.iter().position(|point| point.time > 0.0);
    let Some(first) = first else {
        return Err(TrajectoryError::Points(points.len()));
    };
    let joints = from.len();
    let sizes = |point: &Waypoint| {
        let rates = [point.velocities.len(), point.accelerations.len()];
        point.positions.len() == joints && rates.into_iter().all(|it| it == 0 || it == joints)
    };
    if let Some(wrong) = points.iter().position(|point| !sizes(point)) {
        return Err(TrajectoryError::Values(wrong));
    }
    let start = Waypoint::start(from);
    let mut rest = points.get(first..).unwrap_or_default().to_vec();
    with_velocities(&mut rest, &start);
    let mut failure = None;
    for joined in 0..rest.len().min(JOINS_MAX) {
        let mut all = vec![start.clone()];
        all.extend(rest.iter().skip(joined).cloned());
        ease(&mut all);
        let table = Table::new(all, joints)?;
        match table.check_pieces(0..1, limits) {
            Ok(()) => {
                table.check(limits)?;
                let joined = first + joined;
                return Ok(Planned { table, joined });
            }
            Err(excess) => failure = failure.or(Some(excess)),
        }
    }
    // A single piece that exceeds the limits is the trajectory itself.
    match failure {
        Some(excess) if from.iter().all(|it| *it == State::at_rest(it.position)) => {
            Err(excess.into())
        }
        Some(excess) => Err(TrajectoryError::Unjoined(excess)),
        None => Err(TrajectoryError::Points(points.len())),
    }
}

/// Gives the point where a trajectory is joined the acceleration with which it goes on, so that the way there is quintic and
/// continues the present acceleration.
fn ease(all: &mut [Waypoint]) {
    let joints = all.first().map_or(0, |start| start.positions.len());
    let accelerations: Vec<f64> = match all {
        [_, join, ..] if !join.accelerations.is_empty() => return,
        [_, join, next, ..] => {
            let piece = |joint| {
                let ends = [state(join, joint), state(next, joint)];
                let cubic = piece(next.time - join.time, ends, false);
                evaluate(&cubic, 0.0).acceleration
            };
            (0..joints).map(piece).collect()
        }
        _ => vec![0.0; joints],
    };
    // The piece behind it stays cubic: its other end has no accelerations.
    if let Some(join) = all.get_mut(1) {
        join.accelerations = accelerations;
    }
}

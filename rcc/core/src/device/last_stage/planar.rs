//! The last stage of a mobile base: the output velocity, limited in size and change along the floor and in turning. A
//! base has no range, so its position does not matter here.

use super::{APPROACH_SHARE, Bound, Excess, Limited, closing_speed};

/// x and y (m/s) and turning (rad/s), in the base's own frame.
pub type Twist3 = [f64; 3];

/// A smaller deviation of velocity is not reported, m/s and rad/s.
const REPORTED_FROM: f64 = 0.05;

/// Limits of a base: along the floor, and of turning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarLimits {
    /// Largest speed, m/s and rad/s; above 0.
    pub velocity: [f64; 2],
    /// Largest acceleration, m/s² and rad/s²; above 0.
    pub acceleration: [f64; 2],
}

/// The last stage of a base.
#[derive(Clone, Copy, Debug)]
pub struct PlanarStage {
    limits: PlanarLimits,
    velocity: Twist3,
    /// Along the floor, and turning.
    limited: [Limited; 2],
}

impl PlanarStage {
    /// A base at rest.
    #[must_use]
    pub fn new(limits: PlanarLimits) -> Self {
        Self {
            limits,
            velocity: [0.0; 3],
            limited: [Limited::default(); 2],
        }
    }

    /// Sets rest while the driver does not control the base.
    pub const fn rest(&mut self) {
        self.velocity = [0.0; 3];
    }

    /// The last output velocity.
    #[must_use]
    pub const fn velocity(&self) -> Twist3 {
        self.velocity
    }

    /// Whether the last output is at rest.
    #[must_use]
    pub fn rests(&self) -> bool {
        self.velocity.iter().all(|v| v.abs() < 1e-9)
    }

    /// Limit reports: along the floor, and turning.
    #[must_use]
    pub const fn limited(&self) -> &[Limited; 2] {
        &self.limited
    }

    /// One cycle of `dt_s` towards a velocity; without one it brakes. `reach` returns the share of a velocity that
    /// its wheels can drive; a velocity beyond that, or beyond the limits, is scaled down in its direction.
    pub fn step(
        &mut self,
        wanted: Option<Twist3>,
        reach: impl Fn(Twist3) -> f64,
        dt_s: f64,
    ) -> Twist3 {
        if dt_s <= 0.0 {
            return self.velocity;
        }
        let is_number = wanted.is_none_or(|wanted| wanted.iter().all(|v| v.is_finite()));
        let asked = wanted.filter(|_| is_number).unwrap_or_default();
        let within = self.within(asked, &reach);
        let change: Twist3 = std::array::from_fn(|i| within[i] - self.velocity[i]);
        let [floor, turning] = self.limits.acceleration;
        let shares = [
            share(floor * dt_s, change[0].hypot(change[1])),
            share(turning * dt_s, change[2]),
        ];
        let mut next = self.towards(change, shares);
        // Between two velocities that the wheels can drive, they can drive all on the line.
        if reach(next) < 1.0 {
            next = self.towards(change, [shares[0].min(shares[1]); 2]);
        }
        if wanted.is_some() {
            self.judge(asked, within, next, is_number, dt_s);
        } else {
            self.limited.iter_mut().for_each(Limited::clear);
        }
        self.velocity = next;
        next
    }

    /// One cycle of `dt_s` towards a position at this offset at its end, m and rad in the base's frame, that moves at
    /// `speed`: directly if that is within the limits, otherwise on the path that ends there by constant braking.
    pub fn track(&mut self, path: Twist3, speed: Twist3, dt_s: f64) -> Twist3 {
        if dt_s <= 0.0 {
            return self.velocity;
        }
        let of = |a: Twist3, b: Twist3| speeds(std::array::from_fn(|i| a[i] - b[i]));
        let direct = path.map(|distance| distance / dt_s);
        let (change, stay) = (of(direct, self.velocity), of(direct, speed));
        let fast = speeds(direct);
        let is_within = |i: usize| {
            let most = self.limits.acceleration[i] * dt_s * (1.0 + 1e-9);
            change[i] <= most && stay[i] <= most && fast[i] <= self.limits.velocity[i]
        };
        let behind: Twist3 = std::array::from_fn(|i| path[i] - speed[i] * dt_s);
        let [floor, turning] = speeds(behind);
        let closing = |i: usize, distance| {
            closing_speed(distance, APPROACH_SHARE * self.limits.acceleration[i], dt_s)
        };
        // A zero offset has no direction.
        let along = if floor > 0.0 {
            closing(0, floor) / floor
        } else {
            0.0
        };
        let caught_up = [
            speed[0] + along * behind[0],
            speed[1] + along * behind[1],
            speed[2] + closing(1, turning).copysign(behind[2]),
        ];
        let floor = if is_within(0) { direct } else { caught_up };
        let turning = if is_within(1) { direct } else { caught_up };
        self.step(Some([floor[0], floor[1], turning[2]]), |_| 1.0, dt_s)
    }

    fn towards(&self, change: Twist3, [floor, turning]: [f64; 2]) -> Twist3 {
        let shares = [floor, floor, turning];
        std::array::from_fn(|i| {
            if shares[i] < 1.0 {
                self.velocity[i] + shares[i] * change[i]
            } else {
                self.velocity[i] + change[i]
            }
        })
    }

    /// Scales it down in its direction, if it is too fast.
    fn within(&self, wanted: Twist3, reach: &impl Fn(Twist3) -> f64) -> Twist3 {
        let [floor, turning] = speeds(wanted);
        let [floor_max, turning_max] = self.limits.velocity;
        let over = (floor / floor_max).max(turning / turning_max).max(1.0);
        let slower = wanted.map(|v| v / over);
        let share = reach(slower).min(1.0);
        if share < 1.0 {
            slower.map(|v| v * share)
        } else {
            slower
        }
    }

    /// Counts limited cycles.
    fn judge(&mut self, asked: Twist3, within: Twist3, next: Twist3, is_number: bool, dt_s: f64) {
        let of = |a: Twist3, b: Twist3| speeds(std::array::from_fn(|i| a[i] - b[i]));
        let (cut, ramped) = (of(asked, within), of(within, next));
        let change = of(within, self.velocity);
        let (fast, slower) = (speeds(asked), speeds(within));
        for (i, limited) in self.limited.iter_mut().enumerate() {
            let (bound, wanted, limit) = if !is_number {
                (Bound::Finite, f64::NAN, 0.0)
            } else if cut[i] > 1e-9 {
                (Bound::Velocity, fast[i], slower[i])
            } else if ramped[i] > 1e-9 {
                let acceleration = change[i] / dt_s;
                (
                    Bound::Acceleration,
                    acceleration,
                    self.limits.acceleration[i],
                )
            } else {
                limited.clear();
                continue;
            };
            let off = if is_number {
                cut[i] + ramped[i]
            } else {
                f64::INFINITY
            };
            // Of the same size as the threshold for positions.
            let off = off / REPORTED_FROM * super::REPORTED_FROM;
            let excess = Excess {
                bound,
                wanted,
                limit,
            };
            limited.note(excess, off);
        }
    }
}

/// Along the floor, and of turning.
fn speeds([x, y, turn]: Twist3) -> [f64; 2] {
    [x.hypot(y), turn.abs()]
}

fn share(most: f64, change: f64) -> f64 {
    if change.abs() > most {
        most / change.abs()
    } else {
        1.0
    }
}

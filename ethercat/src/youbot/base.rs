//! The base on four mecanum wheels: converts wheel speeds to base velocity, ramps velocities, and computes odometry.
//! Drives are in the order left front, right front, left back, right back; the motors of the left side are mirrored.

use std::f64::consts::TAU;

/// Encoder ticks in a revolution of the motor.
const TICKS: f64 = 4000.0;

/// Dimensions of the base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mecanum {
    /// Radius of a wheel, m.
    pub radius: f64,
    /// Half of the distance of the axles plus half of that of the wheels on one, m.
    pub lever: f64,
    /// Gear ratio: motor revolutions per wheel revolution.
    pub gear: f64,
    /// Largest speed of a motor, rpm.
    pub rpm_max: f64,
}

impl Default for Mecanum {
    fn default() -> Self {
        Self {
            radius: 0.0475,
            lever: (0.47 + 0.30) / 2.0,
            gear: 9405.0 / 364.0,
            rpm_max: 6000.0,
        }
    }
}

impl Mecanum {
    /// Rates of the wheels (rad/s, in their motors' sense) at a velocity of the base: x forward and y to the left
    /// (m/s), turning to the left (rad/s).
    pub fn rates(&self, [x, y, turn]: [f64; 3]) -> [f64; 4] {
        let turn = self.lever * turn;
        [-x + y + turn, x + y + turn, -x - y + turn, x - y + turn].map(|v| v / self.radius)
    }

    /// Velocity of the base at these rates of the wheels, rad/s.
    pub fn velocity(&self, [a, b, c, d]: [f64; 4]) -> [f64; 3] {
        let quarter = self.radius / 4.0;
        [
            quarter * (-a + b - c + d),
            quarter * (a + b - c - d),
            quarter / self.lever * (a + b + c + d),
        ]
    }

    /// Motor speeds, rpm. If one would be too fast, all are scaled by the same factor: the path stays the same.
    pub fn rpm(&self, velocity: [f64; 3]) -> [i32; 4] {
        let rpm = self.exact_rpm(velocity);
        let fastest = self.fastest(rpm);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "within rpm_max, or saturated"
        )]
        rpm.map(|one| (one * self.rpm_max / fastest).round() as i32)
    }

    /// Fraction of a velocity that the motors can reach: 1, or less if one would be too fast.
    pub fn reach(&self, velocity: [f64; 3]) -> f64 {
        self.rpm_max / self.fastest(self.exact_rpm(velocity))
    }

    fn exact_rpm(&self, velocity: [f64; 3]) -> [f64; 4] {
        let rates = self.rates(velocity);
        rates.map(|rate| rate * self.gear * 60.0 / TAU)
    }

    /// The speed of the fastest motor, at least the largest allowed.
    fn fastest(&self, rpm: [f64; 4]) -> f64 {
        rpm.iter()
            .fold(self.rpm_max, |most, one| most.max(one.abs()))
    }

    /// Rate of a wheel at a motor speed, rad/s.
    pub fn rate(&self, rpm: i32) -> f64 {
        f64::from(rpm) * TAU / 60.0 / self.gear
    }

    /// Angle of a wheel for a number of ticks, rad.
    fn angle(&self, ticks: i32) -> f64 {
        f64::from(ticks) * TAU / TICKS / self.gear
    }
}

/// A velocity with limited acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ramp {
    velocity: [f64; 3],
    /// Largest acceleration along the floor, m/s².
    translation: f64,
    /// Largest acceleration of turning, rad/s².
    rotation: f64,
}

impl Ramp {
    /// At rest, with these largest accelerations, m/s² and rad/s².
    pub const fn new(translation: f64, rotation: f64) -> Self {
        Self {
            velocity: [0.0; 3],
            translation,
            rotation,
        }
    }

    /// The present velocity.
    pub const fn velocity(&self) -> [f64; 3] {
        self.velocity
    }

    /// Stops at once: the base is not under control.
    pub const fn rest(&mut self) {
        self.velocity = [0.0; 3];
    }

    /// Ramps towards a velocity for a time, s.
    pub fn step(&mut self, wanted: [f64; 3], dt: f64) {
        let change = [0, 1, 2].map(|i| wanted[i] - self.velocity[i]);
        let fraction = |most: f64, change: f64| {
            if change.abs() > most * dt {
                most * dt / change.abs()
            } else {
                1.0
            }
        };
        let planar = fraction(self.translation, change[0].hypot(change[1]));
        let turn = fraction(self.rotation, change[2]);
        for (i, fraction) in [planar, planar, turn].into_iter().enumerate() {
            self.velocity[i] += fraction * change[i];
        }
    }
}

/// Odometry of the base. Wheels slip, so it is not a measurement of the true pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Odometry {
    last: Option<[i32; 4]>,
    /// x and y (m) and heading (rad) relative to the start pose.
    pose: [f64; 3],
    /// Angles of the wheels since then, rad, in their motors' sense.
    wheels: [f64; 4],
    /// Number of counter jumps.
    jumps: u64,
    /// The last of these: by how much, and how much it could have been, ticks.
    jump: Option<[u32; 2]>,
}

/// A wheel cannot turn by more in a cycle, ticks: 0.1 s at 6000 rpm.
const JUMP: u32 = 40_000;
/// Ticks of a motor in a second at one and a half times its largest speed.
const TICKS_PER_S: f64 = 1.5 * 409_600.0;
/// What a wheel may turn beside that, ticks: a share of a turn of its motor.
const PLAY: f64 = 500.0;

impl Odometry {
    /// Takes the encoders of the wheels. The heading is that in the middle of the step.
    pub fn advance(&mut self, mecanum: &Mecanum, ticks: [i32; 4]) {
        self.advance_within(mecanum, ticks, f64::INFINITY);
    }

    /// The same so many seconds after the last: what motors cannot turn within them is no way.
    pub fn advance_within(&mut self, mecanum: &Mecanum, ticks: [i32; 4], span_s: f64) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates, and is bounded"
        )]
        let most = ((span_s.max(0.0) * TICKS_PER_S + PLAY) as u32).min(JUMP);
        let last = self.last.replace(ticks).unwrap_or(ticks);
        let steps: [i32; 4] = std::array::from_fn(|i| ticks[i].wrapping_sub(last[i]));
        // A drive that lost its power counts from 0 again; the motion meanwhile is unknown.
        let longest = steps.iter().map(|step| step.unsigned_abs()).max();
        if let Some(longest) = longest.filter(|step| *step > most) {
            self.jumps += 1;
            self.jump = Some([longest, most]);
            return;
        }
        let angles = steps.map(|step| mecanum.angle(step));
        let [x, y, turn] = mecanum.velocity(angles);
        let (sin, cos) = (self.pose[2] + turn / 2.0).sin_cos();
        self.pose[0] += cos * x - sin * y;
        self.pose[1] += sin * x + cos * y;
        self.pose[2] += turn;
        for (wheel, angle) in self.wheels.iter_mut().zip(angles) {
            *wheel += angle;
        }
    }

    /// The drives are offline: their counters restart when they are back.
    pub const fn forget(&mut self) {
        self.last = None;
    }

    /// x and y (m) and heading (rad).
    pub const fn pose(&self) -> [f64; 3] {
        self.pose
    }

    /// Angles of the wheels, rad.
    pub const fn wheels(&self) -> [f64; 4] {
        self.wheels
    }

    /// Number of counter jumps.
    pub const fn jumps(&self) -> u64 {
        self.jumps
    }

    /// The last of these: by how much a wheel rolled, and how much it could have, m.
    pub fn jump(&self, mecanum: &Mecanum) -> Option<[f64; 2]> {
        let rolled = |ticks: u32| {
            let ticks = i32::try_from(ticks).unwrap_or(i32::MAX);
            mecanum.angle(ticks).abs() * mecanum.radius
        };
        self.jump.map(|ticks| ticks.map(rolled))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values recorded from the vendor's driver.
    #[test]
    fn velocities_match_speeds_of_the_vendor_driver() {
        let mecanum = Mecanum::default();
        assert_eq!(mecanum.rpm([0.2, 0.0, 0.0]), [-1039, 1039, -1039, 1039]);
        assert_eq!(mecanum.rpm([0.0, 0.2, 0.0]), [1039, 1039, -1039, -1039]);
        assert_eq!(mecanum.rpm([0.0, 0.0, 0.5]), [1000; 4]);
        let fast = mecanum.rpm([10.0, 0.0, 10.0]);
        assert_eq!(fast.iter().map(|rpm| rpm.abs()).max(), Some(6000));
        let [x, _, turn] = mecanum.velocity(fast.map(|rpm| mecanum.rate(rpm)));
        assert!((x - turn).abs() < 1e-3, "slower on the same path");
    }

    #[test]
    fn velocities_convert_back() {
        let mecanum = Mecanum::default();
        let velocity = [0.3, -0.2, 0.7];
        let back = mecanum.velocity(mecanum.rates(velocity));
        for (one, other) in velocity.into_iter().zip(back) {
            assert!((one - other).abs() < 1e-12);
        }
    }

    #[test]
    fn odometry_of_a_quarter_circle_is_exact() {
        let (mecanum, mut odometry) = (Mecanum::default(), Odometry::default());
        // At the upper end of the counters, so that they wrap.
        let mut ticks = [f64::from(i32::MAX) - 10.0; 4];
        #[expect(clippy::cast_possible_truncation, reason = "wrapped on purpose")]
        let wrapped = |ticks: [f64; 4]| ticks.map(|one| one as i64 as i32);
        odometry.advance(&mecanum, wrapped(ticks));
        let turn = std::f64::consts::FRAC_PI_2;
        // In steps long enough that the choice of the heading matters.
        for _ in 0..20 {
            let rates = mecanum.rates([0.5 * turn, 0.0, turn]);
            for (one, rate) in ticks.iter_mut().zip(rates) {
                *one += rate * 0.05 * mecanum.gear / TAU * TICKS;
            }
            odometry.advance(&mecanum, wrapped(ticks));
        }
        let [x, y, heading] = odometry.pose();
        assert!((x - 0.5).abs() < 1e-3 && (y - 0.5).abs() < 1e-3, "{x} {y}");
        assert!((heading - turn).abs() < 1e-3);
        odometry.advance(&mecanum, [0; 4]);
        assert_eq!(odometry.jumps(), 1);
        assert!((odometry.pose()[0] - x).abs() < 1e-12);
    }

    #[test]
    fn base_ramp_keeps_acceleration_and_direction() {
        let mut ramp = Ramp::new(1.0, 2.0);
        ramp.step([0.3, 0.4, 1.0], 0.1);
        let [x, y, turn] = ramp.velocity();
        assert!((x.hypot(y) - 0.1).abs() < 1e-12 && (y / x - 4.0 / 3.0).abs() < 1e-9);
        assert!((turn - 0.2).abs() < 1e-12);
        for _ in 0..10 {
            ramp.step([0.3, 0.4, 1.0], 0.1);
        }
        let away = ramp.velocity().map(f64::to_bits);
        assert_eq!(away, [0.3_f64, 0.4, 1.0].map(f64::to_bits));
        ramp.rest();
        assert_eq!(ramp.velocity().map(f64::to_bits), [0; 3]);
    }
}

//! Any stream at any period, through any cycle of a driver: what leaves keeps the joint's limits, differentiated here.

#![expect(clippy::cast_possible_truncation, reason = "times of some minutes")]
#![expect(clippy::cast_precision_loss, reason = "times of some minutes")]

use proptest::prelude::*;

use super::*;

const LIMITS: JointLimits = JointLimits {
    position_min: -2.0,
    position_max: 2.5,
    velocity_max: 1.9,
    acceleration_max: 4.0,
};

/// What becomes of a stream for some of its set-points.
#[derive(Clone, Copy, Debug)]
enum Part {
    /// A line at this speed, rad/s.
    Line(f64, u8),
    /// A corner to and fro, by so much a set-point, rad.
    Zigzag(f64, u8),
    /// Anywhere.
    At(f64),
    /// No number.
    Nan,
    /// None come, for so many driver cycles; then they go on.
    Gap(u16),
    /// The net thread stalls for this number of driver cycles.
    Stall(u16),
    /// The host stalls for this number of driver cycles, the driver too, and its drives take what comes for one cycle.
    Freeze(u16),
    /// Datagrams are lost: the next position is for so many cycles.
    Loss(u8),
    /// The driver is not allowed to move it: it rests where it is.
    Reset,
    /// It brakes for another cause, for so many driver cycles.
    Stop(u16),
    /// The clock is set by so many driver cycles.
    Clock(i8),
    /// Another net takes over with another period, this times the one before.
    Period(f64),
}

fn part() -> impl Strategy<Value = Part> {
    prop_oneof![
        4 => (-3.0..3.0, 1..12_u8).prop_map(|(speed, n)| Part::Line(speed, n)),
        2 => (-0.19..0.19, 1..12_u8).prop_map(|(by, n)| Part::Zigzag(by, n)),
        1 => (-4.0..4.0).prop_map(Part::At),
        1 => Just(Part::Nan),
        1 => (1..400_u16).prop_map(Part::Gap),
        1 => (1..400_u16).prop_map(Part::Stall),
        1 => (1..400_u16).prop_map(Part::Freeze),
        1 => (2..40_u8).prop_map(Part::Loss),
        1 => Just(Part::Reset),
        1 => (1..100_u16).prop_map(Part::Stop),
        1 => (-40..40_i8).prop_map(Part::Clock),
        1 => (0.1..8.0).prop_map(Part::Period),
    ]
}

/// 250 us to 60 s, evenly by their logarithm.
fn period() -> impl Strategy<Value = i64> {
    (0.0..1.0_f64).prop_map(|share| (250_000.0 * (60.0 / 250e-6_f64).powf(share)) as i64)
}

struct Play {
    joint: Joint,
    points: JointSetPoints,
    now: i64,
    cycle: i64,
    /// When the last cycle of the net thread was, and when the next set-point is due.
    net: i64,
    due: i64,
    clock: i64,
    jitter: Vec<i64>,
    samples: usize,
    wanted: f64,
    last: (f64, f64),
}

impl Play {
    fn new(period: i64, cycle: i64, jitter: Vec<i64>) -> Self {
        let points = JointSetPoints {
            period: Nanos(period),
            ..JointSetPoints::default()
        };
        Self {
            joint: Joint::new(LIMITS),
            points,
            now: 0,
            cycle,
            net: 0,
            due: 0,
            clock: 0,
            jitter,
            samples: 0,
            wanted: 0.0,
            last: (0.0, 0.0),
        }
    }

    /// A cycle of the driver that lasts `cycles` for its device.
    fn sample(&mut self, cycles: i64, must_brake: bool) -> Result<(), TestCaseError> {
        self.now += self.cycle * cycles;
        self.samples += 1;
        let jitter = self.jitter[self.samples % self.jitter.len()];
        let dt_s = (self.cycle * cycles) as f64 * 1e-9;
        let fresh = self.now - self.net <= 12 * self.cycle && !must_brake;
        let at = Nanos(self.now + self.clock + jitter) - self.joint.delay(&self.points);
        let position = self.joint.sample(&self.points, fresh, at, dt_s);
        let (before, before_speed) = self.last;
        let speed = (position - before) / dt_s;
        let acceleration = (speed - before_speed) / dt_s;
        self.last = (position, speed);
        let slack = 1e-15 * 8.0 / (dt_s * dt_s) + 4e-6;
        prop_assert!(
            (-2.0..=2.5).contains(&position),
            "out of range: {}",
            position
        );
        prop_assert!(speed.abs() <= 1.9, "too fast: {}", speed);
        prop_assert!(
            acceleration.abs() <= 4.0 + slack,
            "too hard: {}",
            acceleration
        );
        if must_brake {
            prop_assert!(
                speed.abs() <= before_speed.abs() + 1e-9,
                "does not brake: {}",
                speed
            );
        }
        Ok(())
    }

    /// Gives a set-point, and lets the driver go on until the next is due.
    fn give(&mut self, position: Option<f64>) -> Result<(), TestCaseError> {
        let time = Nanos(self.due.max(self.now));
        self.points
            .advance(position.map(|position| SetPoint { time, position }));
        self.due = time.0 + self.points.period.0;
        while self.now < self.due {
            // The net thread has a cycle of its own and is alive.
            self.net = self.now;
            self.sample(1, false)?;
        }
        Ok(())
    }

    fn run(&mut self, part: Part) -> Result<(), TestCaseError> {
        let period_s = self.points.period.0 as f64 * 1e-9;
        match part {
            Part::Line(speed, points) => {
                for _ in 0..points.min(self.most()) {
                    self.wanted += speed * period_s.min(0.5);
                    self.give(Some(self.wanted))?;
                }
            }
            Part::Zigzag(by, points) => {
                for n in 0..points.min(self.most()) {
                    self.wanted += if n % 2 == 0 { by } else { -by };
                    self.give(Some(self.wanted))?;
                }
            }
            Part::At(position) => {
                self.wanted = position;
                self.give(Some(position))?;
            }
            Part::Nan => self.give(Some(f64::NAN))?,
            Part::Gap(cycles) => {
                self.points.advance(None);
                for _ in 0..cycles {
                    self.net = self.now;
                    self.sample(1, false)?;
                }
                // A net may begin where the joint is.
                self.wanted = self.last.0;
            }
            Part::Stall(cycles) => {
                for _ in 0..cycles {
                    self.sample(1, false)?;
                }
            }
            Part::Freeze(cycles) => {
                self.now += self.cycle * i64::from(cycles);
                self.net = self.now;
                self.sample(1, false)?;
            }
            Part::Loss(cycles) => self.sample(cycles.into(), false)?,
            Part::Reset => {
                self.joint.rest_at(self.last.0, &self.points);
                self.last.1 = 0.0;
            }
            Part::Stop(cycles) => {
                for _ in 0..cycles {
                    self.sample(1, true)?;
                }
            }
            Part::Clock(cycles) => self.clock += self.cycle * i64::from(cycles),
            Part::Period(times) => {
                let period = (self.points.period.0 as f64 * times) as i64;
                self.points.period = Nanos(period.clamp(250_000, 60_000_000_000));
            }
        }
        Ok(())
    }

    /// Set-points of long periods are few, so that a case ends.
    fn most(&self) -> u8 {
        let cycles = self.points.period.0 / self.cycle;
        u8::try_from((20_000 / cycles.max(1)).clamp(1, 12)).unwrap_or(1)
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// From net periods of 250 us to 60 s, driver cycles of 250 us to 4 ms.
    #[test]
    fn setpoint_stream_of_any_period_stays_within_limits(
        period in period(),
        cycle in prop::sample::select(vec![250_000_i64, 500_000, 1_000_000, 2_000_000, 4_000_000]),
        parts in prop::collection::vec(part(), 1..10),
        jitter in prop_oneof![
            Just(vec![0]),
            prop::collection::vec(-3_000..3_000_i64, 7),
            prop::collection::vec(-200_000..200_000_i64, 7),
        ],
    ) {
        // A period of minutes by cycles of 250 us would take one.
        let cycle = cycle.max(period / 30_000);
        let mut play = Play::new(period, cycle, jitter);
        play.give(Some(0.0))?;
        for part in parts {
            play.run(part)?;
        }
        // Whatever was before: it can be stopped, and is at rest in the time that its limits give.
        let stops_in = (1.9 / 4.0 * 1e9) as i64 / cycle + 2;
        for _ in 0..stops_in {
            play.sample(1, true)?;
        }
        prop_assert!(play.last.1.abs() < 1e-12, "{:?}", play.last);
    }
}

//! A cycle that follows the reference clock of an emulated segment, in virtual time: the master, the servo and the
//! grid are those of the driver thread, in the order in which it uses them. Nothing here waits.

use std::time::Duration;

use takt_ethercat::config::{Location, MasterConfig, SlaveSpec, SyncSpec};
use takt_ethercat::dc::{Sample, phase_ns};
use takt_ethercat::emulator::{Entry, Segment, ServoConfig, ServoDrive};
use takt_ethercat::master::Master;
use takt_rt::Nanos;
use takt_rt::cycle::Grid;
use takt_rt::servo::{Servo, ServoConfig as Settings};

/// Time from one frame to the next.
pub(crate) const CYCLE: Duration = Duration::from_millis(1);
/// Where frames are wanted, behind SYNC0.
pub(crate) const PHASE: Duration = Duration::from_micros(500);

/// A cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Point {
    /// When it was to begin, since the first.
    pub at: Duration,
    /// How far behind its place to SYNC0 it was to begin, ns.
    pub cycle_ns: i64,
    /// How far behind that place its frame passed the reference clock, ns.
    pub frame_ns: i64,
}

/// Delays as a busy host makes them.
struct Noise {
    seed: u64,
    deviation_ns: f64,
}

impl Noise {
    /// The absolute value of a normal number, ns: the sum of twelve uniform ones is one, nearly.
    fn delay(&mut self) -> Duration {
        let mut sum = 0.0;
        for _ in 0..12 {
            self.seed = self
                .seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            let bits = u32::try_from(self.seed >> 32).unwrap_or(0);
            sum += f64::from(bits) / f64::from(u32::MAX);
        }
        Duration::from_secs_f64((sum - 6.0).abs() * self.deviation_ns * 1e-9)
    }
}

/// A segment and its master, and where they are in time.
struct Bench {
    segment: Segment,
    master: Master,
    servo: Servo,
    grid: Grid,
    noise: Noise,
}

/// Time as a number of nanoseconds.
fn ns(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

fn since_zero(at: Nanos) -> Duration {
    Duration::from_nanos(at.0.unsigned_abs())
}

impl Bench {
    fn new(drifts_ppb: &[i64], deviation_ns: f64) -> Self {
        let drive = |(number, drift): (u64, &i64)| {
            let config = ServoConfig {
                needs_sync0: true,
                clock: (number * 0x1234_5678_9ABC, *drift),
                ..ServoConfig::default()
            };
            ServoDrive::slave(config).unwrap().0
        };
        let slave = |position| SlaveSpec {
            sync: Some(SyncSpec::sync0(CYCLE)),
            ..SlaveSpec::new(format!("axis {position}"), Location::Position(position))
        };
        let count = u16::try_from(drifts_ppb.len()).unwrap();
        let config = MasterConfig {
            cycle: CYCLE,
            slaves: (0..count).map(slave).collect(),
            ..MasterConfig::default()
        };
        Self {
            segment: Segment::line((1..).zip(drifts_ppb).map(drive)),
            master: Master::new(config).unwrap(),
            servo: Servo::new(&Settings::new(CYCLE)),
            grid: Grid::new(Nanos::from_millis(1000), CYCLE),
            noise: Noise {
                seed: 7,
                deviation_ns,
            },
        }
    }

    /// One frame there and back; when it passed the reference clock, if it did.
    fn exchange(&mut self, sent: Duration) -> Option<(Sample, Duration)> {
        let mut frame = [0; 1500];
        let len = self.master.poll_transmit(sent, &mut frame)?;
        let passed = sent + self.noise.delay();
        let bytes = &mut frame[..len];
        let back = self.segment.process(bytes, Entry::First, ns(passed))?;
        let received = passed + Duration::from_nanos(back.after) + self.noise.delay();
        self.master.handle_frame(0, bytes, received);
        while self.master.poll_event().is_some() {}
        Some((self.master.poll_sample()?, passed))
    }

    /// One cycle, as the driver does it; where it lay, if the reference clock was heard.
    fn cycle(&mut self) -> Option<Point> {
        let deadline = self.grid.deadline();
        let tick = self.grid.next(deadline);
        let begin = since_zero(tick.scheduled);
        let sent = begin + self.noise.delay();
        let heard = self.exchange(sent);
        if let Some((sample, _)) = heard {
            let way = sample.received.saturating_sub(sample.sent);
            let local = Nanos::from(sample.sent + way / 2);
            let remote = Nanos(i64::try_from(sample.system_ns).unwrap());
            self.servo.handle_sample(local, remote);
        }
        self.servo.handle_time(Nanos::from(sent));
        let estimate = self.servo.estimate();
        if estimate.state.is_followed() {
            self.grid.steer(&estimate, PHASE.into());
        }
        let (sample, passed) = heard?;
        let behind = |system_ns: u64| {
            let period = i64::try_from(ns(CYCLE)).unwrap();
            let late = i64::try_from(phase_ns(system_ns, CYCLE, 0)).unwrap();
            let late = late - i64::try_from(ns(PHASE)).unwrap();
            (late + period / 2).rem_euclid(period) - period / 2
        };
        Some(Point {
            at: begin - Duration::from_secs(1),
            // Clocks that drift by parts in a million agree on so short a way.
            cycle_ns: behind(sample.system_ns - ns(passed - begin)),
            frame_ns: behind(sample.system_ns),
        })
    }
}

/// So long a run with drives whose clocks drift by these, ppb, and delays of this deviation on each way; panics if the
/// segment is not in OP at the end with all clocks within their window.
pub(crate) fn run(drifts_ppb: &[i64], deviation_ns: f64, time: Duration) -> Vec<Point> {
    let mut bench = Bench::new(drifts_ppb, deviation_ns);
    let cycles = time.as_nanos() / CYCLE.as_nanos();
    let points = (0..cycles).filter_map(|_| bench.cycle()).collect();
    assert!(bench.master.is_operational());
    for slave in (0..bench.master.len()).filter_map(|n| bench.master.slave(n)) {
        assert_eq!(slave.clock_violations(), 0);
    }
    points
}

/// Root mean square of the cycles' distances from `from` on, ns.
pub(crate) fn rms_ns(points: &[Point], from: Duration) -> f64 {
    let later = points.iter().filter(|point| point.at >= from);
    let (mut sum, mut count) = (0.0, 0.0);
    for point in later {
        #[expect(clippy::cast_precision_loss, reason = "below a period")]
        let distance = point.cycle_ns as f64;
        sum += distance * distance;
        count += 1.0;
    }
    (sum / f64::max(count, 1.0)).sqrt()
}

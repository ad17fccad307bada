//! The servo compared with the loops of small masters, and with the gains of linuxptp, on the same samples in one
//! run: settling time, phase error, and what a sample costs. `cargo bench -p takt-rt --bench servo`.
//!
//! All but the cost is virtual time and the same at each run on any machine. The others are loops of the
//! published form, not those programs: no steps, no filters of delays.
//!
//! A clock 1 ms and 100 ppm off, sampled at 1 kHz. It counts as settled when the rms error of each 20 ms is
//! below 10 µs for a second. Rms and maximum are those of the last 200 s of 600.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use std::{hint::black_box, time::Duration};

use takt_rt::{
    Nanos, monotonic,
    servo::{Servo, ServoConfig},
};

const PERIOD_NS: f64 = 1e6;
const PERIOD_S: f64 = 1e-3;
const OFFSET_NS: f64 = 1e6;
const DRIFT: f64 = 100e-6;
const SAMPLES: usize = 600_000;
/// Errors count from here.
const STEADY: usize = 400_000;
const WINDOW: usize = 20;
/// Windows in a second.
const SECOND: usize = 50;
const SETTLED_NS: f64 = 10e3;

fn main() {
    let mut json = Vec::new();
    for (name, series) in [("white", white()), ("queue", queue())] {
        println!("{name}: {}", about(name));
        println!("                                settled        rms        max");
        let takt = judge(&series, &mut Takt::new(512));
        report("takt", &takt, &takt);
        json.push(format!(
            "\"{name}\":{{\"takt\":{{\"settled_s\":{},\"rms_us\":{:.3},\"max_us\":{:.3}}}",
            seconds(takt.settled),
            takt.rms_ns * 1e-3,
            takt.max_ns * 1e-3
        ));
        let others: [(&str, Box<dyn Loop>); 5] = [
            ("takt_memory_8192", Box::new(Takt::new(8_192))),
            (
                "proportional_1_10",
                Box::new(Proportional::new(0.1, f64::MAX)),
            ),
            (
                "proportional_1_50_clamped",
                Box::new(Proportional::new(0.02, 100e3)),
            ),
            ("linuxptp_hardware", Box::new(Pi::new(0.7, 0.3))),
            ("linuxptp_software", Box::new(Pi::new(0.1, 0.001))),
        ];
        for (other, mut servo) in others {
            let verdict = judge(&series, servo.as_mut());
            report(other, &verdict, &takt);
            json.push(format!(
                "\"{other}\":{{\"settled_ratio\":{},\"rms_ratio\":{:.2}}}",
                ratio(&verdict, &takt).map_or_else(|| "null".into(), |r| format!("{r:.2}")),
                verdict.rms_ns / takt.rms_ns
            ));
        }
        if let Some(last) = json.last_mut() {
            last.push('}');
        }
    }
    let cost = cost();
    println!("one sample costs {cost:.0} ns");
    println!(
        "{{\"bench\":\"servo\",{},\"sample_ns\":{cost:.0}}}",
        json.join(",")
    );
}

fn about(name: &str) -> &'static str {
    match name {
        "white" => "20 us rms of white noise",
        _ => "5 us of queueing, 300 us more for 1 %, now and then 1 ms for ten in a row",
    }
}

/// Something that follows a clock.
trait Loop {
    /// Sample after a period: the remote clock seems to show `local + offset_ns`.
    /// Returns the loop's estimate of that offset, ns.
    fn sample(&mut self, offset_ns: f64) -> f64;
}

struct Takt {
    servo: Servo,
    now: Nanos,
}

impl Takt {
    fn new(memory: u32) -> Self {
        let servo = Servo::new(&ServoConfig {
            memory,
            ..ServoConfig::new(Duration::from_millis(1))
        });
        Self {
            servo,
            now: Nanos::ZERO,
        }
    }
}

impl Loop for Takt {
    fn sample(&mut self, offset_ns: f64) -> f64 {
        self.now += Nanos::from_millis(1);
        self.servo
            .handle_sample(self.now, self.now + nanos(offset_ns));
        float(self.servo.estimate().remote_at(self.now) - self.now)
    }
}

/// Corrects by a fixed part of the error.
struct Proportional {
    part: f64,
    clamp_ns: f64,
    offset_ns: f64,
}

impl Proportional {
    fn new(part: f64, clamp_ns: f64) -> Self {
        Self {
            part,
            clamp_ns,
            offset_ns: 0.0,
        }
    }
}

impl Loop for Proportional {
    fn sample(&mut self, offset_ns: f64) -> f64 {
        let error = offset_ns - self.offset_ns;
        self.offset_ns += self.part * error.clamp(-self.clamp_ns, self.clamp_ns);
        self.offset_ns
    }
}

/// A PI servo that sets a frequency, with linuxptp's default gains, scaled to the period as it does:
/// `kp = scale · T^-0.3`, `ki = scale · T^0.4`; the frequency first estimated over `0.016 / ki` seconds,
/// then the phase set once.
struct Pi {
    kp: f64,
    ki: f64,
    first: Option<f64>,
    age_s: f64,
    is_locked: bool,
    drift_ppb: f64,
    ppb: f64,
    offset_ns: f64,
}

impl Pi {
    fn new(kp_scale: f64, ki_scale: f64) -> Self {
        Self {
            kp: kp_scale * PERIOD_S.powf(-0.3),
            ki: ki_scale * PERIOD_S.powf(0.4),
            first: None,
            age_s: 0.0,
            is_locked: false,
            drift_ppb: 0.0,
            ppb: 0.0,
            offset_ns: 0.0,
        }
    }
}

impl Loop for Pi {
    fn sample(&mut self, offset_ns: f64) -> f64 {
        self.offset_ns += self.ppb * PERIOD_S;
        let first = *self.first.get_or_insert(offset_ns);
        if !self.is_locked {
            if self.age_s >= 0.016 / self.ki {
                self.drift_ppb = (offset_ns - first) / self.age_s;
                self.ppb = self.drift_ppb;
                self.offset_ns = offset_ns;
                self.is_locked = true;
            }
            self.age_s += PERIOD_S;
            return self.offset_ns;
        }
        let error = offset_ns - self.offset_ns;
        self.drift_ppb += self.ki * error;
        self.ppb = self.kp * error + self.drift_ppb;
        self.offset_ns
    }
}

struct Verdict {
    settled: Option<f64>,
    rms_ns: f64,
    max_ns: f64,
}

fn judge(noise: &[f64], servo: &mut dyn Loop) -> Verdict {
    let mut offset = OFFSET_NS;
    let errors: Vec<f64> = noise
        .iter()
        .map(|noise| {
            offset += DRIFT * PERIOD_NS;
            servo.sample(offset + noise) - offset
        })
        .collect();
    let windows: Vec<f64> = errors.chunks(WINDOW).map(rms).collect();
    let calm = |second: &[f64]| second.iter().all(|&window| window < SETTLED_NS);
    let settled = windows.windows(SECOND).position(calm);
    let steady = &errors[STEADY..];
    Verdict {
        // The good window must be complete first.
        settled: settled.map(|first| count((first + 1) * WINDOW) * PERIOD_S),
        rms_ns: rms(steady),
        max_ns: steady.iter().fold(0.0, |max, error| error.abs().max(max)),
    }
}

fn report(name: &str, verdict: &Verdict, takt: &Verdict) {
    let settled = verdict
        .settled
        .map_or_else(|| "never".into(), |s| format!("{s:.2} s"));
    let ratios = match ratio(verdict, takt) {
        Some(settling) => format!("settling x{settling:.2}, "),
        None => String::new(),
    };
    println!(
        "  {name:26} {settled:>10} {:>7.2} us {:>7.1} us   {ratios}rms x{:.2}",
        verdict.rms_ns * 1e-3,
        verdict.max_ns * 1e-3,
        verdict.rms_ns / takt.rms_ns
    );
}

fn ratio(verdict: &Verdict, takt: &Verdict) -> Option<f64> {
    Some(verdict.settled? / takt.settled?)
}

fn seconds(settled: Option<f64>) -> String {
    settled.map_or_else(|| "null".into(), |s| format!("{s:.3}"))
}

/// Mean of the fastest of some rounds, ns.
fn cost() -> f64 {
    let noise: Vec<Nanos> = white().into_iter().take(60_000).map(nanos).collect();
    let mut best = f64::MAX;
    for _ in 0..11 {
        let mut servo = Servo::new(&ServoConfig::new(Duration::from_millis(1)));
        let start = monotonic();
        for (local, noise) in (0..).map(|n| Nanos(n * 1_000_000)).zip(&noise) {
            black_box(servo.handle_sample(local, local + *noise));
            black_box(servo.estimate());
        }
        best = best.min(float(monotonic() - start) / count(noise.len()));
    }
    best
}

fn white() -> Vec<f64> {
    let mut random = Random(0x2545_f491_4f6c_dd1d);
    (0..SAMPLES).map(|_| random.normal() * 20e3).collect()
}

/// Samples are late, never early: the clock seems behind.
fn queue() -> Vec<f64> {
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let mut burst = 0;
    let late = |_| {
        let queued = random.exponential() * 5e3;
        let tail = if random.uniform() < 0.01 {
            300e3 * random.exponential()
        } else {
            0.0
        };
        burst = if random.uniform() < 0.001 {
            10_u32
        } else {
            burst.saturating_sub(1)
        };
        let full = if burst > 0 {
            1e6 * random.exponential()
        } else {
            0.0
        };
        // The mean of the queue is an offset, for all alike.
        5e3 - (queued + tail + full)
    };
    (0..SAMPLES).map(late).collect()
}

/// The same numbers at each run.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        ((self.0 >> 12) as f64 + 0.5) / (1_u64 << 52) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    fn exponential(&mut self) -> f64 {
        -self.uniform().ln()
    }
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / count(values.len())).sqrt()
}

fn count(n: usize) -> f64 {
    n as f64
}

#[expect(clippy::cast_possible_truncation, reason = "at most a second")]
fn nanos(ns: f64) -> Nanos {
    Nanos(ns.round() as i64)
}

fn float(span: Nanos) -> f64 {
    span.0 as f64
}

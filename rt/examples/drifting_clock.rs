//! A cycle thread kept in phase with a device's clock, here an emulated one that runs 80 ppm fast and is
//! read over a noisy line. `cargo run --example drifting_clock --release [CYCLES]`; 1 ms each, no rights needed.
//!
//! The clock is emulated, the thread, its sleeps and their lateness are real.
#![expect(clippy::print_stdout, reason = "examples print results")]

use std::{env, io, ops::ControlFlow, time::Duration};

use takt_rt::{
    Nanos, alloc,
    cycle::{Cycles, Follow},
    flight::FlightRecorder,
    latest::latest,
    monotonic,
    servo::{Estimate, Servo, ServoConfig},
    stats,
    thread::{ThreadConfig, spawn},
};

const PERIOD: Duration = Duration::from_millis(1);
/// Phase of this thread in the device's cycle.
const PHASE: Nanos = Nanos::from_micros(300);
const DRIFT_PPM: i64 = 80;

fn main() -> io::Result<()> {
    let cycles = env::args()
        .nth(1)
        .and_then(|text| text.parse().ok())
        .unwrap_or(3_000);

    let (mut writer, reader) = stats::pair();
    // The driver publishes its estimate of the clock; any thread may follow it. This one follows its own.
    let (mut clock_out, clock) = latest(1, Estimate::default);
    let config = ThreadConfig {
        priority: Some(80),
        ..ThreadConfig::new("follow")
    };
    let thread = spawn(config, move || {
        let flight = FlightRecorder::new(32);
        let mut servo = Servo::new(&ServoConfig::new(PERIOD));
        let mut device = Device::switched_on();
        let real_time = alloc::enter_real_time();
        let source = Cycles {
            follow: Some(Follow::new(clock, PHASE)),
            flight: Some(&flight),
            ..Cycles::every(PERIOD)
        };
        source.run(&mut writer, |tick| {
            let (local, remote) = device.read_clock();
            servo.handle_sample(local, remote);
            clock_out.write(servo.estimate());
            if tick.index + 1 < cycles {
                ControlFlow::Continue(())
            } else {
                ControlFlow::Break(())
            }
        });
        drop(real_time);
        (servo.estimate(), flight)
    })?;

    let (clock, flight) = thread.join().expect("the body does not panic");
    println!("the device's clock: {clock}; true: {DRIFT_PPM:+} ppm");
    println!("{}", reader.snapshot());
    for entry in flight.entries() {
        println!("{entry}");
    }
    Ok(())
}

/// A device with a clock of its own.
struct Device {
    since: Nanos,
    reads: i64,
}

impl Device {
    fn switched_on() -> Self {
        Self {
            since: monotonic(),
            reads: 0,
        }
    }

    /// Local and remote time of one reading, up to 40 us apart by the noise of the line.
    fn read_clock(&mut self) -> (Nanos, Nanos) {
        let local = monotonic();
        let on_for = (local - self.since).0;
        self.reads += 1;
        let delay = self.reads * 7_919 % 40_000;
        let remote = on_for + on_for / 1_000_000 * DRIFT_PPM - delay;
        (local, Nanos(remote))
    }
}

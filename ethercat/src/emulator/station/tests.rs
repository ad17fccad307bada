//! The station under our master: its terminals, and the hand-shakes of the encoder.

use std::time::Duration;

use super::*;
use crate::config::MasterConfig;
use crate::emulator::Entry;
use crate::encoder::{Encoder, EncoderReading};
use crate::master::Master;

struct Bench {
    master: Master,
    segment: Segment,
    station: Station,
    now: Duration,
}

impl Bench {
    fn new(motor: StationMotor) -> Self {
        let (segment, station) = Station::segment([motor; STATION_AXES]);
        let mut bench = Self {
            master: Master::new(MasterConfig::default()).unwrap(),
            segment,
            station,
            now: Duration::from_secs(1),
        };
        for _ in 0..5000 {
            bench.cycle();
        }
        assert!(bench.master.is_operational());
        bench
    }

    fn cycle(&mut self) {
        let mut frame = [0; 1500];
        if let Some(len) = self.master.poll_transmit(self.now, &mut frame) {
            let ns = u64::try_from(self.now.as_nanos()).unwrap();
            if let Some(back) = self.segment.process(&mut frame[..len], Entry::First, ns) {
                let at = self.now + Duration::from_nanos(back.after);
                self.master.handle_frame(0, &frame[..len], at);
            }
        }
        self.now += self.master.config().cycle;
    }

    /// Enables an axis, without its brake, and gives it a voltage.
    fn drive(&mut self, axis: usize, volts: f64) {
        self.master
            .outputs_mut(Station::OUTPUTS)
            .fill(0b1001 << axis);
        #[expect(clippy::cast_possible_truncation, reason = "a voltage")]
        let raw = (volts / 10.0 * FULL_SCALE) as i16;
        self.master.outputs_mut(Station::ANALOGUE)[2 * axis..][..2]
            .copy_from_slice(&raw.to_le_bytes());
    }

    fn encoder(&self, axis: usize) -> Encoder {
        let slave = Station::ENCODER + axis;
        let view = self.master.slave(slave).unwrap();
        Encoder::new(slave, view.process(), 0).unwrap()
    }

    fn run(&mut self, encoder: &mut Encoder, cycles: usize, arm: bool) -> EncoderReading {
        let mut reading = EncoderReading::default();
        for _ in 0..cycles {
            self.cycle();
            reading = encoder.cycle(&mut self.master, arm);
        }
        reading
    }
}

#[test]
fn station_motor_turns_by_voltage_and_brake_holds() {
    let mut bench = Bench::new(StationMotor::default());
    let mut encoder = bench.encoder(1);
    assert_eq!(bench.run(&mut encoder, 10, false).count, 0);
    bench.drive(1, 1.0);
    // 5 turns a second, of 2,000 counts.
    let before = bench.run(&mut encoder, 100, false).count;
    let after = bench.run(&mut encoder, 1000, false).count;
    assert!((after - before - 10_000).abs() < 50, "{before} {after}");
    assert!((bench.station.angle(1) - 20.0 - 19.6).abs() < 0.3);
    assert!((bench.station.angle(0) - 20.0).abs() < 1e-9);
    bench.master.outputs_mut(Station::OUTPUTS).fill(0);
    let stopped = bench.run(&mut encoder, 20, false).count;
    assert!(bench.station.is_braked(1));
    assert_eq!(bench.run(&mut encoder, 100, false).count, stopped);
}

#[test]
fn encoder_latch_takes_first_pulse_after_arming() {
    let motor = StationMotor {
        index_at: 700,
        ..StationMotor::default()
    };
    let mut bench = Bench::new(motor);
    let mut encoder = bench.encoder(0);
    // The counter is zero where the motor was at power-on.
    let start = bench.station.lock()[0].count();
    for volts in [1.0, -1.0] {
        bench.drive(0, volts);
        assert_eq!(bench.run(&mut encoder, 300, false).latched, None);
        let reading = bench.run(&mut encoder, 600, true);
        let latched = reading.latched.unwrap();
        assert_eq!(
            (latched + start - motor.index_at).rem_euclid(2000),
            0,
            "{volts}"
        );
        // Later pulses do not replace it until it is armed again.
        let later = bench.run(&mut encoder, 900, true);
        assert_eq!(later.latched, Some(latched));
        assert!((later.count - latched).abs() > 2000);
        assert_eq!(bench.run(&mut encoder, 2, false).latched, None);
        let again = bench.run(&mut encoder, 600, true).latched.unwrap();
        assert!((again - latched).abs() >= 2000, "{again} {latched}");
        bench.run(&mut encoder, 5, false);
    }
    bench.station.inject(
        0,
        StationFaults {
            no_index: true,
            ..StationFaults::default()
        },
    );
    assert_eq!(bench.run(&mut encoder, 1000, true).latched, None);
}

#[test]
fn encoder_counter_is_set_and_wraps() {
    let mut bench = Bench::new(StationMotor::default());
    let mut encoder = bench.encoder(2);
    bench.run(&mut encoder, 5, false);
    assert!(encoder.set_counter(0x7FFF_FF00));
    assert!(!encoder.set_counter(1), "one at a time");
    let mut was_set = 0;
    for _ in 0..20 {
        was_set += usize::from(bench.run(&mut encoder, 1, false).was_set);
    }
    assert_eq!(was_set, 1);
    assert_eq!(bench.run(&mut encoder, 1, false).count, 0x7FFF_FF00);
    // Beyond the largest signed number of 32 bits.
    bench.drive(2, 1.0);
    let count = bench.run(&mut encoder, 500, false).count;
    assert!(count > 0x7FFF_FFFF + 1000, "{count}");
    assert!(encoder.set_counter(0));
    bench.drive(2, 0.0);
    let count = bench.run(&mut encoder, 300, false).count;
    assert!(count.abs() < 2000, "{count}");
}

#[test]
fn encoder_open_circuit_is_shown_and_counter_stands() {
    let mut bench = Bench::new(StationMotor::default());
    let mut encoder = bench.encoder(0);
    bench.drive(0, 2.0);
    let before = bench.run(&mut encoder, 100, false);
    assert!(before.online && !before.open_circuit);
    bench.station.inject(
        0,
        StationFaults {
            open_circuit: true,
            ..StationFaults::default()
        },
    );
    let open = bench.run(&mut encoder, 5, false);
    let later = bench.run(&mut encoder, 100, false);
    assert!(later.open_circuit);
    assert_eq!(open.count, later.count);
}

//! What leaves for emulated power bases, command by command and in virtual time, whatever nets want.

use std::time::Duration;

use takt_can::rmp::emulator::{Powerbase, PowerbaseConfig};
use takt_can::rmp::{ACCELERATION, Message, Model, OmniConfig};

use super::platform::Led;
use super::*;

const MS: Duration = Duration::from_millis(1);

/// A platform, its power bases, and what left for them.
struct Bench {
    led: Led,
    bases: Vec<Powerbase>,
    now: Duration,
    /// Counts of velocity and turn for each power base, command by command.
    sent: Vec<Vec<[i16; 2]>>,
}

impl Bench {
    fn new(model: Model, count: usize) -> Self {
        let names = ["front", "back"];
        let config = RmpConfig {
            model: model.name().to_owned(),
            ..RmpConfig::new("base", &names[..count])
        };
        let turn_gain = (count == 2).then(|| OmniConfig::default().turn_gain);
        let base = |_| {
            Powerbase::new(PowerbaseConfig {
                model,
                turn_gain,
                ..PowerbaseConfig::default()
            })
        };
        let mut bench = Self {
            led: Led::new(&config),
            bases: (0..count).map(base).collect(),
            now: Duration::ZERO,
            sent: vec![Vec::new(); count],
        };
        bench.run(None, 5000);
        assert!(bench.led.follows(), "{:?}", bench.led.states());
        bench.sent.iter_mut().for_each(Vec::clear);
        bench
    }

    /// So many milliseconds in which nets want this.
    fn run(&mut self, wanted: Option<[f64; 3]>, span: u32) {
        for _ in 0..span {
            self.now += MS;
            for (part, base) in self.bases.iter_mut().enumerate() {
                base.advance(self.now);
                while let Some((channel, frame)) = base.poll_transmit(self.now) {
                    self.led.handle(part, channel, &frame, self.now);
                }
            }
            let frames = self.led.command(wanted, self.now);
            for ((frame, base), sent) in frames.iter().zip(&mut self.bases).zip(&mut self.sent) {
                let Some(frame) = frame else { continue };
                base.handle_frame(frame, self.now);
                if let Some(Message::Command(command)) = Message::decode(frame) {
                    sent.push([command.velocity, command.turn]);
                }
            }
        }
    }
}

/// Whatever nets want, also no numbers, and while the host is away.
#[test]
fn rmp_commands_change_within_acceleration() {
    let mut bench = Bench::new(Model::Rmp200, 1);
    for (wanted, span) in [
        (Some([1.0, 0.0, 0.5]), 700),
        (Some([-9.0, 3.0, -9.0]), 4000),
        (Some([f64::NAN, 0.0, 0.0]), 200),
        (Some([0.4, 0.0, 2.0]), 900),
    ] {
        bench.run(wanted, span);
        // The host is away for a while.
        bench.now += MS * 130;
    }
    bench.run(None, 3000);
    let scale = Model::Rmp200.scales().velocity;
    let [limit, turn_limit] = ACCELERATION.map(|limit| limit * 0.05);
    // Counts of a degree per second.
    let per_turn = 7.8_f64.to_degrees();
    let mut fastest = 0.0_f64;
    for pair in bench.sent[0].windows(2) {
        let change = |i: usize| f64::from(pair[1][i] - pair[0][i]).abs();
        assert!(change(0) / scale <= limit + 1.0 / scale, "{pair:?}");
        assert!(
            change(1) / per_turn <= turn_limit + 1.0 / per_turn,
            "{pair:?}"
        );
        fastest = fastest.max(f64::from(pair[1][0]).abs() / scale);
    }
    assert!(
        fastest > 0.8 && fastest <= VELOCITY_MAX + 1.0 / scale,
        "{fastest}"
    );
    assert_eq!(bench.sent[0].last(), Some(&[0, 0]));
    let [floor, turning] = bench.led.limited();
    assert!(
        floor.onsets > 0 && turning.onsets > 0,
        "{floor:?} {turning:?}"
    );
}

#[test]
fn rmp_platform_commands_change_within_acceleration() {
    let mut bench = Bench::new(Model::Rmp50, 2);
    for (wanted, span) in [
        (Some([0.6, 0.0, 0.0]), 700),
        (Some([0.0, 5.0, 3.0]), 4000),
        (Some([-1.0, -1.0, -2.0]), 2000),
        (None, 400),
        (Some([1.0, 1.0, 0.0]), 1000),
        (None, 4000),
    ] {
        bench.run(wanted, span);
    }
    let config = OmniConfig::default();
    let commands = bench.sent[0].len().min(bench.sent[1].len());
    assert!(commands > 200);
    // From counts back to what the base was commanded.
    let twist = |n: usize| {
        let mut wheels = [0.0; 4];
        for part in 0..2 {
            let [velocity, turn] = bench.sent[part][n].map(f64::from);
            let (ahead, about) = (velocity * config.velocity_gain, turn * config.turn_gain);
            let [left, right] =
                [ahead + about, ahead - about].map(|v| v / config.counts_per_radian);
            if part == 0 {
                (wheels[0], wheels[1]) = (left, right);
            } else {
                // It is turned round.
                (wheels[3], wheels[2]) = (-left, -right);
            }
        }
        config.geometry.velocity(wheels)
    };
    // Of whole counts, of which each part has some.
    let coarse = 2.0 * config.velocity_gain.max(config.turn_gain) / config.counts_per_radian
        * config.geometry.radius;
    let mut fastest = 0.0_f64;
    for n in 1..commands {
        let (before, now) = (twist(n - 1), twist(n));
        let floor = (now[0] - before[0]).hypot(now[1] - before[1]);
        assert!(
            floor <= ACCELERATION[0] * 0.05 + coarse,
            "{before:?} {now:?}"
        );
        let turn = (now[2] - before[2]).abs();
        let coarse = coarse / config.geometry.lever;
        assert!(
            turn <= ACCELERATION[1] * 0.05 + coarse,
            "{before:?} {now:?}"
        );
        fastest = fastest.max(now[0].hypot(now[1]));
    }
    assert!(
        fastest > 0.5 && fastest <= VELOCITY_MAX + coarse,
        "{fastest}"
    );
    assert!(bench.led.rests());
}

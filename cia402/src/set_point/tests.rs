//! The hand-shake with the emulated drive, and with hand-made statuswords.

#![cfg(feature = "emulator")]

use super::*;
use crate::dictionary::{Address, Dictionary, Key, Number};
use crate::emulator::{Drive, DriveConfig, Step};
use crate::{Feedback, Goal, Master, MasterOptions, State};

const MS: Duration = Duration::from_millis(1);

struct Pair {
    master: Master,
    shake: HandShake,
    drive: Drive,
    d: Dictionary,
    now: Duration,
    outcomes: Vec<Result<(), SetPointError>>,
    /// Slowest while it moved from the one to the next, user units/s.
    slowest: i32,
}

impl Pair {
    /// A drive that is enabled in profile position.
    fn new() -> Self {
        let config = DriveConfig::default();
        let d = Dictionary::new(config.objects(0)).unwrap();
        let drive = Drive::new(config, 0, &d).unwrap();
        let mut master = Master::new(MasterOptions::default());
        master.set_mode(1);
        master.set_goal(Goal::OperationEnabled);
        let mut pair = Self {
            master,
            shake: HandShake::new(100 * MS),
            drive,
            d,
            now: Duration::ZERO,
            outcomes: vec![],
            slowest: i32::MAX,
        };
        pair.run(200);
        assert_eq!(pair.drive.state(), State::OperationEnabled);
        pair
    }

    fn key<T: Number>(&self, index: u16) -> Key<T> {
        self.d.key(Address::new(index, 0)).unwrap()
    }

    fn step(&mut self) {
        self.now += MS;
        let feedback = Feedback {
            status: StatusWord::new(self.d.get(self.key(0x6041))),
            mode: Some(self.d.get(self.key(0x6061))),
            position: self.position(),
        };
        let drive_command = self.master.step(&feedback, self.now);
        let offer = self
            .shake
            .step(feedback.status, drive_command.follows, self.now);
        self.outcomes.extend(offer.outcome);
        let word = drive_command.control.raw() | offer.bits;
        self.d.set(self.key(0x6040), word);
        self.d.set(self.key(0x6060), drive_command.mode);
        if let Some(target) = offer.target {
            self.d.set(self.key(0x607A), target);
        }
        let dt = MS;
        let _ = self.drive.step(
            &mut self.d,
            &Step {
                dt,
                ..Step::default()
            },
        );
        self.slowest = self.slowest.min(self.d.get(self.key(0x606C)));
    }

    fn run(&mut self, ms: u32) {
        (0..ms).for_each(|_| self.step());
    }

    fn position(&self) -> i32 {
        self.d.get(self.key(0x6064))
    }

    fn is_reached(&self) -> bool {
        StatusWord::new(self.d.get(self.key(0x6041))).target_reached()
    }

    /// Offers as soon as the hand-shake is idle.
    fn offer(&mut self, set_point: SetPoint) {
        self.shake.offer(set_point);
        for _ in 0..5_000 {
            if self.shake.is_idle() {
                return;
            }
            self.step();
        }
        panic!("not taken: {:?}", self.outcomes);
    }
}

fn to(target: i32) -> SetPoint {
    SetPoint {
        target,
        ..SetPoint::default()
    }
}

fn near(position: i32, target: i32) -> bool {
    (position - target).abs() <= 10
}

#[test]
fn single_set_points_are_accepted_and_reached() {
    let mut pair = Pair::new();
    for target in [10_000, -5_000, -5_000] {
        pair.offer(to(target));
        assert_eq!(pair.outcomes.pop(), Some(Ok(())));
        pair.run(1500);
        assert!(near(pair.position(), target), "{}", pair.position());
        assert!(pair.is_reached());
    }
    pair.offer(SetPoint {
        relative: true,
        ..to(700)
    });
    pair.run(1000);
    assert!(near(pair.position(), -4_300), "{}", pair.position());
}

/// The third waits until the drive can accept it; none is lost.
#[test]
fn set_of_set_points_stops_at_each() {
    let mut pair = Pair::new();
    let begun = pair.now;
    for target in [8_000, 16_000, 24_000] {
        pair.offer(to(target));
    }
    assert!(pair.now - begun > 100 * MS, "the third waited");
    pair.slowest = i32::MAX;
    pair.run(3000);
    assert_eq!(pair.outcomes, [Ok(()); 3]);
    assert!(near(pair.position(), 24_000), "{}", pair.position());
}

#[test]
fn change_on_set_point_passes_without_stop() {
    for (change, stops) in [(Change::InPassing, false), (Change::AfterStop, true)] {
        let mut pair = Pair::new();
        pair.offer(to(16_000));
        pair.offer(SetPoint {
            change,
            ..to(32_000)
        });
        while pair.position() < 12_000 {
            pair.step();
        }
        pair.slowest = i32::MAX;
        while pair.position() < 20_000 {
            pair.step();
        }
        assert_eq!(pair.slowest < 5_000, stops, "{change:?}: {}", pair.slowest);
        pair.run(2000);
        assert!(near(pair.position(), 32_000), "{}", pair.position());
    }
}

#[test]
fn immediate_set_point_replaces_all_others() {
    let mut pair = Pair::new();
    pair.offer(to(30_000));
    pair.offer(to(40_000));
    pair.run(100);
    pair.offer(SetPoint {
        change: Change::AtOnce,
        ..to(-2_000)
    });
    pair.run(3000);
    assert_eq!(pair.outcomes, [Ok(()); 3]);
    assert!(near(pair.position(), -2_000), "{}", pair.position());
    // And with a drive that can accept another.
    pair.offer(SetPoint {
        change: Change::AtOnce,
        ..to(5_000)
    });
    pair.run(1500);
    assert!(near(pair.position(), 5_000), "{}", pair.position());
}

#[test]
fn set_point_unanswered_or_interrupted_is_reported() {
    let mut shake = HandShake::new(10 * MS);
    shake.offer(to(1));
    let mut last = Offer::default();
    for ms in 0..=11 {
        last = shake.step(StatusWord::new(0x0637), true, ms * MS);
    }
    assert_eq!(last.outcome, Some(Err(SetPointError::NotTaken(11 * MS))));
    assert_eq!(last.bits, 0);
    assert!(SetPointError::NotTaken(MS).to_string().contains("607Dh"));
    shake.offer(to(2));
    assert_eq!(
        shake.step(StatusWord::new(0x0637), true, 20 * MS).bits,
        0x10
    );
    let left = shake.step(StatusWord::new(0x0650), false, 21 * MS);
    assert_eq!(left.outcome, Some(Err(SetPointError::Interrupted)));
    assert!(shake.is_idle());
}

/// Bit 4 is seen low between two set-points, at any rate.
#[test]
fn every_set_point_makes_an_edge() {
    let mut shake = HandShake::new(10 * MS);
    let (mut edges, mut before) = (0, false);
    for ms in 0..40 {
        if shake.is_idle() {
            shake.offer(SetPoint {
                change: Change::AtOnce,
                ..to(1)
            });
        }
        // A drive that mirrors bit 4 in bit 12.
        let status = if before { 0x1637 } else { 0x0637 };
        let high = shake.step(StatusWord::new(status), true, ms * MS).bits & 0x10 != 0;
        edges += u32::from(high && !before);
        before = high;
    }
    assert!(edges > 10, "{edges}");
}

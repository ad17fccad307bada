//! The emulated drive from the master's side: through its objects only.

mod homing;
mod modes;
mod power;

use std::time::Duration;

use super::*;
use crate::dictionary::{Address, Dictionary, Number};
use crate::{Goal, State, StatusWord, next_control_word};

const MS: Duration = Duration::from_millis(1);

/// A drive, its dictionary, and its recorded outputs.
struct Rig {
    drive: Drive,
    d: Dictionary,
    emergencies: Vec<FaultCode>,
    /// Observed states in order, without repeats.
    states: Vec<State>,
    /// New cyclic set-points are sent with every step.
    cyclic: bool,
    lost: bool,
}

impl Rig {
    fn new(config: DriveConfig) -> Self {
        let d = Dictionary::new(config.objects(0)).unwrap();
        let drive = Drive::new(config, 0, &d).unwrap();
        Self {
            drive,
            d,
            emergencies: vec![],
            states: vec![],
            cyclic: true,
            lost: false,
        }
    }

    fn quirky(quirks: Quirks) -> Self {
        Self::new(DriveConfig {
            quirks,
            ..DriveConfig::default()
        })
    }

    /// Enabled in a mode.
    fn enabled(config: DriveConfig, mode: i8) -> Self {
        let mut rig = Self::new(config);
        rig.set(0x6060, mode);
        rig.reach(Goal::OperationEnabled);
        rig
    }

    fn set<T: Number>(&mut self, index: u16, value: T) {
        self.set_sub(index, 0, value);
    }

    fn set_sub<T: Number>(&mut self, index: u16, sub: u8, value: T) {
        let key = self.d.key(Address::new(index, sub)).unwrap();
        self.d.set(key, value);
    }

    fn get<T: Number>(&self, index: u16) -> T {
        self.d.get(self.d.key(Address::new(index, 0)).unwrap())
    }

    fn word(&mut self, raw: u16) {
        self.set(0x6040, raw);
    }

    fn status(&self) -> StatusWord {
        StatusWord::new(self.get(0x6041))
    }

    fn step(&mut self) {
        let step = Step {
            dt: MS,
            set_point: self.cyclic,
            link_lost: self.lost,
        };
        let stepped = self.drive.step(&mut self.d, &step);
        self.emergencies.extend(stepped.emergency);
        let state = self.drive.state();
        if self.states.last() != Some(&state) {
            self.states.push(state);
        }
    }

    fn run(&mut self, ms: u32) {
        (0..ms).for_each(|_| self.step());
    }

    /// Brings the drive to a goal as a master does, within a second.
    fn reach(&mut self, goal: Goal) {
        for _ in 0..1000 {
            self.step();
            let state = self.drive.state();
            if goal.is_reached(state) {
                return;
            }
            self.word(next_control_word(state, goal).raw());
        }
        panic!("{goal:?} was not reached: {:?}", self.states);
    }

    /// Steps until the statusword has these bits, for at most `ms`.
    fn until(&mut self, mask: u16, value: u16, ms: u32) {
        for _ in 0..ms {
            self.step();
            if self.status().raw() & mask == value {
                return;
            }
        }
        panic!(
            "{mask:04X}h = {value:04X}h did not appear; {}",
            self.status()
        );
    }

    fn position(&self) -> i32 {
        self.get(0x6064)
    }

    fn velocity(&self) -> i32 {
        self.get(0x606C)
    }
}

#[test]
fn objects_exist_on_every_axis() {
    for axis in 0..8 {
        let config = DriveConfig::default();
        let d = Dictionary::new(config.objects(axis)).unwrap();
        assert!(Drive::new(config, axis, &d).is_ok(), "axis {axis}");
    }
    let d = Dictionary::new(DriveConfig::default().objects(0)).unwrap();
    assert!(Drive::new(DriveConfig::default(), 1, &d).is_err());
}

#[test]
fn quirks_exist_for_every_name() {
    for name in Quirks::NAMES {
        assert!(Quirks::named(name).is_some(), "{name}");
    }
    assert!(Quirks::named("none").is_none());
}

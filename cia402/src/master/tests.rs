//! The master against the emulated drive, with every quirk, and against words made by hand.

#![cfg(feature = "emulator")]

use super::*;
use crate::dictionary::{Address, Dictionary, Key, Number};
use crate::emulator::{Drive, DriveConfig, FaultCode, Quirks, Step};

struct Pair {
    master: Master,
    drive: Drive,
    d: Dictionary,
    now: Duration,
    orders: Orders,
    /// Controlwords in order, without repeats.
    sent: Vec<u16>,
    states: Vec<State>,
}

impl Pair {
    fn new(quirks: Quirks, patience: Patience) -> Self {
        let config = DriveConfig {
            quirks,
            position: 20.0,
            ..DriveConfig::default()
        };
        let d = Dictionary::new(config.objects(0)).unwrap();
        let drive = Drive::new(config, 0, &d).unwrap();
        let mut master = Master::new(patience);
        master.set_mode(8);
        let orders = Orders {
            control: ControlWord::DISABLE_VOLTAGE,
            mode: 0,
            follows: false,
            hold: 0,
        };
        Self {
            master,
            drive,
            d,
            now: Duration::ZERO,
            orders,
            sent: vec![],
            states: vec![],
        }
    }

    fn key<T: Number>(&self, index: u16) -> Key<T> {
        self.d.key(Address::new(index, 0)).unwrap()
    }

    /// A cycle of 1 ms; a drive that follows is sent `further` from where it is.
    fn step(&mut self, further: i32) {
        let dt = Duration::from_millis(1);
        self.now += dt;
        let feedback = Feedback {
            status: StatusWord::new(self.d.get(self.key(0x6041))),
            mode: Some(self.d.get(self.key(0x6061))),
            position: self.d.get(self.key(0x6064)),
        };
        self.orders = self.master.step(&feedback, self.now);
        let target = if self.orders.follows {
            self.orders.hold + further
        } else {
            self.orders.hold
        };
        self.d.set(
            self.key(0x6040),
            self.orders.control.raw() | 0x0070 & self.cyclic_bits(),
        );
        self.d.set(self.key(0x6060), self.orders.mode);
        self.d.set(self.key(0x607A), target);
        let step = Step {
            dt,
            set_point: true,
            link_lost: false,
        };
        let _ = self.drive.step(&mut self.d, &step);
        let raw = self.orders.control.raw();
        if self.sent.last() != Some(&raw) {
            self.sent.push(raw);
        }
        if self.states.last() != Some(&self.drive.state()) {
            self.states.push(self.drive.state());
        }
    }

    /// The mode's bits are the caller's; some drives want them high in cyclic modes.
    fn cyclic_bits(&self) -> u16 {
        if self.orders.control == ControlWord::ENABLE_OPERATION {
            0x0070
        } else {
            0
        }
    }

    fn run(&mut self, ms: u32) {
        (0..ms).for_each(|_| self.step(0));
    }

    fn enable(&mut self) {
        self.master.set_goal(Goal::OperationEnabled);
        for _ in 0..1000 {
            self.step(0);
            if self.orders.follows {
                return;
            }
        }
        panic!("{:?} in {}", self.master.obstacle(), self.drive.state());
    }
}

#[test]
fn every_quirky_drive_comes_up_without_moving_and_goes_down() {
    for name in Quirks::NAMES {
        let patience = Patience {
            sod_as_0020: name == "ssc-5.11",
            ..Patience::default()
        };
        let mut pair = Pair::new(Quirks::named(name).unwrap(), patience);
        pair.run(5);
        let here = pair.drive.motor().position;
        pair.enable();
        pair.run(100);
        let moved = pair.drive.motor().position - here;
        assert!(moved.abs() < 0.01, "{name}: {moved}");
        assert_eq!(pair.master.obstacle(), None, "{name}");
        pair.master.set_goal(Goal::SwitchOnDisabled);
        pair.run(5);
        assert_eq!(pair.drive.state(), State::SwitchOnDisabled, "{name}");
        assert!(!pair.orders.follows);
    }
}

#[test]
fn a_quick_stop_ends_where_its_option_says_and_is_never_undone() {
    for (option, last) in [
        (2_i16, State::SwitchOnDisabled),
        (6, State::QuickStopActive),
    ] {
        let mut pair = Pair::new(Quirks::default(), Patience::default());
        pair.d
            .set(pair.d.key(Address::new(0x605A, 0)).unwrap(), option);
        pair.enable();
        pair.run(10);
        (0..50).for_each(|_| pair.step(30));
        pair.states.clear();
        pair.master.set_goal(Goal::QuickStop);
        pair.run(500);
        assert_eq!(pair.states.last(), Some(&last));
        let stop = pair
            .states
            .iter()
            .position(|s| *s != State::OperationEnabled);
        let after = &pair.states[stop.unwrap()..];
        assert!(!after.contains(&State::OperationEnabled), "{after:?}");
        // Wanting to be enabled does not end a held stop; it says so.
        if option == 6 {
            pair.master.set_goal(Goal::OperationEnabled);
            pair.run(1500);
            assert_eq!(pair.drive.state(), State::QuickStopActive);
            assert_eq!(pair.master.obstacle(), Some(Obstacle::QuickStopHeld));
        }
    }
}

#[test]
fn a_fault_waits_for_a_reset_that_is_an_edge_and_is_given_up() {
    let mut pair = Pair::new(Quirks::default(), Patience::default());
    pair.enable();
    pair.drive.fault(FaultCode::ENCODER);
    pair.run(50);
    assert_eq!(pair.master.obstacle(), Some(Obstacle::Fault));
    pair.sent.clear();
    pair.run(50);
    assert_eq!(pair.sent, [0x0000], "no reset unasked");
    pair.sent.clear();
    pair.master.reset_fault();
    pair.run(100);
    assert_eq!(
        pair.sent,
        [0x0000, 0x0080, 0x0000, 0x0080, 0x0000, 0x0080, 0x0000]
    );
    assert_eq!(pair.master.obstacle(), Some(Obstacle::ResetRefused(3)));
    pair.drive.mend();
    pair.master.set_goal(Goal::SwitchOnDisabled);
    pair.master.reset_fault();
    pair.run(10);
    assert_eq!(pair.drive.state(), State::SwitchOnDisabled);
    assert_eq!(pair.master.obstacle(), None);
}

#[test]
fn each_obstacle_is_told_with_its_bit_or_object() {
    let mut pair = Pair::new(Quirks::default(), Patience::default());
    pair.drive.dc_link = 0.0;
    pair.master.set_goal(Goal::OperationEnabled);
    pair.run(3500);
    assert_eq!(pair.master.obstacle(), Some(Obstacle::NoVoltage));
    let mut pair = Pair::new(Quirks::default(), Patience::default());
    pair.drive.local = true;
    pair.master.set_goal(Goal::OperationEnabled);
    pair.run(1500);
    assert_eq!(pair.master.obstacle(), Some(Obstacle::NotRemote));
    pair.drive.local = false;
    pair.drive.interlock = true;
    pair.run(4500);
    let stuck = pair.master.obstacle();
    assert!(
        matches!(stuck, Some(Obstacle::Stuck { state, .. }) if state == State::SwitchOnDisabled || state == State::ReadyToSwitchOn),
        "{stuck:?}"
    );
    let inputs = pair.d.get(pair.key::<u32>(0x60FD));
    assert_eq!(inputs & 8, 8);
    let mut pair = Pair::new(Quirks::default(), Patience::default());
    pair.master.set_mode(5);
    pair.master.set_goal(Goal::OperationEnabled);
    pair.run(1500);
    let mode = Obstacle::Mode {
        wanted: 5,
        shown: 0,
    };
    assert_eq!(pair.master.obstacle(), Some(mode));
    assert_eq!(pair.drive.state(), State::SwitchedOn);
    assert!(mode.to_string().contains("6502h"), "{mode}");
}

/// Shows the same words for so long; what is the obstacle then?
fn shown(raw: u16, goal: Goal, seconds: u64) -> Option<Obstacle> {
    let mut master = Master::new(Patience::default());
    master.set_goal(goal);
    master.set_mode(8);
    for ms in 0..seconds * 1000 {
        let feedback = Feedback {
            status: StatusWord::new(raw),
            mode: Some(8),
            position: 0,
        };
        master.step(&feedback, Duration::from_millis(ms));
    }
    master.obstacle()
}

#[test]
fn words_that_do_not_change() {
    let up = Goal::OperationEnabled;
    for (raw, text) in [
        (0x0001, "shows no state"),
        (0x0040, "bit 9"),
        (0x0240, "bit 4"),
        (0x0250, "switch on disabled for"),
        (0x0231, "ready to switch on for"),
        (0x0237, "bit 12"),
        (0x0218, "603Fh"),
        (0x0217, "605Ah"),
    ] {
        let told = shown(raw, up, 4).map(|o| o.to_string()).unwrap_or_default();
        assert!(told.contains(text), "{raw:04X}h: {told}");
    }
    assert_eq!(shown(0x1237, up, 4), None);
    assert_eq!(shown(0x0250, Goal::SwitchOnDisabled, 4), None);
}

#[test]
fn no_statusword_at_all_makes_the_master_stumble() {
    for goal in [
        Goal::OperationEnabled,
        Goal::QuickStop,
        Goal::SwitchOnDisabled,
    ] {
        let mut master = Master::new(Patience::default());
        master.set_goal(goal);
        for raw in 0..=u16::MAX {
            let feedback = Feedback {
                status: StatusWord::new(raw),
                mode: None,
                position: 7,
            };
            let orders = master.step(&feedback, Duration::from_millis(raw.into()));
            assert_eq!(orders.hold, 7);
            let enabled = feedback.status.state() == Ok(State::OperationEnabled);
            assert!(!orders.follows || (enabled && goal == Goal::OperationEnabled));
            if goal != Goal::OperationEnabled {
                assert_ne!(orders.control, ControlWord::ENABLE_OPERATION, "{raw:04X}h");
            }
        }
    }
}

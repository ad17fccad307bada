//! The master against the emulated drive, with every quirk, and against hand-made statuswords.

#![cfg(feature = "emulator")]

use super::*;
use crate::dictionary::{Address, Dictionary, Key, Number};
use crate::emulator::{Drive, DriveConfig, FaultCode, Quirks, Step};

struct Pair {
    master: Master,
    drive: Drive,
    d: Dictionary,
    now: Duration,
    drive_command: DriveCommand,
    /// Controlwords in order, without repeats.
    sent: Vec<u16>,
    states: Vec<State>,
}

impl Pair {
    fn new(quirks: Quirks, options: MasterOptions) -> Self {
        let config = DriveConfig {
            quirks,
            position: 20.0,
            ..DriveConfig::default()
        };
        let d = Dictionary::new(config.objects(0)).unwrap();
        let drive = Drive::new(config, 0, &d).unwrap();
        let mut master = Master::new(options);
        master.set_mode(8);
        let drive_command = DriveCommand {
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
            drive_command,
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
        self.drive_command = self.master.step(&feedback, self.now);
        let target = if self.drive_command.follows {
            self.drive_command.hold + further
        } else {
            self.drive_command.hold
        };
        self.d.set(
            self.key(0x6040),
            self.drive_command.control.raw() | 0x0070 & self.cyclic_bits(),
        );
        self.d.set(self.key(0x6060), self.drive_command.mode);
        self.d.set(self.key(0x607A), target);
        let step = Step {
            dt,
            set_point: true,
            link_lost: false,
        };
        let _ = self.drive.step(&mut self.d, &step);
        let raw = self.drive_command.control.raw();
        if self.sent.last() != Some(&raw) {
            self.sent.push(raw);
        }
        if self.states.last() != Some(&self.drive.state()) {
            self.states.push(self.drive.state());
        }
    }

    /// The mode's bits are the caller's; some drives want them high in cyclic modes.
    fn cyclic_bits(&self) -> u16 {
        if self.drive_command.control == ControlWord::ENABLE_OPERATION {
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
            if self.drive_command.follows {
                return;
            }
        }
        panic!("{:?} in {}", self.master.drive_fault(), self.drive.state());
    }
}

#[test]
fn quirky_drives_enable_without_motion_and_disable() {
    for name in Quirks::NAMES {
        let options = MasterOptions {
            sod_as_0020: name == "ssc-5.11",
            ..MasterOptions::default()
        };
        let mut pair = Pair::new(Quirks::named(name).unwrap(), options);
        pair.run(5);
        let here = pair.drive.motor().position;
        pair.enable();
        pair.run(100);
        let moved = pair.drive.motor().position - here;
        assert!(moved.abs() < 0.01, "{name}: {moved}");
        assert_eq!(pair.master.drive_fault(), None, "{name}");
        pair.master.set_goal(Goal::SwitchOnDisabled);
        pair.run(5);
        assert_eq!(pair.drive.state(), State::SwitchOnDisabled, "{name}");
        assert!(!pair.drive_command.follows);
    }
}

#[test]
fn quick_stop_ends_as_its_option_code_says() {
    for (option, last) in [
        (2_i16, State::SwitchOnDisabled),
        (6, State::QuickStopActive),
    ] {
        let mut pair = Pair::new(Quirks::default(), MasterOptions::default());
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
        // The goal of being enabled does not end a held stop; it is reported.
        if option == 6 {
            pair.master.set_goal(Goal::OperationEnabled);
            pair.run(1500);
            assert_eq!(pair.drive.state(), State::QuickStopActive);
            assert_eq!(pair.master.drive_fault(), Some(DriveFault::QuickStopHeld));
        }
    }
}

#[test]
fn fault_reset_is_an_edge_with_bounded_tries() {
    let mut pair = Pair::new(Quirks::default(), MasterOptions::default());
    pair.enable();
    pair.drive.fault(FaultCode::ENCODER);
    pair.run(50);
    assert_eq!(pair.master.drive_fault(), Some(DriveFault::Fault));
    pair.sent.clear();
    pair.run(50);
    assert_eq!(pair.sent, [0x0000], "no reset without a request");
    pair.sent.clear();
    pair.master.reset_fault();
    pair.run(100);
    assert_eq!(
        pair.sent,
        [0x0000, 0x0080, 0x0000, 0x0080, 0x0000, 0x0080, 0x0000]
    );
    assert_eq!(pair.master.drive_fault(), Some(DriveFault::ResetRefused(3)));
    pair.drive.clear_cause();
    pair.master.set_goal(Goal::SwitchOnDisabled);
    pair.master.reset_fault();
    pair.run(10);
    assert_eq!(pair.drive.state(), State::SwitchOnDisabled);
    assert_eq!(pair.master.drive_fault(), None);
}

#[test]
fn drive_fault_text_names_its_bit_or_object() {
    let mut pair = Pair::new(Quirks::default(), MasterOptions::default());
    pair.drive.dc_link = 0.0;
    pair.master.set_goal(Goal::OperationEnabled);
    pair.run(3500);
    assert_eq!(pair.master.drive_fault(), Some(DriveFault::NoVoltage));
    let mut pair = Pair::new(Quirks::default(), MasterOptions::default());
    pair.drive.local = true;
    pair.master.set_goal(Goal::OperationEnabled);
    pair.run(1500);
    assert_eq!(pair.master.drive_fault(), Some(DriveFault::NotRemote));
    pair.drive.local = false;
    pair.drive.interlock = true;
    pair.run(4500);
    let stuck = pair.master.drive_fault();
    assert!(
        matches!(stuck, Some(DriveFault::Stuck { state, .. }) if state == State::SwitchOnDisabled || state == State::ReadyToSwitchOn),
        "{stuck:?}"
    );
    let inputs = pair.d.get(pair.key::<u32>(0x60FD));
    assert_eq!(inputs & 8, 8);
    let mut pair = Pair::new(Quirks::default(), MasterOptions::default());
    pair.master.set_mode(5);
    pair.master.set_goal(Goal::OperationEnabled);
    pair.run(1500);
    let mode = DriveFault::Mode {
        wanted: 5,
        shown: 0,
    };
    assert_eq!(pair.master.drive_fault(), Some(mode));
    assert_eq!(pair.drive.state(), State::SwitchedOn);
    assert!(mode.to_string().contains("6502h"), "{mode}");
}

/// Shows the same statusword for a time; returns the fault.
fn shown(raw: u16, goal: Goal, seconds: u64) -> Option<DriveFault> {
    let mut master = Master::new(MasterOptions::default());
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
    master.drive_fault()
}

#[test]
fn statuswords_that_never_change_report_their_fault() {
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
        let message = shown(raw, up, 4).map(|o| o.to_string()).unwrap_or_default();
        assert!(message.contains(text), "{raw:04X}h: {message}");
    }
    assert_eq!(shown(0x1237, up, 4), None);
    assert_eq!(shown(0x0250, Goal::SwitchOnDisabled, 4), None);
}

#[test]
fn master_handles_every_statusword() {
    for goal in [
        Goal::OperationEnabled,
        Goal::QuickStop,
        Goal::SwitchOnDisabled,
    ] {
        let mut master = Master::new(MasterOptions::default());
        master.set_goal(goal);
        for raw in 0..=u16::MAX {
            let feedback = Feedback {
                status: StatusWord::new(raw),
                mode: None,
                position: 7,
            };
            let drive_command = master.step(&feedback, Duration::from_millis(raw.into()));
            assert_eq!(drive_command.hold, 7);
            let enabled = feedback.status.state() == Ok(State::OperationEnabled);
            assert!(!drive_command.follows || (enabled && goal == Goal::OperationEnabled));
            if goal != Goal::OperationEnabled {
                assert_ne!(
                    drive_command.control,
                    ControlWord::ENABLE_OPERATION,
                    "{raw:04X}h"
                );
            }
        }
    }
}

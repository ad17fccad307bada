//! Power only when the process data are proven: drives on the emulated segment that do not use the mapping they
//! acknowledged, or cannot be read.

use takt_cia402::emulator::{Distortion, Drive};
use takt_cia402::proof::ProofFault;

use super::*;

/// All orders of so many.
fn orders(of: usize) -> Vec<Vec<usize>> {
    let mut all = vec![vec![]];
    for _ in 0..of {
        all = all
            .iter()
            .flat_map(|order: &Vec<usize>| {
                let rest = (0..of).filter(|n| !order.contains(n));
                rest.map(|n| [order.as_slice(), &[n]].concat())
            })
            .collect();
    }
    all
}

impl Fixture {
    /// A drive whose shaft is not at zero, where all bytes are alike.
    fn with(change: impl FnOnce(&mut Drive)) -> Self {
        let mut config = ServoConfig::default();
        config.axes[0].position = 12.34;
        let drive = ServoDrive::slave(config).unwrap();
        let fixture = Self::new(drive, 1, Duration::from_millis(1), false);
        fixture.drive.axis(0, change);
        fixture
    }

    /// Wants power until its process data are proven or refused, and for a while more; whether they are proven.
    fn prove(&mut self) -> Result<(), DriveFault> {
        self.axes[0].set_goal(Goal::OperationEnabled);
        let mut left = 3000_u32;
        while left > 0 {
            self.cycle(|_, _| Target::Hold);
            left -= 1;
            let decided =
                self.axes[0].proof().is_proven() || self.axes[0].proof().fault().is_some();
            if decided && left > 100 {
                left = 100;
            }
        }
        match self.states[0].drive_fault {
            None if self.axes[0].proof().is_proven() => Ok(()),
            drive_fault => Err(drive_fault.expect("a reason")),
        }
    }

    fn state(&self) -> State {
        self.drive.axis(0, |axis| axis.state()).unwrap()
    }

    #[track_caller]
    fn is_refused(&mut self) -> String {
        let drive_fault = self.prove().unwrap_err();
        assert!(
            matches!(drive_fault, DriveFault::NotProven(_)),
            "{drive_fault}"
        );
        assert_eq!(self.state(), State::SwitchOnDisabled, "{drive_fault}");
        assert_eq!(self.states[0].state, Some(State::SwitchOnDisabled));
        drive_fault.to_string()
    }
}

#[test]
fn drive_with_another_order_of_outputs_gets_no_power() {
    for order in orders(5) {
        let outputs = Distortion::order(order.clone());
        let mut fixture = Fixture::with(|drive| drive.process_data.outputs = outputs);
        if order == [0, 1, 2, 3, 4] {
            assert_eq!(fixture.prove(), Ok(()));
            assert_eq!(fixture.state(), State::OperationEnabled);
        } else {
            fixture.is_refused();
        }
    }
}

#[test]
fn drive_with_another_order_of_inputs_gets_no_power() {
    // The statusword, the mode and the position are what leads it.
    for swapped in [[1, 0, 2], [0, 2, 1], [2, 1, 0], [1, 2, 0], [2, 0, 1]] {
        let inputs = Distortion::order([&swapped[..], &[3, 4, 5]].concat());
        let mut fixture = Fixture::with(|drive| drive.process_data.inputs = inputs);
        let drive_fault = fixture.prove().unwrap_err();
        assert!(
            matches!(drive_fault, DriveFault::NotProven(_)),
            "{drive_fault}"
        );
        assert_eq!(fixture.state(), State::SwitchOnDisabled, "{swapped:?}");
    }
}

#[test]
fn drive_that_shifts_delays_or_freezes_gets_no_power() {
    for fault in [
        Distortion::shifted(1),
        Distortion::delayed(500),
        Distortion::frozen(),
    ] {
        let outputs = fault.clone();
        let mut fixture = Fixture::with(|drive| drive.process_data.outputs = outputs);
        let why = fixture.is_refused();
        println!("{why}");
        let mut fixture = Fixture::with(|drive| drive.process_data.inputs = fault);
        assert!(fixture.prove().is_err());
        let unpowered = [State::SwitchOnDisabled, State::ReadyToSwitchOn];
        assert!(unpowered.contains(&fixture.state()));
    }
}

#[test]
fn drive_that_is_proven_first_receives_its_own_position() {
    let mut fixture = Fixture::with(|drive| drive.motor_mut().velocity = 1.0);
    fixture.axes[0].set_goal(Goal::OperationEnabled);
    for _ in 0..4000 {
        fixture.cycle(|_, _| Target::Hold);
        if fixture.state() == State::OperationEnabled {
            break;
        }
        assert_ne!(fixture.state(), State::FaultReactionActive);
    }
    let number = |index| {
        let read = |d: &mut takt_cia402::dictionary::Dictionary| {
            let bytes = d.bytes(Address::new(index, 0)).unwrap();
            i32::from_le_bytes(*bytes.first_chunk().unwrap())
        };
        fixture.drive.dictionary(read)
    };
    let (target, actual) = (number(0x607A), number(0x6064));
    assert!((target - actual).abs() <= 4, "{target} {actual}");
    assert_eq!(fixture.state(), State::OperationEnabled);
}

#[test]
fn drive_whose_object_sdo_does_not_show_needs_a_quirk() {
    let not_mirrored = Objects::of(&[0x60FF, 0x6071]).unwrap();
    let mut fixture = Fixture::with(|drive| {
        drive.process_data.unreadable = vec![0x6071];
        drive.process_data.cleared = vec![0x60FF];
    });
    let why = fixture.is_refused();
    assert!(why.starts_with("60FFh by PDO "), "{why}");
    assert!(why.contains(", by SDO 0: the slave does not use"), "{why}");
    fixture
        .drive
        .axis(0, |drive| drive.process_data.cleared.clear());
    fixture.axes[0].set_goal(Goal::SwitchOnDisabled);
    let mut fixture = Fixture {
        axes: vec![
            fixture
                .axes
                .remove(0)
                .not_mirrored(Objects::of(&[0x60FF]).unwrap()),
        ],
        ..fixture
    };
    let why = fixture.is_refused();
    assert!(why.starts_with("6071h cannot be read by SDO"), "{why}");
    let mut fixture = Fixture {
        axes: vec![fixture.axes.remove(0).not_mirrored(not_mirrored)],
        ..fixture
    };
    assert_eq!(fixture.prove(), Ok(()));
}

#[test]
fn drive_that_comes_back_with_another_mapping_is_proven_again() {
    let mut fixture = Fixture::with(|_| ());
    fixture.enable(Target::Hold);
    fixture.rig.segment.set_link(0, false);
    for _ in 0..300 {
        fixture.cycle(|_, _| Target::Hold);
    }
    fixture.drive.axis(0, |drive| {
        drive.process_data.outputs = Distortion::order([0, 2, 1, 3, 4]);
    });
    fixture.rig.segment.set_link(0, true);
    fixture.until(6000, Target::Hold, |state| state.online);
    let drive_fault = fixture.prove().unwrap_err();
    assert!(
        matches!(
            drive_fault,
            DriveFault::NotProven(ProofFault::Differs { axis: 0, .. })
        ),
        "{drive_fault}"
    );
}

/// A master that has the objects in another order is broken off after each of its frames; then comes one with ours. A
/// drive that keeps the first mapping gets power only if the first master did not get as far as giving it one.
#[test]
fn set_up_broken_off_after_any_frame_never_leads_to_shifted_targets() {
    let config = |reversed: bool| {
        let (mut outputs, inputs) = pdos(1);
        if reversed {
            // 607Ah at offset 2, as an earlier use had it.
            outputs[0].entries.swap(1, 2);
        }
        MasterConfig {
            slaves: vec![SlaveSpec {
                outputs: Some(outputs),
                inputs: Some(inputs),
                ..SlaveSpec::new("drive", Location::Position(0))
            }],
            ..MasterConfig::default()
        }
    };
    let (mut refused, mut proven, mut frames) = (0, 0, 0);
    loop {
        frames += 1;
        let (slave, drive) = ServoDrive::slave(ServoConfig {
            keeps_mapping: true,
            ..ServoConfig::default()
        })
        .unwrap();
        let mut rig = Rig::new(config(true), Segment::line([slave]));
        rig.cycles(frames);
        let whole = rig.master.is_operational();
        rig.master = Master::new(config(false)).unwrap();
        rig.until(20_000, Master::is_operational);
        let process = rig.master.slave(0).unwrap().process().clone();
        let axis = Axis::new(0, &process, 0, MasterOptions::default()).unwrap();
        let mut fixture = Fixture {
            rig,
            drive,
            axes: vec![axis],
            states: Vec::new(),
        };
        match fixture.prove() {
            Ok(()) => proven += 1,
            Err(drive_fault) => {
                assert!(
                    matches!(drive_fault, DriveFault::NotProven(_)),
                    "{drive_fault}"
                );
                assert_eq!(fixture.state(), State::SwitchOnDisabled, "{frames}");
                refused += 1;
            }
        }
        if whole {
            break;
        }
    }
    println!("{frames} frames: {proven} proven, {refused} refused");
    assert!(proven > 10 && refused > 0, "{proven} {refused}");
}

/// How long a proof takes, by the number of axes that share a mailbox.
#[test]
fn proof_of_one_to_eight_axes_takes_less_than_a_second() {
    for count in [1, 6, 8] {
        let config = ServoConfig {
            axes: vec![takt_cia402::emulator::DriveConfig::default(); usize::from(count)],
            ..ServoConfig::default()
        };
        let drive = ServoDrive::slave(config).unwrap();
        let mut fixture = Fixture::new(drive, count, Duration::from_millis(1), false);
        fixture.enable(Target::Hold);
        let took = fixture
            .axes
            .iter()
            .filter_map(|axis| axis.proof().took())
            .max();
        println!("{count} axes of one slave, 1 ms: {took:?}");
        assert!(took.unwrap() < Duration::from_secs(1));
    }
}

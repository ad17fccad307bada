//! `takt ecat drive` on an emulated segment, in virtual time: drives enabled, jogged, stopped, with faults.

use std::cell::Cell;
use std::time::Duration;

use takt_cia402::State;
use takt_cia402::emulator::{Distortion, Drive, FaultCode};
use takt_cia402::proof::Objects;
use takt_ethercat::AlState;
use takt_ethercat::emulator::{Coupler, Segment, ServoConfig, ServoDrive};

use super::{Order, Outcome, perform};
use crate::ecat::tests::up;

/// A coupler and a drive.
fn line(config: ServoConfig) -> (Segment, ServoDrive) {
    let (slave, drive) = ServoDrive::slave(config).unwrap();
    (Segment::line([Coupler::slave(), slave]), drive)
}

fn order() -> Order {
    Order {
        slave: 1,
        axis: 0,
        cycle: Duration::from_millis(4),
        sync0: false,
        reset: false,
        hold: Duration::from_millis(500),
        jog: None,
        timeout: Duration::from_secs(10),
        profile: takt_cia402::MasterOptions::default(),
        not_mirrored: Objects::default(),
    }
}

/// The result and what was printed; stopped when a line with `stop_at` was printed.
fn done(segment: Segment, order: &Order, stop_at: Option<&str>) -> (Outcome, Vec<String>) {
    done_with(segment, order, |line, stop| {
        if stop_at.is_some_and(|text| line.contains(text)) {
            stop.set(true);
        }
    })
}

/// The same, with something that happens at a line.
fn done_with(
    segment: Segment,
    order: &Order,
    mut at: impl FnMut(&str, &Cell<bool>),
) -> (Outcome, Vec<String>) {
    let mut session = up(segment, AlState::PreOp);
    let (stop, mut lines) = (Cell::new(false), Vec::new());
    let mut print = |line: &str| {
        at(line, &stop);
        lines.push(line.to_owned());
        Ok(())
    };
    let outcome = perform(&mut session, order, &|| stop.get(), &mut print).unwrap();
    session.leave().unwrap();
    (outcome, lines)
}

#[test]
fn ecat_drive_is_enabled_step_by_step_and_switched_off() {
    let (segment, _) = line(ServoConfig::default());
    let (outcome, lines) = done(segment, &order(), None);
    assert_eq!(outcome, Outcome::Done(None), "{lines:#?}");
    let states: Vec<&str> = lines
        .iter()
        .filter_map(|line| line.split(" s  ").nth(1))
        .collect();
    let mut seen = states.clone();
    seen.dedup();
    assert_eq!(
        seen,
        [
            "switch on disabled",
            "ready to switch on",
            "switched on",
            "operation enabled",
            "switched on",
            "switch on disabled"
        ],
        "{lines:#?}"
    );
    let printed = |text: &str| lines.iter().any(|line| line.contains(text));
    assert!(
        printed("6040h 0x0006 enable-voltage+quick-stop"),
        "{lines:#?}"
    );
    assert!(printed("operation-enabled"), "{lines:#?}");
}

#[test]
fn ecat_jog_moves_by_the_increments() {
    let (segment, drive) = line(ServoConfig::default());
    let before = drive.axis(0, |axis| axis.motor().position).unwrap();
    let jog = Order {
        jog: Some((-8192, Duration::from_secs(1))),
        ..order()
    };
    let (outcome, lines) = done(segment, &jog, None);
    let Outcome::Done(Some((moved, lag))) = outcome else {
        panic!("{outcome:?} {lines:#?}");
    };
    assert!((moved + 8192).abs() <= 4, "{moved}");
    assert!(lag < 1000, "{lag}");
    let after = drive.axis(0, |axis| axis.motor().position).unwrap();
    let turned = after - before;
    assert!(
        (turned + 2.0 * std::f64::consts::TAU).abs() < 0.1,
        "{turned}"
    );
}

#[test]
fn ecat_jog_of_a_blocked_motor_fails() {
    let mut blocked = ServoConfig::default();
    blocked.axes[0].motor.coulomb = 1e6;
    let (segment, _) = line(blocked);
    let jog = Order {
        jog: Some((1000, Duration::from_secs(1))),
        ..order()
    };
    let (outcome, lines) = done(segment, &jog, None);
    let Outcome::Axis(why) = &outcome else {
        panic!("{outcome:?} {lines:#?}");
    };
    assert!(why.contains("moved by 0 increments of 1000"), "{why}");
    assert!(why.contains("\n      hint: "), "{why}");
    assert_eq!(outcome.verdict(), crate::Verdict::Failed);
}

#[test]
fn ecat_jog_above_607f_is_rejected_before_power() {
    let (segment, _) = line(ServoConfig::default());
    // 607Fh of the drive is 200,000 increments/s; the middle of the move is twice as fast as its mean.
    let fast = Order {
        jog: Some((-150_000, Duration::from_secs(1))),
        ..order()
    };
    let (outcome, lines) = done(segment, &fast, None);
    let text = outcome.to_string();
    assert_eq!(
        text,
        "FAIL  axis 0: the jog is too fast: 300000 increments/s requested, 607Fh (max profile velocity) allows 200000\n      \
         hint: give it more time (--duration 1.5s) or fewer increments"
    );
    assert_eq!(outcome.verdict(), crate::Verdict::Failed);
    assert_eq!(lines, Vec::<String>::new());
}

/// Why the jog of a drive to which something happens when it is enabled ends; it loses power before it goes far.
fn loses_power(happens: impl Fn(&mut Drive)) -> String {
    let (segment, drive) = line(ServoConfig::default());
    let jog = Order {
        jog: Some((8192, Duration::from_secs(2))),
        ..order()
    };
    let (outcome, lines) = done_with(segment, &jog, |line, _| {
        if line.contains("s  operation enabled") {
            drive.axis(0, |axis| happens(axis)).unwrap();
        }
    });
    let Outcome::Axis(why) = outcome else {
        panic!("{outcome:?} {lines:#?}");
    };
    let turned = drive.axis(0, |axis| axis.motor().position).unwrap();
    let turned = turned.abs() / std::f64::consts::TAU;
    // The allowed lag and the distance that it coasts without power.
    assert!(turned < 8.0, "{turned} turns, {why}");
    let state = drive.axis(0, |axis| axis.state()).unwrap();
    assert_ne!(state, State::OperationEnabled);
    why
}

#[test]
fn ecat_jog_with_permuted_outputs_loses_power() {
    // 607Ah takes the bytes of 60FFh, 6060h those of 607Ah.
    let why = loses_power(|axis| axis.process_data.outputs = Distortion::order([0, 1, 3, 2, 4]));
    assert!(why.contains("increments of allowed lag"), "{why}");
    let why = loses_power(|axis| axis.process_data.outputs = Distortion::order([0, 2, 1, 3, 4]));
    assert!(why.contains("no longer follows its set-points"), "{why}");
}

#[test]
fn ecat_jog_with_shifted_outputs_loses_power() {
    for shift in 1..13 {
        loses_power(|axis| axis.process_data.outputs = Distortion::shifted(shift));
    }
}

#[test]
fn ecat_jog_of_a_driven_motor_loses_power() {
    // Its load is stronger than it is, against its target.
    let why = loses_power(|axis| axis.motor_mut().external = -5.0);
    assert!(why.contains("increments of allowed lag"), "{why}");
    assert!(why.contains("\n      hint: "), "{why}");
}

#[test]
fn ecat_jog_with_frozen_outputs_loses_power() {
    let why = loses_power(|axis| axis.process_data.outputs = Distortion::frozen());
    assert!(why.contains("increments of allowed lag"), "{why}");
}

#[test]
fn ecat_jog_stopped_brakes_before_power_is_removed() {
    let (segment, drive) = line(ServoConfig::default());
    let before = drive.axis(0, |axis| axis.motor().position).unwrap();
    let jog = Order {
        jog: Some((40_960, Duration::from_secs(2))),
        ..order()
    };
    let (outcome, lines) = done(segment, &jog, Some("s  position"));
    assert_eq!(outcome, Outcome::Stopped, "{lines:#?}");
    assert!(
        lines.iter().any(|line| line.ends_with("braking")),
        "{lines:#?}"
    );
    let (after, speed) = drive
        .axis(0, |axis| (axis.motor().position, axis.motor().velocity))
        .unwrap();
    let turns = (after - before) / std::f64::consts::TAU;
    assert!((0.1..9.0).contains(&turns), "{turns}");
    assert!(speed.abs() < 0.01, "{speed}");
}

#[test]
fn ecat_drive_with_a_stale_mapping_gets_no_power() {
    let (segment, drive) = line(ServoConfig::default());
    drive
        .axis(0, |axis| {
            axis.process_data.outputs = Distortion::order([0, 2, 1, 3, 4]);
        })
        .unwrap();
    let (outcome, lines) = done(segment, &order(), None);
    let text = outcome.to_string();
    assert!(
        text.starts_with("FAIL  axis 0: 6060h by PDO 8, by SDO "),
        "{text}"
    );
    assert!(
        text.contains(": the slave does not use the mapping it acknowledged"),
        "{text}"
    );
    assert!(text.contains("hint: power-cycle it"), "{text}");
    let enabled = lines.iter().any(|line| line.contains("switched on"));
    assert!(!enabled, "{lines:#?}");
}

#[test]
fn ecat_drive_with_an_unreadable_object_needs_the_option() {
    let unreadable = |segment, asked: &Order| done(segment, asked, None);
    let deaf = || {
        let (segment, drive) = line(ServoConfig::default());
        drive.axis(0, |axis| axis.process_data.unreadable = vec![0x6071]);
        segment
    };
    let (outcome, _) = unreadable(deaf(), &order());
    let text = outcome.to_string();
    assert!(text.contains("6071h cannot be read by SDO"), "{text}");
    let trusting = Order {
        not_mirrored: Objects::of(&[0x6071]).unwrap(),
        ..order()
    };
    let (outcome, lines) = unreadable(deaf(), &trusting);
    assert_eq!(outcome, Outcome::Done(None), "{lines:#?}");
    let proven = |line: &&String| line.contains("but for 6071h, taken on trust");
    assert_eq!(lines.iter().filter(proven).count(), 1, "{lines:#?}");
}

#[test]
fn ecat_drive_fault_is_explained_and_reset() {
    let (segment, drive) = line(ServoConfig::default());
    drive.axis(0, |axis| axis.fault(FaultCode(0x2310))).unwrap();
    let (outcome, _) = done(segment, &order(), None);
    let Outcome::Axis(why) = outcome else {
        panic!("{outcome:?}");
    };
    assert!(why.contains("the drive is in fault"), "{why}");
    assert!(why.contains("603Fh is 2310h"), "{why}");

    let (segment, drive) = line(ServoConfig::default());
    drive.axis(0, |axis| axis.fault(FaultCode(0x2310))).unwrap();
    drive.axis(0, |axis| axis.clear_cause()).unwrap();
    let reset = Order {
        reset: true,
        ..order()
    };
    let (outcome, lines) = done(segment, &reset, None);
    assert_eq!(outcome, Outcome::Done(None), "{lines:#?}");
}

#[test]
fn ecat_drive_that_needs_sync0_reports_it() {
    let (segment, _) = line(ServoConfig::tx90());
    let (outcome, _) = done(segment, &order(), None);
    let Outcome::Slave(why) = outcome else {
        panic!("{outcome:?}");
    };
    assert!(why.contains("--sync0"), "{why}");
    let (segment, _) = line(ServoConfig::tx90());
    let sync = Order {
        sync0: true,
        axis: 5,
        jog: Some((1000, Duration::from_secs(1))),
        ..order()
    };
    let (outcome, lines) = done(segment, &sync, None);
    assert!(
        matches!(outcome, Outcome::Done(Some((990..=1010, _)))),
        "{outcome:?} {lines:#?}"
    );
}

#[test]
fn ecat_slave_without_the_axis_is_reported() {
    for (slave, axis, why) in [
        (0, 0, "has no statusword (6041h)"),
        (
            1,
            1,
            "slave 1 has 1 axes, counted from 0; there is no axis 1",
        ),
    ] {
        let (segment, _) = line(ServoConfig::default());
        let asked = Order {
            slave,
            axis,
            ..order()
        };
        let (outcome, _) = done(segment, &asked, None);
        let text = outcome.to_string();
        assert!(text.contains(why), "{text}");
    }
}

#[test]
fn ecat_drive_without_bit_12_needs_its_quirk() {
    let mut config = ServoConfig::default();
    config.axes[0].quirks.no_follow_bit = true;
    let (segment, _) = line(config.clone());
    let (outcome, lines) = done(segment, &order(), None);
    let Outcome::Axis(why) = outcome else {
        panic!("{outcome:?}, {lines:#?}");
    };
    assert!(why.contains("quirk no_follow_bit"), "{why}");
    let (segment, _) = line(config);
    let quirky = Order {
        profile: takt_cia402::MasterOptions::default()
            .with_quirks(&[takt_cia402::Quirk::NoFollowBit]),
        ..order()
    };
    let (outcome, lines) = done(segment, &quirky, None);
    assert!(
        matches!(outcome, Outcome::Done(_)),
        "{outcome:?}, {lines:#?}"
    );
}

/// A fault between Operation enabled and the end.
#[test]
fn ecat_drive_fault_at_shutdown_fails() {
    let (segment, drive) = line(ServoConfig::default());
    let was_enabled = Cell::new(false);
    let (outcome, lines) = done_with(segment, &order(), |line, _| {
        was_enabled.set(was_enabled.get() || line.contains("s  operation enabled"));
        if was_enabled.get() && line.ends_with("s  switched on") {
            drive.axis(0, |axis| axis.fault(FaultCode::ENCODER));
        }
    });
    let Outcome::Axis(why) = &outcome else {
        panic!("{outcome:?} {lines:#?}");
    };
    assert!(
        why.contains("in fault") && why.contains("incremental encoder 1"),
        "{why}"
    );
    assert!(outcome.is_failure());
}

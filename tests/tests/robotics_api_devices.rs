//! Programs that use the devices of a cell besides arms: inputs and outputs, grippers, mobile bases.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

mod robotics;

use std::collections::BTreeMap;
use std::time::Duration;

use robotics::Bench;
use takt_api::{Cell, Error, ErrorKind, Number, Outcome, Pose};
use takt_tests::steady;

/// Devices by name and kind, with their parameters.
type Devices<'d> = &'d [(&'d str, &'d str, &'d [(&'d str, &'d str)])];

fn bench(devices: Devices<'_>) -> (Bench, Cell) {
    let bench = Bench::start();
    for (name, kind, parameters) in devices {
        let owned = |(key, value): &(&str, &str)| ((*key).to_owned(), (*value).to_owned());
        let parameters: BTreeMap<_, _> = parameters.iter().map(owned).collect();
        bench
            .controller
            .add_device(name, kind, &parameters)
            .unwrap();
    }
    let cell = bench.cell();
    (bench, cell)
}

#[test]
fn outputs_are_set_and_inputs_follow() {
    steady(|| {
        let (bench, cell) = bench(&[("plant", "io_sim", &[])]);
        let plant = cell.io("plant").unwrap();
        assert_eq!(plant.set(3, true).run(), Ok(Outcome::Completed));
        assert!(cell.holds(&plant.output(3).unwrap()).unwrap());
        // Inputs of the simulated device are connected with its outputs.
        let input = plant.input(3).unwrap();
        assert!(cell.holds(&input).unwrap());
        assert_eq!(plant.set(3, false).run(), Ok(Outcome::Completed));
        assert!(!cell.holds(&input).unwrap());
        assert_eq!(plant.set_analogue(1, -2.5).run(), Ok(Outcome::Completed));
        let value = cell.value(&plant.analogue_input(1).unwrap()).unwrap();
        assert_eq!(value, Some(-2.5));
        let value = cell.value(&plant.analogue_output(1).unwrap()).unwrap();
        assert_eq!(value, Some(-2.5));
        cell.close().unwrap();
        assert_eq!(bench.nets(), 0);
    });
}

#[test]
fn pulse_ends_by_time_cancel_and_close() {
    steady(|| {
        let (bench, cell) = bench(&[("plant", "io_sim", &[])]);
        let plant = cell.io("plant").unwrap();
        let (output, other) = (plant.output(0).unwrap(), plant.output(1).unwrap());
        let short = Duration::from_millis(200);
        let pulse = plant.pulse(0, true, short).begin().unwrap();
        // It has begun; the device has the output one cycle later.
        while !cell.holds(&output).unwrap() {
            assert_eq!(pulse.outcome(), None);
        }
        // Another output does not wait for it.
        assert_eq!(plant.set(1, true).run(), Ok(Outcome::Completed));
        assert_eq!(pulse.wait(), Ok(Outcome::Completed));
        assert!(!cell.holds(&output).unwrap());
        assert!(cell.holds(&other).unwrap());
        let long = Duration::from_secs(600);
        let pulse = plant.pulse(0, true, long).begin().unwrap();
        pulse.cancel();
        assert_eq!(pulse.wait(), Ok(Outcome::Cancelled));
        assert!(!cell.holds(&output).unwrap());
        let _ = plant.pulse(0, true, long).begin().unwrap();
        cell.close().unwrap();
        let cell = bench.cell();
        assert!(!cell.holds(&output).unwrap());
        assert_eq!(bench.nets(), 0);
    });
}

#[test]
fn unknown_port_or_device_is_named() {
    steady(|| {
        let (_bench, cell) = bench(&[
            ("plant", "io_sim", &[("reals", "1")]),
            ("platform", "kuka_youbot_base_sim", &[]),
        ]);
        let plant = cell.io("plant").unwrap();
        let errors = [
            plant.input(8).unwrap_err(),
            plant.output(8).unwrap_err(),
            plant.analogue_input(1).unwrap_err(),
            plant.set(8, true).run().unwrap_err(),
            plant.set_analogue(1, 0.0).run().unwrap_err(),
        ];
        for error in errors {
            assert!(matches!(error.kind, ErrorKind::NoPort { .. }), "{error}");
            let text = error.to_string();
            assert!(
                text.contains("8 digital outputs, 1 analogue input,"),
                "{text}"
            );
        }
        let error = cell.io("platform").unwrap_err();
        assert!(matches!(error.kind, ErrorKind::NoDevice { .. }), "{error}");
        assert!(
            error
                .to_string()
                .contains("the controller has left, plant, right"),
            "{error}"
        );
    });
}

#[test]
fn fingers_open_close_and_stop() {
    steady(|| {
        let (bench, cell) = bench(&[("hand", "kuka_youbot_gripper_sim", &[])]);
        let hand = cell.gripper("hand").unwrap();
        let width = || cell.value(&hand.width()).unwrap().unwrap();
        assert_eq!(hand.open().run(), Ok(Outcome::Completed));
        assert!((width() - 0.023).abs() < 1e-6, "{}", width());
        assert_eq!(hand.move_to(0.02).run(), Ok(Outcome::Completed));
        assert!((width() - 0.02).abs() < 1e-6, "{}", width());
        let closing = hand.close().begin().unwrap();
        hand.cancel();
        assert_eq!(closing.wait(), Ok(Outcome::Cancelled));
        assert!(width() > 0.001, "{}", width());
        let late = hand
            .clone()
            .with_timeout(Duration::from_millis(50))
            .close()
            .run();
        let Err(ErrorKind::DeviceFailed { device, cause }) =
            late.clone().map_err(|error| error.kind)
        else {
            panic!("{late:?}");
        };
        assert_eq!(device, "hand");
        assert!(cause.contains("after 0.05 s\nhint:"), "{cause}");
        for error in [
            hand.move_to(0.03).run().unwrap_err(),
            hand.grasp(0.01, 20.0).run().unwrap_err(),
            hand.force().unwrap_err(),
            hand.holds().unwrap_err(),
        ] {
            assert!(matches!(error.kind, ErrorKind::Invalid(_)), "{error}");
        }
        assert!(matches!(
            cell.gripper("left").unwrap_err().kind,
            ErrorKind::NoDevice { .. }
        ));
        cell.close().unwrap();
        assert_eq!(bench.nets(), 0);
    });
}

#[test]
fn servo_gripper_grips_a_part_with_a_force() {
    steady(|| {
        let devices: Devices<'_> = &[
            ("full", "schunk_wsg_sim", &[("part", "0.05")]),
            ("empty", "schunk_wsg_sim", &[]),
        ];
        let (bench, cell) = bench(devices);
        let full = cell.gripper("full").unwrap();
        let number = |number: &Number| cell.value(number).unwrap().unwrap();
        assert_eq!(full.grasp(0.05, 30.0).run(), Ok(Outcome::Completed));
        assert!((number(&full.force().unwrap()) - 30.0).abs() < 1e-6);
        assert!((number(&full.width()) - 0.05).abs() < 1e-3);
        assert!(cell.holds(&full.holds().unwrap()).unwrap());
        assert_eq!(full.move_to(0.1).run(), Ok(Outcome::Completed));
        assert!(!cell.holds(&full.holds().unwrap()).unwrap());
        let cause = |outcome: Result<Outcome, Error>| match outcome.map_err(|error| error.kind) {
            Err(ErrorKind::DeviceFailed { cause, .. }) => cause,
            other => panic!("{other:?}"),
        };
        let blocked = cause(full.close().run());
        assert!(blocked.contains("blocked"), "{blocked}");
        assert_eq!(full.open().run(), Ok(Outcome::Completed));
        let empty = cell.gripper("empty").unwrap();
        let nothing = cause(empty.grasp(0.05, 30.0).run());
        assert!(nothing.contains("no part"), "{nothing}");
        let beyond = cause(empty.move_to(0.5).run());
        assert!(beyond.contains("out of its range"), "{beyond}");
        assert_eq!(
            empty.clone().with_speed(0.5).close().run(),
            Ok(Outcome::Completed)
        );
        cell.close().unwrap();
        assert_eq!(bench.nets(), 0);
    });
}

/// Fails if a device was limited.
fn is_not_limited(bench: &Bench, device: &str) {
    let limited = bench.controller.limited(device);
    assert!(!limited.is_empty());
    for info in limited {
        assert_eq!(info.limited.onsets, 0, "{device}: {info:?}");
    }
}

#[test]
fn base_moves_to_a_pose_and_rests() {
    steady(|| {
        let (bench, cell) = bench(&[("platform", "kuka_youbot_base_sim", &[])]);
        let platform = cell.base("platform").unwrap();
        let to = Pose::xyz(0.3, -0.2, 0.0).abc(0.5, 0.0, 0.0);
        assert_eq!(platform.go_to(to).run(), Ok(Outcome::Completed));
        let at = platform.pose().unwrap();
        let rest = (to.inverse() * at).isometry().to_owned();
        assert!(rest.translation.vector.norm() < 0.015, "{at:?}");
        assert!(rest.rotation.angle() < 0.011, "{at:?}");
        let away = platform.go_to(Pose::xyz(5.0, 0.0, 0.0)).begin().unwrap();
        std::thread::sleep(Duration::from_millis(300));
        platform.cancel();
        assert_eq!(away.wait(), Ok(Outcome::Cancelled));
        let at = platform.pose().unwrap().position();
        std::thread::sleep(Duration::from_millis(100));
        let after = platform.pose().unwrap().position();
        assert!((at[0] - after[0]).abs() < 1e-3, "{at:?} {after:?}");
        is_not_limited(&bench, "platform");
        cell.close().unwrap();
        assert_eq!(bench.nets(), 0);
    });
}

#[test]
fn base_drives_until_its_time_is_over() {
    steady(|| {
        let (bench, cell) = bench(&[("platform", "kuka_youbot_base_sim", &[])]);
        let platform = cell.base("platform").unwrap();
        assert_eq!(platform.limits(), (0.8, 0.8));
        let short = Duration::from_millis(300);
        let first = platform.drive([0.2, 0.0, 0.0], short).begin().unwrap();
        // Renewed before it ends.
        let next = platform
            .drive([0.2, 0.0, 0.0], short)
            .now()
            .begin()
            .unwrap();
        assert!(first.wait().is_ok());
        assert_eq!(next.wait(), Ok(Outcome::Completed));
        let [x, ..] = platform.pose().unwrap().position();
        assert!((0.03..0.2).contains(&x), "{x}");
        is_not_limited(&bench, "platform");
        let error = platform.drive([0.9, 0.0, 0.0], short).run().unwrap_err();
        assert!(error.to_string().contains("at most 0.8 m/s"), "{error}");
        assert!(matches!(
            cell.base("left").unwrap_err().kind,
            ErrorKind::NoDevice { .. }
        ));
        cell.close().unwrap();
        assert_eq!(bench.nets(), 0);
    });
}

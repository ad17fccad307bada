//! Devices of an emulated segment whose master stalls until watchdogs trip, in virtual time: which of them follow
//! again by themselves and which do not, and that nothing moves before a net requests it.

use takt_ethercat::emulator::{Segment, ServoConfig, ServoDrive, YouBot, YouBotConfig};

use super::wire_tests::{Bench, YOUBOT, config};
use takt_core::device::{DeviceState, DeviceStatus};
use takt_device_drives::Recovery;

/// The state of a device of the bench.
fn state<T>(bench: &mut Bench, device: usize, read: impl FnOnce(&DeviceState) -> T) -> T {
    bench.devices[device].state.read_with(read)
}

/// Runs until a device is or is not operational, so many cycles at most.
fn runs_until(bench: &mut Bench, device: usize, operational: bool, cycles: u32) -> bool {
    (0..cycles).any(|_| {
        bench.cycle();
        let is = state(bench, device, |state| state.status) == DeviceStatus::Operational;
        is == operational
    })
}

/// Stands still for 150 ms three times, while the first joint of the device that is watched moves.
fn stands_still(mut bench: Bench, devices: &[usize], recovery: Recovery, what: &str) {
    for stall in 1..=3_u32 {
        let has_joints = state(&mut bench, devices[0], |state| {
            state.joints[0].commanded_position.is_some()
        });
        if has_joints {
            let start = bench.position(0);
            for n in 0..100_u32 {
                bench.want(0, start + f64::from(n) * 2e-4, 1);
                bench.cycle();
            }
        }
        let cycle_ms = u64::try_from(bench.cycle.0 / 1_000_000).unwrap();
        bench.stand_still(150 / cycle_ms);
        for device in devices {
            let tripped = runs_until(&mut bench, *device, false, 500);
            assert!(tripped || stall > 1, "{what}, device {device}: no fault");
        }
        // The net that commanded it ends with its fault.
        for seen in &mut bench.devices {
            seen.given.joints[0].advance(None);
        }
        for device in devices {
            let is_back = runs_until(&mut bench, *device, true, 2_000);
            let expected = recovery == Recovery::Automatic;
            assert_eq!(
                is_back, expected,
                "{what}, device {device}, stall {stall}: {recovery:?}"
            );
        }
        if recovery == Recovery::OnRestart {
            return;
        }
        for device in devices {
            let faults = state(&mut bench, *device, |state| state.faults);
            assert_eq!(faults, u64::from(stall), "{what}, device {device}");
        }
        if has_joints {
            let rests = bench.position(0);
            (0..200).for_each(|_| bench.cycle());
            let moved = (bench.position(0) - rests).abs();
            assert!(moved < 1e-3, "{what}: moved by {moved} rad, unasked");
        }
    }
}

#[test]
fn cia402_arm_after_watchdog_trip_follows_as_configured() {
    for (recovery, word) in [
        (Recovery::Automatic, "automatic"),
        (Recovery::OnRestart, "on_restart"),
    ] {
        let text = format!(
            "cycle = '2ms'\n\
             [[ethercat.slave]]\nname = 'drive'\nposition = 0\naxes = 1\n\
             [[ethercat.arm]]\nname = 'arm'\nrecovery = '{word}'\n\
             [[ethercat.arm.joint]]\nslave = 'drive'\nincrements_per_turn = 409600.0\nrange = [-170.0, 170.0]\n\
             velocity_max = 100.0\nacceleration_max = 230.0\n"
        );
        let mut servo = ServoConfig::default();
        let axis = &mut servo.axes[0];
        axis.quirks.missing_set_points = None;
        (axis.motor.negative_limit, axis.motor.positive_limit) = (-1e3, 1e3);
        axis.motor.stops = (-2e3, 2e3);
        let (slave, _drive) = ServoDrive::slave(servo).unwrap();
        let bench = Bench::new(&config(&text), Segment::line([slave]), 0);
        stands_still(bench, &[0], recovery, "arm of CiA 402 drives");
    }
}

#[test]
fn youbot_after_watchdog_trip_follows_as_configured() {
    for (recovery, word) in [
        (Recovery::Automatic, "automatic"),
        (Recovery::OnRestart, "on_restart"),
    ] {
        let text = YOUBOT
            .replace(
                "name = 'base'\n",
                &format!("name = 'base'\nrecovery = '{word}'\n"),
            )
            .replace(
                "name = 'arm'\n",
                &format!("name = 'arm'\nrecovery = '{word}'\ngripper = 'hand'\n"),
            );
        let config = config(&text);
        let held: &[&str] = match recovery {
            Recovery::Automatic => &[],
            Recovery::OnRestart => &["base", "arm", "hand"],
        };
        assert_eq!(config.on_restart(), held);
        let (segment, _bot) = YouBot::segment(&YouBotConfig::default());
        // The arm is homed last.
        let mut bench = Bench::new(&config, segment, 1);
        assert!(runs_until(&mut bench, 2, true, 10_000), "the gripper");
        // Arm first, whose joints are moved. The gripper, led by its drive's mailbox, lives through it.
        stands_still(bench, &[1, 0], recovery, "youBot");
    }
}

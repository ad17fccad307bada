//! `takt can drive` against emulated drives, each with what can be wrong with it.

mod end;
mod jog;

use std::time::Duration;

use takt_can::Frame;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::canopen::sdo::{Initiate, Request, Response};
use takt_can::canopen::{Message, NmtCommand, RPDO1};
use takt_cia402::dictionary::{AbortCode, Address};
use takt_cia402::emulator::{Drive as Axis, DriveConfig, FaultCode, MotorConfig, Quirks};
use takt_cia402::{Goal, State, next_control_word};

use super::diagnosis::Cause;
use super::session::{Jog, Plan, Report, Session};
use crate::can::lab::{Device, Lab, drive, node};
use crate::can::sdo_client::{SdoClient, TIMEOUT};
use crate::can::wire::Wire;

fn plan() -> Plan {
    Plan {
        node: node(5),
        axis: 0,
        mode: 3,
        reset: false,
        hold: Duration::from_millis(200),
        jog: None,
        timeout: TIMEOUT,
        profile: takt_cia402::MasterOptions::default(),
    }
}

fn jog(velocity: i32, ms: u64) -> Plan {
    let time = Duration::from_millis(ms);
    Plan {
        jog: Some(Jog {
            velocity,
            time,
            unguarded: false,
        }),
        ..plan()
    }
}

fn lab() -> Lab {
    lab_with(DriveConfig::default())
}

fn lab_with(axis: DriveConfig) -> Lab {
    let mut lab = Lab::new();
    lab.add_drive(DriveNodeConfig {
        axes: vec![axis],
        ..DriveNodeConfig::new(node(5))
    });
    lab.run(20);
    lab
}

fn axis(devices: &mut [Device]) -> &mut Axis {
    let drives = drive(devices, 0).application_mut();
    drives.axis_mut(0).unwrap()
}

fn run(lab: &mut Lab, plan: Plan) -> Report {
    Session::new(lab, plan, &mut |_| Ok(())).run().unwrap()
}

/// The cause and the text of a diagnosis; afterwards the drive is without power and at rest.
fn diagnosed(lab: &mut Lab, plan: Plan) -> (Cause, String) {
    let report = run(lab, plan);
    let text = super::text::verdict(&report);
    let diagnosis = report.diagnosis.expect("a diagnosis");
    lab.run(3000);
    if let Device::Drive(drive) = &mut lab.devices[0] {
        let axis = drive.application_mut().axis_mut(0).unwrap();
        assert!(axis.motor().velocity.abs() < 0.1, "it turns: {text}");
        assert_ne!(axis.state(), State::OperationEnabled, "{text}");
    }
    (diagnosis.cause, text)
}

fn states(report: &Report) -> Vec<State> {
    let mut states: Vec<State> = report
        .steps
        .iter()
        .filter_map(|s| s.status.state().ok())
        .collect();
    states.dedup();
    states
}

#[test]
fn can_drive_is_enabled_state_by_state_and_switched_off() {
    let mut lab = lab();
    let report = run(&mut lab, plan());
    assert_eq!(report.diagnosis, None);
    assert_eq!(
        states(&report),
        [
            State::SwitchOnDisabled,
            State::ReadyToSwitchOn,
            State::SwitchedOn,
            State::OperationEnabled,
            State::SwitchedOn,
            State::SwitchOnDisabled
        ]
    );
    assert!(super::text::verdict(&report).contains("ok, enabled and switched off"));
    let json = super::text::json(&report);
    assert_eq!(
        (&json["enabled"], &json["diagnosis"]),
        (&true.into(), &serde_json::Value::Null)
    );
    // As it was: no heartbeat is monitored, and nothing counts as a fault.
    lab.run(2000);
    let drive = lab.drive(0);
    assert_eq!(drive.state(), takt_can::canopen::nmt::State::Operational);
    assert_eq!(
        drive.dictionary().bytes(Address::new(0x1016, 1)),
        Some(&[0; 4][..])
    );
    assert_eq!(axis(&mut lab.devices).state(), State::SwitchOnDisabled);
}

#[test]
fn can_drive_step_shows_words_with_their_bits() {
    let mut lab = lab();
    let report = run(&mut lab, plan());
    let texts: Vec<String> = report.steps.iter().map(super::text::step).collect();
    let enabled = texts
        .iter()
        .find(|text| text.contains("s  operation enabled"))
        .unwrap();
    assert!(enabled.contains("6041h 0x"), "{enabled}");
    assert!(enabled.contains("+operation-enabled+"), "{enabled}");
    assert!(
        enabled.contains("6040h 0x000f switch-on+enable-voltage+quick-stop+enable-operation"),
        "{enabled}"
    );
}

#[test]
fn can_drive_with_any_quirk_is_enabled() {
    for name in Quirks::NAMES.into_iter().filter(|name| *name != "ssc-5.11") {
        let quirks = Quirks::named(name).unwrap();
        let mut lab = lab_with(DriveConfig {
            quirks,
            ..DriveConfig::default()
        });
        let report = run(&mut lab, plan());
        assert_eq!(report.diagnosis, None, "{name}");
        assert!(report.was_enabled(), "{name}");
    }
}

#[test]
fn can_drive_axis_of_several_moves_alone() {
    let mut lab = Lab::new();
    lab.add_drive(DriveNodeConfig {
        axes: vec![DriveConfig::default(); 3],
        ..DriveNodeConfig::new(node(5))
    });
    lab.run(20);
    let report = run(
        &mut lab,
        Plan {
            axis: 2,
            ..jog(20_000, 500)
        },
    );
    assert_eq!(report.diagnosis, None);
    let drives = lab.drive(0).application();
    assert!(drives.axis(2).unwrap().motor().position > 1.0);
    assert!(drives.axis(0).unwrap().motor().position.abs() < 1e-6);
}

#[test]
fn can_jog_turns_and_comes_to_rest() {
    let mut lab = lab();
    let report = run(&mut lab, jog(-20_000, 1000));
    assert_eq!(report.diagnosis, None, "{}", super::text::verdict(&report));
    let turned = axis(&mut lab.devices).motor().position;
    // A second at 20,000 increments/s of 4,096 a turn.
    let expected = -20_000.0 / 4096.0 * std::f64::consts::TAU;
    assert!(
        (turned - expected).abs() < 0.1 * expected.abs(),
        "{turned} {expected}"
    );
    assert!(axis(&mut lab.devices).motor().velocity.abs() < 0.1);
}

#[test]
fn can_jog_on_ctrl_c_makes_a_quick_stop() {
    let mut lab = lab();
    lab.stop_at = Some(lab.now() + Duration::from_secs(1));
    let report = run(&mut lab, jog(20_000, 60_000));
    assert!(report.stopped && report.diagnosis.is_none());
    assert!(
        states(&report).contains(&State::QuickStopActive),
        "{:?}",
        states(&report)
    );
    assert!(lab.now() < Duration::from_secs(3), "{:?}", lab.now());
    assert!(axis(&mut lab.devices).motor().velocity.abs() < 0.1);
    assert_eq!(axis(&mut lab.devices).state(), State::SwitchOnDisabled);
}

/// The interface fails during a jog.
#[test]
fn can_drive_without_master_stops_by_itself() {
    struct Failing(Lab, Duration);
    impl Wire for Failing {
        fn now(&self) -> Duration {
            self.0.now()
        }
        fn send(&mut self, frame: &Frame) -> anyhow::Result<()> {
            anyhow::ensure!(self.now() < self.1, "interface failed");
            self.0.send(frame)
        }
        fn receive(&mut self, timeout: Duration) -> anyhow::Result<Option<Frame>> {
            self.0.receive(timeout)
        }
        fn is_stopped(&self) -> bool {
            false
        }
    }
    let mut wire = Failing(lab(), Duration::from_secs(1));
    let mut show = |_: &super::session::Step| Ok(());
    let failed = Session::new(&mut wire, jog(20_000, 60_000), &mut show).run();
    assert_eq!(failed.unwrap_err().to_string(), "interface failed");
    let lab = &mut wire.0;
    assert!(axis(&mut lab.devices).motor().velocity > 10.0);
    lab.run(1500);
    assert!(axis(&mut lab.devices).motor().velocity.abs() < 0.1);
    assert_eq!(axis(&mut lab.devices).state(), State::Fault);
}

#[test]
fn can_drive_watch_commands_nothing() {
    let mut lab = lab();
    lab.at(300, |devices| axis(devices).fault(FaultCode::TEMPERATURE));
    let mut show = |_: &super::session::Step| Ok(());
    let session = Session::new(&mut lab, plan(), &mut show);
    let report = session.watch(Some(Duration::from_millis(600))).unwrap();
    assert_eq!(states(&report).last(), Some(&State::Fault));
    let text = super::text::verdict(&report);
    assert!(text.contains("FAIL  the drive is in fault"), "{text}");
    assert!(text.contains("603Fh:00 error code: "), "{text}");
    let reads = |frame: &Frame| {
        let Message::SdoRequest(_, message) = Message::decode(frame) else {
            return false;
        };
        matches!(Request::decode(&message), Some(Request::Upload { .. }))
    };
    assert!(lab.sent.iter().all(|(_, frame)| reads(frame)));
}

#[test]
fn can_drive_offline_is_diagnosed() {
    let (cause, text) = diagnosed(&mut Lab::new().with_nothing(), plan());
    assert!(matches!(cause, Cause::Silent(_)), "{text}");
    assert!(text.contains("node 5 does not answer"), "{text}");
}

impl Lab {
    fn with_nothing(mut self) -> Self {
        self.devices.push(Device::Nothing);
        self
    }
}

/// Replaces the answer about an object.
fn answer_instead(frame: Frame, index: u16, value: &[u8]) -> Frame {
    let Message::SdoResponse(node, message) = Message::decode(&frame) else {
        return frame;
    };
    match Response::decode(&message) {
        Some(Response::Upload { address, .. }) if address.index == index => {
            let data = Initiate::Expedited(takt_can::canopen::sdo::Bytes::new(value));
            let answer = Response::Upload { address, data }.encode();
            Frame::full(node.cob(takt_can::canopen::SDO_RESPONSE), answer)
        }
        _ => frame,
    }
}

#[test]
fn can_node_without_the_axis_is_diagnosed() {
    let mut lab = lab();
    lab.tamper = |frame| answer_instead(frame, 0x1000, &[0x91, 1, 3, 0]);
    let (cause, text) = diagnosed(&mut lab, plan());
    assert_eq!(cause, Cause::NotADrive(0x0003_0191), "{text}");
    lab.tamper = |frame| frame;
    let (cause, text) = diagnosed(&mut lab, Plan { axis: 1, ..plan() });
    assert!(matches!(cause, Cause::NoAxis(1, _)), "{text}");
    assert!(text.contains("refuses 6841h:00"), "{text}");
}

#[test]
fn can_drive_statusword_without_state_is_diagnosed() {
    let mut lab = lab();
    lab.tamper = |frame| answer_instead(frame, 0x6041, &[1, 0]);
    let (cause, text) = diagnosed(&mut lab, plan());
    assert_eq!(cause.name(), "undefined-state", "{text}");
}

#[test]
fn can_drive_fault_shows_code_and_history() {
    let mut lab = lab();
    axis(&mut lab.devices).fault(FaultCode::SHORT_CIRCUIT);
    lab.run(50);
    let (cause, text) = diagnosed(&mut lab, plan());
    assert_eq!(cause.name(), "fault");
    for words in [
        "603Fh:00 error code: short circuit or earth leakage at the motor (2320h)",
        "1001h:00 error register 03h: generic, current",
        "1003h:01 last error: short circuit",
    ] {
        assert!(text.contains(words), "{words}\n{text}");
    }
}

#[test]
fn can_drive_fault_is_reset_or_reported() {
    let mut lab = lab();
    axis(&mut lab.devices).fault(FaultCode::ENCODER);
    lab.run(50);
    let (cause, text) = diagnosed(
        &mut lab,
        Plan {
            reset: true,
            ..plan()
        },
    );
    assert_eq!(cause.name(), "reset-refused");
    assert!(
        text.contains("after 3 resets") && text.contains("encoder"),
        "{text}"
    );
    axis(&mut lab.devices).clear_cause();
    let report = run(
        &mut lab,
        Plan {
            reset: true,
            ..plan()
        },
    );
    assert_eq!(report.diagnosis, None);
    assert!(report.was_enabled());
}

#[test]
fn can_drive_without_voltage_is_diagnosed() {
    let mut lab = lab();
    axis(&mut lab.devices).dc_link = 3.0;
    let (cause, text) = diagnosed(&mut lab, plan());
    assert_eq!(cause.name(), "no-voltage");
    assert!(
        text.contains("6079h:00 DC link: 3.0 V") && text.contains("bit 4"),
        "{text}"
    );
}

#[test]
fn can_drive_held_by_a_service_tool_is_diagnosed() {
    let mut lab = lab();
    axis(&mut lab.devices).local = true;
    let (cause, text) = diagnosed(&mut lab, plan());
    assert_eq!(cause.name(), "not-remote");
    assert!(text.contains("bit 9 of 6041h is low"), "{text}");
}

#[test]
fn can_drive_with_open_interlock_is_diagnosed() {
    let mut lab = lab();
    axis(&mut lab.devices).interlock = true;
    let (cause, text) = diagnosed(&mut lab, plan());
    assert_eq!(cause.name(), "stuck");
    assert!(
        text.contains("60FDh:00 digital inputs 0000000Ch: home switch, interlock"),
        "{text}"
    );
    assert!(
        text.contains("ready to switch on although 6040h is 0x0007"),
        "{text}"
    );
}

#[test]
fn can_drive_with_another_master_is_diagnosed() {
    let mut lab = lab();
    let nothing = Frame::new(node(5).cob(RPDO1), &[0, 0]).unwrap();
    let begun = lab.now();
    for ms in 0..6000 {
        lab.other_master
            .push((begun + Duration::from_millis(ms), nothing));
    }
    let (cause, text) = diagnosed(&mut lab, plan());
    assert!(
        matches!(cause, Cause::Overwritten { holds: 0, .. }),
        "{text}"
    );
    assert!(text.contains("another master sends to it"), "{text}");
}

#[test]
fn can_drive_without_the_mode_is_diagnosed() {
    let mut lab = lab_with(DriveConfig {
        quirks: Quirks {
            supported_modes: 0x1,
            ..Quirks::default()
        },
        ..DriveConfig::default()
    });
    let (cause, text) = diagnosed(&mut lab, plan());
    assert_eq!(cause.name(), "refused");
    assert!(
        text.contains("node 5 refuses 6060h:00: the value is not allowed"),
        "{text}"
    );
    assert!(text.contains("6502h:00 has the modes PP (1)"), "{text}");
}

#[test]
fn can_drive_mode_timeout_is_diagnosed() {
    let mut lab = lab_with(DriveConfig {
        quirks: Quirks {
            mode_delay: Duration::from_secs(10),
            ..Quirks::default()
        },
        ..DriveConfig::default()
    });
    let (cause, text) = diagnosed(&mut lab, plan());
    assert_eq!(cause.name(), "mode");
    assert!(
        text.contains("6061h shows mode 0, not 3") && text.contains("6502h:00"),
        "{text}"
    );
}

/// It was left in Quick stop active.
#[test]
fn can_drive_held_quick_stop_is_diagnosed() {
    let mut lab = lab();
    let mut asker = SdoClient::new(node(5), TIMEOUT);
    let mut write = |index, value: &[u8]| {
        let answer = asker.write(&mut lab, Address::new(index, 0), value, false);
        answer.unwrap().unwrap();
        lab.run(500);
    };
    write(0x605A, &[6, 0]);
    write(0x6060, &[3]);
    for state in [
        State::SwitchOnDisabled,
        State::ReadyToSwitchOn,
        State::SwitchedOn,
    ] {
        let word = next_control_word(state, Goal::OperationEnabled);
        write(0x6040, &word.raw().to_le_bytes());
    }
    write(0x6040, &[2, 0]);
    let (cause, text) = diagnosed(&mut lab, plan());
    assert_eq!(cause.name(), "quick-stop-held");
    assert!(
        text.contains("quick stop option 6: quick stop ramp, stays"),
        "{text}"
    );
}

/// Over SDO there are no cyclic set-points.
#[test]
fn can_drive_cyclic_mode_not_followed_is_diagnosed() {
    let mut lab = lab_with(DriveConfig {
        quirks: Quirks::named("dm556ec").unwrap(),
        ..DriveConfig::default()
    });
    let (cause, text) = diagnosed(&mut lab, Plan { mode: 8, ..plan() });
    assert_eq!(cause.name(), "not-following");
    assert!(
        text.contains("bit 12") && text.contains("6061h:00 mode of operation 8"),
        "{text}"
    );
}

#[test]
fn can_jog_of_a_blocked_motor_fails() {
    let mut lab = lab();
    let mut asker = SdoClient::new(node(5), TIMEOUT);
    let none = asker.write(&mut lab, Address::new(0x6072, 0), &[0, 0], false);
    none.unwrap().unwrap();
    let (cause, text) = diagnosed(&mut lab, jog(20_000, 3000));
    assert_eq!(
        cause,
        Cause::DoesNotTurn {
            wanted: 20_000,
            shown: 0
        }
    );
    assert!(
        text.contains("6072h:00 max torque 0.0 % of rated"),
        "{text}"
    );
    // A jog shorter than the timeout is judged at its end.
    let (cause, _) = diagnosed(&mut lab, jog(20_000, 200));
    assert_eq!(cause.name(), "does-not-turn");
}

#[test]
fn can_jog_above_607f_or_6080h_is_rejected() {
    let mut lab = lab();
    let (cause, text) = diagnosed(&mut lab, jog(-200_001, 500));
    assert_eq!(cause.name(), "too-fast", "{text}");
    assert!(
        text.contains("200001 velocity units requested, 607Fh (max profile velocity) allows 200000\n        hint: --jog 200000"),
        "{text}"
    );
    let mut asker = SdoClient::new(node(5), TIMEOUT);
    let rpm = asker.write(&mut lab, Address::new(0x6080, 0), &[60, 0, 0, 0], false);
    rpm.unwrap().unwrap();
    lab.sent.clear();
    let (cause, text) = diagnosed(&mut lab, jog(4100, 500));
    assert_eq!(cause.name(), "too-fast", "{text}");
    assert!(
        text.contains("6080h (max motor speed) allows 4096"),
        "{text}"
    );
    // It was not enabled.
    let is_download = |(_, frame): &(Duration, Frame)| {
        matches!(Message::decode(frame), Message::SdoRequest(_, message)
            if !matches!(Request::decode(&message), Some(Request::Upload { .. })))
    };
    assert_eq!(lab.sent.iter().filter(|sent| is_download(sent)).count(), 0);
}

/// A drive whose 60FFh changes by itself while it turns loses power soon.
fn runs_away(velocity: i32) -> String {
    let mut lab = lab();
    lab.at(600, move |devices| {
        let target = Address::new(0x60FF, 0);
        let store = drive(devices, 0).dictionary_mut();
        store.store(target, &velocity.to_le_bytes()).unwrap();
    });
    let (cause, text) = diagnosed(&mut lab, jog(20_000, 5000));
    assert_eq!(cause.name(), "runaway", "{text}");
    assert!(
        text.contains("its power was taken\n        hint: "),
        "{text}"
    );
    let turns = axis(&mut lab.devices).motor().position / std::f64::consts::TAU;
    // Of some half a second at full speed before its power went, and coasting.
    assert!(turns.abs() < 60.0, "{turns}");
    text
}

#[test]
fn can_jog_runaway_loses_power() {
    runs_away(190_000);
    runs_away(-40_000);
}

#[test]
fn can_jog_fault_is_diagnosed() {
    let mut lab = lab();
    lab.at(1000, |devices| axis(devices).fault(FaultCode::OVER_VOLTAGE));
    let (cause, text) = diagnosed(&mut lab, jog(20_000, 5000));
    assert_eq!(cause.name(), "fault");
    assert!(
        text.contains("DC link over-voltage (3210h)") && text.contains("emergency: DC link"),
        "{text}"
    );
}

#[test]
fn can_jog_of_an_offline_drive_is_diagnosed() {
    let mut lab = lab();
    lab.at(1000, |devices| devices[0] = Device::Nothing);
    let (cause, text) = diagnosed(&mut lab, jog(20_000, 5000));
    assert_eq!(cause.name(), "silent", "{text}");
}

#[test]
fn can_jog_of_a_restarted_drive_is_diagnosed() {
    let mut lab = lab();
    lab.at(1000, |devices| {
        let config = DriveNodeConfig::new(node(5));
        let restarted = DriveNode::power_on(config, Duration::from_secs(1)).unwrap();
        devices[0] = Device::Drive(Box::new(restarted));
    });
    let (cause, text) = diagnosed(&mut lab, jog(20_000, 5000));
    assert_eq!(cause, Cause::Rebooted, "{text}");
}

#[test]
fn can_drive_leaving_operational_is_diagnosed() {
    let mut lab = Lab::new();
    lab.add_drive(DriveNodeConfig {
        heartbeat_ms: 50,
        ..DriveNodeConfig::new(node(5))
    });
    lab.run(20);
    let preop = NmtCommand::EnterPreOperational.frame(None);
    lab.other_master.push((Duration::from_secs(1), preop));
    let mut asker = SdoClient::new(node(5), TIMEOUT);
    let ignore = asker.write(&mut lab, Address::new(0x6007, 0), &[0, 0], false);
    ignore.unwrap().unwrap();
    let held = Plan {
        hold: Duration::from_secs(5),
        ..plan()
    };
    let (cause, text) = diagnosed(&mut lab, held);
    assert_eq!(cause.name(), "left-operational", "{text}");
    assert!(
        text.contains("another master sends to it: NMT enter pre-operational"),
        "{text}"
    );
}

/// Another master disables it.
#[test]
fn can_drive_disabled_by_others_is_diagnosed() {
    let mut lab = lab();
    let off = Frame::new(node(5).cob(RPDO1), &[0, 0]).unwrap();
    lab.other_master.push((Duration::from_secs(1), off));
    let held = Plan {
        hold: Duration::from_secs(5),
        ..plan()
    };
    let (cause, text) = diagnosed(&mut lab, held);
    assert_eq!(cause, Cause::Dropped(State::SwitchOnDisabled), "{text}");
}

#[test]
fn can_jog_driven_by_its_load_is_diagnosed() {
    let mut lab = lab_with(DriveConfig {
        motor: MotorConfig {
            stops: (-1e9, 1e9),
            thermal_time: 1e6,
            ..MotorConfig::default()
        },
        ..DriveConfig::default()
    });
    lab.at(740, |devices| {
        axis(devices).motor_mut().external = 3.0;
    });
    let report = run(&mut lab, jog(20_000, 500));
    let cause = report.diagnosis.as_ref().expect("a diagnosis").cause;
    assert_eq!(cause.name(), "does-not-stop");
    assert_ne!(axis(&mut lab.devices).state(), State::OperationEnabled);
}

#[test]
fn can_jog_without_heartbeat_monitor_needs_the_option() {
    let mut lab = lab();
    let mut asker = SdoClient::new(node(5), TIMEOUT);
    let none = asker.write(&mut lab, Address::new(0x6007, 0), &[0, 0], false);
    none.unwrap().unwrap();
    let (cause, _) = diagnosed(&mut lab, jog(20_000, 500));
    assert_eq!(cause, Cause::NoReaction);
    let unguarded = |mut plan: Plan| {
        plan.jog = plan.jog.map(|jog| Jog {
            unguarded: true,
            ..jog
        });
        plan
    };
    assert_eq!(run(&mut lab, unguarded(jog(20_000, 500))).diagnosis, None);
    // A drive that has no 1016h.
    let mut lab = self::lab();
    lab.tamper = |frame| {
        let Message::SdoResponse(node, message) = Message::decode(&frame) else {
            return frame;
        };
        match Response::decode(&message) {
            Some(Response::Download { address }) if address.index == 0x1016 => {
                let code = AbortCode::NoObject;
                let answer = Response::Abort { address, code }.encode();
                Frame::full(node.cob(takt_can::canopen::SDO_RESPONSE), answer)
            }
            _ => frame,
        }
    };
    let (cause, text) = diagnosed(&mut lab, jog(20_000, 500));
    assert_eq!(cause.name(), "unguarded", "{text}");
    assert!(text.contains("--unguarded"), "{text}");
}

#[test]
fn can_drive_modes_have_names() {
    assert_eq!(super::mode("csp"), Ok(8));
    assert_eq!(super::mode("-1"), Ok(-1));
    assert!(super::mode("fast").is_err());
}

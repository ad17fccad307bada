//! `takt can rmp` against an emulated power base, with each fault that it can have.

use std::time::Duration;

use takt_can::Frame;
use takt_can::rmp::emulator::PowerbaseConfig;
use takt_can::rmp::{Base, Command, Config, DriverConfig, Gain, Mode, Model, YawSign};

use super::session::{Finding, Jog, Plan, Report, Session};
use super::{Configs, configs, text, velocity};
use crate::can::lab::{Device, Lab, rmp};

fn lab() -> Lab {
    let mut lab = Lab::new();
    lab.add_rmp(PowerbaseConfig::default());
    lab
}

fn watch() -> Plan {
    Plan {
        model: Model::Rmp200,
        yaw_integral: YawSign::default(),
        duration: Some(Duration::from_secs(2)),
        configs: vec![],
        jog: None,
    }
}

fn jog(velocity: [f64; 2], ms: u64) -> Plan {
    let time = Duration::from_millis(ms);
    Plan {
        jog: Some(Jog { velocity, time }),
        ..watch()
    }
}

fn run(lab: &mut Lab, plan: Plan) -> Report {
    Session::new(lab, plan).run(&mut |_| ()).unwrap()
}

fn names(report: &Report) -> Vec<&'static str> {
    report
        .findings
        .iter()
        .map(|finding| finding.name())
        .collect()
}

#[test]
fn rmp_watch_sends_nothing_and_shows_all() {
    let mut lab = lab();
    let mut views = 0;
    let report = Session::new(&mut lab, watch())
        .run(&mut |_| views += 1)
        .unwrap();
    assert_eq!(report.findings, []);
    assert!(lab.sent.is_empty());
    assert!(report.view.cycles > 150 && report.view.broken == 0);
    assert!((9..=10).contains(&views), "{views}");
    let shown = text::report("can0", &report);
    for words in [
        "can0: rmp200",
        "mode       disabled",
        "batteries  power base",
        "odometry   x +0.000 m",
        "can0: ok",
    ] {
        assert!(shown.contains(words), "{words}\n{shown}");
    }
    assert!(shown.lines().all(|line| line.len() <= 80), "{shown}");
    let json = text::json(&report);
    assert_eq!(
        (&json["broken"], &json["findings"]),
        (&0.into(), &serde_json::json!([]))
    );
}

#[test]
fn rmp_jog_ends_disabled_at_rest() {
    let mut lab = lab();
    let report = run(&mut lab, jog([0.4, 0.0], 2000));
    assert_eq!(report.findings, []);
    let (reported, truth) = (report.view.motion.pose, lab.rmp(0).truth());
    // Ramps of 1 m/s² on both sides.
    assert!((truth.x - 0.8).abs() < 0.15, "{}", truth.x);
    assert!(
        (reported.x - truth.x).abs() < 0.02,
        "{} {}",
        reported.x,
        truth.x
    );
    assert_eq!(lab.rmp(0).mode(), Mode::Disabled);
    assert!(lab.rmp(0).speed().iter().all(|speed| speed.abs() < 0.01));
}

#[test]
fn rmp_jog_on_ctrl_c_brakes() {
    let mut lab = lab();
    lab.stop_at = Some(Duration::from_secs(3));
    let report = run(&mut lab, jog([0.5, 0.5], 60_000));
    assert!(report.stopped && report.findings.is_empty());
    assert!(lab.rmp(0).truth().x > 0.2);
    assert!(lab.rmp(0).speed().iter().all(|speed| speed.abs() < 0.01));
    assert!(lab.bus.now() < Duration::from_secs(6));
}

#[test]
fn rmp_settings_are_sent_repeatedly() {
    let mut lab = lab();
    let plan = Plan {
        configs: configs("velocity=16,acceleration=9,turn=5,gain=1")
            .unwrap()
            .0,
        ..watch()
    };
    let report = run(&mut lab, plan);
    assert_eq!(report.findings, []);
    assert_eq!(lab.rmp(0).scales(), [16, 9, 5]);
    assert_eq!(report.view.measured.unwrap().gain, Gain::from_raw(1));
    assert!(text::report("can0", &report).contains("set        velocity scale 16/16"));
}

#[test]
fn rmp_gain_not_accepted_is_reported() {
    let mut lab = lab();
    let plan = Plan {
        configs: configs("gain=2").unwrap().0,
        ..watch()
    };
    // The frame with the setting does not arrive at the power base, which keeps its own.
    lab.at(1500, |devices| {
        rmp(devices, 0).faults.silent = [true; 2];
    });
    let report = run(&mut lab, plan);
    assert!(
        names(&report).contains(&"gain-not-taken"),
        "{:?}",
        report.findings
    );
}

#[test]
fn rmp_settings_of_the_command_line_are_checked() {
    assert_eq!(
        configs("turn=3,current=256"),
        Ok(Configs(vec![Config::MaxTurn(3), Config::CurrentLimit(256)]))
    );
    for wrong in [
        "",
        "turn",
        "turn=17",
        "current=257",
        "gain=3",
        "speed=1",
        "turn=-1",
    ] {
        assert!(configs(wrong).is_err(), "{wrong}");
    }
    assert_eq!(velocity("0.2,-0.1").map(|v| v.0), Ok([0.2, -0.1]));
    assert_eq!(velocity("-0.2").map(|v| v.0), Ok([-0.2, 0.0]));
    for wrong in ["", "x", "2,0", "0,9", "nan", "inf,0"] {
        assert!(velocity(wrong).is_err(), "{wrong}");
    }
}

#[test]
fn rmp_silent_or_off_is_reported() {
    let mut lab = Lab::new();
    assert_eq!(names(&run(&mut lab, watch())), ["silent"]);
    assert_eq!(
        names(&run(&mut Lab::new(), jog([0.2, 0.0], 500))),
        ["silent"]
    );
    let mut lab = self::lab();
    lab.rmp(0).power(false);
    let report = run(&mut lab, watch());
    assert_eq!(names(&report), ["powered-off"]);
    assert!(text::report("can0", &report).contains("switch it on"));
    assert_eq!(names(&run(&mut lab, jog([0.2, 0.0], 500))), ["powered-off"]);
}

#[test]
fn rmp_each_hindrance_is_reported() {
    type Fault = fn(&mut [Device]);
    let cases: [(Fault, &str); 4] = [
        (
            |d| rmp(d, 0).faults.emergency_stop = true,
            "emergency stop is open",
        ),
        (|d| rmp(d, 0).faults.word1 = 0x0040, "integrity fault"),
        (|d| rmp(d, 0).faults.refuses_mode = true, "it stays in mode"),
        (|d| rmp(d, 0).faults.word1 = 0x4000, "battery is low"),
    ];
    for (fault, words) in cases {
        let mut lab = lab();
        fault(&mut lab.devices);
        let report = run(&mut lab, jog([0.2, 0.0], 1000));
        let shown = text::report("can0", &report);
        assert!(shown.contains(words), "{words}\n{shown}");
        assert_eq!(report.findings.len(), 1, "{shown}");
    }
}

#[test]
fn rmp_fault_during_a_jog_is_reported() {
    let mut lab = lab();
    lab.at(3000, |devices| rmp(devices, 0).faults.emergency_stop = true);
    let report = run(&mut lab, jog([0.2, 0.0], 20_000));
    assert_eq!(names(&report), ["blocked"]);
    let mut lab = self::lab();
    lab.at(3000, |devices| devices[0] = Device::Nothing);
    let report = run(&mut lab, jog([0.2, 0.0], 20_000));
    assert_eq!(names(&report), ["silent"]);
    let mut lab = self::lab();
    lab.at(500, |devices| devices[0] = Device::Nothing);
    assert_eq!(names(&run(&mut lab, watch())), ["silent"]);
}

#[test]
fn rmp_missing_message_is_reported() {
    let mut lab = lab();
    lab.rmp(0).faults.lacks = Some(0x404);
    let report = run(&mut lab, watch());
    assert!(
        names(&report).contains(&"broken-cycles"),
        "{:?}",
        report.findings
    );
}

#[test]
fn rmp_other_host_is_reported() {
    let mut lab = lab();
    let rest: Frame = Command::default().frame();
    for turn in 0..20_u64 {
        lab.other_master
            .push((Duration::from_millis(50 * turn), rest));
    }
    let report = run(&mut lab, watch());
    assert_eq!(report.findings, [Finding::OtherHost(20)]);
}

#[test]
fn rmp_short_jog_without_motion_fails() {
    let mut lab = lab();
    lab.rmp(0).faults.keeps_scale = true;
    lab.rmp(0).store_scale(0);
    let report = run(&mut lab, jog([0.3, 0.0], 800));
    assert_eq!(report.findings, [Finding::DoesNotMove]);
}

#[test]
fn rmp_largest_jog_is_within_every_model() {
    for model in Model::ALL {
        let config = DriverConfig {
            model,
            ..DriverConfig::default()
        };
        let base = Base::new(config, 1.0, 1.0);
        let largest = [super::SPEED_MAX, super::ROTATION_MAX];
        assert!(base.reach(largest) >= 1.0, "{}", model.name());
        assert!(base.reach([3.6, 0.0]) < 1.0, "{}", model.name());
    }
}

/// It keeps its stored scale, which is zero.
#[test]
fn rmp_jog_without_motion_fails() {
    let mut lab = lab();
    lab.rmp(0).faults.keeps_scale = true;
    lab.rmp(0).store_scale(0);
    let report = run(&mut lab, jog([0.3, 0.0], 5000));
    assert_eq!(report.findings, [Finding::DoesNotMove]);
    assert!(report.findings[0].to_string().contains("--set velocity=16"));
}

#[test]
fn rmp_jog_that_turns_decides_the_yaw_sign() {
    let mut lab = Lab::new();
    lab.add_rmp(PowerbaseConfig {
        yaw_integral: YawSign::CounterClockwise,
        ..PowerbaseConfig::default()
    });
    let report = run(&mut lab, jog([0.0, 0.5], 4000));
    assert_eq!(
        report.findings,
        [Finding::YawSign(YawSign::CounterClockwise)]
    );
    let text = text::report("can0", &report);
    assert!(
        text.contains("yaw_integral = \"counter_clockwise\""),
        "{text}"
    );
    let right = Plan {
        yaw_integral: YawSign::CounterClockwise,
        ..jog([0.0, 0.5], 4000)
    };
    assert_eq!(run(&mut lab, right).findings, []);
}

/// It ignores the command that disables its motors.
#[test]
fn rmp_jog_that_stays_enabled_fails() {
    let mut lab = lab();
    lab.at(2500, |devices| rmp(devices, 0).faults.refuses_mode = true);
    let report = run(&mut lab, jog([0.3, 0.0], 3000));
    assert!(
        names(&report).contains(&"stays-enabled"),
        "{:?}",
        report.findings
    );
}

//! The primitives `schunkwsg::*` and `KUKA::IIWA::CartSinImpParameters` in nets, on simulated devices, in virtual time.

mod fixtures;

use fixtures::{Fixture, arm_parameters, endless, parameters, watch};
use takt_net::Devices;

fn hand(part: Option<&'static str>) -> Fixture {
    let mut fixture = Fixture::default();
    let part = part.map(|width| ("part", width));
    let given: Vec<_> = part.into_iter().collect();
    fixture.add("hand", "schunk_wsg_sim", &parameters(&given));
    fixture
}

/// A command and the values that a net sees of it.
fn seen(name: &str, command: &str) -> String {
    format!(
        "{name}={command},{},{}",
        watch(
            "Core::Boolean",
            &format!("{name}_done"),
            &format!("{name}.outFinished")
        ),
        watch(
            "Core::Int",
            &format!("{name}_status"),
            &format!("{name}.outStatusCode")
        ),
    )
}

fn monitor() -> String {
    format!(
        "m=schunkwsg::Monitor(Device='hand'),{},{},{}",
        watch("Core::Double", "width", "m.outOpeningWidth"),
        watch("Core::Double", "force", "m.outForce"),
        watch("Core::Double", "state", "m.outGraspingState"),
    )
}

#[test]
fn wsg_commands_follow_one_another_in_net() {
    let mut fixture = hand(Some("0.03"));
    let text = format!(
        "{},{},{}",
        seen(
            "limit",
            "schunkwsg::SetForceLimit(Device='hand',Force='20')"
        ),
        seen(
            "grasp",
            "schunkwsg::Grasping(Device='hand',Width='0.03',Speed='0.1',inActive=limit.outFinished)",
        ),
        monitor(),
    );
    fixture.start(1, &text);
    fixture.steps(5);
    assert_eq!(fixture.out(1, "grasp_status"), "null");
    fixture.until(1, "grasp_done", "true");
    assert_eq!(fixture.out(1, "grasp_status"), "0");
    fixture.steps(2);
    assert!((fixture.number(1, "width") - 0.03).abs() < 1e-9);
    assert_eq!(
        (fixture.out(1, "force"), fixture.out(1, "state")),
        ("20".into(), "4".into())
    );
}

#[test]
fn wsg_grasp_without_part_reports_its_status() {
    let mut fixture = hand(None);
    let text = seen(
        "g",
        "schunkwsg::Grasping(Device='hand',Width='0.09',Speed='0.1')",
    );
    fixture.start(1, &text);
    fixture.until(1, "g_done", "true");
    assert_eq!(fixture.out(1, "g_status"), "18");
}

#[test]
fn wsg_second_command_at_once_is_concurrent() {
    let mut fixture = hand(None);
    let text = format!(
        "{},{}",
        seen(
            "a",
            "schunkwsg::Releasing(Device='hand',OpenWidth='0.01',Speed='0.1')"
        ),
        seen(
            "b",
            "schunkwsg::Releasing(Device='hand',OpenWidth='0.05',Speed='0.1')"
        ),
    );
    fixture.start(1, &text);
    fixture.steps(3);
    let statuses = [fixture.out(1, "a_status"), fixture.out(1, "b_status")];
    assert!(statuses.contains(&"32".to_owned()), "{statuses:?}");
    assert!(statuses.contains(&"null".to_owned()), "{statuses:?}");
}

#[test]
fn wsg_motion_stops_with_its_net() {
    let mut fixture = hand(None);
    let text = format!(
        "{},{}",
        seen(
            "a",
            "schunkwsg::Releasing(Device='hand',OpenWidth='0.01',Speed='0.1')"
        ),
        monitor(),
    );
    fixture.start(1, &text);
    fixture.steps(200);
    fixture.end(1);
    fixture.steps(50);
    fixture.start(2, &monitor());
    fixture.steps(2);
    let rests_at = fixture.number(2, "width");
    fixture.steps(300);
    assert!((fixture.number(2, "width") - rests_at).abs() < 1e-12);
    assert!(rests_at > 0.05, "{rests_at}");
}

#[test]
fn wsg_parameters_without_meaning_are_faults() {
    let fixture = hand(None);
    for (command, cause) in [
        (
            "Grasping(Device='hand',Width='-1')",
            "-1 is not a finite number from 0",
        ),
        (
            "SetForceLimit(Device='hand',Force='nan')",
            "NaN is not a finite number from 0",
        ),
        ("Homing(Device='none')", "none"),
    ] {
        let fault = fixture.fault(&endless(&format!("g=schunkwsg::{command}")));
        assert!(fault.contains(cause), "{fault}");
    }
}

#[test]
fn sine_impedance_is_taken_by_arms_that_have_it() {
    let mut fixture = Fixture::default();
    fixture.add("iiwa", "kuka_iiwa_sim", &arm_parameters(7, &[]));
    fixture.add("lwr", "kuka_lwr_sim", &arm_parameters(7, &[]));
    let net = |robot: &str| {
        format!(
            "a=World::WrenchValue(Value='{{force:{{z:5}}}}'),
            s=KUKA::IIWA::CartSinImpParameters(inAmplitude=a.outValue,inFrequency=a.outValue,Robot='{robot}')"
        )
    };
    fixture.start(1, &net("iiwa"));
    fixture.steps(3);
    let sine = Devices::interfaces(&fixture.table, "iiwa")
        .unwrap()
        .cartesian_sine
        .unwrap();
    let answer = sine.answer.get(&fixture.executor.image);
    assert!(answer.is_some_and(|answer| answer.error == 0), "{answer:?}");
    let fault = fixture.fault(&endless(&net("lwr")));
    assert!(fault.contains("can oscillate"), "{fault}");
}

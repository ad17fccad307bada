//! The findings of `takt net check` in nets with the primitives of real robots: each kind is found, with
//! its location and a hint, and nets that mean what they say have none.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::time::Duration;

use takt_core::device::DeviceTable;
use takt_device_fri::lwr;
use takt_net::{Finding, Limits, LoadContext, check};

/// The findings of a net in a cell with two arms.
fn findings(children: &str) -> Vec<Finding> {
    let mut devices = DeviceTable::default();
    for name in ["left", "right"] {
        devices.add_arm(lwr::describe(name)).unwrap();
    }
    let registry = takt_core::registry();
    let context = LoadContext {
        registry: &registry,
        devices: &devices,
        period: Duration::from_millis(1),
        limits: Limits::default(),
    };
    let text = net(children);
    let (_, findings) = check(&text, &context)
        .map_err(|rejection| rejection.render("net", &text))
        .unwrap();
    for finding in &findings {
        let rendered = finding.render("net", &text);
        assert!(
            rendered.contains("\nhint: ") && rendered.contains("--> net:1:"),
            "{rendered}"
        );
    }
    findings
}

fn net(children: &str) -> String {
    format!("{{{children},c=Cancel(),outTerminate=c.outCancel}}")
}

/// Checks that the only findings of a net are at the texts `at`, and contain the texts.
fn finds(children: &str, expected: &[(&str, &str)]) {
    let text = net(children);
    let found = findings(children);
    assert_eq!(found.len(), expected.len(), "{children}: {found:#?}");
    for (finding, (at, part)) in found.iter().zip(expected) {
        assert!(text[finding.at.clone()].starts_with(at), "{finding:?}");
        assert!(finding.text.contains(part), "{finding:?}");
        assert!(!finding.hint.is_empty());
    }
}

/// Where joint 4 of `left` is, in every cycle.
const HERE: &str = "m=RobotArm::JointMonitor(Robot='left',Axis='4')";

/// A command to that joint whose error is read.
fn joint(name: &str, rest: &str) -> String {
    format!(
        "{name}=RobotArm::JointPosition(Robot='left',Axis='4'{rest}),\
         o{name}=Core::IntNetcommOut(inValue={name}.outError,Key='{name}')"
    )
}

#[test]
fn net_that_means_what_it_says_has_no_findings() {
    let follow = joint("j", ",inPosition=m.outCommandedPosition");
    finds(&format!("{HERE},{follow}"), &[]);
    let sine = "t=Core::Clock(),s=Core::DoubleSin(inValue=t.outValue),\
                o=Core::DoubleNetcommOut(inValue=s.outValue,Key='s')";
    finds(sine, &[]);
}

#[test]
fn joint_commanded_twice_in_parallel_is_found() {
    let [first, second] = ["a", "b"].map(|name| joint(name, ",inPosition=m.outCommandedPosition"));
    finds(
        &format!("{HERE},{first},{second}"),
        &[(
            "RobotArm::JointPosition(Robot='left',Axis='4',inPosition=m",
            "`b` commands what `a` commands",
        )],
    );
    // One at a time, and two joints, are meant.
    let [first, second] = [("a", "on"), ("b", "off")].map(|(name, active)| {
        joint(
            name,
            &format!(",inPosition=m.outCommandedPosition,inActive={active}.outValue"),
        )
    });
    let switch = "on=Core::BooleanNetcommIn(Key='on'),off=Core::BooleanNot(inValue=on.outValue)";
    finds(&format!("{HERE},{switch},{first},{second}"), &[]);
    let other = joint("b", ",inPosition=n.outCommandedPosition").replace("left", "right");
    let there = HERE.replace("m=", "n=").replace("left", "right");
    let one = joint("a", ",inPosition=m.outCommandedPosition");
    finds(&format!("{HERE},{there},{one},{other}"), &[]);
}

#[test]
fn command_without_value_is_found() {
    finds(
        &joint("j", ""),
        &[(
            "RobotArm::JointPosition",
            "`j` commands nothing: `inPosition` is not connected",
        )],
    );
}

#[test]
fn loop_without_first_value_is_found() {
    let sum =
        "p=Core::DoublePre(inValue=s.outValue),s=Core::DoubleAdd(inFirst=p.outValue,Second='0.1')";
    let expected = ("Core::DoublePre", "`p` is null in every cycle");
    finds(
        &format!("{sum},o=Core::DoubleNetcommOut(inValue=s.outValue,Key='s')"),
        &[expected],
    );
    let filtered =
        "p=Core::DoublePre(inValue=s.outValue),s=Core::DoubleLowPass(inValue=p.outValue)";
    finds(
        &format!("{filtered},o=Core::DoubleNetcommOut(inValue=s.outValue,Key='s')"),
        &[expected],
    );
    let command = joint("j", ",inPosition=s.outValue");
    finds(
        &format!("{sum},{command}"),
        &[
            expected,
            (
                "RobotArm::JointPosition",
                "`j` commands nothing: `inPosition` is null in every cycle",
            ),
        ],
    );
    let started = "n=Core::DoubleIsNull(inValue=p.outValue),\
                   f=Core::DoubleConditional(inCondition=n.outValue,True='1',inFalse=p.outValue)";
    let sum = sum.replace("inFirst=p", "inFirst=f");
    finds(
        &format!("{sum},{started},o=Core::DoubleNetcommOut(inValue=s.outValue,Key='s')"),
        &[],
    );
}

#[test]
fn result_that_no_one_reads_is_found() {
    finds(
        "t=Core::Clock()",
        &[("Core::Clock", "no one reads the results of `t`")],
    );
}

#[test]
fn command_errors_that_no_one_reads_are_found_once() {
    let silent = |name: &str, axis: usize| {
        format!(
            "{name}=RobotArm::JointPosition(Robot='left',Axis='{axis}',inPosition=m.outCommandedPosition)"
        )
    };
    finds(
        &format!(
            "{HERE},{},{},{}",
            silent("a", 0),
            silent("b", 1),
            silent("d", 2)
        ),
        &[(
            "RobotArm::JointPosition",
            "`outError` of `a` and of 2 other commands",
        )],
    );
}

#[test]
fn constant_command_is_found_with_limits_and_degrees() {
    let with = |value: &str| {
        format!(
            "v=Core::DoubleValue(Value='{value}'),{}",
            joint("j", ",inPosition=v.outValue")
        )
    };
    finds(
        &with("1.0"),
        &[(
            "1.0",
            "commanded to a constant: its driver rejects the step",
        )],
    );
    let degrees = with("30");
    finds(
        &degrees,
        &[("30", "commanded to 30 rad, beyond its limits -2.967")],
    );
    assert!(findings(&degrees)[0].hint.contains("write '30deg'"));
    finds(&with("30deg"), &[("30deg", "commanded to a constant")]);
    let found = findings(&with("5mm"));
    assert!(
        found.iter().any(|f| f
            .text
            .contains("measures rad, but its source `v` measures m")),
        "{found:?}"
    );
}

#[test]
fn links_between_quantities_are_found() {
    let speed = joint("j", ",inPosition=m.outMeasuredVelocity");
    finds(
        &format!("{HERE},{speed}"),
        &[(
            "RobotArm::JointPosition",
            "`inPosition` of `j` measures rad, but its source `m` measures rad/s",
        )],
    );
}

#[test]
fn motion_beyond_limits_or_without_start_is_found() {
    let get = "g=Core::DoubleArrayGet(inArray=p.outPosition,Size='1',Index='0')";
    let command = joint("j", ",inPosition=g.outValue");
    let ptp = |ends: &str| format!("p=Motion::Ptp({ends}),{get},{command}");
    finds(&ptp("From='[0.1]',To='[30deg]'"), &[]);
    finds(
        &ptp("From='[0.1]',To='[30]'"),
        &[("[30]", "commanded to 30 rad, beyond its limits")],
    );
    finds(
        &ptp("To='[30deg]'"),
        &[("Motion::Ptp", "`p` starts at [0], wherever the robot is")],
    );
}

#[test]
fn robot_without_kinematics_is_note_that_asks_for_cell() {
    let text = net("f=World::FrameValue(),h=Core::DoubleArray(Size='7'),\
         i=ArmKinematics::InvKin(inFrame=f.outValue,inHintJoints=h.outArray,Robot='left')");
    struct Unknown;
    impl takt_net::Devices for Unknown {
        fn arm(&self, _: &str) -> Option<takt_net::ArmBinding> {
            Some(takt_net::ArmBinding {
                first_joint: 0,
                limits: std::sync::Arc::from([]),
                kinematics: None,
            })
        }
        fn names(&self) -> Vec<String> {
            Vec::new()
        }
    }
    let registry = takt_core::registry();
    let context = LoadContext {
        registry: &registry,
        devices: &Unknown,
        period: Duration::from_millis(1),
        limits: Limits::default(),
    };
    let notes = check(&text, &context).unwrap_err().as_notes().unwrap();
    assert_eq!(notes.len(), 1);
    assert!(notes[0].text.contains("only its cell knows"));
    assert!(notes[0].hint.contains("--config"));
    let broken = text.replace("World::FrameValue", "World::FrameValeu");
    assert_eq!(check(&broken, &context).unwrap_err().as_notes(), None);
}

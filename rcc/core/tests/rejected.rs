//! Set-points that devices or primitives reject: each is reported once per onset with net, part, reason and figures, and a net
//! that is rejected continuously ends.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use takt_core::controller::{LoadRequest, NetState, RejectReason, RejectedInfo};
use takt_core::{CellConfig, Controller, NetId, SessionId};

/// A time within which a controller reports and ends nets even on a busy host.
const LONG: Duration = Duration::from_secs(60);

/// A controller that ends rejected nets after this time, with an arm and a base.
fn cell(ends_after: Duration) -> Controller {
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    cell.controller.rejected_ends_after = ends_after;
    let controller = Controller::start(&cell).unwrap();
    let list = |value: f64| format!("{:?}", vec![value; 7]);
    let limits = [
        ("min_joint", -2.0),
        ("max_joint", 2.0),
        ("max_vel", 2.0),
        ("max_acc", 4.0),
        ("home_joint", 0.04),
    ];
    let limits: BTreeMap<_, _> = limits.map(|(key, v)| (key.to_owned(), list(v))).into();
    controller
        .add_device("left", "kuka_lwr_sim", &limits)
        .unwrap();
    let none = BTreeMap::new();
    controller
        .add_device("base", "kuka_youbot_base_sim", &none)
        .unwrap();
    controller
}

fn start(controller: &Controller, parts: &str) -> NetId {
    let id = controller
        .load(LoadRequest {
            text: format!("{{{parts},c=Cancel(),outTerminate=c.outCancel}}"),
            session: SessionId::NONE,
            description: String::new(),
            period: None,
        })
        .unwrap();
    let net = controller.net(id).unwrap();
    assert_eq!(net.state(), NetState::Ready, "{:?}", net.rejection);
    controller.start_net(id).unwrap();
    id
}

fn wait<T>(what: &str, mut done: impl FnMut() -> Option<T>) -> T {
    let until = Instant::now() + LONG;
    loop {
        if let Some(result) = done() {
            return result;
        }
        assert!(Instant::now() < until, "{what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// The first rejection of a net.
fn rejected(controller: &Controller, net: NetId) -> RejectedInfo {
    wait("nothing is rejected", || {
        controller.rejected(Some(net)).into_iter().next()
    })
}

fn joint(position: &str) -> String {
    format!("{position},j=RobotArm::JointPosition(inPosition=v.outValue,Robot='left',Axis='4')")
}

#[test]
fn rejected_start_names_net_joint_and_figures() {
    let controller = cell(Duration::ZERO);
    let net = start(&controller, &joint("v=Core::DoubleValue(Value='1.0')"));
    let found = rejected(&controller, net);
    assert_eq!(
        (found.part.as_str(), found.reason),
        ("joint 4", RejectReason::Start)
    );
    assert_eq!(
        found.text.lines().next(),
        Some(
            "left joint 4 rejects set-points of rpinet0: the first is 0.9600 rad from the measured 0.0400, 0.0200 allowed"
        )
    );
    // The primitive gives the set-point again and again: it is one onset.
    let cycles = controller.stats().cycles;
    wait("no cycles", || {
        (controller.stats().cycles > cycles + 1000).then_some(())
    });
    assert_eq!(controller.rejected(None).len(), 1);
    let key = ("left".to_owned(), "joint 4".to_owned(), RejectReason::Start);
    assert_eq!(controller.rejected_counts()[&key], 1);
    let reports = controller.device_reports("left");
    assert!(
        reports.iter().any(|report| report.event.text == found.text),
        "{reports:?}"
    );
    assert_eq!(
        controller.net(net).unwrap().state(),
        NetState::Running,
        "it runs on"
    );
}

#[test]
fn net_rejected_for_too_long_ends_with_reason() {
    let controller = cell(Duration::from_millis(100));
    let net = start(&controller, &joint("v=Core::DoubleValue(Value='1.0')"));
    let end = wait("the net does not end", || controller.net(net)?.end);
    assert!(
        end.starts_with(
            "rejected for 100ms: left joint 4 rejects set-points of rpinet0: the first"
        ),
        "{end}"
    );
    let lasted = wait("the rejection lasts", || rejected(&controller, net).lasted);
    assert!(lasted >= Duration::from_millis(100), "{lasted:?}");
}

#[test]
fn degrees_for_radians_are_named_as_such() {
    let controller = cell(Duration::ZERO);
    let net = start(&controller, &joint("v=Core::DoubleValue(Value='30')"));
    let found = rejected(&controller, net);
    assert_eq!(found.reason, RejectReason::Range);
    assert_eq!(
        found.text,
        "left joint 4 rejects set-points of rpinet0: `j` is given 30.0000 rad, outside of -2.0000 to 2.0000\n\
         hint: positions are in rad: 30.00 degrees are 0.5236 rad"
    );
}

#[test]
fn set_point_without_number_is_reported() {
    let controller = cell(Duration::ZERO);
    let text = "z=Core::DoubleValue(Value='0'),v=Core::DoubleDivide(inFirst=z.outValue,inSecond=z.outValue)";
    let net = start(&controller, &joint(text));
    assert_eq!(rejected(&controller, net).reason, RejectReason::NoNumber);
}

#[test]
fn set_point_that_is_always_null_is_reported() {
    let controller = cell(Duration::from_millis(100));
    let text =
        "p=Core::DoublePre(inValue=v.outValue),v=Core::DoubleAdd(inFirst=p.outValue,Second='0.01')";
    let net = start(&controller, &joint(text));
    let found = rejected(&controller, net);
    assert_eq!(found.reason, RejectReason::Null);
    assert!(
        found
            .text
            .contains("left joint 4 gets no set-points of rpinet0"),
        "{}",
        found.text
    );
    // A net may wait for its first value: it is not ended.
    assert_eq!(controller.net(net).unwrap().state(), NetState::Running);
}

#[test]
fn set_points_that_run_away_are_reported() {
    let controller = cell(Duration::ZERO);
    // From where the joint is, four times as fast as it can.
    let text = "t=Core::Clock(),s=Core::DoubleMultiply(inFirst=t.outValue,Second='8'),\
        v=Core::DoubleAdd(inFirst=s.outValue,Second='0.04')";
    let net = start(&controller, &joint(text));
    let found = rejected(&controller, net);
    assert_eq!(found.reason, RejectReason::Lost, "{}", found.text);
    assert!(found.text.contains("0.2000 allowed"), "{}", found.text);
}

#[test]
fn base_rejects_poses_and_velocities_with_figures() {
    let controller = cell(Duration::ZERO);
    let far = "v=World::FrameValue(Value='{pos:{x:0.5}}'),\
        j=CartesianPosition::CartesianPosition(inPosition=v.outValue,Robot='base')";
    let net = start(&controller, far);
    let found = rejected(&controller, net);
    assert_eq!(
        (found.part.as_str(), found.reason),
        ("pose", RejectReason::Start)
    );
    assert!(
        found
            .text
            .contains("0.5000 m or rad from where the base is"),
        "{}",
        found.text
    );
    controller.abort(net).unwrap();
    let fast = "v=World::TwistValue(Value='{vel:{x:9}}'),\
        j=RobotBase::BaseVelocity(inVel=v.outValue,Robot='base')";
    let net = start(&controller, fast);
    let found = rejected(&controller, net);
    assert_eq!(found.reason, RejectReason::Range);
    assert!(
        found.text.contains("times its largest speed"),
        "{}",
        found.text
    );
}

#[test]
fn accepted_set_points_are_not_reported() {
    let controller = cell(Duration::from_millis(100));
    let net = start(&controller, &joint("v=Core::DoubleValue(Value='0.05')"));
    let cycles = controller.stats().cycles;
    wait("no cycles", || {
        (controller.stats().cycles > cycles + 1000).then_some(())
    });
    assert_eq!(controller.rejected(None), []);
    assert_eq!(controller.net(net).unwrap().state(), NetState::Running);
}

#[test]
fn failed_net_keeps_its_last_second_of_values() {
    let controller = cell(Duration::from_millis(100));
    let text = joint("v=Core::DoubleValue(Value='1.0')");
    let clock = "t=Core::Clock(),o=Core::DoubleNetcommOut(inValue=t.outValue,Key='t')";
    let net = start(&controller, &format!("{text},{clock}"));
    assert!(
        controller.last_values_of_net(net).is_none(),
        "it has not failed"
    );
    wait("the net does not end", || controller.net(net)?.end);
    let last = controller.last_values_of_net(net).unwrap();
    let csv = last.csv();
    let mut blocks = csv.split("time s,").skip(1);
    let of_arm = blocks.next().unwrap();
    let columns: Vec<_> = of_arm.lines().next().unwrap().split(',').collect();
    let at = columns
        .iter()
        .position(|name| *name == "left j4 set-point")
        .unwrap()
        + 1;
    let set_points = || {
        of_arm
            .lines()
            .skip(1)
            .filter_map(|row| row.split(',').nth(at))
    };
    assert!(set_points().any(|value| value == "1"), "{of_arm}");
    assert!(
        set_points().any(str::is_empty),
        "the primitive withdraws it"
    );
    let begin: f64 = of_arm
        .lines()
        .nth(1)
        .and_then(|row| row.split(',').next()?.parse().ok())
        .unwrap();
    assert!(
        begin <= -0.1,
        "at least the 100 ms in which it ran: {begin} s"
    );
    let of_net: Vec<_> = blocks.next().unwrap().lines().collect();
    assert_eq!(of_net[0], "outt");
    assert!(of_net.len() > 2, "{of_net:?}");
    let table = last.table();
    assert!(
        table.contains("j4 measured") && table.lines().count() > 3,
        "{table}"
    );
}

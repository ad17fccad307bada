//! Simulated devices made and removed while the controller runs, and nets of other periods than
//! that of the thread that evaluates them.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use takt_core::controller::{LoadRequest, NetState};
use takt_core::{CellConfig, Controller, NetId, SessionId};

fn parameters(joints: usize) -> BTreeMap<String, String> {
    let list = |value: f64| format!("{:?}", vec![value; joints]);
    [
        ("min_joint", -2.0),
        ("max_joint", 2.0),
        ("max_vel", 2.0),
        ("max_acc", 4.0),
    ]
    .map(|(key, value)| (key.to_owned(), list(value)))
    .into()
}

fn load(controller: &Controller, text: String, period: Option<Duration>) -> NetId {
    let (session, description) = (SessionId::NONE, String::new());
    let id = controller
        .load(LoadRequest {
            text,
            session,
            description,
            period,
        })
        .unwrap();
    let net = controller.net(id).unwrap();
    assert_eq!(net.state(), NetState::Ready, "{:?}", net.rejection);
    id
}

/// Moves joint 0 of an arm by half a radian within one and a half seconds.
fn swing(robot: &str) -> String {
    format!(
        "{{clock=Core::Clock(),part=Core::Interval(inValue=clock.outValue,Max='1.5'),
        smooth=Core::DoubleBezier(inValue=part.outValue,To='0.5'),
        joint=RobotArm::JointPosition(inPosition=smooth.outValue,Robot='{robot}',Axis='0'),
        error=Core::IntNetcommOut(inValue=joint.outError,Key='error'),
        done=Core::DoubleGreater(inFirst=clock.outValue,Second='1.6'),outTerminate=done.outValue}}"
    )
}

fn run(controller: &Controller, net: NetId) {
    controller.start_net(net).unwrap();
    let until = Instant::now() + Duration::from_secs(20);
    while controller.net(net).unwrap().state() != NetState::Terminated {
        assert!(Instant::now() < until, "the net does not end");
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(controller.net(net).unwrap().end, None);
    assert_eq!(
        controller.out_values(net),
        [("outerror".to_owned(), "0".to_owned())]
    );
}

fn position(controller: &Controller, name: &str) -> f64 {
    controller.arm_state(name).unwrap().joints[0]
        .measured_position
        .unwrap()
}

#[test]
fn sim_arm_is_at_its_set_points() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    controller
        .add_device("arm", "kuka_lwr_sim", &parameters(7))
        .unwrap();
    let net = load(&controller, swing("arm"), None);
    run(&controller, net);
    assert!((position(&controller, "arm") - 0.5).abs() < 1e-9);
}

#[test]
fn sim_arm_slower_net_reaches_same_position() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    controller
        .add_device("arm", "kuka_lwr_sim", &parameters(7))
        .unwrap();
    let net = load(&controller, swing("arm"), Some(Duration::from_millis(4)));
    run(&controller, net);
    assert!(
        (position(&controller, "arm") - 0.5).abs() < 1e-9,
        "{}",
        position(&controller, "arm")
    );
}

#[test]
fn net_period_not_multiple_is_rejected_with_figure() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    let request = LoadRequest {
        text: "{f=Core::BooleanValue(),outTerminate=f.outValue}".to_owned(),
        session: SessionId::NONE,
        description: String::new(),
        period: Some(Duration::from_micros(1500)),
    };
    let id = controller.load(request).unwrap();
    let rejection = controller.net(id).unwrap().rejection.unwrap().to_string();
    assert!(
        rejection.contains("1.5ms is not a whole multiple of the controller's 1ms"),
        "{rejection}"
    );
}

#[test]
fn arm_of_client_names_no_files() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/cells/ur5e.urdf");
    let text = takt_motion::Model::of_arm(takt_motion::urdf::read_arm(&file, None, None).unwrap());
    let mesh = ";V 0 0 0 0 0 0 0 1 mesh /secret.stl 1 1 1";
    let model = format!("{}{mesh}", text.full_text());
    let parameters = BTreeMap::from([("model".to_owned(), model)]);
    let controller = Controller::start(&CellConfig::default()).unwrap();
    controller
        .add_device("arm", "arm_sim", &parameters)
        .unwrap();
    let details = controller.device_details();
    let arm = details[0].model.arm().unwrap();
    assert_eq!((arm.joints.len(), arm.visuals.len()), (6, 0));
}

#[test]
fn sim_devices_are_created_and_removed() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    let add = |name, kind, joints| controller.add_device(name, kind, &parameters(joints));
    for round in 0..3 {
        add("a", "kuka_lwr_sim", 7).unwrap();
        add("b", "kuka_youbot_arm_sim", 5).unwrap();
        let twice = add("a", "kuka_iiwa_sim", 7).unwrap_err().to_string();
        assert!(twice.contains("`a` exists already"), "{twice}");
        let net = load(&controller, swing("b"), None);
        let used = controller.remove_device("b").unwrap_err().to_string();
        assert!(used.contains(&format!("used by net {net}")), "{used}");
        if round == 1 {
            run(&controller, net);
        } else {
            controller.abort(net).unwrap();
        }
        controller.unload(net).unwrap();
        controller.remove_device("a").unwrap();
        controller.remove_device("b").unwrap();
        assert!(controller.devices().is_empty());
    }
    let error = controller.remove_device("a").unwrap_err().to_string();
    assert!(error.contains("no device `a`"), "{error}");
}

#[test]
fn sim_device_wrong_parameters_are_reported() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    let refused = |kind: &str, change: (&str, &str)| {
        let mut parameters = parameters(7);
        parameters.insert(change.0.to_owned(), change.1.to_owned());
        controller
            .add_device("arm", kind, &parameters)
            .unwrap_err()
            .to_string()
    };
    let unknown = refused("kuka_lwr_simm", ("", ""));
    assert!(
        unknown.contains("there are arm_sim, kuka_lwr_sim, kuka_iiwa_sim"),
        "{unknown}"
    );
    assert!(refused("kuka_lwr_sim", ("max_vel", "[1,2]")).contains("max_vel: 7 numbers"));
    let unreadable = refused("kuka_lwr_sim", ("max_vel", "x"));
    assert!(
        unreadable.contains("max_vel: ") && unreadable.contains("list"),
        "{unreadable}"
    );
    let still = ("max_acc", "[0,0,0,0,0,0,0]");
    assert!(refused("kuka_lwr_sim", still).contains("joint 0 leave it no motion"));
    assert!(controller.devices().is_empty());
}

#[test]
fn net_above_period_budget_is_rejected_with_figure() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    let mut text = String::from("{f=Core::BooleanValue(),outTerminate=f.outValue");
    for i in 0..30_000 {
        text += &format!(",a{i}=Core::DoubleAdd(First='1')");
    }
    text.push('}');
    let (session, description, period) = (SessionId::NONE, String::new(), None);
    let id = controller
        .load(LoadRequest {
            text,
            session,
            description,
            period,
        })
        .unwrap();
    let rejection = controller.net(id).unwrap().rejection.unwrap().to_string();
    for text in [
        "costs up to 1.20044ms",
        "the limit is 800µs of its period of 1ms",
        "the heaviest are 30000 `Core::DoubleAdd` 100 %",
        "`takt net calibrate`",
    ] {
        assert!(rejection.contains(text), "{text} is missing in {rejection}");
    }
}

//! The description of devices and frames that programs get over the wire, of every kind of device, for two clients.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::time::Duration;

use takt_client::{Client, Value};
use takt_core::Controller;
use takt_core::device::driver::DriverThread;
use takt_server::{Server, ServerConfig};

/// A device of every kind. The drivers are not started, so that no interface is needed.
const CELL: &str = r#"
[[frame]]
name = "table"
position = [1, 0, 0.7]
rotation = [90, 0, 0]
hints = { lwr = [0, 30, 0, -60, 0, 90, 0] }

[[base]]
device = "lwr"
parent = "table"
position = [0, 0.5, 0]

[[tool]]
name = "pen"
device = "lwr"
position = [0, 0, 0.2]
mass = 0.3
centre_of_mass = [0, 0, 0.05]

[[home]]
device = "lwr"
joints = [0, 30, 0, -90, 0, 60, 0]

[[device]]
name = "lwr"
type = "kuka_lwr_fri"
[[device]]
name = "iiwa"
type = "kuka_iiwa_fri"
[[device]]
name = "rmp"
type = "segway_rmp"
links = ["can0"]
[[device]]
name = "wsg"
type = "schunk_wsg"
address = "127.0.0.1:1000"

[[canopen]]
name = "network"
interface = "can0"
[[canopen.arm]]
name = "turntable"
joint = [{ node = 5, increments_per_turn = 204800, range = [-170, 170], velocity_max = 100, acceleration_max = 300 }]

[[ethercat]]
name = "segment"
interface = "eth1"
[[ethercat.slave]]
name = "drive"
position = 0
axes = 1
[[ethercat.arm]]
name = "axis"
joint = [{ slave = "drive", increments_per_turn = 204800, range = [-180, 180], velocity_max = 400, acceleration_max = 1000 }]

[[ethercat]]
name = "youbot"
interface = "eth2"
[[ethercat.youbot_base]]
name = "platform"
[[ethercat.youbot_arm]]
name = "youbot_arm"
position = 5
gripper = "hand"
"#;

/// Name, joints, model, and an interface of each device.
const DEVICES: [(&str, usize, &str, &str); 15] = [
    ("lwr", 7, "kuka_lwr4", "wrench"),
    ("iiwa", 7, "kuka_iiwa14", "torques"),
    ("rmp", 0, "", "robotbase"),
    ("wsg", 0, "", "servogripper"),
    ("turntable", 1, "", "robotarm"),
    ("axis", 1, "", "robotarm"),
    ("platform", 0, "", "robotbase"),
    ("youbot_arm", 5, "kuka_youbot_upright", "armkinematics"),
    ("hand", 0, "", "gripper"),
    ("lwr_sim", 7, "kuka_lwr4", "armkinematics"),
    ("iiwa_sim", 7, "kuka_iiwa7", "armkinematics"),
    ("base_sim", 0, "", "cartesianposition"),
    ("gripper_sim", 0, "", "gripper"),
    ("wsg_sim", 0, "", "servogripper"),
    ("io_sim", 0, "", "io"),
];

const SIMULATED: [(&str, &str); 6] = [
    ("lwr_sim", "kuka_lwr_sim"),
    ("iiwa_sim", "kuka_iiwa_sim"),
    ("base_sim", "kuka_youbot_base_sim"),
    ("gripper_sim", "kuka_youbot_gripper_sim"),
    ("wsg_sim", "schunk_wsg_sim"),
    ("io_sim", "io_sim"),
];

fn controller() -> Controller {
    let cell = takt_devices::parse_cell(CELL).unwrap();
    let mut empty = cell.clone();
    empty.devices.clear();
    empty.buses.clear();
    empty.controller.priority = None;
    // The parents are those of the whole cell.
    empty.frames = takt_core::cell::CellFrames::default();
    let controller = Controller::start(&empty).unwrap();
    controller.set_frames(cell.frames.clone());
    for config in cell.drivers() {
        let added = controller.add_driver(config.name(), config.devices(), None, |ends| {
            let thread = DriverThread::start(config.name(), None, &[], move |stop| {
                while !stop.load(Ordering::Relaxed) {
                    std::thread::sleep(Duration::from_millis(20));
                }
                ends.clock
            })?;
            Ok(Box::new(thread))
        });
        added.unwrap();
    }
    let list = |value: f64| format!("{:?}", [value; 7]);
    let parameters = [
        ("min_joint", list(-2.0)),
        ("max_joint", list(2.0)),
        ("max_vel", list(2.0)),
        ("max_acc", list(4.0)),
    ];
    let parameters = parameters.map(|(key, value)| (key.to_owned(), value));
    for (name, kind) in SIMULATED {
        let is_arm = ["kuka_lwr_sim", "kuka_iiwa_sim"].contains(&kind);
        let parameters: BTreeMap<_, _> =
            parameters.clone().into_iter().filter(|_| is_arm).collect();
        controller.add_device(name, kind, &parameters).unwrap();
    }
    controller
}

/// The replies of two clients.
fn replies(command: &str) -> [BTreeMap<String, Value>; 2] {
    let controller = controller();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
        .unwrap();
    let config = ServerConfig {
        tcp: Some(SocketAddr::from(([127, 0, 0, 1], 0))),
        ..ServerConfig::default()
    };
    let server = runtime.block_on(Server::bind(config)).unwrap();
    let address = server.tcp_address().unwrap().to_string();
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let served = std::thread::spawn(move || {
        runtime.block_on(server.run(controller, async {
            let _ = stopped.await;
        }));
    });
    let replies = [0, 1].map(|_| {
        let client = Client::connect(&address).unwrap();
        let reply = client.call(command, [] as [&str; 0]).unwrap();
        reply.values[0].as_map().unwrap().clone()
    });
    drop(stop);
    served.join().unwrap();
    replies
}

fn texts(value: &Value) -> Vec<f64> {
    let list = value.as_list().unwrap().iter();
    list.map(|text| text.as_str().unwrap().parse().unwrap())
        .collect()
}

#[test]
fn description_of_every_device_kind_is_complete() {
    let [first, second] = replies("din");
    assert_eq!(first, second);
    for (name, joints, model, interface) in DEVICES {
        let device = first[name].as_map().unwrap();
        let found = device["joints"].as_list().unwrap();
        assert_eq!(found.len(), joints, "{name}");
        assert_eq!(device["kinematics"].as_str(), Some(model), "{name}");
        let interfaces = device["interfaces"].as_list().unwrap();
        assert!(
            interfaces.contains(&interface.into()),
            "{name}: {interfaces:?}"
        );
        let parameters = device["parameters"].as_map().unwrap();
        assert_eq!(parameters.len(), interfaces.len(), "{name}");
        let period: f64 = device["period"].as_str().unwrap().parse().unwrap();
        assert!(period > 0.0, "{name}");
        for joint in found {
            let number = |key: &str| {
                joint.as_map().unwrap()[key]
                    .as_str()
                    .unwrap()
                    .parse::<f64>()
            };
            assert!(number("position_min").unwrap() < number("position_max").unwrap());
            for key in ["velocity_max", "acceleration_max", "jerk_max"] {
                let limit = number(key).unwrap();
                assert!(limit > 0.0 && limit.is_finite(), "{name}: {key}");
            }
        }
        let chain = device.get("chain").and_then(Value::as_map);
        assert_eq!(chain.is_some(), !model.is_empty(), "{name}");
        let axes = chain.map_or(0, |chain| chain["axes"].as_list().unwrap().len());
        assert_eq!(axes, if model.is_empty() { 0 } else { joints }, "{name}");
        assert_eq!(device.contains_key("base"), name == "lwr", "{name}");
        assert_eq!(device.contains_key("home"), name == "lwr", "{name}");
    }
    let speed = |name: &str| {
        let parameters = first[name].as_map().unwrap()["parameters"]
            .as_map()
            .unwrap();
        let base = parameters["robotbase"].as_map().unwrap();
        base["velocity_max"]
            .as_str()
            .unwrap()
            .parse::<f64>()
            .unwrap()
    };
    assert!(speed("rmp") > 0.5 && speed("platform").to_bits() == 0.8_f64.to_bits());
    let lwr = first["lwr"].as_map().unwrap();
    let base = lwr["base"].as_map().unwrap();
    assert_eq!(base["parent"].as_str(), Some("table"));
    assert!(base["pose"].as_str().unwrap().contains("y:0.5"), "{base:?}");
    let pen = lwr["tools"].as_map().unwrap()["pen"].as_map().unwrap();
    assert_eq!(pen["mass"].as_str(), Some("0.3"));
    assert_eq!(texts(&pen["centre_of_mass"]), [0.0, 0.0, 0.05]);
    let home = texts(&lwr["home"]);
    assert!((home[3] + 90_f64.to_radians()).abs() < 1e-12, "{home:?}");
}

#[test]
fn named_frames_reach_every_client() {
    let [first, second] = replies("fin");
    assert_eq!(first, second);
    let table = first["table"].as_map().unwrap();
    assert_eq!(table["parent"].as_str(), Some("world"));
    let hints = table["hints"].as_map().unwrap();
    let hint = texts(&hints["lwr"]);
    assert!((hint[1] - 30_f64.to_radians()).abs() < 1e-12, "{hint:?}");
}

//! `/geometry/`, and that the page computes from it what the kinematics of the controller do.

use serde_json::Value;
use takt_core::{CellConfig, Controller};
use takt_motion::kinematics::named;

use super::super::page::tests::run;
use super::resources::{body, controller, get, post};

/// Limits of a simulated youBot arm, which has no data sheet.
const YOUBOT: &str = "type=kuka_youbot_arm_sim&min_joint=[-2.0,-2.0,-2.0,-2.0,-2.0]&max_joint=[2.0,2.0,2.0,2.0,2.0]\
    &max_vel=[1.0,1.0,1.0,1.0,1.0]&max_acc=[2.0,2.0,2.0,2.0,2.0]&home_joint=[0.0,0.0,0.0,0.0,0.0]";

/// Simulated arms and the models of their kinematics.
const ARMS: [(&str, &str, &str); 4] = [
    ("lwr", "type=kuka_lwr_sim", "kuka_lwr4"),
    ("iiwa", "type=kuka_iiwa_sim", "kuka_iiwa7"),
    ("folded", "zero=folded", "kuka_youbot"),
    ("upright", "zero=upright", "kuka_youbot_upright"),
];

fn geometry(controller: &Controller) -> Value {
    let response = get(controller, "/geometry/?format=json");
    assert!(response.starts_with("HTTP/1.1 200 OK"), "{response}");
    serde_json::from_str(body(&response)).unwrap()
}

#[test]
fn page_forward_kinematics_equal_those_of_controller() {
    let controller = controller();
    for (name, fields, _) in ARMS {
        let rest = if fields.starts_with("zero") {
            format!("&{YOUBOT}")
        } else {
            String::new()
        };
        let response = post(
            &controller,
            "/devices/",
            &format!("name={name}&{fields}{rest}"),
        );
        assert!(response.starts_with("HTTP/1.1 201"), "{name}: {response}");
    }
    let geometry = geometry(&controller);
    let program = r#"
        const { readGeometry } = await import("PAGE/js/geometry.js");
        const { forward } = await import("PAGE/js/math3.js");
        for (const device of readGeometry(GEOMETRY).devices)
          for (let round = 0; round < 100; round++) {
            const joints = device.axis.map((_, axis) => 2.5 * Math.sin(round * 1.7 + axis * 0.9));
            console.log(device.name, ...joints, ...forward(device, joints));
          }"#;
    let Some(printed) = run(&program.replace("GEOMETRY", &geometry.to_string())) else {
        takt_tests::skip(
            "page_forward_kinematics_equal_those_of_controller",
            "needs node",
        );
        return;
    };
    let mut compared = 0;
    for line in printed.lines() {
        let (name, numbers) = line.split_once(' ').unwrap();
        let numbers: Vec<f64> = numbers.split(' ').map(|it| it.parse().unwrap()).collect();
        let (joints, found) = numbers.split_at(numbers.len() - 16);
        let (_, _, model) = ARMS.iter().find(|(known, ..)| *known == name).unwrap();
        let flange = named(model).unwrap().forward(joints).to_homogeneous();
        for (expected, found) in flange.iter().zip(found) {
            assert!(
                (expected - found).abs() < 1e-9,
                "{name}: {found} for {expected}"
            );
        }
        compared += 1;
    }
    assert_eq!(compared, 100 * ARMS.len());
}

#[test]
fn geometry_places_devices_as_cell_does() {
    let cell = "[[frame]]\nname = 'table'\nposition = [1, 0, 0.7]\nrotation = [90, 0, 0]\n\
        [[base]]\ndevice = 'left'\nparent = 'table'\n\
        [[tool]]\nname = 'pen'\ndevice = 'left'\nposition = [0, 0, 0.2]";
    let mut cell = CellConfig::parse(cell, &[]).unwrap();
    cell.controller.priority = None;
    let controller = Controller::start(&cell).unwrap();
    post(&controller, "/devices/", "name=left&type=kuka_lwr_sim");
    post(
        &controller,
        "/devices/",
        "name=base&type=kuka_youbot_base_sim&max_vel=0.5&max_rot_vel=1.0&max_acc=1.0&max_rot_acc=2.0",
    );
    let geometry = geometry(&controller);
    let [table] = geometry["frame"].as_array().unwrap().as_slice() else {
        panic!("{geometry}");
    };
    assert_eq!(table["position"], serde_json::json!([1, 0, 0.7]));
    let devices = geometry["device"].as_array().unwrap();
    let find = |name: &str| devices.iter().find(|it| it["name"] == name).unwrap();
    let (left, base) = (find("left"), find("base"));
    assert_eq!(left["parent"], "table");
    assert_eq!(left["axis"].as_array().unwrap().len(), 7);
    assert_eq!(left["tool"][0]["position"], serde_json::json!([0, 0, 0.2]));
    assert_eq!(
        (&base["parent"], &base["mobile"]),
        (&Value::Null, &Value::Bool(true))
    );
    let wheels = base["solid"].as_array().unwrap().iter();
    assert_eq!(wheels.filter(|it| it["role"] == "wheel").count(), 4);

    // What stands on what: the tip of the pen in the world, with the arm upright.
    let program = r#"
        const { Places, readGeometry, rowOf } = await import("PAGE/js/geometry.js");
        const geometry = readGeometry(GEOMETRY), places = new Places(geometry, rowOf(geometry), new Map());
        const at = name => { const m = places.frame(name); return m && [...m.subarray(12, 15)].map(v => v.toFixed(4)).join(" "); };
        console.log([at("left.pen"), at("left.odd"), at("base.base") !== null].join("|"));"#;
    if let Some(printed) = run(&program.replace("GEOMETRY", &geometry.to_string())) {
        assert_eq!(printed, "1.0000 0.0000 2.0785||true");
    }
    let xml = get(&controller, "/geometry/");
    assert!(
        body(&xml).contains("<frame name=\"table\" parent=\"world\""),
        "{xml}"
    );
}

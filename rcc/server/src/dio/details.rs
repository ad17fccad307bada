//! Devices and frames as values, with what a program needs to plan motions. Numbers are texts in their shortest exact form:
//! the protocol's own have neither sign nor exponent. Frames are texts as in nets.

use takt_client::wire::Value;
use takt_core::cell::{CellFrames, ToolConfig};
use takt_core::controller::{Chain, DeviceDetails};
use takt_core::net::Frame;
use takt_core::net::value::text::TextValue as _;

/// Ratio of jerk to acceleration that motions keep, 1/s: full acceleration after 0.1 s. No driver knows a jerk limit.
const JERK_PER_ACCELERATION: f64 = 10.0;

fn number(number: f64) -> Value {
    Value::from(number.to_string())
}

fn numbers(numbers: &[f64]) -> Value {
    Value::List(numbers.iter().map(|value| number(*value)).collect())
}

fn frame(frame: Frame) -> Value {
    let mut text = String::new();
    frame.format(&mut text);
    Value::from(text)
}

/// Name and description of a device.
pub(super) fn value(device: DeviceDetails) -> (String, Value) {
    let joints = device.joints.iter().map(|joint| {
        Value::map_of([
            ("position_min", number(joint.position_min)),
            ("position_max", number(joint.position_max)),
            ("velocity_max", number(joint.velocity_max)),
            ("acceleration_max", number(joint.acceleration_max)),
            (
                "jerk_max",
                number(joint.acceleration_max * JERK_PER_ACCELERATION),
            ),
        ])
    });
    let interfaces = Value::list_of(device.abilities.keys().map(String::as_str));
    let parameters = device.abilities.iter().map(|(name, parameters)| {
        let parameters = parameters.iter();
        let texts = parameters.map(|(key, text)| (key.clone(), Value::from(text.as_str())));
        (name.clone(), Value::map_of(texts))
    });
    let mut members = vec![
        ("type", Value::from(device.info.kind)),
        ("state", device.info.status.word().into()),
        ("interfaces", interfaces),
        ("parameters", Value::map_of(parameters)),
        ("period", number(device.period.as_secs_f64())),
        ("kinematics", device.model.name().into()),
        ("joints", Value::List(joints.collect())),
        ("tools", Value::map_of(device.tools.iter().map(tool))),
    ];
    members.extend(device.chain.as_ref().map(|of| ("chain", chain(of))));
    let is_chain = device.model.arm().is_some();
    let joints = is_chain.then(|| Value::from(device.model.text().into_owned()));
    members.extend(joints.map(|joints| ("serial", joints)));
    members.extend(device.home.map(|home| {
        let joints: Vec<_> = home.joints.iter().map(|joint| joint.to_radians()).collect();
        ("home", numbers(&joints))
    }));
    members.extend(device.base.map(|base| {
        let placed = [
            ("parent", base.parent.as_str().into()),
            ("pose", frame(base.placement().frame())),
        ];
        ("base", Value::map_of(placed))
    }));
    (device.info.name, Value::map_of(members))
}

fn tool(tool: &ToolConfig) -> (String, Value) {
    let members = [
        ("pose", frame(tool.placement().frame())),
        ("mass", number(tool.mass)),
        ("centre_of_mass", numbers(&tool.centre_of_mass)),
    ];
    (tool.name.clone(), Value::map_of(members))
}

fn chain(chain: &Chain) -> Value {
    let axes = chain.axes.iter().map(|axis| {
        Value::map_of([
            ("direction", numbers(axis.direction.as_slice())),
            ("point", numbers(axis.point.as_slice())),
        ])
    });
    Value::map_of([
        ("home", frame(chain.home)),
        ("axes", Value::List(axes.collect())),
    ])
}

/// The named frames of a cell.
pub(super) fn frames(frames: &CellFrames) -> Value {
    Value::map_of(frames.frames.iter().map(|named| {
        let hints = named.hints.iter().map(|(arm, joints)| {
            let joints: Vec<_> = joints.iter().map(|joint| joint.to_radians()).collect();
            (arm.clone(), numbers(&joints))
        });
        let members = [
            ("parent", Value::from(named.parent.as_str())),
            ("pose", frame(named.placement().frame())),
            ("hints", Value::map_of(hints)),
        ];
        (named.name.clone(), Value::map_of(members))
    }))
}

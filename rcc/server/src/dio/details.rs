//! Devices as values, with what a program needs to plan motions. Numbers are texts in their shortest exact form: the
//! protocol's own have neither sign nor exponent.

use takt_client::wire::Value;
use takt_core::controller::DeviceDetails;

/// Name and description of a device.
pub(super) fn value(device: DeviceDetails) -> (String, Value) {
    let number = |number: f64| Value::from(number.to_string());
    let joints = device.joints.iter().map(|joint| {
        Value::map_of([
            ("position_min", number(joint.position_min)),
            ("position_max", number(joint.position_max)),
            ("velocity_max", number(joint.velocity_max)),
            ("acceleration_max", number(joint.acceleration_max)),
        ])
    });
    let interfaces = device.info.interfaces.keys();
    let value = Value::map_of([
        ("type", Value::from(device.info.kind)),
        ("state", device.info.status.word().into()),
        ("interfaces", Value::list_of(interfaces.map(String::as_str))),
        ("period", number(device.period.as_secs_f64())),
        ("kinematics", device.model.into()),
        ("joints", Value::List(joints.collect())),
    ]);
    (device.info.name, value)
}

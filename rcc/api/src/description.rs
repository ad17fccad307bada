//! Devices as the controller describes them: who has an interface, its parameters, and arms with their joints.

use std::collections::BTreeMap;
use std::time::Duration;

use takt_client::Value;
use takt_motion::Model;

use crate::error::ErrorKind;
use crate::motion::{ArmDescription, JointLimits};
use crate::session::Session;

/// Descriptions of the devices of a controller, by their names.
#[derive(Debug)]
pub(crate) struct Descriptions(BTreeMap<String, Value>);

/// An interface of a device with its parameters.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Interface {
    pub(crate) name: &'static str,
    /// Type of the device.
    pub(crate) kind: String,
    parameters: BTreeMap<String, f64>,
}

impl Interface {
    /// A parameter, 0 if the controller does not know it.
    pub(crate) fn number(&self, parameter: &str) -> f64 {
        self.parameters.get(parameter).copied().unwrap_or_default()
    }
}

#[cfg(test)]
impl Interface {
    pub(crate) fn with<const N: usize>(name: &'static str, parameters: [(&str, f64); N]) -> Self {
        let parameters = parameters.map(|(key, value)| (key.to_owned(), value));
        Self {
            name,
            kind: "simulated".to_owned(),
            parameters: parameters.into(),
        }
    }
}

impl Descriptions {
    pub(crate) fn read(session: &Session) -> Result<Self, ErrorKind> {
        let reply = session.client().call("din", [] as [&str; 0])?;
        let Some(Value::Map(devices)) = reply.values.into_iter().next() else {
            return Ok(Self(BTreeMap::new()));
        };
        Ok(Self(devices))
    }

    /// All descriptions by the names of their devices.
    pub(crate) fn all(&self) -> impl Iterator<Item = (&String, &Value)> {
        self.0.iter()
    }

    /// Whether a device has an interface.
    pub(crate) fn has(&self, device: &str, name: &'static str) -> bool {
        let device = self.0.get(device);
        device.and_then(|device| interface(device, name)).is_some()
    }

    /// The first of some interfaces that a device has; `wanted` says in errors what such devices are.
    pub(crate) fn interface(
        &self,
        name: &str,
        wanted: &'static str,
        interfaces: &[&'static str],
    ) -> Result<Interface, ErrorKind> {
        let mut all = self.with_interface(interfaces);
        let at = all.iter().position(|(known, _)| known == name);
        at.map(|at| all.swap_remove(at).1).ok_or_else(|| {
            let others = all.into_iter().map(|(name, _)| name);
            ErrorKind::no_device(wanted, name, others.collect())
        })
    }

    /// All devices with one of some interfaces: their names, and the first of these that they have.
    pub(crate) fn with_interface(&self, interfaces: &[&'static str]) -> Vec<(String, Interface)> {
        let of = |device: &Value| interfaces.iter().find_map(|it| interface(device, it));
        let all = self.0.iter();
        all.filter_map(|(name, device)| Some((name.clone(), of(device)?)))
            .collect()
    }
}

/// The text of a member.
pub(crate) fn text<'a>(device: &'a Value, key: &str) -> Option<&'a str> {
    device.as_map()?.get(key)?.as_str()
}

fn number(device: &Value, key: &str) -> Option<f64> {
    text(device, key)?.parse().ok()
}

fn interface(device: &Value, name: &'static str) -> Option<Interface> {
    let parameters = device.as_map()?.get("parameters")?.as_map()?.get(name)?;
    let parameters = parameters.as_map()?.iter();
    let known = parameters.filter_map(|(key, value)| {
        let value = value.as_str()?.parse().ok()?;
        Some((key.clone(), value))
    });
    Some(Interface {
        name,
        kind: text(device, "type").unwrap_or_default().to_owned(),
        parameters: known.collect(),
    })
}

/// The model of a device's kinematics: its chain of joints if the controller describes that, else its name.
fn model(device: &Value) -> Model {
    let chain = text(device, "serial").and_then(|chain| chain.parse().ok());
    let named = || {
        text(device, "kinematics")
            .unwrap_or_default()
            .to_owned()
            .into()
    };
    chain.unwrap_or_else(named)
}

/// The arm of a device's description, if it is one.
pub(crate) fn arm(name: &str, device: &Value) -> Option<ArmDescription> {
    let joint = |joint: &Value| {
        Some(JointLimits {
            position_min: number(joint, "position_min")?,
            position_max: number(joint, "position_max")?,
            velocity: number(joint, "velocity_max")?,
            acceleration: number(joint, "acceleration_max")?,
            jerk: number(joint, "jerk_max")?,
        })
    };
    let joints = device.as_map()?.get("joints")?.as_list()?.iter();
    let joints: Option<Vec<_>> = joints.map(joint).collect();
    let joints = joints.filter(|joints| !joints.is_empty())?;
    let home = device.as_map()?.get("home").and_then(Value::as_list);
    let position = |joint: &Value| joint.as_str()?.parse().ok();
    // One that cannot be read has no joints, and no motion goes there.
    let home = home.map(|home| {
        home.iter()
            .map(position)
            .collect::<Option<_>>()
            .unwrap_or_default()
    });
    Some(ArmDescription {
        name: name.to_owned(),
        kind: text(device, "type").unwrap_or_default().to_owned(),
        model: model(device),
        home: home.unwrap_or_else(|| joints.iter().map(JointLimits::rest).collect()),
        joints,
        period: Duration::from_secs_f64(number(device, "period")?),
        interfaces: device
            .as_map()
            .and_then(|device| device.get("parameters")?.as_map())
            .map(|interfaces| interfaces.keys().cloned().collect())
            .unwrap_or_default(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn described(home: Option<Value>) -> ArmDescription {
        let joint = |min: &str, max: &str| {
            let limits = [("position_min", min), ("position_max", max)];
            let others = ["velocity_max", "acceleration_max", "jerk_max"].map(|key| (key, "1"));
            Value::map_of(limits.into_iter().chain(others))
        };
        let joints = [("-1", "2"), ("0.5", "1.5"), ("-3", "-1")];
        let joints = joints.map(|(min, max)| joint(min, max));
        let members = [
            ("joints", Value::list_of(joints)),
            ("period", "0.001".into()),
        ];
        let home = home.map(|home| ("home", home));
        arm("left", &Value::map_of(members.into_iter().chain(home))).unwrap()
    }

    #[test]
    fn home_is_that_of_cell_else_zero_or_middle() {
        assert_eq!(described(None).home, [0.0, 1.0, -2.0]);
        let home = described(Some(Value::list_of(["0.1", "1", "-1.5"]))).home;
        assert_eq!(home, [0.1, 1.0, -1.5]);
        let unread = described(Some(Value::list_of(["0.1", "x", "-1.5"])));
        assert!(unread.check_joints(&unread.home).is_err());
    }
}

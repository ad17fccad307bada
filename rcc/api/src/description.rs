//! Devices as the controller describes them: who has an interface, its parameters, and arms with their joints.

use std::collections::BTreeMap;
use std::time::Duration;

use takt_client::Value;

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
        let of = |device: &Value| interfaces.iter().find_map(|it| interface(device, it));
        self.0.get(name).and_then(of).ok_or_else(|| {
            let others = self.0.iter().filter(|(_, device)| of(device).is_some());
            ErrorKind::no_device(wanted, name, others.map(|(name, _)| name.clone()).collect())
        })
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
        parameters: known.collect(),
    })
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
    Some(ArmDescription {
        name: name.to_owned(),
        kind: text(device, "type").unwrap_or_default().to_owned(),
        model: text(device, "kinematics").unwrap_or_default().to_owned(),
        joints: joints.filter(|joints| !joints.is_empty())?,
        period: Duration::from_secs_f64(number(device, "period")?),
    })
}

//! What one client was told of the devices, and what it is to be told next. It asks the
//! controller nothing.

use std::collections::BTreeMap;

use takt_core::controller::DeviceInfo;

use super::push;
use crate::wire::{Message, Value};

/// A subscription to all devices.
#[derive(Debug)]
pub(super) struct DeviceWatch {
    tag: String,
    told: BTreeMap<String, Told>,
}

#[derive(Debug, PartialEq)]
struct Told {
    /// Type and interfaces, as they are sent.
    description: Value,
    status: &'static str,
}

impl DeviceWatch {
    /// A subscription that was told nothing yet.
    pub(super) const fn new(tag: String) -> Self {
        Self {
            tag,
            told: BTreeMap::new(),
        }
    }

    /// Tells what changed, given all devices as they are now: first those that are new or have
    /// other interfaces, then those that are gone, then those in another state.
    pub(super) fn handle_devices(&mut self, devices: Vec<DeviceInfo>) -> Vec<Message> {
        let now: BTreeMap<_, _> = devices.into_iter().map(told).collect();
        let described = self.differing(&now, |a, b| a.description == b.description);
        let added = described.map(|(n, t)| (n.clone(), t.description.clone()));
        let added: BTreeMap<_, _> = added.collect();
        let gone: Vec<_> = self
            .told
            .keys()
            .filter(|n| !now.contains_key(*n))
            .cloned()
            .collect();
        let changed = self.differing(&now, |a, b| a.status == b.status);
        let changed: BTreeMap<_, _> = changed.map(|(n, t)| (n.clone(), t.status.into())).collect();
        let mut out = Vec::new();
        if !added.is_empty() {
            out.push(push(&self.tag, "da", added));
        }
        if !gone.is_empty() {
            out.push(push(&self.tag, "dr", Value::list_of(gone)));
        }
        if !changed.is_empty() {
            out.push(push(&self.tag, "ds", changed));
        }
        self.told = now;
        out
    }

    /// The devices that were not told, or told differently.
    fn differing<'a>(
        &'a self,
        now: &'a BTreeMap<String, Told>,
        same: impl Fn(&Told, &Told) -> bool + 'a,
    ) -> impl Iterator<Item = (&'a String, &'a Told)> {
        now.iter()
            .filter(move |(name, new)| !self.told.get(*name).is_some_and(|t| same(t, new)))
    }
}

fn told(device: DeviceInfo) -> (String, Told) {
    let status = device.status.word();
    let interfaces = device
        .interfaces
        .into_iter()
        .map(|(k, v)| (k, Value::map_of(v)));
    let description = Value::map_of([
        ("type", device.kind.into()),
        ("interfaces", Value::map_of(interfaces)),
    ]);
    (
        device.name,
        Told {
            description,
            status,
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_core::device::DeviceStatus;

    fn arm(joints: u32, status: DeviceStatus) -> DeviceInfo {
        let joints = BTreeMap::from([("jointcount".to_owned(), joints.to_string())]);
        DeviceInfo {
            name: "lwr1".to_owned(),
            kind: "kuka_lwr_sim".to_owned(),
            interfaces: BTreeMap::from([("robotarm".to_owned(), joints)]),
            status,
        }
    }

    fn told(watch: &mut DeviceWatch, devices: &[DeviceInfo]) -> Vec<String> {
        watch
            .handle_devices(devices.to_vec())
            .iter()
            .map(Message::to_string)
            .collect()
    }

    #[test]
    fn devices_come_change_and_go() {
        use DeviceStatus::{Offline, Operational, SafeOperational};
        let mut watch = DeviceWatch::new("t".to_owned());
        let added = |joints| {
            let interfaces = format!("interfaces:{{robotarm:{{jointcount:\"{joints}\"}}}}");
            format!("t=da({{lwr1:{{{interfaces},type:\"kuka_lwr_sim\"}}}})")
        };
        let state = |word| format!("t=ds({{lwr1:\"{word}\"}})");
        assert_eq!(told(&mut watch, &[]), Vec::<String>::new());
        assert_eq!(
            told(&mut watch, &[arm(7, Offline)]),
            [added(7), state("off")]
        );
        assert_eq!(told(&mut watch, &[arm(7, Operational)]), [state("op")]);
        assert_eq!(
            told(&mut watch, &[arm(7, SafeOperational)]),
            [state("safeop")]
        );
        assert_eq!(told(&mut watch, &[arm(6, SafeOperational)]), [added(6)]);
        assert_eq!(told(&mut watch, &[]), [r#"t=dr(["lwr1"])"#]);
        assert_eq!(
            told(&mut watch, &[arm(7, Operational)]),
            [added(7), state("op")]
        );
    }
}
